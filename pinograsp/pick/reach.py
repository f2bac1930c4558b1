"""Whether an arm reaches a grasp: postures there, and the straight lines by which it comes, lifts and puts down."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import brief
from pinograsp.hands import HandModel
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.pick.arm import OBJECT, Arm, Nearest, Object
from pinograsp.pick.inverse_kinematics import PalmSolver
from pinograsp.spatial import Array, inverse_of, pose_of
from pinograsp.synthesis import FoundGrasp, GraspSearch
from pinograsp.synthesis.setting import REFUSED

OUT_OF_REACH = "out of reach"
_STARTS = 12  # postures from which the inverse kinematics starts, at random
_FEW_STARTS, _FEW_STEPS = 3, 30  # and their steps, for each sample of a search
_STEP = 0.01  # [m] of a straight line
_POSTURES = 4  # of a grasp whose lines are tried
_STAND_OFF = (0.1, 0.06)  # [m] from which a hand comes straight on, and to which it leaves
_UPWARD = (0.0, 0.6, 1.0)  # share of the way out that goes up instead


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reached:
    """A grasp that the arm reaches; positions of the arm alone, (m, a) each.

    Attributes:
        grasp: which.
        approach: from where the hand comes straight on, to the grasp.
        lift: up from it.
        lower: down to where the object is put; None: it is only lifted.
        leave: from there straight back.
        place: pose (4, 4) of the object's frame there.
        room: of the posture in the grasp, least distance to a joint's limit over half its range [-].
    """

    grasp: FoundGrasp
    approach: Array
    lift: Array
    lower: Array | None
    leave: Array | None
    place: Array | None
    room: float

    __repr__ = brief("grasp", "room")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickTask:
    """What is to be picked, and where it is to go.

    Attributes:
        robot: arm and hand, in its resting posture.
        hand: alone.
        body: the object.
        scene: what stands around.
        places: poses (4, 4) of the object's frame, of which the first is taken that goes; none: it is only lifted.
        start: the arm's positions (a,).
        lift: how far straight up [m].
        gravity_o: (3,) [m/s^2].
        supports: names of the obstacles that the object stands on, and that it is put on.
    """

    robot: HandModel
    hand: HandModel
    body: Body
    scene: Scene
    places: tuple[Array, ...]
    start: Array
    lift: float
    gravity_o: Array
    supports: set[str]

    __repr__ = brief("robot")

    @property
    def up_o(self) -> Array:
        """Unit direction (3,)."""
        up: Array = -self.gravity_o / np.linalg.norm(self.gravity_o)
        return up

    def arm(self, fingers: Array, kind: Object, body: Body, x: Array) -> Arm:
        """The robot with its fingers at positions of the hand (n_h,), its arm at x (a,), where an object is held."""
        q = np.array(self.robot.resting)
        q[self.robot.arm] = x
        q[[self.robot.joint_names.index(joint) for joint in self.hand.joint_names]] = fingers
        return Arm(self.robot, q, self.scene, body, kind, self.supports)


class ReachSetting:
    """The setting of a search: where an arm gets with its hand open, and hits nothing."""

    def __init__(self, task: PickTask):
        self.task = task
        self._known: dict[bytes, tuple[PalmSolver, Array]] = {}

    def __reduce__(self) -> tuple[type[ReachSetting], tuple[PickTask]]:
        return ReachSetting, (self.task,)  # without what is heavy, and made quickly

    def refuse(self, hand: HandModel, q: Array) -> str:
        """Why the arm does not bring a hand where it is placed, open at q (n_h,)."""
        task, palm = self.task, hand.frame_placements(q, [self.task.robot.palm])[0]
        if (key := q.tobytes()) not in self._known:
            arm = task.arm(q, "free", task.body, task.start)
            # The same starts for every hand: what is found must not depend on which process looks.
            random = np.random.default_rng(0).uniform(arm.lower, arm.upper, (_FEW_STARTS, len(task.start)))
            self._known[key] = PalmSolver(arm), np.vstack([task.start, random])
        (solver, starts), why = self._known[key], OUT_OF_REACH
        for start in starts:
            x = solver.solve(palm, start, _FEW_STEPS)
            if x is None:
                continue
            nearest = solver.arm.find_nearest(x, near=True)
            if nearest.spare >= 0:
                return ""
            why = _tell(nearest, task)
        return why


class Reacher:
    """Looks which grasps a robot reaches, and counts why not.

    Attributes:
        reasons: what kept the arm from grasps, and from how many.

    Args:
        task: what is to be picked.
        rng: of the postures that the inverse kinematics starts from.
        starts: how many of these for each grasp.
    """

    def __init__(self, task: PickTask, rng: np.random.Generator, starts: int = _STARTS):
        self.task, self.rng, self.starts = task, rng, starts
        self.reasons: Counter[str] = Counter()

    def reach(self, grasp: FoundGrasp) -> Reached | None:
        """The best posture and lines to a grasp; None: there are none, which is counted."""
        task, closure = self.task, grasp.closure
        palm = closure.hand.frame_placements(closure.start, [task.robot.palm])[0]
        opened = task.arm(closure.start, "free", task.body, task.start)
        solver = PalmSolver(opened)
        random = self.rng.uniform(opened.lower, opened.upper, (self.starts, len(task.start)))
        postures = solver.find_postures(palm, np.vstack([task.start, random]))
        if not postures:
            self.reasons[OUT_OF_REACH] += 1
            return None
        why = Counter[str]()
        free = list[Array]()
        for x in postures:
            nearest = opened.find_nearest(x, near=True)
            if nearest.spare >= 0:
                free.append(x)
            else:
                why[_tell(nearest, task)] += 1
        for x in sorted(free, key=lambda one: -self._rate(opened, one))[:_POSTURES]:
            found = self._find_lines(grasp, opened, solver, palm, x)
            if isinstance(found, Reached):
                return found
            why[found] += 1
        self.reasons[why.most_common(1)[0][0]] += 1
        return None

    def count_refusals(self, found: GraspSearch) -> int:
        """Count the samples of a search that there was no place for; how many."""
        refused = {what: count for what, count in found.outcomes.items() if what.startswith(REFUSED)}
        for what, count in refused.items():
            self.reasons[what.removeprefix(f"{REFUSED} (").removesuffix(")")] += count
        return sum(refused.values())

    def _rate(self, arm: Arm, x: Array) -> float:
        """How good a posture is: what it has left of the joints' ways or, where that is less, of their torques [-]."""
        torques = arm.hold(x, self.task.body.mass, self.task.gravity_o)
        limits = arm.model.effortLimit
        load = np.divide(np.abs(torques), limits, out=np.zeros_like(torques), where=(limits > 0) & np.isfinite(limits))
        return min(_room(arm, x), 1.0 - float(load.max()))

    def _find_lines(self, grasp: FoundGrasp, opened: Arm, solver: PalmSolver, palm: Array, x: Array) -> Reached | str:
        task, closure = self.task, grasp.closure
        out = self._find_way_out(grasp, opened, solver, palm, x)
        if isinstance(out, str):
            return f"{out} on the way to the object"
        held_at = closure.object
        holding = task.arm(closure.q, "held", held_at, x)
        carrying = PalmSolver(holding)
        lift = self._follow(holding, carrying, line_of(palm, task.up_o, task.lift), x)
        if isinstance(lift, str):
            return f"{lift} on the way up"
        found = Reached(
            grasp=grasp, approach=out[::-1], lift=lift, lower=None, leave=None, place=None, room=_room(opened, x)
        )
        why = Counter[str]()
        for place in task.places:
            put = self._find_lines_there(found, holding, carrying, palm, place)
            if isinstance(put, Reached):
                return put
            why[put] += 1
        return why.most_common(1)[0][0] if why else found

    def _find_lines_there(
        self, lifted: Reached, holding: Arm, carrying: PalmSolver, palm: Array, place: Array
    ) -> Reached | str:
        """The same with the lines down to a place and back from there."""
        task, grasp, lift = self.task, lifted.grasp, lifted.lift
        closure = grasp.closure
        held_at = closure.object
        there = place @ inverse_of(held_at.pose)
        lowered = self._find_posture(holding, carrying, there @ palm, lift[-1])
        if isinstance(lowered, str):
            return f"{lowered} where it is to be put"
        above = self._follow(holding, carrying, line_of(there @ palm, task.up_o, task.lift), lowered)
        if isinstance(above, str):
            return f"{above} above where it is to be put"
        put = held_at.placed(there @ held_at.pose)
        open_there = task.arm(closure.start, "free", put, lowered)
        turned = there[:3, :3] @ grasp.look_o
        leave = self._find_way_out(grasp, open_there, PalmSolver(open_there), there @ palm, lowered, turned)
        if isinstance(leave, str):
            return f"{leave} on the way back"
        return replace(lifted, lower=above[::-1], leave=leave, place=place)

    def _find_posture(self, arm: Arm, solver: PalmSolver, palm: Array, start: Array) -> Array | str:
        """Where the object is put, near the posture ``start`` if that goes."""
        random = self.rng.uniform(arm.lower, arm.upper, (_STARTS, len(start)))
        postures = solver.find_postures(palm, np.vstack([start, random]))
        why = OUT_OF_REACH
        for x in postures:
            nearest = arm.find_nearest(x, near=True)
            if nearest.spare >= 0:
                return x
            why = _tell(nearest, self.task)
        return why

    def _find_way_out(
        self, grasp: FoundGrasp, arm: Arm, solver: PalmSolver, palm: Array, x: Array, look: Array | None = None
    ) -> Array | str:
        """Straight back from a grasp, more and more upwards where that does not go."""
        why = OUT_OF_REACH
        back = -(grasp.look_o if look is None else look)
        for share in _UPWARD:
            direction = (1.0 - share) * back + share * self.task.up_o
            if (size := float(np.linalg.norm(direction))) < 0.1:
                continue
            for distance in _STAND_OFF:
                found = self._follow(arm, solver, line_of(palm, direction / size, distance), x)
                if not isinstance(found, str):
                    return found
                why = found
        return why

    def _follow(self, arm: Arm, solver: PalmSolver, palms: Array, x: Array) -> Array | str:
        """Positions along a line that is free where hands may be near, and at its end everywhere; else why not."""
        found = solver.follow(palms, x)
        if found is None:
            return OUT_OF_REACH
        found = np.vstack([x, found])
        for near, xs in ((False, found[-1:]), (True, found)):
            for one in xs:
                if not arm.is_free(one, near=near):
                    return _tell(arm.find_nearest(one, near=near), self.task)
        return found


def line_of(palm: Array, direction: Array, distance: float) -> Array:
    """Palms (m, 4, 4) along a straight line, without the first one."""
    count = max(1, int(np.ceil(distance / _STEP)))
    shares = np.arange(1, count + 1) / count
    return np.array([pose_of(palm[:3, 3] + share * distance * direction, palm[:3, :3]) for share in shares])


def _room(arm: Arm, x: Array) -> float:
    half = (arm.upper - arm.lower) / 2.0
    return float((np.minimum(x - arm.lower, arm.upper - x) / half).min())


def _tell(nearest: Nearest, task: PickTask) -> str:
    """What is in the way, as one reason of many."""
    for name in (nearest.one, nearest.other):
        if name in task.scene.obstacles:
            return f"hit {name}"
    return f"hit {OBJECT}" if OBJECT in nearest[1:] else "hit the robot itself"
