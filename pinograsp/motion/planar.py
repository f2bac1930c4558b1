"""Planar fingers in closed form: an abduction joint, then parallel flexion joints (Eqs. 1-3).

A finger with several contacts is split at them into sub-manipulators (Fig. 5: 4, 3+1, 2+2, 2+1+1 joints); the
solution of each part places the base of the next. The first joint turns the flexion plane onto the first contact
point (Eq. 1); after that everything is planar, with one (Eq. 2), two (Eq. 3) or three joints per part, the first of
three being sampled around a given angle.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinograsp.contacts import Contact
from pinograsp.errors import InvalidInput
from pinograsp.hands import Finger, HandModel
from pinograsp.spatial import Array, cross

REACHED = 1e-9  # [m] every posture must put its contact points back this close by forward kinematics
_STRAIGHT = 1e-9  # [m, -] how exactly a finger must be planar for the closed form to hold


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AngleSampling:
    """Which angles are tried of a joint that the contact points leave free.

    Attributes:
        reference: joint angles (n_f,) [rad] around which is sampled; joints beyond the last contact keep them.
        spread: half-width [rad]; None: each joint's whole range.
        samples: number of angles.
        lower: joint limits (n_f,) [rad].
        upper: joint limits (n_f,) [rad].
    """

    reference: Array
    spread: float | None
    samples: int
    lower: Array
    upper: Array

    def of(self, joint: int) -> list[float]:
        """Angles of the finger's joint number ``joint`` [rad]."""
        low, high = self.lower[joint], self.upper[joint]
        if self.spread is not None:
            if self.samples == 1:
                return [float(self.reference[joint])]
            low = max(low, self.reference[joint] - self.spread)
            high = min(high, self.reference[joint] + self.spread)
        values: list[float] = np.linspace(low, high, self.samples).tolist()
        return values

    def into(self, joint: int, angle: float) -> float:
        """The angle modulo 2 pi that lies in the joint's range, or nearest to its middle."""
        middle = float(self.lower[joint] + self.upper[joint]) / 2
        return angle + 2 * math.pi * round((middle - angle) / (2 * math.pi))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanarFinger:
    """An abduction joint followed by parallel flexion joints, all in one plane through the abduction axis.

    At q1 the flexion plane is spanned by x1(q1) = Rot(z0, q1) x0 and z0; angles in it run from x1 towards z0.
    Joint k (k >= 2) sits at ``base`` + sum of its predecessors' ``link`` vectors, each turned by the angles so far.
    """

    origin: Array  # (3,) on the abduction axis, world
    x0: Array
    z0: Array
    base: complex  # joint 2 in the plane, as x + i z
    links: tuple[complex, ...]  # joint k to joint k+1 at zero angles, k = 2..; the last one ends at the fingertip
    signs: Array  # +1 where a flexion joint's positive turn runs from x1 towards z0


def planar_finger(hand: HandModel, finger: Finger) -> PlanarFinger | None:
    """The finger's planar geometry, read from the model at zero angles; None where it has no such geometry."""
    if finger.n < 2 or finger.coupled:
        return None
    data = hand.model.createData()
    pin.computeJointJacobians(hand.model, data, hand.resting)
    pin.updateFramePlacements(hand.model, data)
    axes = np.array([data.J[3:, i] for i in finger.dofs])  # world axes; zero for a prismatic joint
    if np.linalg.norm(axes, axis=1).min() < 0.5:
        return None
    points = np.array([data.oMi[j].translation for j in finger.joint_ids])
    tip = data.oMf[hand.frame_id(finger.tip)].translation
    z0, flexion = axes[0], axes[1]
    parallel = np.abs(np.abs(axes[1:] @ flexion) - 1) < _STRAIGHT
    offsets = np.concatenate([points, tip[None]]) - points[0]
    if not (parallel.all() and abs(z0 @ flexion) < _STRAIGHT and np.abs(offsets @ flexion).max() < _STRAIGHT):
        return None
    x0 = cross(z0, flexion)
    plane = [complex(p @ x0, p @ z0) for p in offsets[1:]]
    return PlanarFinger(
        origin=points[0],
        x0=x0,
        z0=z0,
        base=plane[0],
        links=tuple(b - a for a, b in itertools.pairwise(plane)),
        signs=np.sign(axes[1:] @ flexion),
    )


