"""From any triangles to a closed surface that bounds one solid, or to an explanation of why they do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, floats_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.triangles import TriangleSurface
from pinograsp.spatial import FARTHEST, Array, BoolArray, IntArray

# A solid whose volume is less than this part of its bounding cube is a sheet: millions of times thinner than wide.
_SHEET = 1e-12
# Vertices whose spread across is less than this part of that along lie in one plane, as far as Qhull can tell.
_FLAT = 1e-9
_FILLED = 1e-3  # of the hull's volume that a convex surface may lack
# Holes with no more than this part of the edges, and of the surface once they are closed, are flaws of a scan; a larger
# one is an opening that somebody may have meant.
_FLAW_EDGES, _FLAW_AREA = 1e-2, 2e-3
_MOST_PARTS = 3000
_HULL = "or use its convex hull: convex=True"


def convex_surface(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, IntArray]:
    """Vertices and outward faces of the convex hull."""
    import trimesh

    vertices, _ = _merge(vertices, faces)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if spread[2] <= _FLAT * spread[0]:
        raise InvalidInput(
            f"mesh: expected vertices around a volume, got {len(vertices)} in one plane or line: check the file"
        )
    hull = trimesh.convex.convex_hull(vertices)
    return np.array(hull.vertices), np.array(hull.faces)


def is_convex(vertices: ArrayLike, faces: ArrayLike) -> bool:
    """Whether a closed surface is that of its convex hull, up to a thousandth of the volume."""
    from trimesh.triangles import mass_properties

    hull = convex_surface(vertices, faces)
    volumes = [
        abs(float(mass_properties(np.asarray(v, dtype=float)[np.asarray(f)], skip_inertia=True).volume))
        for v, f in (hull, (vertices, faces))
    ]
    return volumes[1] >= (1 - _FILLED) * volumes[0]


class PartsMeet(InvalidInput):
    """A surface whose parts touch or overlap."""


def closed_surface(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, IntArray, tuple[str, ...]]:
    """Vertices, faces wound outwards, and notes of what was changed.

    Raises:
        PartsMeet: edges with more than two faces, overlapping parts.
        InvalidInput: holes, faces wound both ways, no volume.
    """
    vertices, faces = _merge(vertices, faces)
    vertices, faces, mended = _without_flaws(vertices, faces)
    _check_edges(vertices, faces)
    label = part_labels(len(vertices), faces)
    count = label.max() + 1
    volumes = np.array([_volume(vertices, part) for part in group(faces, label[faces[:, 0]])])
    outward = np.where(_depths(vertices, faces, label, count) % 2 == 0, volumes > 0, volumes < 0)
    if outward.all():
        return vertices, faces, mended
    if not outward.any():
        return vertices, faces[:, ::-1].copy(), (*mended, "the mesh was inside out: its faces were turned round")
    part = int(np.argmin(outward))
    raise InvalidInput(
        f"mesh: expected parts wound outwards and cavities wound inwards, got part {part + 1} of {count} (at "
        f"{_place(vertices[label == part][0])}) the other way round, or one solid inside another: turn or remove that "
        f"part (trimesh: part.invert()), {_HULL}"
    )


def _merge(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, IntArray]:
    """Checked arrays, vertices at the same place merged, without faces that then have fewer than three corners."""
    import trimesh

    vertices, faces = floats_of("mesh vertices", vertices), floats_of("mesh faces", faces)
    if vertices.size == 0 or faces.size == 0:
        raise InvalidInput(
            "mesh: expected vertices (n, 3) and faces (m, 3), got an empty mesh: check that the file holds triangles"
        )
    vertices = _numbers("mesh vertices", vertices)
    if np.abs(vertices).max() > FARTHEST:
        raise InvalidInput(
            f"mesh: expected vertices within {FARTHEST:g} m, got one more than {FARTHEST:g} m off: are the units right?"
        )
    indices = _numbers("mesh faces", faces)
    faces = indices.astype(np.int64)
    if np.any(faces != indices) or faces.min() < 0 or faces.max() >= len(vertices):
        raise InvalidInput(
            f"mesh faces: expected whole numbers from 0 to {len(vertices) - 1}, one per corner, got values from "
            f"{indices.min():g} to {indices.max():g}"
        )
    merged = trimesh.Trimesh(vertices, faces, process=True)
    vertices, faces = np.array(merged.vertices), np.array(merged.faces, dtype=np.int64)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    if len(used) < 4:
        raise InvalidInput(
            "mesh: expected at least four corners that differ by more than 1e-8 m, got "
            f"{len(used)}: are the units right? (scale=0.001 for millimetres)"
        )
    return vertices[used], faces


def _without_flaws(vertices: Array, faces: IntArray) -> tuple[Array, IntArray, tuple[str, ...]]:
    """The mesh with its small holes closed, as scans have them, and a note; or as it is."""
    import trimesh

    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    counts = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_counts=True)[1]
    count = int(np.sum(counts == 1))
    if not 0 < count <= _FLAW_EDGES * len(counts):
        return vertices, faces, ()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    area = float(mesh.area)
    trimesh.repair.fill_holes(mesh)
    more = float(mesh.area) / area - 1
    if not mesh.is_watertight or more > _FLAW_AREA:
        return vertices, faces, ()
    note = f"small holes ({count} open edges) were closed, {100 * more:.2g} % of the surface"
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), (note,)


def _numbers(name: str, value: ArrayLike) -> Array:
    """A finite array (any, 3); its message stays short however many numbers came."""
    try:
        broken = ~np.isfinite(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        raise InvalidInput(f"{name}: expected numbers of shape (any, 3), got something else") from None
    if np.any(broken):
        raise InvalidInput(f"{name}: expected finite numbers, got {broken.sum()} that are not")
    return array_of(name, value, (None, 3))


def _check_edges(vertices: Array, faces: IntArray) -> None:
    n = len(vertices)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    edges, index, counts = np.unique(low * n + high, return_inverse=True, return_counts=True)
    balance = np.bincount(index.ravel(), weights=np.where(start < end, 1, -1))

    def first(which: BoolArray) -> str:
        return _place(vertices[list(divmod(int(edges[np.argmax(which)]), n))].mean(axis=0))

    if np.any(counts == 1):
        raise InvalidInput(
            f"mesh: expected a watertight surface, got {np.sum(counts == 1)} open edges of {len(edges)} (the first at "
            f"{first(counts == 1)}): close the holes (trimesh.repair.fill_holes, MeshLab, Blender), {_HULL}"
        )
    if np.any(counts != 2):
        raise PartsMeet(
            f"mesh: expected two faces at every edge, got {np.sum(counts != 2)} edges with more (the first at "
            f"{first(counts != 2)}): remove double and internal faces (MeshLab, Blender; trimesh: "
            f"mesh.update_faces(mesh.unique_faces())), {_HULL}"
        )
    if np.any(balance != 0):
        raise InvalidInput(
            f"mesh: expected faces wound one way, got {np.sum(balance != 0)} edges where neighbours disagree (the "
            f"first at {first(balance != 0)}): make them agree (trimesh.repair.fix_winding, MeshLab, Blender), {_HULL}"
        )


def _place(point: Array) -> str:
    return f"{(1e3 * point).round(3).tolist()} mm"


def _volume(vertices: Array, faces: IntArray) -> float:
    """Signed volume [m^3]; a surface without volume is refused."""
    used = np.unique(faces)
    centre = vertices[used].mean(axis=0)
    volume = float(np.linalg.det(vertices[faces] - centre).sum() / 6)
    if abs(volume) <= _SHEET * np.ptp(vertices[used], axis=0).max() ** 3:
        raise InvalidInput(
            f"mesh: expected a surface around a volume, got {abs(volume):.3g} m^3 at {_place(centre)}: give the sheet "
            "a thickness, or repair the surface if it crosses itself"
        )
    return volume


def part_labels(count: int, faces: IntArray) -> IntArray:
    """Number (n,) of the connected part each vertex belongs to.

    Raises:
        InvalidInput: more parts than an object has.
    """
    from scipy.sparse import coo_array  # slow to import, and only meshes need it
    from scipy.sparse.csgraph import connected_components

    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(count, count))
    labels: IntArray = connected_components(graph, directed=False)[1]
    found = len(np.unique(labels[faces[:, 0]]))  # vertices of no face are no parts
    if found > _MOST_PARTS:
        raise InvalidInput(
            f"mesh: expected one solid, or at most {_MOST_PARTS} parts, got {found}: remove the specks (MeshLab, "
            f"Blender), {_HULL}"
        )
    return labels


def group(rows: IntArray, label: IntArray) -> list[IntArray]:
    """The rows of each label, from 0 on."""
    order = np.argsort(label, kind="stable")
    return np.split(rows[order], np.cumsum(np.bincount(label))[:-1])


def _depths(vertices: Array, faces: IntArray, label: IntArray, count: int) -> IntArray:
    """In how many other parts each part lies (count,): an even number for solids, an odd one for cavities.

    Raises:
        InvalidInput: parts whose surfaces meet.
    """
    depths = np.zeros(count, dtype=int)
    if count == 1:
        return depths
    import coal  # slow to import, and so are hands

    from pinograsp.hands.mesh_file import collision_model

    own = group(np.arange(len(vertices)), label)
    members = [vertices[which] for which in own]
    low, high = np.array([v.min(axis=0) for v in members]), np.array([v.max(axis=0) for v in members])
    numbers = np.empty(len(vertices), dtype=np.int64)  # of each vertex within its part
    for which in own:
        numbers[which] = np.arange(len(which))
    of_part = group(numbers[faces], label[faces[:, 0]])
    models, surfaces, here = {}, {}, coal.Transform3s.Identity()
    for i, j in _boxes_meet(low, high):
        for part in (i, j):
            if part not in models:
                models[part] = collision_model(members[part], of_part[part])
                surfaces[part] = TriangleSurface(members[part], of_part[part])
        result = coal.CollisionResult()
        if coal.collide(models[i], here, models[j], here, coal.CollisionRequest(), result):
            where = result.getContact(0).pos
            raise PartsMeet(
                f"mesh: expected parts that do not touch each other, got parts {i + 1} and {j + 1} of {count} meeting "
                f"at {_place(where)}: unite them (trimesh.boolean.union, Blender), {_HULL}"
            )
        for inner, outer in ((i, j), (j, i)):
            depths[inner] += abs(surfaces[outer].winding_number(members[inner][:1])[0]) > 0.5
    return depths


def _boxes_meet(low: Array, high: Array) -> Iterator[tuple[int, int]]:
    """Pairs of boxes (n, 3) that have points in common, the smaller number first, in order."""
    for i in range(len(low)):
        for j in np.flatnonzero(np.all((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i]), axis=1)):
            yield i, i + 1 + int(j)
