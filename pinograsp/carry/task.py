"""What is to be carried along which path, within what limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinograsp.carry.constraints import ArmLimits, GraspLimits, PathConstraints
from pinograsp.carry.limits import find_disturbance, limit_grasp, spare_forces
from pinograsp.carry.loads import CarryScenario, LoadedRobot
from pinograsp.carry.path import ArmPath
from pinograsp.checks import brief
from pinograsp.errors import CarryInfeasible
from pinograsp.forces import TorqueLimit
from pinograsp.hands import HandModel
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarrySettings:
    """Numbers of a carry plan, checked.

    Attributes:
        arm: limits of the robot's joints, less what is kept free.
        torque_limit: of the robot's joints, as for :class:`~pinograsp.forces.GraspConditions`.
        reserve: share of each limit that is kept free [-].
        disturbance: that is borne on the way as well [N]; None: that of the grasp's own reserve.
        gravity_o: (3,) [m/s^2].
        count: intervals.
    """

    arm: ArmLimits
    torque_limit: TorqueLimit
    reserve: float
    disturbance: float | None
    gravity_o: Array
    count: int

    __repr__ = brief("reserve", "count")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryTask:
    """What is carried along which path, within what limits.

    Attributes:
        robot: arm and hand.
        grasp: what is carried.
        path: of the arm, without joints that follow or hold.
        loaded: the robot with the planned object, then with those of other scenarios.
        limits: what the grasp may use.
        settings: the numbers.
        disturbance: that is borne on the way as well: a force in any direction [N], or a moment [N m].
    """

    robot: HandModel
    grasp: GraspPlan
    path: ArmPath
    loaded: tuple[LoadedRobot, ...]
    limits: GraspLimits
    settings: CarrySettings
    disturbance: tuple[float, float]

    __repr__ = brief("robot", "path")

    @property
    def count(self) -> int:
        """Number of intervals."""
        return self.settings.count

    def constrain(self, s: Array, knots: Array) -> PathConstraints:
        """Constraints at samples s (N,) and ends of intervals (N + 1,)."""
        slopes, object_slopes = self.loaded[0].slopes(self.path, knots)

        def of(loaded: LoadedRobot, others: tuple[PathConstraints, ...] = ()) -> PathConstraints:
            middle = loaded.along(self.path, s, self.settings.gravity_o)
            return PathConstraints(
                grasp=self.limits,
                arm=self.settings.arm,
                loaded=loaded,
                middle=middle,
                slopes=slopes,
                object_slopes=object_slopes,
                others=others,
            )

        return of(self.loaded[0], tuple(of(one) for one in self.loaded[1:]))


def prepare_task(
    robot: HandModel, grasp: GraspPlan, path: ArmPath, scenarios: Sequence[CarryScenario], settings: CarrySettings
) -> CarryTask:
    """The task of carrying what a grasp holds, whatever of the scenarios comes true.

    Raises:
        InvalidInput: a path of other joints than the arm's, a robot without the grasp's hand.
        CarryInfeasible: contacts that may not press enough to withstand the disturbances.
    """
    # The planned object first: loads and torques of the plan are its own. Friction counts at its least, so that
    # scenarios of the same loads are one; sorted, since even rounding should not depend on their order.
    planned, others = (1.0, (0.0, 0.0, 0.0)), {(one.mass, tuple(np.asarray(one.com).tolist())) for one in scenarios}
    loads = [planned, *sorted(others - {planned})]
    loaded = tuple(LoadedRobot.carry(robot, grasp, CarryScenario(mass=mass, com=com)) for mass, com in loads)
    mu = min((1.0, *(one.mu for one in scenarios)))
    problem, (least, most) = limit_grasp(grasp, loaded[0], settings.reserve, settings.torque_limit, mu)
    disturbance = find_disturbance(grasp, loaded[0].body, settings.disturbance)
    spare = spare_forces(problem, *disturbance)
    if np.any(short := spare >= most):
        weak = int(np.argmax(short))
        raise CarryInfeasible(
            f"contact '{problem.contacts.names[weak]}' needs {spare[weak]:.3g} N to withstand the disturbances, but "
            f"may press with {most[weak]:.3g} N at most: choose smaller ones (disturbance=)",
            at=0.0,
            solution=None,
        )
    return CarryTask(
        robot=robot,
        grasp=grasp,
        path=loaded[0].keep_arm_joints(path),
        loaded=loaded,
        limits=GraspLimits(problem=problem, least=least, most=most, spare=spare),
        settings=settings,
        disturbance=disturbance,
    )
