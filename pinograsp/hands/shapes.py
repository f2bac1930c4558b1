"""Collision shapes of a URDF, and the mesh files its names mean."""

from __future__ import annotations

import os
import urllib.parse
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from pinograsp.checks import one_of
from pinograsp.hands.elements import end_of, named, numbers, placement_of
from pinograsp.hands.geometry import Kind, Shape, read_mesh
from pinograsp.hands.ros_packages import Packages
from pinograsp.spatial import FARTHEST

_LEAST = 1e-9  # [m] of sizes
_UNIT_SPHERE = "unit_sphere.stl"
# Attributes that give the size of a shape, in the order coal takes them.
_SIZES: dict[Kind, dict[str, int]] = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "ellipsoid": {"size": 3},
    "mesh": {"scale": 3},
}


def shapes_of(robot: ElementTree.Element, folder: Path, packages: Packages, notes: list[str]) -> list[Shape]:
    """Collision shapes; those without size and those whose file is missing are left out and noted.

    So are coarse shapes for a controller's own checks of self-collision: those of a link that is fixed to another and
    called as that one and ``_sc``, as Franka's. URDF has no ellipsoid. A mesh called ``unit_sphere.stl`` with a scale
    stands for one and becomes the exact shape.
    """
    shapes: list[Shape] = []
    missing: list[str] = []
    void: list[str] = []
    coarse = _coarse(robot)
    for name, link in named(robot, "link"):
        if name in coarse:
            continue
        for collision in link.findall("collision"):
            element = next((one for one in collision.findall("geometry/*") if one.tag in _SIZES), None)
            if element is None:
                void.append(f"{name} (no known shape)")
                continue
            kind, path = one_of("shape", element.tag, _SIZES), ""
            try:
                sizes = [
                    numbers(element, key, count, "1 1 1" if key == "scale" else None)
                    for key, count in _SIZES[kind].items()
                ]
            except ValueError as error:
                void.append(f"{name} (<{kind}>: {error})")
                continue
            size = tuple(value for group in sizes for value in group)
            if not all(value != 0 if kind == "mesh" else _LEAST <= value <= FARTHEST for value in size):
                void.append(f"{name} (<{kind}> of size {' '.join(f'{value:g}' for value in size)})")
                continue
            if kind == "mesh":
                filename = element.get("filename", "")
                file = mesh_path(filename, folder, packages)
                path = str(file or "")
                called = filename.replace("\\", "/").split("/")[-1]
                if called == _UNIT_SPHERE and (file is None or _is_unit_sphere(file)):
                    kind, size, path = "ellipsoid", tuple(map(abs, size)), ""
                    if not all(_LEAST <= value <= FARTHEST for value in size):
                        void.append(f"{name} (<mesh> of scale {' '.join(f'{value:g}' for value in size)})")
                        continue
                elif file is None:
                    missing.append(f"{name} ({filename})")
                    continue
            shapes.append(Shape(link=name, placement=placement_of(collision), kind=kind, size=size, path=path))
    if coarse:
        notes.append(f"coarse shapes for checks of self-collision are left out: {', '.join(coarse)}")
    if missing:
        notes.append(
            f"meshes not found, so these links cannot touch anything (packages= gives the folders of ROS packages): "
            f"{', '.join(missing)}"
        )
    if void:
        notes.append(f"shapes left out: {', '.join(void)}")
    return shapes


def _coarse(robot: ElementTree.Element) -> list[str]:
    """Links with shapes, called as a link with shapes of its own that they are fixed to, and ``_sc``."""
    shaped = {name for name, link in named(robot, "link") if link.find("collision") is not None}
    return [
        end_of(joint, "child")
        for _, joint in named(robot, "joint")
        if joint.get("type") == "fixed"
        and end_of(joint, "child") == f"{end_of(joint, 'parent')}_sc"
        and {end_of(joint, "child"), end_of(joint, "parent")} <= shaped
    ]


def _is_unit_sphere(path: Path) -> bool:
    try:
        vertices = read_mesh(str(path)).vertices()
    except (ValueError, OSError):
        return False
    return bool(np.all(np.abs(np.linalg.norm(vertices, axis=1) - 1.0) < 1e-3))


def mesh_path(name: str, folder: Path, packages: Packages) -> Path | None:
    """The file that ``package://``, ``file://``, absolute or relative ``name`` means, or None."""
    name = name.replace("\\", "/")
    spellings = [name, plain] if (plain := urllib.parse.unquote(name)) != name else [name]
    for one in spellings:
        for place in _places(one, folder, packages):
            if os.path.isfile(place):
                return place.resolve()
    return None


def _places(name: str, folder: Path, given: Packages) -> list[Path]:
    if name.startswith("file://"):
        name = name[len("file://") :]
    if "://" not in name:
        return [Path(name) if Path(name).is_absolute() else folder / name]
    name = name.split("://", 1)[1].lstrip("/")
    packages = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    package, _, inside = name.partition("/")
    places = [given[package] / inside] if package in given else []
    # Beside the file's own package, then where ROS looks, then the package's folder under another name.
    places += [*(above / name for above in (folder, *folder.parents)), *(p / name for p in packages)]
    inside = inside or name
    places += [above / inside for above in (folder, *list(folder.parents)[:3])]
    return [*places, *(p.parent / name for p in packages)]
