"""Where hands touch objects, found by the compiled core: against coal, Pinocchio, and by hand."""

from __future__ import annotations

import dataclasses
import itertools
import secrets

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from convex_shapes import draw_placement, draw_shapes, extent

from pinograsp import core
from pinograsp.contacts.bulk import BulkContacts, BulkScene
from pinograsp.contacts.clearance import parts_of
from pinograsp.contacts.compiled import corners_of, support_shape
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.hands import load_hand
from pinograsp.hands.mesh_file import collision_model
from pinograsp.objects import Box, Cylinder, Sphere

SEED = secrets.randbelow(10**9)
FAR = 1.0  # [m]


def scene_of(one, at, other, there):
    """A hand of one part that nothing moves, and an object."""
    scene = core.load().Scene(0, np.eye(4), there.homogeneous)
    scene.add_part(-1, at.homogeneous, 0, *support_shape(one), corners_of(one))
    scene.add_solid(*support_shape(other))
    return scene


def touch(scene, tolerance):
    return scene.touch(np.zeros((1, 0)), np.eye(4)[None], tolerance=tolerance, lean=0.03, gravity=np.zeros(3))


def distance(one, at, other, there):
    """Coal's signed distance, and the nearest point of the second."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance, request.gjk_tolerance, request.epa_tolerance = True, 1e-12, 1e-9
    request.gjk_max_iterations = 1000
    poses = [coal.Transform3s(frame.rotation, frame.translation) for frame in (at, there)]
    return coal.distance(one, poses[0], other, poses[1], request, result), np.array(result.getNearestPoint2())


def test_gaps_between_shapes_are_those_of_coal():
    rng, gap = np.random.default_rng(SEED), np.zeros(1)
    for one, other in itertools.product(draw_shapes(rng, 0.01), repeat=2):
        at, there = draw_placement(rng, 0.05), draw_placement(rng, 0.05)
        expected, point = distance(one, at, other, there)
        if not 1e-4 < expected < FAR:
            continue
        scene = scene_of(one, at, other, there)
        scene.gaps(np.zeros((1, 0)), np.eye(4)[None], np.zeros(1, dtype=np.int64), FAR, gap)
        found = touch(scene, FAR)
        # No more than a plane between them leaves, no less than coal finds: where that errs, it is too near.
        free = -extent(one, at, found.normals) - extent(other, there, -found.normals)
        for value in (gap[0], found.gap[0]):
            assert expected - 1e-8 < value < free + 1e-12, SEED
        assert abs((found.points - point) @ found.normals) < 1e-6, SEED


def test_a_shape_that_is_moved_out_by_its_depth_just_touches():
    rng = np.random.default_rng(SEED)
    overlaps = 0
    for one, other in itertools.product(draw_shapes(rng, 0.01), repeat=2):
        at, there = draw_placement(rng, 0.005), draw_placement(rng, 0.005)
        if distance(one, at, other, there)[0] > -1e-4:
            continue
        found = touch(scene_of(one, at, other, there), FAR)
        depth, normal = -found.gap[0], found.normals
        assert depth > 1e-4, SEED
        out = pin.SE3(there.rotation, there.translation + (depth + 1e-4) * normal)
        clear, _ = distance(one, at, other, out)
        assert abs(clear - 1e-4) < 2e-6, SEED
        # Each direction leads out, none of them much sooner.
        for along in rng.normal(size=(20, 3)):
            sooner = 0.99 * (depth - 1e-4) * along / np.linalg.norm(along)
            assert distance(one, at, other, pin.SE3(there.rotation, there.translation + sooner))[0] < 1e-6, SEED
        overlaps += 1
    assert overlaps > 12, SEED


def test_a_ball_in_a_box_has_the_nearest_face():
    for middle, depth, normal in (([0.0, 0.0, 0.025], 0.015, [0, 0, -1]), ([-0.06, 0.0, 0.0], -0.0, [1, 0, 0])):
        at = pin.SE3(np.eye(3), np.array(middle))
        found = touch(scene_of(coal.Sphere(0.01), at, coal.Box(0.1, 0.08, 0.06), pin.SE3.Identity()), 0.02)
        assert found.gap[0] == pytest.approx(-depth, abs=1e-12) and np.allclose(found.normals, normal, atol=1e-9)


def beaker_with(one, at):
    """A part of a hand at a beaker of one surface, whose convex parts are sectors of its wall, and the wall's radius."""
    outer = trimesh.creation.cylinder(radius=0.035, height=0.08, sections=64)
    inner = trimesh.creation.cylinder(radius=0.03, height=0.08, sections=64)
    inner.apply_translation([0, 0, 0.006])
    beaker = trimesh.boolean.difference([outer, inner], engine="manifold")
    scene = core.load().Scene(0, np.eye(4), np.eye(4))
    scene.add_part(-1, at.homogeneous, 0, *support_shape(one), np.zeros((0, 3, 3)))
    for i in range(64):
        angles = 2 * np.pi * np.array([i, i + 1]) / 64
        ring = np.column_stack([np.cos(angles), np.sin(angles)])
        flat = np.vstack([0.03 * ring, 0.035 * ring])
        points = np.vstack([np.column_stack([flat, np.full(4, z)]) for z in (-0.034, 0.04)])
        scene.add_solid(points, np.zeros(3))
    scene.put(corners_of(collision_model(np.array(beaker.vertices), np.array(beaker.faces))))
    return scene


