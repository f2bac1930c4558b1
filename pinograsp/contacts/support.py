"""Areas in which convex shapes meet when they are pressed together: for many pairs at once."""

from __future__ import annotations

from typing import NamedTuple

import coal
import numpy as np

from pinograsp.objects.body import tangents
from pinograsp.spatial import Array, BoolArray, IntArray

CORNERS = 4  # of an area, at most
_AZIMUTHS = 0.3 + np.pi / 4 * np.arange(8)  # askew, since along an edge any of its points is as near
_WIDER = 1e-4  # [m] by which areas are enlarged, so that points and edges have an inside
_SAME = 1e-3  # [m] corners nearer to each other are one


class SupportShape(NamedTuple):
    """A convex shape: the hull of points (v, 3), and an ellipsoid of radii (3,) about each [m], in its own frame."""

    points: Array
    radii: Array

    def support(self, directions: Array) -> Array:
        """Its points (..., 3) that are farthest along unit vectors (..., 3)."""
        found: Array = self.points[np.argmax(directions @ self.points.T, axis=-1)]
        if self.radii.any():
            stretched = self.radii * directions
            size = np.linalg.norm(stretched, axis=-1, keepdims=True)
            found = found + self.radii * stretched / np.maximum(size, 1e-300)
        return found


def support_shape(geometry: coal.CollisionGeometry) -> SupportShape | None:
    """Coal's convex geometry as such a shape; None of a kind unknown."""
    ends, none = np.array([[0, 0, 1.0], [0, 0, -1.0]]), np.zeros(3)
    if isinstance(geometry, coal.Sphere):
        return SupportShape(none[None], np.full(3, geometry.radius))
    if isinstance(geometry, coal.Ellipsoid):
        return SupportShape(none[None], np.array(geometry.radii))
    if isinstance(geometry, coal.Capsule):
        return SupportShape(ends * geometry.halfLength, np.full(3, geometry.radius))
    if isinstance(geometry, coal.Cylinder):
        return SupportShape(ends * geometry.halfLength, np.array([geometry.radius, geometry.radius, 0.0]))
    if isinstance(geometry, coal.Box):
        signs = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
        return SupportShape(signs * geometry.halfSide, none)
    if isinstance(geometry, coal.ConvexBase):
        return SupportShape(np.array(geometry.points(), dtype=float).reshape(-1, 3), none)
    return None


def tilt(normals: Array, lean: float) -> Array:
    """Unit vectors (t, 8, 3) around unit normals (t, 3), off them by ``lean`` [rad].

    Of faces that lean less than this against each other, they find the corners.
    """
    across = np.einsum("txi,ai->tax", tangents(normals), np.column_stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)]))
    found: Array = np.cos(lean) * normals[:, None] + np.sin(lean) * across
    return found


def common_corners(one: Array, other: Array, points: Array, normals: Array) -> tuple[Array, IntArray, Array]:
    """Corners of the area that two faces have in common, seen along the normals.

    Args:
        one: supports (t, 8, 3) of one shape along normals tilted by :func:`tilt` [m].
        other: supports (t, 8, 3) of the other along the same, with the normal's part reversed [m].
        points: where the shapes touch (t, 3) [m].
        normals: unit normals (t, 3).

    Returns:
        Corners (t, 4, 3) in the planes through the points across the normals; how many count (t,): 1 (the middle of
        what is smaller than a millimetre), 2 (along an edge), 3 or 4; and by how much the faces are farther apart at
        each than where they are nearest (t, 4) [m], since they lean.
    """
    plane = tangents(normals)
    around = np.column_stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)])
    a, b = (np.einsum("tax,txi->tai", shape - points[:, None], plane) + _WIDER * around for shape in (one, other))
    edges_a, edges_b = np.roll(a, -1, axis=1) - a, np.roll(b, -1, axis=1) - b
    crossings, cross = _crossings(a, edges_a, b, edges_b)
    candidates = np.concatenate([a, b, crossings], axis=1)
    valid = np.concatenate([_inside(a, b, edges_b), _inside(b, a, edges_a), cross], axis=1)
    # The farthest in each of four directions: all corners of a rectangle, whichever way it lies.
    far = np.where(valid[:, None], np.einsum("tci,ai->tac", candidates, around[::2]), -np.inf)
    best = np.take_along_axis(candidates, far.argmax(axis=2)[..., None], axis=1)
    best[~valid.any(axis=1)] = 0.0  # they meet beside each other's faces: at the point alone
    flat, counts = _distinct(best)
    slopes = _slope(other - points[:, None], plane, normals) - _slope(one - points[:, None], plane, normals)
    rise = np.einsum("ti,tai->ta", slopes, flat)
    lowest = np.where(np.arange(CORNERS) < counts[:, None], rise, np.inf).min(axis=1)
    return points[:, None] + np.einsum("txi,tai->tax", plane, flat), counts, np.maximum(rise - lowest[:, None], 0.0)


