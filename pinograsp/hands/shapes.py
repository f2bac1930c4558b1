"""Collision and visual shapes of a URDF, and the mesh files its names mean."""

from __future__ import annotations

import os
import urllib.parse
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from pinograsp.checks import one_of
from pinograsp.hands.elements import LEAST, as_rpy, drop, end_of, named, numbers, placement_of
from pinograsp.hands.file_reads import is_there
from pinograsp.hands.geometry import Kind, Shape, Triangles, read_mesh
from pinograsp.hands.ros_packages import Packages
from pinograsp.spatial import FARTHEST

INLINE = "inline:"  # how names of meshes begin that come from no file
_NONE: Mapping[str, Triangles] = MappingProxyType({})
_MOST_VISUALS = 2000
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


def shapes_of(
    robot: ElementTree.Element,
    folder: Path,
    packages: Packages,
    notes: list[str],
    inline: Mapping[str, Triangles] = _NONE,
) -> list[Shape]:
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
            try:
                shapes.append(_shape(name, collision, folder, packages, inline))
            except FileNotFoundError as error:
                missing.append(f"{name} ({error})")
            except ValueError as error:
                void.append(f"{name} ({error})")
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


def take_visuals(
    robot: ElementTree.Element, folder: Path, packages: Packages, inline: Mapping[str, Triangles] = _NONE
) -> list[Shape]:
    """Take out what is seen of the links, with the description's colours and textures; what cannot be read is left out.

    Meshes that are not found keep the name that the description gives them.
    """
    for origin in robot.findall("link/visual/origin"):
        as_rpy(origin)
    named_colours: dict[str, str | None] = {}
    named_textures: dict[str, str] = {}
    for one in robot.iter("material"):
        if not one.get("name"):
            continue
        if one.find("color") is not None:
            named_colours.setdefault(one.get("name", ""), _colour(one))
        if texture := _texture(one, folder, packages):
            named_textures.setdefault(one.get("name", ""), texture)
    shapes: list[Shape] = []
    for name, link in named(robot, "link"):
        for visual in link.findall("visual")[: _MOST_VISUALS - len(shapes)]:
            material = visual.find("material")
            colour: str | None = ""
            texture = ""
            if material is not None:
                called = material.get("name", "")
                own = material.find("color") is not None
                colour = _colour(material) if own else named_colours.get(called, "")
                texture = _texture(material, folder, packages) or ("" if own else named_textures.get(called, ""))
            if colour is None:
                continue
            try:
                shape = _shape(name, visual, folder, packages, inline)
            except FileNotFoundError as error:
                shape = Shape(link=name, placement=pin.SE3.Identity(), kind="mesh", size=(1, 1, 1), path=str(error))
            except ValueError:
                continue
            if np.abs(shape.placement.translation).max() <= FARTHEST:
                shapes.append(replace(shape, colour=colour, texture=texture))
        drop(link, "visual")
    return shapes


def _colour(material: ElementTree.Element) -> str | None:
    """A material's colour, ``#rrggbb``; empty: none that can be read; None: it cannot be seen."""
    color = material.find("color")
    try:
        red, green, blue, alpha = numbers(ElementTree.Element("color") if color is None else color, "rgba", 4)
    except ValueError:
        return ""
    return None if alpha <= 0 else hex_of([red, green, blue])


def _texture(material: ElementTree.Element, folder: Path, packages: Packages) -> str:
    """The file of a material's texture; empty: none that is there."""
    texture = material.find("texture")
    name = "" if texture is None else texture.get("filename", "")
    return str(mesh_path(name, folder, packages) or "") if name else ""


def hex_of(rgb: Iterable[float]) -> str:
    """Shares of red, green and blue, 0 to 1, as ``#rrggbb``."""
    return "#" + "".join(f"{round(255 * min(max(share, 0.0), 1.0)):02X}" for share in rgb)


def _shape(
    link: str, element: ElementTree.Element, folder: Path, packages: Packages, inline: Mapping[str, Triangles]
) -> Shape:
    """The shape of a <collision> or a <visual>.

    Raises:
        ValueError: no shape, or one without size.
        FileNotFoundError: the name of a mesh whose file is not found.
    """
    found = next((one for one in element.findall("geometry/*") if one.tag in _SIZES), None)
    if found is None:
        raise ValueError("no known shape")
    kind, path = one_of("shape", found.tag, _SIZES), ""
    try:
        sizes = [numbers(found, key, count, "1 1 1" if key == "scale" else None) for key, count in _SIZES[kind].items()]
    except ValueError as error:
        raise ValueError(f"<{kind}>: {error}") from error
    size = tuple(value for group in sizes for value in group)
    written = " ".join(f"{value:g}" for value in size)
    if not all(value != 0 if kind == "mesh" else LEAST <= value <= FARTHEST for value in size):
        raise ValueError(f"<{kind}> of size {written}")
    filename = found.get("filename", "")
    if kind == "mesh" and filename not in inline:
        file = mesh_path(filename, folder, packages)
        path = str(file or "")
        called = filename.replace("\\", "/").split("/")[-1]
        if called == _UNIT_SPHERE and (file is None or _is_unit_sphere(file)):
            kind, size, path = "ellipsoid", tuple(map(abs, size)), ""
            if not all(LEAST <= value <= FARTHEST for value in size):
                raise ValueError(f"<mesh> of scale {written}")
        elif file is None:
            raise FileNotFoundError(filename)
    triangles = inline.get(filename)
    path = filename if triangles else path
    return Shape(link=link, placement=placement_of(element), kind=kind, size=size, path=path, triangles=triangles)


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
            if is_there(place):
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
