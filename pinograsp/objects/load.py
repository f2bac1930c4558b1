"""One object from its URDF, SDF or MJCF file: an exact primitive, or the union of its collision shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import flag, instance_of, number, path_of, placement_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body, InertiaImpossible
from pinograsp.objects.ellipsoid import Ellipsoid
from pinograsp.objects.mesh import Mesh
from pinograsp.objects.mesh_checks import convex_surface
from pinograsp.objects.mesh_files import find_bounds, read_surface
from pinograsp.objects.mesh_union import one_of_several
from pinograsp.objects.primitives import Box, Capsule, Cylinder, Sphere
from pinograsp.spatial import Array, IntArray

if TYPE_CHECKING:
    import mujoco

    from pinograsp.objects.description import CollisionShape, Description

_Solid = TypeVar("_Solid", bound=Body)

# A primitive whose centre of mass is this near to its middle is homogeneous: files give few digits.
_CENTRED = 1e-5  # [m]
# Sections and subdivisions of round shapes in unions, by the number of shapes: within 0.06, 0.25 and 1 % of the radius.
_DETAIL = ((30, 96, 4), (150, 48, 3), (1000, 24, 2))


def load_object(
    path: str | Path | mujoco.MjSpec,
    *,
    mass: float | None = None,
    density: float | None = None,
    hulls: bool = False,
    packages: Mapping[str, str | Path] | None = None,
    pose: ArrayLike | None = None,
    body: str | None = None,
) -> Body:
    """Load the object in a URDF, SDF or MJCF file: its collision shapes in their places, as one solid, with the file's
    mass.

    One box, sphere, cylinder, capsule or ellipsoid stays exact; several shapes become their union (needs the extra
    ``mesh``). The file's centre of mass and inertia are kept. Files often hold an inertia that no solid of that mass
    and size can have; it is replaced by that of a homogeneous solid, and ``notes`` say so. In an MJCF file, bodies
    fixed to a body belong to it, shapes that touch nothing are left out, and shapes without a mass have MuJoCo's 1000
    kg/m^3.

    Args:
        path: ``.urdf``, ``.sdf`` or MuJoCo's ``.xml``; the text of such a file; or a ``mujoco.MjSpec``, which is not
            changed.
        mass: replaces the file's [kg]; the centre of mass and the shape of the inertia stay.
        density: of a homogeneous solid, instead of the file's mass, centre of mass and inertia [kg/m^3].
        hulls: use the convex hull of each mesh, as physics engines do; for meshes that are not closed.
        packages: folders of ROS packages, ``{name: folder}``, for ``package://name/``.
        pose: oMb (4, 4), the frame of the file (of the link in URDF, of the model in SDF, of the body in MJCF) in the
            world [m]; default: the world's.
        body: which of an MJCF file's bodies; default: the only free one, or the only one.

    Returns:
        The object; its body frame is that of the file.

    Raises:
        InvalidInput: no such file, several links or bodies, moving joints, a mesh that is missing or does not bound a
            solid, no mass.
    """
    from pinograsp.hands.elements import is_text  # with Pinocchio, slow to import
    from pinograsp.hands.ros_packages import packages_of
    from pinograsp.objects.object_file import read_object_file

    if type(path).__name__ == "MjSpec":
        name = "MjSpec"
    elif isinstance(path, str) and is_text(path):
        name = "text"
    else:
        path = path_of("object file", path)
        name = str(path)
    flag("hulls", hulls)
    pose = np.eye(4) if pose is None else placement_of("pose", pose)
    instance_of("body", body, str, type(None))
    found = read_object_file(path, name, packages_of(packages), body)
    if mass is None and density is None:
        mass = found.mass
        if mass is None:
            raise InvalidInput(f"object file '{name}': it gives no mass: give mass= [kg] or density= [kg/m^3]")
    elif mass is not None:
        mass = number("mass", mass, above=0, unit="kg")
    given: dict[str, Any] = {"pose": pose, "mass": mass} | ({} if density is None else {"density": density})
    com, inertia = found.com, found.inertia
    if density is not None:
        com = inertia = None
    elif inertia is not None and mass is not None and found.mass is not None:
        inertia = inertia * (mass / found.mass)
    try:
        solid = _solid(found, com, inertia, given, hulls)
    except InvalidInput as error:
        raise InvalidInput(f"object file '{name}': {error}".replace("convex=True", "hulls=True")) from None
    if found.notes:
        solid._set(notes=(*solid.notes, *found.notes))
    return solid


def _solid(
    found: Description,
    com: Array | None,
    inertia: Array | None,
    given: dict[str, Any],
    hulls: bool,
) -> Body:
    part = found.parts[0]
    alone = len(found.parts) == 1
    if alone and part.kind != "mesh" and (com is None or np.linalg.norm(com - part.pose[:3, 3]) < _CENTRED):
        return _with_inertia(lambda **more: _primitive(part, {"shape_b": part.pose, **given, **more}), inertia)
    notes: tuple[str, ...] = ()
    surfaces = _surfaces(found.parts, hulls)
    if alone:
        ((vertices, faces),) = surfaces.values()
    else:
        vertices, faces, notes = one_of_several(surfaces)
    given = {"vertices": vertices, "faces": faces, "com": com, "notes": notes, "convex": alone and hulls, **given}
    given["regions"] = {} if alone else _regions(found.parts, surfaces)
    return _with_inertia(lambda **more: Mesh(**given, **more), inertia)


def _regions(parts: Sequence[CollisionShape], surfaces: Mapping[str, tuple[Array, IntArray]]) -> dict[str, Array]:
    """Boxes (2, 3) about the shapes that have a name, in the file's frame [m]; of one name: about all of them.

    ``surfaces``: vertices and faces of each of the shapes, in their order.
    """
    found: dict[str, list[Array]] = {}
    for part, (vertices, _) in zip(parts, surfaces.values()):
        if part.name:
            found.setdefault(part.name, []).append(vertices)
    return {name: find_bounds(np.concatenate(points)) for name, points in found.items()}


def _with_inertia(make: Callable[..., _Solid], inertia: Array | None) -> _Solid:
    """What is made with that inertia, or without it where it is impossible, which is noted."""
    if inertia is None:
        return make()
    try:
        return make(inertia=inertia)
    except InertiaImpossible as error:
        body = make()
        body._set(notes=(*body.notes, f"the file's inertia cannot be, that of a homogeneous solid is used: {error}"))
        return body


def _primitive(part: CollisionShape, given: dict[str, Any]) -> Body:
    size = part.size
    if part.kind == "box":
        return Box(size=np.array(size), **given)
    if part.kind == "sphere":
        return Sphere(radius=size[0], **given)
    if part.kind == "cylinder":
        return Cylinder(radius=size[0], height=size[1], **given)
    if part.kind == "capsule":
        return Capsule(radius=size[0], length=size[1], **given)
    return Ellipsoid(semi_axes=np.array(size), **given)


def _surfaces(parts: Sequence[CollisionShape], hulls: bool) -> dict[str, tuple[Array, IntArray]]:
    """Vertices and faces of shapes in the file's frame, by their number and kind; each file is read once."""
    from pinograsp.hands.mesh_file import MOST_TRIANGLES  # with Pinocchio, slow to import

    read: dict[Path, tuple[Array, IntArray]] = {}
    surfaces: dict[str, tuple[Array, IntArray]] = {}
    total = 0
    _, sections, subdivisions = next(one for one in _DETAIL if len(parts) <= one[0])
    for place, part in enumerate(parts, 1):
        if part.triangles is not None:
            vertices, faces = convex_surface(*part.triangles) if hulls else part.triangles
        elif part.path is None:
            vertices, faces = _round_or_box(part, sections, subdivisions)
        else:
            if part.path not in read:
                read[part.path] = read_surface(part.path)
            vertices, faces = _scale(*read[part.path], part.size, hulls)
        total += len(faces)
        if total > MOST_TRIANGLES:
            raise InvalidInput(
                f"expected at most {MOST_TRIANGLES} triangles in all shapes, got {total} in the first {place} of "
                f"{len(parts)}: simplify the meshes"
            )
        surfaces[f"{place} ({part.kind})"] = vertices @ part.pose[:3, :3].T + part.pose[:3, 3], faces
    return surfaces


