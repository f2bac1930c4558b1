"""Picking: what a plan asks of arm and hand, recomputed by other means, and why there is none."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput, PickFailed
from pinograsp.handover import read_ros2
from pinograsp.hands.catalogue import file_of
from pinograsp.pick import PickMotion, PlaceRegion, load_pick, save_pick, simulate_pick
from pinograsp.pick.arm import Arm
from pinograsp.pick.scene import pick_scene
from pinograsp.pick.upright import Upright
from pinograsp.pick.ways import Patience, find_way
from pinograsp.simulation import Disturbance
from pinograsp.spatial import inverse_of, pose_of
from pinograsp.viz.solids import to_sevens

HOME = {"panda_joint2": -0.5, "panda_joint4": -2.0, "panda_joint6": 1.6, "panda_joint7": 0.8}
CONDITIONS = pg.GraspConditions(mu=0.6)
LYING = pose_of((0.5, -0.25, 0.03), pg.spatial.rotation_rpy(np.pi / 2, 0.0, 0.0))


def panda():
    return pg.attach(file_of("panda"), "panda", link="panda_link8", remove=["panda_hand"], posture=HOME)


def a_can():
    return pg.Cylinder(radius=0.03, height=0.12, mass=0.3).placed(pose_of((0.5, 0.25, 0.06)))


@pytest.fixture(scope="module")
def scene():
    return pg.Scene.on_table(clearance=0.008).with_box("wall", (0.02, 0.3, 0.25), at=(0.45, 0.0, 0.125))


@pytest.fixture(scope="module")
def plan(scene):
    return pg.plan_pick(panda(), a_can(), scene, CONDITIONS, place=(0.5, -0.25, 0.06), seed=5, progress=False)


def parts_at(robot, q):
    """The robot's shapes and where they are."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    for one in robot.geometry.geometryObjects:
        pose = data.oMi[one.parentJoint] * one.placement
        yield robot.model.frames[one.parentFrame].name, one, coal.Transform3s(pose.rotation, pose.translation)


def distance(one, at, other, there):
    result = coal.DistanceResult()
    return coal.distance(one, at, other, there, coal.DistanceRequest(), result)


def test_phases_follow_each_other_and_end_where_they_are_to(plan):
    assert [phase.name for phase in plan.phases] == ["reach", "close", "carry", "open", "leave"]
    robot = plan.robot
    for phase in plan.phases:
        np.testing.assert_allclose(phase.dq[[0, -1]], 0.0, atol=1e-6)
    for before, after in zip(plan.phases, plan.phases[1:]):
        np.testing.assert_allclose(before.q[-1], after.q[0], atol=1e-6)
    np.testing.assert_allclose(plan.phases[0].q[0][robot.arm], np.array(robot.resting)[robot.arm], atol=1e-9)
    # The palm goes with the object: what moved it from where it stood takes it to its place.
    carry = plan.phases[2]
    first, last = robot.frame_placements(carry.q[[0, -1]], [robot.palm])[:, 0]
    np.testing.assert_allclose(last @ inverse_of(first) @ plan.grasp.body.pose, plan.place, atol=1e-4)
    assert plan.status is pg.Status.OK and "carry" in plan.describe()


def test_speeds_accelerations_and_torques_are_within_limits(plan):
    """At 1 kHz, torques anew by RNEA, with the object's weight and inertia at the palm while it is carried."""
    robot, way = plan.robot, plan.trajectory(rate=1000.0)
    arm, model = robot.arm, robot.model
    assert np.all(np.abs(way.dq[:, arm]) <= robot.velocity[arm])
    ddq = np.gradient(way.dq, way.times, axis=0)
    assert np.all(np.abs(ddq[:, arm]) <= 10.0)
    begin = sum(phase.duration for phase in plan.phases[:2])
    carried = (way.times > begin) & (way.times < begin + plan.phases[2].duration)
    loaded, data = model.copy(), None
    body, palm = plan.grasp.body, model.frames[robot.frame_id(robot.palm)]
    at_grasp = robot.frame_placements(plan.phases[2].q[0], [robot.palm])[0]
    held = palm.placement * pin.SE3(inverse_of(at_grasp) @ body.shape_pose)
    loaded.inertias[palm.parentJoint] += held.act(pin.Inertia(body.mass, np.zeros(3), body.inertia_s))
    data = loaded.createData()
    for i in np.flatnonzero(carried)[::20]:
        tau = pin.rnea(loaded, data, way.q[i], way.dq[i], ddq[i])
        assert np.all(np.abs(tau[arm]) <= robot.effort[arm])
        np.testing.assert_allclose(way.effort[i][arm], tau[arm], atol=0.5 + 0.02 * np.abs(tau[arm]).max())


