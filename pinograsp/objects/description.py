"""Collision shapes, mass and inertia of one object, as URDF and SDF say them."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from pinograsp.checks import shorten
from pinograsp.hands.elements import floats, numbers
from pinograsp.hands.shapes import mesh_path
from pinograsp.hands.urdf_file import MOMENTS
from pinograsp.spatial import FARTHEST, Array, IntArray, pose_of, rotation_rpy

Kind: TypeAlias = Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"]
MOST_SHAPES = 1000
_LEAST = 1e-9  # [m] of sizes
_LARGEST = 1e6  # of angles, masses and moments in SI units
# What gives the size of a shape, and of how many numbers: attributes in URDF, elements in SDF.
URDF_SIZES: dict[Kind, dict[str, int]] = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
_SDF: dict[Kind, dict[str, int]] = {**URDF_SIZES, "ellipsoid": {"radii": 3}}
_STILL = ("fixed", "floating")


@dataclass(frozen=True, slots=True, kw_only=True)
class CollisionShape:
    """A collision shape.

    Attributes:
        kind: of shape.
        size: edges of a box, radius, radius and length, semi-axes, or the scale of a mesh [m, -].
        pose: of the shape in the file's frame (4, 4) [m].
        path: of a mesh that comes from a file.
        triangles: of another mesh: vertices (n, 3) [m] and faces (m, 3).
        name: in the file; empty where it has none.
    """

    kind: Kind
    size: tuple[float, ...]
    pose: Array
    path: Path | None = None
    triangles: tuple[Array, IntArray] | None = field(default=None, compare=False)
    name: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What a file says of an object, in its frame: that of the link (URDF), the model (SDF) or the body (MJCF).

    Attributes:
        parts: one or more.
        mass: [kg]; None where the file gives none, or 0.
        com: centre of mass (3,) [m]; None with the mass.
        inertia: about the centre of mass, axes of the file's frame (3, 3) [kg m^2]; None where the file gives none.
        notes: what was left out.
    """

    parts: tuple[CollisionShape, ...]
    mass: float | None
    com: Array | None
    inertia: Array | None
    notes: tuple[str, ...] = ()


# -- URDF --------------------------------------------------------------------------------------------------------------


def urdf_description(robot: ElementTree.Element, folder: Path, packages: Mapping[str, Path]) -> Description:
    """What a URDF says; ValueError for several links, joints that move, no shape, a missing mesh."""
    moving = [joint.get("name", "") for joint in robot.findall("joint") if joint.get("type") not in _STILL]
    link = _only_link(robot, moving)
    parts = []
    for collision in collisions_of(link):
        geometry, kind = shape_of(collision, URDF_SIZES)
        size = [numbers(geometry, key, n, "1 1 1" if kind == "mesh" else None) for key, n in URDF_SIZES[kind].items()]
        part = part_of(kind, size, origin_of(collision), geometry.get("filename", ""), folder, packages)
        parts.append(replace(part, name=collision.get("name", "")))
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return Description(parts=tuple(parts), mass=None, com=None, inertia=None)
    (value,) = numbers(mass, "value", 1, most=_LARGEST)
    given = inertial.find("inertia")
    moments = None if given is None else [numbers(given, key, 1, "0", most=_LARGEST)[0] for key in MOMENTS]
    return _weigh(parts, value, origin_of(inertial), moments)


