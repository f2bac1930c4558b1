"""XML of a robot: parsed, and its elements and numbers looked up."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded

_XACRO = "{http://www.ros.org/wiki/xacro}"


def parse(source: str, text: str) -> ElementTree.Element:
    """The outermost element of a description, names without namespaces.

    Raises:
        HandNotLoaded: not XML, or not of a robot.
    """
    try:
        robot = ElementTree.fromstring(text.lstrip("\ufeff").strip())
    except (ElementTree.ParseError, ValueError) as error:
        raise HandNotLoaded(source, f"not well-formed XML: {error}") from error
    if any(element.tag.startswith(_XACRO) for element in robot.iter()):
        raise HandNotLoaded(source, "holds xacro commands: give the file the ending .xacro, or expand it first")
    for element in robot.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    if robot.tag not in ("robot", "mujoco"):
        raise HandNotLoaded(source, f"expected <robot> (URDF) or <mujoco> (MJCF), found <{robot.tag}>")
    return robot


def is_file(path: Path) -> bool:
    """Whether there is such a file; False as well for names that cannot be any."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, in a folder that may not be read
        return False


def written(values) -> str:
    """Numbers as text, without losing a digit."""
    return " ".join(repr(float(value)) for value in values)


def named(robot, tag: str) -> list[tuple[str, ElementTree.Element]]:
    return [(element.get("name", ""), element) for element in robot.findall(tag)]


def end_of(joint, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def drop(element, *tags: str) -> None:
    for tag in tags:
        for child in element.findall(tag):
            element.remove(child)


def numbers(element, key: str, count: int, default: str | None = None) -> list[float]:
    """``count`` finite numbers of an attribute; ValueError where there are others."""
    text = element.get(key, default)
    try:
        values = [] if text is None else [float(value) for value in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"expected {count} finite number{'s' * (count > 1)}, got {text!r}")
    return values


def placement_of(element) -> pin.SE3:
    """Placement given by an element's <origin>, which has been checked."""
    origin = element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    return pin.SE3(
        pin.rpy.rpyToMatrix(np.array(numbers(origin, "rpy", 3, "0 0 0"))), np.array(numbers(origin, "xyz", 3, "0 0 0"))
    )
