"""What pages and pictures show of carrying: the object where the palm takes it, forces that turn with it, an arm that moves."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from panda_path import JOINTS, WAY, WAYPOINTS
from scipy.spatial.transform import Rotation

import pinograsp as pg
from pinograsp.carry import ArmPath, plan_carry
from pinograsp.carry.scene import carry_scene
from pinograsp.errors import InvalidInput
from pinograsp.spatial import pose_of
from pinograsp.viz.solids import to_sevens


@pytest.fixture(scope="module")
def scene(smoothed):
    return carry_scene(smoothed)


def matrix(pose):
    """A position and quaternion (7,) as a placement (4, 4)."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(np.roll(pose[3:], -1)).as_matrix()
    found[:3, 3] = pose[:3]
    return found


def same_turn(a, b):
    return abs(np.dot(a[3:], b[3:])) == pytest.approx(1.0, abs=1e-12)


def test_the_object_goes_where_the_palm_goes(scene, arm, grasp):
    """Against the robot's own kinematics."""
    planned, last = grasp.body.pose, len(scene.times) - 1
    palm = arm.frame_placements(np.array(grasp.motion.q[-1]), [arm.palm])[0]
    for i in (0, last // 3, last // 2, last):
        now = arm.frame_placements(scene.q[i], [arm.palm])[0] @ np.linalg.inv(palm) @ planned
        np.testing.assert_allclose(scene.object_at(i)[:3], now[:3, 3], atol=1e-12)
        assert same_turn(scene.object_at(i), to_sevens(now))
    moved = [scene.object_at(i)[:3] for i in (0, last)]
    assert np.linalg.norm(moved[1] - moved[0]) > 0.2


def test_the_arm_moves_and_the_fingers_stay(scene, arm):
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    np.testing.assert_allclose(scene.q[[0, -1]][:, moving], WAY[[0, -1]], atol=1e-12)
    rest = np.setdiff1d(np.arange(arm.n), moving)
    assert np.ptp(scene.q[:, rest], axis=0).max() == 0.0
    assert np.ptp(scene.link_poses[:, :, :3], axis=0).max() > 0.2
    # Whatever the hand is made of stays where it is beside the object.
    fingers = {one.link for one in scene.solids if one.link is not None and "finger" in one.name}
    for link in fingers:
        first, last = (
            np.linalg.inv(matrix(scene.object_at(i))) @ matrix(scene.link_poses[i, link]) for i in (0, len(scene.q) - 1)
        )
        np.testing.assert_allclose(first, last, atol=1e-9)
    assert len(fingers) == 2


def test_arrows_move_the_object_as_newton_says(scene, grasp):
    """In the world, where the arrows are drawn: the forces' sum is mass times acceleration and weight."""
    scale, h = 0.5, scene.times[1]
    com = np.array([scene.carry_points(scene.com_o[None], i)[0] for i in range(len(scene.times))])
    acceleration = (com[2:] + com[:-2] - 2 * com[1:-1]) / h**2
    arrows = np.array([scene.carry_points(scene.arrows(i, scale), i) for i in range(1, len(com) - 1)])
    force = np.diff(arrows, axis=2)[:, :, 0].sum(axis=1) / scale
    expected = grasp.body.mass * (acceleration + [0, 0, 9.81])
    error = np.linalg.norm(force - expected, axis=1)
    assert np.median(error) < 0.01 and error.max() < 0.3  # N; the least where acceleration bends
    weight = np.linalg.norm(force - grasp.body.mass * np.array([0, 0, 9.81]), axis=1)
    assert weight.max() > 1.0  # the arm is fast: its acceleration is seen
    load = np.diff(scene.carry_points(scene.load_arrow(5, scale), 5), axis=0)[0] / scale
    np.testing.assert_allclose(load, -force[4], atol=1e-5)


def test_contacts_stay_on_the_object(scene, grasp):
    for i in (0, 40, len(scene.times) - 1):
        own = np.linalg.inv(matrix(scene.object_at(i)))
        points = scene.carry_points(scene.points_o, i) @ own[:3, :3].T + own[:3, 3]
        before = np.linalg.inv(grasp.body.pose)
        np.testing.assert_allclose(points, grasp.contacts.points_o @ before[:3, :3].T + before[:3, 3], atol=1e-12)


def test_numbers_are_the_plans(scene, smoothed):
    assert scene.times[-1] == pytest.approx(smoothed.duration)
    assert scene.rate * smoothed.duration == pytest.approx(len(scene.times) - 1)
    for i in (10, 30):
        at = scene.frame_at(smoothed.instants[i])
        near = np.abs(smoothed.instants - scene.times[at]).argsort()[:2]
        low, high = np.sort(smoothed.normal_forces[near], axis=0)
        assert (scene.normal[at] >= low - 1e-9).all() and (scene.normal[at] <= high + 1e-9).all()
        assert smoothed.binding[i] in scene.told[at]
    named = [(phase.name, scene.times[phase.last]) for phase in scene.phases]
    stretches = [(what, smoothed.times[last + 1]) for what, _, last in smoothed.stretches()]
    assert [what for what, _ in named] == [what for what, _ in stretches]
    np.testing.assert_allclose([end for _, end in named], [end for _, end in stretches], atol=2 * scene.times[1])
    facts = dict(scene.facts)
    assert facts["duration"] == f"{smoothed.duration:.4g} s" and scene.answer.level == "yes"
    assert any(smoothed.shares()[0][0] == value for what, value in scene.facts if what.startswith("binds"))


@pytest.mark.slow
def test_a_grasp_planned_elsewhere_is_in_the_same_hand(arm, grasp, scene):
    """The world that the grasp was planned in does not matter, only where the object is in its hand."""
    turn = Rotation.from_euler("xyz", [0.4, 0.2, -1.0]).as_matrix()
    shift = pose_of(np.array([0.3, -0.2, 0.5]), turn)
    box = pg.Box(size=[0.04, 0.04, 0.06], mass=0.2, pose=shift @ grasp.body.pose)
    away = pg.plan_grasp_on(arm.placed(shift @ arm.pose), box, pg.GraspConditions(mu=0.6))
    other = carry_scene(plan_carry(arm, away, WAYPOINTS, intervals=20))
    for i, k in ((0, 0), (-1, -1)):
        np.testing.assert_allclose(other.object_at(i)[:3], scene.object_at(k)[:3], atol=1e-9)
        assert same_turn(other.object_at(i), scene.object_at(k))
    assert np.linalg.norm(other.object_pose[:3] - scene.object_pose[:3]) > 0.3


@pytest.mark.slow
def test_plans_write_what_they_show(smoothed, tmp_path):
    page = smoothed.save_html(tmp_path / "deep" / "way.html")
    text = page.read_text(encoding="utf-8")
    assert "On the path" in text and "__DATA__" not in text and page.stat().st_size < 5e6
    image = imread(smoothed.picture(tmp_path / "way.png"))[..., :3]
    assert image.std() > 0.02 and image.shape[:2] == (640, 900)
    other = imread(smoothed.picture(tmp_path / "start.png", time=0.0, view=[1, 0.3, 0.2]))[..., :3]
    assert (np.abs(image - other).max(axis=2) > 0.03).mean() > 0.02
    paths = smoothed.save_figures(tmp_path)
    assert [path.name for path in paths] == [
        f"carry_{what}.png" for what in ("speed", "forces", "friction", "torques", "motion")
    ]


def test_given_timings_are_shown_too(arm, grasp, smoothed):
    times = 2.0 * smoothed.instants
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    way = ArmPath(joints=JOINTS, s=(times - times[0]) / np.ptp(times), q=smoothed.q[:, moving], times=times - times[0])
    slow = plan_carry(arm, grasp, way, timing="given", intervals=20)
    scene = carry_scene(slow)
    assert "times as fast would also hold" in scene.answer.text and slow.lower_bound is None
    assert dict(scene.facts)["may be faster by"] == f"{slow.factor:.3g} times"
    with pytest.raises(InvalidInput, match="object"):
        carry_scene(replace(slow, grasp=replace(grasp, body=None)))
