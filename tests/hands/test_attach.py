"""A hand on an arm: kinematics, masses and torques of the robot are those of both, joined by hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from shipped_hands import loaded

import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.errors import InvalidInput
from pinograsp.hands import attach, detach, servo_gains
from pinograsp.hands.catalogue import file_of
from pinograsp.hands.reach import measure_reach
from pinograsp.hands.record import hand_of, hand_record

UR5 = "ur_description/urdf/ur5_robot.urdf"
AT = pin.SE3(pin.utils.rotate("z", 0.3) @ pin.utils.rotate("x", 0.2), np.array([0.01, 0, 0.02])).homogeneous
GRIPPER = """<mujoco model="pincher"><worldbody><body name="mount"><geom type="box" size=".03 .03 .01"/>
<body name="one" pos=".03 0 0"><joint name="j" axis="0 1 0" range="0 1.5" armature="0.003"/>
<geom type="capsule" fromto="0 0 0 0 0 .06" size=".008"/></body>
<body name="two" pos="-.03 0 0"><joint name="k" axis="0 -1 0" range="0 1.5"/>
<geom type="capsule" fromto="0 0 0 0 0 .06" size=".008"/></body></body></worldbody>
<actuator><position joint="j" kp="7.5"/><position joint="k" kp="7.5"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def arm_file():
    return file_of("panda").parents[2] / UR5


@pytest.mark.parametrize("hand_name", ["allegro_right", "panda", "psyonic_left"])
def test_the_robot_is_both_of_them(hand_name):
    """With a Panda's arm, of whose file the hand is left out."""
    robot = attach(file_of("panda"), hand_name, link="panda_link8", at=AT, remove=["panda_hand"])
    hand, arm = loaded(hand_name), pin.buildModelFromUrdf(str(file_of("panda")))
    assert set(robot.joint_names) == {f"panda_joint{i}" for i in range(1, 8)} | set(hand.joint_names)
    assert (robot.palm, [one.name for one in robot.fingers]) == (hand.palm, [one.name for one in hand.fingers])
    rng = np.random.default_rng(20261129)
    q = rng.uniform(robot.lower, robot.upper)
    alone = np.array([q[robot.joint_names.index(name)] for name in hand.joint_names])
    tips = [one.tip for one in hand.fingers]
    at_arm, *at_tips = robot.frame_placements(q, ["panda_link8", *tips])
    np.testing.assert_allclose(at_tips, at_arm @ AT @ hand.frame_placements(alone, tips), atol=1e-12)
    of_arm, data = np.array([q[robot.joint_names.index(f"panda_joint{i}")] for i in range(1, 8)]), arm.createData()
    pin.framesForwardKinematics(arm, data, np.concatenate([of_arm, np.zeros(arm.nq - 7)]))
    np.testing.assert_allclose(at_arm, data.oMf[arm.getFrameId("panda_link8")].homogeneous, atol=1e-12)
    own = [drive for drive in robot.drives if set(drive.joints) <= set(hand.joint_names)]
    assert [str(one) for one in own] == [str(one) for one in hand.drives] and len(robot.drives) == 7 + len(own)
    i = [robot.joint_names.index(name) for name in hand.joint_names]
    np.testing.assert_allclose(robot.effort[i], hand.effort)
    np.testing.assert_allclose(np.array(robot.model.armature)[i], hand.model.armature)


def test_how_far_an_arm_reaches(arm_file):
    """A Panda's flange comes 855 mm from its first axis (Franka's data sheet), 107 mm below the flange's own joint."""
    robot = pg.load_hand(file_of("panda"), palm="panda_link8", fingers={"jaw": "panda_leftfinger"})
    assert measure_reach(robot) == pytest.approx(0.855, abs=0.01)
    assert measure_reach(loaded("allegro_right")) is None
    # A UR5's upper arm and forearm are 425 and 392 mm long; the rest of it can go on along them.
    ur5 = attach(arm_file, "panda", link="tool0")
    assert 0.425 + 0.392 < measure_reach(ur5) < 1.1
    q = np.random.default_rng().uniform(ur5.lower, ur5.upper, (500, ur5.n))
    base, palm = (ur5.frame_placements(q, [name])[:, 0, :3, 3] for name in ("shoulder_link", ur5.palm))
    assert np.linalg.norm(palm - base, axis=1).max() < measure_reach(ur5) + 1e-9
    assert "arm: 6 joints" in ur5.describe()


def test_arm_and_hand_bear_their_weight(arm_file):
    """Gravity's torques are the slopes of the potential energy, and the mass is that of both."""
    robot = attach(arm_file, "allegro_right", link="tool0", at=AT)
    masses = [one.mass for one in pin.buildModelFromUrdf(str(arm_file)).inertias]
    assert robot.mass == pytest.approx(sum(masses) + loaded("allegro_right").mass, rel=1e-6)
    model, data = robot.model, robot.model.createData()
    q = np.random.default_rng(1).uniform(np.maximum(robot.lower, -1), np.minimum(robot.upper, 1))
    told, step = pin.computeGeneralizedGravity(model, data, q), 1e-6
    slopes = [
        (
            pin.computePotentialEnergy(model, data, q + step * one)
            - pin.computePotentialEnergy(model, data, q - step * one)
        )
        / (2 * step)
        for one in np.eye(robot.n)
    ]
    np.testing.assert_allclose(told, slopes, atol=1e-5)


