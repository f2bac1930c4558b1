"""Contact phase: joint angles that put every contact point of a finger in its place at impact (Eqs. 1-3).

Planar fingers are solved in closed form; all others numerically, from the same samples of a redundant joint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, frozen, instance_of, integer, mapping_of, number
from pinograsp.contacts import PALM, Contact, ContactSet
from pinograsp.errors import ContactNotReached
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.jacobian import point_jacobian
from pinograsp.motion.planar import REACHED, AngleSampling, closed_form, planar_finger, touching_point
from pinograsp.spatial import Array
from pinograsp.words import format_fixed

MOST_SAMPLES = 10_000  # postures of a redundant joint
_LIMIT_SLACK = 1e-9  # [rad] a limit met exactly must survive rounding
_NEWTON_STEPS = 100


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactPostures:
    """All contact-phase solutions of one finger.

    Attributes:
        finger: finger name.
        angles: joint angles (s, n_f) of the s solutions [rad].
        points_l: contact points (c, 3) in the frames of the joints that carry the touching links, per solution
            (s, c, 3) [m].
        method: ``"closed form"``, ``"numerical"``, or ``"closing"`` for a closed hand.
    """

    finger: str
    angles: Array
    points_l: Array
    method: Literal["closed form", "numerical", "closing"]

    __repr__ = brief()


def contact_postures(
    hand: HandModel,
    contacts: ContactSet,
    *,
    reference: Mapping[str, ArrayLike] | None = None,
    spread: float = math.radians(3.0),
    samples: int = 13,
) -> dict[str, ContactPostures]:
    """Find every sampled joint posture of every touching finger that reaches its contact points within the joint
    limits.

    Args:
        hand: the hand.
        contacts: which of its links touch, and where.
        reference: ``{finger: angles (n_f,)}`` [rad]; the redundant joint is sampled around it, joints that no contact
            determines keep it. Without it the redundant joint is sampled over its whole range, undetermined joints
            stay at 0 (or their nearest limit).
        spread: half-width of the sampling around the reference [rad] (the paper's 3 deg).
        samples: number of samples; an odd number includes the reference itself.

    Returns:
        Finger name -> :class:`ContactPostures`, in the order of the contacts.

    Raises:
        ContactNotReached: a finger has no posture; the message gives the nearest miss.
        InvalidInput: a reference for an unknown finger, or of the wrong size.
    """
    instance_of("hand", hand, HandModel)
    instance_of("contacts", contacts, ContactSet)
    spread = number("spread", spread, at_least=0, unit="rad")
    samples = integer("samples", samples, at_least=1, at_most=MOST_SAMPLES)
    given = mapping_of("reference", {} if reference is None else reference, "{finger: joint angles}")
    references = {
        name: array_of(f"reference angles of '{name}'", angles, (hand.finger(name).n,))
        for name, angles in given.items()
        if name != PALM
    }
    postures = find_postures(hand, contacts, references, spread, samples)
    for found in postures.values():
        frozen(found.angles)
        frozen(found.points_l)
    return postures


def find_postures(
    hand: HandModel, contacts: ContactSet, references: Mapping[str, Array], spread: float, samples: int
) -> dict[str, ContactPostures]:
    """As :func:`contact_postures`, of arguments that are known to be sound."""
    result = {}
    for finger, which in moving_groups(hand, contacts):
        own = [contacts[i] for i in which]
        points = [contact.point_l for contact in own if contact.point_l is not None]
        if contacts.posture is not None and len(points) == len(own):
            result[finger.name] = ContactPostures(
                finger=finger.name,
                angles=contacts.posture[None, finger.dofs],
                points_l=np.array([points]),
                method="closing",
            )
        else:
            result[finger.name] = _finger_postures(hand, finger, own, references.get(finger.name), spread, samples)
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
    return [(_join_fingers(fingers), which) for fingers, which in groups]


def _join_fingers(fingers: list[Finger]) -> Finger:
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


def _finger_postures(
    hand: HandModel,
    finger: Finger,
    contacts: Sequence[Contact],
    reference: Array | None,
    spread: float,
    samples: int,
) -> ContactPostures:
    lower, upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
    if reference is None:  # nothing to sample around: the whole range, in steps of a few degrees
        reference = np.clip(np.zeros(finger.n), lower, upper)
        sampling = AngleSampling(reference=reference, spread=None, samples=max(samples, 61), lower=lower, upper=upper)
    else:
        sampling = AngleSampling(reference=reference, spread=spread, samples=samples, lower=lower, upper=upper)
    on_axis = all(contact.point_l is None for contact in contacts)
    planar = planar_finger(hand, finger) if on_axis else None
    if planar is not None:
        angles, points = closed_form(hand, finger, planar, contacts, sampling)
    else:
        points_l = np.array([touching_point(hand, finger, contact) for contact in contacts])
        angles = _numerical(hand, finger, contacts, points_l, sampling)
        points = [points_l] * len(angles)
    kept = [i for i, q in enumerate(angles) if np.all((q >= lower - _LIMIT_SLACK) & (q <= upper + _LIMIT_SLACK))]
    if not kept:
        why = _beyond_limits(finger, angles, lower, upper) if angles else _why(hand, finger, contacts)
        raise ContactNotReached(finger.name, why)
    return ContactPostures(
        finger=finger.name,
        angles=np.array([np.clip(angles[i], lower, upper) for i in kept]),
        points_l=np.array([points[i] for i in kept]),
        method="numerical" if planar is None else "closed form",
    )


def _beyond_limits(finger: Finger, angles: Sequence[Array], lower: Array, upper: Array) -> str:
    """Which joints are beyond their limits, in the solution (n_f,) that is nearest to them."""
    beyond = [np.maximum(np.maximum(lower - q, q - upper), 0.0) for q in angles]
    nearest = angles[min(range(len(angles)), key=lambda i: (np.sum(beyond[i] > _LIMIT_SLACK), beyond[i].max()))]

    def degrees(angle: float) -> str:
        return format_fixed(math.degrees(angle), 1)

    over = [
        f"{joint} at {degrees(q)} deg, limits {degrees(low)}..{degrees(high)}"
        for joint, q, low, high in zip(finger.actuated, nearest, lower, upper)
        if q < low - _LIMIT_SLACK or q > high + _LIMIT_SLACK
    ]
    return f"only outside its joint limits ({'; '.join(over)}): widen them or move the hand"


def _why(hand: HandModel, finger: Finger, contacts: Sequence[Contact]) -> str:
    """The most likely reason why no posture was found, from the distances and the finger's length."""
    base = hand.frame_placements(hand.resting, [finger.joints[0]])[0][:3, 3]
    frames = hand.frame_placements(hand.resting, [*finger.joints, finger.tip])
    reach = float(np.linalg.norm(np.diff(frames[:, :3, 3], axis=0), axis=1).sum())
    parts = [
        f"{c.link} to {(1e3 * c.point_o).round(2).tolist()} mm, {1e3 * np.linalg.norm(c.point_o - base):.1f} "
        "mm from its base"
        for c in contacts
    ]
    if any(np.linalg.norm(c.point_o - base) > reach for c in contacts):
        hint = "too far"
    elif len(contacts) > 1:
        hint = (
            "no joint angles put the points there: with several contacts all of them must lie in the finger's flexion "
            "plane and at the contact lengths"
        )
    else:
        hint = "outside the workspace of the sampled postures: raise the spread, or give another reference"
    return f"{', '.join(parts)}; the finger is {1e3 * reach:.1f} mm long: {hint}"


def _numerical(
    hand: HandModel, finger: Finger, contacts: Sequence[Contact], points_l: Array, sampling: AngleSampling
) -> list[Array]:
    """Damped Newton iterations on all contact points from sampled starts, for fingers without the planar geometry.

    ``points_l``: contact points (c, 3) in the links' frames. Returns the joint angles (n_f,) of each solution.
    """
    spread, samples = sampling.spread, sampling.samples
    sampled = min(1, finger.n - 1)
    around = np.linspace(-spread, spread, samples) if spread is not None and samples > 1 else np.zeros(1)
    starts = [sampling.reference + np.eye(finger.n)[sampled] * offset for offset in around]
    if spread is None:
        starts += list(np.random.default_rng(0).uniform(sampling.lower, sampling.upper, (4 * samples, finger.n)))
    angles: list[Array] = []
    for start in starts:
        found = _newton(hand, finger, contacts, points_l, np.clip(start, sampling.lower, sampling.upper))
        if found is not None and all(np.abs(found - other).max() > 1e-6 for other in angles):
            angles.append(found)
    return angles


def _newton(
    hand: HandModel, finger: Finger, contacts: Sequence[Contact], points_l: Array, start: Array
) -> Array | None:
    """Joint angles (n_f,) at which the links' points (c, 3) are at the contacts, from ``start``; None: not found."""
    model, data, q, distance = hand.model, hand.model.createData(), np.array(hand.resting), np.inf
    lower, upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
    joints = [finger.joint_of(contact.link) for contact in contacts]
    targets = np.array([contact.point_o for contact in contacts])
    q[finger.dofs] = start
    for _ in range(_NEWTON_STEPS):
        pin.computeJointJacobians(model, data, q)
        error = np.concatenate([goal - data.oMi[j].act(p) for goal, j, p in zip(targets, joints, points_l)])
        distance = float(np.linalg.norm(error))
        if distance < REACHED / 10:
            break
        J = np.concatenate([point_jacobian(model, data, j, p)[:, finger.dofs] for j, p in zip(joints, points_l)])
        damping = 1e-3 * min(1.0, distance / 0.01)  # vanishes with the error: quadratic at the end
        # By singular values: contacts may ask for more than the joints can give, and joints may move no contact.
        U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
        gains = np.divide(sigma, sigma**2 + damping**2, out=np.zeros_like(sigma), where=sigma > 1e-9 * sigma[0])
        step = Vt.T @ (gains * (U.T @ error))
        q[finger.dofs] = np.clip(q[finger.dofs] + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12)), lower, upper)
    return np.array(q[finger.dofs]) if distance < REACHED else None
