"""Where the fingers press, from the tree and the geometry: centres of links, and the ends of fingers."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from pinograsp.checks import instance_of, integer
from pinograsp.contacts.clearance import locate_for_coal
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.spatial import Array

_FAR = 1e3  # [m] farther off than any part of a hand


def link_centre(hand: HandModel, data: pin.Data, joint: int) -> Array:
    """Return the centre of the geometry that a joint carries (3,) in the world [m]; its origin if it carries none."""
    instance_of("hand", hand, HandModel)
    instance_of("data", data, pin.Data)
    joint = integer("joint", joint, at_least=0, at_most=hand.model.njoints - 1)
    own = [one for one in hand.geometry.geometryObjects if one.parentJoint == joint]
    for one in own:
        one.geometry.computeLocalAABB()
    centres = [data.oMi[joint].act(one.placement.act(np.array(one.geometry.aabb_center))) for one in own]
    return np.array(centres).mean(axis=0) if centres else np.array(data.oMi[joint].translation)


def fingertips(hand: HandModel, data: pin.Data) -> Array:
    """Return where the fingers press: centres of their last links (f, 3) in the world [m].

    A single finger presses with its end against the palm. For it: its end, and the point of the palm nearest to where
    that end can reach (2, 3).

    Raises:
        InvalidInput: not a hand, or data of another model.
    """
    instance_of("hand", hand, HandModel)
    if len(instance_of("data", data, pin.Data).oMi) != hand.model.njoints:
        raise InvalidInput(
            f"data: expected those of the hand's model ({hand.model.njoints - 1} joints), got {len(data.oMi) - 1} "
            "joints: make them by hand.model.createData()"
        )
    last = [finger.joint_ids[-1] for finger in hand.fingers]
    if len(last) > 1:
        return np.array([link_centre(hand, data, joint) for joint in last])
    other, found = hand.model.createData(), []
    for q in (np.array(hand.lower), np.array(hand.upper)):
        pin.forwardKinematics(hand.model, other, np.clip(q, -np.pi, np.pi))
        found.append(_nearest(hand, other, 0, _end(hand, other, last[0])))
    return np.array([_end(hand, data, last[0]), min(found, key=lambda one: one[0])[1]])


def _end(hand: HandModel, data: pin.Data, joint: int) -> Array:
    """The point (3,) that a joint's geometry reaches farthest, in the direction of its centre."""
    origin = data.oMi[joint].translation
    out = link_centre(hand, data, joint) - origin
    far = origin + _FAR * out / max(float(np.linalg.norm(out)), 1e-9)
    return _nearest(hand, data, joint, far)[1]


def _nearest(hand: HandModel, data: pin.Data, joint: int, point: Array) -> tuple[float, Array]:
    """Distance [m] of the geometry that a joint carries from a point (3,), and its nearest point (3,).

    Where the joint carries none: infinity, and the joint's origin.
    """
    found = [(np.inf, np.array(data.oMi[joint].translation))]
    at, request, result = coal.Transform3s(np.eye(3), point), coal.DistanceRequest(), coal.DistanceResult()
    for one in hand.geometry.geometryObjects:
        if one.parentJoint == joint:
            result.clear()
            pose = locate_for_coal(data, joint, one.placement)
            distance = coal.distance(one.geometry, pose, coal.Sphere(1e-6), at, request, result)
            found.append((distance, np.array(result.getNearestPoint1())))
    return min(found, key=lambda one: one[0])
