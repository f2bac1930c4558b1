"""Triangles of shapes: those of hands and objects, friction cones and arrows."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands.mesh_file import triangles_of
from pinograsp.hands.visuals import simplify
from pinograsp.spatial import Array, IntArray
from pinograsp.viz.raster import Surface
from pinograsp.viz.style import COLOURS

# Greys for the hand; for the object yellow, the Okabe-Ito colour that the figures do not use.
PALM, LINK, OBJECT, GHOST = "#7C8794", "#B9C1CA", "#F0E442", "#9DB2C7"
AXES = (COLOURS[1], COLOURS[2], COLOURS[0])  # x, y, z of the contact frames
LOAD = "#000000"
HEAD, WIDE, BALL = (
    5.0,
    2.3,
    1.7,
)  # length and radius of an arrow's head, and radius of a contact's ball, over the shaft's
_AROUND = 32  # edges of a circle: smooth at the size of a screen
_CREASE = np.radians(35.0)  # faces that meet at a larger angle show their edge
_SAME = 1e-6  # distance at which vertices are merged, relative to the size of the shape

Triangles: TypeAlias = tuple[Array, IntArray]  # vertices (n, 3) [m], faces (m, 3)


def rgb(colour: str) -> IntArray:
    """A colour such as ``#0072B2`` as three integers (3,)."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])


# -- shapes -----------------------------------------------------------------------------------------------------------


def triangulate(shape: Any, most: int = 1_000_000) -> Triangles:
    """Triangles of a shape of coal in its own frame, with faces outwards.

    Vertices at creases are repeated, so that normals averaged over the faces at a vertex give smooth shading and sharp
    edges. Shapes are recognised by the names of their classes, because only some rooms import coal. Meshes of more than
    ``most`` triangles are simplified.

    Raises:
        InvalidInput: a shape of another kind.
    """
    kind = type(shape).__name__
    if kind == "Box":
        return split_creases(*_box(np.ravel(shape.halfSide)))
    if kind in ("Sphere", "Ellipsoid"):
        vertices, faces = ball()
        return vertices * (shape.radius if kind == "Sphere" else np.ravel(shape.radii)), faces
    if kind == "Capsule":
        return split_creases(*_lathe(*_arc(shape.radius, shape.halfLength)))
    if kind == "Cylinder":
        r, h = shape.radius, shape.halfLength
        return split_creases(*_lathe([0.0, r, r, 0.0], [-h, -h, h, h]))
    if kind.startswith("BVHModel"):
        welded = _weld(*triangles_of(shape))
        return split_creases(*simplify(*welded, most))
    if kind.startswith("Convex"):
        vertices, faces = np.array(shape.points()), _rows(shape.polygons, shape.num_polygons)
        return split_creases(vertices, _outwards(vertices, faces))
    raise InvalidInput(f"viewer: expected a box, sphere, ellipsoid, capsule, cylinder, mesh or hull, got {kind}")


def friction_cone(mu: float, height: float, edges: int | None = None) -> Triangles:
    """The cone of forces that friction can bear, about +z with its apex at the origin; open at the far end.

    Args:
        mu: friction coefficient; the half-angle is atan(mu).
        height: along z [m].
        edges: number of edges of a pyramid, inscribed in the cone with its first edge at 45 deg from x; None: a cone.
    """
    angles = 2 * np.pi * np.arange(edges or _AROUND) / (edges or _AROUND) + (np.pi / 4 if edges else 0.0)
    rim = height * np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones_like(angles)])
    i = np.arange(len(angles))
    faces = np.column_stack([0 * i, 1 + np.roll(i, -1), 1 + i])
    return split_creases(np.vstack([np.zeros(3), rim]), faces, np.pi / 2 if edges is None else _CREASE)


