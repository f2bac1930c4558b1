"""Links of a hand that hit each other (coal); pairs whose bounding spheres are apart are not looked at."""

from __future__ import annotations

from collections import Counter
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from pinograsp.hands import HandModel
from pinograsp.spatial import Array, BoolArray, IntArray

_TOUCH = 1e-5  # [m] parts that slide along each other, as bars of jaws drawn side by side, overlap by less
_LOOKS = 9  # at what one motor moves, over its range


class SelfCollisions:
    """Which links of a hand overlap at a posture.

    Left out are pairs that the hand's SRDF disables. Those within two joints of each other in one chain do by design,
    and so do bars of a linkage: what one motor moves against each other, and touches over half of its range or more.
    """

    def __init__(self, hand: HandModel):
        model = hand.model
        self.hand, self.model, self.data = hand, model, model.createData()
        self.objects = list(hand.geometry.geometryObjects)
        self.touch, self.overlap = coal.CollisionRequest(), coal.CollisionRequest()
        self.overlap.security_margin = -_TOUCH
        self.joints = np.array([one.parentJoint for one in self.objects], dtype=int)
        for one in self.objects:
            one.geometry.computeLocalAABB()
        self.centres = np.array([one.placement.act(np.array(one.geometry.aabb_center)) for one in self.objects])
        radii = np.array([one.geometry.aabb_radius for one in self.objects])
        self.links = [model.frames[one.parentFrame].name for one in self.objects]
        if not self.objects:
            self.pairs = np.zeros((0, 2), dtype=int)
            return
        disabled = {frozenset(pair) for pair in hand.disabled_collisions}
        apart = ~_near(model)
        self.pairs = np.argwhere(np.tril(apart[np.ix_(self.joints, self.joints)], -1))
        if disabled:
            kept = [frozenset((self.links[a], self.links[b])) not in disabled for b, a in self.pairs.tolist()]
            self.pairs = self.pairs[np.array(kept, dtype=bool)]
        self.reach = radii[self.pairs].sum(axis=1)
        coupled = [tuple(pair) for pair in self.pairs[_moved_by_one(model, *self.joints[self.pairs].T)].tolist()]
        if coupled:
            linked = self._link(hand, coupled)
            free = np.array([(self.links[a], self.links[b]) not in linked for b, a in self.pairs.tolist()])
            self.pairs, self.reach = self.pairs[free], self.reach[free]

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process the pairs are listed anew."""
        return SelfCollisions, (self.hand,)

    def _link(self, hand: HandModel, coupled: list[tuple[int, int]]) -> set[tuple[str, str]]:
        """Names of the links that overlap over half of the hand's range or more."""
        overlaps: Counter[tuple[str, str]] = Counter()
        for share in np.linspace(0.0, 1.0, _LOOKS):
            pin.forwardKinematics(self.model, self.data, hand.lower + share * (hand.upper - hand.lower))
            at = {i: self._place(i) for i in {i for pair in coupled for i in pair}}
            hits = {(self.links[a], self.links[b]) for b, a in coupled if self._meet(b, a, at[b], at[a], self.touch)}
            overlaps.update(hits)
        return {names for names, count in overlaps.items() if 2 * count >= _LOOKS}

    def at(self, q: Array) -> set[tuple[str, str]]:
        """Names of the links that overlap at a posture q (n,), pair by pair."""
        if not len(self.pairs):
            return set()
        pin.forwardKinematics(self.model, self.data, q)
        poses = [pose.homogeneous for pose in self.data.oMi]
        placed = np.array(poses)[self.joints]
        centres = placed[:, :3, 3] + np.einsum("pij,pj->pi", placed[:, :3, :3], self.centres)
        apart = np.linalg.norm(np.subtract(*centres[self.pairs.T]), axis=1)
        found: set[tuple[str, str]] = set()
        near = self.pairs[apart <= self.reach].tolist()
        at = {i: self._place(i) for i in {i for pair in near for i in pair}}
        for b, a in near:
            pair = (self.links[a], self.links[b])
            if pair not in found and self._meet(a, b, at[a], at[b], self.overlap):
                found.add(pair)
        return found

    def _place(self, i: int) -> coal.Transform3s:
        one = self.objects[i]
        pose = self.data.oMi[one.parentJoint] * one.placement
        return coal.Transform3s(pose.rotation, pose.translation)

    def _meet(
        self, a: int, b: int, there: coal.Transform3s, here: coal.Transform3s, request: coal.CollisionRequest
    ) -> bool:
        one, other = self.objects[a].geometry, self.objects[b].geometry
        if isinstance(one, coal.BVHModelBase) or isinstance(other, coal.BVHModelBase):
            request = self.touch  # coal knows no margins of meshes
        return bool(coal.collide(one, there, other, here, request, coal.CollisionResult()))

    def between(self, start: Array, q: Array) -> tuple[tuple[str, str], ...]:
        """Pairs of links that overlap at q (n,) but not at ``start`` (n,)."""
        return tuple(self.after(start, q[None]))

    def after(self, start: Array, postures: Array) -> list[tuple[str, str]]:
        """Pairs of links that overlap at postures (m, n) but not at ``start`` (n,), posture by posture."""
        before: set[tuple[str, str]] | None = None
        found: list[tuple[str, str]] = []
        for q in postures:
            if now := self.at(q):
                before = self.at(start) if before is None else before
                found += sorted(now - before)
        return found


def _near(model: pin.Model) -> BoolArray:
    """Which pairs of joints (j, j) are the same, or come within two joints after each other in one chain."""
    parents, each = np.array(model.parents, dtype=int), np.arange(model.njoints)
    near: BoolArray = np.eye(model.njoints, dtype=bool)
    near[parents, each] = True
    near[parents[parents], each] = True
    near |= near.T
    return near


def _moved_by_one(model: pin.Model, one: IntArray, other: IntArray) -> BoolArray:
    """Whether all that moves joints ``one`` (p,) against ``other`` (p,) is a single motor (p,)."""
    supports = np.zeros((model.njoints, model.njoints), dtype=bool)
    motors = np.zeros((model.njoints, model.nv))
    for j, support in enumerate(model.supports):
        supports[j, list(support)] = True
        if j:
            motors[j, model.joints[j].idx_v] = 1.0
    between = (supports[one] ^ supports[other]).astype(float)  # quicker to multiply than integers
    single: BoolArray = ((between @ motors) > 0).sum(axis=1) == 1
    return single
