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


def read_regions(path: Path) -> dict[str, Array]:
    """Boxes (2, 3) about the parts of a mesh file that have a name, in the file's units: an OBJ's objects or groups,
    the nodes of a GLB or DAE scene. Files of one part have none.
    """
    kind = path.suffix.lower()
    if kind not in (".obj", ".glb", ".dae"):
        return {}
    try:
        points = _read_groups(path) if kind == ".obj" else _read_nodes(path)
    except (ValueError, IndexError):  # lines that trimesh reads otherwise
        return {}
    return {name: find_bounds(part) for name, part in points.items()} if len(points) > 1 else {}


def _read_nodes(path: Path) -> dict[str, Array]:
    """The vertices at each node of a scene, in its frame."""
    import trimesh  # slow to import

    from pinograsp.hands.mesh_file import load_mesh_file

    scene = load_mesh_file(path)
    if not isinstance(scene, trimesh.Scene):
        return {}
    placed = ((str(node), *scene.graph[node]) for node in scene.graph.nodes_geometry)
    return {node: trimesh.transform_points(scene.geometry[name].vertices, pose) for node, pose, name in placed}


def _read_groups(path: Path) -> dict[str, Array]:
    """The corners of the faces of each object (``o``) of an OBJ file, or of each group (``g``) where it has these."""
    vertices: list[list[float]] = []
    faces: dict[str, dict[str, list[int]]] = {"o": {}, "g": {}}
    name = {"o": "", "g": ""}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind in name:
            name[kind] = " ".join(words)
        elif kind == "f":
            corners = [int(word.partition("/")[0]) for word in words]
            for of, one in name.items():
                if one:
                    into = faces[of].setdefault(one, [])
                    into += [i - 1 if i > 0 else len(vertices) + i for i in corners]
    points = np.array(vertices).reshape(-1, 3)
    named = max(faces.values(), key=len)
    return {one: points[sorted(set(corners))] for one, corners in named.items()}


def find_bounds(points: Array) -> Array:
    """Lower and upper corner (2, 3) of points (n, 3), a hair apart where these are flat."""
    hair = 1e-9
    return np.array([points.min(axis=0) - hair, points.max(axis=0) + hair])


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
