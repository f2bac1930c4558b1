"""The file of an object that a data set names: by its path, its name or its code, in a folder of objects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pinograsp.checks import number, path_of, text_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.load import load_object
from pinograsp.objects.mesh import Mesh

_MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".dae")
_FILES = (*_MESHES, ".urdf", ".sdf", ".xml")
# Within an object's own folder, in the data sets' layouts: convex parts first, then whole surfaces.
_INSIDE = (
    *("coacd/decomposed.obj", "urdf/meshes/*.obj", "urdf/coacd*convex*.obj", "meshes/*.obj"),
    *("mesh/simplified.obj", "coacd/remeshed.obj", "mesh/*.obj", "*.obj", "*.stl", "*.ply", "*.glb"),
)


def find_object(folder: str | Path, name: str) -> list[Path]:
    """The file, or the files of the parts, of the object of that name.

    Looked for are, in this order: the name as a path in the folder, its last parts, with the endings of meshes and of
    URDF, SDF and MJCF files; then a folder of that name with ``coacd/decomposed.obj``, ``urdf/meshes/*.obj``,
    ``mesh/simplified.obj``, or one mesh.

    Raises:
        InvalidInput: no such folder, or no such object in it.
    """
    folder, name = path_of("folder of objects", folder), text_of("object", name)
    if not folder.is_dir():
        raise InvalidInput(f"folder of objects: expected a folder, got '{folder}', which is none")
    for place in _places(folder, name):
        if place.is_file():
            return [place]
        for ending in _FILES:
            one = place.with_name(place.name + ending)
            if one.is_file():
                return [one]
        if place.is_dir():
            for pattern in _INSIDE:
                found = sorted(place.glob(pattern))
                if found:
                    return found
    raise InvalidInput(
        f"object '{name}': expected a mesh, or a folder with one, of that name in '{folder}', found none; looked for "
        f"{', '.join(repr(str(one.relative_to(folder))) for one in _places(folder, name))}"
    )


def _places(folder: Path, name: str) -> Iterator[Path]:
    """Where it may be: paths in data sets begin anywhere above the folder of objects."""
    parts = [part for part in Path(name.replace("\\", "/")).parts if part not in ("/", "..", ".")]
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
    if files[0].suffix.lower() in _MESHES:
        return Mesh.load(files, scale=scale, mass=mass, density=density)
    if scale != 1.0:
        raise InvalidInput(
            f"object '{name}': expected a mesh, since the grasps are of one enlarged {scale:g} times, got '{files[0]}'"
        )
    return load_object(files[0], mass=mass, density=density)