def closed_form(
    hand: HandModel, finger: Finger, planar: PlanarFinger, contacts: Sequence[Contact], sampling: AngleSampling
) -> tuple[list[Array], list[Array]]:
    """Candidates in closed form: base joint by Eq. (1), then the sub-manipulators one after the other.

    Returns:
        Joint angles (n_f,) and contact points (c, 3) in the links' frames of each.
    """
    offsets = np.array([contact.point_o for contact in contacts]) - planar.origin
    y0 = cross(planar.z0, planar.x0)
    first = offsets[0]
    radius = math.hypot(first @ planar.x0, first @ y0)
    if radius < _STRAIGHT:  # on the abduction axis: any angle will do
        bases = [float(sampling.reference[0])]
    else:
        # Eq. (1) gives the angle up to pi: a curled fingertip lies past the knuckle, at negative x1.
        angle = math.atan2(first @ y0, first @ planar.x0)
        bases = [sampling.into(0, angle), sampling.into(0, angle + math.pi)]
    angles, points = [], []
    for q1 in bases:
        x1 = math.cos(q1) * planar.x0 + math.sin(q1) * y0
        across = cross(x1, planar.z0)
        if np.abs(offsets @ across).max() > REACHED / 2:
            continue  # the other contact points are not in this flexion plane
        targets = [complex(p @ x1, p @ planar.z0) for p in offsets]
        for chain, reached in _planar_chain(finger, planar, contacts, targets, sampling):
            q = np.concatenate([[q1], chain])
            points_l = _in_link_frames(hand, finger, contacts, q, reached)
            if points_l is not None:
                angles.append(q)
                points.append(points_l)
    return angles, points


def _planar_chain(
    finger: Finger,
    planar: PlanarFinger,
    contacts: Sequence[Contact],
    targets: Sequence[complex],
    sampling: AngleSampling,
) -> Iterator[tuple[Array, list[float]]]:
    """Yield (flexion angles, contact lengths used) of every branch, working outwards contact by contact.

    A state is the position of the next joint in the plane, the turn accumulated so far, the angles found, and the
    contact lengths; each contact's sub-manipulator extends it, joints beyond the last contact keep the reference.
    """
    states: list[tuple[complex, float, list[float], list[float]]] = [(planar.base, 0.0, [], [])]
    done = 1  # joints 0..done-1 are settled (the abduction joint is)
    for contact, target in zip(contacts, targets):
        last = finger.links.index(contact.link)
        extended = []
        for position, turn, found, lengths in states:
            for chain, length in _sub_manipulator(planar, sampling, done, last, position, turn, target, contact.length):
                at, turned = position, turn
                for j, q in enumerate(chain, start=done):
                    turned += planar.signs[j - 1] * q
                    at += planar.links[j - 1] * complex(math.cos(turned), math.sin(turned))
                extended.append((at, turned, [*found, *chain], [*lengths, length]))
        states, done = extended, last + 1
    for _, _, found, lengths in states:
        yield np.array([*found, *sampling.reference[done:]]), lengths


def _sub_manipulator(
    planar: PlanarFinger,
    sampling: AngleSampling,
    first: int,
    last: int,
    position: complex,
    turn: float,
    target: complex,
    length: float | None,
) -> Iterator[tuple[list[float], float]]:
    """Angles of joints first..last that put the contact on link ``last`` at ``target``: 1, 2 or more joints.

    Yields (angles, contact length); the length is the given one, or what the point asks for where none is given and a
    single joint has no freedom to choose.
    """
    count = last - first + 1
    if count <= 0:
        return
    tip_link = planar.links[last - 1]
    if count == 1:  # Eq. (2): the joint points its link at the contact
        aim = target - position
        reach = abs(aim)
        if (length is not None and abs(reach - length) > REACHED / 2) or reach < _STRAIGHT:
            return
        if length is None and reach > abs(tip_link) * (1 + 1e-9) + REACHED:
            return  # the point lies beyond the end of the link
        q = planar.signs[last - 1] * (np.angle(aim) - np.angle(tip_link) - turn)
        yield [sampling.into(last, q)], reach
        return
    length = abs(tip_link) / 2 if length is None else length
    if count == 2:
        yield from _two_links(planar, sampling, first, position, turn, target, length)
        return
    # Redundant: fix the first joint at its samples, solve the rest.
    for q in sampling.of(first):
        turned = turn + planar.signs[first - 1] * q
        at = position + planar.links[first - 1] * complex(math.cos(turned), math.sin(turned))
        for rest, used in _sub_manipulator(planar, sampling, first + 1, last, at, turned, target, length):
            yield [q, *rest], used


