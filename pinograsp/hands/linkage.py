"""Levers of linkages: chains that one motor moves together with a finger, and that are pinned to it.

A parallel gripper's finger hangs on two bars. Descriptions are trees, so one of the bars ends in nothing: a chain of
its own, which no person would call a finger.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import product

import coal
import numpy as np
import pinocchio as pin

from pinograsp.hands.geometry import hull_points, hulls
from pinograsp.hands.tree import Part
from pinograsp.spatial import Array

_LOOKS = (0.02, 0.35, 0.65, 0.98)  # shares of the joints' ranges at which links are looked at
_PINNED = 1e-3  # [m] by which links overlap where a pin joins them, at half of the looks or more
_SHORTER = 0.85  # reach of a lever, at most, relative to the finger that it carries


def without_levers(
    model: pin.Model,
    geometry: pin.GeometryModel,
    chains: list[list[Part]],
    driven: Collection[str],
    pinned: list[tuple[str, str]],
    notes: list[str],
) -> list[list[Part]]:
    """The chains that are fingers; levers are noted, and the pairs of links that pins may join added to ``pinned``.

    A lever is moved by no motor that does not move its finger as well, overlaps it wherever both are, and ends short of
    it, measured from where the finger begins. Or it is a motor's rod: it slides, and joints of the finger turn with it.
    ``driven``: joints that motors move; where these are none of the hand's, all are.
    """
    moved = {model.joints[model.getJointId(joint)].idx_v for joint in driven if model.existJointName(joint)}
    moved = moved or set(range(model.nv))
    looks: _Looks | None = None
    kept: list[list[Part]] = []
    levers: list[str] = []
    joined: list[tuple[str, str]] = []
    for chain in chains:
        own = _dofs(model, chain) & moved
        fingers = [other for other in chains if other is not chain and own <= _dofs(model, other)]
        if fingers and looks is None:
            looks = _Looks(model, hulls(geometry))
        carried = [
            finger
            for finger in fingers
            if _is_rod(model, chain, finger) or (looks is not None and looks.carries(chain, finger))
        ]
        if carried:
            levers.append(chain[-1].joint.child)
            joined += [pair for finger in carried for pair in product(_links(chain), _links(finger))]
        else:
            kept.append(chain)
    if not levers or not kept:
        return chains
    pinned += joined
    notes.append(f"levers of linkages, not fingers: {', '.join(levers)} (fingers= can name them as fingers)")
    return kept


def _links(chain: list[Part]) -> list[str]:
    return [link for part in chain for link in part.links]


def _dofs(model: pin.Model, chain: list[Part]) -> set[int]:
    """Positions in q of the joints that move a chain."""
    return {model.joints[model.getJointId(part.joint.name)].idx_v for part in chain}


def _is_rod(model: pin.Model, chain: list[Part], finger: list[Part]) -> bool:
    """Whether a chain ends in a link that slides, and joints that turn the finger follow it."""
    rod = chain[-1]
    turning = [part for part in finger if part.joint.type != "prismatic"]
    return rod.joint.type == "prismatic" and bool(_dofs(model, [rod]) & _dofs(model, turning))


class _Looks:
    """A hand's links at several postures."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel):
        self.model, self.geometry = model, geometry
        self.poses: list[tuple[list[pin.SE3], list[pin.SE3]]] = []
        data, placed = model.createData(), geometry.createData()
        low, high = model.lowerPositionLimit, model.upperPositionLimit
        for share in _LOOKS:
            pin.forwardKinematics(model, data, low + share * (high - low))
            pin.updateGeometryPlacements(model, data, geometry, placed)
            self.poses.append(([pose.copy() for pose in data.oMi], [pose.copy() for pose in placed.oMg]))

    def carries(self, lever: list[Part], finger: list[Part]) -> bool:
        """Whether a chain is a lever of a finger."""
        both = self._joints(lever) & self._joints(finger)
        own, other = (self._shapes(self._joints(chain) - both) for chain in (lever, finger))
        if not own or not other:
            return False
        begin = self.model.getJointId(finger[0].joint.name)
        origin = self.poses[1][0][begin].translation
        if self._reach(own, origin) > _SHORTER * self._reach(other, origin):
            return False
        overlaps = [self._gap(poses, own, other) < -_PINNED for _, poses in self.poses]
        return sum(overlaps) >= len(overlaps) / 2

    def _joints(self, chain: list[Part]) -> set[int]:
        return {self.model.getJointId(part.joint.name) for part in chain}

    def _shapes(self, joints: set[int]) -> list[int]:
        return [i for i, one in enumerate(self.geometry.geometryObjects) if one.parentJoint in joints]

    def _reach(self, shapes: list[int], origin: Array) -> float:
        """Distance of the farthest point from an origin (3,) [m]."""
        poses, objects = self.poses[1][1], self.geometry.geometryObjects
        points = np.concatenate(
            [hull_points(objects[i].geometry) @ poses[i].rotation.T + poses[i].translation for i in shapes]
        )
        return float(np.linalg.norm(points - origin, axis=1).max())

    def _gap(self, poses: list[pin.SE3], own: list[int], other: list[int]) -> float:
        """Least distance [m]; below 0 where they overlap."""
        objects, request = self.geometry.geometryObjects, coal.DistanceRequest()
        at = {i: coal.Transform3s(poses[i].rotation, poses[i].translation) for i in (*own, *other)}
        return min(
            float(coal.distance(objects[i].geometry, at[i], objects[j].geometry, at[j], request, coal.DistanceResult()))
            for i in own
            for j in other
        )
