"""Collision and visual shapes of a URDF, and the mesh files its names mean."""

from __future__ import annotations

import os
import urllib.parse
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pinograsp.hands.elements import LEAST
from pinograsp.hands.file_reads import is_there
from pinograsp.hands.geometry import UNSEEN, Kind, Shape, Triangles, read_mesh
from pinograsp.hands.ros_packages import Packages
from pinograsp.hands.urdf_file import CAPSULE, ELLIPSOID, NO_SHAPE
from pinograsp.spatial import FARTHEST

if TYPE_CHECKING:
    import yourdfpy

_MOST_VISUALS = 2000
_UNIT_SPHERE = "unit_sphere.stl"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshNames:
    """What the names of meshes and pictures in a description mean.

    Attributes:
        folder: relative paths start there.
        packages: folders of ROS packages, by name.
        inline: vertices and faces of meshes that come from no file, by the names that the description has for them.
    """

    folder: Path
    packages: Packages = field(default_factory=lambda: MappingProxyType({}))
    inline: Mapping[str, Triangles] = field(default_factory=lambda: MappingProxyType({}))

    def find(self, name: str) -> Path | None:
        """The file that a name means, or None."""
        return mesh_path(name, self.folder, self.packages)


def read_shapes(robot: yourdfpy.Robot, names: MeshNames, notes: list[str]) -> list[Shape]:
    """Collision shapes; those without size and those whose file is missing are left out and noted.

    So are coarse shapes for a controller's own checks of self-collision: those of a link that is fixed to another and
    called as that one and ``_sc``, as Franka's. URDF has no ellipsoid. A mesh called ``unit_sphere.stl`` with a scale
    stands for one and becomes the exact shape.
    """
    shapes: list[Shape] = []
    missing: list[str] = []
    void: list[str] = []
    coarse = _find_coarse(robot)
    for link in robot.links:
        if link.name in coarse:
            continue
        for collision in link.collisions:
            try:
                shapes.append(_read_shape(link.name, collision, names))
            except FileNotFoundError as error:
                missing.append(f"{link.name} ({error})")
            except ValueError as error:
                void.append(f"{link.name} ({error})")
    if coarse:
        notes.append(f"coarse shapes for checks of self-collision are left out: {', '.join(coarse)}")
    if missing:
        notes.append(f"meshes not found, {UNSEEN} (packages= gives the folders of ROS packages): {', '.join(missing)}")
    if void:
        notes.append(f"shapes left out: {', '.join(void)}")
    return shapes


def choose_shapes(shapes: list[Shape], visuals: list[Shape], moved: Collection[str], notes: list[str]) -> list[Shape]:
    """The collision shapes; where no link that is ``moved`` has one, also what is seen of the links without, noted."""
    shaped = {shape.link for shape in shapes}
    seen = [shape for shape in visuals if shape.link not in shaped]
    if not shaped.isdisjoint(moved) or {shape.link for shape in seen}.isdisjoint(moved):
        return shapes
    notes.append("no link that moves has collision shapes: what is seen of the links stands for them")
    return [*shapes, *seen]


def _find_coarse(robot: yourdfpy.Robot) -> list[str]:
    """Links with shapes, called as a link with shapes of its own that they are fixed to, and ``_sc``."""
    shaped = {link.name for link in robot.links if link.collisions}
    return [
        joint.child
        for joint in robot.joints
        if joint.type == "fixed" and joint.child == f"{joint.parent}_sc" and {joint.child, joint.parent} <= shaped
    ]


def read_visuals(robot: yourdfpy.Robot, names: MeshNames) -> list[Shape]:
    """What is seen of the links, with the description's colours and textures; what cannot be read is left out.

    Meshes that are not found keep the name that the description gives them.
    """
    visuals = [(link.name, visual) for link in robot.links for visual in link.visuals][:_MOST_VISUALS]
    materials = [*robot.materials, *(visual.material for _, visual in visuals if visual.material is not None)]
    colours: dict[str, str | None] = {}
    textures: dict[str, str] = {}
    for one in materials:
        if one.name and one.color is not None:
            colours.setdefault(one.name, _read_colour(one))
        if one.name and (texture := _find_texture(one, names)):
            textures.setdefault(one.name, texture)
    shapes: list[Shape] = []
    for link, visual in visuals:
        colour: str | None = ""
        texture, material = "", visual.material
        if material is not None:
            own = material.color is not None
            colour = _read_colour(material) if own else colours.get(material.name, "")
            texture = _find_texture(material, names) or ("" if own else textures.get(material.name, ""))
        if colour is None:
            continue
        try:
            shape = _read_shape(link, visual, names)
        except FileNotFoundError as error:
            shape = Shape(link=link, placement=pin.SE3.Identity(), kind="mesh", size=(1, 1, 1), path=str(error))
        except ValueError:
            continue
        shapes.append(replace(shape, colour=colour, texture=texture))
    return shapes


