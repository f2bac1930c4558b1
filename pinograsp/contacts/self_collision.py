"""Links of a hand that hit each other (coal); pairs whose bounding spheres are apart are not looked at."""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from pinograsp.hands import HandModel
from pinograsp.spatial import Array, BoolArray, IntArray

_TOUCH = 1e-5  # [m] parts that slide along each other, as bars of jaws drawn side by side, overlap by less
_LOOKS = 5  # at a joint, over its range
_BY_DESIGN = 1 / 3  # of the looks: such pairs overlap at 0.47 of them and more in the catalogue's hands, others at 0.24


class SelfCollisions:
    """Which links of a hand overlap at a posture.

    Left out are pairs that the hand's SRDF disables, and what overlaps by design: a link and the next one in its chain,
    links two joints apart that touch over a third of these joints' ranges or more, and bars of a linkage (what one
    motor moves against each other) that do so over its range.
    """

    def __init__(self, hand: HandModel):
        self.hand, self.model, self.data = hand, hand.model, hand.model.createData()
        self.objects = list(hand.geometry.geometryObjects)
        self.overlap = coal.CollisionRequest()
        self.overlap.security_margin = -_TOUCH
        self.joints = np.array([one.parentJoint for one in self.objects], dtype=int)
        for one in self.objects:
            one.geometry.computeLocalAABB()
        self.centres = np.array([one.placement.act(np.array(one.geometry.aabb_center)) for one in self.objects])
        radii = np.array([one.geometry.aabb_radius for one in self.objects])
        self.links = [hand.model.frames[one.parentFrame].name for one in self.objects]
        self.pairs = list_pairs(hand)
        self.reach = radii[self.pairs].sum(axis=1)

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process the pairs are listed anew."""
        return SelfCollisions, (self.hand,)

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
        at = _place(self.data, self.objects, near)
        for b, a in near:
            pair = (self.links[a], self.links[b])
            if pair not in found and _meet(self.objects[a], self.objects[b], at[a], at[b], self.overlap):
                found.add(pair)
        return found

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


@lru_cache(maxsize=8)
def list_pairs(hand: HandModel) -> IntArray:
    """Pairs of the hand's geometry objects (p, 2) that must not overlap."""
    model, objects = hand.model, list(hand.geometry.geometryObjects)
    if not objects:
        return np.zeros((0, 2), dtype=int)
    joints = np.array([one.parentJoint for one in objects], dtype=int)
    links = [model.frames[one.parentFrame].name for one in objects]
    pairs = np.argwhere(np.tril(~_near(model)[np.ix_(joints, joints)], -1))
    few = pairs[_moved_by_few(model, *joints[pairs].T)].tolist()
    left_out = {frozenset(pair) for pair in hand.disabled_collisions}
    left_out |= _overlap_by_design(hand, [pair for pair in few if frozenset(links[i] for i in pair) not in left_out])
    kept = np.array([frozenset(links[i] for i in pair) not in left_out for pair in pairs.tolist()], dtype=bool)
    return np.asarray(pairs[kept])


def _overlap_by_design(hand: HandModel, pairs: list[list[int]]) -> set[frozenset[str]]:
    """Links, by name, that overlap over a third of their ranges, of pairs with one motor or two joints between them.

    Joints at even and at odd places of their chains move apart from each other: so the two of each pair do.
    """
    model, data, objects = hand.model, hand.model.createData(), list(hand.geometry.geometryObjects)
    links = [model.frames[one.parentFrame].name for one in objects]
    odd, touch = np.zeros(model.nv, dtype=bool), coal.CollisionRequest()
    for j, support in enumerate(model.supports):
        if j:
            odd[model.joints[j].idx_v] = len(support) % 2
    overlaps: Counter[frozenset[str]] = Counter()
    looks = list(product(np.linspace(0.0, 1.0, _LOOKS), repeat=2))
    for shares in looks if pairs else ():
        pin.forwardKinematics(model, data, hand.lower + np.where(odd, *shares) * (hand.upper - hand.lower))
        at = _place(data, objects, pairs)
        hits = [(a, b) for a, b in pairs if _meet(objects[a], objects[b], at[a], at[b], touch)]
        overlaps.update({frozenset((links[a], links[b])) for a, b in hits})
    return {names for names, count in overlaps.items() if count >= _BY_DESIGN * len(looks)}


def _place(data: pin.Data, objects: list[pin.GeometryObject], pairs: list[list[int]]) -> dict[int, coal.Transform3s]:
    """Where the objects of these pairs are."""
    poses = {i: data.oMi[objects[i].parentJoint] * objects[i].placement for i in {i for pair in pairs for i in pair}}
    return {i: coal.Transform3s(pose.rotation, pose.translation) for i, pose in poses.items()}


def _meet(
    one: pin.GeometryObject,
    other: pin.GeometryObject,
    there: coal.Transform3s,
    here: coal.Transform3s,
    request: coal.CollisionRequest,
) -> bool:
    shapes = one.geometry, other.geometry
    if any(isinstance(shape, coal.BVHModelBase) for shape in shapes):
        request = coal.CollisionRequest()  # coal knows no margins of meshes
    return bool(coal.collide(shapes[0], there, shapes[1], here, request, coal.CollisionResult()))


def _near(model: pin.Model) -> BoolArray:
    """Which pairs of joints (j, j) are the same, or come after each other in one chain."""
    parents, each = np.array(model.parents, dtype=int), np.arange(model.njoints)
    near: BoolArray = np.eye(model.njoints, dtype=bool)
    near[parents, each] = True
    near |= near.T
    return near


def _moved_by_few(model: pin.Model, one: IntArray, other: IntArray) -> BoolArray:
    """Whether all that moves joints ``one`` (p,) against ``other`` (p,) is one motor, or two joints of a chain (p,)."""
    supports = np.zeros((model.njoints, model.njoints), dtype=bool)
    motors = np.zeros((model.njoints, model.nv))
    for j, support in enumerate(model.supports):
        supports[j, list(support)] = True
        if j:
            motors[j, model.joints[j].idx_v] = 1.0
    between = (supports[one] ^ supports[other]).astype(float)  # quicker to multiply than integers
    single: BoolArray = ((between @ motors) > 0).sum(axis=1) == 1
    parents = np.array(model.parents, dtype=int)
    grand: BoolArray = (parents[parents[one]] == other) | (parents[parents[other]] == one)
    return single | grand
