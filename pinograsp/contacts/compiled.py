"""Hands as the compiled core takes them: joints and shapes as numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from pinograsp import core
from pinograsp.hands.mesh_file import triangles_of
from pinograsp.objects.body import Body
from pinograsp.objects.mesh import Mesh
from pinograsp.spatial import Array


class SupportShape(NamedTuple):
    """A convex shape: the hull of points (v, 3), and an ellipsoid of radii (3,) about each [m], in its own frame."""

    points: Array
    radii: Array


def support_shape(geometry: coal.CollisionGeometry) -> SupportShape:
    """Coal's convex geometry as such a shape; of a kind unknown, without points."""
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
    return SupportShape(np.zeros((0, 3)), none)


def compiled_shape(geometry: coal.CollisionGeometry) -> Any:
    """The core's shape of coal's geometry, of a mesh its triangles; None of a kind unknown."""
    try:
        return core.load().Shape(*support_shape(geometry), corners_of(geometry))
    except ValueError:
        return None


def compiled_object(body: Body) -> Any:
    """The core's shape of an object, at its shape's own frame; None of a kind unknown."""
    if isinstance(body, Mesh) and not body.convex:
        return body.surface.compiled
    return compiled_shape(body.collision_geometry)


def joints_of(model: pin.Model) -> list[tuple[int, int, Array, Array]]:
    """Of each joint: its parent (-1: the world), the input that moves it, its frame (4, 4) in its parent's at inputs of
    0, and what a unit of the input adds to its velocity (6,) in its own frame, linear part first.
    """
    data, found = model.createData(), []
    pin.forwardKinematics(model, data, np.zeros(model.nq), np.ones(model.nv))
    for j in range(1, model.njoints):
        parent = model.parents[j]
        # What a unit of its input adds, coupled joints their ratio.
        own = data.v[j].vector - data.liMi[j].actInv(data.v[parent]).vector
        found.append((parent - 1, model.joints[j].idx_v, np.array(data.liMi[j].homogeneous), own))
    return found


def corners_of(geometry: coal.CollisionGeometry) -> Array:
    """The triangles (m, 3, 3) of a mesh; none of other geometry."""
    if not isinstance(geometry, coal.BVHModelBase):
        return np.zeros((0, 3, 3))
    vertices, faces = triangles_of(geometry)
    corners: Array = vertices[faces]
    return corners
