"""An object that jaws push: how it makes way, without friction, and whether friction jams it between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from pinograsp.contacts.clearance import Distances, HandPart
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array

_RATHER_MOVED = 3.0  # a turn costs this times as much as a move as far as its rim goes: pushed, an object slides first
_BALANCED = 1e-3  # of the pressing forces: what may be left of them where the object jams
_CUTS = 30  # rounds of making way after a push
_PRESSING = 60  # points that are remembered


class PushedObject:
    """An object between the parts of a hand.

    Attributes:
        distances: of the hand from it.
        pressing: joints, and points that pressed the object, in their frames.
    """

    def __init__(self, distances: Distances):
        self.distances = distances
        self.pressing: list[tuple[int, Array]] = []

    def is_jammed(self, parts: Sequence[HandPart], gaps: Array, friction: float, near: float) -> bool:
        """Whether friction lets the parts that are ``near`` [m] press the object without moving it.

        Then forces in their friction cones add up to zero. The posture and the object's place are those that distances
        are taken at; ``gaps`` are lower bounds there.
        """
        arm, edges, fingers = self.distances.body.bounding_radius, [], set()
        for part in (part for part, gap in zip(parts, gaps) if gap <= near):
            gap, point = self.distances.of(part)
            if gap <= near:
                fingers.add(part.finger)
                _, normal = self.distances.surface(point)
                across = tangents(normal[None])[0]
                for turn in np.arange(8) * np.pi / 4:
                    force = normal + friction * across @ (np.cos(turn), np.sin(turn))
                    edges.append([*force, *np.cross(point - self.distances.body.com_o, force) / arm, 1.0])
        if len(fingers) < 2:
            return False
        _, left = nnls(np.array(edges).T, np.eye(7)[6])
        return bool(left < _BALANCED)

    def make_way(
        self, parts: Sequence[HandPart], q: Array, body: Body, gaps: Array, far: float, room: float
    ) -> tuple[Body, Array] | None:
        """The object out of the way of all parts at q, moved and turned as little as possible; None: it cannot yield.

        ``gaps`` are lower bounds of the parts' distances from ``body``; new ones are returned as well. It moves by
        ``far`` [m] at most, and where it makes way by half of ``room`` [m] more than it must.
        """
        gaps, given = gaps.copy(), body
        points, exact = np.zeros((len(parts), 3)), np.zeros(len(parts), dtype=bool)
        radius, arm = body.bounding_radius, _RATHER_MOVED * body.bounding_radius
        motion = np.zeros(6)  # translation, and turn times the arm
        self.distances.put(q, body)
        joints = self.distances.data.oMi
        for _ in range(_CUTS):
            # Points that pressed before show cheaply where room is wanted, distances whether that was all.
            known = np.array([joints[joint].act(point) for joint, point in self.pressing]).reshape(-1, 3)
            for _ in range(_CUTS if len(known) else 0):
                surface, normal, gap = body.project(known)
                if gap.min() >= 0.0:
                    break
                # Each asks for room along its normal: the least motion that gives it to all that are near.
                near = gap < far
                rows = np.hstack([normal[near], np.cross(surface[near] - body.com_o, normal[near]) / arm])
                new = _least_motion(rows, 0.5 * room - gap[near] + rows @ motion)
                if new is None or np.linalg.norm(new[:3]) + np.linalg.norm(new[3:]) * radius / arm > far:
                    return None  # squeezed between parts that press against each other, or out of their reach
                gaps -= np.linalg.norm(new[:3] - motion[:3]) + np.linalg.norm(new[3:] - motion[3:]) * radius / arm
                exact[:] = False
                motion = new
                body = given.moved(motion[:3], pin.exp3(motion[3:] / arm))
            self.distances.put(q, body)
            while True:
                worst = int(np.argmin(gaps))
                if gaps[worst] >= 0.0:
                    return body, gaps
                if exact[worst]:
                    break
                gaps[worst], point = self.distances.bound(parts[worst])
                points[worst] = 0.0 if point is None else point
                exact[worst] = True
            # As deep as the distance says: coal's points in an overlap can be micrometres off.
            _, inwards, gap = body.project(points[worst][None])
            point, joint = points[worst] + max(gap[0] - gaps[worst], 0.0) * inwards[0], parts[worst].joint
            self.pressing = [*self.pressing[1 - _PRESSING :], (joint, joints[joint].actInv(point))]
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
