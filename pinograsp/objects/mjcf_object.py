"""Collision shapes, mass and inertia of one body of an MJCF file: read as hands' files are."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pinograsp.checks import one_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import end_of, named, numbers
from pinograsp.hands.mjcf import to_urdf
from pinograsp.hands.mjcf_source import Source
from pinograsp.objects.description import (
    URDF_SIZES,
    Description,
    Kind,
    Part,
    collisions_of,
    names_of,
    origin_of,
    part_of,
    shape_of,
)
from pinograsp.spatial import Array

# As the URDF has them that MJCF is turned into.
_SIZES: dict[Kind, dict[str, int]] = {**URDF_SIZES, "ellipsoid": {"size": 3}}
_UNTOLD = ("the sub-tree of",)  # notes of the reader that say nothing of an object


def mjcf_description(element: ElementTree.Element, path: Path, body: str | None) -> Description:
    """What an MJCF file says of the body called ``body``, or of the only one that is free or the only one there is.

    Bodies that are fixed in it belong to it. The frame is the body's own.

    Raises:
        ValueError: several bodies, joints that move, no shape that touches, a missing mesh; what hands' files are
            refused for.
    """
    try:
        source = Source(str(path), element, path, trusted=False)
        if source.problems:
            raise ValueError("; ".join(source.problems))
        chosen = _chosen(source, body)
        _check_still(source, chosen)
        chosen.set("name", chosen.get("name") or "object")
        robot, problems, notes, _, _ = to_urdf(str(path), element, path, chosen.get("name"))
    except HandNotLoaded as error:
        raise ValueError("; ".join(error.problems)) from None
    if problems:
        raise ValueError("; ".join(problems))
    parts, whole = _united(robot, path.parent)
    if not parts:
        raise ValueError(
            f"body '{chosen.get('name')}': expected a <geom> that touches (contype, conaffinity), got none"
        )
    told = tuple(note for note in notes if not note.startswith(_UNTOLD))
    if whole.mass <= 0:
        return Description(parts=tuple(parts), mass=None, com=None, inertia=None, notes=told)
    inertia = whole.inertia if whole.inertia.any() else None
    return Description(parts=tuple(parts), mass=whole.mass, com=whole.com, inertia=inertia, notes=told)


def _chosen(source: Source, name: str | None) -> ElementTree.Element:
    """The body that is the object."""
    bodies = [
        body
        for world in source.element.findall("worldbody")
        for body, _, _ in source.contents(world, None)
        if body.tag == "body" and next(body.iter("geom"), None) is not None
    ]
    if name is not None:
        known = {body.get("name", ""): body for body in bodies}
        return known[one_of("body", name, known)]
    free = [body for body in bodies if _joints(source, body) & {"free"}]
    found = free if free else bodies
    if len(found) != 1:
        what = "free body" if free else "body with shapes in <worldbody>"
        raise ValueError(f"expected one {what}, got {len(found)}{names_of(found)}: name one with body=")
    return found[0]


def _joints(source: Source, body: ElementTree.Element) -> set[str]:
    """Types of the joints by which its parent carries a body."""
    found = set()
    for child, inherited, _ in source.contents(body, body.get("childclass")):
        if child.tag == "freejoint":
            found.add("free")
        elif child.tag == "joint":
            found.add(source.attributes(child, inherited).get("type", "hinge"))
    return found


def _check_still(source: Source, body: ElementTree.Element) -> None:
    moving = [one for one in body.iter("body") if _joints(source, one) - {"free"}]
    if moving:
        raise ValueError(f"expected one rigid object, got bodies with joints that move{names_of(moving)}")


def _united(robot: ElementTree.Element, folder: Path) -> tuple[list[Part], _Mass]:
    """The shapes of all links, which are fixed to the first, and what they weigh together, in its frame."""
    at = {robot.findall("link")[0].get("name", ""): np.eye(4)}
    for _, joint in named(robot, "joint"):  # parents come first
        at[end_of(joint, "child")] = at[end_of(joint, "parent")] @ origin_of(joint)
    parts, weights = [], []
    for name, link in named(robot, "link"):
        for collision in collisions_of(link):
            geometry, kind = shape_of(collision, _SIZES)
            size = [numbers(geometry, key, n) for key, n in _SIZES[kind].items()]
            pose = at[name] @ origin_of(collision)
            parts.append(part_of(kind, size, pose, geometry.get("filename", ""), folder, {}))
        if (inertial := link.find("inertial")) is not None:
            weights.append(_mass_of(inertial, at[name]))
    return parts, _together(weights)


class _Mass(NamedTuple):
    """Mass [kg], centre (3,) [m], and inertia about it (3, 3) [kg m^2]."""

    mass: float
    com: Array
    inertia: Array


def _mass_of(inertial: ElementTree.Element, at: Array) -> _Mass:
    """What <inertial> says of a link that is placed at (4, 4)."""
    mass, moments = (next(inertial.iter(tag)) for tag in ("mass", "inertia"))
    xx, xy, xz, yy, yz, zz = (numbers(moments, key, 1)[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    pose = at @ origin_of(inertial)
    turn = pose[:3, :3]
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return _Mass(numbers(mass, "value", 1)[0], pose[:3, 3], inertia)


def _together(weights: list[_Mass]) -> _Mass:
    """What several solids are as one."""
    mass = sum(one.mass for one in weights)
    com = sum((one.mass * one.com for one in weights), np.zeros(3)) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for one in weights:
        arm = one.com - com
        inertia += one.inertia + one.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return _Mass(float(mass), com, inertia)
