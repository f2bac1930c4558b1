"""Grasps of objects that stand on a table: nothing of the hand is below it, at any time."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pinograsp import GraspConditions, load_hand, plan_grasp_on
from pinograsp.contacts.support_plane import SupportPlane, deepest_below
from pinograsp.errors import InvalidInput, NoGrasp, Status
from pinograsp.hands.geometry import hull_points
from pinograsp.objects import Box, Capsule, Cylinder, Mesh, Sphere
from pinograsp.synthesis import find_grasps


def lowest(hand, q, up):
    """Height of the lowest point of a hand of boxes, balls and hulls."""
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, q)
    heights = []
    for one in hand.geometry.geometryObjects:
        pose = data.oMi[one.parentJoint] * one.placement
        if isinstance(one.geometry, coal.Sphere):
            heights.append(pose.translation @ up - one.geometry.radius)
        else:
            heights += [pose.act(point) @ up for point in hull_points(one.geometry)]
    return min(heights)


@pytest.mark.parametrize("name", ["allegro_left", "psyonic_right", "panda", "so101"])
def test_depths_below_a_plane_are_those_of_the_lowest_points(name):
    rng, hand = np.random.default_rng(4), load_hand(name)
    for _ in range(5):
        q = rng.uniform(np.maximum(hand.lower, -np.pi), np.minimum(hand.upper, np.pi))
        up = rng.normal(size=3)
        up /= np.linalg.norm(up)
        at = lowest(hand, q, up)
        hit = deepest_below(hand, SupportPlane(up_o=3 * up, height=at + 0.01), [q])
        assert hit.depth == pytest.approx(0.01, abs=1e-6)
        assert deepest_below(hand, SupportPlane(up_o=up, height=at - 1e-5), [q]) is None


@pytest.mark.parametrize(
    ("body", "below"),
    [
        (Sphere(radius=0.03, mass=0.1), 0.03),
        (Cylinder(radius=0.03, height=0.1, mass=0.1), 0.05),
        (Capsule(radius=0.02, length=0.06, mass=0.1), 0.05),
        (Box(size=(0.04, 0.05, 0.12), mass=0.1), 0.06),
    ],
    ids=["sphere", "cylinder", "capsule", "box"],
)
def test_planes_are_under_the_lowest_points(body, below):
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = pin.exp3(np.array([0.4, -0.7, 1.1])), [0.1, -0.2, 0.3]
    plane = SupportPlane.under(body.placed(turn), turn[:3, :3] @ [0, 0, -9.81])
    assert plane.up_o == pytest.approx(turn[:3, 2])
    assert plane.height == pytest.approx(turn[:3, 3] @ turn[:3, 2] - below, abs=1e-6)


def test_planes_are_under_meshes_and_refused_without_gravity():
    shape = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
    shape.apply_scale([1.0, 0.5, 0.8])
    body = Mesh(vertices=shape.vertices, faces=shape.faces, mass=0.1)
    gravity = np.array([1.0, -2.0, -3.0])
    plane = SupportPlane.under(body, gravity)
    up = -gravity / np.linalg.norm(gravity)
    assert plane.height == pytest.approx(((shape.vertices - shape.center_mass) @ up).min(), abs=1e-5)
    with pytest.raises(InvalidInput, match="expected gravity"):
        SupportPlane.under(body, np.zeros(3))


FLAT = Box(size=(0.05, 0.05, 0.04), mass=0.1)


@pytest.fixture(scope="module")
def found():
    """Grasps of a flat box by one hand, with and without a table under it."""
    hand = load_hand("psyonic_left")
    return {
        table: find_grasps(hand, FLAT, GraspConditions(mu=0.6, table=table), count=8, seed=5, jobs=1, progress=False)
        for table in (True, False)
    }


def below(grasp, postures):
    plane = SupportPlane.under(grasp.closure.object, [0, 0, -9.81])
    return deepest_below(grasp.closure.hand, plane, postures)


@pytest.mark.slow
def test_hands_keep_above_the_table(found):
    """At every sample of the planned motion, which the search looked at in five places."""
    conditions = GraspConditions(mu=0.6, table=True)
    assert found[True].grasps and "the open hand overlaps the object" not in found[True].outcomes
    planned = 0
    for grasp in found[True].grasps:
        assert below(grasp, [grasp.closure.start, grasp.closure.q]) is None
        try:
            plan = plan_grasp_on(grasp.closure.hand, grasp.closure, conditions)
        except NoGrasp:
            continue
        if plan.status is Status.OK:
            assert below(grasp, plan.motion.q[::10]) is None
            planned += 1
    assert planned


@pytest.mark.slow
def test_plans_that_go_through_the_table_say_so(found):
    """Without a table hands reach round a flat box: told to keep above one, the plan names link, time and depth."""
    through = [
        grasp
        for grasp in found[False].grasps
        if grasp.withstands and below(grasp, [grasp.closure.start, grasp.closure.q])
    ]
    assert through
    closure = through[0].closure
    plan = plan_grasp_on(closure.hand, closure, GraspConditions(mu=0.6, table=True))
    assert plan.status is Status.EARLY_CONTACT
    assert any("hits the table on the way, at" in note for note in plan.motion.notes)


@pytest.mark.slow
def test_the_command_takes_it(command, tmp_path, no_rendering):
    options = ("--object", "box:size=0.04x0.04x0.06,mass=0.1", "--samples", "8", "--table", "--json")
    code, out, _ = command("plan", "--hand", "panda", *options, "--out", str(tmp_path / "run"))
    assert code == 0 and '"ok"' in out
