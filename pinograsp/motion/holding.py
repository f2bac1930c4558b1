"""How stiffly a hand holds an object: its servos, its contacts, and what the squeeze adds."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.actuation import CompliantHand, ObjectStiffness, contact_stiffness, object_stiffness
from pinograsp.contacts import ContactSet
from pinograsp.contacts.edges import on_edges
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem
from pinograsp.hands import HandModel
from pinograsp.motion.jacobian import contact_jacobians
from pinograsp.motion.torques import preload_slope
from pinograsp.spatial import Array

AWAY = 2e-3  # [m] by which the object may give way to the push of a reserve
TILTED = float(np.radians(5.0))  # [rad] by which its weight may turn the object once only the hand holds it
_FINGERTIP = 0.008  # [m] radius of curvature of links where they touch


def compliant_hand(
    hand: HandModel, contacts: ContactSet, q: Array, gains: Array, depth: ArrayLike = 0.0
) -> CompliantHand:
    """The hand at ``q`` (n,), closed to depths (k,) [m], with servos of ``gains`` (n,) at its joints."""
    data = hand.model.createData()
    pin.computeJointJacobians(hand.model, data, q)
    jacobians = contact_jacobians(hand, contacts, data, depth)
    return CompliantHand.at(contacts, jacobians, gains=gains)


def held_stiffness(
    hand: HandModel, problem: ForceProblem, forces_c: Array, q: Array, gains: Array, depth: ArrayLike = 0.0
) -> ObjectStiffness:
    """Stiffness of the object in a hand at ``q`` (n,) with servos of ``gains`` (n,), under contact forces (k, 3) [N].

    Links that touch at several corners are flat there, others are round; the object is as curved as it is.
    """
    contacts = problem.contacts
    stiff = contact_stiffness(problem.compliance, forces_c[:, 2])
    forces_o = np.einsum("kxc,kc->kx", contacts.rotations_oc, forces_c)
    own, other = _curvatures(problem)
    return object_stiffness(
        contacts.G,
        stiff,
        compliant_hand(hand, contacts, q, gains, depth),
        forces_c,
        object_curvature=own,
        hand_curvature=other,
        torsional_stiffness=problem.friction.torsion**2 * stiff.diagonal()[2::3],
        joint_preload=preload_slope(hand, contacts, q, forces_o, depth=depth),
    )


def push_away(held: ObjectStiffness, push: float) -> float:
    """How far a push [N] on the centre of mass moves the object [m], in the worst direction; infinity: it leaves."""
    if not held.is_stable():
        return np.inf
    return push * float(np.linalg.norm(np.linalg.pinv(held.matrix)[:3, :3], 2))


def find_tilt(held: ObjectStiffness, load: Array) -> float:
    """How far a load (6,) [N, N m] turns the object [rad]; infinity: it leaves."""
    if not held.is_stable():
        return np.inf
    return float(np.linalg.norm((np.linalg.pinv(held.matrix) @ load)[3:]))


def _curvatures(problem: ForceProblem) -> tuple[Array, Array]:
    """Of the object and of the links at the contacts (k,) [1/m]."""
    contacts, body = problem.contacts, problem.object
    links = [contact.link for contact in contacts]
    rounded = np.array([links.count(link) == 1 for link in links])
    own, other = np.full(len(links), np.inf), np.where(rounded, 1.0 / _FINGERTIP, 0.0)
    if body is not None:
        rounded &= ~on_edges(body, contacts)
    own[rounded] = 0.0
    if body is not None and rounded.any():
        with suppress(InvalidInput):  # an edge too near for a curvature
            own[rounded] = body.curvature(contacts.points_o[rounded])[0].mean(axis=1)
    # In a hollow that is narrower than the link the two touch at more than a point: flat on flat.
    narrow = own + other <= 0
    own[narrow], other[narrow] = np.inf, 0.0
    return own, other
