"""Plans of hands with fewer drives than joints: tendons over two joints, a motor for two fingers with springs beyond."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import own_hands
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.errors import GraspInfeasible, NoGrasp
from pinograsp.hands import Drive, Spring

MU = 0.6
CONDITIONS = pg.GraspConditions(mu=MU)
SIDES = ("left", "right")
PAIR = own_hands.robot(
    "pair",
    own_hands.link("palm", 0.3, "box 0.12 0.04 0.02", "0 0 -0.02"),
    *(
        part
        for side, x, turn in (("left", -0.05, 1), ("right", 0.05, -1))
        for part in (
            own_hands.link(f"{side}_proximal", 0.01, "cylinder 0.005 0.04", "0 0 0.025"),
            own_hands.link(
                f"{side}_distal", 0.006, "cylinder 0.005 0.02", "0 0 0.012", (("sphere 0.008", "0 0 0.035"),)
            ),
            own_hands.joint(f"{side}_1", "palm", f"{side}_proximal", f"{x} 0 0", f"0 {turn} 0", "-0.5 1.2 3 4"),
            own_hands.joint(
                f"{side}_2", f"{side}_proximal", f"{side}_distal", "0 0 0.05", f"0 {turn} 0", "-0.5 1.2 3 4"
            ),
        )
    ),
)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two fingers of two joints that face each other; every joint has a motor."""
    path = tmp_path_factory.mktemp("pair") / "pair.urdf"
    path.write_text(PAIR)
    return pg.load_hand(path)


@pytest.fixture(scope="module")
def free(pair):
    """The plan of the hand with a motor at each joint."""
    return planned(pair)


def planned(hand):
    body = pg.Cylinder(radius=0.025, height=0.06, mass=0.05, pose=_at(0.08))
    closure = pg.close_hand(
        hand,
        body,
        start={side: [-0.3, 0.0] for side in hand_fingers(hand)},
        target={side: [1.0, 0.3] for side in hand_fingers(hand)},
    )
    return pg.plan_grasp_on(hand, closure, CONDITIONS)


def hand_fingers(hand):
    return [finger.name for finger in hand.fingers]


def _at(height):
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # lies across the fingers
    pose[2, 3] = height
    return pose


def torques(plan):
    """Holding torques by joint name."""
    return dict(zip(plan.hand.joint_names, plan.motion.holding_torques))


def tendons(hand, left, right=None):
    """A tendon over the two joints of each finger."""
    arms = {"left": left, "right": left if right is None else right}
    return hand.with_drives(
        [Drive(name=f"{side}_tendon", joints=(f"{side}_1", f"{side}_2"), arms=arms[side]) for side in SIDES]
    )


def in_cvxpy(plan, drives, springs=(), friction=0.0):
    """Whether any forces in the friction cones hold the weight with torques of these drives: from Pinocchio alone.

    ``friction``: share of the contacts' torques by which those of the second joint may miss the drives'.
    """
    model, q, contacts = plan.hand.model, plan.closure.q, plan.solution.problem.contacts
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    tau = np.array(pin.computeGeneralizedGravity(model, data, q))
    forces = cp.Variable((len(contacts), 3))
    spun, conditions, net, levers = cp.Variable(len(contacts)), [], 0, []
    for i, (contact, touch) in enumerate(zip(contacts, plan.closure.touches)):
        pose, turn = data.oMi[touch.joint_id], contact.rotation_oc
        J = pin.getJointJacobian(model, data, touch.joint_id, pin.LOCAL_WORLD_ALIGNED)
        arm = contact.point_o - pose.translation
        levers.append((J[:3] - pin.skew(arm) @ J[3:]).T)
        world = turn @ forces[i]
        tau = tau + (J[:3] - pin.skew(arm) @ J[3:]).T @ world + J[3:].T @ (turn[:, 2] * spun[i])
        # Soft fingers, with 80 % of the friction as the reserve leaves it.
        limit = 0.8 * MU * forces[i, 2]
        conditions += [cp.norm(cp.hstack([forces[i, :2], 0.8 * MU / (0.8 * 5e-3) * spun[i]])) <= limit]
        moment = pin.skew(contact.point_o - contacts.com_o) @ world + turn[:, 2] * spun[i]
        net = net + cp.hstack([world, moment])
    arms = np.zeros((len(drives), model.nv))
    for row, drive in zip(arms, drives):
        for joint, arm in zip(drive.joints, drive.arms):
            row[plan.hand.joint_names.index(joint)] = arm
    elastic = np.zeros(model.nv)
    for spring in springs:
        j = plan.hand.joint_names.index(spring.joint)
        elastic[j] = -spring.stiffness * (q[j] - spring.rest)
    efforts = cp.Variable(len(drives))
    conditions += [net == np.array([0, 0, 0.05 * 9.81, 0, 0, 0])]
    missed = tau - arms.T @ efforts - elastic
    if friction:
        for row in arms:
            across = np.zeros(model.nv)
            first, second = np.flatnonzero(row)
            across[[first, second]] = np.array([row[second], -row[first]]) / np.linalg.norm(row)
            sizes = np.array([np.linalg.norm(across @ lever) for lever in levers])
            conditions += [cp.abs(across @ missed) <= friction * sizes @ forces[:, 2]]
    else:
        conditions += [missed == 0]
    program = cp.Problem(cp.Minimize(cp.max(forces[:, 2])), conditions)
    program.solve(solver=cp.CLARABEL)
    return program.status == "optimal"


