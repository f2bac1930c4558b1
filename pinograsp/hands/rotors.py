"""Rotors: bars and wheels that turn about their own middle, as on the motor of a gripper. They grasp nothing."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pinograsp.hands.elements import end_of, named, numbers
from pinograsp.hands.geometry import Triangles, form_of, hull_points
from pinograsp.hands.ros_packages import Packages
from pinograsp.hands.shapes import shapes_of
from pinograsp.hands.tree import MOVING
from pinograsp.hands.urdf_tree import joints_below
from pinograsp.spatial import Array

_EVEN = 0.7  # reach to the other side of the axis, at least, relative to the farthest


def rotors(robot: ElementTree.Element, folder: Path, packages: Packages, inline: Mapping[str, Triangles]) -> list[str]:
    """Names of joints that turn without end, carry nothing but one link, and whose shapes reach about as far to both
    sides of their axis; beside them at least two others that move start below the same link.

    Joints that move with others are none. The robot has been checked.
    """
    followed = {mimic.get("joint", "") for mimic in robot.iter("mimic")}
    parents = {end_of(joint, "parent") for _, joint in named(robot, "joint")}
    free = {name for name, joint in named(robot, "joint") if joint.get("type") in (*MOVING, "continuous")}
    found = []
    for name, joint in named(robot, "joint"):
        child = end_of(joint, "child")
        alone = joint.get("type") == "continuous" and child not in parents
        if not alone or name in followed or joint.find("mimic") is not None:
            continue
        if len(free & joints_below(robot, end_of(joint, "parent"))) > 2:
            points = _points(robot, child, folder, packages, inline)
            if points is not None and _even(points, joint):
                found.append(name)
    return found if len(free.difference(found)) > 1 else []


def _points(
    robot: ElementTree.Element, link: str, folder: Path, packages: Packages, inline: Mapping[str, Triangles]
) -> Array | None:
    """Points (p, 3) of a link's shapes in its frame; None where it has none, or any that cannot be read."""
    alone = ElementTree.Element("robot")
    alone.extend(one for name, one in named(robot, "link") if name == link)
    points = []
    for shape in shapes_of(alone, folder, packages, [], inline):
        try:
            form = form_of(shape)
        except (ValueError, OSError):  # noted with the other shapes
            return None
        points.append(hull_points(form) @ shape.placement.rotation.T + shape.placement.translation)
    return np.concatenate(points) if points else None


def _even(points: Array, joint: ElementTree.Element) -> bool:
    """Whether points (p, 3) reach about as far to both sides of a joint's axis."""
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0] if element is None else numbers(element, "xyz", 3, "1 0 0"))
    across = points - np.outer(points @ axis, axis) / float(axis @ axis)
    far = across[np.argmax(np.linalg.norm(across, axis=1))]
    return bool(-(across @ far).min() >= _EVEN * float(far @ far))
