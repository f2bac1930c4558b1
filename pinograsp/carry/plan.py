"""How fast an arm may carry what its hand holds along a path, and how hard the hand must squeeze on the way."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from numpy.typing import ArrayLike

from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.limits import limit_arm, read_joint_limits
from pinograsp.carry.loads import CarryScenario
from pinograsp.carry.passage import Passage
from pinograsp.carry.passing import pass_fastest, pass_smoothly, pass_timed
from pinograsp.carry.path import ArmPath
from pinograsp.carry.recording import record_plan
from pinograsp.carry.refusals import refuse_timing
from pinograsp.carry.squeeze import squeeze_least, squeeze_steadily
from pinograsp.carry.task import CarrySettings, prepare_task
from pinograsp.carry.timing import Timing
from pinograsp.checks import array_of, instance_of, integer, items_of, number, one_of, share_of
from pinograsp.errors import InvalidInput
from pinograsp.forces import TorqueLimit
from pinograsp.handover import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.planner import GraspPlan

TimingName = Literal["fastest", "given"]
SqueezeName = Literal["least", "constant"]

_ROUNDING = 1e-4  # of the factor on a given speed, which comes out a little too small
RAMP = 0.05  # [s] in less, an object would swing on its contacts


def plan_carry(
    robot: HandModel,
    grasp: GraspPlan,
    path: ArmPath | JointTrajectory | Mapping[str, ArrayLike],
    *,
    timing: TimingName = "fastest",
    squeeze: SqueezeName | float = "least",
    scenarios: Sequence[CarryScenario] = (),
    ramp: float = RAMP,
    jerk: ArrayLike | None = None,
    intervals: int = 500,
    reserve: float = 0.1,
    disturbance: float | None = None,
    torque_limit: TorqueLimit = "effort",
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    object_speed: float | None = None,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
) -> CarryPlan:
    """Plan the timing of an arm's path, and the squeeze along it, within the limits of grasp, friction and motors.

    The fastest timing goes from rest to rest. The path's parameter s moves with piecewise constant acceleration; wrench
    and torques are linear in it and in the squared speed, so that timing and contact forces together are one convex
    program (Verscheure et al. 2009, with exact friction cones), solved to a proven gap. The planned motion is the
    moving average of that motion over ``ramp``, slowed down if limits require it, because accelerations that jump would
    make the object swing on its contacts. Balance and limits hold at the middles of the intervals.

    Args:
        robot: arm and hand in one model.
        grasp: a plan with this robot, or with its hand alone, new or read back; it has the object, the contacts and the
            friction. Normal forces are at most those of its caps (not stored) and of its largest depth.
        path: of the arm: ``{joint: waypoints}`` [rad or m], an :class:`~pinograsp.carry.ArmPath`, or a trajectory.
            Other joints stay as they are in the grasp.
        timing: ``"fastest"``; or ``"given"``: that of the trajectory.
        squeeze: ``"least"``: at every instant the forces of least squares; ``"constant"``: normal forces that are
            commanded once for the whole path, with contacts that react to the loads as equal springs; a number: the
            largest change of each commanded normal force [N/s].
        scenarios: possible differences from the plan; one squeeze withstands all of them, each with the least friction
            of any. Their order does not matter; the plan's loads, forces and torques are those of the planned object.
        ramp: least time in which accelerations of the fastest timing change [s]; 0: they jump.
        jerk: largest |jerk| of the arm's joints, one number or (n,) [rad/s^3 or m/s^3], achieved by longer ramps (for
            small values also limit ``acceleration``); None: no limit.
        intervals: of the path, or of its time, N.
        reserve: share of friction, largest normal forces, torques, speeds and accelerations that is kept free [-].
        disturbance: force in any direction, or as a moment about any axis at the object's radius of gyration, that the
            squeeze also withstands along the path [N]; None: that of the grasp's own reserve, its heavier object
            included.
        torque_limit: largest |torque| of the robot's joints as for :class:`~pinograsp.forces.GraspConditions`.
        speed: largest |speed|, one number or (n,) [rad/s or m/s]; None: the robot's own limits, if it has any.
        acceleration: largest |acceleration|, one number or (n,) [rad/s^2 or m/s^2]; None: no limit.
        object_speed: largest speed of the object's centre of mass [m/s], without headroom; None: no limit.
        gravity_o: (3,) [m/s^2] in the robot's world.

    Raises:
        InvalidInput: unusable numbers, a path of other joints than the arm's or beyond their limits, a robot without
            the grasp's hand.
        CarryInfeasible: no timing holds the object, or the given one does not: at a point of the path no forces
            within the limits hold the load (proven), or no squeeze of that kind exists. ``factor`` is the possible
            speed over the given one.
        CarryUndecided: none was found, but it is not proven that none exists.
    """
    started = time.perf_counter()
    instance_of("robot", robot, HandModel)
    instance_of("grasp", grasp, GraspPlan)
    way, named = _read_path(path), one_of("timing", timing, get_args(TimingName))
    if named == "given" and way.duration is None:
        raise InvalidInput(
            "timing: expected 'fastest' for a path of waypoints, got 'given': give a trajectory (a column time)"
        )
    if named == "given" and jerk is not None:
        raise InvalidInput("jerk: expected with timing='fastest', got one with a given timing")
    rate = _read_rate(squeeze)
    reserve = share_of("reserve", reserve)
    settings = CarrySettings(
        arm=limit_arm(robot, torque_limit, speed, acceleration, reserve, object_speed),
        torque_limit=torque_limit,
        reserve=reserve,
        disturbance=None if disturbance is None else number("disturbance", disturbance, at_least=0, unit="N"),
        gravity_o=array_of("gravity", gravity_o, (3,)),
        count=integer("intervals", intervals, at_least=2, at_most=100_000),
    )
    task = prepare_task(robot, grasp, way, items_of("scenarios", scenarios, CarryScenario), settings)
    ramp = number("ramp", ramp, at_least=0, at_most=10, unit="s")
    most_jerk = None if jerk is None else read_joint_limits("jerk", jerk, robot.n)
    fastest: Passage | None = None
    if named == "given":
        passage = pass_timed(task, Timing.steady(float(way.duration or 0.0)))
        if passage.factor < 1.0 - _ROUNDING:
            raise refuse_timing(task, passage)
    else:
        passage = fastest = pass_fastest(task)
        if ramp or most_jerk is not None:
            passage = pass_smoothly(task, fastest.timing, ramp, most_jerk)
    mark = time.perf_counter()
    found = squeeze_least(passage) if rate is None else squeeze_steadily(passage, rate, slower=fastest is not None)
    elapsed = {"timing": mark - started, "forces": time.perf_counter() - mark}
    return record_plan(task, found, fastest, elapsed)


def _read_path(path: ArmPath | JointTrajectory | Mapping[str, ArrayLike]) -> ArmPath:
    if isinstance(path, JointTrajectory):
        return ArmPath.of(path)
    if isinstance(path, Mapping):
        return ArmPath.through(path)
    return instance_of("path", path, ArmPath)


def _read_rate(squeeze: SqueezeName | float) -> float | None:
    """Of the commanded forces' change [N/s]; None: they follow the loads."""
    if isinstance(squeeze, str):
        if squeeze not in get_args(SqueezeName):
            raise InvalidInput(f"squeeze: expected 'least', 'constant' or a number [N/s], got '{squeeze}'")
        return None if squeeze == "least" else 0.0
    return number("squeeze, as the largest change of commanded forces", squeeze, above=0, unit="N/s")
