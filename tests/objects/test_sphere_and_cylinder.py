"""Spheres and cylinders: inertia by sampling, nearest points by optimization, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from pinograsp.errors import InvalidInput
from pinograsp.objects import Cylinder, Sphere
from pinograsp.spatial import pose_of, rotation_rpy

SHAPES = [
    Sphere(radius=0.03, mass=0.4, pose=pose_of([0.1, 0.2, 0.3], rotation_rpy(0.3, 0.2, 0.1))),
    Cylinder(radius=0.02, height=0.1, mass=0.7, pose=pose_of([0.1, 0.2, 0.3], rotation_rpy(1.0, 0.2, 0.1))),
    Cylinder(radius=0.05, height=0.01, mass=0.7),
]


def inside(shape, points):
    local = (points - shape.com_o) @ shape.pose[:3, :3]
    if isinstance(shape, Sphere):
        return np.linalg.norm(local, axis=1) <= shape.radius
    return (np.hypot(local[:, 0], local[:, 1]) <= shape.radius) & (np.abs(local[:, 2]) <= shape.height / 2)


@pytest.mark.parametrize("shape", SHAPES)
def test_inertia_by_monte_carlo(shape):
    rng = np.random.default_rng(0)
    R = shape.bounding_radius
    local = rng.uniform(-R, R, (400_000, 3))
    local = local[inside(shape, local @ shape.pose[:3, :3].T + shape.com_o)]
    second = (local[:, :, None] * local[:, None, :]).mean(axis=0)
    inertia = shape.mass * (np.trace(second) * np.eye(3) - second)
    assert np.abs(inertia - shape.inertia_b).max() < 0.02 * shape.inertia_b.max()


@pytest.mark.parametrize("shape", SHAPES)
def test_projection_is_the_nearest_surface_point(shape):
    rng = np.random.default_rng(1)
    points = shape.com_o + rng.uniform(-1.5, 1.5, (40, 3)) * shape.bounding_radius
    surface, normals, distance = shape.project(points)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.allclose(points + distance[:, None] * normals, surface)  # the inward normal leads there
    assert np.array_equal(distance <= 0, inside(shape, points))
    assert np.abs(shape.project(surface)[2]).max() < 1e-12
    for point, nearest, gap in zip(points, surface, distance):
        if gap > 0:  # outside: no point of the solid is nearer (the solid is convex)
            along = minimize(
                lambda p, point=point: np.sum((p - point) ** 2),
                shape.com_o,
                constraints=_solid(shape),
                method="SLSQP",
                options={"ftol": 1e-14, "maxiter": 300},
            )
            assert gap <= np.sqrt(along.fun) + 1e-6
        else:  # inside: a ball of that radius stays inside
            ball = point + 0.999 * abs(gap) * rng.normal(size=(200, 3)) / np.sqrt(3) / 3
            near = np.linalg.norm(ball - point, axis=1) <= 0.999 * abs(gap)
            assert inside(shape, ball[near]).all()
        assert abs(np.linalg.norm(nearest - point) - abs(gap)) < 1e-12


def _solid(shape):
    def local(p):
        return (p - shape.com_o) @ shape.pose[:3, :3]

    if isinstance(shape, Sphere):
        return [{"type": "ineq", "fun": lambda p: shape.radius**2 - local(p) @ local(p)}]
    return [
        {"type": "ineq", "fun": lambda p: shape.radius**2 - local(p)[0] ** 2 - local(p)[1] ** 2},
        {"type": "ineq", "fun": lambda p: shape.height / 2 - local(p)[2]},
        {"type": "ineq", "fun": lambda p: shape.height / 2 + local(p)[2]},
    ]


def test_points_without_a_direction_are_refused():
    with pytest.raises(InvalidInput, match="centre"):
        SHAPES[0].project([SHAPES[0].com_o])
    with pytest.raises(InvalidInput, match="axis"):
        SHAPES[1].project([SHAPES[1].com_o])
    assert SHAPES[2].project([[0, 0, 0.004]])[2] == pytest.approx(-0.001)  # a disc: the cap is nearer than the side


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sphere(radius=-1, mass=1),
        lambda: Sphere(radius=1, mass=0),
        lambda: Sphere(radius=float("nan"), mass=1),
        lambda: Sphere(radius="big", mass=1),
        lambda: Cylinder(radius=1, height=0, mass=1),
        lambda: Cylinder(radius=1, height=1, mass=float("inf")),
        lambda: Cylinder(radius=1, height=1, mass=1, pose=np.eye(3)),
        lambda: Cylinder(radius=1, height=1, mass=1, pose=2 * np.eye(4)),
        lambda: Sphere(radius=1, mass=1).project([[1, 2]]),
        lambda: Sphere(radius=1, mass=1).project([[1, 2, np.nan]]),
    ],
)
def test_bad_input_is_refused(make):
    with pytest.raises(InvalidInput, match="expected"):
        make()


def test_records_cannot_be_changed():
    with pytest.raises(AttributeError):
        SHAPES[0].radius = 1
    with pytest.raises(ValueError, match="read-only"):
        SHAPES[0].pose[0, 0] = 5
