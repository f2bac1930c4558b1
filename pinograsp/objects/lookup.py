"""The file of an object that a data set names: by its path, its name or its code, in a folder of objects."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from pinograsp.checks import number, path_of, text_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.load import load_object
from pinograsp.objects.mesh import Mesh
from pinograsp.words import printable

MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".dae")
_DEEPEST, _SHOWN = 32, 6  # parts of a name that are looked for; places that a message names
_FILES = (*MESHES, ".urdf", ".sdf", ".xml")
# Within an object's own folder, in the data sets' layouts: convex parts first, then whole surfaces.
_INSIDE = (
    *("coacd/decomposed.obj", "urdf/meshes/*.obj", "urdf/coacd*convex*.obj", "meshes/*.obj"),
    *("mesh/simplified.obj", "coacd/remeshed.obj", "mesh/*.obj", "*.obj", "*.stl", "*.ply", "*.glb"),
)


def find_object(folder: str | Path, name: str) -> list[Path]:
    """The file, or the files of the parts, of the object of that name.

    Looked for are, in this order: the name as a path in the folder, its last parts, with the endings of meshes and of
    URDF, SDF and MJCF files; then a folder of that name with ``coacd/decomposed.obj``, ``urdf/meshes/*.obj``,
    ``mesh/simplified.obj``, or one mesh. Where ``folder`` is a file, it is the object, whatever its name.

    Raises:
        InvalidInput: no such folder, or no such object in it.
    """
    folder, name = path_of("folder of objects", folder), text_of("object", name)
    if os.path.isfile(folder):
        return [folder]
    if not os.path.isdir(folder):
        raise InvalidInput(
            f"folder of objects: expected a folder, or the file of one object, got '{folder}', which is none"
        )
    for place in _places(folder, name):
        if os.path.isfile(place):
            return [place]
        for ending in _FILES:
            one = place.with_name(place.name + ending)
            if os.path.isfile(one):
                return [one]
        if os.path.isdir(place):
            for pattern in _INSIDE:
                found = sorted(one for one in place.glob(pattern) if os.path.isfile(one))
                if found:
                    return found
    looked = [printable(str(one.relative_to(folder))) for one in _places(folder, name)]
    more = f" and {len(looked) - _SHOWN} more" if len(looked) > _SHOWN else ""
    raise InvalidInput(
        f"object '{printable(name)}': expected a mesh, or a folder with one, of that name in '{folder}', found none; "
        f"looked for {', '.join(map(repr, looked[:_SHOWN])) or 'nothing'}{more}; if all grasps are of one object, give "
        "its file instead of the folder"
    )


def _places(folder: Path, name: str) -> Iterator[Path]:
    """Where it may be: paths in data sets begin anywhere above the folder of objects."""
    parts = [part for part in Path(name.replace("\\", "/")).parts if part not in ("/", "//", "..", ".")][-_DEEPEST:]
    for start in range(len(parts)):
        yield folder.joinpath(*parts[start:])
    if parts and (stem := Path(parts[-1]).stem) != parts[-1]:
        yield folder / stem


def object_in(
    folder: str | Path, name: str, *, scale: float = 1.0, mass: float | None = None, density: float | None = None
) -> Body:
    """The object of that name, its file's frame in the world's, enlarged by ``scale``.

    Raises:
        InvalidInput: no such object, or one that is refused, see :class:`Mesh` and :func:`load_object`.
    """
    scale = number("scale of the object", scale, above=0)
    files = find_object(folder, name)
    if files[0].suffix.lower() in MESHES:
        return Mesh.load(files, scale=scale, mass=mass, density=density)
    if scale != 1.0:
        raise InvalidInput(
            f"object '{name}': expected a mesh, since the grasps are of one enlarged {scale:g} times, got '{files[0]}'"
        )
    return load_object(files[0], mass=mass, density=density)
