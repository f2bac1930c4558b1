"""The geometry that the engines simulate: primitives as they are, meshes as their convex hulls."""

from __future__ import annotations

import coal

from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import hull_of
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from pinograsp.objects.body import Body

_HOLLOW = 1e-3  # share by which the convex hull's volume exceeds that of a mesh that is not convex


def convex(shape: coal.CollisionGeometry, name: str, notes: list[str]) -> coal.ShapeBase | None:
    """A convex shape of coal, or None where a mesh is flat; what was changed is appended to ``notes``."""
    if not isinstance(shape, coal.BVHModelBase):
        return shape
    hull = hull_of(shape)
    if hull is None:
        notes.append(f"'{name}' is flat: it is left out")
    elif abs(shape.computeVolume()) < (1 - _HOLLOW) * abs(hull.computeVolume()):
        notes.append(f"'{name}' is not convex: its convex hull is used")
    return hull


def convex_object(body: Body, notes: list[str]) -> coal.ShapeBase:
    """The object's shape in its own frame, convex.

    Raises:
        InvalidInput: not a shape of :mod:`pinograsp.objects`, or flat.
    """
    if not isinstance(body, Sphere | Cylinder | Capsule | Box | Ellipsoid | Mesh):
        raise InvalidInput(
            f"simulate: expected a shape of pinograsp.objects, got {type(body).__name__}: give its mesh "
            "(pinograsp.Mesh) as object=..."
        )
    shape = convex(body.collision_geometry, "object", notes)
    if shape is None:
        raise InvalidInput("simulate: the object's mesh is flat: expected one with volume")
    return shape
