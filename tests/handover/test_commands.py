"""What drives are sent: closed forms, servos as springs, round trips, ROS 2's message definitions, MuJoCo's own contacts."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yaml

import pinograsp as pg
from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.handover import drive_commands, gripper_message, jaw_commands, joint_trajectory, read_csv, read_ros2
from pinograsp.hands import Drive, Spring
from pinograsp.planner import load_run, save_run

JOINT = "panda_finger_joint1"
RATE = {"rate": 250.0}


@pytest.fixture(scope="module")
def panda():
    """A ball between jaws that close along the horizontal."""
    down = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.1034]))
    hand = pg.load_hand("panda").placed(down.homogeneous)
    return pg.plan_grasp_on(hand, pg.Sphere(radius=0.025, mass=0.1), pg.GraspConditions(mu=0.7))


@pytest.fixture(scope="module")
def allegro():
    turn = pin.Quaternion(np.array([0.1018, 0.7958, -0.3877, -0.454])).normalized().toRotationMatrix()
    hand = pg.load_hand("allegro_right").placed(pin.SE3(turn, np.array([0.0511, -0.0154, -0.02])).homogeneous)
    friction = pg.Friction(model="cone", safety=1.2)
    return pg.plan_grasp_on(hand, pg.Sphere(radius=0.03, mass=0.1), pg.GraspConditions(mu=0.7, friction=friction))


def driven(plan, drives, springs=None):
    """The same plan with these drives."""
    return replace(plan, hand=plan.hand.with_drives(drives, springs))


def one_drive(arm, **settings):
    return [Drive(name="motor", joints=(JOINT,), arms=(arm,), **settings)]


# -- efforts and positions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", [0.5, -2.0])
def test_one_joint_in_closed_form(panda, arm):
    """a = r q, e = tau / r, a_ref = r q + tau / (r kp)."""
    plan, joints = driven(panda, one_drive(arm, control="position", stiffness=300.0)), joint_trajectory(panda, **RATE)
    q, tau = joints.q[:, 0], joints.effort[:, 0]
    torque = drive_commands(plan, "torque", **RATE)
    assert torque.names == ("motor",) and torque.stiffness is None
    assert torque.q[:, 0] == pytest.approx(arm * q) and torque.effort[:, 0] == pytest.approx(tau / arm, abs=1e-12)
    assert torque.dq[:, 0] == pytest.approx(arm * joints.dq[:, 0])
    assert torque.effort[-1, 0] == pytest.approx(plan.motion.holding_torques[0] / arm)
    position = drive_commands(plan, "position", **RATE)
    assert position.q[:, 0] == pytest.approx(arm * q + tau / (arm * 300.0), abs=1e-12)
    assert not position.effort.any() and not position.dq[-1].any() and not position.ddq[-1].any()
    impedance = drive_commands(plan, "impedance", damping=2.0, stiffness=[40.0], **RATE)
    for name in ("q", "dq", "ddq", "effort"):
        assert np.array_equal(getattr(impedance, name), getattr(torque, name))
    assert impedance.stiffness == pytest.approx([40.0]) and impedance.damping == pytest.approx([2.0])


@pytest.mark.parametrize("gain", [0.5, 50.0])
def test_servos_as_springs_make_the_planned_torques(allegro, gain):
    """At the planned posture, from joint positions alone: also with two motors on two joints, and springs."""
    hand = allegro.hand
    first, second, *others = hand.joint_names
    drives = [
        Drive(name="sum", joints=(first, second), arms=(0.02, 0.015)),
        Drive(name="difference", joints=(first, second), arms=(0.02, -0.01)),
        *(Drive(name=joint, joints=(joint,), arms=(1.0,)) for joint in others),
    ]
    plan = driven(allegro, drives, [Spring(joint=second, stiffness=0.3, rest=0.1)])
    joints = joint_trajectory(allegro, **RATE)
    kp = gain * np.linspace(1.0, 2.0, len(drives))
    sent = drive_commands(plan, "position", stiffness=kp, **RATE)
    S = np.zeros((hand.n, len(drives)))  # written again
    for column, drive in enumerate(drives):
        for joint, arm in zip(drive.joints, drive.arms):
            S[hand.joint_names.index(joint), column] = arm
    made = (kp * (sent.q - joints.q @ S)) @ S.T
    made[:, 1] -= 0.3 * (joints.q[:, 1] - 0.1)
    assert made == pytest.approx(joints.effort, abs=1e-9 * max(1.0, gain))
    assert made[-1] == pytest.approx(allegro.motion.holding_torques, abs=1e-9 * max(1.0, gain))


def test_positions_move_as_their_rates_say(allegro):
    sent = drive_commands(allegro, "position", stiffness=5.0, rate=2000.0)
    numeric = np.gradient(sent.q, sent.times, axis=0)
    inside = slice(20, -20)
    assert np.abs(numeric - sent.dq)[inside].max() < 0.05 * np.abs(sent.dq).max()


def test_fewer_motors_than_joints(allegro):
    """One tendon for four joints: refused, or the least squares with a note."""
    hand = allegro.hand
    moved, others = hand.joint_names[:4], hand.joint_names[4:]
    tendon = Drive(name="tendon", joints=moved, arms=(0.01, 0.01, 0.008, 0.006))
    plan = driven(allegro, [tendon, *(Drive(name=joint, joints=(joint,), arms=(1.0,)) for joint in others)])
    with pytest.raises(
        InvalidInput, match=r"cannot produce the torques of 16 joints, .* % of the largest .*shortfall=None"
    ):
        drive_commands(plan, "torque", **RATE)
    sent = drive_commands(plan, "torque", shortfall=None, **RATE)
    wanted = joint_trajectory(allegro, **RATE).effort
    best = np.linalg.lstsq(plan.hand.transmission.T, wanted.T, rcond=None)[0].T
    assert sent.effort == pytest.approx(best, abs=1e-9)
    assert any("cannot produce the torques" in note for note in sent.notes)
    with pytest.raises(InvalidInput, match="produce within 0 %"):
        plan.to_csv("nowhere.csv", command="impedance", stiffness=1.0, damping=1.0, shortfall=0.0, **RATE)


def test_what_is_beyond_limits_is_noted(panda):
    weak = drive_commands(driven(panda, one_drive(1.0, limit=1e-3)), "torque", **RATE)
    assert any("motor needs up to" in note and "limit of 0.001" in note for note in weak.notes)
    soft = drive_commands(driven(panda, one_drive(1.0)), "position", stiffness=1.0, **RATE)
    assert any("motor is sent" in note and "beyond its joints' range" in note for note in soft.notes)


def test_joints_without_limits_have_no_range(allegro):
    model = allegro.hand.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = np.full(16, -math.inf), np.full(16, math.inf)
    endless = replace(allegro, hand=replace(allegro.hand, model=model))
    sent = drive_commands(endless, "position", stiffness=0.1, **RATE)
    assert not any("range" in note for note in sent.notes)
    assert any("range" in note for note in drive_commands(allegro, "position", stiffness=0.1, **RATE).notes)


@pytest.mark.slow
def test_a_plan_read_back_sends_the_same(panda, tmp_path):
    again = load_run(save_run(panda, tmp_path / "run"))
    assert jaw_commands(again) == jaw_commands(panda)
    one, other = (drive_commands(plan, "torque", **RATE) for plan in (panda, again))
    assert np.array_equal(one.effort, other.effort) and np.array_equal(one.q, other.q)
    again.to_mujoco(tmp_path / "scene.xml", scene=True, command="jaw", hold=0.2)
    assert played(tmp_path / "scene.xml")[2] == pytest.approx(planned(panda), rel=1e-2)


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["torque", "position", "impedance"])
def test_files_come_back(allegro, tmp_path, command):
    gains = {} if command == "torque" else {"stiffness": np.arange(1.0, 17.0)}
    gains |= {"damping": 0.1} if command == "impedance" else {}
    sent = allegro.to_csv(tmp_path / "a.csv", command=command, **gains, rate=100.0)
    message = allegro.to_ros2(tmp_path / "a.yaml", command=command, **gains, rate=100.0)
    assert message["joint_names"] == [drive.name for drive in allegro.hand.drives]
    table = read_csv(tmp_path / "a.csv")
    for back in (table, read_ros2(tmp_path / "a.yaml")):
        assert back.names == sent.names
        for name in ("times", "q", "dq", "ddq", "effort"):
            assert getattr(back, name) == pytest.approx(getattr(sent, name), rel=0, abs=1e-9)
    for name in ("stiffness", "damping"):
        wanted = np.broadcast_to(gains[name], 16) if name in gains else None
        assert np.array_equal(getattr(table, name), wanted)


@pytest.mark.parametrize("command", ["torque", "position", "impedance"])
def test_controls_of_a_model_with_an_actuator_per_drive(panda, tmp_path, command):
    """MuJoCo's own actuator force at qpos, qvel and ctrl is the effort of the drive."""
    kp, kd, sent = 400.0, 3.0, drive_commands(panda, "torque", **RATE)
    gains = {"torque": {}, "position": {"stiffness": kp}, "impedance": {"stiffness": kp, "damping": kd}}[command]
    panda.to_mujoco(tmp_path / "keys.xml", command=command, **gains, **RATE)
    servo = "<motor joint='panda_finger_joint1' gear='2'/>"
    if command != "torque":
        kv = kd if command == "impedance" else 0
        servo = f"<position joint='panda_finger_joint1' gear='2' kp='{kp}' kv='{kv}'/>"
    bodies = "".join(
        f"<body><joint name='panda_finger_joint{i}' type='slide'/><geom size='0.01'/></body>" for i in (1, 2)
    )
    (tmp_path / "hand.xml").write_text(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{servo}</actuator><include file='keys.xml'/></mujoco>"
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    data, stored = mujoco.MjData(model), np.load(tmp_path / "keys.npz")
    assert stored["actuators"].tolist() == ["jaws"] and model.nkey == 3
    for i in range(0, stored["times"].size, 9):
        data.qpos[:], data.qvel[:], data.ctrl[:] = stored["qpos"][i], stored["qvel"][i], stored["ctrl"][i]
        mujoco.mj_forward(model, data)
        assert data.actuator_force == pytest.approx(sent.effort[i], abs=1e-9)


# -- jaws --------------------------------------------------------------------------------------------------------------


def test_width_and_force_of_jaws(panda):
    """The ball's diameter, and that less both depths; the plan's forces; twice as much for both."""
    (jaw,) = jaw_commands(panda)
    assert jaw.touch_width == pytest.approx(0.05, abs=5e-6)  # planned contacts lie on the ball to micrometres
    assert "50.00 mm" in jaw.describe() and f"{1e3 * jaw.width:.2f} mm" in jaw.describe()
    depths, forces = panda.forces.final_depths, panda.forces.normal_forces
    assert jaw.width == pytest.approx(0.05 - depths.sum(), abs=5e-5)
    assert jaw.coordinate == pytest.approx(2 * panda.motion.q[-1, 0])
    assert jaw.jaw_force == pytest.approx(forces.max(), rel=1e-6)
    assert jaw.total_force == pytest.approx(forces.sum(), rel=1e-6)
    assert jaw.effort == pytest.approx(abs(panda.motion.holding_torques[0]) / 2)
    assert jaw.effort == pytest.approx(jaw.jaw_force, rel=1e-3)  # the catalogue's drive counts newtons per jaw
    summary = jaw.summary()
    assert json.loads(json.dumps(summary)) == summary
    assert summary["force_total_N"] == pytest.approx(2 * summary["force_per_jaw_N"], rel=1e-6)


def test_gripper_goal_has_the_fields_and_units_of_ros2(panda, tmp_path):
    """control_msgs/action/ParallelGripperCommand: a sensor_msgs/JointState; metres and newtons of each joint itself."""
    path = tmp_path / "grip.yaml"
    message = panda.to_ros2(path, command="jaw", frame="yes: no")
    assert set(message) == {"command"}
    command = message["command"]
    assert set(command) == {"header", "name", "position", "velocity", "effort"}
    assert set(command["header"]) == {"stamp", "frame_id"} and set(command["header"]["stamp"]) == {"sec", "nanosec"}
    (force,) = command["effort"]
    assert command["name"] == [JOINT] and command["velocity"] == []
    assert force == pytest.approx(panda.forces.normal_forces.mean(), rel=1e-3)  # one jaw
    # It closes as far as it can, or it would stop where it presses with nothing.
    assert command["position"] == [panda.hand.lower[0]] and command["position"][0] < panda.motion.q[-1, 0]
    assert yaml.safe_load(path.read_text()) == message
    both = panda.to_ros2(tmp_path / "grip.json", command="jaw", followers=True)["command"]
    assert both["name"] == [JOINT, "panda_finger_joint2"] and both["effort"] == pytest.approx([force, force])
    assert json.loads((tmp_path / "grip.json").read_text())["command"] == both
    # Work done by the joints' own forces is that of the torque of the joint that is followed.
    assert sum(both["effort"]) == pytest.approx(abs(panda.motion.holding_torques[0]))


@pytest.mark.slow
def test_a_linkage_is_driven_by_all_of_its_torque():
    """The joint that a controller commands has the plan's whole torque, whatever turns with it: work is conserved."""
    hand, ball = pg.load_hand("talos_right"), pg.Sphere(radius=0.03, mass=0.1)
    conditions = pg.GraspConditions(mu=0.8)
    plan = pg.plan_best(pg.find_grasps(hand, ball, conditions, count=16, seed=3, progress=False), conditions)
    (jaw,) = jaw_commands(plan)
    driven, *turned = jaw.joints
    assert driven.effort == pytest.approx(abs(plan.motion.holding_torques[0])) and len(turned) == 6
    assert [one.effort for one in turned] == [0.0] * 6
    command = plan.to_ros2(command="jaw")["command"]
    assert command["name"] == [driven.joint] and command["effort"] == [driven.effort]


def test_jaws_as_a_table(panda, tmp_path):
    panda.to_csv(tmp_path / "jaws.csv", command="jaw")
    with open(tmp_path / "jaws.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    (jaw,) = jaw_commands(panda)
    assert [row["joint"] for row in rows] == [JOINT, "panda_finger_joint2"]
    assert all(row["drive"] == "jaws" and float(row["width_m"]) == jaw.width for row in rows)
    assert all(float(row["width_at_touch_m"]) == jaw.touch_width for row in rows)
    assert float(rows[0]["force_per_jaw_N"]) == jaw.jaw_force and float(rows[0]["force_total_N"]) == jaw.total_force
    assert float(rows[0]["effort"]) == jaw.joints[0].effort
    # Two jaws slide towards each other, each at the speed of its joint.
    impact = panda.motion.impact
    assert float(rows[0]["speed_m_s"]) == pytest.approx(2 * abs(panda.motion.dq[impact, 0]), rel=1e-5)
    assert float(rows[0]["epsilon_m"]) == max(5e-3, jaw.touch_width - jaw.width)


def test_a_motor_that_opens_at_positive_effort_and_one_without_an_end(panda):
    opening = jaw_commands(driven(panda, one_drive(1.0)))[0]
    closing = jaw_commands(driven(panda, one_drive(-1.0)))[0]
    assert opening.joints == closing.joints and opening.effort == closing.effort
    assert closing.coordinate == -opening.coordinate
    model = panda.hand.model.copy()
    model.lowerPositionLimit = np.array([-math.inf])
    endless = jaw_commands(replace(panda, hand=replace(panda.hand, model=model)))[0].joints[0]
    assert endless.closed == endless.position == panda.motion.q[-1, 0]


# -- scenes ------------------------------------------------------------------------------------------------------------


def played(path, key=None):
    """How far the object moves and turns [m, rad], and the hand's forces on it by body [N], at the end."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, stored = mujoco.MjData(model), np.load(path.with_suffix(".npz"))
    mujoco.mj_resetDataKeyframe(model, data, model.key(key or "start").id)
    mujoco.mj_forward(model, data)
    place, turn = data.body("object").xpos.copy(), data.body("object").xmat.reshape(3, 3).copy()
    steps = round((stored["times"][1] - stored["times"][0]) / model.opt.timestep)
    for ctrl in stored["ctrl"] if key is None else np.tile(data.ctrl, (1000, 1)):
        data.ctrl[:] = ctrl
        for _ in range(steps):
            mujoco.mj_step(model, data)
    assert not any(warning.number for warning in data.warning)
    forces = {}
    for c in range(data.ncon):
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, c, wrench)
        (body,) = {model.body(model.geom_bodyid[g]).name for g in data.contact[c].geom} - {"object"}
        forces[body] = forces.get(body, 0.0) + wrench[0]
    moved = np.linalg.norm(data.body("object").xpos - place)
    return moved, np.linalg.norm(pin.log3(data.body("object").xmat.reshape(3, 3) @ turn.T)), forces, model


def planned(plan):
    forces = {}
    for link, force in zip(plan.contacts.links, plan.forces.normal_forces):
        body = f"link {plan.hand.model.frames[plan.hand.frame_id(link)].parentJoint}"
        forces[body] = forces.get(body, 0.0) + force
    return forces


@pytest.mark.parametrize("command", ["jaw", "impedance", "torque"])
def test_a_gripper_holds_in_its_scene(panda, tmp_path, command):
    """MuJoCo's own contacts make the planned forces, after the support is gone."""
    sent = panda.to_mujoco(tmp_path / "scene.xml", scene=True, command=command, hold=0.5)
    assert sent.names == ("jaws",) and {one.name for one in tmp_path.iterdir()} == {"scene.xml", "scene.npz"}
    moved, turned, forces, model = played(tmp_path / "scene.xml")
    assert moved < 1e-5 and turned < 1e-3
    assert forces == pytest.approx(planned(panda), rel=1e-2)
    assert [model.key(i).name for i in range(model.nkey)] == ["start", "touch", "grasp"]
    assert model.opt.gravity == pytest.approx(panda.gravity_o)
    assert any("do not correct the posture" in note for note in sent.notes) == (command == "torque")


@pytest.mark.parametrize("damping", [200.0, 500.0])
def test_servos_of_much_damping_hold_by_shorter_steps(panda, tmp_path, damping):
    """Coupled jaws have damping that is not implicit: at 0.5 ms its chatter drops the object (10 mm at 200 N s/m)."""
    gains = {"stiffness": 2e4, "damping": damping, "hold": 0.3, "rate": 500.0}
    sent = panda.to_mujoco(tmp_path / "scene.xml", scene=True, **gains)
    moved, turned, forces, model = played(tmp_path / "scene.xml")
    assert moved < 1e-5 and turned < 1e-3 and forces == pytest.approx(planned(panda), rel=1e-2)
    assert model.opt.timestep < 5e-4 and any("steps of" in note for note in sent.notes)
    assert "steps of" in (tmp_path / "scene.xml").read_text()
    with pytest.raises(InvalidInput, match="damping: expected gains"):
        panda.to_mujoco(tmp_path / "scene.xml", scene=True, stiffness=2e4, damping=1e5)


def test_a_scene_that_does_not_hold_is_told(panda, tmp_path):
    """The friction that the plan counts on is not there any more."""
    slippery = replace(panda, friction=replace(panda.friction, mu=0.05 * panda.friction.mu))
    sent = slippery.to_mujoco(tmp_path / "scene.xml", scene=True, hold=0.6, rate=250.0)
    assert played(tmp_path / "scene.xml")[0] > 0.01
    assert any("does not hold" in note for note in sent.notes)


@pytest.mark.parametrize("command", ["impedance", "position"])
def test_a_hand_holds_in_its_scene(allegro, tmp_path, command):
    sent = allegro.to_mujoco(tmp_path / "scene.xml", scene=True, command=command, hold=0.5, rate=500.0)
    moved, turned, forces, model = played(tmp_path / "scene.xml")
    assert moved < 1e-3 and turned < np.radians(2)
    wanted = planned(allegro)
    for body in forces.keys() | wanted.keys():  # links beside them touch by chance
        assert forces.get(body, 0.0) == pytest.approx(wanted.get(body, 0.0), rel=0.25, abs=0.2)
    assert [model.actuator(u).name for u in range(model.nu - 6)] == list(sent.names)
    assert played(tmp_path / "scene.xml", "grasp")[0] < 1e-3  # with the controls of that keyframe alone


def test_a_scene_has_the_plans_contacts(allegro, tmp_path):
    """Stiffness of a contact at rest, friction, and the support that lets go."""
    allegro.to_mujoco(tmp_path / "scene.xml", scene=True, hold=0.2, rate=500.0)
    model, stored = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml")), np.load(tmp_path / "scene.npz")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
    mujoco.mj_forward(model, data)
    while data.time < 2.5:
        mujoco.mj_step(model, data)
    frames, seen = [allegro.hand.frame_id(link) for link in allegro.contacts.links], 0
    slopes = allegro.forces.normal_forces / allegro.forces.final_depths
    slope = {f"link {allegro.hand.model.frames[i].parentJoint}": one for i, one in zip(frames, slopes)}
    for c, contact in enumerate(data.contact):
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, c, wrench)
        (body,) = {model.body(model.geom_bodyid[g]).name for g in contact.geom} - {"object"}
        assert contact.friction[0] == pytest.approx(0.7)
        if body in slope:  # friction and normal force are not quite independent in MuJoCo
            assert wrench[0] / -contact.dist == pytest.approx(slope[body], rel=0.06)
            seen += 1
    assert seen >= 4
    final = joint_trajectory(allegro, rate=500.0).final_time
    support = stored["ctrl"][:, -6:]
    assert np.all(support[stored["times"] <= final] == 1) and not support[stored["times"] > final + 0.11].any()


def test_a_scene_with_a_tendon_and_springs(allegro, tmp_path):
    """Two motors on two joints through tendons, beside a spring: their forces are the efforts."""
    hand = allegro.hand
    first, second, *others = hand.joint_names
    drives = [
        Drive(name="sum", joints=(first, second), arms=(0.02, 0.015), control="position", stiffness=9e4, damping=900.0),
        Drive(name="difference", joints=(first, second), arms=(0.02, -0.01)),
        *(Drive(name=joint, joints=(joint,), arms=(1.0,)) for joint in others),
    ]
    plan = driven(allegro, drives, [Spring(joint=second, stiffness=0.3, rest=0.1)])
    sent = plan.to_mujoco(tmp_path / "scene.xml", scene=True, hold=0.2, rate=500.0)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    data, stored = mujoco.MjData(model), np.load(tmp_path / "scene.npz")
    for i in range(0, sent.times.size, 50):
        data.qpos[:], data.qvel[:], data.ctrl[:] = stored["qpos"][i], stored["qvel"][i], stored["ctrl"][i]
        mujoco.mj_forward(model, data)
        assert data.actuator_force[:-6] == pytest.approx(sent.effort[i], abs=1e-5)  # the file has six digits
    assert model.actuator("sum").biasprm[2] == pytest.approx(-900.0)
    assert data.qfrc_passive[model.joint(second).dofadr[0]] == pytest.approx(
        -0.3 * (data.joint(second).qpos[0] - 0.1), abs=1e-6
    )


@pytest.mark.slow
def test_an_object_that_is_not_convex_holds_in_its_scene(tmp_path):
    """A tray by its wall, one jaw inside: in its convex hull there is no inside, and it falls."""
    outer, inner = trimesh.creation.box([0.12, 0.1, 0.05]), trimesh.creation.box([0.108, 0.088, 0.05])
    inner.apply_translation([0, 0, 0.006])
    made = trimesh.boolean.difference([outer, inner], engine="manifold")
    tray = pg.Mesh(vertices=made.vertices, faces=made.faces, mass=0.05)
    down = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.047, 0.025 + 0.0924]))
    plan = pg.plan_grasp_on(
        pg.load_hand("panda").placed(down.homogeneous),
        tray,
        pg.GraspConditions(mu=0.7),
    )
    assert pg.simulate(plan, hold=0.1).verdict.held
    for command in ("jaw", "impedance"):
        sent = plan.to_mujoco(tmp_path / "scene.xml", scene=True, command=command, hold=0.5)
        (note,) = [note for note in sent.notes if "not convex" in note]
        assert re.search(r"convex parts are used, which stand out of it by up to 0\.[012] mm", note)
        moved, turned, forces, _ = played(tmp_path / "scene.xml")
        assert moved < 2e-3 and turned < np.radians(3) and len(forces) == 2
        if command == "jaw":  # stiff servos press the more, the more the parts stand out
            assert forces == pytest.approx(planned(plan), rel=0.05)


