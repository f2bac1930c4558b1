"""The hand of a robot alone, without the arm that carries it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import coal
import pinocchio as pin

from pinograsp.checks import instance_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.elements import parse
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.urdf_tree import cut_out

# Of the actuated joints, by their names in Pinocchio.
_LIMITS = (
    "lowerPositionLimit",
    "upperPositionLimit",
    "effortLimit",
    "velocityLimit",
    "armature",
    "damping",
    "friction",
)


def detach(robot: HandModel) -> HandModel:
    """Return the hand of a robot, in the place where the arm holds it at rest.

    The hand is what the last joint before the palm carries; its root is the link that this joint moves. Palm, fingers,
    names of links and joints, shapes, limits and drives are those of the robot, so that a plan for the hand alone is
    valid for the robot. A robot whose palm is fixed in the world is its own hand.

    Raises:
        InvalidInput: the robot was built without a description.
    """
    model, palm = instance_of("robot", robot, HandModel).model, robot.model.frames[robot.frame_id(robot.palm)]
    if palm.parentJoint == 0:
        return robot
    if not robot.description:
        raise InvalidInput(f"robot '{robot.name}': expected one of a description, got one that was built otherwise")
    element = parse(robot.source, robot.description)
    root = _find_root(model, palm)
    cut_out(robot.source, element, root.name, [])
    text = ElementTree.tostring(element, encoding="unicode")
    own, at_rest = pin.buildModelFromXML(text, True), robot.frame_placements(robot.resting, [root.name])[0]
    # From the joint that carries the root to the world, in which it is fixed now.
    move = pin.SE3(at_rest) * root.placement.inverse()
    old, known = [0] * own.njoints, set(model.names)
    for j in range(1, own.njoints):
        # Coupled hands number their joints in the description.
        own.names[j] = own.names[j] if own.names[j] in known else re.sub(r"^\d{4,} ", "", own.names[j])
        old[j] = int(model.getJointId(own.names[j]))
        placement = model.jointPlacements[old[j]]
        own.jointPlacements[j] = move * placement if own.parents[j] == 0 else placement
        own.inertias[j] = model.inertias[old[j]]
    own.inertias[0] = pin.SE3(at_rest).act(own.inertias[0])
    for limit in _LIMITS:
        values = getattr(own, limit)
        for j in range(1, own.njoints):
            if own.joints[j].nv:
                values[own.joints[j].idx_v] = getattr(model, limit)[model.joints[old[j]].idx_v]
        setattr(own, limit, values)
    frames = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in list(own.frames)[1:]:
        if frame.type != pin.FrameType.BODY:
            frame.name = frame.name if model.existFrame(frame.name) else re.sub(r"^\d{4,} ", "", frame.name)
        its = frames[frame.name] if frame.type == pin.FrameType.BODY else model.frames[model.getFrameId(frame.name)]
        frame.placement = move * its.placement if frame.parentJoint == 0 else its.placement
    links = {frame.name for frame in own.frames if frame.type == pin.FrameType.BODY}
    geometry, shapes = _take_shapes(robot, own, links, move)
    joints = {own.names[j] for j in range(1, own.njoints) if own.joints[j].nv}
    fingers = [Finger.on_model(own, one.name, one.joints, one.links, one.tip) for one in robot.fingers]
    hand = replace(
        robot,
        model=own,
        geometry=geometry,
        fingers=tuple(fingers),
        pose=at_rest,
        description=text,
        own_shapes=shapes,
        drives=(),
        springs=(),
        disabled_collisions=tuple(pair for pair in robot.disabled_collisions if links.issuperset(pair)),
        visuals=tuple(one for one in robot.visuals if one.link in links),
        posture={joint: value for joint, value in robot.posture.items() if joint in joints},
        continuous=tuple(joint for joint in robot.continuous if joint in joints),
    )
    return hand.with_drives(
        [drive for drive in robot.drives if joints.issuperset(drive.joints)],
        [spring for spring in robot.springs if spring.joint in joints],
    )


def _find_root(model: pin.Model, palm: pin.Frame) -> pin.Frame:
    """The link that the joint moves which carries the palm."""
    root = frame = palm
    while (frame := model.frames[frame.parentFrame]).parentJoint == palm.parentJoint:
        root = frame if frame.type == pin.FrameType.BODY else root
        if frame.type == pin.FrameType.JOINT:
            break
    return root


def _take_shapes(
    robot: HandModel, own: pin.Model, links: set[str], move: pin.SE3
) -> tuple[pin.GeometryModel, tuple[coal.CollisionGeometry, ...]]:
    """The shapes of these links, and as their file has them."""
    geometry, kept = pin.GeometryModel(), list[int]()
    for i, one in enumerate(robot.geometry.geometryObjects):
        link = robot.model.frames[one.parentFrame].name
        if link not in links:
            continue
        shape, frame = one.copy(), own.getFrameId(link, pin.FrameType.BODY)
        shape.parentFrame, shape.parentJoint = frame, own.frames[frame].parentJoint
        if not shape.parentJoint:
            shape.placement = move * one.placement
        geometry.addGeometryObject(shape)
        kept.append(i)
    whole = len(robot.own_shapes) == robot.geometry.ngeoms
    return geometry, tuple(robot.own_shapes[i] for i in kept) if whole else ()
