"""Plans, certificates, simulations, scenes and runs do not depend on where the file of an object has its origin."""

import re

import mujoco
import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.certification import placement_hint
from pinograsp.errors import Status
from pinograsp.spatial import pose_of, rotation_rpy

SIZE, MASS = [0.05, 0.03, 0.09], 0.15
HAND = pg.load_hand("panda").placed(pose_of([0.3, 0.2, 0.1034 + 0.02], rotation_rpy(np.pi, 0, 0)))
MIDDLE = pose_of([0.3, 0.2, 0.0])
CONDITIONS = pg.GraspConditions(mu=0.6)
# Of the block's middle in its file: on its corner, and turned, with the origin a metre off.
FILES = {
    "at a corner": pose_of([0.025, 0.015, 0.045]),
    "turned and off": pose_of([0.5, -0.8, 0.3], rotation_rpy(0.4, -1.2, 2.0)),
}


def block(middle_b):
    """The block as a mesh in a file whose frame is elsewhere, put where its middle is at ``MIDDLE``."""
    made = trimesh.creation.box(SIZE, transform=middle_b)
    pose = MIDDLE @ np.linalg.inv(middle_b)
    return pg.Mesh(vertices=made.vertices, faces=made.faces, convex=True, mass=MASS, pose=pose)


def planned(body, conditions=CONDITIONS):
    closure = pg.close_hand(HAND, body)
    return pg.plan_grasp_on(closure.hand, closure, conditions)


@pytest.fixture(scope="module")
def primitive():
    """The plan on the block as a primitive: the outside oracle, whose frame is in its middle."""
    return planned(pg.Box(size=SIZE, mass=MASS, pose=MIDDLE))


@pytest.fixture(scope="module", params=FILES)
def plan(request):
    return planned(block(FILES[request.param]))


@pytest.fixture(scope="module")
def simulations(plan, primitive):
    return [pg.simulate(one, hold=0.02, support="fixed", time_step=1e-3) for one in (plan, primitive)]


@pytest.mark.slow
def test_forces_are_those_of_the_same_block_centred(plan, primitive):
    """Translations change nothing; where the axes are turned the reserve looks in other directions, 2 % at most."""
    turned = not np.allclose(plan.body.pose[:3, :3], np.eye(3))
    rel = 0.02 if turned else 1e-6
    assert plan.status == primitive.status == "ok"
    total, expected = (one.forces.normal_forces.sum() for one in (plan, primitive))
    assert total == pytest.approx(expected, rel=rel)
    assert np.allclose(plan.contacts.com_o, MIDDLE[:3, 3], atol=1e-9)
    bare = pg.GraspConditions(mu=0.6, reserve=None)
    totals = [np.sort(planned(body, bare).forces.normal_forces) for body in (plan.body, primitive.body) if turned]
    assert not turned or np.allclose(*totals, rtol=1e-5)


def test_the_hand_is_where_the_file_has_it(plan, primitive):
    middle_b = np.linalg.inv(plan.body.pose) @ MIDDLE
    assert np.allclose(plan.hand_in_object, middle_b @ primitive.hand_in_object, atol=1e-9)
    closure = plan.closure
    assert np.allclose(plan.hand_in_object, np.linalg.inv(closure.object.pose) @ closure.hand.pose, atol=1e-12)
    assert np.allclose(closure.summary()["object_pose"], plan.body.pose)


def test_a_plan_is_certified_where_it_says_that_the_hand_is(plan):
    """The root in the object's frame, and the object as its file has it; gravity is in that frame, too."""
    down = plan.body.pose[:3, :3].T @ [0, 0, -9.81]
    here = plan.body.placed(np.eye(4))
    conditions = pg.GraspConditions(mu=0.6, gravity_o=down)
    found = pg.certify(pg.load_hand("panda"), here, [plan.closure.q], conditions, roots=[plan.hand_in_object])
    assert found.held.all() and found.hint == ""
    # At the centre of mass instead, as another convention has it, it is somewhere else.
    other = plan.hand_in_object.copy()
    other[:3, 3] -= plan.body.com_b
    assert not pg.certify(pg.load_hand("panda"), here, [plan.closure.q], conditions, roots=[other]).held.any()


@pytest.mark.slow
def test_simulations_tell_the_frame_of_the_file(plan, simulations):
    ours, centred = simulations
    assert ours.verdict.held and centred.verdict.held
    assert np.allclose(ours.object_poses[0], plan.body.pose, atol=1e-9)
    assert np.allclose(ours.com_o[0], MIDDLE[:3, 3], atol=1e-9)
    assert np.allclose(ours.com_o, centred.com_o, atol=2e-5)  # its forces differ by 1 %
    assert np.allclose(ours.drift, np.linalg.norm(ours.com_o - ours.com_o[ours.complete], axis=1) * (ours.drift > 0))
    assert np.allclose(centred.com_b, 0)


