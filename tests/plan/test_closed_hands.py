"""Plans from a hand and an object, or from a hand closed on it already."""

from __future__ import annotations

import numpy as np
import own_hands
import pytest

from pinograsp.cases import load_case
from pinograsp.contacts import Friction, close_hand
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import load_hand
from pinograsp.hands.humanoid import FINAL_ANGLES_DEG
from pinograsp.objects import Box
from pinograsp.planner import plan_grasp_on


def above_the_palm(height: float) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = height
    return pose


def test_table_iv_alone_is_planned_to_the_end():
    """The paper's grasp without its contact points: they are where the closed hand touches."""
    case = load_case("paper", {"forces.balance": "wrench"})
    hand = case.load_hand()
    target = {finger: np.radians(FINAL_ANGLES_DEG[finger]) for finger in ("thumb", "index", "middle")}
    closure = close_hand(hand, case.make_object(), start=np.zeros(hand.n), target=target)
    plan = plan_grasp_on(hand, closure, GraspConditions(mu=0.7, friction=Friction(), measure="work", reserve=None))
    assert plan.forces.status is Status.OK and plan.forces.certificate.relative_gap <= 1e-6
    assert plan.motion.status in (Status.OK, Status.JOINT_LIMIT)
    assert plan.motion.tracking_error.max() < 1e-6 and plan.closure is closure


def test_plans_on_closed_grippers(tmp_path):
    """From hand and object alone to a certified, torque-limited plan; what one actuator cannot do is said."""
    hand = load_hand(own_hands.write(tmp_path, "parallel_gripper"))
    box = Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=above_the_palm(0.03))
    plan = plan_grasp_on(hand, box, GraspConditions(mu=0.6, friction=Friction(safety=1.1), reserve=None))
    assert plan.forces.status is Status.OK and plan.problem.balance == "wrench"
    certificate = plan.forces.certificate
    assert certificate.relative_gap <= 1e-6 and plan.forces.residual_force < 1e-8 and plan.forces.residual_moment < 1e-8
    assert np.all(np.abs(plan.motion.torques[-1]) <= hand.effort * (1 + 1e-6))
    assert plan.elapsed.keys() >= {"closing", "forces", "motion"}
    with pytest.raises(InvalidInput, match="conditions: expected a GraspConditions"):
        plan_grasp_on(hand, box, 0.5)
    with pytest.raises(InvalidInput, match="body: expected a Body or Closure"):
        plan_grasp_on(hand, "box", GraspConditions(mu=0.5))
    with pytest.raises(InvalidInput, match="expected the closure's own"):
        plan_grasp_on(hand.placed(above_the_palm(0.1)), plan.closure, GraspConditions(mu=0.5))


def test_plans_say_what_was_changed_in_the_object(tmp_path):
    hand = load_hand(own_hands.write(tmp_path, "parallel_gripper"))
    notes = ("two holes were closed",)
    box = Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=above_the_palm(0.03), notes=notes)
    plan = plan_grasp_on(hand, box, GraspConditions(mu=0.7, reserve=None))
    assert "object: two holes were closed" in plan.notes
