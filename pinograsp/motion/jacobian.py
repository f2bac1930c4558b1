"""Jacobian of a contact point that is fixed in a link."""

from __future__ import annotations

import pinocchio as pin

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
