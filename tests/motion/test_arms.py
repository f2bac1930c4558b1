"""An arm and its hand in one model: plans tell the torques of the arm as well, however it is mounted."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.hands.catalogue import file_of

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


@pytest.mark.parametrize(
    ("mounted", "gravity_o"),
    [
        (UPRIGHT, (0.0, 0.0, -9.81)),
        (UPRIGHT, (9.81, 0.0, 0.0)),
        (HANGING, (0.0, 0.0, -9.81)),
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


def test_an_arms_grasp_is_kept_and_simulated(tmp_path):
    hand, plan = grasp(UPRIGHT, (0.0, 0.0, -9.81))
    again = pg.load_run(pg.save_run(plan, tmp_path / "run"))
    assert np.array_equal(again.motion.torques, plan.motion.torques) and again.hand.joint_names == hand.joint_names
    assert pg.simulate(plan, engine="pinocchio", hold=0.1, time_step=5e-4).verdict.held
