"""The geometry that the engines simulate: primitives and objects as they are, the hand's meshes as convex hulls."""

from __future__ import annotations

import coal

from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import hull_of
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from pinograsp.objects.body import Body
from pinograsp.referee.surface import Surface

_HOLLOW = 1e-3  # share by which the convex hull's volume exceeds that of a mesh that is not convex


def convex(shape: coal.CollisionGeometry, name: str, notes: list[str]) -> coal.ShapeBase | None:
    """A convex shape of coal, or None where a mesh is flat; what was changed is appended to ``notes``."""
    if not isinstance(shape, coal.BVHModelBase):
        return shape
    hull = hull_of(shape)
    if hull is None:
        notes.append(f"'{name}' is flat: it is left out")
    elif _is_hollow(shape, hull):
        notes.append(f"'{name}' is not convex: its convex hull is used")
    return hull


def _is_hollow(mesh: coal.BVHModelBase, hull: coal.ConvexBase) -> bool:
    return bool(abs(mesh.computeVolume()) < (1 - _HOLLOW) * abs(hull.computeVolume()))


def object_shape(body: Body, notes: list[str]) -> coal.ShapeBase | Surface:
    """The object's shape in its own frame: convex, or the triangles of a mesh that is not.

    Raises:
        InvalidInput: not a shape of :mod:`pinograsp.objects`, or flat.
    """
    if not isinstance(body, Sphere | Cylinder | Capsule | Box | Ellipsoid | Mesh):
        raise InvalidInput(
            f"simulate: expected a shape of pinograsp.objects, got {type(body).__name__}: give its mesh "
            "(pinograsp.Mesh) as object=..."
        )
    shape = body.collision_geometry
    if not isinstance(body, Mesh) or not isinstance(shape, coal.BVHModelBase):
        return shape
    hull = hull_of(shape)
    if hull is None:
        raise InvalidInput("simulate: the object's mesh is flat: expected one with volume")
    if not _is_hollow(shape, hull):
        return hull
    notes.append("'object' is not convex: its own triangles are used, by coal's distances")
    return Surface(body)


def hull_shape(body: Body, notes: list[str]) -> coal.ShapeBase:
    """The object's shape in its own frame: convex, or the convex hull of a mesh that is not; as for
    :func:`object_shape`.
    """
    found: list[str] = []
    shape = object_shape(body, found)
    if not isinstance(shape, Surface):
        notes += found
        return shape
    notes.append("'object' is not convex: its convex hull is used, which may touch where the object does not")
    hull: coal.ShapeBase = hull_of(body.collision_geometry)
    return hull