def _scale(vertices: Array, faces: IntArray, scale: Sequence[float], hulls: bool) -> tuple[Array, IntArray]:
    """A mesh in metres, or its convex hull."""
    vertices = vertices * np.array(scale)
    if np.prod(scale) < 0:  # mirrored
        faces = faces[:, ::-1]
    return convex_surface(vertices, faces) if hulls else (vertices, faces)


def _round_or_box(part: CollisionShape, sections: int, subdivisions: int) -> tuple[Array, IntArray]:
    """A primitive as triangles, in its own frame."""
    import trimesh

    size = part.size
    made: Any
    # Round ones are made at radius 1: trimesh takes triangles of small ones for points.
    if part.kind == "box":
        made = trimesh.creation.box(size)
    elif part.kind == "cylinder":
        made = trimesh.creation.cylinder(radius=1.0, height=size[1] / size[0], sections=sections)
        made.apply_scale(size[0])
    elif part.kind == "capsule":
        made = trimesh.creation.capsule(radius=1.0, height=size[1] / size[0], count=[sections, sections // 2])
        made.apply_scale(size[0])
        made.apply_translation([0, 0, -made.bounds[:, 2].mean()])
    else:
        made = trimesh.creation.icosphere(subdivisions=subdivisions)
        made.apply_scale(size if part.kind == "ellipsoid" else size[0])
    return np.array(made.vertices), np.array(made.faces, dtype=np.int64)