def origin_of(element: ElementTree.Element) -> Array:
    """The placement (4, 4) that an element's <origin> gives [m]."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = (numbers(origin, key, 3, "0 0 0", most=most) for key, most in (("xyz", FARTHEST), ("rpy", _LARGEST)))
    return pose_of(xyz, rotation_rpy(*rpy))


# -- SDF ---------------------------------------------------------------------------------------------------------------


def sdf_description(root: ElementTree.Element, folder: Path, packages: Mapping[str, Path]) -> Description:
    """What an SDF says; ValueError for several models or links, joints that move, no shape, a missing mesh."""
    models = [root] if root.tag == "model" else [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1:
        raise ValueError(
            f"expected one <model>, got {len(models)}{list_names(models)}: give each object a file of its own"
        )
    (model,) = models
    nested = [*model.findall("model"), *model.findall("include")]
    if nested:
        raise ValueError(
            f"expected one object, got a model with others in it{list_names(nested)}: give the file of one"
        )
    moving = [joint.get("name", "") for joint in model.findall("joint") if joint.get("type") not in _STILL]
    link = _only_link(model, moving)
    of_link = _read_pose(link)
    parts = []
    for collision in collisions_of(link):
        geometry, kind = shape_of(collision, _SDF)
        if geometry.find("submesh") is not None:
            raise ValueError("<submesh> is not supported: give it a mesh file of its own")
        size = [_texts(geometry, key, n, "1 1 1" if kind == "mesh" else None) for key, n in _SDF[kind].items()]
        uri = (geometry.findtext("uri") or "").strip()
        part = part_of(kind, size, of_link @ _read_pose(collision), uri, folder, packages)
        parts.append(replace(part, name=collision.get("name", "")))
    inertial = link.find("inertial")
    if inertial is None or inertial.find("mass") is None:
        return Description(parts=tuple(parts), mass=None, com=None, inertia=None)
    (value,) = _texts(inertial, "mass", 1)
    given = inertial.find("inertia")
    moments = None
    if given is not None:
        moments = [_texts(given, key, 1, "1" if key[1] == key[2] else "0")[0] for key in MOMENTS]
    return _weigh(parts, value, of_link @ _read_pose(inertial), moments)


def _texts(element: ElementTree.Element, key: str, count: int, default: str | None = None) -> list[float]:
    """``count`` finite numbers in a child element."""
    text = element.findtext(key, default)
    try:
        values = [] if text is None else floats(text)
    except ValueError:
        values = []
    if len(values) != count or max(map(abs, values)) > _LARGEST:
        raise ValueError(f"<{key}>: expected {count} finite number{'s' * (count > 1)}, got {shorten(text)}")
    return values


def _read_pose(element: ElementTree.Element) -> Array:
    """A <pose> of x, y, z, roll, pitch, yaw in the frame of the element above."""
    pose = element.find("pose")
    if pose is None:
        return np.eye(4)
    if pose.get("relative_to") or pose.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise ValueError("<pose relative_to=, rotation_format=> is not supported: write x y z roll pitch yaw")
    values = _texts(element, "pose", 6, "") if (pose.text or "").strip() else [0.0] * 6
    turn = values[3:] if pose.get("degrees") not in ("true", "1") else np.radians(values[3:]).tolist()
    return pose_of(values[:3], rotation_rpy(*turn))


# -- both --------------------------------------------------------------------------------------------------------------


def _only_link(model: ElementTree.Element, moving: list[str]) -> ElementTree.Element:
    """The link that the object is; frames (links with nothing in them) may stand beside it."""
    if moving:
        raise ValueError(f"expected one rigid object, got joints that move: {', '.join(sorted(moving)[:10])}")
    links = model.findall("link")
    solid = [link for link in links if link.find("collision") is not None]
    heavy = [link for link in links if link.find("inertial") is not None and link not in solid]
    if len(solid) != 1 or heavy:
        raise ValueError(
            f"expected one link with <collision> and no others with a mass, got {len(solid)}{list_names(solid)}"
            + (f" and others with a mass{list_names(heavy)}" if heavy else "")
            + ": give the file of one rigid object"
        )
    return solid[0]


def list_names(elements: list[ElementTree.Element]) -> str:
    """The first names of elements in brackets, for a message."""
    names = ", ".join(element.get("name") or f"<{element.tag}>" for element in elements[:10])
    return f" ({names})" if names else ""


def collisions_of(link: ElementTree.Element) -> list[ElementTree.Element]:
    """The collision shapes of a link; ValueError for more than an object has."""
    found = link.findall("collision")
    if len(found) > MOST_SHAPES:
        raise ValueError(f"expected at most {MOST_SHAPES} collision shapes, got {len(found)}")
    return found


def shape_of(collision: ElementTree.Element, sizes: Mapping[Kind, dict[str, int]]) -> tuple[ElementTree.Element, Kind]:
    """The element that gives the shape of a <collision>, and its kind; ValueError for others than in ``sizes``."""
    for element in collision.findall("geometry/*"):
        for kind in sizes:
            if element.tag == kind:
                return element, kind
    found = ", ".join(f"<{element.tag}>" for element in collision.findall("geometry/*")[:5]) or "nothing"
    raise ValueError(f"<collision>: expected one of {', '.join(sizes)}, got {found}")


def part_of(
    kind: Kind, sizes: list[list[float]], pose: Array, name: str, folder: Path, packages: Mapping[str, Path]
) -> CollisionShape:
    """A shape of these sizes, or the mesh called ``name``; ValueError where it has no size or is not there."""
    size = tuple(value for group in sizes for value in group)
    if not all(value != 0 if kind == "mesh" else _LEAST <= value <= FARTHEST for value in size):
        raise ValueError(f"<{kind}>: expected sizes > 0 [m], got {' '.join(f'{value:g}' for value in size)}")
    if kind != "mesh":
        return CollisionShape(kind=kind, size=size, pose=pose)
    # Relative to the file, or to the folder of all assets above it, as Isaac Gym has them.
    places = [mesh_path(name, place, packages) for place in (folder, *list(folder.parents)[:2])] if name else []
    path = next((place for place in places if place is not None), None)
    if path is None:
        raise ValueError(
            f"mesh '{name:.200}' not found: expected it beside the file (packages= gives the folders of ROS packages)"
        )
    return CollisionShape(kind=kind, size=size, pose=pose, path=path)


def _weigh(parts: list[CollisionShape], mass: float, pose: Array, moments: list[float] | None) -> Description:
    if mass < 0:
        raise ValueError(f"<mass>: expected >= 0 kg, got {mass:g}")
    if mass == 0:
        return Description(parts=tuple(parts), mass=None, com=None, inertia=None)
    inertia = None
    if moments is not None and any(moments):
        xx, xy, xz, yy, yz, zz = moments
        turn = pose[:3, :3]
        inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return Description(parts=tuple(parts), mass=mass, com=pose[:3, 3], inertia=inertia)