def arrow() -> tuple[Triangles, Triangles]:
    """Shaft and head of an arrow along +z, each from z = 0 to 1 and of radius 1, to be scaled."""
    shaft = split_creases(*_lathe([0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]))
    head = split_creases(*_lathe([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))
    return shaft, head


def span_arrow(along: Array, width: float) -> tuple[Array, float, float] | None:
    """Axes of an arrow ``along`` (3,) [m] with a shaft of radius ``width``, the last of them its direction, in rows
    (3, 3), its length and that of its head [m]; None where it is nothing.
    """
    length = float(np.linalg.norm(along))
    if length < 1e-5:
        return None
    z = along / length
    x = np.cross([1.0, 0.0, 0.0] if abs(z[0]) < 0.8 else [0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z]), length, min(HEAD * width, 0.6 * length)


def paint(colour: str) -> Array:
    """A colour such as ``#0072B2`` as three numbers from 0 to 1 (3,)."""
    painted: Array = rgb(colour) / 255
    return painted


def make_arrows(points: Array, arrows: Sequence[Array], colours: Sequence[str], width: float) -> list[Surface]:
    """Balls at contact points (k, 3) [m], and arrows of the forces and the load (2, 3) [m], whose shafts have a radius
    ``width`` [m]; ``colours``: of the arrows.
    """
    vertices, faces = ball()
    found = [Surface(BALL * width * vertices + point, faces, paint(one)) for point, one in zip(points, colours)]
    for (start, end), colour in zip(arrows, colours):
        if (span := span_arrow(end - start, width)) is None:
            continue
        axes, length, tip = span
        sizes = ((width, length - tip, 0.0), (WIDE * width, tip, length - tip))
        found += [
            Surface((corners * [radius, radius, high]) @ axes + start + base * axes[2], own, paint(colour))
            for (corners, own), (radius, high, base) in zip(arrow(), sizes)
        ]
    return found


@functools.cache
def ball() -> Triangles:
    """A sphere of radius 1 about the origin, read-only."""
    vertices, faces = split_creases(*_lathe(*_arc(1.0, 0.0)))
    faces.setflags(write=False)
    return read_only(vertices), faces


def split_creases(vertices: Array, faces: IntArray, crease: float = _CREASE) -> Triangles:
    """The surface with equal vertices merged, then repeated where faces meet at more than ``crease`` [rad]."""
    vertices, faces = _weld(np.asarray(vertices, dtype=float), np.asarray(faces))
    if not len(faces):
        return vertices, faces
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    # A corner is a vertex as one face sees it; corners across a smooth edge are the same vertex.
    m, n = len(faces), len(vertices)
    corner = np.arange(3 * m).reshape(m, 3)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * n + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first, second = order[:-1], order[1:]
    shared = key[first] == key[second]
    first, second = first[shared], second[shared]
    smooth = (normals[first // 3] * normals[second // 3]).sum(axis=1) > np.cos(crease)
    first, second = first[smooth], second[smooth]
    after = np.roll(corner, -1, axis=1).ravel()
    same = start[first] == start[second]  # faces of equal orientation traverse their edge in opposite directions
    links = (
        np.concatenate([first, after[first]]),
        np.concatenate([np.where(same, second, after[second]), np.where(same, after[second], second)]),
    )
    label = _find_groups(*links, 3 * m)
    split = np.empty((label.max() + 1, 3))
    split[label] = vertices[start]
    return split, label.reshape(m, 3)


def _find_groups(first: IntArray, second: IntArray, count: int) -> IntArray:
    """Which group each of ``count`` things belongs to, numbered from 0, where ``first`` and ``second`` are the same."""
    label = np.arange(count)
    while np.any(label[first] != label[second]):
        low, high = np.minimum(label[first], label[second]), np.maximum(label[first], label[second])
        np.minimum.at(label, high, low)
        while np.any(label != (nearer := label[label])):
            label = nearer
    groups: IntArray = np.unique(label, return_inverse=True)[1]
    return groups


def _weld(vertices: Array, faces: IntArray) -> Triangles:
    size = np.ptp(vertices, axis=0).max(initial=0.0) or 1.0
    _, kept, same = np.unique(np.round(vertices / (_SAME * size)), axis=0, return_index=True, return_inverse=True)
    vertices, faces = vertices[kept], same.ravel()[faces]
    flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    return vertices, faces[~flat]


def _rows(triangle: Callable[[int], Sequence[int]], count: int) -> IntArray:
    return np.array([[t[0], t[1], t[2]] for t in map(triangle, range(count))], dtype=np.int64).reshape(-1, 3)


def _outwards(vertices: Array, faces: IntArray) -> IntArray:
    """Faces of a convex hull, oriented outwards."""
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    inside = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    return np.where(inside[:, None], faces[:, ::-1], faces)


def _box(half: Array) -> Triangles:
    corners = half * (2.0 * np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(8, 3) - 1)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.vstack([quads[:, :3], quads[:, [0, 2, 3]]])


def _arc(radius: float, half_length: float) -> tuple[Array, Array]:
    """Radii and heights of the profile of a sphere, or of a capsule with its half-spheres centred at +-half_length."""
    angle = np.linspace(0, np.pi / 2, _AROUND // 4 + 1)
    across, up = radius * np.cos(angle), half_length + radius * np.sin(angle)
    return np.r_[across[::-1], across], np.r_[-up[::-1], up]


def _lathe(radii: ArrayLike, heights: ArrayLike) -> Triangles:
    """The surface of revolution about z of a profile (p,), from its lower end to its upper one."""
    radii, heights = np.asarray(radii, dtype=float), np.asarray(heights, dtype=float)
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(_AROUND, z)]) for r, z in zip(radii, heights)])
    i, j = np.meshgrid(np.arange(len(radii) - 1), np.arange(_AROUND), indexing="ij")
    low, high, next_ = i * _AROUND, (i + 1) * _AROUND, (j + 1) % _AROUND
    a, b, c, d = (part.ravel() for part in (low + j, low + next_, high + next_, high + j))
    return vertices, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