TURN = pin.exp3(np.array([0, 0, np.pi / 64]))  # to the middle of a side
WALL = 0.03 * np.cos(np.pi / 64)  # [m] of the polygon, there


def test_a_ball_in_a_beaker_touches_the_inner_wall_and_not_the_hull():
    found = touch(beaker_with(coal.Sphere(0.01), pin.SE3(np.eye(3), TURN @ [WALL - 0.009, 0.0, 0.01])), 0.002)
    assert found.gap[0] == pytest.approx(-0.001, abs=1e-7)
    assert np.allclose(found.normals, TURN @ [1, 0, 0], atol=1e-4)
    assert np.allclose(found.points, TURN @ [WALL, 0.0, 0.01], atol=1e-6)


def test_a_bar_through_the_wall_of_a_beaker_does_not_touch_but_is_as_deep_as_its_shorter_end():
    # From 0.02 to 0.05 m off the axis, the wall between 0.03 and 0.035.
    at = pin.SE3(TURN, TURN @ [0.035, 0.0, 0.0])
    found = touch(beaker_with(coal.Box(0.03, 0.004, 0.004), at), 0.002)
    assert not found.gap.size and found.depth[0] == pytest.approx(0.035 - 0.02, abs=1e-4)


def ring(rng):
    """The surface of a torus, for coal."""
    radius = rng.uniform(0.01, 0.03)
    torus = trimesh.creation.torus(radius, 0.3 * radius, major_sections=12, minor_sections=8)
    return collision_model(np.array(torus.vertices), np.array(torus.faces))


def test_gaps_of_meshes_are_those_of_coal():
    rng, gap, compared = np.random.default_rng(SEED), np.zeros(1), 0
    for other in 10 * draw_shapes(rng, 0.01):
        one, at, there = ring(rng), draw_placement(rng, 0.03), draw_placement(rng, 0.03)
        expected, _ = distance(one, at, other, there)
        scene = core.load().Scene(0, np.eye(4), there.homogeneous)
        scene.add_part(-1, at.homogeneous, 0, np.zeros((0, 3)), np.zeros(3), corners_of(one))
        scene.add_solid(*support_shape(other))
        scene.gaps(np.zeros((1, 0)), np.eye(4)[None], np.zeros(1, dtype=np.int64), FAR, gap)
        assert (gap[0] > 0) == (expected > 0), SEED
        # Coal's distances of ellipsoids are off by up to 2e-8; projections onto them agree with the core to 1e-12.
        near = 1e-7 if isinstance(other, coal.Ellipsoid) else 1e-8
        assert expected < 1e-4 or abs(gap[0] - expected) < near, SEED
        compared += expected > 1e-4
    assert compared > 10, SEED