def test_distances_are_kept_all_along(plan, scene):
    """Of all links and the held object to the wall; of links of the arm to the table, too; and of the arm to the object
    until it is taken.
    """
    robot, way = plan.robot, plan.trajectory(rate=50.0)
    bounds = np.cumsum([phase.duration for phase in plan.phases])
    obstacles = {
        name: (body.collision_geometry, coal.Transform3s(body.shape_pose[:3, :3], body.shape_pose[:3, 3]))
        for name, body in scene.obstacles.items()
    }
    body, at_grasp = plan.grasp.body, robot.frame_placements(plan.phases[2].q[0], [robot.palm])[0]
    palm = model_joint = robot.model.frames[robot.frame_id(robot.palm)].parentJoint
    spare = {"wall": np.inf, "table": np.inf, "object": np.inf}
    for time, q in zip(way.times, way.q):
        here = robot.frame_placements(q, [robot.palm])[0]
        pose = body.shape_pose if time < bounds[1] else here @ inverse_of(at_grasp) @ body.shape_pose
        there = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        for _, one, at in parts_at(robot, q):
            if not one.parentJoint:
                continue
            spare["wall"] = min(spare["wall"], distance(one.geometry, at, *obstacles["wall"]))
            if one.parentJoint < palm:
                spare["table"] = min(spare["table"], distance(one.geometry, at, *obstacles["table"]))
            if one.parentJoint < model_joint and time < bounds[0]:
                spare["object"] = min(spare["object"], distance(one.geometry, at, body.collision_geometry, there))
        if bounds[1] < time < bounds[2]:
            spare["wall"] = min(spare["wall"], distance(body.collision_geometry, there, *obstacles["wall"]))
    assert all(value >= 0.999 * scene.clearance for value in spare.values()), spare


def tilts_of(plan):
    """Of the object's axis while it is carried [rad]."""
    palms = plan.robot.frame_placements(plan.phases[2].q, [plan.robot.palm])[:, 0]
    axis = palms[0, :3, :3].T @ [0.0, 0.0, 1.0]
    return np.arccos(np.clip((palms[:, :3, :3] @ axis)[:, 2], -1.0, 1.0))


@pytest.mark.slow
def test_what_is_full_stays_upright_and_slow_and_goes_to_a_region(scene):
    region = PlaceRegion(x=(0.4, 0.6), y=(-0.35, -0.2))
    motion = PickMotion(upright=np.radians(5.0), object_speed=0.25)
    found = pg.plan_pick(panda(), a_can(), scene, CONDITIONS, place=region, motion=motion, seed=5, progress=False)
    assert tilts_of(found).max() <= np.radians(5.0)
    carry, body = found.phases[2], found.grasp.body
    palms = found.robot.frame_placements(carry.q, [found.robot.palm])[:, 0]
    centres = (palms @ inverse_of(palms[0]) @ body.pose)[:, :3, 3]
    speed = np.linalg.norm(np.gradient(centres, carry.times, axis=0), axis=1)
    assert 0.2 < speed.max() < 0.2502
    assert np.all(found.place[:2, 3] >= (0.4, -0.35)) and np.all(found.place[:2, 3] <= (0.6, -0.2))
    assert found.place[2, 3] == pytest.approx(0.06) and found.status is pg.Status.OK


