"""Closed loops of MJCF files: what one motor moves through a linkage, as joints that follow it linearly.

Trees have no loops, so MuJoCo closes them by constraints: a point of one body stays on a point of another. Where one
motor moves a loop, the positions of its other joints are solved for over the motor's range, as the constraints, the
joints' limits and their springs have them, and a line is fitted to each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import yourdfpy
from scipy.optimize import least_squares

from pinograsp.hands.coupling import Coupling
from pinograsp.hands.tree import MOVING
from pinograsp.spatial import Array

_SAMPLES = 9  # of the motor's range
_OFF = 2e-3  # [m] that a loop may be open by with the fitted lines
_STIFF, _STAY = 1e4, 1e-3  # weights of open loops [1/m] and of the way from the last sample [1/rad], against springs
_ROOM = 1e-6  # beyond a joint's limits, for a start at one
_STILL = 1e-3  # [rad or m] over the motor's range: a joint that moves less does not


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """Two links that share a point, which is at ``anchors`` (3,) in their frames [m]."""

    links: tuple[str, str]
    anchors: tuple[Array, Array]
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """Where a joint is by itself: its reference position, and its spring [N m/rad or N/m, rad or m]."""

    reference: float
    stiffness: float = 0.0
    relaxed: float = 0.0


def close_loops(
    robot: yourdfpy.Robot,
    loops: Sequence[Loop],
    rests: Mapping[str, Rest],
    couplings: Mapping[str, Coupling],
    driven: set[str],
    notes: list[str],
) -> tuple[dict[str, Coupling], list[Loop]]:
    """Couplings of joints to the motors' joints that move them through loops, noted, and the loops that stay open.

    Args:
        robot: links and joints as a URDF has them.
        loops: to be closed.
        rests: of the joints, by name.
        couplings: between joints, which are kept.
        driven: joints that a motor moves.
    """
    tree = _Linkage(robot, rests, couplings)
    groups: dict[str, list[Loop]] = {}
    for loop in loops:
        leaders = {tree.leader(joint) for joint in tree.between(*loop.links)} & {tree.leader(one) for one in driven}
        if len(leaders) == 1:
            groups.setdefault(leaders.pop(), []).append(loop)
    found: dict[str, Coupling] = {}
    closed: list[Loop] = []
    for motor, group in groups.items():
        if (fitted := _fit(tree, motor, group)) is None:
            continue
        lines, off = fitted
        found |= lines
        closed += group
        notes.append(
            f"loops are closed: {', '.join(lines)} follow {motor} in proportion, off by at most {1e3 * off:.2g} mm"
        )
    return found, [loop for loop in loops if loop not in closed]


def _fit(tree: _Linkage, motor: str, loops: list[Loop]) -> tuple[dict[str, Coupling], float] | None:
    """Lines of the joints in loops over a motor's range, and how far these leave the loops open [m]."""
    names = list(
        dict.fromkeys(joint for loop in loops for joint in tree.between(*loop.links) if tree.free(joint, motor))
    )
    low, high = tree.limits.get(motor, (np.nan, np.nan))
    if not names or not low < high:
        return None
    values = np.linspace(low, high, _SAMPLES)
    solved = np.zeros((_SAMPLES, len(names)))
    start = int(np.argmin(np.abs(values - tree.rests[motor].reference)))
    last = {start: np.array([tree.rests[name].reference for name in names])}
    for i in (*range(start, _SAMPLES), *range(start - 1, -1, -1)):
        before = last[start] if i == start else last[i - 1 if i > start else i + 1]
        last[i] = solved[i] = tree.solve(motor, float(values[i]), names, before, loops)
    lines: dict[str, Coupling] = {}
    for name, way in zip(names, solved.T):
        factor, offset = np.polyfit(values, way, 1).tolist()
        if abs(factor) * (high - low) < _STILL:
            factor, offset = 0.0, float(way.mean())
        lines[name] = Coupling(followed=motor, factor=factor, offset=offset)
    on_lines = np.array([[lines[name].factor * value + lines[name].offset for name in names] for value in values])
    off = max(
        float(np.linalg.norm(tree.open({motor: value, **dict(zip(names, q.tolist()))}, loop)))
        for value, q in zip(values.tolist(), on_lines)
        for loop in loops
    )
    return (lines, off) if off <= _OFF else None


