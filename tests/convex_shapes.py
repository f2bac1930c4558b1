"""Convex shapes of every kind that the core knows, and placements, at random."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin


def draw_shapes(rng, least):
    """One of each kind, of sizes from ``least`` to 0.05 m."""
    size = rng.uniform(least, 0.05, 3)
    points = coal.StdVec_Vec3s()
    for point in rng.normal(size=(20, 3)) * size:
        points.append(point)
    return [
        coal.Sphere(size[0]),
        coal.Ellipsoid(*size),
        coal.Capsule(size[0], size[1]),
        coal.Cylinder(size[0], size[1]),
        coal.Box(*size),
        coal.Convex.convexHull(points, True, "Qt"),
    ]


def extent(shape, at, along):
    """How far a shape reaches along a unit vector [m]: its support function."""
    x, y, z = at.rotation.T @ along
    reaches = {
        coal.Sphere: lambda: shape.radius,
        coal.Ellipsoid: lambda: np.linalg.norm(shape.radii * [x, y, z]),
        coal.Capsule: lambda: shape.radius + shape.halfLength * abs(z),
        coal.Cylinder: lambda: shape.radius * np.hypot(x, y) + shape.halfLength * abs(z),
        coal.Box: lambda: shape.halfSide @ np.abs([x, y, z]),
    }
    local = reaches.get(type(shape), lambda: max(np.array(shape.points()) @ [x, y, z]))()
    return local + at.translation @ along


def draw_placement(rng, size):
    return pin.SE3(pin.exp3(rng.normal(size=3)), size * rng.normal(size=3))
