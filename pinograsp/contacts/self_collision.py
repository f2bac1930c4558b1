"""Links of a hand that hit each other (coal); pairs whose bounding spheres are apart are not looked at."""

from __future__ import annotations

from collections import Counter

import coal
import numpy as np
import pinocchio as pin

from pinograsp.hands import HandModel
from pinograsp.spatial import Array, IntArray

_LOOKS = 9  # at what one motor moves, over its range


class SelfCollisions:
    """Which links of a hand overlap at a posture.

    Left out are pairs that the hand's SRDF disables. Those within two joints of each other in one chain do by design,
    and so do bars of a linkage: what one motor moves against each other, and overlaps over half of its range or more.
    """

    def __init__(self, hand: HandModel):
        model = hand.model
        self.model, self.data = model, model.createData()
        self.objects = list(hand.geometry.geometryObjects)
        self.request = coal.CollisionRequest()
        self.joints = np.array([one.parentJoint for one in self.objects], dtype=int)
        for one in self.objects:
            one.geometry.computeLocalAABB()
        self.centres = np.array([one.placement.act(np.array(one.geometry.aabb_center)) for one in self.objects])
        radii = np.array([one.geometry.aabb_radius for one in self.objects])
        self.links = [model.frames[one.parentFrame].name for one in self.objects]
        apart = np.array([[not _near(model, i, j) for j in range(model.njoints)] for i in range(model.njoints)])
        if not self.objects:
            self.pairs = np.zeros((0, 2), dtype=int)
            return
        disabled = {frozenset(pair) for pair in hand.disabled_collisions}
        pairs = np.argwhere(np.tril(apart[np.ix_(self.joints, self.joints)], -1)).tolist()
        kept = [(b, a) for b, a in pairs if frozenset((self.links[a], self.links[b])) not in disabled]
        self.pairs = np.array(kept, dtype=int).reshape(-1, 2)
        self.reach = radii[self.pairs].sum(axis=1)
        supports, joints = [set(support) for support in model.supports], self.joints.tolist()
        coupled = [
            (b, a)
            for b, a in self.pairs.tolist()
            if len({model.joints[j].idx_v for j in supports[joints[b]] ^ supports[joints[a]] if j}) == 1
        ]
        if coupled:
            linked = self._linked(hand, coupled)
            free = np.array([(self.links[a], self.links[b]) not in linked for b, a in self.pairs.tolist()])
            self.pairs, self.reach = self.pairs[free], self.reach[free]

    @property
    def names(self) -> list[tuple[str, str]]:
        """The links of each pair that is looked at."""
        return [(self.links[a], self.links[b]) for b, a in self.pairs.tolist()]

    def _linked(self, hand: HandModel, coupled: list[tuple[int, int]]) -> set[tuple[str, str]]:
        """Names of the links that overlap over half of the hand's range or more."""
        overlaps: Counter[tuple[str, str]] = Counter()
        for share in np.linspace(0.0, 1.0, _LOOKS):
            pin.forwardKinematics(self.model, self.data, hand.lower + share * (hand.upper - hand.lower))
            overlaps.update({(self.links[a], self.links[b]) for b, a in coupled if self._collide(b, a)})
        return {names for names, count in overlaps.items() if 2 * count >= _LOOKS}

    def at(self, q: Array) -> set[tuple[str, str]]:
        """Names of the links that overlap at a posture q (n,), pair by pair."""
        if not len(self.pairs):
            return set()
        pin.forwardKinematics(self.model, self.data, q)
        rotations = np.array([pose.rotation for pose in self.data.oMi])[self.joints]
        origins = np.array([pose.translation for pose in self.data.oMi])[self.joints]
        centres = origins + np.einsum("pij,pj->pi", rotations, self.centres)
        apart = np.linalg.norm(np.subtract(*centres[self.pairs.T]), axis=1)
        found: set[tuple[str, str]] = set()
        for b, a in self.pairs[apart <= self.reach].tolist():
            pair = (self.links[a], self.links[b])
            if pair not in found and self._collide(a, b):
                found.add(pair)
        return found

    def first(self, oMi: Array) -> IntArray:
        """A pair that overlaps (N,), by its place in ``pairs``, -1 where none does.

        ``oMi``: placements (N, joints, 4, 4) of the joints.
        """
        found = np.full(len(oMi), -1)
        if not len(self.pairs):
            return found
        poses = oMi[:, self.joints]
        centres = np.einsum("npij,pj->npi", poses[..., :3, :3], self.centres) + poses[..., :3, 3]
        between = centres[:, self.pairs[:, 0]] - centres[:, self.pairs[:, 1]]
        for i, k in np.argwhere(np.einsum("npx,npx->np", between, between) <= self.reach**2).tolist():
            if found[i] < 0:
                b, a = self.pairs[k]
                if self._overlap(a, b, *(pin.SE3(oMi[i, self.joints[one]]) for one in (a, b))):
                    found[i] = k
        return found

    def _collide(self, a: int, b: int) -> bool:
        return self._overlap(a, b, *(self.data.oMi[self.objects[i].parentJoint] for i in (a, b)))

    def _overlap(self, a: int, b: int, pose_a: pin.SE3, pose_b: pin.SE3) -> bool:
        one, other = (self.objects[i] for i in (a, b))
        poses = pose_a * one.placement, pose_b * other.placement
        there, here = (coal.Transform3s(pose.rotation, pose.translation) for pose in poses)
        return bool(coal.collide(one.geometry, there, other.geometry, here, self.request, coal.CollisionResult()))

    def between(self, start: Array, q: Array) -> tuple[tuple[str, str], ...]:
        """Pairs of links that overlap at q (n,) but not at ``start`` (n,)."""
        after = self.at(q)
        return tuple(sorted(after - self.at(start))) if after else ()


def _near(model: pin.Model, one: int, other: int) -> bool:
    """Whether one of two joints is the other, or comes within two joints after it in one chain."""
    return one == other or _follows(model, one, other) or _follows(model, other, one)


def _follows(model: pin.Model, inner: int, outer: int) -> bool:
    for _ in range(2):
        outer = model.parents[outer]
        if outer == inner:
            return True
        if not outer:
            return False
    return False
