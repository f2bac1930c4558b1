"""From an object that stands somewhere to a carried object, with the arm one has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from pinograsp.carry import ArmPath, CarryPlan, plan_carry
from pinograsp.carry.constraints import ArmLimits
from pinograsp.carry.limits import limit_arm
from pinograsp.carry.plan import RAMP, SqueezeName
from pinograsp.carry.simulation import close_for_way
from pinograsp.checks import brief, instance_of, integer, mapping_of, number, one_of, share_of
from pinograsp.errors import InvalidInput, NoGrasp, PickFailed, Status
from pinograsp.forces import GraspConditions
from pinograsp.handover import JointTrajectory
from pinograsp.hands import HandModel, detach
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.pick.arm import Arm
from pinograsp.pick.inverse_kinematics import PalmSolver
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.place import PlaceRegion, find_places, measure_tilts
from pinograsp.pick.reach import PickTask, Reached, Reacher, ReachSetting, line_of
from pinograsp.pick.record import PickPhase
from pinograsp.pick.timing import time_path
from pinograsp.pick.upright import Upright
from pinograsp.pick.ways import find_way, is_straight, measure_way
from pinograsp.planner import GraspPlan, PlanOptions
from pinograsp.planner.best import plan_each
from pinograsp.planner.planning import GraspTask
from pinograsp.planner.stopwatch import Stopwatch
from pinograsp.spatial import Array
from pinograsp.synthesis import GraspSearch, Wishes, find_grasps

# Samples of the searches, one after the other, until a grasp goes.
_COUNTS = (16, 48)
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
_SLOWER = 1.05  # times as long as joints need that would be too fast: forces change a little with the time, too
_LEAST_TILT = 0.01  # [rad] that postures, splines and rounding take


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickMotion:
    """How an arm goes.

    Attributes:
        lift: how far the object goes straight up, and comes straight down [m].
        upright: how far the object may tilt while it is held [rad]; None: anyhow.
        acceleration: largest |acceleration| of the arm's joints, one number or (n,) [rad/s^2 or m/s^2].
        speed: largest |speed| likewise [rad/s or m/s]; None: the robot's own.
        object_speed: largest speed of the object [m/s]; None: any.
        reserve: share of torques, speeds and accelerations, and of the grasp's friction on the way, kept free [-].
    """

    lift: float = 0.1
    upright: float | None = None
    acceleration: ArrayLike = 10.0
    speed: ArrayLike | None = None
    object_speed: float | None = None
    reserve: float = 0.3

    __repr__ = brief("lift", "upright", "object_speed", "reserve")

    def __post_init__(self) -> None:
        number("lift", self.lift, above=0, at_most=2, unit="m")
        if self.upright is not None:
            number("upright", self.upright, at_least=_LEAST_TILT, at_most=np.pi, unit="rad")
        share_of("reserve", self.reserve)


def plan_pick(
    robot: HandModel,
    body: Body,
    scene: Scene,
    conditions: GraspConditions,
    wishes: Wishes | None = None,
    *,
    place: ArrayLike | PlaceRegion | None = None,
    start: Mapping[str, float] | None = None,
    motion: PickMotion | None = None,
    seed: int = 0,
    jobs: int = -1,
    progress: bool | None = None,
) -> PickPlan:
    """Take an object from where it stands, carry it, and put it down: grasp, ways, timing and torques.

    Grasps of the hand are searched where the arm brings it and there is room; best first: there is a posture in which
    nothing is hit (inverse kinematics by Pink), the open hand comes straight to it and leaves likewise, the object goes
    straight up and is put straight down. The ways between are OMPL's; free ones are timed by TOPP-RA, held ones by
    :func:`~pinograsp.carry.plan_carry` under the grasp's own limits.

    Args:
        robot: arm and hand in one model (:func:`~pinograsp.hands.attach`), its root where it is bolted.
        body: the object, where it stands.
        scene: what stands around.
        conditions: of the grasp.
        wishes: how it is to be held.
        place: pose (4, 4) of the object's frame where it is to be put, or where it is to be with the turn that it
            has (3,) [m], or a region, of which the first place that goes is taken; None: it is lifted, and that is all.
        start: the arm's positions, ``{joint: position}`` [rad or m]; others as in its ``posture``. Without both, where
            joints at 0 hit something, the middle of the joints' ranges.
        motion: how the arm goes; None: :class:`PickMotion` as it is.
        seed: of all that is random.
        jobs: processes of the search.
        progress: of the search: bar on stderr: None (on a terminal), True or False.

    Raises:
        InvalidInput: unusable values; a robot without an arm; a start that is not free; a place without room, or where
            the object is not as upright as is wished.
        PickFailed: no grasp, or none that goes: with what kept each from it.
        ExtraMissing: the extra ``arm`` is not installed.
    """
    clock = Stopwatch("search", "reach", "forces", "ways", "timing")
    instance_of("conditions", conditions, GraspConditions)
    instance_of("robot", robot, HandModel)
    if instance_of("scene", scene, Scene).find_supports(instance_of("body", body, Body)):
        conditions = replace(conditions, table=True)
    motion = PickMotion() if motion is None else instance_of("motion", motion, PickMotion)
    wishes = Wishes() if wishes is None else instance_of("wishes", wishes, Wishes)
    seed = integer("seed", seed, at_least=0)
    rng = np.random.default_rng(seed)
    task = read_task(robot, body, scene, place, start, motion, conditions, rng)
    reacher, setting = Reacher(task, rng), ReachSetting(task)
    limits = limit_arm(task.robot, "effort", motion.speed, motion.acceleration, motion.reserve)
    tried, doubtful = 0, None
    for round_, count in enumerate(_COUNTS):
        found = find_grasps(
            task.hand,
            body,
            conditions,
            wishes=wishes,
            scene=setting,
            impact_time=0.5 * sum(conditions.impact_time_range),
            count=count,
            seed=seed + round_,
            jobs=jobs,
            progress=progress,
        )
        clock.stop("search")
        tried += reacher.count_refused(found)
        reached = list[Reached]()
        for grasp in found.grasps:
            if len(reached) == _ENOUGH:
                break
            tried += 1
            if grasp.withstands and (one := reacher.reach(grasp)) is not None:
                reached.append(one)
            elif not grasp.withstands:
                reacher.reasons["cannot be held"] += 1
        clock.stop("reach")
        refused = list[tuple[NoGrasp, GraspTask]]()
        plans = plan_each(_only(found, reached), conditions, progress=False, refused=refused) if reached else iter(())
        for plan in plans:
            clock.stop("forces")
            chosen = next(one for one in reached if one.grasp.closure is plan.closure)
            plan = _slow_closing(plan, conditions)
            clock.stop("forces")
            if plan.status not in (Status.OK, Status.DOUBTFUL):
                reacher.reasons[f"plan {plan.status.value}"] += 1
                continue
            made = _Maker(task, plan, chosen, motion, limits, seed).make(clock)
            if isinstance(made, str):
                reacher.reasons[made] += 1
                clock.stop("ways")
                continue
            # Where the best grasp is doubtful all are; where the way with it is, another one may do.
            if made.status is Status.OK or plan.status is not Status.OK:
                return _finish(made, tried, clock)
            doubtful = doubtful or made
        if refused:
            reacher.reasons["cannot be held"] += len(refused)
        clock.stop("forces")
        if doubtful is not None:
            return _finish(doubtful, tried, clock)
        if not found.grasps and reacher.reasons:
            break  # there is hardly room for the hand
    raise PickFailed(_explain(tried, reacher, found), dict(reacher.reasons))


def read_task(
    robot: HandModel,
    body: Body,
    scene: Scene,
    place: ArrayLike | PlaceRegion | None,
    start: Mapping[str, float] | None,
    motion: PickMotion,
    conditions: GraspConditions,
    rng: np.random.Generator,
) -> PickTask:
    """What is to be picked, checked: see :func:`plan_pick`."""
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
    gravity = np.array(conditions.gravity_o)
    if not (size := float(np.linalg.norm(gravity))):
        raise InvalidInput("gravity: expected some, got none: nothing stands anywhere then")
    up_o = -gravity / size
    places = find_places(place, body, scene, up_o, rng)
    tilted = float(measure_tilts(places, body, up_o).max(initial=0.0))
    if motion.upright is not None and tilted > motion.upright:
        raise InvalidInput(
            f"upright: expected a place that tilts the object by {np.degrees(motion.upright):.3g} deg at most, got one "
            f"that tilts it by {np.degrees(tilted):.3g} deg"
        )
    task = PickTask(
        robot=robot,
        hand=detach(robot),
        body=body,
        scene=scene,
        places=places,
        start=np.array(robot.resting)[robot.arm],
        lift=motion.lift,
        gravity_o=gravity,
        supports=set().union(*(scene.find_supports(body.placed(pose)) for pose in (body.pose, *places))),
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


def _slow_closing(plan: GraspPlan, conditions: GraspConditions) -> GraspPlan:
    """The plan; where its hand would close faster than its joints can, one that takes as long as they need."""
    limit = np.where(plan.hand.velocity > 0, plan.hand.velocity, np.inf)
    factor = _SLOWER * float((np.abs(plan.motion.dq) / limit).max())
    if factor <= _SLOWER or plan.closure is None:
        return plan
    first, last = conditions.impact_time_range
    slower = replace(
        conditions,
        final_time=factor * conditions.final_time,
        impact_time_range=(factor * first, factor * last),
    )
    try:
        return GraspTask.of_closure(plan.closure, slower, PlanOptions(), progress=False).attempt()
    except NoGrasp:
        return plan


def _finish(made: PickPlan, tried: int, clock: Stopwatch) -> PickPlan:
    """The plan with what takes a while and is told of none but this one."""
    grasp = made.grasp.with_tolerance()
    clock.stop("forces")
    return replace(made, grasp=grasp, tried=tried, elapsed=clock.elapsed)


def _only(found: GraspSearch, reached: list[Reached]) -> GraspSearch:
    return replace(found, grasps=tuple(one.grasp for one in reached))


def _explain(tried: int, reacher: Reacher, last: GraspSearch) -> str:
    """Why nothing goes: what kept the arm from grasps, or, where none was found, what the search of them says."""
    if not last.grasps and sum(reacher.reasons.values()) < last.tried:
        return f"no grasp was found where the arm brings the hand: {last.explain()}"
    parts = ", ".join(f"{count} {reason}" for reason, count in reacher.reasons.most_common())
    return f"none of {tried} grasps goes: {parts}"


class _Maker:
    """Ways, timing and torques of one grasp that is reached."""

    def __init__(
        self, task: PickTask, plan: GraspPlan, reached: Reached, motion: PickMotion, limits: ArmLimits, seed: int
    ):
        self.task, self.plan, self.reached = task, plan, reached
        self.motion, self.limits, self.seed = motion, limits, seed
        self.joints = [task.robot.joint_names[i] for i in task.robot.arm]

    def make(self, clock: Stopwatch) -> PickPlan | str:
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
        upright = None if self.motion.upright is None else Upright(held, at, task.up_o, self.motion.upright)
        parts = [reached.lift]
        if reached.lower is not None:
            between = self._way(held, reached.lift[-1], reached.lower[0], upright)
            if between is None:
                return "no way with the object" + ("" if upright is None else " upright")
            parts += [between, reached.lower]
        coming = self._smooth(free, [to, reached.approach], ends=(False, True))
        carrying = self._smooth(held, parts, ends=(True, reached.lower is not None), upright=upright)
        if coming is None or carrying is None:
            return "no smooth way"
        clock.stop("ways")
        carried = self._carry(carrying)
        clock.stop("timing")
        if isinstance(carried, str):
            return carried
        ways = [("reach", coming)]
        if reached.leave is not None:
            ways.append(("leave", ArmPath.through(dict(zip(self.joints, reached.leave.T)))))
        moves = [one for name, way in ways if (one := self._move(name, way, opened)) is not None]
        clock.stop("timing")
        if len(moves) < len(ways):
            return "no timing that the arm's torques allow"
        phases = [moves[0], *self._hold(carried), *moves[1:]]
        return PickPlan(
            robot=task.robot,
            body=task.body,
            scene=task.scene,
            place=reached.place,
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
                    reserve=share * self.motion.reserve,
                    acceleration=share * np.asarray(self.motion.acceleration),
                    speed=self.motion.speed,
                    object_speed=self.motion.object_speed,
                    gravity_o=self.plan.gravity_o,
                )
            except NoGrasp as error:
                why = str(error).splitlines()[0]
        return f"cannot be carried ({why:.60})"

    def _way(self, arm: Arm, start: Array, goal: Array, upright: Upright | None = None) -> Array | None:
        """A way over what is between; where that is long, or there is none, OMPL's around it, the shorter of both."""
        over = self._over(arm, start, goal, upright)
        if over is not None and measure_way(over) <= _LONG * float(np.linalg.norm(goal - start)):
            return over
        around = find_way(arm, start, goal, seed=self.seed, upright=upright)
        return min((way for way in (over, around) if way is not None), key=measure_way, default=None)

    def _over(self, arm: Arm, start: Array, goal: Array, upright: Upright | None) -> Array | None:
        """Straight up from both ends, as far as it takes, and straight from there to there."""
        if (straight := _go_straight(arm, start, goal, upright)) is not None:
            return straight
        solver, palms = PalmSolver(arm), [arm.palm(x) for x in (start, goal)]
        for height in _OVER:
            ups = [solver.follow(line_of(palm, self.task.up_o, height), x) for palm, x in zip(palms, (start, goal))]
            if ups[0] is None or ups[1] is None:
                return None
            if (straight := _go_straight(arm, ups[0][-1], ups[1][-1], upright)) is not None:
                sides = [np.vstack([start, ups[0]]), np.vstack([ups[1][::-1], goal])]
                if not all(is_straight(arm, *pair) for side in sides for pair in pairwise(side)):
                    return None
                return np.vstack([sides[0], straight[1:-1], sides[1]])
        return None

    def _smooth(
        self, arm: Arm, parts: list[Array], ends: tuple[bool, bool], upright: Upright | None = None
    ) -> ArmPath | None:
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
            if self._is_free(arm, path, path.s[bounds], ends, upright):
                return path
            fine /= 2.0
        return None

    def _is_free(
        self, arm: Arm, path: ArmPath, bounds: Array, ends: tuple[bool, bool], upright: Upright | None
    ) -> bool:
        """Whether a path keeps to its limits, hits nothing, and tilts nothing too far."""
        length = np.abs(np.diff(path.q, axis=0)).max(axis=1).sum()
        s = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / _LOOK)) + 1))
        x = path.at(s).q
        if np.any(x < arm.lower) or np.any(x > arm.upper):
            return False
        if upright is not None and max(upright.measure(one) for one in x) > upright.most:
            return False
        near = (ends[0] & (s <= bounds[1])) | (ends[1] & (s >= bounds[-2]))
        return all(arm.is_free(one, near=bool(close)) for one, close in zip(x, near))

    def _move(self, name: str, path: ArmPath, fingers: Array) -> PickPhase | None:
        """A phase in which the arm moves, and the fingers (n_h,) stay; None: its torques do not allow any."""
        task, q = self.task, np.array(self.task.robot.resting)
        q[self._fingers] = fingers
        timed = time_path(task.robot, path, q, self.limits, self.plan.gravity_o, RAMP)
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


def _go_straight(arm: Arm, start: Array, goal: Array, upright: Upright | None) -> Array | None:
    """Straight from one posture to another, as far as what is held stays upright; None: something is in the way."""
    if upright is None:
        return np.array([start, goal]) if is_straight(arm, start, goal) else None
    way = _densify(np.array([start, goal]), _FINE / 2.0)
    inner = [upright.straighten(x) for x in way[1:-1]]
    if any(x is None for x in inner):
        return None
    way[1:-1] = np.array(inner).reshape(-1, len(start))
    if np.abs(np.diff(way, axis=0)).max() > _FINE or not all(is_straight(arm, *pair) for pair in pairwise(way)):
        return None
    return way


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
