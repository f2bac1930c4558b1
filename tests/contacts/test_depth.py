"""Depths along common normals: by the compiled core as by coal, and to where the surfaces just touch."""

import secrets

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.optimize import minimize_scalar

import pinograsp as pg
from pinograsp.contacts.clearance import Distances, parts_of
from pinograsp.contacts.penetration import deepest_of
from pinograsp.errors import GeometryFailed
from pinograsp.spatial import pose_of

DEEP = 1e-3  # [m]


def beaker():
    outer, inner = (trimesh.creation.cylinder(radius=r, height=0.06, sections=24) for r in (0.02, 0.017))
    inner.apply_translation([0, 0, 0.004])
    solid = trimesh.boolean.difference([outer, inner], engine="manifold")
    return pg.Mesh(vertices=solid.vertices, faces=solid.faces, mass=0.1)


OBJECTS = (
    pg.Box(size=(0.03, 0.04, 0.05), mass=0.1),
    pg.Ellipsoid(semi_axes=(0.02, 0.03, 0.04), mass=0.1),
    beaker(),
)


def test_the_core_finds_the_distances_that_coal_does():
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    clear = 0
    for name in ("allegro_right", "talos_left"):
        hand = pg.load_hand(name)
        parts = [part for part in parts_of(hand) if part.joint]
        for body in OBJECTS * 8:
            part, distances = parts[rng.integers(len(parts))], Distances(hand, body)
            middle = distances.data.oMi[part.joint].act(part.centre)
            way = rng.normal(size=3)
            off = (part.radius + body.bounding_radius) * rng.uniform(0.5, 1.5) * way / np.linalg.norm(way)
            distances.put_object(body.placed(pose_of(middle + off, pin.exp3(rng.normal(size=3)))))
            found, gap = distances.of(part), distances.bound(part)
            distances.compiled = distances.compiled_hull = None
            coal_gap = distances.bound(part)
            distance, _ = distances.of(part)
            if distance <= 0.0:
                continue
            clear += 1
            assert found[0] == pytest.approx(distance, abs=1e-7), seed
            surface, _, _ = distances.body.project(found[1][None])
            assert np.linalg.norm(surface[0] - found[1]) == pytest.approx(distance, abs=1e-6), seed
            assert (gap.parted, gap.point is None) == (coal_gap.parted, coal_gap.point is None), seed
            assert gap.distance == pytest.approx(coal_gap.distance, abs=1e-7), seed
            assert np.linalg.norm(gap.normal - coal_gap.normal) < 1e-2, seed
    assert clear > 20, seed


def test_the_core_finds_the_depths_that_coal_does():
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    hand = pg.load_hand("allegro_right")
    parts = [part for part in parts_of(hand) if part.joint]
    alike = compared = 0
    for body in OBJECTS * 8:
        part, way = parts[rng.integers(len(parts))], rng.normal(size=3)
        way /= np.linalg.norm(way)
        distances = Distances(hand, body)
        at = distances.data.oMi[part.joint].translation
        distances.put_object(body.placed(pose_of(at, pin.exp3(rng.normal(size=3)))))
        away = 0.2  # clear, and from there nearer until it is a millimetre inside
        for _ in range(8):
            distances.move_object(away * way, np.eye(3))
            away -= distances.of(part)[0]
        away -= DEEP
        distances.move_object(away * way, np.eye(3))
        found = []
        for compiled in (distances.compiled, None):
            distances.compiled = compiled
            try:
                found.append(deepest_of(distances, part, way))
            except GeometryFailed:
                break
        if len(found) < 2:
            continue
        compared += 1
        alike += abs(found[0][0] - found[1][0]) < 1e-6
        # Moved off by its depth, the object just touches the part.
        depth, normal, _ = found[0]
        distances.move_object(away * way + depth * normal, np.eye(3))
        assert distances.of(part)[0] > -1e-5, f"seed {seed}"
    assert compared > 12 and alike >= 0.8 * compared, f"seed {seed}: {alike} of {compared}"


def test_depths_of_ellipsoids_in_a_cylinder_are_exact():
    """Along a normal across its axis a cylinder reaches its radius, and an ellipsoid sqrt(n^T A n)."""
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    hand = pg.load_case("paper").load_hand()
    cylinder = pg.Cylinder(radius=0.03, height=0.2, mass=0.1)
    parts = [part for part in parts_of(hand) if isinstance(part.geometry, coal.Ellipsoid)]
    compared = 0
    for _ in range(200):
        part, distances = parts[rng.integers(len(parts))], Distances(hand, cylinder)
        own, R = distances.data.oMi[part.joint] * part.placement, pin.exp3(rng.normal(size=3))
        A = own.rotation @ np.diag(np.square(part.geometry.radii)) @ own.rotation.T

        def reach(angle, R=R, A=A):
            n = R @ (np.cos(angle), np.sin(angle), 0)
            return n, cylinder.radius + np.sqrt(n @ A @ n)

        turn = rng.uniform(0, 2 * np.pi)
        way, far = reach(turn)
        off = (far - rng.uniform(0.1, 3) * DEEP) * way
        distances.put_object(cylinder.placed(pose_of(own.translation + off, R)))
        depth, normal, point = deepest_of(distances, part, way)
        if abs(R[:, 2] @ (point - own.translation)) > 0.4 * cylinder.height:
            continue
        compared += 1
        found = minimize_scalar(
            lambda angle, reach=reach, off=off: reach(angle)[1] - reach(angle)[0] @ off,
            bounds=(turn - 0.5, turn + 0.5),
            options={"xatol": 1e-9},
            method="bounded",
        )
        assert depth == pytest.approx(found.fun, abs=1e-8), f"seed {seed}"
        assert normal == pytest.approx(reach(found.x)[0], abs=1e-3), f"seed {seed}"
    assert compared > 100, f"seed {seed}: {compared}"
