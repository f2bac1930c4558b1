"""What the engines take for the geometry of hand and object: primitives as they are, meshes as their convex hulls."""

from __future__ import annotations

import coal

from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import hull_of
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere

_HOLLOW = 1e-3  # the convex hull holds more than the mesh by this share: not the same shape


def convex(shape, name: str, notes: list[str]):
    """A coal shape that is convex, or None where a mesh is flat; ``notes`` tell what is not as it was."""
    if not isinstance(shape, coal.BVHModelBase):
        return shape
    hull = hull_of(shape)
    if hull is None:
        notes.append(f"'{name}' is flat: it is left out")
    elif abs(shape.computeVolume()) < (1 - _HOLLOW) * abs(hull.computeVolume()):
        notes.append(f"'{name}' is not convex: its convex hull is taken")
    return hull


def convex_object(body, notes: list[str]):
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
