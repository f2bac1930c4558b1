"""Jacobians of contact points that are fixed in links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.contacts import PALM, ContactSet
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.spatial import Array, skew


def point_jacobian(model: pin.Model, data: pin.Data, joint: int, point_l: Array) -> Array:
    """Jacobian (3, n) of the linear velocity, world axes, of a point (3,) fixed in a joint's frame [m].

    Needs ``pin.computeJointJacobians`` at the current q. Pinocchio gives the joint frame's Jacobian
    (``LOCAL_WORLD_ALIGNED``); the point's differs by the lever arm.
    """
    return contact_jacobian(model, data, joint, point_l)[:3]


def contact_jacobian(model: pin.Model, data: pin.Data, joint: int, point_l: Array) -> Array:
    """Jacobian (6, n), world axes, of a point (3,) fixed in a joint's frame [m]: linear, then angular velocity."""
    # Pinocchio's has the shape (6,) where nv is 1.
    J: Array = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
    arm = data.oMi[joint].rotation @ point_l
    J[:3] -= skew(arm) @ J[3:]
    return J


def point_jacobians(model: pin.Model, data: pin.Data, joints: Sequence[int], points_o: Array) -> Array:
    """Jacobians (k, 6, n), world axes, of points (k, 3) in the world [m], each fixed in a joint's link: linear first.

    Needs ``pin.computeJointJacobians`` at the current q. Points of the palm, joint 0, do not move.
    """
    own = {0: np.zeros((6, model.nv))}
    for joint in joints:
        if joint not in own:
            own[joint] = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, model.nv)
    found = np.array([own[joint] for joint in joints]).reshape(-1, 6, model.nv)
    # Pinocchio's are of the point of the link that is at the origin.
    found[:, :3] -= skew(points_o) @ found[:, 3:]
    return found


def contact_jacobians(hand: HandModel, contacts: ContactSet, data: pin.Data, depth: ArrayLike = 0.0) -> Array:
    """Jacobians (k, 6, n), world axes, of all contact points, each as a point of its link; the palm's are zero.

    Needs ``pin.computeJointJacobians`` at the current q. The points are pressed in by ``depth`` (k,) [m] there.

    Raises:
        InvalidInput: contacts that were made without a hand.
    """
    found = np.zeros((len(contacts), 6, hand.n))
    for i, (joint, point) in enumerate(contact_points(hand, contacts, data, depth)):
        if joint:  # the palm does not move
            found[i] = contact_jacobian(hand.model, data, joint, point)
    return found


def contact_points(
    hand: HandModel, contacts: ContactSet, data: pin.Data, depth: ArrayLike = 0.0
) -> list[tuple[int, Array]]:
    """The joint of each contact's link, 0 for the palm, and the contact point (3,) in its frame [m], pressed in by
    ``depth`` (k,) [m].

    Needs the joints' placements at the current q.

    Raises:
        InvalidInput: contacts that were made without a hand.
    """
    points = []
    for contact, pressed in zip(contacts, np.broadcast_to(depth, len(contacts))):
        if not contact.link:
            raise InvalidInput("contacts: expected those of a hand; these were made without one (hand=None)")
        joint = 0 if contact.finger == PALM else hand.finger(contact.finger).joint_of(contact.link)
        points.append((joint, data.oMi[joint].actInv(contact.point_o + pressed * contact.normal_o)))
    return points