@pytest.mark.parametrize("kind", ["file", "text", "spec"])
def test_other_formats_are_mounted_too(arm_file, tmp_path, kind):
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER)
    hand = {"file": path, "text": GRIPPER, "spec": mujoco.MjSpec.from_string(GRIPPER)}[kind]
    robot = attach(arm_file, hand, link="tool0")
    assert robot.joint_names[-2:] == ("j", "k") and len(robot.fingers) == 2
    np.testing.assert_array_equal(robot.servo_stiffness[-2:], [7.5, 7.5])
    assert robot.model.armature[robot.joint_names.index("j")] == 0.003


def test_it_is_planned_with_carried_and_kept(arm_file, tmp_path):
    home = dict(zip(("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"), (-1.5, 1.6, -1.6, -1.57)))
    robot = attach(arm_file, "panda", link="tool0", posture=home)
    there = np.eye(4)
    there[2, 3] = 0.1034
    box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
    plan = pg.plan_grasp_on(
        robot,
        box.placed(robot.frame_placements(robot.resting, ["panda_hand"])[0] @ there),
        pg.GraspConditions(mu=0.6),
    )
    carried = plan_carry(robot, plan, {"shoulder_pan_joint": [0.0, 0.3, 0.6]})
    assert 0.05 < carried.duration < 3.0
    assert plan.status is pg.Status.OK and any("of the arm's" in note for note in plan.notes)
    assert (
        servo_gains(robot)[0] == robot.effort[0] / 0.03 and servo_gains(robot)[-1] == servo_gains(loaded("panda"))[-1]
    )
    back = pg.load_run(pg.save_run(plan, tmp_path / "run")).hand
    np.testing.assert_allclose(
        back.frame_placements(robot.resting, ["panda_hand"]), plan.hand.frame_placements(robot.resting, ["panda_hand"])
    )


@pytest.mark.parametrize("hand_name", ["allegro_right", "panda", "psyonic_left", "hey5"])
def test_the_hand_comes_off_again(arm_file, hand_name):
    """Joints, links, inertias, limits and drives stay where they were; what the last joint carries is its root."""
    home = {"elbow_joint": 0.7, "wrist_1_joint": -0.4}
    robot, alone = attach(arm_file, hand_name, link="tool0", at=AT, posture=home), loaded(hand_name)
    hand = detach(robot)
    assert (hand.joint_names, hand.palm) == (alone.joint_names, alone.palm) and not len(hand.arm)
    assert [str(one) for one in hand.drives] == [str(one) for one in alone.drives]
    q, whole = np.random.default_rng(5).uniform(hand.lower, hand.upper), np.array(robot.resting)
    whole[[robot.joint_names.index(name) for name in hand.joint_names]] = q
    names = [hand.palm, *(link for finger in hand.fingers for link in finger.links)]
    np.testing.assert_allclose(hand.frame_placements(q, names), robot.frame_placements(whole, names), atol=1e-12)
    fingers = [robot.joint_names.index(name) for name in hand.joint_names]
    np.testing.assert_allclose(
        hand.joint_inertia(q), robot.joint_inertia(whole)[np.ix_(fingers, fingers)], rtol=1e-9, atol=1e-12
    )
    placed = {one.name: one.placement for one in alone.geometry.geometryObjects}
    own = {one.name: one for one in hand.geometry.geometryObjects}
    assert set(placed) < set(own) and "wrist_3_link_0" in own
    for name, one in own.items():
        if one.parentJoint and name in placed:
            np.testing.assert_allclose(one.placement.homogeneous, placed[name].homogeneous, atol=1e-12)
    back = hand_of(hand_record(hand))
    np.testing.assert_allclose(back.frame_placements(q, names), hand.frame_placements(q, names), atol=1e-12)
    assert detach(hand) is hand and detach(alone) is alone


def test_what_is_planned_for_the_hand_alone_is_carried_by_the_robot(arm_file):
    home = dict(zip(("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"), (-1.5, 1.6, -1.6, -1.57)))
    robot = attach(arm_file, "panda", link="tool0", posture=home)
    hand, there = detach(robot), np.eye(4)
    there[2, 3] = 0.1034
    box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
    at_palm = box.placed(hand.frame_placements(hand.resting, ["panda_hand"])[0] @ there)
    plans = [pg.plan_grasp_on(one, at_palm, pg.GraspConditions(mu=0.6)) for one in (hand, robot)]
    np.testing.assert_allclose(plans[0].forces.normal_forces, plans[1].forces.normal_forces, rtol=1e-3)
    carried = [plan_carry(robot, plan, {"shoulder_pan_joint": [0.0, 0.3, 0.6]}) for plan in plans]
    assert carried[0].duration == pytest.approx(carried[1].duration, rel=1e-3)


def test_what_cannot_be_mounted_is_refused(arm_file):
    for wrong, told in (
        ({"link": "tool9"}, "did you mean 'tool0'"),
        ({"link": "tool0", "remove": ["gripper"]}, "link of the arm"),
        ({"link": "tool0", "at": np.eye(3)}, "at"),
        ({"link": "tool0", "posture": {"elbow": 1.0}}, "elbow_joint"),
    ):
        with pytest.raises(InvalidInput, match=told):
            attach(arm_file, "panda", **wrong)
    with pytest.raises(InvalidInput, match="do not share"):
        attach(file_of("panda"), "panda", link="panda_link8")