def _two_links(
    planar: PlanarFinger,
    sampling: AngleSampling,
    first: int,
    position: complex,
    turn: float,
    target: complex,
    length: float,
) -> Iterator[tuple[list[float], float]]:
    """Eq. (3): link ``first`` of length l, then the contact at length l_c on the next link. Both branches of asin."""
    link, outer = planar.links[first - 1], planar.links[first]
    aim = (target - position) * complex(math.cos(-turn), math.sin(-turn))  # in the frame before joint ``first``
    x, y, l, r = aim.real, aim.imag, abs(link), abs(aim)
    if r < _STRAIGHT or l < _STRAIGHT:
        return
    sine = (l**2 - length**2 + r**2) / (2 * l * r)
    if abs(sine) > 1 + 1e-12:
        return
    straight = math.asin(max(-1.0, min(1.0, sine)))
    for branch in dict.fromkeys((straight, math.pi - straight)):
        direction = branch - math.atan2(x, y)  # Eq. (3a): angle of link ``first``
        # Eq. (3b) gives sin(q_i) = (y cos - x sin) / l_c; with its cosine the branch is unambiguous.
        bend = math.atan2(
            y * math.cos(direction) - x * math.sin(direction), x * math.cos(direction) + y * math.sin(direction) - l
        )
        q1 = planar.signs[first - 1] * (direction - np.angle(link))
        q2 = planar.signs[first] * (bend - np.angle(outer) + np.angle(link))
        yield [sampling.into(first, q1), sampling.into(first + 1, q2)], length


def _in_link_frames(
    hand: HandModel, finger: Finger, contacts: Sequence[Contact], q_finger: Array, lengths: Sequence[float]
) -> Array | None:
    """Contact points (c, 3) in their joints' frames if forward kinematics confirms them, else None."""
    data = hand.model.createData()
    q = np.array(hand.resting)
    q[finger.dofs] = q_finger
    pin.forwardKinematics(hand.model, data, q)
    points = []
    for contact, length in zip(contacts, lengths):
        i = finger.links.index(contact.link)
        local = length * link_direction(hand, finger, i)
        placed = data.oMi[finger.joint_ids[i]].act(local)
        if np.linalg.norm(placed - contact.point_o) > REACHED:
            return None
        points.append(local)
    return np.array(points)


def link_vector(hand: HandModel, finger: Finger, i: int) -> Array:
    """Link i in its joint's frame (3,) [m]: to the next joint, or the fingertip."""
    if i + 1 < len(finger.links):
        return np.array(hand.model.jointPlacements[finger.joint_ids[i + 1]].translation)
    return np.array(hand.model.frames[hand.frame_id(finger.tip)].placement.translation)


def link_direction(hand: HandModel, finger: Finger, i: int) -> Array:
    """Unit vector along link i in its joint's frame."""
    along = link_vector(hand, finger, i)
    length = np.linalg.norm(along)
    if length == 0:
        raise InvalidInput(
            f"link '{finger.links[i]}' of finger '{finger.name}' has zero length: no contact can lie on it"
        )
    direction: Array = along / length
    return direction


def touching_point(hand: HandModel, finger: Finger, contact: Contact) -> Array:
    """The point (3,) of a contact's link that is to touch, in its joint's frame [m]; half-way where nothing says."""
    if contact.point_l is not None:
        return contact.point_l
    i = finger.links.index(contact.link)
    length = float(np.linalg.norm(link_vector(hand, finger, i)) / 2) if contact.length is None else contact.length
    return link_direction(hand, finger, i) * length