@pytest.mark.slow
def test_the_papers_hand_holds_in_its_scene(tmp_path):
    """1 kg on three fingertips."""
    plan = pg.load_case("paper").plan()
    plan.to_mujoco(tmp_path / "scene.xml", scene=True)
    moved, turned, forces, _ = played(tmp_path / "scene.xml")
    assert moved < 2e-4 and turned < np.radians(0.2)
    assert forces == pytest.approx(planned(plan), rel=0.06)


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_commands_that_cannot_be_are_refused(panda, allegro, tmp_path):
    path = tmp_path / "a.csv"
    bare = replace(panda, hand=replace(panda.hand, drives=()))
    for call, words in (
        (lambda: panda.to_csv(path, command="force"), "command: expected"),
        (lambda: panda.to_csv(path, command=["torque"]), "command: expected"),
        (lambda: panda.to_ros2(command=np.zeros(2)), "command: expected"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", command=np.zeros(2)), "command: expected"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", command=np.zeros(2), scene=True), "command: expected"),
        (lambda: drive_commands(panda, "jaw"), "command: expected"),
        (lambda: drive_commands("plan", "torque"), "plan: expected a PlanRecord"),
        (lambda: drive_commands(bare, "torque"), "expected a hand with drives, .*with_drives"),
        (lambda: panda.to_csv(path, command="position"), r"stiffness: expected .* none for jaws: give stiffness="),
        (lambda: panda.to_csv(path, command="impedance", stiffness=1.0), "damping: expected .* none for jaws"),
        (lambda: panda.to_csv(path, command="position", stiffness=0.0), "stiffness: expected values > 0"),
        (lambda: panda.to_csv(path, command="position", stiffness=-1.0), "stiffness: expected values >= 0"),
        (lambda: panda.to_csv(path, command="position", stiffness=np.nan), "stiffness: expected a finite number"),
        (lambda: panda.to_csv(path, command="position", stiffness="stiff"), "stiffness"),
        (lambda: allegro.to_csv(path, command="position", stiffness=[1.0]), r"stiffness: expected shape \(16,\)"),
        (lambda: panda.to_csv(path, stiffness=1.0), "stiffness: expected with command='position'"),
        (lambda: drive_commands(panda, "torque", shortfall=-1.0), "shortfall: expected a finite number >= 0"),
        (lambda: drive_commands(panda, "torque", rate=0), "rate: expected"),
        (lambda: allegro.to_csv(path, command="jaw"), "expected drives with control 'jaw', got 16 drives"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", command="jaw"), "expected scene=True"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", scene="yes"), "scene: expected True or False"),
        (lambda: panda.to_mujoco(tmp_path / "a.json", scene=True), "suffix of a MuJoCo scene"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", scene=True, hold=-1.0), "hold: expected"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", scene=True, rate=1e-12), "rate: expected two samples"),
        (lambda: panda.to_mujoco(tmp_path / "a.xml", scene=True, model=1), "model: expected without"),
        (lambda: allegro.to_mujoco(tmp_path / "a.xml", scene=True, command="jaw"), "expected drives with control"),
        (lambda: replace(panda, body=None).to_mujoco(tmp_path / "a.xml", scene=True), "expected a plan with an object"),
        (lambda: panda.to_ros2(tmp_path / "a.txt", command="jaw"), "suffix of a ROS 2 message"),
        (lambda: gripper_message(["jaws"]), "jaws"),
    ):
        with pytest.raises(InvalidInput, match=words):
            call()
    assert not list(tmp_path.iterdir())
    path.mkdir()
    with pytest.raises(ResultsNotWritten):
        panda.to_csv(path / ".." / "a.csv" / "x" / "..", command="jaw")