def test_meshes_that_hit_each_other_are_those_of_coal():
    rng, hits = np.random.default_rng(SEED), 0
    for _ in range(100):
        forms, places = [ring(rng), ring(rng)], [draw_placement(rng, 0.015), draw_placement(rng, 0.015)]
        scene = core.load().Scene(0, np.eye(4), np.eye(4))
        for form, at in zip(forms, places):
            scene.add_part(-1, at.homogeneous, 0, *support_shape(form.convex or form), corners_of(form))
        scene.add_pair(0, 1)
        scene.add_solid(np.full((1, 3), FAR), np.zeros(3))
        poses = [coal.Transform3s(at.rotation, at.translation) for at in places]
        expected = coal.collide(forms[0], poses[0], forms[1], poses[1], coal.CollisionRequest(), coal.CollisionResult())
        assert (touch(scene, 1e-3).collision[0] == 0) == bool(expected), SEED
        hits += bool(expected)
    assert 10 < hits < 90, SEED


@pytest.mark.parametrize("name", ["allegro_right", "psyonic_left", "pr2_left", "baxter_left"])
def test_places_jacobians_and_weights_are_pinocchios(name):
    rng = np.random.default_rng(SEED)
    hand = load_hand(name).placed(draw_placement(rng, 0.2).homogeneous)
    body = Sphere(radius=0.03, mass=0.1, pose=draw_placement(rng, 0.1).homogeneous)
    scene, count = BulkScene(hand, body), 100
    q = hand.lower + rng.uniform(size=(count, hand.n)) * (hand.upper - hand.lower)
    roots = np.array([draw_placement(rng, 0.1).homogeneous for _ in range(count)])
    placed = scene.placed_parts(q, roots)
    parts = rng.integers(len(scene.parts), size=count)
    for i, part in enumerate(parts):  # the object at one of its parts
        middle = placed[i, part, :3, :3] @ scene.parts[part].geometry.aabb_center + placed[i, part, :3, 3]
        aside = 0.03 + 0.5 * scene.parts[part].radius
        roots[i, :3, 3] += body.com_o - middle + aside * np.array([0.0, 0.0, 1.0])
    gravity = rng.normal(size=3)
    found = scene.contacts(q, roots, tolerance=0.02, gravity_o=gravity)
    placed = scene.placed_parts(q, roots)
    assert len(found.grasp) > 20, SEED
    for i in range(count):
        moved = hand.placed(roots[i])
        model, data = moved.model, moved.model.createData()
        pin.computeJointJacobians(model, data, q[i])
        for p, part in enumerate(parts_of(moved)):
            assert np.allclose(placed[i, p], (data.oMi[part.joint] * part.placement).homogeneous, atol=1e-12), SEED
        for t in np.flatnonzero(found.grasp == i):
            joint = scene.parts[found.part[t]].joint
            J = np.zeros((6, hand.n))
            if joint:
                J = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
                J[:3] += np.cross(J[3:], (found.points_o[t] - data.oMi[joint].translation)[:, None], axis=0)
            assert np.allclose(found.jacobians_o[t], J, atol=1e-12), SEED
        model.gravity.linear = gravity
        expected = pin.computeGeneralizedGravity(model, data, q[i])
        assert np.allclose(found.gravity_torques[i], expected, atol=1e-12), SEED


