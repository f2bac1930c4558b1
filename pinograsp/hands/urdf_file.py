"""URDF files as yourdfpy reads them, after a look at their numbers.

yourdfpy's records have no place for some of what is read here: capsules, ellipsoids and shapes that cannot be used
stand as meshes under names of their own, and the motors' inertias come beside the robot.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pinograsp.hands.elements import LARGEST, LEAST, find_named, numbers
from pinograsp.hands.tree import MOVING
from pinograsp.spatial import FARTHEST
from pinograsp.words import printable

if TYPE_CHECKING:
    import yourdfpy

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# How names of meshes begin that are none: what yourdfpy has no record for, and why a shape cannot be used.
CAPSULE, ELLIPSOID, NO_SHAPE = "capsule:", "ellipsoid:", "no shape: "
WAY_OUT = "correct it, or leave <inertial> out: mass and inertia are then taken from the link's shapes"
_LONGEST = 100_000  # characters of an attribute
# What is read of each element.
_CHILDREN: dict[str, tuple[str, ...]] = {
    "robot": ("material", "link", "joint"),
    "link": ("inertial", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "collision": ("origin",),
    "visual": ("origin", "material"),
    "material": ("color", "texture"),
    "joint": ("origin", "parent", "child", "axis", "mimic", "dynamics"),
}
_OF_FIXED = ("origin", "parent", "child")  # it follows nothing and needs no axis
# How many numbers an attribute holds and how large each may be, by element.
_NUMBERS: dict[str, dict[str, tuple[int, float]]] = {
    "origin": {"xyz": (3, FARTHEST), "rpy": (3, LARGEST), "quat_xyzw": (4, LARGEST)},
    "axis": {"xyz": (3, LARGEST)},
    "mass": {"value": (1, LARGEST)},
    "inertia": dict.fromkeys(MOMENTS, (1, LARGEST)),
    "mimic": {"multiplier": (1, LARGEST), "offset": (1, LARGEST)},
    "dynamics": {"damping": (1, LARGEST), "friction": (1, LARGEST), "armature": (1, LARGEST)},
}
# Attributes that give the size of a shape.
_SIZES: dict[str, dict[str, int]] = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "ellipsoid": {"size": 3},
    "mesh": {"scale": 3},
}


def read_urdf(element: ElementTree.Element, problems: list[str]) -> tuple[yourdfpy.Robot, dict[str, float]]:
    """The robot that a URDF's outermost element describes, and the inertia of motors [kg m^2] by joint.

    ``problems``: attributes that are not the numbers they should be are added, and left out. Of collision shapes,
    :data:`NO_SHAPE` tells them; what is only seen is left out with them.
    """
    import yourdfpy  # brings trimesh, slow to import

    if element.tag != "robot":
        problems.append(f"expected <robot> outermost, got <{printable(str(element.tag), 60)}>")
        return yourdfpy.Robot(name=""), {}
    clean = _copy(element, "", problems)
    if any(len(value) > _LONGEST for one in clean.iter() for value in one.attrib.values()):
        problems.append(f"expected attributes of at most {_LONGEST} characters")
        return yourdfpy.Robot(name=""), {}
    armatures = {
        name: float(dynamics.get("armature", "0"))
        for name, joint in find_named(clean, "joint")
        for dynamics in joint.findall("dynamics")[:1]
    }
    stream = io.BytesIO(ElementTree.tostring(clean, encoding="utf-8"))
    # Nothing but the robot itself: a scene of yourdfpy's reads every file that a mesh names, of any size.
    urdf = yourdfpy.URDF.load(stream, build_scene_graph=False, load_meshes=False, filename_handler=str)
    return urdf.robot, armatures


def _copy(element: ElementTree.Element, where: str, problems: list[str]) -> ElementTree.Element:
    """An element with what is read of it; ``where``: the link or joint that it belongs to."""
    tag, clean = element.tag, ElementTree.Element(element.tag, element.attrib)
    if tag in ("robot", "link", "joint"):
        clean.set("name", name := element.get("name", ""))
        where = f"{tag} '{name}'"
    children = _OF_FIXED if tag == "joint" and element.get("type") == "fixed" else _CHILDREN.get(tag, ())
    clean.extend([_copy(child, where, problems) for one in children for child in element.findall(one)])
    for key, (count, most) in _NUMBERS.get(tag, {}).items():
        try:
            values = numbers(element, key, count, most=most) if key in element.attrib else [1.0]
            if key == "quat_xyzw" and key in element.attrib:
                clean.set("rpy", _turn(values))
        except ValueError as error:
            problems.append(f"{where}: <{tag} {key}=>: {error}")
            del clean.attrib[key]
        else:
            if tag == "axis" and max(map(abs, values)) < LEAST:
                problems.append(f"{where}: <axis xyz=> is zero, expected a direction")
    if tag == "link":
        problems += [f"{where}: {problem}" for one in element.findall("inertial") for problem in _lacks(one)]
        for visual in element.findall("visual"):
            ignored: list[str] = []
            seen = _copy(visual, "", ignored)
            clean.extend([] if ignored else [seen])
    elif tag == "joint":
        for one in ("parent", "child"):
            ElementTree.SubElement(clean, one, link="")  # where it has none
        if element.get("type") in (*MOVING, "continuous"):
            clean.extend([_limit(limit, where, problems) for limit in element.findall("limit")])
    elif tag in ("collision", "visual"):
        ElementTree.SubElement(clean, "geometry").append(_shape(element))
    elif tag == "color":
        try:
            numbers(element, "rgba", 4)
        except ValueError:
            clean.set("rgba", "nan nan nan nan")
    return clean


def _turn(quaternion: list[float]) -> str:
    """Roll, pitch and yaw of a quaternion (x, y, z, w)."""
    turn = pin.Quaternion(np.array(quaternion))
    if turn.norm() < LEAST:
        raise ValueError("expected a rotation, got zeros")
    return " ".join(map(repr, pin.rpy.matrixToRpy(turn.normalized().matrix()).tolist()))


def _lacks(inertial: ElementTree.Element) -> list[str]:
    """What an <inertial> must have, for which yourdfpy takes numbers of its own."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        return [f"<inertial> needs both <mass> and <inertia>: {WAY_OUT}"]
    given = {*mass.attrib, *inertia.attrib}
    lacking = [key for key in ("value", *MOMENTS) if key not in given]
    return [f"<inertial> lacks {', '.join(lacking)}: {WAY_OUT}"] if lacking else []


