"""Contact phase: joint angles that put every contact point of a finger in its place at impact (Eqs. 1-3).

A finger with several contacts is split at them into sub-manipulators (Fig. 5: 4, 3+1, 2+2, 2+1+1 joints); the
solution of each part places the base of the next. The first joint turns the flexion plane onto the first contact
point (Eq. 1); after that everything is planar, with one (Eq. 2), two (Eq. 3) or three joints per part, the first of
three being sampled around a given angle. Fingers that are not of this kind are solved numerically from the same
samples.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of, brief, instance_of, integer, mapping_of, number, read_only
from pinograsp.contacts import PALM, Contact, ContactSet
from pinograsp.errors import ContactNotReached, InvalidInput
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.jacobian import point_jacobian

REACHED = 1e-9  # [m] every posture must put its contact points back this close by forward kinematics
MOST_SAMPLES = 10_000  # postures of a redundant joint
_STRAIGHT = 1e-9  # [m, -] how exactly a finger must be planar for the closed form to hold
_LIMIT_SLACK = 1e-9  # [rad] a limit met exactly must survive rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactPostures:
    """All contact-phase solutions of one finger.

    Attributes:
        finger: finger name.
        angles: joint angles (s, n_f) of the s solutions [rad].
        points_l: contact points (c, 3) in the frames of the joints that carry the touching links, per solution
            (s, c, 3) [m].
        method: ``"closed form"`` or ``"numerical"``.
    """

    finger: str
    angles: np.ndarray
    points_l: np.ndarray
    method: str

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PlanarFinger:
    """An abduction joint followed by parallel flexion joints, all in one plane through the abduction axis.

    At q1 the flexion plane is spanned by x1(q1) = Rot(z0, q1) x0 and z0; angles in it run from x1 towards z0.
    Joint k (k >= 2) sits at ``base`` + sum of its predecessors' ``link`` vectors, each turned by the angles so far.
    """

    origin: np.ndarray  # (3,) on the abduction axis, world
    x0: np.ndarray
    z0: np.ndarray
    base: complex  # joint 2 in the plane, as x + i z
    links: tuple[complex, ...]  # joint k to joint k+1 at zero angles, k = 2..; the last one ends at the fingertip
    signs: np.ndarray  # +1 where a flexion joint's positive turn runs from x1 towards z0


def contact_postures(
    hand: HandModel,
    contacts: ContactSet,
    *,
    reference: dict[str, np.ndarray] | None = None,
    spread: float = math.radians(3.0),
    samples: int = 13,
) -> dict[str, ContactPostures]:
    """Every sampled joint posture of every touching finger that reaches its contact points within the joint limits.

    Args:
        hand, contacts: who touches what, where.
        reference: ``{finger: angles (n_f,)}`` [rad]; the redundant joint is sampled around it, joints that no contact
            determines keep it. Without it the redundant joint is sampled over its whole range, undetermined joints
            stay at 0 (or their nearest limit).
        spread: half-width of the sampling around the reference [rad] (the paper's 3 deg).
        samples: number of samples; an odd number includes the reference itself.

    Returns:
        Finger name -> :class:`ContactPostures`, in the order of the contacts.

    Raises:
        ContactNotReached: a finger has no posture, with the nearest miss.
        InvalidInput: a reference for an unknown finger, or of the wrong size.
    """
    instance_of("hand", hand, HandModel)
    instance_of("contacts", contacts, ContactSet)
    spread = number("spread", spread, at_least=0, unit="rad")
    samples = integer("samples", samples, at_least=1, at_most=MOST_SAMPLES)
    reference = {
        name: array_of(f"reference angles of '{name}'", angles, (hand.finger(name).n,))
        for name, angles in mapping_of(
            "reference", {} if reference is None else reference, "{finger: joint angles}"
        ).items()
        if name != PALM
    }
    result = {}
    for finger, which in moving_groups(hand, contacts):
        own = [contacts[i] for i in which]
        if contacts.posture is not None and all(contact.point_l is not None for contact in own):
            result[finger.name] = ContactPostures(
                finger=finger.name,
                angles=read_only(contacts.posture[None, finger.dofs]),
                points_l=read_only([[contact.point_l for contact in own]]),
                method="closing",
            )
        else:
            result[finger.name] = _finger_postures(hand, finger, own, reference.get(finger.name), spread, samples)
    return result


def moving_groups(hand: HandModel, contacts: ContactSet) -> list[tuple[Finger, list[int]]]:
    """Touching fingers with the indices of their contacts; those that share actuators as one; not the palm."""
    groups: list[tuple[list[Finger], list[int]]] = []
    for i, contact in enumerate(contacts):
        if contact.finger == PALM:
            continue
        finger = hand.finger(contact.finger)
        shared = [group for group in groups if any(np.intersect1d(finger.dofs, one.dofs).size for one in group[0])]
        for group in shared:
            groups.remove(group)
        fingers = list(dict.fromkeys([*(one for group in shared for one in group[0]), finger]))
        groups.append((fingers, sorted([*(j for group in shared for j in group[1]), i])))
    return [(_joined(fingers), which) for fingers, which in groups]


def _joined(fingers: list[Finger]) -> Finger:
    """Fingers that share actuators, as one."""
    if len(fingers) == 1:
        return fingers[0]
    parts = dict.fromkeys(part for one in fingers for part in zip(one.joints, one.links, one.joint_ids))
    joints, links, ids = zip(*parts)
    actuated = dict.fromkeys(pair for one in fingers for pair in zip(one.dofs.tolist(), one.actuated))
    return Finger(
        name=" + ".join(one.name for one in fingers),
        joints=joints,
        links=links,
        tip=fingers[0].tip,
        joint_ids=ids,
        dofs=np.array([dof for dof, _ in actuated]),
        actuated=tuple(name for _, name in actuated),
    )


def _finger_postures(hand, finger: Finger, contacts, reference, spread, samples) -> ContactPostures:
    lower, upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
    given = reference is not None
    if not given:  # nothing to sample around: the whole range, in steps of a few degrees
        reference, samples = np.clip(np.zeros(finger.n), lower, upper), max(samples, 61)
    on_axis = all(contact.point_l is None for contact in contacts)
    planar = _planar_finger(hand, finger) if on_axis else None
    if planar is not None:
        angles, points = _closed_form(hand, finger, planar, contacts, reference, spread if given else None, samples)
        method = "closed form"
    else:
        angles, points = _numerical(hand, finger, contacts, reference, spread if given else None, samples)
        method = "numerical"
    if not angles:
        raise ContactNotReached(finger.name, _why(hand, finger, contacts))
    inside = [np.all((q >= lower - _LIMIT_SLACK) & (q <= upper + _LIMIT_SLACK)) for q in angles]
    if not any(inside):
        beyond = [np.maximum(np.maximum(lower - q, q - upper), 0.0) for q in angles]
        nearest = angles[min(range(len(angles)), key=lambda i: (np.sum(beyond[i] > _LIMIT_SLACK), beyond[i].max()))]
        over = [
            f"{joint} at {math.degrees(q):.1f} deg, limits {math.degrees(low):.1f}..{math.degrees(high):.1f}"
            for joint, q, low, high in zip(finger.actuated, nearest, lower, upper)
            if q < low - _LIMIT_SLACK or q > high + _LIMIT_SLACK
        ]
        raise ContactNotReached(
            finger.name, f"only outside its joint limits ({'; '.join(over)}): widen them or move the hand"
        )
    kept = [i for i, ok in enumerate(inside) if ok]
    return ContactPostures(
        finger=finger.name,
        angles=read_only([np.clip(angles[i], lower, upper) for i in kept]),
        points_l=read_only([points[i] for i in kept]),
        method=method,
    )


def _why(hand: HandModel, finger: Finger, contacts: list[Contact]) -> str:
    """The nearest reason that can be told without a posture: distance against the finger's length."""
    base = hand.frame_placements(np.zeros(hand.n), [finger.joints[0]])[0][:3, 3]
    frames = hand.frame_placements(np.zeros(hand.n), [*finger.joints, finger.tip])
    reach = float(np.linalg.norm(np.diff(frames[:, :3, 3], axis=0), axis=1).sum())
    parts = [
        f"{c.link} to {(1e3 * c.point_o).round(2).tolist()} mm, {1e3 * np.linalg.norm(c.point_o - base):.1f} "
        "mm from its base"
        for c in contacts
    ]
    hint = (
        "too far"
        if any(np.linalg.norm(c.point_o - base) > reach for c in contacts)
        else (
            "no joint angles put the points there: with several contacts all of them must lie in the finger's "
            "flexion plane "
            "and at the contact lengths"
            if len(contacts) > 1
            else "outside the workspace of the sampled postures: raise the spread or give another reference"
        )
    )
    return f"{', '.join(parts)}; the finger is {1e3 * reach:.1f} mm long: {hint}"


def _planar_finger(hand: HandModel, finger: Finger) -> _PlanarFinger | None:
    """The finger's planar geometry, read from the model at zero angles; None where it has no such geometry."""
    if finger.n < 2 or finger.coupled:
        return None
    data = hand.model.createData()
    zero = np.zeros(hand.n)
    pin.computeJointJacobians(hand.model, data, zero)
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
    x0 = np.cross(z0, flexion)
    plane = [complex(p @ x0, p @ z0) for p in offsets[1:]]
    return _PlanarFinger(
        origin=points[0],
        x0=x0,
        z0=z0,
        base=plane[0],
        links=tuple(b - a for a, b in itertools.pairwise(plane)),
        signs=np.sign(axes[1:] @ flexion),
    )


def _closed_form(hand, finger, planar: _PlanarFinger, contacts, reference, spread, samples):
    """Candidates in closed form: base joint by Eq. (1), then the sub-manipulators one after the other."""
    offsets = np.array([contact.point_o for contact in contacts]) - planar.origin
    y0 = np.cross(planar.z0, planar.x0)
    first = offsets[0]
    radius = math.hypot(first @ planar.x0, first @ y0)
    lower, upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
    if radius < _STRAIGHT:  # on the abduction axis: any angle will do
        bases = [float(reference[0])]
    else:
        # Eq. (1) gives the angle up to pi: a curled fingertip lies past the knuckle, at negative x1.
        angle = math.atan2(first @ y0, first @ planar.x0)
        bases = [_into(angle, lower[0], upper[0]), _into(angle + math.pi, lower[0], upper[0])]
    angles, points = [], []
    for q1 in bases:
        x1 = math.cos(q1) * planar.x0 + math.sin(q1) * y0
        across = np.cross(x1, planar.z0)
        if np.abs(offsets @ across).max() > REACHED / 2:
            continue  # the other contact points are not in this flexion plane
        targets = [complex(p @ x1, p @ planar.z0) for p in offsets]
        for chain, reached in _planar_chain(
            finger, planar, contacts, targets, reference, spread, samples, lower, upper
        ):
            q = np.concatenate([[q1], chain])
            points_l = _in_link_frames(hand, finger, contacts, q, reached)
            if points_l is not None:
                angles.append(q)
                points.append(points_l)
    return angles, points


def _into(angle: float, lower: float, upper: float) -> float:
    """The angle modulo 2 pi that lies in the range, or nearest to its middle."""
    middle = (lower + upper) / 2
    return angle + 2 * math.pi * round((middle - angle) / (2 * math.pi))


def _planar_chain(finger, planar: _PlanarFinger, contacts, targets, reference, spread, samples, lower, upper):
    """Yield (flexion angles, contact lengths used) of every branch, working outwards contact by contact.

    A state is the position of the next joint in the plane, the turn accumulated so far, the angles found, and the
    contact lengths; each contact's sub-manipulator extends it, joints beyond the last contact keep the reference.
    """
    states = [(planar.base, 0.0, [], [])]
    done = 1  # joints 0..done-1 are settled (the abduction joint is)
    for contact, target in zip(contacts, targets):
        last = finger.links.index(contact.link)
        extended = []
        for position, turn, found, lengths in states:
            for chain, length in _sub_manipulator(
                planar, done, last, position, turn, target, contact.length, reference, spread, samples, lower, upper
            ):
                at, turned = position, turn
                for j, q in enumerate(chain, start=done):
                    turned += planar.signs[j - 1] * q
                    at += planar.links[j - 1] * complex(math.cos(turned), math.sin(turned))
                extended.append((at, turned, [*found, *chain], [*lengths, length]))
        states, done = extended, last + 1
    for _, _, found, lengths in states:
        yield np.array([*found, *reference[done:]]), lengths


def _sub_manipulator(planar, first, last, position, turn, target, length, reference, spread, samples, lower, upper):
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
        yield [_into(q, lower[last], upper[last])], reach
        return
    length = abs(tip_link) / 2 if length is None else length
    if count == 2:
        yield from _two_links(planar, first, position, turn, target, length, lower, upper)
        return
    # Redundant: fix the first joint at samples around its reference (all of its range without one), solve the rest.
    low, high = lower[first], upper[first]
    if spread is not None:
        low, high = max(low, reference[first] - spread), min(high, reference[first] + spread)
    values = [reference[first]] if samples == 1 and spread is not None else np.linspace(low, high, samples)
    for q in values:
        turned = turn + planar.signs[first - 1] * q
        at = position + planar.links[first - 1] * complex(math.cos(turned), math.sin(turned))
        for rest, used in _sub_manipulator(
            planar, first + 1, last, at, turned, target, length, reference, spread, samples, lower, upper
        ):
            yield [q, *rest], used


def _two_links(planar, first, position, turn, target, length, lower, upper):
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
        yield [_into(q1, lower[first], upper[first]), _into(q2, lower[first + 1], upper[first + 1])], length


def _in_link_frames(hand: HandModel, finger: Finger, contacts, q_finger, lengths) -> np.ndarray | None:
    """Contact points (c, 3) in their joints' frames if forward kinematics confirms them, else None."""
    data = hand.model.createData()
    q = np.zeros(hand.n)
    q[finger.dofs] = q_finger
    pin.forwardKinematics(hand.model, data, q)
    points = []
    for contact, length in zip(contacts, lengths):
        i = finger.links.index(contact.link)
        local = length * _link_direction(hand, finger, i)
        placed = data.oMi[finger.joint_ids[i]].act(local)
        if np.linalg.norm(placed - contact.point_o) > REACHED:
            return None
        points.append(local)
    return np.array(points)


def _link_direction(hand: HandModel, finger: Finger, i: int) -> np.ndarray:
    """Unit vector along link i in its joint's frame: towards the next joint, or the fingertip."""
    if i + 1 < len(finger.links):
        along = hand.model.jointPlacements[finger.joint_ids[i + 1]].translation
    else:
        along = hand.model.frames[hand.frame_id(finger.tip)].placement.translation
    length = np.linalg.norm(along)
    if length == 0:
        raise InvalidInput(
            f"link '{finger.links[i]}' of finger '{finger.name}' has zero length: no contact can lie on it"
        )
    return along / length


def _numerical(hand: HandModel, finger: Finger, contacts, reference, spread, samples):
    """Damped Newton iterations on all contact points from sampled starts, for fingers without the planar geometry."""
    lengths = []
    for contact in contacts:
        i = finger.links.index(contact.link)
        if contact.length is None and i + 1 < len(finger.links):
            lengths.append(np.linalg.norm(hand.model.jointPlacements[finger.joint_ids[i + 1]].translation) / 2)
        else:
            lengths.append(contact.length)
    locals_ = [
        l * _link_direction(hand, finger, finger.links.index(c.link)) if c.point_l is None else c.point_l
        for c, l in zip(contacts, lengths)
    ]
    lower, upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
    sampled = min(1, finger.n - 1)
    around = np.linspace(-spread, spread, samples) if spread is not None and samples > 1 else [0.0]
    starts = [reference + np.eye(finger.n)[sampled] * offset for offset in around]
    if spread is None:
        starts += list(np.random.default_rng(0).uniform(lower, upper, (4 * samples, finger.n)))
    model, data, q = hand.model, hand.model.createData(), np.zeros(hand.n)
    angles, points = [], []
    for start in starts:
        q[finger.dofs] = np.clip(start, lower, upper)
        for _ in range(100):
            pin.computeJointJacobians(model, data, q)
            error, rows = [], []
            for contact, local in zip(contacts, locals_):
                joint = finger.joint_of(contact.link)
                error.append(contact.point_o - data.oMi[joint].act(local))
                rows.append(point_jacobian(model, data, joint, local)[:, finger.dofs])
            error, J = np.concatenate(error), np.concatenate(rows)
            if np.linalg.norm(error) < REACHED / 10:
                break
            damping = 1e-3 * min(1.0, np.linalg.norm(error) / 0.01)  # vanishes with the error: quadratic at the end
            # By singular values: contacts may ask for more than the joints can give, and joints may move no contact.
            U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
            gains = np.divide(sigma, sigma**2 + damping**2, out=np.zeros_like(sigma), where=sigma > 1e-9 * sigma[0])
            step = Vt.T @ (gains * (U.T @ error))
            q[finger.dofs] = np.clip(
                q[finger.dofs] + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12)), lower, upper
            )
        found = q[finger.dofs].copy()
        new = all(np.abs(found - other).max() > 1e-6 for other in angles)
        if np.linalg.norm(error) < REACHED and new:
            angles.append(found)
            points.append(np.array(locals_))
    return angles, points