def test_scenes_have_the_body_in_the_frame_of_the_file(plan, tmp_path):
    plan.to_mujoco(tmp_path / "scene.xml", scene=True)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    body = model.body("object").id
    pose = pose_of(data.xpos[body], data.xmat[body].reshape(3, 3))
    assert np.allclose(pose, plan.body.pose, atol=1e-6)
    assert np.allclose(data.xipos[body], MIDDLE[:3, 3], atol=1e-6) and model.body_mass[body] == pytest.approx(MASS)
    moments = np.sort(np.linalg.eigvalsh(plan.body.inertia_b))
    assert np.sort(model.body_inertia[body]) == pytest.approx(moments, rel=1e-4)
    (geom,) = np.flatnonzero(model.geom_bodyid == body)
    assert np.allclose(data.geom_xpos[geom], MIDDLE[:3, 3], atol=1e-6)
    assert np.allclose(data.site_xpos[model.site("object").id], data.site_xpos[model.site("place").id], atol=1e-6)


def test_viewers_draw_the_object_where_it_is(plan):
    from pinograsp.viz.scene import make_scene
    from pinograsp.viz.solids import place_solid

    scene = make_scene(plan)
    (solid,) = [one for one in scene.solids if one.link is None]
    assert np.allclose(scene.object_pose[:3], plan.body.pose[:3, 3])
    assert np.abs(plan.body.project(place_solid(solid, scene.object_pose))[2]).max() < 1e-6


# -- grasps that are misplaced ---------------------------------------------------------------------------------------


def grasps(plan, count=8):
    """Copies of a plan's grasp in the object's frame, its place off by a tenth of a millimetre."""
    rng, roots = np.random.default_rng(0), np.tile(plan.hand_in_object, (count, 1, 1))
    roots[:, :3, 3] += 1e-4 * rng.normal(size=(count, 3))
    return np.tile(plan.closure.q, (count, 1)), roots


@pytest.mark.parametrize(
    "mistake, figure",
    [
        (lambda q, roots: (q, roots @ pose_of([0, 0, 0.03])), "are in the object, [0-9.]+ mm deep in the median"),
        (
            lambda q, roots: (q, roots @ pose_of([0, 0, -0.09])),
            "do not touch the object.*, [0-9.]+ mm away in the median",
        ),
        (lambda q, roots: (q, roots @ pose_of([0, 0, -9.0])), "100 mm or more away"),
        (lambda q, roots: (1e3 * q, roots), "beyond their limits"),
    ],
)
def test_misplaced_grasps_come_with_a_hint(primitive, mistake, figure):
    q, roots = mistake(*grasps(primitive))
    found = pg.certify(pg.load_hand("panda"), primitive.body.placed(np.eye(4)), q, CONDITIONS, roots=roots)
    assert not found.held.any()
    assert re.search(figure, found.hint) and found.hint in found.describe()


def test_how_far_off_the_nearest_link_is_is_told(primitive):
    """The jaws' pads reach 0.1 m beyond the palm: taken straight up from above the block, they are that far off."""
    q, roots = grasps(primitive, 1)
    up = np.tile(roots, (2, 1, 1))
    up[:, 2, 3] += [0.06, 0.08]
    found = pg.certify(
        pg.load_hand("panda"), primitive.body.placed(np.eye(4)), np.tile(q, (2, 1)), CONDITIONS, roots=up
    )
    assert (found.reason == Status.NO_CONTACT.code).all()
    assert found.depth[0] - found.depth[1] == pytest.approx(0.02, abs=1e-4) and found.depth[0] < 0
    assert "mm away" in found.words(0)


def test_grasps_that_are_where_they_should_be_have_no_hint(primitive):
    q, roots = grasps(primitive)
    found = pg.certify(pg.load_hand("panda"), primitive.body.placed(np.eye(4)), q, CONDITIONS, roots=roots)
    assert found.held.all() and found.hint == "" and str(len(q)) in str(found)


@pytest.mark.parametrize("count, misplaced, is_hint", [(4, 4, False), (5, 5, True), (20, 18, True), (20, 17, False)])
def test_few_misplaced_grasps_are_chance(count, misplaced, is_hint):
    reasons = [Status.PENETRATES.code] * misplaced + [Status.RESERVE.code] * (count - misplaced)
    assert bool(placement_hint(reasons, [0.012] * misplaced + [0.0] * (count - misplaced))) == is_hint