def _limit(limit: ElementTree.Element, where: str, problems: list[str]) -> ElementTree.Element:
    given = {key: value for key, value in limit.attrib.items() if key in ("lower", "upper", "effort", "velocity")}
    try:
        return ElementTree.Element("limit", {key: repr(float(value)) for key, value in given.items()})
    except ValueError:
        problems.append(f"{where}: limits must be numbers, got {limit.attrib}")
        return ElementTree.Element("limit", lower="-1", upper="1")


def _shape(element: ElementTree.Element) -> ElementTree.Element:
    """The first known shape of a <collision> or <visual>, as one that yourdfpy reads."""
    found = next((one for one in element.findall("geometry/*") if one.tag in _SIZES), None)
    if found is None:
        return ElementTree.Element("mesh", filename=f"{NO_SHAPE}no known shape")
    try:
        for key, count in _SIZES[found.tag].items():
            numbers(found, key, count, "1 1 1" if key == "scale" else None)
    except ValueError as error:
        return ElementTree.Element("mesh", filename=f"{NO_SHAPE}<{found.tag}>: {error}")
    if found.tag == "capsule":
        return ElementTree.Element("mesh", filename=CAPSULE, scale=f"{found.get('radius')} {found.get('length')} 1")
    if found.tag == "ellipsoid":
        return ElementTree.Element("mesh", filename=ELLIPSOID, scale=found.get("size", ""))
    return ElementTree.Element(found.tag, {"filename": ""} | found.attrib)
