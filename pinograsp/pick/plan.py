"""From an object that stands somewhere to a carried object, with the arm one has."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from pinograsp.carry import ArmPath, CarryPlan, plan_carry
from pinograsp.carry.constraints import ArmLimits
from pinograsp.carry.limits import limit_arm
from pinograsp.carry.plan import RAMP, SqueezeName
from pinograsp.carry.simulation import close_for_way
from pinograsp.checks import array_of, instance_of, integer, mapping_of, number, one_of, placement_of
from pinograsp.errors import InvalidInput, NoGrasp, PickFailed, Status
from pinograsp.forces import GraspConditions
from pinograsp.handover import JointTrajectory
from pinograsp.hands import HandModel, detach
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.pick.arm import Arm, find_supports
from pinograsp.pick.inverse_kinematics import PalmSolver
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.reach import PickTask, Reached, Reacher, line_of
from pinograsp.pick.record import PickPhase
from pinograsp.pick.timing import time_path
from pinograsp.pick.ways import find_way, is_straight, measure_way
from pinograsp.planner import GraspPlan, plan_best
from pinograsp.spatial import Array
from pinograsp.synthesis import GraspSearch, Wishes, find_grasps

LIFT = 0.1  # [m]
ACCELERATION = 10.0  # [rad/s^2 or m/s^2]
RESERVE = 0.3  # [-] of friction, torques, speeds and accelerations on the way
# Samples of the searches, one after the other, until a grasp goes; the last one where the arm got to some.
_COUNTS = (16, 48, 96)
_ENOUGH = 4  # grasps that are reached, after which no more are looked at
_INTERVALS = 250  # of the way with the object
_LESS = 1 / 3  # of the reserve and of the accelerations, where a grasp leaves no more
_OVER = (0.08, 0.16, 0.24)  # [m] straight up, for ways over what is between
_LONG = 1.6  # times the straight way in the joints: others are looked for
_FINE = 0.1  # [rad or m] between waypoints of a way, halved until its spline is free
_HALVINGS = 4
# [s] in which the squeeze ends where an object is put, and in which the hand opens then; between samples of that.
_EASE, _OPENING, _EASED = 0.3, 0.8, 5e-3
_LOOK = 0.01  # [rad or m] between postures of a spline that are looked at


def plan_pick(
    robot: HandModel,
    body: Body,
    scene: Scene,
    conditions: GraspConditions,
    wishes: Wishes | None = None,
    *,
    place: ArrayLike | None = None,
    start: Mapping[str, float] | None = None,
    lift: float = LIFT,
    acceleration: ArrayLike = ACCELERATION,
    speed: ArrayLike | None = None,
    reserve: float = RESERVE,
    seed: int = 0,
    jobs: int = -1,
    progress: bool | None = None,
) -> PickPlan:
    """Take an object from where it stands, carry it, and put it down: grasp, ways, timing and torques.

    Grasps of the hand alone are searched, those that the arm reaches are planned, best first: there is a posture
    in which nothing is hit (inverse kinematics by Pink), the open hand comes straight to it and leaves likewise, the
    object goes straight up and is put straight down. The ways between are OMPL's; free ones are timed by TOPP-RA,
    held ones by :func:`~pinograsp.carry.plan_carry` under the grasp's own limits.

    Args:
        robot: arm and hand in one model (:func:`~pinograsp.hands.attach`), its root where it is bolted.
        body: the object, where it stands.
        scene: what stands around.
        conditions: of the grasp.
        wishes: how it is to be held.
        place: pose (4, 4) of the object's frame where it is to be put, or where it is to be with the turn that it
            has (3,) [m]; None: it is lifted, and that is all.
        start: the arm's positions, ``{joint: position}`` [rad or m]; others as in its ``posture``. Without both, where
            joints at 0 hit something, the middle of the joints' ranges.
        lift: how far the object goes straight up, and comes straight down [m].
        acceleration: largest |acceleration| of the arm's joints, one number or (n,) [rad/s^2 or m/s^2].
        speed: largest |speed| likewise [rad/s or m/s]; None: the robot's own.
        reserve: share of torques, speeds and accelerations, and of the grasp's friction on the way, kept free [-].
        seed: of all that is random.
        jobs: processes of the search.
        progress: of the search: bar on stderr: None (on a terminal), True or False.

    Raises:
        InvalidInput: unusable values; a robot without an arm; a start that is not free.
        PickFailed: no grasp, or none that goes: with what kept each from it.
        ExtraMissing: the extra ``arm`` is not installed.
    """
    mark = time.perf_counter()
    instance_of("conditions", conditions, GraspConditions)
    instance_of("robot", robot, HandModel)
    if find_supports(instance_of("scene", scene, Scene), instance_of("body", body, Body)):
        conditions = replace(conditions, table=True)
    task = _read_task(robot, body, scene, place, start, lift, conditions)
    wishes = Wishes() if wishes is None else instance_of("wishes", wishes, Wishes)
    seed = integer("seed", seed, at_least=0)
    reacher = Reacher(task, np.random.default_rng(seed))
    limits = limit_arm(task.robot, "effort", speed, acceleration, reserve)
    settings = _Settings(limits, reserve, acceleration, speed, seed)
    elapsed: dict[str, float] = dict.fromkeys(("search", "reach", "forces", "ways", "timing"), 0.0)

    def stop(stage: str) -> None:
        nonlocal mark
        now = time.perf_counter()
        elapsed[stage] += now - mark
        mark = now

    tried, doubtful = 0, None
    for round_, count in enumerate(_COUNTS):
        if count == _COUNTS[-1] and not reacher.arrived:
            break
        found = find_grasps(
            task.hand, body, conditions, wishes=wishes, count=count, seed=seed + round_, jobs=jobs, progress=progress
        )
        stop("search")
        reached = list[Reached]()
        for grasp in found.grasps:
            if len(reached) == _ENOUGH:
                break
            tried += 1
            if grasp.withstands and (one := reacher.reach(grasp)) is not None:
                reached.append(one)
            elif not grasp.withstands:
                reacher.reasons["cannot be held"] += 1
        stop("reach")
        while reached:
            try:
                plan = plan_best(_only(found, reached), conditions, progress=False)
            except NoGrasp:
                reacher.reasons["cannot be held"] += len(reached)
                break
            finally:
                stop("forces")
            chosen = next(one for one in reached if one.grasp.closure is plan.closure)
            reached.remove(chosen)
            if plan.status not in (Status.OK, Status.DOUBTFUL):
                reacher.reasons[f"plan {plan.status.value}"] += 1
                continue
            made = _Maker(task, plan, chosen, settings).make(stop)
            if isinstance(made, str):
                reacher.reasons[made] += 1
                continue
            made = replace(made, tried=tried)
            # Where the best grasp is doubtful all are; where the way with it is, another one may do.
            if made.status is Status.OK or plan.status is not Status.OK:
                return replace(made, elapsed=elapsed)
            doubtful = doubtful or made
        if doubtful is not None:
            return replace(doubtful, elapsed=elapsed)
    raise PickFailed(_explain(tried, reacher), dict(reacher.reasons))


def _read_task(
    robot: HandModel,
    body: Body,
    scene: Scene,
    place: ArrayLike | None,
    start: Mapping[str, float] | None,
    lift: float,
    conditions: GraspConditions,
) -> PickTask:
    if not len(robot.arm):
        raise InvalidInput(
            f"robot '{robot.name}': expected an arm that carries the hand, got a hand alone: mount it on one, "
            "pinograsp.hands.attach(arm, hand, link=...)"
        )
    if start is not None:
        names = [robot.joint_names[i] for i in robot.arm]
        given = mapping_of("start", start, "{joint: position}")
        for name in given:
            one_of("start: joint of the arm", name, names)
        robot = robot.with_posture({**robot.posture, **given})
    where = None
    if place is not None:
        if np.shape(place) == (3,):
            where = np.array(body.pose)
            where[:3, 3] = array_of("place", place, (3,))
        else:
            where = np.array(placement_of("place", place))
    gravity = np.array(conditions.gravity_o)
    if not (size := float(np.linalg.norm(gravity))):
        raise InvalidInput("gravity: expected some, got none: nothing stands anywhere then")
    task = PickTask(
        robot=robot,
        hand=detach(robot),
        body=body,
        scene=scene,
        place=where,
        start=np.array(robot.resting)[robot.arm],
        lift=number("lift", lift, above=0, at_most=2, unit="m"),
        up_o=-gravity / size,
        supports=find_supports(scene, body, where),
    )
    arm = task.arm(task.hand.resting, "free", body, task.start)
    if not robot.posture and not arm.is_free(task.start):
        middle = (robot.lower + robot.upper)[robot.arm] / 2.0
        if arm.is_free(middle):
            names = [robot.joint_names[i] for i in robot.arm]
            robot = robot.with_posture(dict(zip(names, middle.tolist())))
            return replace(task, robot=robot, hand=detach(robot), start=middle)
    if not arm.is_free(task.start):
        nearest = arm.find_nearest(task.start)
        raise InvalidInput(
            f"start: expected a posture that keeps {1e3 * scene.clearance:g} mm from all, got one in which "
            f"{nearest.one} is {-1e3 * nearest.spare:.3g} mm nearer to {nearest.other}: give another start="
        )
    return task


def _only(found: GraspSearch, reached: list[Reached]) -> GraspSearch:
    return replace(found, grasps=tuple(one.grasp for one in reached))


def _explain(tried: int, reacher: Reacher) -> str:
    if not tried:
        return "no grasp was found: the hand by itself does not hold this object (pinograsp.find_grasps says why)"
    parts = ", ".join(f"{count} {reason}" for reason, count in reacher.reasons.most_common())
    return f"none of {tried} grasps goes: {parts}"


class _Settings(NamedTuple):
    """How the arm may move: limits of its joints, what is kept free of them, and where those come from."""

    limits: ArmLimits
    reserve: float
    acceleration: ArrayLike
    speed: ArrayLike | None
    seed: int


class _Maker:
    """Ways, timing and torques of one grasp that is reached."""

    def __init__(self, task: PickTask, plan: GraspPlan, reached: Reached, settings: _Settings):
        self.task, self.plan, self.reached, self.settings = task, plan, reached, settings
        self.joints = [task.robot.joint_names[i] for i in task.robot.arm]

    def make(self, stop: Callable[[str], None]) -> PickPlan | str:
        """The plan; else why there is none."""
        task, reached, motion = self.task, self.reached, self.plan.motion
        opened, closed = motion.q[0], motion.q[-1]
        body = self.plan.body
        assert body is not None
        free = task.arm(opened, "free", task.body, task.start)
        to = self._way(free, task.start, reached.approach[0])
        if to is None:
            return "no way to the object"
        at = reached.approach[-1]
        held = task.arm(closed, "held", body, at)
        parts = [reached.lift]
        if reached.lower is not None:
            between = self._way(held, reached.lift[-1], reached.lower[0])
            if between is None:
                return "no way with the object"
            parts += [between, reached.lower]
        coming = self._smooth(free, [to, reached.approach], ends=(False, True))
        carrying = self._smooth(held, parts, ends=(True, reached.lower is not None))
        if coming is None or carrying is None:
            return "no smooth way"
        stop("ways")
        carried = self._carry(carrying)
        stop("timing")
        if isinstance(carried, str):
            return carried
        ways = [("reach", coming)]
        if reached.leave is not None:
            ways.append(("leave", ArmPath.through(dict(zip(self.joints, reached.leave.T)))))
        moves = [one for name, way in ways if (one := self._move(name, way, opened)) is not None]
        stop("timing")
        if len(moves) < len(ways):
            return "no timing that the arm's torques allow"
        phases = [moves[0], *self._hold(carried), *moves[1:]]
        return PickPlan(
            robot=task.robot,
            body=task.body,
            scene=task.scene,
            place=task.place,
            grasp=self.plan,
            carry=carried,
            phases=tuple(phases),
        )

    def _carry(self, path: ArmPath) -> CarryPlan | str:
        """The way with the object, with the reserve that is wished, or with what the grasp leaves of it."""
        why = ""
        kinds: tuple[tuple[float, SqueezeName], ...] = ((1.0, "constant"), (_LESS, "constant"), (_LESS, "least"))
        for share, squeeze in kinds:
            try:
                return plan_carry(
                    self.task.robot,
                    self.plan,
                    path,
                    squeeze=squeeze,
                    intervals=_INTERVALS,
                    reserve=share * self.settings.reserve,
                    acceleration=share * np.asarray(self.settings.acceleration),
                    speed=self.settings.speed,
                    gravity_o=self.plan.gravity_o,
                )
            except NoGrasp as error:
                why = str(error).splitlines()[0]
        return f"cannot be carried ({why:.60})"

    def _way(self, arm: Arm, start: Array, goal: Array) -> Array | None:
        """A way over what is between; where that is long, or there is none, OMPL's around it, the shorter of both."""
        over = self._over(arm, start, goal)
        if over is not None and measure_way(over) <= _LONG * float(np.linalg.norm(goal - start)):
            return over
        around = find_way(arm, start, goal, seed=self.settings.seed)
        return min((way for way in (over, around) if way is not None), key=measure_way, default=None)

    def _over(self, arm: Arm, start: Array, goal: Array) -> Array | None:
        """Straight up from both ends, as far as it takes, and straight from there to there."""
        if is_straight(arm, start, goal):
            return np.array([start, goal])
        solver, palms = PalmSolver(arm), [arm.palm(x) for x in (start, goal)]
        for height in _OVER:
            ups = [solver.follow(line_of(palm, self.task.up_o, height), x) for palm, x in zip(palms, (start, goal))]
            if ups[0] is None or ups[1] is None:
                return None
            if is_straight(arm, ups[0][-1], ups[1][-1]):
                way = np.vstack([start, ups[0], ups[1][::-1], goal])
                return way if all(is_straight(arm, *pair) for pair in pairwise(way)) else None
        return None

    def _smooth(self, arm: Arm, parts: list[Array], ends: tuple[bool, bool]) -> ArmPath | None:
        """The spline through parts that follow each other, with waypoints so near that it is free like these.

        ``ends``: whether hands may be near in the first and in the last part.
        """
        fine = _FINE
        for _ in range(_HALVINGS):
            points, bounds = list[Array](), [0]
            for part in parts:
                dense = _densify(part, fine)
                points += list(dense if not points else dense[1:])
                bounds.append(len(points) - 1)
            path = ArmPath.through(dict(zip(self.joints, np.array(points).T)))
            if self._is_free(arm, path, path.s[bounds], ends):
                return path
            fine /= 2.0
        return None

    def _is_free(self, arm: Arm, path: ArmPath, bounds: Array, ends: tuple[bool, bool]) -> bool:
        """Whether a path keeps to its limits and hits nothing."""
        length = np.abs(np.diff(path.q, axis=0)).max(axis=1).sum()
        s = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / _LOOK)) + 1))
        x = path.at(s).q
        if np.any(x < arm.lower) or np.any(x > arm.upper):
            return False
        near = (ends[0] & (s <= bounds[1])) | (ends[1] & (s >= bounds[-2]))
        return all(arm.is_free(one, near=bool(close)) for one, close in zip(x, near))

    def _move(self, name: str, path: ArmPath, fingers: Array) -> PickPhase | None:
        """A phase in which the arm moves, and the fingers (n_h,) stay; None: its torques do not allow any."""
        task, q = self.task, np.array(self.task.robot.resting)
        q[self._fingers] = fingers
        timed = time_path(task.robot, path, q, self.settings.limits, self.plan.gravity_o, RAMP)
        return None if timed is None else PickPhase.alone(name, task.robot, timed, self.plan.gravity_o)

    @property
    def _fingers(self) -> list[int]:
        return [self.task.robot.joint_names.index(joint) for joint in self.task.hand.joint_names]

    def _open(self, way: JointTrajectory) -> PickPhase:
        """From the last squeeze of a way to the touch, all fingers at once, and from there back as they had come."""
        robot, motion = self.task.robot, self.plan.motion
        ease, back = (np.linspace(0.0, 1.0, round(took / _EASED) + 1) for took in (_EASE, _OPENING))
        pressed, touch = way.q[-1], way.q[-1].copy()
        touch[self._fingers] = motion.q[motion.impact]
        q = np.tile(pressed, (len(ease) + len(back) - 1, 1))
        q[: len(ease)] += _blend(ease)[:, None] * (touch - pressed)
        coming = CubicHermiteSpline(motion.times, motion.q, motion.dq)
        q[len(ease) :, self._fingers] = coming(motion.times[motion.impact] * (1.0 - _blend(back[1:])))
        dq = np.gradient(q, _EASED, axis=0)
        dq[[0, len(ease) - 1, -1]] = 0.0
        bare = inverse_dynamics(robot, q, np.zeros_like(q), np.zeros_like(q), gravity_o=self.plan.gravity_o)
        holding = way.effort[-1] - bare[0]
        left = np.concatenate([1.0 - _blend(ease), np.zeros(len(back) - 1)])
        return PickPhase(
            name="open",
            times=_EASED * np.arange(len(q), dtype=float),
            q=q,
            dq=dq,
            torques=bare + left[:, None] * holding,
        )

    def _hold(self, carried: CarryPlan) -> list[PickPhase]:
        """Closing, the way, and opening where the object is put."""
        way = carried.trajectory()
        times, q, dq, torques, _ = close_for_way(carried, way)
        phases = [
            PickPhase(name="close", times=times, q=q, dq=dq, torques=torques),
            PickPhase(name="carry", times=way.times, q=way.q, dq=way.dq, torques=way.effort),
        ]
        if self.reached.leave is None:
            return phases
        phases.append(self._open(way))
        return phases


def _densify(way: Array, apart: float) -> Array:
    """Waypoints (w, a) with others between them, none farther apart than that."""
    points = [way[:1]]
    for before, after in pairwise(way):
        count = max(1, int(np.ceil(np.abs(after - before).max() / apart)))
        points.append(before + np.arange(1, count + 1)[:, None] / count * (after - before))
    return np.concatenate(points)


def _blend(u: Array) -> Array:
    """From 0 to 1 as u (m,) does, at rest at both ends."""
    return (1.0 - np.cos(np.pi * u)) / 2.0
