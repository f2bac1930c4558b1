"""How deep a hand's links are in an object: where the surfaces have a common normal, however the links have turned.

A link that presses also turns, so the point of it that touched first is not the deepest for long: it rolls. Two smooth
bodies overlap most along the common normal of their surfaces. To find it, the object is moved off along the normal
known so far until it is clear by a millimetre; there the nearest points of both are exact (coal), and their direction
is the next guess.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import coal
import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, instance_of, read_only
from pinograsp.contacts.clearance import PALM, Distances, HandPart
from pinograsp.contacts.contact_set import Contact, ContactSet
from pinograsp.contacts.edges import ASIDE, TURNED, turns_nearby
from pinograsp.errors import ContactNotReached, GeometryFailed, InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, IntArray

_CLEAR = 1e-3  # [m] how far the object is moved off: the direction between nearest points keeps its digits
_FAR = 0.05  # [m] off the object
_ALIKE = 1e-7  # [rad] normals this close are the same
# [rad] ... and for depths these, where they come no closer: of curved bodies coal's nearest points are often no better.
# A depth changes with the square of it, by less than 1e-10 m; the points, by a micrometre.
_ROUGHLY = 1e-4
_ROUNDS = 20
_REACHED = 1e-9  # [m]
_STEPS, _PROBE, _LARGEST = 60, 1e-6, 0.3  # Newton steps; finite difference and largest step [rad or m]
# Unit vectors (12, 3) to its corners: directions in which to look for a way out of an object.
ICOSAHEDRON = read_only(
    np.array([np.roll([0, i, j * 1.618034], k) / 1.902113 for i in (1, -1) for j in (1, -1) for k in range(3)])
)
_RANK = 1e-2  # singular values of the Jacobian below this share of the largest: steps along them are noise


class Penetration:
    """Depths of the contacts of a closed hand (those with a posture) in the object, at any posture.

    ``points``: whether the points are wanted as exactly as the depths.
    """

    def __init__(self, hand: HandModel, body: Body, contacts: ContactSet, *, points: bool = False):
        self.hand, self.body, self.contacts = hand, body, contacts
        self.roughly = 0.0 if points else _ROUGHLY
        self.distances = Distances(hand, body)
        joints = [self._joint(contact) for contact in contacts]
        own = set(joints)
        parts = [HandPart(hand, one, {}) for one in hand.geometry.geometryObjects if one.parentJoint in own]
        # Corners of a flat area are points of the link; where one point touches, the surface around it counts.
        self.corner = [joints.count(joint) > 1 for joint in joints]
        self.parts = [[part for part in parts if part.joint == joint] for joint in joints]
        if contacts.posture is not None:
            self.distances.put(contacts.posture)
            touching = [[part for part in own if self.distances.rough(part) < _CLEAR] for own in self.parts]
            self.parts = [near or own for near, own in zip(touching, self.parts)]
        self.joints = joints
        self.normals = np.array([contact.normal_o for contact in contacts])

    def _joint(self, contact: Contact) -> int:
        return 0 if contact.finger == PALM else self.hand.finger(contact.finger).joint_of(contact.link)

    def at(
        self, q: Array, which: Iterable[int] | None = None, near: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        """Depths (c,) [m], negative where clear, inward normals (c, 3), and points on the object's surface (c, 3) [m].

        ``which`` contacts; default: all. ``near``: normals (k, 3) and depths (k,) of all contacts to start from; None:
        the contacts' normals.
        """
        self.distances.put(q)
        from_normals, from_depths = (self.normals, np.full(len(self.contacts), _CLEAR)) if near is None else near
        chosen = range(len(self.contacts)) if which is None else which
        found = [self._one(i, from_normals[i], float(from_depths[i])) for i in chosen]
        depths, normals, points = zip(*found)
        return np.array(depths), np.array(normals), np.array(points)

    def _one(self, i: int, near: Array, deep: float) -> tuple[float, Array, Array]:
        if self.corner[i]:
            point = self.distances.data.oMi[self.joints[i]].act(np.array(self.contacts[i].point_l))
            # Of the plane they touched, not of the nearest surface: at an edge of the object that may be another face.
            normal = self.normals[i]
            depth = float((point - self.contacts[i].point_o) @ normal)
            return depth, normal, point - depth * normal
        return max(
            (deepest_of(self.distances, part, near, self.roughly, deep) for part in self.parts[i]),
            key=lambda one: one[0],
        )


def deepest_of(
    distances: Distances, part: HandPart, normal: Array, roughly: float = _ROUGHLY, deep: float = _CLEAR
) -> tuple[float, Array, Array]:
    """Depth of a part in the object [m], negative where clear, inward normal (3,), and point on the object (3,) [m].

    Args:
        distances: at the posture.
        part: of the hand.
        normal: where to start from (3,).
        roughly: normals that come no closer may differ by this [rad]; 0: go on as long as they do.
        deep: about how deep it is [m].

    Raises:
        GeometryFailed: the object cannot be moved off along the normals found.
    """
    how = np.array([_CLEAR, _FAR, _ALIKE, roughly, deep])
    if (found := distances.find_depth(part, np.ascontiguousarray(normal, dtype=float), how, _ROUNDS)) is not None:
        return found
    off, further, turned = _CLEAR + max(deep, 0.0), _CLEAR, math.inf
    mine_at, moved, geometry = distances.locate(part), coal.Transform3s(distances.pose), part.geometry
    # Three numbers at a time are quicker as floats than as arrays.
    hx, hy, hz = distances.pose.getTranslation().tolist()
    x, y, z = normal.tolist()
    last: tuple[float, float, float, float] | None = None
    for _ in range(_ROUNDS):
        moved.setTranslation(np.array((hx + off * x, hy + off * y, hz + off * z)))
        gap, mine = distances.placed_at(part, mine_at, moved, geometry)
        if gap < 0.5 * _CLEAR:  # deeper than thought
            # Coal's own depth is rough, often next to nothing deep inside: each time twice as far.
            off += further + min(max(-gap, 0.0), 10 * _CLEAR)
            further *= 2
            continue
        further = _CLEAR
        mx, my, mz = mine.tolist()
        ox, oy, oz = distances.result.getNearestPoint2().tolist()
        dx, dy, dz = ox - mx, oy - my, oz - mz  # along the next normal, gap long
        # Farther off than need be, the nearest points are others than those that overlap.
        spare = gap - _CLEAR
        before, turned = turned, math.hypot(dx / gap - x, dy / gap - y, dz / gap - z)
        # As quickly as they came closer, the next ones would be the same.
        settled = turned < roughly and turned * turned < _ALIKE * before < math.inf
        alike = turned < _ALIKE or settled or 0.5 * before < turned < roughly
        last = off - (dx * x + dy * y + dz * z), ox - off * x, oy - off * y, oz - off * z
        # Far off, its place as it is tells: bringing the object closer may go round the part.
        if alike and (abs(spare) <= 0.5 * _CLEAR or (off == 0.0 and spare > 0)):
            break
        x, y, z, off = dx / gap, dy / gap, dz / gap, off - spare if off - spare > -_FAR else 0.0
    if last is None:
        raise GeometryFailed(part.link, type(part.geometry).__name__)
    return last[0], np.array((x, y, z)), np.array(last[1:])


def find_normal(distances: Distances, part: HandPart, point: Array, normal: Array) -> tuple[Array, bool]:
    """Inward normal (3,) of a part that touches the object, common to both, and whether it is sharp there.

    Where the object's surface is smooth, ``normal`` is its own. On an edge it is that of the part's surface, which is
    sharp where the object's moving a millimetre aside turns it by more than an edge does.

    Args:
        distances: at the posture, with the object where it just touches.
        part: of the hand.
        point: of the part that touches (3,) [m].
        normal: the object's own inward normal there (3,).
    """
    body = distances.body
    if not turns_nearby(body, point[None], normal[None])[0]:
        return normal, False
    try:
        _, common, _ = deepest_of(distances, part, normal)
        across = tangents(common[None])[0].T
        for step in ASIDE * np.concatenate([across, -across]):
            distances.put_object(body.moved(step, np.eye(3)))
            _, turned, _ = deepest_of(distances, part, common)
            if turned @ common < np.cos(TURNED):
                return common, True
        return common, False
    except GeometryFailed:
        return normal, True
    finally:
        distances.put_object(body)


def touching(hand: HandModel, body: Body, contacts: ContactSet, posture: ArrayLike) -> ContactSet:
    """Return the contacts with the posture in which the links' surfaces, not their ends, touch ``body`` at the given
    points.

    Args:
        hand: as for :func:`contacts_at`.
        body: as for :func:`contacts_at`.
        contacts: one per link.
        posture: q (n,) [rad] near which to search.

    Returns:
        The contacts at the points of the object's surface nearest to the given ones, each with its link's point; the
        posture.

    Raises:
        ContactNotReached: no such posture exists within the joint limits near the given one.
        InvalidInput: several contacts on one link.
    """
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body)
    instance_of("contacts", contacts, ContactSet)
    q: Array = np.clip(array_of("posture", posture, (hand.n,)), hand.lower, hand.upper)
    depth = Penetration(hand, body, contacts, points=True)
    if any(depth.corner):
        raise InvalidInput(
            "touching: expected one contact point per link: a surface touches a smooth object in one point"
        )
    by_finger: dict[str, list[int]] = {}
    for i, contact in enumerate(contacts):
        by_finger.setdefault(contact.finger, []).append(i)
    goals, _, _ = body.project(contacts.points_o)
    for name, which in by_finger.items():
        dofs = hand.finger(name).dofs
        q[dofs] = _touching_angles(depth, name, which, goals[which], q)
    depth.distances.put(q)
    moved = []
    for contact, joint, goal in zip(contacts, depth.joints, goals):
        local = depth.distances.data.oMi[joint].actInv(goal)
        moved.append(
            replace(
                contact,
                point_o=read_only(goal),
                distance=0.0,
                point_l=read_only(local),
                length=float(np.linalg.norm(local)),
            )
        )
    return ContactSet(contacts=tuple(moved), com_o=contacts.com_o, posture=read_only(q))


def _touching_angles(depth: Penetration, name: str, which: Sequence[int], goals: Array, q: Array) -> Array:
    """Angles (n_f,) at which a finger's surfaces touch at ``goals`` (c, 3), by Newton's method from the posture q."""
    hand, q, left = depth.hand, q.copy(), np.full(1, np.inf)
    dofs = hand.finger(name).dofs

    def miss(angles: Array) -> Array:
        q[dofs] = angles
        try:
            depths, normals, points = depth.at(q, which)
        except GeometryFailed:  # deep inside each other
            return np.full(3 * len(which), np.inf)
        return (points - goals + depths[:, None] * normals).ravel()

    low, high = hand.lower[dofs], hand.upper[dofs]
    angles: Array = q[dofs]
    for _ in range(_STEPS):
        left = miss(angles)
        if np.abs(left).max() < _REACHED:
            return angles
        if not np.isfinite(left).all():
            raise ContactNotReached(name, "from this posture the search runs deep into the object: give another one")
        probes = np.where(angles + _PROBE > high, -_PROBE, _PROBE)
        J = np.array([(miss(angles + p * e) - left) / p for p, e in zip(probes, np.eye(dofs.size))]).T
        angles = np.clip(angles + _newton_step(J, left, angles, low, high), low, high)
    raise ContactNotReached(
        name,
        f"no posture near the given one has its surface at the contact points; {1e3 * np.abs(left).max():.3g} mm "
        f"remain{_at_limits(hand, dofs, angles)}: give another posture or other points",
    )


def _newton_step(J: Array, left: Array, angles: Array, low: Array, high: Array) -> Array:
    """The step (n_f,) that takes ``left`` away; a joint at its limit stays there, the others do the rest."""
    free = np.ones(angles.size, dtype=bool)
    while True:
        step = np.zeros(angles.size)
        step[free] = np.linalg.lstsq(J[:, free], -left, rcond=_RANK)[0]
        step *= min(1.0, _LARGEST / max(np.abs(step).max(), 1e-12))
        beyond = free & (((angles + step > high) & (angles >= high)) | ((angles + step < low) & (angles <= low)))
        if not beyond.any():
            return step
        free &= ~beyond


def _at_limits(hand: HandModel, dofs: IntArray, angles: Array) -> str:
    """The joints that would go beyond their limits, in words."""
    stuck = []
    for i, angle in zip(dofs.tolist(), angles.tolist()):
        if angle in (hand.lower[i], hand.upper[i]):
            name = hand.joint_names[i]
            slides = hand.is_prismatic(hand.model.getJointId(name))
            stuck.append(f"{name} at " + (f"{1e3 * angle:.1f} mm" if slides else f"{np.degrees(angle):.1f} deg"))
    return f", with joints at their limits ({', '.join(stuck)})" if stuck else ""