def _slope(supports: Array, plane: Array, normals: Array) -> Array:
    """How faces rise along the normals (t, 2): of the plane through their supports (t, 8, 3), the least that fits."""
    across = np.einsum("tax,txi->tai", supports, plane)
    height = np.einsum("tax,tx->ta", supports, normals)
    across, height = across - across.mean(axis=1, keepdims=True), height - height.mean(axis=1, keepdims=True)
    spread = np.einsum("tai,taj->tij", across, across) + _SAME**2 * np.eye(2)
    found: Array = np.linalg.solve(spread, np.einsum("tai,ta->ti", across, height)[..., None])[..., 0]
    return found


def _inside(points: Array, corners: Array, edges: Array) -> BoolArray:
    """Which points (t, p, 2) lie in convex polygons with corners and edges (t, e, 2), counter-clockwise (t, p)."""
    offset = points[:, :, None] - corners[:, None]
    side = edges[:, None, :, 0] * offset[..., 1] - edges[:, None, :, 1] * offset[..., 0]
    return np.asarray((side >= -1e-12).all(axis=2), dtype=bool)


def _crossings(a: Array, along_a: Array, b: Array, along_b: Array) -> tuple[Array, BoolArray]:
    """Where edges of two polygons cross (t, e e, 2), and whether they do (t, e e)."""
    offset = b[:, None] - a[:, :, None]
    turn = along_a[:, :, None, 0] * along_b[:, None, :, 1] - along_a[:, :, None, 1] * along_b[:, None, :, 0]
    safe = np.where(np.abs(turn) > 1e-15, turn, 1.0)
    s = (offset[..., 0] * along_b[:, None, :, 1] - offset[..., 1] * along_b[:, None, :, 0]) / safe
    r = (offset[..., 0] * along_a[:, :, None, 1] - offset[..., 1] * along_a[:, :, None, 0]) / safe
    found = (np.abs(turn) > 1e-15) & (s >= 0) & (s <= 1) & (r >= 0) & (r <= 1)
    points = a[:, :, None] + s[..., None] * along_a[:, :, None]
    return points.reshape(len(a), -1, 2), found.reshape(len(a), -1)


def _distinct(corners: Array) -> tuple[Array, IntArray]:
    """Corners (t, 4, 2) with the different ones first, and how many these are (t,)."""
    counts = np.zeros(len(corners), dtype=np.int64)
    found = np.repeat(corners.mean(axis=1)[:, None], CORNERS, axis=1)
    rows = np.arange(len(corners))
    for i in range(CORNERS):
        gaps = np.linalg.norm(found - corners[:, i : i + 1], axis=2)
        gaps[np.arange(CORNERS) >= counts[:, None]] = np.inf
        new = gaps.min(axis=1) > _SAME
        found[rows[new], counts[new]] = corners[new, i]
        counts += new
    alone = counts == 1
    found[alone, 0] = corners[alone].mean(axis=1)
    return found, counts
