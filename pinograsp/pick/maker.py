"""Ways, timing and torques of a grasp that an arm reaches."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from pinograsp.carry import ArmPath, CarryPlan, plan_carry
from pinograsp.carry.constraints import ArmLimits
from pinograsp.carry.limits import find_disturbance
from pinograsp.carry.plan import RAMP, SqueezeName
from pinograsp.carry.simulation import close_for_way
from pinograsp.errors import NoGrasp
from pinograsp.handover import JointTrajectory
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.pick.arm import Arm
from pinograsp.pick.inverse_kinematics import PalmSolver
from pinograsp.pick.pick_motion import PickMotion
from pinograsp.pick.pick_plan import PickPlan
from pinograsp.pick.reach import PickTask, Reached, line_of
from pinograsp.pick.record import PickPhase
from pinograsp.pick.timing import time_path
from pinograsp.pick.upright import Upright
from pinograsp.pick.ways import Patience, find_way, is_straight, measure_way
from pinograsp.planner import GraspPlan
from pinograsp.planner.stopwatch import Stopwatch
from pinograsp.spatial import Array

_INTERVALS = 250  # of the way with the object
_LESS = 1 / 3  # of the reserve, of accelerations, then of the disturbance besides, where a grasp leaves no more
_OVER = (0.08, 0.16, 0.24)  # [m] straight up, for ways over what is between
_LONG = 1.6  # times the straight way in the joints: others are looked for
_FINE = 0.1  # [rad or m] between waypoints of a way, halved until its spline is free
_HALVINGS = 4
# [s] in which the squeeze ends where an object is put, and in which the hand opens then; between samples of that.
_EASE, _OPENING, _EASED = 0.3, 2.0, 5e-3
_LOOK = 0.005  # [rad or m] between postures of a spline that are looked at


class PickMaker:
    """Ways, timing and torques of one grasp that is reached."""

    def __init__(
        self,
        task: PickTask,
        plan: GraspPlan,
        reached: Reached,
        motion: PickMotion,
        limits: ArmLimits,
        patience: Patience,
        seed: int,
    ):
        self.task, self.plan, self.reached = task, plan, reached
        self.motion, self.limits, self.patience, self.seed = motion, limits, patience, seed
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
            return "no path to the object"
        at = reached.approach[-1]
        held = task.arm(closed, "held", body, at)
        upright = None if self.motion.upright is None else Upright(held, at, task.up_o, self.motion.upright)
        parts = [reached.lift]
        if reached.lower is not None:
            between = self._way(held, reached.lift[-1], reached.lower[0], upright)
            if between is None:
                return "no path with the object" + ("" if upright is None else " upright")
            parts += [between, reached.lower]
        coming = self._smooth(free, [to, reached.approach], ends=(False, True))
        carrying = self._smooth(held, parts, ends=(True, reached.lower is not None), upright=upright)
        if coming is None or carrying is None:
            return "no smooth path"
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
        pushed, _ = find_disturbance(self.plan, self.task.body, None)
        kinds: tuple[tuple[float, SqueezeName, float | None], ...] = (
            (1.0, "constant", None),
            (_LESS, "constant", None),
            (_LESS, "least", None),
            (_LESS, "least", _LESS * pushed),
        )
        for share, squeeze, disturbance in kinds:
            try:
                return plan_carry(
                    self.task.robot,
                    self.plan,
                    path,
                    squeeze=squeeze,
                    disturbance=disturbance,
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
        around = find_way(arm, start, goal, seed=self.seed, patience=self.patience, upright=upright)
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
