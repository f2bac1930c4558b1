"""An object that jaws push: how it makes way, without friction, until friction jams it between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from pinograsp import core
from pinograsp.contacts.clearance import Distances, HandPart
from pinograsp.contacts.compiled import compiled_object, joints_of
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, cross

_PUSH = 0.005  # first share of the path that jaws push the object at once; quartered where it cannot yield
_ROOM = 0.02  # of the jaws' own way: room that a pushed object is given, so that curved paths need few corrections
_LEVERAGE = 10.0  # a pushed object moves at most this much farther than the jaws: else it slips out of them
CAGED = 2e-6  # [m] gap of a jaw that cages the object with others
_FAR = 4.0  # times the object's radius: it is pushed out of the hand
_PUSHES = 200  # at most
_RATHER_MOVED = 3.0  # a turn costs this times as much as a move as far as its rim goes: pushed, an object slides first
_BALANCED = 1e-3  # of the pressing forces: what may be left of them where the object jams
_CUTS = 30  # rounds of making way after a push
_TURNS = np.arange(8) * np.pi / 4
_AROUND = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])  # edges of friction cones, across the normal


class CompiledPush:
    """The core's pushes of an object, of that ``shape``, by a hand's parts, wherever the two are."""

    def __init__(self, hand: HandModel, body: Body, parts: Sequence[HandPart], shape: Any):
        settings = np.array([_PUSH, CAGED, _ROOM, _LEVERAGE, _FAR, _RATHER_MOVED, _BALANCED])
        self._pose, self._shape_b = np.array(hand.pose), np.array(body.shape_b)
        self._own = core.load().Push(body.bounding_radius, settings, most=_PUSHES, cuts=_CUTS)
        for joint in joints_of(hand.model):
            self._own.add_joint(*joint)
        for part in parts:
            self._own.add_part(part.joint - 1, part.placement.homogeneous, part.compiled)
        self._own.put(shape)

    @classmethod
    def of(cls, hand: HandModel, body: Body, parts: Sequence[HandPart]) -> CompiledPush | None:
        """None where the core is not installed, or does not know a shape."""
        if not core.is_installed() or any(part.hull is not part.geometry or part.compiled is None for part in parts):
            return None
        shape = compiled_object(body)
        return None if shape is None else cls(hand, body, parts, shape)

    def push(self, way: PushWay, hand: HandModel, body: Body, which: Sequence[int], friction: float) -> Pushed:
        """As :func:`push_object`, by the parts ``which``; ``hand``, ``body``: the same ones, where they are now."""
        there = self._pose @ np.linalg.inv(hand.pose)
        q, pose = way.q.copy(), np.ascontiguousarray(there @ body.shape_pose)
        fingers = list(dict.fromkeys(part.finger for part in way.parts))
        pushers = np.array([[i, fingers.index(part.finger)] for i, part in zip(which, way.parts)], dtype=np.int64)
        at = self._own.push(q, way.rate, way.last, pose, way.at, pushers, way.speeds, friction)
        if at == way.at:
            return Pushed(way.q, at, body)
        return Pushed(q, at, body.placed(np.linalg.inv(there) @ pose @ np.linalg.inv(self._shape_b)))


class PushWay(NamedTuple):
    """How parts push: from q (n,) at a point of the path, each joint at its ``rate`` (n,) to its ``last`` place (n,);
    the parts' speeds (p,) are bounds.
    """

    q: Array
    at: float
    rate: Array
    last: Array
    parts: Sequence[HandPart]
    speeds: Array


class Pushed(NamedTuple):
    """Where a push ends: the posture (n,), the point of the path, and the object."""

    q: Array
    at: float
    body: Body


def push_object(distances: Distances, way: PushWay, body: Body, friction: float) -> Pushed:
    """Go on with what pushes the object, which yields, until it is caged or jammed."""
    q, at, parts, speeds = way.q, way.at, way.parts, way.speeds
    start, step, most, room = body.com_o, _PUSH, _PUSH, 0.0
    gaps = np.full(len(parts), -np.inf)  # lower bounds at q and body: the distances of far parts are not computed
    distances.put(q, body)
    pushed = True
    for _ in range(_PUSHES):
        if pushed and _is_jammed(distances, parts, gaps, friction, max(CAGED, 2 * room)):
            if 2 * room <= CAGED:
                break
            most = step = min(step, most) / 4  # nearer, before it is called touching
        if step * speeds.max() < 0.1 * CAGED:
            break
        left = np.abs(way.last - q)
        if not left.max() > 1e-12:
            break
        # Every joint goes on to its own end.
        trial, reach = q + np.sign(way.rate) * np.minimum(step * np.abs(way.rate), left), step * speeds.max()
        given = max(0.1 * CAGED, _ROOM * reach)
        yielded = _make_way(distances, parts, trial, body, gaps - step * speeds, _LEVERAGE * reach + given, given)
        pushed = yielded is not None
        if yielded is None:
            step /= 4
        else:
            q, at, (body, gaps), room, step = trial, at + step, yielded, given, min(2 * step, most)
            if np.linalg.norm(body.com_o - start) > _FAR * body.bounding_radius:
                break
    return Pushed(q, at, body)


def _is_jammed(distances: Distances, parts: Sequence[HandPart], gaps: Array, friction: float, near: float) -> bool:
    """Whether friction lets the parts that are ``near`` [m] press the object without moving it.

    Then forces in their friction cones add up to zero. The posture and the object's place are those that distances
    are taken at; ``gaps`` are lower bounds there.
    """
    pressing = []
    for part, gap in zip(parts, gaps):
        if gap <= near and (found := distances.bound(part)).distance <= near and found.point is not None:
            pressing.append((part.finger, found.point, found.normal))
    if len({finger for finger, _, _ in pressing}) < 2:
        return False
    # Forces act along lines of least distance: that of a jaw's face from an edge is the face's normal.
    points, normals = (np.array([one[i] for one in pressing]) for i in (1, 2))
    body = distances.body
    forces = normals[:, None] + friction * np.einsum("kxy,ey->kex", tangents(normals), _AROUND)
    moments = cross((points - body.com_o)[:, None], forces) / body.bounding_radius
    edges = np.concatenate([forces, moments, np.ones((*forces.shape[:2], 1))], axis=2).reshape(-1, 7)
    _, left = nnls(edges.T, np.eye(7)[6])
    return bool(left < _BALANCED)


def _make_way(
    distances: Distances,
    parts: Sequence[HandPart],
    q: Array,
    body: Body,
    gaps: Array,
    far: float,
    room: float,
) -> tuple[Body, Array] | None:
    """The object out of the way of all parts at q, moved and turned as little as possible; None: it cannot yield.

    ``gaps`` are lower bounds of the parts' distances from ``body``; new ones are returned as well. It moves by
    ``far`` [m] at most, and where it makes way by half of ``room`` [m] more than it must.
    """
    gaps = gaps.copy()
    radius, arm = body.bounding_radius, _RATHER_MOVED * body.bounding_radius
    motion = np.zeros(6)  # translation, and turn times the arm
    rows, sides = np.empty((0, 6)), np.empty(0)
    distances.put(q, body)
    for _ in range(_CUTS):
        for i in np.flatnonzero(gaps < 0.0).tolist():
            found = distances.bound(parts[i])
            gaps[i], point = found.distance, found.point
            if point is not None:
                # It asks for room along the line of least distance: an object's edge leaves a jaw's face along
                # the face's normal, which the object's own surface does not have there.
                row = np.hstack([found.normal, cross(point - body.com_o - motion[:3], found.normal) / arm])
                rows, sides = np.vstack([rows, row]), np.append(sides, 0.5 * room - gaps[i] + row @ motion)
        if not (gaps < 0.0).any():
            moved = body.moved(motion[:3], pin.exp3(motion[3:] / arm))
            distances.put_object(moved)
            return moved, gaps
        new = _least_motion(rows, sides)
        if new is None or np.linalg.norm(new[:3]) + np.linalg.norm(new[3:]) * radius / arm > far:
            return None  # squeezed between parts that press against each other, or out of their reach
        gaps -= np.linalg.norm(new[:3] - motion[:3]) + np.linalg.norm(new[3:] - motion[3:]) * radius / arm
        motion = new
        distances.move_object(motion[:3], pin.exp3(motion[3:] / arm))
    return None


def _least_motion(rows: Array, sides: Array) -> Array | None:
    """Least m with rows @ m >= sides, or None (Lawson and Hanson's least distance programming)."""
    scale = max(float(np.abs(sides).max()), 1e-12)
    E = np.vstack([rows.T, sides / scale])
    target = np.zeros(len(E))
    target[-1] = 1.0
    u, left = nnls(E, target)
    residual = E @ u - target
    if left < 1e-7:
        return None
    motion: Array = -residual[:-1] / residual[-1] * scale
    return motion