def test_jaws_that_one_motor_cannot_press_as_planned(panda, tmp_path):
    """Two joints with different torques on one motor: refused, as other commands are, or the nearest effort."""
    hand = pg.load_hand("sake_left")
    joints = hand.joint_names
    assert len(joints) == 2 and len(hand.drives) == 1
    plan = replace(
        panda,
        hand=hand,
        contacts=replace(panda.contacts, links=("", "")),
        motion=replace(panda.motion, q=np.zeros((1, 2)), holding_torques=np.array([0.3, 0.1])),
    )
    with pytest.raises(InvalidInput, match="1 drive cannot produce the torques of 2 joints"):
        plan.to_ros2(command="jaw")
    (jaw,) = jaw_commands(plan, shortfall=None)
    arms = hand.transmission[0]
    assert jaw.effort == pytest.approx(abs(arms @ [0.3, 0.1]) / (arms @ arms))
    assert jaw.width is None and jaw.jaw_force is None
    assert jaw.summary()["force_per_jaw_N"] is None
    assert plan.to_ros2(command="jaw", shortfall=None)["command"]["name"] == list(joints)


def test_a_drive_that_does_not_press_is_no_jaw(panda):
    idle = replace(panda, motion=replace(panda.motion, holding_torques=np.zeros(1)))
    with pytest.raises(InvalidInput, match="expected a drive that presses"):
        jaw_commands(idle)
