"""An arm and its hand in one model: plans tell the torques of the arm as well, however it is mounted."""

from __future__ import annotations

import json

import numpy as np
import own_hands
import pinocchio as pin
import pytest
from own_hands import joint
from typer.testing import CliRunner

import pinograsp as pg
from pinograsp.cases import load_case
from pinograsp.cli import app
from pinograsp.errors import InvalidInput
from pinograsp.hands.catalogue import file_of
from pinograsp.motion.contact_ik import contact_postures

ARM = {"panda_joint1": 0.3, "panda_joint2": -0.4, "panda_joint3": 0.2, "panda_joint4": -2.0, "panda_joint5": 0.3}
ARM |= {"panda_joint6": 1.9, "panda_joint7": 0.5}
UPRIGHT, HANGING = np.eye(4), pin.SE3(pin.exp3(np.array([np.pi, 0.0, 0.0])), np.array([0.2, 0.1, 1.5])).homogeneous
TILTED = pin.SE3(pin.exp3(np.array([1.0, 2.0, 0.3])), np.array([1.0, 0.0, 0.0])).homogeneous
MASS = 0.3


def grasp(mounted, gravity_o):
    """A box of 0.3 kg between the jaws of a Panda hand on its arm, which stays as it is."""
    hand = pg.load_hand(file_of("panda"), pose=mounted)
    q = np.array([ARM.get(joint, 0.0) for joint in hand.joint_names])
    start, target = q.copy(), q.copy()
    start[-1], target[-1] = 0.04, 0.0
    between = hand.frame_placements(q, ["panda_hand"])[0] @ pin.SE3(np.eye(3), np.array([0, 0, 0.1034])).homogeneous
    box = pg.Box(size=(0.04, 0.04, 0.05), mass=MASS).placed(between)
    closure = pg.close_hand(hand, box, start=start, target=target)
    return hand, pg.plan_grasp_on(hand, closure, pg.GraspConditions(mu=0.6, gravity_o=gravity_o))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mounted", "gravity_o"),
    [
        (UPRIGHT, (0.0, 0.0, -9.81)),
        pytest.param(UPRIGHT, (9.81, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param(HANGING, (0.0, 0.0, -9.81), marks=pytest.mark.slow),
        (TILTED, (0.0, -6.0, 7.0)),
    ],
)
def test_the_arm_holds_hand_and_object(mounted, gravity_o):
    """Holding torques against RNEA with the contact forces as external ones and, for the arm, against the gravity of an
    arm that the object is welded to: balanced forces load it with nothing but the object's weight.

    The object's centre is up to 0.1 mm off where the jaws press it to: 3 N times that, and forces of 10 N at points as much apart.
    """
    hand, plan = grasp(mounted, gravity_o)
    motion, q = plan.motion, plan.motion.q[-1]
    assert plan.status in ("ok", "doubtful") and q[:7] == pytest.approx([ARM[joint] for joint in hand.joint_names[:7]])
    model = hand.model.copy()
    model.gravity.linear = np.array(gravity_o)
    data, still = model.createData(), np.zeros(hand.n)
    pin.forwardKinematics(model, data, q)
    on_links = [pin.Force.Zero() for _ in range(model.njoints)]
    for contact, force, depth in zip(plan.problem.contacts, motion.forces_o[-1], plan.solution.profile.final_depth):
        joint, point = hand.finger(contact.finger).joint_of(contact.link), contact.point_o + depth * contact.normal_o
        on_links[joint] += data.oMi[joint].actInv(pin.Force(-force, np.cross(point, -force)))
    assert motion.holding_torques == pytest.approx(pin.rnea(model, data, q, still, still, on_links), abs=1e-3)

    held = model.getJointId("panda_joint7")
    object_h = data.oMi[held].actInv(plan.problem.object.com_o)
    model.inertias[held] = model.inertias[held] + pin.Inertia(MASS, object_h, np.zeros((3, 3)))
    welded = pin.computeGeneralizedGravity(model, model.createData(), q)
    assert motion.holding_torques[:7] == pytest.approx(welded[:7], abs=3e-3)
    alone = pin.computeGeneralizedGravity(hand.model, hand.model.createData(), q)
    assert np.abs(motion.holding_torques[:7] - alone[:7]).max() > 0.5  # what the object adds


@pytest.mark.slow
def test_an_arms_grasp_is_kept_and_simulated(tmp_path):
    hand, plan = grasp(UPRIGHT, (0.0, 0.0, -9.81))
    again = pg.load_run(pg.save_run(plan, tmp_path / "run"))
    assert np.array_equal(again.motion.torques, plan.motion.torques) and again.hand.joint_names == hand.joint_names
    assert pg.simulate(plan, hold=0.1, time_step=5e-4).verdict.held


def between_jaws(hand):
    """A box of 0.3 kg between the open jaws of the hand where its arm stays."""
    between = hand.frame_placements(hand.resting, ["panda_hand"])[0] @ pin.SE3(np.eye(3), np.array([0, 0, 0.1034]))
    return pg.Box(size=(0.04, 0.04, 0.05), mass=MASS).placed(between)


@pytest.mark.slow
def test_an_arm_stays_where_it_is_told_once(tmp_path):
    """Said when the hand is loaded, in all that is planned, simulated, drawn and kept; against the torques that an arm
    holds its gravity and an object welded to it with.
    """
    hand = pg.load_hand(file_of("panda"), pose=TILTED, posture=ARM)
    wanted = np.array(list(ARM.values()))
    assert hand.resting == pytest.approx([*wanted, 0.0])
    plan = pg.plan_grasp_on(hand, between_jaws(hand), pg.GraspConditions(mu=0.6))
    assert plan.status in ("ok", "doubtful")
    assert np.array_equal(plan.motion.q[:, :7], np.tile(wanted, (len(plan.motion.q), 1)))
    model, data = hand.model.copy(), hand.model.createData()
    pin.forwardKinematics(model, data, plan.motion.q[-1])
    held = model.getJointId("panda_joint7")
    object_h = data.oMi[held].actInv(plan.problem.object.com_o)
    model.inertias[held] = model.inertias[held] + pin.Inertia(MASS, object_h, np.zeros((3, 3)))
    still = np.zeros(hand.n)
    welded = pin.rnea(model, model.createData(), plan.motion.q[-1], still, still)
    assert plan.motion.holding_torques[:7] == pytest.approx(welded[:7], abs=3e-3)
    again = pg.load_run(pg.save_run(plan, tmp_path / "run"))
    assert again.hand.posture == ARM and again.hand.placed(UPRIGHT).posture == ARM


@pytest.mark.slow
def test_grasps_are_searched_with_the_arm_where_it_stays():
    """Also where that is near a limit of a joint."""
    near = ARM | {"panda_joint4": -0.08}
    hand = pg.load_hand(file_of("panda"), posture=near)
    box = pg.Box(size=(0.04, 0.04, 0.05), mass=MASS)
    found = pg.find_grasps(hand, box, pg.GraspConditions(mu=0.6), count=4, jobs=1, progress=False)
    assert found.grasps
    for one in found.grasps:
        for q in (one.closure.q, one.closure.start, one.closure.target):
            assert np.array_equal(q[:7], list(near.values()))


@pytest.mark.slow
def test_contacts_at_points_are_reached_from_where_the_wrist_stays(tmp_path):
    """Postures of fingers at given points, as cases have them: angles at which their own fingertips are there."""
    wrist = joint("wrist", "forearm", "palm", "0 0 0.2", "0 1 0", "-1.5 1.5 9 9")
    file = tmp_path / "hand.urdf"
    file.write_text(own_hands.THREE_FINGERS.replace("</robot>", f'<link name="forearm"/>{wrist}</robot>'))
    hand = pg.load_hand(file, posture={"wrist": 0.8})
    angles = {finger.name: np.full(finger.n, 0.15) for finger in hand.fingers}
    q = hand.configuration(angles)
    assert q[hand.joint_names.index("wrist")] == 0.8
    points = hand.frame_placements(q, [finger.tip for finger in hand.fingers])[:, :3, 3]
    middle = points.mean(axis=0)
    ball = pg.Sphere(radius=np.linalg.norm(points[0] - middle), mass=0.1, pose=pin.SE3(np.eye(3), middle).homogeneous)
    contacts = pg.contacts_at(hand, ball, {finger.name: point[None] for finger, point in zip(hand.fingers, points)})
    for name, found in contact_postures(hand, contacts).items():
        assert found.angles[0] == pytest.approx(angles[name], abs=1e-6)


def test_the_commands_and_cases_take_a_posture():
    shape = "box:size=0.04x0.04x0.05,mass=0.3"
    hand = pg.load_hand(file_of("panda"), posture=ARM)
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = between_jaws(hand).pose[:3, :3], between_jaws(hand).com_o
    rpy = np.degrees(pin.rpy.matrixToRpy(at[:3, :3]))
    options = [part for joint, value in ARM.items() for part in ("--posture", f"{joint}={value}")]
    done = CliRunner().invoke(
        app,
        ["close", "--hand", str(file_of("panda")), "--object", shape, "--json", *options]
        + ["--at", ",".join(map(str, [*at[:3, 3], *rpy]))],
    )
    found = json.loads(done.stdout)
    assert {joint: found["q"][joint] for joint in ARM} == pytest.approx(ARM)
    assert {touch["link"] for touch in found["touches"]} == {"panda_leftfinger", "panda_rightfinger"}
    case = load_case("paper", {"hand.source": str(file_of("panda")), "hand.limits_deg": {}, "hand.posture": ARM})
    assert case.load_hand().posture == ARM


@pytest.mark.parametrize(
    ("posture", "match"),
    [
        ({"panda_joint9": 0.0}, "joint of hand 'panda'.*did you mean|expected one of"),
        ({"panda_joint4": 1.0}, "posture of 'panda_joint4': expected"),
        ({"panda_finger_joint1": 0.01}, "joints of no finger .*got 'panda_finger_joint1'.*start="),
        ({"panda_joint1": "far"}, "posture of 'panda_joint1': expected a"),
        ([0.0], "posture: expected"),
    ],
)
def test_postures_that_an_arm_cannot_have_are_refused(posture, match):
    with pytest.raises(InvalidInput, match=match):
        pg.load_hand(file_of("panda"), posture=posture)