def test_tilts_and_their_slopes():
    robot, rng = panda(), np.random.default_rng()
    arm = Arm(robot, np.array(robot.resting), pg.Scene(), a_can(), "held", set())
    x = rng.uniform(arm.lower, arm.upper)
    upright = Upright(arm, x, np.array([0.0, 0.0, 1.0]), 0.2)
    assert upright.measure(x) == pytest.approx(0.0, abs=1e-9) and upright.lean(x) == pytest.approx(np.zeros(2))
    y = x + 0.1 * rng.normal(size=7)
    assert np.linalg.norm(upright.lean(y)) == pytest.approx(np.sin(upright.measure(y)), abs=1e-9)
    steps = 1e-4 * np.eye(7)
    slopes = np.array([(upright.lean(y + step) - upright.lean(y - step)) / 2e-4 for step in steps]).T
    np.testing.assert_allclose(upright.lean_slopes(y), slopes, atol=1e-6)
    straight = upright.straighten(x + 0.02 * rng.normal(size=7))
    assert straight is None or upright.measure(straight) < 2e-4
    projected = y.copy()
    assert not upright.project(projected, 1e-6) or upright.measure(projected) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_ways_around_keep_upright():
    robot = panda()
    scene = pg.Scene.on_table(at=(0.5, 0.0), size=(0.8, 1.4)).with_box("wall", (0.2, 0.02, 0.6), at=(0.5, 0.0, 0.3))
    arm = Arm(robot, np.array(robot.resting), scene, a_can(), "free", set())
    turned = np.array(arm.resting[arm.dofs])
    start, goal = turned.copy(), turned.copy()
    start[0], goal[0] = 0.7, -0.7
    upright = Upright(arm, start, np.array([0.0, 0.0, 1.0]), np.radians(10.0))
    way = find_way(arm, start, goal, seed=3, patience=Patience(), upright=upright)
    assert way is not None
    np.testing.assert_allclose(way[[0, -1]], [start, goal], atol=1e-9)
    assert max(upright.measure(x) for x in way) <= np.radians(10.0)
    assert sum(arm.is_free(x) for x in way) >= len(way) - 1


def test_picks_come_back_from_their_folder(plan, tmp_path):
    folder = save_pick(plan, tmp_path / "pick", rate=100.0)
    report = (folder / "report.md").read_text(encoding="utf-8")
    assert all(phase.name in report for phase in plan.phases) and "Phase by phase" in report
    back = load_pick(folder)
    assert back.describe() == plan.describe() and back.summary() == plan.summary()
    for attribute in ("q", "dq", "effort"):
        np.testing.assert_array_equal(getattr(back.trajectory(), attribute), getattr(plan.trajectory(), attribute))
    assert set(back.scene.obstacles) == set(plan.scene.obstacles)
    (folder / "record.json").write_text("{}")
    with pytest.raises(InvalidInput, match="holds no readable pick"):
        load_pick(folder)


@pytest.mark.slow
def test_it_comes_about_in_the_simulation(plan):
    seen = simulate_pick(plan)
    assert seen.done and seen.nearest.spare > 0 and "done" in str(seen)
    assert seen.off < 0.01 and seen.off_angle < 10.0
    # Its top is where the way has it.
    assert seen.object_poses[:, 2, 3].max() > plan.body.pose[2, 3] + 0.08


@pytest.mark.slow
def test_what_slips_is_told(plan):
    slippery = simulate_pick(plan, disturbance=Disturbance(mu=0.05))
    assert not slippery.done and slippery.failed == "carry"
    with pytest.raises(InvalidInput, match="shake"):
        simulate_pick(plan, disturbance=Disturbance(shake=(1.0, 0.0, 0.0)))


@pytest.mark.slow
def test_the_same_seed_is_the_same_plan(plan, scene):
    again = pg.plan_pick(panda(), a_can(), scene, CONDITIONS, place=(0.5, -0.25, 0.06), seed=5, jobs=1, progress=False)
    np.testing.assert_allclose(again.phases[0].q, plan.phases[0].q, atol=1e-9)
    assert again.duration == pytest.approx(plan.duration, rel=1e-6)


def test_the_trajectory_goes_to_controllers(plan, tmp_path):
    way = plan.trajectory(rate=250.0)
    way.to_csv(tmp_path / "pick.csv")
    of_arm = [plan.robot.joint_names[i] for i in plan.robot.arm]
    plan.trajectory(rate=250.0, joints=of_arm).to_ros2(tmp_path / "arm.json")
    back = read_ros2(tmp_path / "arm.json")
    assert list(back.names) == of_arm and back.times[-1] == pytest.approx(way.times[-1])
    np.testing.assert_allclose(back.q, way.q[:, plan.robot.arm], atol=1e-9)
    hand = plan.trajectory(joints=[plan.robot.joint_names[7]])
    assert len(hand.names) == 1 and len(hand.with_followers().names) == 2
    with pytest.raises(InvalidInput, match="joints"):
        plan.trajectory(joints=["wrist"])
    with pytest.raises(InvalidInput, match="rate"):
        plan.trajectory(rate=0.0)