def test_tendons_whose_arms_fit(pair, free):
    own = torques(free)
    fitting = tendons(pair, (own["left_1"], own["left_2"]), (own["right_1"], own["right_2"]))
    plan = planned(fitting)
    assert plan.status == "ok" and in_cvxpy(free, fitting.drives)
    assert plan.reserve.above_unrestricted < 0.02
    assert not [text for text in plan.cautions if "motors between them" in text]


@pytest.mark.slow
@pytest.mark.parametrize(("share", "held"), [(1.0, True), (0.97, True), (1.3, False), (0.7, False)])
def test_friction_of_tendons_bears_a_little(pair, free, share, held):
    """Two opposed contacts leave the forces no choice: a tendon's torques are off by as much as its arms."""
    own = torques(free)
    other = tendons(pair, (share * own["left_1"], own["left_2"]), (share * own["right_1"], own["right_2"]))
    assert in_cvxpy(free, other.drives, friction=0.05) == held
    if held:
        plan = planned(other)
        harder = plan.forces.normal_forces.sum() / free.forces.normal_forces.sum()
        assert plan.status == "ok" and (harder > 1.1) == (share != 1.0)
        # The impulse of a linear deceleration grows about as the forces do.
        assert plan.reserve.above_unrestricted == pytest.approx(harder - 1.0, abs=0.3 * (harder - 1.0) + 0.01)
    else:
        with pytest.raises(GraspInfeasible, match="that this hand can produce.*tendon"):
            planned(other)


@pytest.mark.slow
def test_tendons_that_cannot_make_the_torques(pair, free):
    own = torques(free)
    wrong = tendons(pair, (own["left_1"], own["left_2"]), (own["right_1"], -own["right_2"]))
    assert not in_cvxpy(free, wrong.drives)
    with pytest.raises(GraspInfeasible, match="that this hand can produce.*right_tendon") as refused:
        planned(wrong)
    assert "left_tendon" not in str(refused.value)


@pytest.mark.slow
def test_one_motor_for_two_fingers_with_springs_in_their_tips(pair, free):
    own, q = torques(free), dict(zip(pair.joint_names, free.closure.q))
    motor = Drive(name="motor", joints=("left_1", "right_1"), arms=(own["left_1"], own["right_1"]))
    springs = [Spring(joint=f"{side}_2", stiffness=0.5, rest=q[f"{side}_2"] + own[f"{side}_2"] / 0.5) for side in SIDES]
    plan = planned(pair.with_drives([motor], springs))
    assert plan.status == "ok" and in_cvxpy(free, [motor], springs)
    slack = [Spring(joint=spring.joint, stiffness=0.5, rest=q[spring.joint]) for spring in springs]
    assert not in_cvxpy(free, [motor], slack)
    with pytest.raises(NoGrasp, match="that this hand can produce.*no drive moves left_2"):
        planned(pair.with_drives([motor], slack))


def test_limp_joints_hold_nothing(pair):
    only = [Drive(name=f"{side}_motor", joints=(f"{side}_1",), arms=(1.0,)) for side in SIDES]
    with pytest.raises(NoGrasp, match="no drive moves right_2"):
        planned(pair.with_drives(only))


def test_what_nobody_has_measured_is_a_caution(pair, free):
    own = torques(free)
    arms = {side: (own[f"{side}_1"], -own[f"{side}_2"]) for side in SIDES}
    loose = [
        Drive(name=f"{side}_tendon", joints=(f"{side}_1", f"{side}_2"), arms=arms[side], exact=False) for side in SIDES
    ]
    plan = planned(pair.with_drives(loose))
    assert [text for text in plan.cautions if "motors between them, which cannot produce these torques" in text]
    assert torques(plan) == pytest.approx(own)
