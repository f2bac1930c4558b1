"""An object that jaws push: how it makes way, without friction, and whether friction jams it between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from pinograsp.contacts.clearance import Distances, HandPart
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, cross

_RATHER_MOVED = 3.0  # a turn costs this times as much as a move as far as its rim goes: pushed, an object slides first
_BALANCED = 1e-3  # of the pressing forces: what may be left of them where the object jams
_CUTS = 30  # rounds of making way after a push
_TURNS = np.arange(8) * np.pi / 4
_AROUND = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])  # edges of friction cones, across the normal


def is_jammed(distances: Distances, parts: Sequence[HandPart], gaps: Array, friction: float, near: float) -> bool:
    """Whether friction lets the parts that are ``near`` [m] press the object without moving it.

    Then forces in their friction cones add up to zero. The posture and the object's place are those that distances
    are taken at; ``gaps`` are lower bounds there.
    """
    found = [(part.finger, *distances.of(part)) for part, gap in zip(parts, gaps) if gap <= near]
    pressing = [(finger, point) for finger, gap, point in found if gap <= near]
    if len({finger for finger, _ in pressing}) < 2:
        return False
    points = np.array([point for _, point in pressing])
    body = distances.body
    _, normals, _ = body.project(points)
    forces = normals[:, None] + friction * np.einsum("kxy,ey->kex", tangents(normals), _AROUND)
    moments = cross((points - body.com_o)[:, None], forces) / body.bounding_radius
    edges = np.concatenate([forces, moments, np.ones((*forces.shape[:2], 1))], axis=2).reshape(-1, 7)
    _, left = nnls(edges.T, np.eye(7)[6])
    return bool(left < _BALANCED)


def make_way(
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
