"""Which files a path means, and the triangles in them."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pinograsp.checks import items_of, one_of
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, IntArray

_MOST_FILES = 1000  # convex decompositions have less than a hundred parts


def mesh_files(path: str | Path | Sequence[str | Path]) -> list[Path]:
    """The mesh files of one object: a file, those of a folder or of a pattern in the order of their names, or several.

    Raises:
        InvalidInput: none, more than a thousand, or a link in a folder or of a pattern to a file that is no mesh.
    """
    from pinograsp.hands.mesh_file import FORMATS  # with Pinocchio, slow to import

    if not isinstance(path, str | Path):
        files = [Path(str(one)) for one in items_of("mesh files", path, str, Path)]
        where = "none"
    elif os.path.isdir(path):
        files = sorted(one for one in Path(path).iterdir() if one.suffix.lower() in FORMATS)
        where = f"none in the folder '{path}' that ends in {', '.join(FORMATS)}"
    elif not os.path.exists(path) and glob.has_magic(str(path)):
        files = sorted(Path(one) for one in glob.glob(str(path)) if os.path.isfile(one))
        where = f"none that fits '{path}'"
    else:
        return [Path(path)]
    if not files:
        raise InvalidInput(f"mesh files: expected one or more, got {where}: check the path")
    if len(files) > _MOST_FILES:
        raise InvalidInput(f"mesh files: expected at most {_MOST_FILES}, got {len(files)}: unite them first")
    if isinstance(path, str | Path):
        _check_links(files, FORMATS)
    return files


def _check_links(files: Sequence[Path], formats: Sequence[str]) -> None:
    """Refuse links to what is no mesh: whoever gave the folder need not have meant that file."""
    for one in files:
        target = os.path.realpath(one)
        if one.is_symlink() and os.path.splitext(target)[1].lower() not in formats:
            raise InvalidInput(
                f"mesh files: expected files or links to those that end in {', '.join(formats)}, got the link '{one}' "
                f"to '{target}': remove it, or give the files of the object one by one"
            )


def read_surface(path: Path) -> tuple[Array, IntArray]:
    """Vertices (n, 3) in the file's units, in metres where it says them (COLLADA), and faces (m, 3)."""
    from pinograsp.hands.mesh_file import FORMATS, read_triangles  # with Pinocchio, slow to import

    if not os.path.isfile(path):
        raise InvalidInput(f"mesh file: expected an existing file, got '{path}': check the path")
    one_of(f"format of mesh file '{path}'", path.suffix.lower(), FORMATS)
    try:
        vertices, faces = read_triangles(path, corners_alone=True)
    except (ValueError, OSError) as error:
        raise InvalidInput(f"mesh file '{path}': {error}") from error
    if len(vertices) == 3 * len(faces):  # of triangles without common corners, as in STL, nobody could tell the parts
        vertices, which = np.unique(vertices, axis=0, return_inverse=True)
        faces = which.reshape(-1)[faces]
    return vertices, faces