def test_pages_and_pictures_show_all_phases_and_what_is_around(plan, tmp_path):
    scene = pick_scene(plan)
    assert [phase.name for phase in scene.phases] == [phase.name for phase in plan.phases]
    assert {"wall", "table"} <= {solid.name for solid in scene.solids}
    pose = plan.grasp.body.pose
    np.testing.assert_allclose(scene.carried[0], to_sevens(np.eye(4)), atol=1e-6)
    there = plan.place @ inverse_of(pose)
    np.testing.assert_allclose(scene.carried[-1][:3], there[:3, 3], atol=1e-3)
    # Nothing presses before the hand closes and after it has opened; what presses bears the weight on the way.
    assert not scene.forces_o[0].any() and not scene.forces_o[-1].any()
    middle = int(np.argmax(scene.normal.sum(axis=1)))
    assert scene.normal[middle].sum() == pytest.approx(plan.carry.normal_forces.max(axis=0).sum(), rel=0.05)
    assert b"wall" in plan.save_html(tmp_path / "pick.html").read_bytes()
    assert plan.picture(tmp_path / "pick.png").stat().st_size > 10_000


@pytest.mark.slow
def test_it_is_put_on_what_is_higher(scene):
    higher = scene.with_box("crate", (0.15, 0.15, 0.1), at=(0.5, -0.25, 0.05))
    plan = pg.plan_pick(panda(), a_can(), higher, CONDITIONS, place=(0.5, -0.25, 0.16), seed=5, progress=False)
    seen = simulate_pick(plan)
    assert seen.done and seen.object_poses[-1, 2, 3] == pytest.approx(0.16, abs=0.003)


@pytest.mark.slow
def test_lifting_alone(scene):
    plan = pg.plan_pick(panda(), a_can(), scene, CONDITIONS, seed=5, progress=False)
    assert [phase.name for phase in plan.phases] == ["reach", "close", "carry"]
    seen = simulate_pick(plan, disturbance=Disturbance(mass_factor=1.1))
    assert seen.done and seen.off is None
    assert seen.object_poses[-1, 2, 3] == pytest.approx(plan.body.pose[2, 3] + 0.1, abs=0.005)


@pytest.mark.slow
def test_what_is_out_of_reach_is_told(scene):
    far = a_can().placed(pose_of((1.4, 0.0, 0.06)))
    with pytest.raises(PickFailed, match=r"none of \d+ grasps is possible: .*out of reach") as told:
        pg.plan_pick(panda(), far, scene, CONDITIONS, seed=1, progress=False)
    assert told.value.reasons["out of reach"] > 5


@pytest.mark.slow
def test_what_is_in_the_way_is_told():
    """A can under a low shelf: no hand comes to it."""
    scene = pg.Scene.on_table().with_box("shelf", (0.6, 0.6, 0.02), at=(0.5, 0.25, 0.16))
    scene = scene.with_box("front", (0.02, 0.6, 0.15), at=(0.42, 0.25, 0.075))
    with pytest.raises(PickFailed, match="hit (shelf|front)"):
        pg.plan_pick(panda(), a_can(), scene, CONDITIONS, seed=1, progress=False)


def test_unusable_tasks_are_refused(scene):
    for wrong in ({"lift": -0.1}, {"upright": 0.0}, {"reserve": 1.0}):
        with pytest.raises(InvalidInput, match=next(iter(wrong))):
            PickMotion(**wrong)
    with pytest.raises(InvalidInput, match="least first"):
        PlaceRegion(x=(1.0, 0.0), y=(0.0, 1.0))
    with pytest.raises(InvalidInput, match="got a hand alone"):
        pg.plan_pick(pg.load_hand("panda"), a_can(), scene, CONDITIONS)
    wall = scene.with_box("box", (0.2, 0.2, 0.2), at=(0.4, 0.0, 0.5))
    with pytest.raises(InvalidInput, match=r"start: expected a posture that keeps 8 mm .* box"):
        pg.plan_pick(panda(), a_can(), wall, CONDITIONS)
    for wrong, told in (
        ({"place": (1.0, 2.0)}, "place"),
        ({"start": {"panda_joint9": 0.0}}, "panda_joint9"),
        ({"seed": -1}, "seed"),
        ({"place": (0.45, 0.0, 0.06)}, "place: expected room .* 'wall'"),
        ({"place": PlaceRegion(x=(0.44, 0.46), y=(-0.1, 0.1))}, "place: expected a region with room"),
        ({"place": LYING, "motion": PickMotion(upright=0.2)}, "tilts it by 90 deg"),
    ):
        with pytest.raises(InvalidInput, match=told):
            pg.plan_pick(panda(), a_can(), scene, CONDITIONS, **wrong)