@pytest.mark.parametrize("name", ["allegro_right", "humanoid", "psyonic_left"])
def test_links_that_hit_each_other_are_those_of_coal(name):
    rng, hand = np.random.default_rng(SEED), load_hand(name)
    q = hand.lower + rng.uniform(size=(60, hand.n)) * (hand.upper - hand.lower)
    scene = BulkScene(hand, Sphere(radius=0.01, mass=0.1))
    collisions = scene.collisions
    found = scene.contacts(q, np.tile(hand.pose, (60, 1, 1)), tolerance=1e-3).collision
    assert (found >= 0).any() and (found < 0).any(), SEED
    for posture, pair in zip(q, found):
        names = SelfCollisions(hand).at(posture)
        assert bool(names) == (pair >= 0), SEED
        if pair >= 0:
            b, a = collisions.pairs[pair]
            assert (collisions.links[a], collisions.links[b]) in names, SEED


def test_a_posture_has_the_same_touches_alone_and_in_any_number_of_threads():
    rng, hand = np.random.default_rng(SEED), load_hand("allegro_right")
    body = Cylinder(radius=0.03, height=0.1, mass=0.1, pose=pin.SE3(np.eye(3), np.array([0.06, 0, 0.06])).homogeneous)
    q = hand.lower + rng.uniform(size=(200, hand.n)) * (hand.upper - hand.lower)
    roots = np.array([draw_placement(rng, 0.005).homogeneous for _ in range(200)])
    scene = BulkScene(hand, body)
    one = scene.contacts(q, roots, tolerance=5e-3)
    assert len(one.grasp) > 50, SEED
    for threads in (2, 5):
        other = scene.contacts(q, roots, tolerance=5e-3, threads=threads)
        for field in dataclasses.fields(BulkContacts):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), (SEED, field.name)
    for i in (0, 77, 199):
        alone = scene.contacts(q[i : i + 1], roots[i : i + 1], tolerance=5e-3)
        assert np.array_equal(alone.jacobians_o, one.jacobians_o[one.grasp == i]), SEED
        assert alone.depth[0] == one.depth[i] and alone.collision[0] == one.collision[i], SEED


def test_no_postures_have_no_touches():
    hand = load_hand("panda")
    found = BulkScene(hand, Box(size=(0.03, 0.03, 0.03), mass=0.1)).contacts(
        np.zeros((0, 1)), np.zeros((0, 4, 4)), tolerance=1e-3
    )
    assert found.grasp.shape == (0,) and found.jacobians_o.shape == (0, 6, 1) and found.gravity_torques.shape == (0, 1)


def test_a_scene_refuses_what_is_not_there_and_what_is_no_number():
    eye, none = np.eye(4), np.zeros((0, 3, 3))
    ball = np.zeros((1, 3)), np.ones(3)
    scene = core.load().Scene(1, eye, eye)
    for wrong, call in (
        ("input", lambda: scene.add_joint(-1, 1, eye, np.zeros(6), 1.0, np.zeros(3))),
        ("mass", lambda: scene.add_joint(-1, 0, eye, np.zeros(6), np.nan, np.zeros(3))),
        ("joint", lambda: scene.add_part(3, eye, 0, *ball, none)),
        ("link", lambda: scene.add_part(-1, eye, 1, *ball, none)),
        ("points", lambda: scene.add_part(-1, eye, 0, np.zeros((0, 3)), np.ones(3), none)),
        ("radii", lambda: scene.add_part(-1, eye, 0, np.zeros((1, 3)), -np.ones(3), none)),
        ("triangles", lambda: scene.put(np.zeros((2, 3)))),
        ("points", lambda: scene.add_solid(np.full((1, 3), np.inf), np.ones(3))),
        ("part", lambda: scene.add_pair(0, 0)),
        ("solids", lambda: scene.touch(np.zeros((1, 1)), eye[None], tolerance=1.0, lean=0.0, gravity=np.zeros(3))),
    ):
        with pytest.raises(ValueError, match=wrong):
            call()
    scene.add_solid(*ball)
    for q in (np.zeros((2, 1)), np.full((1, 1), np.nan)):
        with pytest.raises(ValueError, match="q"):
            scene.touch(q, eye[None], tolerance=1.0, lean=0.0, gravity=np.zeros(3))
