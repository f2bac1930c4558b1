"""Where a hand touches an object at a posture that is given, as others' grasps are."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear

from pinograsp.checks import array_of, brief, flag, instance_of, number, read_only
from pinograsp.contacts.clearance import Distances, HandPart, check_geometry, parts_of
from pinograsp.contacts.closure import Touch, TouchingHand
from pinograsp.contacts.penetration import ICOSAHEDRON, deepest_of, find_normal
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.errors import GeometryFailed, InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, cross

_TOUCH = 1e-7  # [m] a gap that counts as touching
_SETTLED = 1e-6  # [m] largest gap that ends the settling
_ROUNDS = 12  # of settling
_STEP = 0.1  # [rad or 30 mm] of a joint in a round
_LEVER = 0.03  # [m] that a sliding joint moves for what a turn of 1 rad costs
_LEAST = 1e-3  # weight of the change of posture [rad] against gaps in units of the lever
_NEAR = 1e-9  # [rad or m] beyond a limit that is rounding


class Near(NamedTuple):
    """A part of a link that is near the object: gap [m], inward normal (3,), its own point (3,) in the world [m]."""

    part: HandPart
    gap: float
    normal: Array
    point: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PostureContacts(TouchingHand):
    """Where a hand touches an object at a posture.

    Attributes:
        hand: the hand, in its place.
        object: the object, in its place.
        q: the posture (n,) [rad or m], settled if you asked for that.
        given: the posture that was given (n,).
        touches: one per link, within the tolerance; their ``gap`` is negative inside.
        overlaps: links that are deeper inside than the tolerance, ``{link: depth [m]}``; they do not count as touches.
        self_collisions: pairs of links that overlap.
        residual: largest distance of a finger's touch from the surface, outside or inside [m].
        notes: remarks for the caller.
    """

    hand: HandModel
    object: Body
    q: Array
    given: Array
    touches: tuple[Touch, ...]
    overlaps: dict[str, float]
    self_collisions: tuple[tuple[str, str], ...]
    residual: float
    notes: tuple[str, ...]

    __repr__ = brief("hand", "object", "touches", "overlaps", "residual", "notes")


def contacts_of(
    hand: HandModel, body: Body, q: ArrayLike, *, tolerance: float = 2e-3, settle: bool = False
) -> PostureContacts:
    """Find where the links of ``hand`` touch ``body`` in a posture, or are within a tolerance of it, outside or inside.

    The contact of a link is the point of its surface that is nearest to the object, or deepest in it along the common
    normal of both surfaces.

    Args:
        hand: placed in the world.
        body: placed in the world.
        q: posture (n,) [rad or m]; coupled joints follow.
        tolerance: distance from the surface [m] up to which a link touches.
        settle: change the joints as little as possible (least squares; sliding joints by 30 mm for 1 rad), within their
            limits, so that the fingers' touching links meet the surface; ``residual`` says what cannot be reached.

    Raises:
        InvalidInput: a posture beyond the joints' limits, or a hand without geometry.
        GeometryFailed: a mesh whose distance cannot be computed.
    """
    check_geometry(hand)
    instance_of("body", body, Body)
    given = array_of("q", q, (hand.n,))
    tolerance = number("tolerance", tolerance, at_least=_TOUCH, unit="m")
    flag("settle", settle)
    beyond = (given < hand.lower - _NEAR) | (given > hand.upper + _NEAR)
    if beyond.any():
        raise InvalidInput(
            "q: expected joint positions within their limits, got "
            + ", ".join(f"{hand.joint_names[i]} = {given[i]:.6g}" for i in np.flatnonzero(beyond)[:5])
        )
    posture = _Posture(hand, body)
    near = posture.near(given, tolerance)
    settled = np.array(given)
    if settle:
        settled = posture.settle(given, near, tolerance)
        near = posture.near(settled, tolerance)
    touches = [posture.touch(one) for one in near.values() if one.gap >= -tolerance]
    overlaps = {one.part.link: -one.gap for one in near.values() if one.gap < -tolerance}
    notes = [f"'{touch.link}' touches, but belongs to no finger" for touch in touches if not touch.finger]
    notes += [f"'{link}' is {1e3 * depth:.2g} mm deep in the object" for link, depth in overlaps.items()]
    return PostureContacts(
        hand=hand,
        object=body,
        q=read_only(settled),
        given=given,
        touches=tuple(touches),
        overlaps=overlaps,
        self_collisions=tuple(sorted(SelfCollisions(hand).at(settled))),
        residual=max((abs(touch.gap) for touch in touches if touch.joint_id), default=0.0),
        notes=tuple(notes),
    )


class _Posture:
    """A hand near an object."""

    def __init__(self, hand: HandModel, body: Body):
        self.hand, self.body, self.parts, self.distances = hand, body, parts_of(hand), Distances(hand, body)

    def near(self, q: Array, reach: float) -> dict[tuple[int, str], Near]:
        """What is nearer to the object than ``reach`` [m], or inside it, of each link, by joint and link."""
        self.distances.put(q, self.body)
        found: dict[tuple[int, str], Near] = {}
        for part in self.parts:
            if self.distances.rough(part) > reach:
                continue
            gap, point = self.distances.of(part)
            _, normal = self.distances.surface(point)
            if gap <= _TOUCH:
                depth, normal, surface = self._way_out(part, normal)
                gap, point = -depth, surface + depth * normal
            key = part.joint, part.link
            if gap <= reach and (key not in found or gap < found[key].gap):
                found[key] = Near(part, gap, normal, point)
        return found

    def _way_out(self, part: HandPart, normal: Array) -> tuple[float, Array, Array]:
        """The shortest way out of the object, as of :func:`deepest_of`.

        At an edge, as the rim of a mug, the surfaces have several common normals; from the nearest surface's ``normal``
        the search may end at one along which the part is deeper.
        """
        ways = [deepest_of(self.distances, part, normal)]
        for start in ICOSAHEDRON:
            with suppress(GeometryFailed):  # no way out along this one
                ways.append(deepest_of(self.distances, part, start, deep=ways[0][0]))
        return min(ways, key=lambda way: way[0] - (1e-9 if way is ways[0] else 0.0))

    def settle(self, given: Array, near: dict[tuple[int, str], Near], tolerance: float) -> Array:
        """The posture nearest to the given one at which the fingers' links that are near touch (n,).

        Gauss and Newton's method with the normals and points of each round; links that do not move stay as they are.
        """
        hand, q = self.hand, np.array(given)
        wanted = {key for key, one in near.items() if one.part.finger and key[0] and abs(one.gap) <= tolerance}
        scale = np.where(hand.slides, _LEVER, 1.0)
        for _ in range(_ROUNDS):
            pin.computeJointJacobians(hand.model, self.distances.data)
            rows = np.array([self._rate(one) for key, one in near.items() if key in wanted]).reshape(-1, hand.n)
            gaps = np.array([one.gap for key, one in near.items() if key in wanted])
            if not len(gaps) or np.abs(gaps).max() <= _SETTLED:
                break
            low, high = np.maximum(hand.lower, q - _STEP * scale), np.minimum(hand.upper, q + _STEP * scale)
            A = np.vstack([rows * scale / _LEVER, _LEAST * np.eye(hand.n)])
            b = np.concatenate([(gaps + rows @ q) / _LEVER, _LEAST * given / scale])
            room = np.maximum(high - low, 1e-12)
            scaled = lsq_linear(A, b, bounds=(low / scale, (low + room) / scale), method="bvls").x
            q = np.clip(scaled * scale, hand.lower, hand.upper)
            near = self.near(q, 3 * tolerance)
        return q

    def _rate(self, one: Near) -> Array:
        """How fast a link comes closer to the object for each joint's rate (n,) [m/rad or -]."""
        model, data = self.hand.model, self.distances.data
        J = pin.getJointJacobian(model, data, one.part.joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, self.hand.n)
        arm = one.point - data.oMi[one.part.joint].translation
        rate: Array = one.normal @ J[:3] + cross(arm, one.normal) @ J[3:]
        return rate

    def touch(self, one: Near) -> Touch:
        """The touch of a link that is near, with its patch: as if the object were moved to where it just touches."""
        pose = np.array(self.body.pose)
        pose[:3, 3] -= one.gap * one.normal
        self.distances.put_object(self.body.placed(pose))
        patch = self.distances.patch(one.part, one.point, one.normal)
        _, sharp = find_normal(self.distances, one.part, one.point, one.normal)
        point = patch.mean(axis=0) if len(patch) > 1 else one.point
        local = self.distances.data.oMi[one.part.joint].actInv(point)
        return Touch(
            finger=one.part.finger,
            link=one.part.link,
            joint_id=one.part.joint,
            at=1.0,
            point_o=read_only(point + one.gap * one.normal),
            normal_o=read_only(one.normal),
            gap=one.gap,
            point_l=read_only(local),
            length=float(np.linalg.norm(local)),
            patch_o=read_only(patch + one.gap * one.normal),
            sharp=sharp,
        )
