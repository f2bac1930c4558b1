"""Solids that meet, as convex decompositions have them, made one solid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.errors import InvalidInput
from pinograsp.objects.mesh_checks import PartsMeet, closed_surface, group, is_convex, part_labels
from pinograsp.spatial import Array, IntArray

_INSTALL = "pip install 'pinograsp[mesh]'"
_MOST_PIECES = 256  # of a decomposition; a scan in more is none
# Parts that share a face up to the digits of a file touch, and stay apart in a union. They are enlarged until they
# meet, by these lengths at their farthest corners [m].
_ENLARGED = (0.0, 2e-5, 2e-4)


def one_solid(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, IntArray, tuple[str, ...]]:
    """As :func:`closed_surface`; what is none for its parts that meet becomes their union."""
    try:
        return closed_surface(vertices, faces)
    except PartsMeet as error:
        parts = _parts_of(np.asarray(faces, dtype=np.int64))
        if len(parts) < 2:
            raise
        refused = error
    try:
        vertices, faces, notes = _unite([_outward(np.asarray(vertices, dtype=float), part) for part in parts])
    except ImportError:
        raise InvalidInput(f"{refused}; {_INSTALL} unites the {len(parts)} parts") from None
    except InvalidInput as error:
        raise InvalidInput(f"{refused}; not united: {error}") from None
    return vertices, faces, (f"{len(parts)} parts that meet were united", *notes)


def one_of_several(surfaces: Mapping[str, tuple[Array, IntArray]]) -> tuple[Array, IntArray, tuple[str, ...]]:
    """The union of closed surfaces, by their names, whether they meet, lie apart or one within the other; with notes.

    Raises:
        InvalidInput: one that is not closed, by its name, or manifold3d (extra ``mesh``) is missing.
    """
    solids = []
    for name, (vertices, faces) in surfaces.items():
        try:
            solids.append(one_solid(vertices, faces)[:2])
        except InvalidInput as error:
            raise InvalidInput(f"part '{name}': {error}") from None
    try:
        vertices, faces, notes = _unite(solids)
    except ImportError:
        raise InvalidInput(f"mesh: expected one part, got {len(solids)}: {_INSTALL} unites them") from None
    return vertices, faces, (f"{len(solids)} parts were united", *notes)


def concatenate(surfaces: Iterable[tuple[Array, IntArray]]) -> tuple[Array, IntArray]:
    """The surfaces beside each other in one mesh."""
    given = list(surfaces)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in given[:-1])])
    faces = np.concatenate([faces + start for (_, faces), start in zip(given, starts)])
    return np.concatenate([vertices for vertices, _ in given]), faces


def convex_pieces(surfaces: Iterable[tuple[Array, IntArray]]) -> list[Array] | None:
    """The corners (n, 3) of each part of surfaces; None where it is one part, or one is not convex."""
    parts = [(vertices, part) for vertices, faces in surfaces for part in _parts_of(np.asarray(faces, dtype=np.int64))]
    if not 1 < len(parts) <= _MOST_PIECES:
        return None
    found: list[Array] = []
    for vertices, part in parts:
        used, own = np.unique(part, return_inverse=True)
        if len(used) < 4 or not is_convex(vertices[used], own.reshape(-1, 3)):
            return None
        found.append(vertices[used])
    return found


def _parts_of(faces: IntArray) -> list[IntArray]:
    """Faces of each part of a mesh: triangles that share corners by their numbers."""
    of = np.unique(part_labels(int(faces.max()) + 1, faces)[faces[:, 0]], return_inverse=True)[1]
    return group(faces, of.ravel())


def _outward(vertices: Array, faces: IntArray) -> tuple[Array, IntArray]:
    """One part alone, its vertices merged and its faces turned outwards."""
    import trimesh

    part = trimesh.Trimesh(vertices, faces, process=True)
    if part.volume < 0:
        part.invert()
    return np.array(part.vertices, dtype=float), np.array(part.faces, dtype=np.int64)


def _unite(
    solids: list[tuple[Array, IntArray]], enlarged: Sequence[float] = _ENLARGED
) -> tuple[Array, IntArray, tuple[str, ...]]:
    """Vertices and faces of the union of closed solids, and notes.

    Raises:
        ImportError: manifold3d (extra ``mesh``) is not installed.
        InvalidInput: a solid that is not closed, by its number, or a union that bounds no solid.
    """
    more, *further = enlarged
    vertices, faces = _union([(_enlarge(vertices, more), faces) for vertices, faces in solids])
    try:
        vertices, faces, notes = closed_surface(vertices, faces)
    except PartsMeet:
        if not further:
            raise
        return _unite(solids, further)
    grown = (f"they were enlarged by {1e3 * more:g} mm so that they meet",) if more else ()
    return vertices, faces, (*grown, *notes)


def _enlarge(vertices: Array, by: float) -> Array:
    """Vertices moved away from their middle, the farthest one by that length [m]."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    away = vertices - middle
    enlarged: Array = middle + away * (1 + by / float(np.linalg.norm(away, axis=1).max()))
    return enlarged


def _union(solids: list[tuple[Array, IntArray]]) -> tuple[Array, IntArray]:
    import manifold3d

    parts = []
    for number, (vertices, faces) in enumerate(solids, 1):
        part = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
        if part.status() != manifold3d.Error.NoError:
            raise InvalidInput(
                f"part {number} of {len(solids)} is not closed ({part.status().name}): repair it (MeshLab, Blender), "
                "or use the convex hull: convex=True"
            )
        parts.append(part)
    union = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add).to_mesh64()
    return np.array(union.vert_properties[:, :3], dtype=float), np.array(union.tri_verts, dtype=np.int64)