class _Linkage:
    """The tree of a robot with the positions of all its joints."""

    def __init__(self, robot: yourdfpy.Robot, rests: Mapping[str, Rest], couplings: Mapping[str, Coupling]):
        self.rests, self.couplings = rests, couplings
        self.above = {joint.child: joint for joint in robot.joints}
        self.kinds = {joint.name: joint.type for joint in robot.joints}
        self.limits = {
            joint.name: (joint.limit.lower, joint.limit.upper) for joint in robot.joints if joint.limit is not None
        }

    def leader(self, joint: str) -> str:
        """What moves a joint: another one, or itself."""
        while joint in self.couplings:
            joint = self.couplings[joint].followed
        return joint

    def free(self, joint: str, motor: str) -> bool:
        """Whether the position of a joint follows from nothing but loops."""
        return joint in self.rests and joint not in self.couplings and joint != motor

    def between(self, one: str, other: str) -> list[str]:
        """Moving joints on the way from one link to another."""
        ways = [self._to_root(link) for link in (one, other)]
        shared = set(ways[0]) & set(ways[1])
        return [joint for way in ways for joint in way if joint not in shared and self.kinds[joint] in MOVING]

    def _to_root(self, link: str) -> list[str]:
        way = []
        while link in self.above:
            joint = self.above[link]
            link = joint.parent
            way.append(joint.name)
        return way

    def pose(self, link: str, q: Mapping[str, float]) -> pin.SE3:
        """Where a link is; joints that ``q`` does not name follow their leaders, or are at their references."""
        pose = pin.SE3.Identity()
        while link in self.above:
            joint = self.above[link]
            link = joint.parent
            way = self._position(joint.name, q) * joint.axis if joint.type in MOVING else np.zeros(3)
            moved = pin.SE3(pin.exp3(way), np.zeros(3)) if joint.type == "revolute" else pin.SE3(np.eye(3), way)
            pose = pin.SE3(joint.origin) * moved * pose
        return pose

    def _position(self, joint: str, q: Mapping[str, float]) -> float:
        if joint in q:
            return q[joint]
        if joint in self.couplings:
            one = self.couplings[joint]
            return one.factor * self._position(one.followed, q) + one.offset
        return self.rests[joint].reference

    def open(self, q: Mapping[str, float], loop: Loop) -> Array:
        """By how much a loop is open (3,) [m]."""
        one, other = (self.pose(link, q).act(anchor) for link, anchor in zip(loop.links, loop.anchors))
        return np.asarray(other - one)

    def solve(self, motor: str, value: float, names: list[str], before: Array, loops: list[Loop]) -> Array:
        """Positions of joints (n,) that close the loops with the motor at ``value``, springs at least energy."""
        rests = [self.rests[name] for name in names]
        pull = np.sqrt([rest.stiffness for rest in rests])
        relaxed = np.array([rest.relaxed for rest in rests])
        ends = np.array([self.limits.get(name, (-np.inf, np.inf)) for name in names])

        def residual(q: Array) -> Array:
            at = {motor: value, **dict(zip(names, q.tolist()))}
            gaps = [_STIFF * self.open(at, loop) for loop in loops]
            return np.concatenate([*gaps, pull * (q - relaxed), _STAY * (q - before)])

        bounds = ends[:, 0] - _ROOM, ends[:, 1] + _ROOM
        return np.asarray(least_squares(residual, np.clip(before, ends[:, 0], ends[:, 1]), bounds=bounds).x)
