"""The geometry that is simulated: primitives and objects as they are, the hand's meshes as convex hulls."""

from __future__ import annotations

import coal

from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import hull_of
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from pinograsp.objects.body import Body
from pinograsp.simulation.surface import MeshSurface
from pinograsp.spatial import Array

_HOLLOW = 1e-3  # share by which the convex hull's volume exceeds that of a mesh that is not convex


def make_convex(shape: coal.CollisionGeometry, name: str, notes: list[str]) -> coal.ShapeBase | None:
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


def object_shape(body: Body, notes: list[str]) -> coal.ShapeBase | MeshSurface:
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
    return MeshSurface(body)


def convex_shapes(body: Body, notes: list[str]) -> list[coal.ShapeBase]:
    """The object's shape in its own frame, as :func:`object_shape`; convex parts of a mesh that is not convex.

    Raises:
        ExtraMissing: such a mesh, without the extra ``mesh``.
    """
    found: list[str] = []
    shape = object_shape(body, found)
    if not isinstance(shape, MeshSurface) or not isinstance(body, Mesh):
        notes += found
        return [shape]
    parts = body.convex_parts
    hulls = [hull for corners in parts.corners if (hull := hull_of(_cloud(corners))) is not None]
    notes.append(
        f"'object' is not convex: {len(hulls)} convex parts are used, which stand out of it by up to "
        f"{1e3 * parts.excess:.1f} mm"
    )
    return hulls


def _cloud(corners: Array) -> coal.BVHModelBase:
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(corners))
    model.addVertices(corners)
    model.endModel()
    return model
