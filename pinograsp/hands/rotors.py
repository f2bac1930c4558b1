"""Rotors: bars and wheels that turn about their own middle, as on the motor of a gripper. They grasp nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.hands.geometry import form_of, hull_points
from pinograsp.hands.shapes import MeshNames, read_shapes
from pinograsp.hands.tree import MOVING
from pinograsp.hands.urdf_tree import links_below
from pinograsp.spatial import Array

if TYPE_CHECKING:
    import yourdfpy

_EVEN = 0.7  # reach to the other side of the axis, at least, relative to the farthest


def find_rotors(robot: yourdfpy.Robot, names: MeshNames) -> list[str]:
    """Names of joints that turn without end, carry nothing but one link, and whose shapes reach about as far to both
    sides of their axis; beside them at least two others that move start below the same link.

    Joints that move with others are none. The robot has been checked.
    """
    followed = {joint.mimic.joint for joint in robot.joints if joint.mimic is not None}
    parents = {joint.parent for joint in robot.joints}
    moving = [joint for joint in robot.joints if joint.type in (*MOVING, "continuous")]
    found = []
    for joint in moving:
        alone = joint.type == "continuous" and joint.child not in parents
        if not alone or joint.name in followed or joint.mimic is not None:
            continue
        below = links_below(robot, joint.parent)
        if sum(one.parent in below for one in moving) > 2:
            points = _find_points(robot, joint.child, names)
            if points is not None and _reach_evenly(points, joint.axis):
                found.append(joint.name)
    return found if len(moving) - len(found) > 1 else []


def _find_points(robot: yourdfpy.Robot, link: str, names: MeshNames) -> Array | None:
    """Points (p, 3) of a link's shapes in its frame; None where it has none, or any that cannot be read."""
    alone = replace(robot, links=[one for one in robot.links if one.name == link], joints=[])
    points = []
    for shape in read_shapes(alone, names, []):
        try:
            form = form_of(shape)
        except (ValueError, OSError):  # noted with the other shapes
            return None
        points.append(hull_points(form) @ shape.placement.rotation.T + shape.placement.translation)
    return np.concatenate(points) if points else None


def _reach_evenly(points: Array, axis: Array) -> bool:
    """Whether points (p, 3) reach about as far to both sides of a joint's axis (3,)."""
    across = points - np.outer(points @ axis, axis) / float(axis @ axis)
    far = across[np.argmax(np.linalg.norm(across, axis=1))]
    return bool(-(across @ far).min() >= _EVEN * float(far @ far))
