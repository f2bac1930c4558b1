"""Links that are hollow or bent, in parts whose convex hulls are nearer to them: cut by planes where that pays."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from pinograsp.hands.mesh_file import collision_model, triangles_of
from pinograsp.spatial import Array
from pinograsp.words import few

_DEEP, _MUCH = 2e-3, 0.25  # [m] behind its hull, over so much of the hull's surface: a link worth cutting
_POINTS, _NAMED = 200, 4

_PLACES = np.linspace(0.0, 1.0, 9)[1:-1]  # of planes, along each axis of a part
_MOST = 8  # parts
_WORTH = 0.005  # of the whole hull's volume, that a cut has to take off
_GRID = 60  # cells along the longest side: points of one cell are one where volumes are compared


class _Cut(NamedTuple):
    """The best plane of a part: what it takes off [m^3], its axis and place [m]."""

    gain: float
    axis: int
    at: float


def cut_hollow_links(geometry: pin.GeometryModel, joints: Collection[int]) -> tuple[pin.GeometryModel, list[str]]:
    """The same geometry with the meshes that these joints carry in parts, where they are far behind their hulls.

    And notes on them. A part is the mesh's own surface between the planes: its hull has all of that in it.
    """
    cut, told = pin.GeometryModel(), list[str]()
    known: dict[bytes, list[Array]] = {}  # fingers often have the same mesh
    for one in geometry.geometryObjects:
        parts: list[Array] = []
        if one.parentJoint in joints and isinstance(one.geometry, coal.BVHModelBase):
            vertices, faces = triangles_of(one.geometry)
            key = vertices.tobytes()
            if key not in known:
                hollow = np.mean(_gaps(one.geometry, vertices) > _DEEP) > _MUCH
                known[key] = cut_in_parts(vertices[faces]) if hollow else []
            parts = known[key]
        if len(parts) < 2:
            cut.addGeometryObject(one)
            continue
        told.append(f"{one.name} ({len(parts)})")
        for i, part in enumerate(parts):
            # In single precision, as records of hands keep meshes.
            corners = part.reshape(-1, 3).astype(np.float32).astype(float)
            form = collision_model(corners, np.arange(3 * len(part)).reshape(-1, 3))
            cut.addGeometryObject(
                pin.GeometryObject(f"{one.name}.{i}", one.parentJoint, one.parentFrame, one.placement, form)
            )
    return cut, [f"hollow or bent links are represented by convex parts: {few(told, _NAMED)}"] if told else []


def _gaps(mesh: coal.BVHModelBase, points: Array) -> Array:
    """Distances [m] of a mesh from points that are spread over the hull of others (n, 3); none where these are flat."""
    try:
        hull = ConvexHull(points, qhull_options="Qt")
    except (QhullError, ValueError):
        return np.zeros(1)
    faces, draw = points[hull.simplices], np.random.default_rng(0)
    areas = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    drawn = faces[draw.choice(len(faces), _POINTS, p=areas / areas.sum())]
    spread = np.einsum("ni,nij->nj", draw.dirichlet(np.ones(3), _POINTS), drawn)
    point, own, request, result = coal.Sphere(1e-7), coal.Transform3s(), coal.DistanceRequest(), coal.DistanceResult()
    found = []
    for at in spread:
        result.clear()
        found.append(coal.distance(mesh, own, point, coal.Transform3s(np.eye(3), at), request, result))
    return np.array(found)


def cut_in_parts(triangles: Array) -> list[Array]:
    """Triangles (t, 3, 3) in parts whose hulls together are small, between planes along the axes of their frame; one
    part where no plane is worth it.
    """
    whole = _volume(triangles.reshape(-1, 3))
    parts = [(triangles, _best_cut(triangles, whole))]
    while len(parts) < _MOST:
        i = max(range(len(parts)), key=lambda i: parts[i][1].gain)
        part, cut = parts[i]
        if not cut.gain > _WORTH * whole:
            break
        sides = (_clip(part, cut.axis, cut.at, 1.0), _clip(part, cut.axis, cut.at, -1.0))
        parts[i : i + 1] = [(side, _best_cut(side, whole)) for side in sides]
    return [part for part, _ in parts]


def _best_cut(part: Array, whole: float) -> _Cut:
    points = part.reshape(-1, 3)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    hull = _volume(points)
    best = _Cut(0.0, 0, 0.0)
    if hull <= _WORTH * whole:
        return best
    for axis in range(3):
        for place in _PLACES:
            at = float(low[axis] + place * size[axis])
            sides = [_volume(_side(part, axis, at, sign)) for sign in (1.0, -1.0)]
            if hull - sum(sides) > best.gain and min(sides) > 0:
                best = _Cut(hull - sum(sides), axis, at)
    return best


def _volume(points: Array) -> float:
    """Of the hull of points (n, 3), of which those of a cell count as one; 0 where they are flat."""
    cell = float(np.ptp(points, axis=0).max(initial=0.0)) / _GRID
    if len(points) > 500 and cell > 0:
        _, first = np.unique(np.round(points / cell).astype(np.int64) @ [1, 1 << 20, 1 << 40], return_index=True)
        points = points[first]
    try:
        return float(ConvexHull(points, qhull_options="Qt").volume)
    except (QhullError, ValueError):
        return 0.0


def _side(part: Array, axis: int, at: float, sign: float) -> Array:
    """Points (n, 3) of what the triangles have on one side of a plane, those on the plane included."""
    off = sign * (part[:, :, axis] - at)
    found = [part[off >= 0]]
    for one, other in ((0, 1), (1, 2), (2, 0)):
        crossed = off[:, one] * off[:, other] < 0
        share = off[crossed, one] / (off[crossed, one] - off[crossed, other])
        found.append(part[crossed, one] + share[:, None] * (part[crossed, other] - part[crossed, one]))
    return np.concatenate(found)


def _clip(part: Array, axis: int, at: float, sign: float) -> Array:
    """The triangles (t, 3, 3) on one side of a plane; those that it crosses are cut."""
    off = sign * (part[:, :, axis] - at)
    inside = (off >= 0).sum(axis=1)
    found = [part[inside == 3]]
    for count in (1, 2):
        cut, apart = part[inside == count], off[inside == count]
        # The corner that is alone on its side first.
        alone = np.argmax((apart >= 0) == (count == 1), axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        cut, apart = np.take_along_axis(cut, order[..., None], axis=1), np.take_along_axis(apart, order, axis=1)
        share = apart[:, :1] / (apart[:, :1] - apart[:, 1:])
        ends = cut[:, :1] + share[..., None] * (cut[:, 1:] - cut[:, :1])
        if count == 1:
            found.append(np.stack([cut[:, 0], ends[:, 0], ends[:, 1]], axis=1))
        else:
            found.append(np.stack([ends[:, 0], cut[:, 1], cut[:, 2]], axis=1))
            found.append(np.stack([ends[:, 0], cut[:, 2], ends[:, 1]], axis=1))
    return np.concatenate(found)