def _read_colour(material: yourdfpy.Material) -> str | None:
    """A material's colour, ``#rrggbb``; empty: none that can be read; None: it cannot be seen."""
    rgba = material.color.rgba
    if not np.isfinite(rgba).all():
        return ""
    return None if rgba[3] <= 0 else hex_of(rgba[:3])


def _find_texture(material: yourdfpy.Material, names: MeshNames) -> str:
    """The file of a material's texture; empty: none that is there."""
    name = "" if material.texture is None else material.texture.filename
    return str(names.find(name) or "") if name else ""


def hex_of(rgb: Iterable[float]) -> str:
    """Shares of red, green and blue, 0 to 1, as ``#rrggbb``."""
    return "#" + "".join(f"{round(255 * min(max(share, 0.0), 1.0)):02X}" for share in rgb)


def _read_shape(link: str, shape: yourdfpy.Collision | yourdfpy.Visual, names: MeshNames) -> Shape:
    """The shape of a <collision> or a <visual>.

    Raises:
        ValueError: no shape, or one without size.
        FileNotFoundError: the name of a mesh whose file is not found.
    """
    kind, size, name = _read_size(shape.geometry)
    text, path, triangles = " ".join(f"{value:g}" for value in size), "", names.inline.get(name)
    if not all(value != 0 if kind == "mesh" else LEAST <= value <= FARTHEST for value in size):
        raise ValueError(f"<{kind}> of size {text}")
    if triangles is not None:
        path = name
    elif kind == "mesh":
        file = names.find(name)
        path = str(file or "")
        if name.replace("\\", "/").split("/")[-1] == _UNIT_SPHERE and (file is None or _is_unit_sphere(file)):
            kind, size, path = "ellipsoid", tuple(map(abs, size)), ""
            if not all(LEAST <= value <= FARTHEST for value in size):
                raise ValueError(f"<mesh> of scale {text}")
        elif file is None:
            raise FileNotFoundError(name)
    placement = pin.SE3.Identity() if shape.origin is None else pin.SE3(shape.origin)
    return Shape(link=link, placement=placement, kind=kind, size=size, path=path, triangles=triangles)


def _read_size(geometry: yourdfpy.Geometry) -> tuple[Kind, tuple[float, ...], str]:
    """Kind and size of a shape, in the order coal takes the latter, and the name of its mesh."""
    if geometry.box is not None:
        return "box", tuple(geometry.box.size.tolist()), ""
    if geometry.sphere is not None:
        return "sphere", (geometry.sphere.radius,), ""
    if geometry.cylinder is not None:
        return "cylinder", (geometry.cylinder.radius, geometry.cylinder.length), ""
    name = geometry.mesh.filename
    if name.startswith(NO_SHAPE):
        raise ValueError(name.removeprefix(NO_SHAPE))
    scale = (1.0, 1.0, 1.0) if geometry.mesh.scale is None else tuple(geometry.mesh.scale.tolist())
    if name == CAPSULE:
        return "capsule", scale[:2], ""
    return ("ellipsoid", scale, "") if name == ELLIPSOID else ("mesh", scale, name)


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
    from yourdfpy.urdf import filename_handler_ignore_directive as without_scheme

    plain = without_scheme(name)
    if name.startswith("file://") or "://" not in name:
        return [folder / plain]
    name = plain.lstrip("/")
    packages = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    package, _, inside = name.partition("/")
    places = [given[package] / inside] if package in given else []
    # Beside the file's own package, then where ROS looks, then the package's folder under another name.
    places += [*(above / name for above in (folder, *folder.parents)), *(p / name for p in packages)]
    inside = inside or name
    places += [above / inside for above in (folder, *list(folder.parents)[:3])]
    return [*places, *(p.parent / name for p in packages)]
