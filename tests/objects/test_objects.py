"""Shapes of objects: surfaces, mass properties, curvature, collision geometry, meshes, texts."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import pickle
import secrets
import sys
import types
from decimal import Decimal, localcontext

import coal
import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from pinograsp import core
from pinograsp.contacts import contacts_at
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere, object_from
from pinograsp.objects.triangles import TriangleSurface
from pinograsp.spatial import pose_of

POSE = pose_of([0.1, -0.2, 0.3], Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
MOVE = pose_of([-0.7, 0.2, 0.1], Rotation.from_rotvec([1.4, 0.3, -2.1]).as_matrix())

PRIMITIVES = {
    "sphere": Sphere(radius=0.03, mass=0.4, pose=POSE),
    "cylinder": Cylinder(radius=0.02, height=0.1, mass=0.7, pose=POSE),
    "disc": Cylinder(radius=0.05, height=0.01, mass=0.7, pose=POSE),
    "capsule": Capsule(radius=0.02, length=0.06, mass=0.3, pose=POSE),
    "box": Box(size=[0.04, 0.06, 0.1], mass=0.2, pose=POSE),
    "ellipsoid": Ellipsoid(semi_axes=[0.03, 0.02, 0.05], mass=0.1, pose=POSE),
    "lens": Ellipsoid(semi_axes=[0.04, 0.04, 0.01], mass=0.1, pose=POSE),
    "rod": Ellipsoid(semi_axes=[0.01, 0.06, 0.01], mass=0.1, pose=POSE),
}


def mesh_of(made, convex=False, **fields):
    return Mesh(vertices=made.vertices, faces=made.faces, convex=convex, **{"density": 500.0, "pose": POSE, **fields})


def hollow_box():
    """A box with a box-shaped cavity off its middle."""
    outer = trimesh.creation.box([0.06, 0.08, 0.1])
    inner = trimesh.creation.box([0.02, 0.03, 0.04])
    inner.apply_translation([0.01, 0, 0.005])
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def bracket():
    """An L-shaped prism: one reflex edge."""
    outline = 0.02 * np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 4], [0, 4]])
    vertices = [[x, y, z] for z in (0.0, 0.03) for x, y in outline]
    top = np.array([(6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11)])
    sides = [f for i, j in zip(range(6), (1, 2, 3, 4, 5, 0)) for f in ((i, j, j + 6), (i, j + 6, i + 6))]
    return trimesh.Trimesh(vertices, np.concatenate([top, top[:, ::-1] - 6, sides]), process=False)


def cloud(count):
    """Triangles that bound nothing: only their hull is a solid."""
    points = np.random.default_rng(5).normal(size=(3 * count, 3)) * [0.02, 0.03, 0.04]
    return trimesh.Trimesh(points, np.arange(3 * count).reshape(-1, 3), process=False)


HULLS = {
    "hull of a ball": mesh_of(trimesh.creation.icosphere(subdivisions=3, radius=0.03), convex=True),
    "hull of points": mesh_of(cloud(13), convex=True),
}
GENERAL = {
    "ring": mesh_of(trimesh.creation.torus(0.04, 0.012, major_sections=48, minor_sections=24)),
    "hollow box": mesh_of(hollow_box()),
    "bracket": mesh_of(bracket()),
}
SHAPES = {**PRIMITIVES, **HULLS, **GENERAL}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
every_primitive = pytest.mark.parametrize("shape", PRIMITIVES.values(), ids=PRIMITIVES)
every_convex = pytest.mark.parametrize("shape", {**PRIMITIVES, **HULLS}.values(), ids={**PRIMITIVES, **HULLS})


def points_around(shape, count=60, seed=0, far=1.6):
    """Points in and about the shape, every third of them nearer to its middle."""
    rng = np.random.default_rng(seed)
    reach = np.where(np.arange(count) % 3 == 0, 0.3, 1.0)[:, None] * shape.bounding_radius / np.sqrt(3)
    return shape.com_o + rng.uniform(-far, far, (count, 3)) * reach


def support(shape, n):
    """How far the convex shape reaches from its centre of mass along unit vectors n (..., 3) of its body axes."""
    if isinstance(shape, Sphere):
        return shape.radius * np.linalg.norm(n, axis=-1)
    if isinstance(shape, Cylinder):
        return shape.radius * np.hypot(n[..., 0], n[..., 1]) + shape.height / 2 * np.abs(n[..., 2])
    if isinstance(shape, Capsule):
        return shape.radius * np.linalg.norm(n, axis=-1) + shape.length / 2 * np.abs(n[..., 2])
    if isinstance(shape, Box):
        return np.abs(n) @ shape.size / 2
    if isinstance(shape, Ellipsoid):
        return np.linalg.norm(n * shape.semi_axes, axis=-1)
    return (n @ (shape.vertices - shape.com_b).T).max(axis=-1)


# -- nearest points -------------------------------------------------------------------------------------------------


@every_convex
def test_signed_distance_is_that_to_the_farthest_supporting_plane(shape):
    """Of a convex body it is the largest of n p - support(n) over all directions, inside and outside."""
    rng = np.random.default_rng(1)
    fan = rng.normal(size=(4000, 3))
    fan /= np.linalg.norm(fan, axis=1)[:, None]
    fan = np.concatenate([fan, np.eye(3), -np.eye(3)])
    if isinstance(shape, Mesh):  # inside, a face's plane is the nearest
        corners = shape.vertices[shape.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        fan = np.concatenate([fan, normals / np.linalg.norm(normals, axis=1)[:, None]])
    points = points_around(shape, 25, seed=2)
    _, _, distances = shape.project(points)
    assert (distances < 0).any() and (distances > 0).any()
    for local, distance in zip((points - shape.com_o) @ shape.pose[:3, :3], distances):
        heights = fan @ local - support(shape, fan)
        start = fan[heights.argmax()]

        def miss(v, local=local):
            n = v / np.linalg.norm(v)
            return float(support(shape, n) - n @ local)

        found = minimize(miss, start, method="Nelder-Mead", options={"xatol": 1e-12, "fatol": 1e-16, "maxiter": 2000})
        assert distance == pytest.approx(-found.fun, abs=1e-7 * shape.bounding_radius)


def to_coal(pose, position=(0.0, 0.0, 0.0)):
    return coal.Transform3s(np.array(pose[:3, :3]), pose[:3, 3] + np.array(position))


@every_shape
def test_distances_are_those_of_the_collision_geometry(shape):
    points = points_around(shape, 200, seed=3, far=2.5)
    _, _, distances = shape.project(points)
    outside = distances > 1e-4
    assert outside.sum() > 50
    tiny = 1e-6
    ball = coal.Sphere(tiny)
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-8
    here = to_coal(shape.shape_pose)
    for point, distance in zip(points[outside], distances[outside]):
        there, result = to_coal(np.eye(4), point), coal.DistanceResult()
        found = coal.distance(shape.collision_geometry, here, ball, there, request, result)
        assert found == pytest.approx(distance - tiny, abs=5e-8)  # coal iterates on ellipsoids


def test_collision_geometries_are_of_the_right_kind():
    kinds = {
        "sphere": coal.Sphere,
        "cylinder": coal.Cylinder,
        "capsule": coal.Capsule,
        "box": coal.Box,
        "ellipsoid": coal.Ellipsoid,
        "hull of a ball": coal.Convex,
        "bracket": coal.BVHModelOBBRSS,
    }
    for name, kind in kinds.items():
        assert isinstance(SHAPES[name].collision_geometry, kind)


@every_shape
def test_projection_leads_to_the_surface_along_unit_inward_normals(shape):
    points = points_around(shape, 400)
    surface, normals, distances = shape.project(points)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-12
    assert np.abs(points + distances[:, None] * normals - surface).max() < 1e-12
    again, inward, left = shape.project(surface)
    assert np.abs(again - surface).max() < 1e-12 and np.abs(left).max() < 1e-12
    # A little way along its normal from a smooth point is inside, by that much.
    smooth = (inward * normals).sum(axis=1) > 1 - 1e-9
    deeper = shape.project(surface[smooth] + 1e-5 * normals[smooth])[2]
    assert smooth.sum() > 100 and np.median(np.abs(deeper + 1e-5)) < 1e-9 and deeper.max() < 0


@every_shape
def test_signed_distance_grows_at_unit_rate_against_the_normal(shape):
    points = points_around(shape, 300, seed=4)
    _, normals, distances = shape.project(points)
    step = 1e-6
    slope = np.empty((len(points), 3))
    for axis in range(3):
        up, down = (shape.project(points + sign * step * np.eye(3)[axis])[2] for sign in (1, -1))
        slope[:, axis] = (up - down) / (2 * step)
    # Central differences are off by the step over the distance to the nearest crease, squared; a few straddle one.
    error = np.linalg.norm(slope + normals, axis=1)
    assert np.quantile(error, 0.95) < 1e-5
    assert np.abs(distances).max() > 100 * step


@every_shape
def test_everything_moves_with_the_body(shape):
    points = points_around(shape, 50)
    moved = shape.placed(MOVE @ shape.pose)
    rotation = MOVE[:3, :3]

    def move(p):
        return p @ rotation.T + MOVE[:3, 3]

    surface, normals, distances = shape.project(points)
    there, turned, same = moved.project(move(points))
    assert np.abs(there - move(surface)).max() < 1e-12
    assert np.abs(turned - normals @ rotation.T).max() < 1e-9
    assert np.abs(same - distances).max() < 1e-12
    assert (moved.mass, moved.volume) == (shape.mass, shape.volume)
    assert np.array_equal(moved.inertia_b, shape.inertia_b)
    assert np.allclose(moved.com_o, move(shape.com_o))


@every_shape
def test_no_points_make_no_results(shape):
    surface, normals, distances = shape.project(np.empty((0, 3)))
    assert (surface.shape, normals.shape, distances.shape) == ((0, 3), (0, 3), (0,))
    curvatures, first = shape.curvature(np.empty((0, 3)))
    assert (curvatures.shape, first.shape) == ((0, 2), (0, 3))


@pytest.mark.parametrize(
    "shape, local",
    [
        (PRIMITIVES["sphere"], [0, 0, 0]),
        (PRIMITIVES["cylinder"], [0, 0, 0.02]),
        (PRIMITIVES["disc"], [0.01, 0, 0]),
        (PRIMITIVES["capsule"], [0, 0, 0.03]),
        (PRIMITIVES["box"], [0, 0.005, 0.01]),
        (PRIMITIVES["ellipsoid"], [0.005, 0, 0.01]),
        (PRIMITIVES["lens"], [0.01, -0.02, 0]),
        (PRIMITIVES["rod"], [0, 0.02, 0]),
        (HULLS["hull of a ball"], [0, 0, 0]),
        (mesh_of(trimesh.creation.box([0.02, 0.06, 0.1])), [0, 0.01, 0.02]),
        (mesh_of(trimesh.creation.cylinder(0.02, 0.1, sections=33)), [0, 0, 0.001]),
    ],
)
def test_points_between_opposite_sides_are_refused(shape, local):
    with pytest.raises(InvalidInput, match="move it to the surface") as caught:
        shape.project([POSE[:3, :3] @ local + shape.com_o])
    assert "mm in the world" in str(caught.value)
    with pytest.raises(InvalidInput, match="move it to the surface"):
        shape.curvature([POSE[:3, :3] @ local + shape.com_o])
    aside = POSE[:3, :3] @ np.add(local, [3e-9, 2e-9, 4e-9]) + shape.com_o  # however near, but on one side
    assert shape.project([aside])[2] < 0


def exact_ellipsoid(semi_axes, point):
    """The nearest surface point and the signed distance, by bisection with 50 digits."""
    with localcontext() as context:
        context.prec = 50
        e, y = [Decimal(float(v)) for v in semi_axes], [abs(Decimal(float(v))) for v in point]
        least = min(e) ** 2
        low, high = Decimal(0), max(e) ** 2 + sum(((a * b) ** 2 for a, b in zip(e, y)), Decimal(0)).sqrt()

        def outside(shift):
            return sum((a * b / (shift - least + a * a)) ** 2 for a, b in zip(e, y) if b) > 1

        for _ in range(400):
            middle = (low * high).sqrt() if low > 0 and high > 4 * low else (low + high) / 2
            low, high = (middle, high) if outside(middle) else (low, middle)
        x = [a * a * b / (high - least + a * a) for a, b in zip(e, y)]
        distance = sum(((a - b) ** 2 for a, b in zip(x, y)), Decimal(0)).sqrt().copy_sign(high - least)
        return np.copysign([float(v) for v in x], point), float(distance)


@pytest.mark.parametrize(
    "semi_axes",
    [
        (0.02, 0.03, 0.04),
        (0.03, 0.03, 0.01),
        (0.01, 0.01, 0.05),
        (0.03, 0.03 * (1 + 1e-9), 0.03 * (1 - 1e-12)),
        (0.03, 0.03, 0.03),
        (0.05, 0.04, 1e-5),
        (1e-5, 1.1e-5, 0.05),
    ],
)
def test_ellipsoids_are_exact_near_and_far(semi_axes):
    shape, e = Ellipsoid(semi_axes=semi_axes, mass=1), np.array(semi_axes)
    rng = np.random.default_rng(6)
    unit = rng.normal(size=(8, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    axes = np.eye(3)[[0, 1, 2, 0, 1, 2]] * e * rng.uniform(1.0, 3.0, (6, 1))
    near_axes = axes + rng.normal(size=(6, 3)) * 10.0 ** rng.uniform(-20, -7, (6, 1))
    across = rng.uniform(-0.6, 0.6, (6, 3)) * e
    across[:, e.argmin()] = 2e-9
    points = [unit * e * 1.001, unit * e * 0.999, 0.5 * unit * e, 1e-7 * unit, 1e6 * unit, axes, near_axes, across]
    points = np.concatenate(points)
    surface, _, distances = shape.project(points)
    for point, found, distance in zip(points, surface, distances):
        expected, gap = exact_ellipsoid(e, point)
        assert np.abs(found - expected).max() <= 1e-13 * e.max()
        assert abs(distance - gap) <= 1e-13 * max(abs(gap), e.min())


lengths = st.floats(1e-3, 1.0)


@given(st.tuples(lengths, lengths, lengths), st.tuples(*[st.floats(-3, 3)] * 3))
def test_ellipsoids_meet_the_conditions_of_the_nearest_point(semi_axes, point):
    shape, e, y = Ellipsoid(semi_axes=semi_axes, mass=1), np.array(semi_axes), np.array(point)
    try:
        (x,), (inward,), (distance,) = shape.project([y])
    except InvalidInput:
        assert np.abs(y[e.argmin()]) < 1e-9
        return
    assert np.sum((x / e) ** 2) == pytest.approx(1, abs=1e-13)
    gradient = x / e**2
    assert np.abs(inward + gradient / np.linalg.norm(gradient)).max() < 1e-13
    assert np.abs(y + distance * inward - x).max() <= 1e-13 * max(1, np.linalg.norm(y))
    # Of all points whose normal meets y, the nearest is in y's octant and within the radii of curvature.
    assert np.all(x * y >= 0) and distance / np.linalg.norm(gradient) >= -(e.min() ** 2) * (1 + 1e-12)


@pytest.mark.parametrize("shape", GENERAL.values(), ids=GENERAL)
def test_general_meshes_by_brute_force(shape):
    """Against every triangle in turn, and against rays for the side."""
    points = points_around(shape, 150, seed=7, far=1.3)
    local = (points - shape.com_o) @ shape.pose[:3, :3]
    made = trimesh.Trimesh(shape.vertices - shape.com_b, shape.faces, process=False)
    nearest, gaps, _ = trimesh.proximity.closest_point_naive(made, local)
    surface, _, distances = shape.project(points)
    assert np.abs(np.abs(distances) - gaps).max() < 2e-9  # the other's tolerance
    assert np.mean(np.abs(surface - (nearest @ shape.pose[:3, :3].T + shape.com_o)).max(axis=1) < 1e-5) > 0.98
    turns = np.round(np.random.default_rng(8).normal(size=3), 3)
    assert np.array_equal(distances < 0, inside_by_rays(made, local, turns / np.linalg.norm(turns)))
    assert np.array_equal(distances < 0, TriangleSurface(made.vertices, shape.faces).winding_number(local) > 0.5)
    assert 10 < np.sum(distances < 0) < 140


def inside_by_rays(made, points, direction):
    """Whether a ray from each point crosses the surface an odd number of times."""
    a, b, c = np.moveaxis(np.asarray(made.triangles), 1, 0)
    inside = []
    for p in points:
        ahead = np.stack([np.cross(v - p, w - p) @ direction for v, w in ((a, b), (b, c), (c, a))])
        crossed = (ahead > 0).all(axis=0) | (ahead < 0).all(axis=0)
        normal = np.cross(b - a, c - a)
        crossed &= ((a - p) * normal).sum(axis=1) / (normal @ direction) > 0
        inside.append(crossed.sum() % 2 == 1)
    return np.array(inside)


def test_a_ring_of_triangles_is_a_torus():
    shape = GENERAL["ring"]
    points = points_around(shape, 300, seed=9, far=1.2)
    local = (points - shape.com_o) @ shape.pose[:3, :3]
    exact = np.hypot(np.hypot(local[:, 0], local[:, 1]) - 0.04, local[:, 2]) - 0.012
    # Facets lie inside the torus by r (1 - cos(pi / n)) on the tube and by as much of the ring's outer radius.
    sag = 0.012 * (1 - np.cos(np.pi / 24)) + 0.052 * (1 - np.cos(np.pi / 48))
    assert np.abs(shape.project(points)[2] - exact).max() < 1.2 * sag


def knife():
    """A prism whose cross-section is a triangle with an angle of 6 degrees; its sharp edge is its first."""
    x, y, z = 0.06, 0.06 * np.tan(np.radians(3)), 0.05
    vertices = [[0, 0, -z], [0, 0, z], [x, y, -z], [x, y, z], [x, -y, -z], [x, -y, z]]
    faces = [[0, 1, 3], [0, 3, 2], [1, 0, 4], [1, 4, 5], [2, 3, 5], [2, 5, 4], [0, 2, 4], [1, 5, 3]]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("made, edge", [(trimesh.creation.box([0.04, 0.06, 0.1]), (0, 1)), (knife(), (0, 1))])
@pytest.mark.parametrize("side", [0, 1])
def test_flat_triangles_do_not_upset_the_side(made, edge, side):
    """An edge that is split on one face only, closed by a triangle without area."""
    i, j = edge
    k = len(made.vertices)
    pair = [f for f in range(len(made.faces)) if {i, j} <= set(made.faces[f])]
    split, kept = pair[side], pair[1 - side]
    halves = [np.where(made.faces[split] == end, k, made.faces[split]) for end in (i, j)]
    a, b = next((a, b) for a, b in zip(made.faces[kept], np.roll(made.faces[kept], -1)) if {a, b} == {i, j})
    faces = np.concatenate([np.delete(made.faces, split, axis=0), halves, [[b, a, k]]])
    vertices = np.concatenate([made.vertices, [made.vertices[[i, j]].mean(axis=0)]])
    shape, exact = Mesh(vertices=vertices, faces=faces, mass=1), mesh_of(made, density=None, mass=1)
    assert np.allclose(shape.inertia_b, exact.inertia_b)
    points = np.random.default_rng(10).normal(size=(2000, 3)) * 0.01 + vertices[k]
    distances = shape.project(points)[2]
    offsets = points[:, None] - made.triangles[:, 0]
    behind_all = (offsets * made.face_normals).sum(axis=2).max(axis=1) < 0  # both are convex
    assert np.array_equal(distances < 0, behind_all) and behind_all.sum() > 10
    assert np.abs(distances - exact.placed(np.eye(4)).project(points)[2]).max() < 1e-12


def test_normals_on_edges_are_the_mean_of_the_faces():
    shape = mesh_of(trimesh.creation.box([0.04, 0.06, 0.1]), pose=np.eye(4))
    _, normals, distances = shape.project([[0.02, 0.03, 0.01], [-0.02, 0.03, 0.05], [0.02, 0.01, 0.02]])
    assert np.abs(distances).max() < 1e-15
    assert np.allclose(normals[0], [-np.sqrt(0.5), -np.sqrt(0.5), 0])
    assert np.allclose(normals[1], np.array([1, -1, -1]) / np.sqrt(3))  # however the faces are cut into triangles
    assert np.allclose(normals[2], [-1, 0, 0])


@pytest.mark.parametrize("name", GENERAL)
def test_nearest_points_are_the_same_without_the_core(name, monkeypatch):
    mesh, rng = GENERAL[name], np.random.default_rng(secrets.randbelow(10**9))
    surface = TriangleSurface(mesh.vertices, mesh.faces)
    size = np.abs(mesh.vertices).max()
    points = np.concatenate(
        [
            size * rng.normal(size=(100, 3)),
            mesh.vertices[:20],
            mesh.vertices[mesh.faces[:20]].mean(axis=1),
            np.zeros((1, 3)),
        ]
    )
    compiled = surface.nearest(points)
    monkeypatch.setattr(core, "is_installed", lambda: False)
    for found, expected in zip(surface.nearest(points), compiled):
        assert found == pytest.approx(expected, abs=1e-9)


def test_many_points_at_once_are_the_same_as_few(monkeypatch):
    monkeypatch.setattr(core, "is_installed", lambda: False)
    ring = GENERAL["ring"]
    surface = TriangleSurface(ring.vertices, ring.faces)
    points = np.random.default_rng(11).normal(size=(200, 3)) * 0.03
    whole = surface.nearest(points)
    monkeypatch.setattr("pinograsp.objects.triangles._MOST_PAIRS", 500)
    for found, expected in zip(surface.nearest(points), whole):
        assert np.array_equal(found, expected)


# -- mass -----------------------------------------------------------------------------------------------------------

FINE = {
    "sphere": lambda s: trimesh.creation.icosphere(subdivisions=5, radius=s.radius),
    "cylinder": lambda s: trimesh.creation.cylinder(s.radius, s.height, sections=500),
    "disc": lambda s: trimesh.creation.cylinder(s.radius, s.height, sections=500),
    "capsule": lambda s: trimesh.creation.capsule(s.length, s.radius, count=[64, 64]),
    "box": lambda s: trimesh.creation.box(s.size),
    "ellipsoid": lambda s: scaled_ball(s.semi_axes),
    "lens": lambda s: scaled_ball(s.semi_axes),
    "rod": lambda s: scaled_ball(s.semi_axes),
}


def scaled_ball(semi_axes, subdivisions=5):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    ball.apply_scale(semi_axes)
    return ball


@pytest.mark.parametrize("name", PRIMITIVES)
def test_primitives_and_their_meshes_agree(name):
    shape = PRIMITIVES[name]
    mesh = mesh_of(FINE[name](shape), density=None, mass=shape.mass)
    tolerance = 1e-12 if name == "box" else 2e-3  # of the facets
    assert mesh.volume == pytest.approx(shape.volume, rel=tolerance)
    assert np.abs(mesh.inertia_b - shape.inertia_b).max() < tolerance * shape.inertia_b.max()
    assert mesh.bounding_radius == pytest.approx(shape.bounding_radius, rel=1e-4)
    points = points_around(shape, 200)
    surface, normals, distances = shape.project(points)
    there, turned, gaps = mesh.project(points)
    assert np.abs(gaps - distances).max() < 1.5e-3 * shape.bounding_radius
    outside = distances > 0
    assert np.abs(there - surface)[outside].max() < 0.03 * shape.bounding_radius
    assert (normals * turned).sum(axis=1)[outside].min() > np.cos(0.05)


def test_mass_and_density_follow_from_each_other():
    for make in (
        lambda **w: Sphere(radius=0.03, **w),
        lambda **w: Capsule(radius=0.02, length=0.05, **w),
        lambda **w: Box(size=[0.1, 0.2, 0.3], **w),
        lambda **w: mesh_of(bracket(), **{"density": None, **w}),
    ):
        heavy = make(mass=0.5)
        same = make(density=heavy.density)
        assert heavy.density == pytest.approx(0.5 / heavy.volume) and same.mass == pytest.approx(0.5)
        assert np.allclose(heavy.inertia_b, same.inertia_b)
        with pytest.raises(InvalidInput, match="neither"):
            make()
        with pytest.raises(InvalidInput, match=r"disagree.*give one"):
            make(mass=0.5, density=2 * heavy.density)
        for bad in ({"mass": 0}, {"mass": np.nan}, {"density": -1}, {"density": np.inf}, {"density": "lead"}):
            with pytest.raises(InvalidInput, match="expected"):
                make(**bad)
        # Copies of a record, with or without a change, need not say which was given.
        assert dataclasses.replace(heavy, pose=POSE).mass == 0.5
    assert dataclasses.replace(Sphere(radius=0.03, mass=0.5), radius=0.06, density=None).mass == 0.5


@every_shape
def test_records_copy_and_do_not_change(shape):
    point = points_around(shape, 1)
    pickled = pickle.loads(pickle.dumps(shape))
    for other in (copy.copy(shape), copy.deepcopy(shape), pickled, dataclasses.replace(shape)):
        assert np.allclose(other.project(point)[0], shape.project(point)[0], atol=1e-15)
        assert other.mass == pytest.approx(shape.mass, rel=1e-15)
    with pytest.raises(AttributeError):
        shape.mass = 1.0
    for array in (shape.pose, shape.inertia_b, getattr(shape, "vertices", shape.pose)):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 5


# -- curvature ------------------------------------------------------------------------------------------------------

SMOOTH = {
    "sphere": [[1, 0.2, 0.1], [0, 0, -1]],
    "cylinder": [[0.02, 0.001, 0.03], [-0.001, 0.02, -0.04], [0.01, 0.003, 0.05]],
    "capsule": [[0.02, 0.001, 0.02], [0.01, 0.01, 0.05], [0, 0, -0.06]],
    "box": [[0.02, 0.01, 0.03], [0.01, -0.03, 0.03], [0.01, 0.01, 0.05]],
    "ellipsoid": [[0.02, 0.01, 0.03], [0.01, -0.03, 0.03], [-0.01, 0.01, 0.001], [0, 0, 0.05]],
    "lens": [[0.02, 0.01, 0.002], [0.024, -0.032, 0], [0, 0, 0.01]],
    "rod": [[0.001, 0.05, 0.005], [0, 0.06, 0]],
}


@pytest.mark.parametrize("name", SMOOTH)
def test_curvature_is_the_turn_of_the_normal(name):
    shape = PRIMITIVES[name]
    points = shape.project(np.array(SMOOTH[name]) @ POSE[:3, :3].T + shape.com_o)[0]
    _, inward, _ = shape.project(points)
    curvatures, first = shape.curvature(points)
    assert np.abs(np.linalg.norm(first, axis=1) - 1).max() < 1e-12
    assert np.abs((first * inward).sum(axis=1)).max() < 1e-12
    assert np.all(curvatures[:, 0] <= curvatures[:, 1])
    step = 1e-5
    for direction, curvature in ((first, curvatures[:, 0]), (np.cross(inward, first), curvatures[:, 1])):
        ahead, behind = (shape.project(points + sign * step * direction)[1] for sign in (1, -1))
        turn = -(ahead - behind) / (2 * step)  # of the outward normal
        assert np.abs(turn - curvature[:, None] * direction).max() < 1e-4 * max(1, np.abs(curvatures).max())


def test_closed_forms_of_curvature():
    assert np.allclose(PRIMITIVES["sphere"].curvature(points_around(PRIMITIVES["sphere"], 5))[0], 1 / 0.03)
    can = Cylinder(radius=0.02, height=0.1, mass=1)
    curvatures, first = can.curvature([[0.02, 0, 0.01], [0.01, 0, 0.05]])
    assert np.allclose(curvatures, [[0, 50], [0, 0]]) and np.allclose(first[0], [0, 0, 1])
    pill = Capsule(radius=0.02, length=0.1, mass=1)
    assert np.allclose(pill.curvature([[0.02, 0, 0.01], [0.01, 0, 0.066]])[0], [[0, 50], [50, 50]])
    assert np.all(Box(size=[1, 1, 1], mass=1).curvature([[0.1, 0.2, 0.5], [-0.5, 0.3, 0.2]])[0] == 0)
    egg = Ellipsoid(semi_axes=[0.02, 0.03, 0.05], mass=1)
    curvatures, first = egg.curvature([[0.02, 0, 0], [0, -0.03, 0], [0, 0, 0.05]])  # c/a^2 at the end of c
    expected = [[0.02 / 0.05**2, 0.02 / 0.03**2], [0.03 / 0.05**2, 0.03 / 0.02**2], [0.05 / 0.03**2, 0.05 / 0.02**2]]
    assert np.allclose(curvatures, expected)
    assert np.allclose(np.abs(first), [[0, 0, 1], [0, 0, 1], [0, 1, 0]])


@pytest.mark.parametrize(
    "shape, point",
    [
        (Cylinder(radius=0.02, height=0.1, mass=1), [0.02, 0, 0.05]),
        (Cylinder(radius=0.02, height=0.1, mass=1), [0.03, 0, -0.06]),
        (Box(size=[0.1, 0.1, 0.1], mass=1), [0.05, 0.05, 0.01]),
        (Box(size=[0.1, 0.1, 0.1], mass=1), [0.06, 0.06, 0.06]),
    ],
)
def test_edges_have_no_curvature(shape, point):
    with pytest.raises(InvalidInput, match="no finite curvature: move the point off"):
        shape.curvature([point])
    shape.curvature([np.multiply(point, [1, 0.5, 0.5])])


@pytest.mark.parametrize("semi_axes", [(0.03, 0.03, 0.03), (0.02, 0.03, 0.05), (0.03, 0.03, 0.015)])
@pytest.mark.parametrize("subdivisions, height, tolerance", [(5, 0.1, 0.02), (4, 0.2, 0.04)])
def test_mesh_curvature_is_as_near_as_documented(semi_axes, subdivisions, height, tolerance):
    shape = Ellipsoid(semi_axes=semi_axes, mass=1)
    mesh = mesh_of(scaled_ball(semi_axes, subdivisions), pose=np.eye(4))
    points = shape.project(np.random.default_rng(12).normal(size=(40, 3)))[0]
    exact, first = shape.curvature(points)
    surface = TriangleSurface(mesh.vertices, mesh.faces)
    assert np.median(surface.heights) * exact.max() < height  # what the documented accuracy asks for
    found, direction = mesh.curvature(points)
    assert (np.abs(found - exact) / exact[:, 1:]).max() < tolerance
    _, inward, _ = mesh.project(points)
    assert np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 1e-12
    assert np.abs((direction * inward).sum(axis=1)).max() < 0.1
    told_apart = exact[:, 1] > 1.3 * exact[:, 0]
    assert np.all(np.abs((direction * first).sum(axis=1))[told_apart] > np.cos(np.radians(5)))
    wider, _ = mesh.curvature(points, radius=6 * np.median(surface.heights))  # twice the default's
    assert np.median(np.abs(wider - exact)) > np.median(np.abs(found - exact))


def test_mesh_curvature_of_hollows_and_flats():
    ring = GENERAL["ring"]
    outer, inner = np.array([[0.052, 0, 0], [0.028, 0, 0]]) @ POSE[:3, :3].T + ring.com_o
    curvatures, _ = ring.curvature([outer, inner])
    assert np.abs(curvatures - [[1 / 0.052, 1 / 0.012], [-1 / 0.028, 1 / 0.012]]).max() < 0.08 / 0.012
    can = mesh_of(trimesh.creation.cylinder(0.02, 0.1, sections=64), pose=np.eye(4))  # facets as long as the can
    curvatures, first = can.curvature([[0.02, 0, 0.013], [0.005, 0, 0.05]])
    assert np.abs(curvatures - [[0, 50], [0, 0]]).max() < 2 and np.allclose(np.abs(first[0]), [0, 0, 1], atol=1e-2)
    spike = trimesh.creation.cone(0.001, 0.1)
    with pytest.raises(InvalidInput, match="tip"):
        mesh_of(spike, pose=np.eye(4)).curvature([[0, 0, 1.0]])
    with pytest.raises(InvalidInput, match="radius of the curvature fit"):
        can.curvature([[0.02, 0, 0]], radius=0)


# -- meshes ---------------------------------------------------------------------------------------------------------


def test_meshes_stay_in_their_files_frame():
    made = bracket()
    made.apply_translation([3.0, -2.0, 5.0])  # far off, as parts of an assembly are
    shape = mesh_of(made, mass=0.3, density=None)
    assert np.array_equal(shape.vertices, made.vertices) and np.allclose(shape.com_b, made.center_mass, atol=1e-12)
    unit = trimesh.Trimesh(made.vertices - made.center_mass, made.faces)
    assert np.allclose(shape.inertia_b, unit.moment_inertia / unit.volume * 0.3, rtol=1e-9)
    for there in (shape, shape.placed(np.eye(4)), dataclasses.replace(shape, pose=MOVE)):
        assert np.allclose(there.com_o, there.pose[:3, :3] @ made.center_mass + there.pose[:3, 3], atol=1e-12)
        in_world = made.vertices @ there.pose[:3, :3].T + there.pose[:3, 3]
        assert np.abs(there.project(in_world)[2]).max() < 1e-12


@pytest.mark.parametrize("format", ["stl", "obj", "ply", "glb", "off"])
def test_files_of_every_format(tmp_path, format):
    made = bracket()
    made.apply_scale(1000)
    made.export(tmp_path / f"part.{format}")
    shape = Mesh.load(tmp_path / f"part.{format}", scale=1e-3, density=500, pose=POSE)
    expected = GENERAL["bracket"]
    assert shape.volume == pytest.approx(expected.volume, rel=1e-6)
    assert np.abs(shape.inertia_b - expected.inertia_b).max() < 1e-6 * expected.inertia_b.max()
    points = points_around(expected, 50)
    assert np.abs(shape.project(points)[2] - expected.project(points)[2]).max() < 1e-7  # single precision
    assert shape.notes == () and len(shape.vertices) == 12


def test_files_with_several_parts_and_seams(tmp_path):
    one, two = trimesh.creation.box([0.1, 0.1, 0.1]), trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    two.apply_translation([0.3, 0, 0])
    trimesh.Scene([one, two]).export(tmp_path / "two.glb")
    shape = Mesh.load(tmp_path / "two.glb", mass=1)
    assert shape.volume == pytest.approx(one.volume + two.volume, rel=1e-5)
    # A texture seam writes the corners of a face twice: still one surface.
    corners = one.vertices[one.faces].reshape(-1, 3)
    text = [f"v {x} {y} {z}" for x, y, z in corners] + [f"vt {i / 36} 0" for i in range(36)]
    text += [f"f {i}/{i} {i + 1}/{i + 1} {i + 2}/{i + 2}" for i in range(1, 36, 3)]
    (tmp_path / "seams.obj").write_text("\n".join(text))
    assert Mesh.load(tmp_path / "seams.obj", mass=1).volume == pytest.approx(1e-3)


def test_convex_hulls_mend_open_meshes():
    made = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    torn = trimesh.Trimesh(made.vertices, made.faces[7:], process=False)
    with pytest.raises(InvalidInput, match=r"watertight.*open edges.*convex=True"):
        mesh_of(torn)
    hull = mesh_of(torn, convex=True)
    assert hull.volume == pytest.approx(made.volume, rel=1e-9) and hull.convex
    assert mesh_of(bracket(), convex=True).volume > 1.2 * mesh_of(bracket()).volume


def test_small_holes_of_scans_are_closed():
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    holes = [10, 11, 2000, 4000]
    torn = trimesh.Trimesh(made.vertices, np.delete(made.faces, holes, axis=0), process=False)
    mended = mesh_of(torn)
    assert mended.volume == pytest.approx(made.volume, rel=1e-4)
    (note,) = mended.notes
    assert note == "small holes (10 open edges) were closed, 0.077 % of the surface"
    torn = trimesh.Trimesh(made.vertices, made.faces[np.arange(len(made.faces)) % 300 > 0], process=False)  # 0.33 %
    with pytest.raises(InvalidInput, match="watertight"):
        mesh_of(torn)


def test_meshes_that_are_inside_out_are_turned():
    made = hollow_box()
    expected = mesh_of(made)
    made.invert()
    shape = mesh_of(made)
    assert "inside out" in shape.notes[0]
    points = points_around(shape)
    assert np.array_equal(shape.project(points)[2], expected.project(points)[2])
    assert shape.volume == expected.volume == pytest.approx(0.06 * 0.08 * 0.1 - 0.02 * 0.03 * 0.04)
    assert dataclasses.replace(shape, pose=MOVE).notes == shape.notes


def test_cavities_are_not_part_of_the_solid():
    shape = GENERAL["hollow box"].placed(np.eye(4))
    _, normals, distances = shape.project([[0.01, 0, 0.005 + 0.015], [0.027, 0, 0]])
    assert distances == pytest.approx([0.005, -0.003])
    assert np.allclose(normals[0], [0, 0, 1])  # from the cavity into the wall


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def moved_box(by, size=(0.1, 0.1, 0.1), inverted=False):
    box = trimesh.creation.box(size)
    box.apply_translation(by)
    if inverted:
        box.invert()
    return box


def faces_changed(change):
    box = trimesh.creation.box([0.1, 0.1, 0.1])
    return {"vertices": box.vertices, "faces": change(np.array(box.faces))}


def joined(*parts):
    made = trimesh.util.concatenate(parts)
    return {"vertices": made.vertices, "faces": made.faces}


@pytest.mark.parametrize(
    "arrays, match",
    [
        ({"vertices": [], "faces": []}, "empty mesh"),
        ({"vertices": np.eye(3), "faces": np.empty((0, 3))}, "empty mesh"),
        ({"vertices": np.full((4, 3), np.nan), "faces": [[0, 1, 2]]}, "12 that are not"),
        ({"vertices": "a cube", "faces": [[0, 1, 2]]}, "expected numbers"),
        ({"vertices": np.eye(4), "faces": [[0, 1, 2]]}, "expected shape"),
        ({"vertices": np.eye(3), "faces": [[0, 1, 3]]}, "whole numbers from 0 to 2"),
        ({"vertices": np.eye(3), "faces": [[0, 1, 0.5]]}, "whole numbers"),
        ({"vertices": np.eye(3), "faces": [[0, 1]]}, "expected shape"),
        ({"vertices": 1e-10 * np.eye(3), "faces": [[0, 1, 2]]}, "are the units right"),
        ({"vertices": SQUARE, "faces": [[0, 1, 2], [0, 2, 1]]}, "at least four"),
        ({"vertices": SQUARE, "faces": [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]}, "around a volume"),
        (faces_changed(lambda f: f[1:]), "3 open edges"),
        (faces_changed(lambda f: np.concatenate([f, f[:1], f[:1, ::-1]])), "edges with more"),
        (faces_changed(lambda f: np.concatenate([f[1:], f[:1, ::-1]])), "neighbours disagree"),
        (joined(moved_box([0, 0, 0]), moved_box([0, 0, 0], (0.02,) * 3)), "one solid inside another"),
        (joined(moved_box([0, 0, 0]), moved_box([1, 0, 0], inverted=True)), "the other way round"),
        ({**joined(moved_box([0, 0, 0])), "convex": "yes"}, "True or False"),
        ({"vertices": SQUARE, "faces": [[0, 1, 2], [0, 2, 3]], "convex": True}, "in one plane"),
    ],
)
def test_meshes_that_bound_no_solid_are_refused(arrays, match):
    with pytest.raises(InvalidInput, match=match) as caught:
        Mesh(**arrays, mass=1)
    assert "expected" in str(caught.value) and len(str(caught.value)) < 500


def test_parts_that_meet_are_one_solid(tmp_path, monkeypatch):
    """A box with a peg on it and a ball through its side: the volumes of union and overlap, from a file or several."""
    box, peg, ball = (
        moved_box([0, 0, 0]),
        moved_box([0, 0, 0.075], (0.04, 0.04, 0.05)),
        trimesh.creation.icosphere(3, 0.03),
    )
    apart = joined(box, moved_box([1, 0, 0]))
    touching, crossing = (
        Mesh(**joined(box, peg), mass=1.0),
        Mesh(**joined(box, peg, ball, moved_box([0.05, 0, 0])), mass=1.0),
    )
    assert touching.volume == pytest.approx(box.volume + peg.volume, rel=1e-9)
    assert crossing.volume == pytest.approx(1.5 * box.volume + peg.volume, rel=1e-9)  # the ball is inside
    assert touching.notes == ("2 parts that meet were united",) and Mesh(**apart, mass=1.0).notes == ()
    scene = trimesh.Scene([box, peg])
    scene.export(tmp_path / "decomposed.obj")
    paths = [tmp_path / "box.ply", tmp_path / "peg.stl"]
    for part, path in zip((box, peg), paths):
        part.export(path)
    for loaded in (
        Mesh.load(tmp_path / "decomposed.obj", mass=1.0),
        Mesh.load(paths[:1] + [tmp_path / "decomposed.obj"], mass=1),
    ):
        assert loaded.volume == pytest.approx(touching.volume, rel=1e-6)
        assert loaded.project([[0.021, 0.0, 0.2]])[2].size == 1
    box.export(tmp_path / "box.stl")
    assert Mesh.load([tmp_path / "box.stl", tmp_path / "peg.stl"], mass=1).volume == pytest.approx(
        touching.volume, rel=1e-6
    )
    open_part = trimesh.Trimesh(peg.vertices, peg.faces[1:])
    with pytest.raises(InvalidInput, match="open edges"):
        Mesh(**joined(box, open_part), mass=1.0)
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(
        InvalidInput, match=r"(meeting at|edges with more).*pip install 'pinograsp\[mesh\]' unites the 2 parts"
    ):
        Mesh(**joined(box, peg), mass=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("made", [bracket(), hollow_box(), trimesh.creation.annulus(0.03, 0.04, 0.05, sections=24)])
def test_convex_parts_are_about_the_solid(made, monkeypatch):
    """Every point of the solid lies in a part, none of a part is farther out than they say, and all come again."""
    shape = mesh_of(made, pose=np.eye(4))
    parts, excess = shape.convex_parts
    assert len(parts) > 1 and shape.placed(POSE).convex_parts is shape.convex_parts
    placed = [part @ shape.shape_pose[:3, :3].T + shape.shape_pose[:3, 3] for part in parts]
    hulls = [trimesh.convex.convex_hull(part) for part in placed]
    assert sum(hull.volume for hull in hulls) == pytest.approx(shape.volume, rel=0.05)
    points = points_around(shape, 400)
    distance = shape.project(points)[2]
    within = np.any([hull.contains(points) for hull in hulls], axis=0)
    assert within[distance < -1e-3].all() and not within[distance > excess + 1e-4].any()
    again = mesh_of(made, pose=np.eye(4)).convex_parts
    assert all(np.array_equal(one, two) for one, two in zip(parts, again.corners, strict=True))
    assert len(mesh_of(made, convex=True).convex_parts.corners) == 1
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ExtraMissing, match=r"pip install 'pinograsp\[mesh\]'"):
        _ = mesh_of(made).convex_parts


@pytest.mark.slow
def test_surfaces_that_cross_themselves_have_no_convex_parts(monkeypatch):
    """They would be searched for without end; a crossing of a few small triangles, as scans have them, is fine."""
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    vertices = box.vertices.copy()
    vertices[[0, 1]] = vertices[[1, 0]]
    with pytest.raises(InvalidInput, match=r"does not cross itself.*over \d+ % of its area"):
        _ = Mesh(vertices=vertices, faces=box.faces, mass=1).convex_parts
    asked = []
    coacd = types.ModuleType("coacd")
    coacd.set_log_level, coacd.Mesh = print, lambda *mesh: mesh
    coacd.run_coacd = lambda mesh, **settings: asked.append(mesh) or [(box.vertices, box.faces)]
    monkeypatch.setitem(sys.modules, "coacd", coacd)
    fine = box.subdivide_to_size(0.002)
    vertices = fine.vertices.copy()
    vertices[np.linalg.norm(vertices - [0.01, 0, 0], axis=1).argmin(), 0] = -0.012  # through the opposite side
    assert Mesh(vertices=vertices, faces=fine.faces, mass=1).convex_parts and asked


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="existing file"):
        Mesh.load(tmp_path / "none.stl", mass=1)
    for wrong in (None, 3, [tmp_path, 3]):
        with pytest.raises(InvalidInput, match="mesh files: expected a sequence of str or Path"):
            Mesh.load(wrong, mass=1)
    with pytest.raises(InvalidInput, match="one or more, got none"):
        Mesh.load([], mass=1)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InvalidInput, match=r"expected one of \.stl, \.obj"):
        Mesh.load(tmp_path / "notes.txt", mass=1)
    for content, format in itertools.product((b"", b"not a mesh at all\n" * 9), ("stl", "obj", "ply", "glb", "off")):
        (tmp_path / f"broken.{format}").write_bytes(content)
        with pytest.raises(InvalidInput, match=rf"broken\.{format}'.*expected"):
            Mesh.load(tmp_path / f"broken.{format}", mass=1)
    trimesh.creation.box().export(tmp_path / "box.stl")
    for bad in ({"scale": 0}, {"scale": -1}, {"mass": -1}, {}, {"mass": 1, "pose": np.eye(3)}):
        with pytest.raises(InvalidInput, match="expected"):
            Mesh.load(tmp_path / "box.stl", **{"mass": None, **bad})


def test_thousands_of_triangles_and_one():
    tetrahedron = mesh_of(trimesh.creation.icosahedron().convex_hull, pose=np.eye(4))
    assert tetrahedron.project([[2.0, 0, 0]])[2] > 0.9
    fine = trimesh.creation.icosphere(subdivisions=6, radius=0.03)
    shape = mesh_of(fine, pose=np.eye(4))
    points = np.random.default_rng(13).normal(size=(200, 3)) * 0.05
    assert np.abs(shape.project(points)[2] - (np.linalg.norm(points, axis=1) - 0.03)).max() < 1e-5


# -- sizes, texts, contacts -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda: Capsule(radius=0, length=1, mass=1),
        lambda: Capsule(radius=1, length=-1, mass=1),
        lambda: Box(size=[1, 2], mass=1),
        lambda: Box(size=[1, 2, 0], mass=1),
        lambda: Box(size=[1, 2, np.nan], mass=1),
        lambda: Box(size="big", mass=1),
        lambda: Ellipsoid(semi_axes=[1, -2, 3], mass=1),
        lambda: Ellipsoid(semi_axes=1, mass=1),
        lambda: Sphere(radius=1e-150, density=1),
        lambda: Sphere(radius=1e150, density=1),
        lambda: Box(size=[1, 1, 1], mass=1, pose=np.full((4, 4), np.nan)),
        lambda: Box(size=[1, 1, 1], mass=1).placed(np.eye(3)),
        lambda: Box(size=[1, 1, 1], mass=1).project([1, 2, 3]),
        lambda: Box(size=[1, 1, 1], mass=1).curvature([[1, 2, np.inf]]),
    ],
)
def test_bad_input_is_refused(make):
    with pytest.raises(InvalidInput, match="expected"):
        make()


def test_texts_make_the_same_objects(tmp_path):
    for text, expected in (
        ("sphere:radius=0.03,mass=0.4", Sphere(radius=0.03, mass=0.4)),
        ("cylinder:radius=0.02,height=0.12,mass=0.2", Cylinder(radius=0.02, height=0.12, mass=0.2)),
        (" capsule: length = 5e-2, radius=2e-2 ,density=900", Capsule(radius=0.02, length=0.05, density=900)),
        ("box:size=0.04x0.06x0.1,density=500", Box(size=[0.04, 0.06, 0.1], density=500)),
        ("ellipsoid:semi_axes=0.02x0.03x0.04,mass=0.1", Ellipsoid(semi_axes=[0.02, 0.03, 0.04], mass=0.1)),
    ):
        made = object_from(text)
        assert type(made) is type(expected)
        for name in (field.name for field in dataclasses.fields(expected)):
            assert np.array_equal(getattr(made, name), getattr(expected, name)), name
    path = tmp_path / "an odd, name: =1.stl"
    large = bracket()
    large.apply_scale(1000)
    large.export(path)
    shape = object_from(f"mesh:path={path},scale=0.001,density=400")
    assert shape.mass == pytest.approx(400 * GENERAL["bracket"].volume, rel=1e-6) and not shape.convex
    hull = object_from(f"mesh:path={path},scale=0.001,density=400,convex=true")
    assert hull.convex and hull.mass > 1.2 * shape.mass


@pytest.mark.parametrize(
    "text, match",
    [
        ("spere:radius=1,mass=1", "expected one of sphere, cylinder.*did you mean 'sphere'"),
        ("", "expected one of sphere"),
        (None, "expected a text such as"),
        ("sphere:radios=1,mass=1", "field of sphere: expected one of radius, mass, density.*did you mean 'radius'"),
        ("sphere:mass=1", "got no radius"),
        ("sphere", "got no radius"),
        ("sphere:radius=1", "got neither"),
        ("sphere:radius=1,mass=1,density=1", "give one of them"),
        ("sphere:radius=1,mass", "expected"),
        ("sphere:radius=1,radius=2,mass=1", "radius twice"),
        ("sphere:radius=big,mass=1", "expected a number"),
        ("sphere:radius=nan,mass=1", "finite"),
        ("sphere:radius,mass=1", "expected field=value"),
        ("box:size=1x2,mass=1", "box size: expected shape"),
        ("box:size=1x2xx,mass=1", "expected three lengths"),
        ("cylinder:radius=1,mass=1,heigth=2", "did you mean 'height'"),
        ("mesh:path=none.stl,mass=1", "existing file"),
        ("mesh:scale=1,mass=1", "got no path"),
        ("mesh:path=none.stl,mass=1,convex=maybe", "true or false"),
    ],
)
def test_texts_that_describe_nothing_are_refused(text, match):
    with pytest.raises(InvalidInput, match=match):
        object_from(text)


@every_shape
def test_contacts_can_be_made_on_every_shape(shape):
    points = shape.project(points_around(shape, 6))[0]
    contacts = contacts_at(None, shape, points)
    _, normals, _ = shape.project(points)
    assert np.allclose([c.normal_o for c in contacts], normals)
    assert np.array_equal(contacts.com_o, shape.com_o)


@pytest.mark.parametrize("name", ["cylinder", "disc", "box", "mesh of the cylinder", "mesh of the box"])
def test_on_an_edge_rounding_does_not_decide_the_normal(name):
    """Points on rims, edges and corners, moved by rounding: one normal, the mean of the faces', for project and
    contacts alike.
    """
    own = PRIMITIVES[name.split()[-1]]
    shape = own
    if name.startswith("mesh"):
        made = (
            trimesh.creation.box(own.size)
            if "box" in name
            else trimesh.creation.cylinder(own.radius, own.height, sections=16)
        )
        shape = mesh_of(made)
    if "box" in name:
        half = own.size / 2
        edge = np.array([[half[0], -half[1], 0.01], [0.01, half[1], half[2]], half, -half])
        outward = np.sign(edge) * (np.abs(edge) == half)
    else:
        angle = 2 * np.pi * np.arange(16) / 16 + np.pi / 16
        reach = own.radius * (np.cos(np.pi / 16) if name.startswith("mesh") else 1)
        around = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        edge, outward = reach * around + [0, 0, own.height / 2], around + [0, 0, 1]
    outward = outward / np.linalg.norm(outward, axis=1)[:, None]
    rotation = POSE[:3, :3]
    points = edge @ rotation.T + POSE[:3, 3]
    rng = np.random.default_rng(0)
    for off in (0.0, 1e-17, 1e-16, 1e-12):
        moved = points + off * rng.normal(size=points.shape)
        for normals in (
            shape.project(moved)[1],
            np.array([shape.project(point[None])[1][0] for point in moved]),
            np.array([contact.normal_o for contact in contacts_at(None, shape, moved)]),
        ):
            assert np.abs(normals + outward @ rotation.T).max() < 1e-9
