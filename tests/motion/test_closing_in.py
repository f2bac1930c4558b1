"""The way of closing fingers: gentle approaches within limits, hits on the way, and depths that joints press together."""

from __future__ import annotations

import numpy as np
import own_hands
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st

import pinograsp as pg
from pinograsp.contacts import close_hand
from pinograsp.contacts.hits import Way
from pinograsp.errors import GraspUndecided, Status
from pinograsp.hands import load_hand
from pinograsp.motion import MotionSpec, pressing_together
from pinograsp.motion.approach import gentle_approach

LOW, HIGH = np.array([-0.5, 0.0, -1.0]), np.array([1.5, 1.0, 1.0])
shares = st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)


@settings(max_examples=40)
@example([0.0, 0.0, 0.0], [0.9999, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.01)
@given(shares, shares, st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3), st.sampled_from([0.1, 0.01]))
def test_gentle_approaches_stay_within_the_limits(begin, end, rates, last):
    """And end where, as fast and as accelerated as they are to; rates and accelerations are the derivatives."""
    start, q = LOW + np.array(begin) * (HIGH - LOW), LOW + np.array(end) * (HIGH - LOW)
    dq = np.array(rates)
    ddq = -dq / 0.1  # as the grasp phase brakes
    # Near a limit that it leaves, a joint turns within a fraction of a millisecond.
    times = np.concatenate([np.linspace(0, 0.899, 2_000, endpoint=False), np.linspace(0.899, 0.9, 2_001)])
    path, jumps = gentle_approach(
        times, 0.9, start, (q, dq, ddq), limits=(LOW, HIGH), windows=[[0, 1], [0, 0.4], [0.6, 1]], last_part=last
    )
    assert np.all(path.q >= LOW - 1e-12) and np.all(path.q <= HIGH + 1e-12)
    assert path.q[0] == pytest.approx(start) and path.q[-1] == pytest.approx(q)
    assert path.dq[-1] == pytest.approx(np.where(jumps, 0.0, dq), abs=1e-9)
    assert np.all(path.dq[0] == 0) and path.ddq[-1][~jumps] == pytest.approx(ddq[~jumps], abs=1e-6)
    step = np.diff(times)[:, None]
    off = np.abs(np.diff(path.q, axis=0) / step - (path.dq[1:] + path.dq[:-1]) / 2)
    assert (off <= 2 * step * np.abs(path.ddq).max() + 1e-8).all()
    # A joint has no room only at a limit that it leaves.
    at_limit = (dq > 0) & (q - LOW < 1e-2) | (dq < 0) & (HIGH - q < 1e-2)
    assert not np.any(jumps & ~at_limit)


def test_the_deepest_hit_on_the_way(hand):
    """A ball put where a fingertip passes: the link, and the depth that is deep enough."""
    q = np.linspace(0.0, 1.0, 11)[:, None] * (hand.lower + hand.upper) / 2
    ball = pg.Sphere(radius=0.005, mass=0.1)
    assert Way(hand, ball.placed(pg.spatial.pose_of([0.5, 0.5, 0.5]))).deepest_hit(q) is None
    data, finger = hand.model.createData(), hand.fingers[1]
    pin.forwardKinematics(hand.model, data, q[6])
    inside = pg.spatial.pose_of(data.oMi[finger.joint_ids[-1]].translation)
    hit = Way(hand, ball.placed(inside)).deepest_hit(q)
    assert hit is not None and hit.depth > 0.004 and hit.link in finger.links
    alone = Way(hand, ball.placed(inside)).deepest_hit(q[hit.sample : hit.sample + 1])
    assert alone is not None and alone.depth == pytest.approx(hit.depth, abs=1e-9)
    assert Way(hand, ball.placed(inside)).deepest_hit(q, allowed=hit.depth + 1e-6) is None


@pytest.fixture(scope="module")
def jaws(tmp_path_factory):
    return load_hand(own_hands.write(tmp_path_factory.mktemp("jaws"), "parallel_gripper"))


def test_jaws_on_one_actuator_press_alike_and_the_object_gives_way(jaws):
    pose = np.eye(4)
    pose[2, 3] = 0.03
    closure = close_hand(jaws, pg.Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=pose))
    contacts = closure.contacts()
    together = pressing_together(closure.hand, contacts, contacts.posture)
    rng = np.random.default_rng(2)
    for _ in range(20):
        dq, twist = rng.normal(size=jaws.n), 1e-3 * rng.normal(size=6)
        depths = together.moves @ dq - together.shifts @ twist
        assert np.abs(together.rows @ depths).max(initial=0.0) < 1e-12
    # Twisted corners of a rigid face cannot go in one without the other.
    assert len(together.rows) == len(contacts) - np.linalg.matrix_rank(
        np.column_stack([together.moves, together.shifts]), tol=1e-6
    )
    alone = np.zeros(len(contacts))
    alone[0] = 1e-3
    assert np.abs(together.rows @ alone).max() > 1e-5


def test_plans_of_jaws_are_what_they_can_press(jaws):
    pose = np.eye(4)
    pose[2, 3] = 0.03
    plan = pg.plan_grasp_on(jaws, pg.Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=pose), pg.GraspConditions(mu=0.6))
    together = pressing_together(plan.closure.hand, plan.problem.contacts, plan.problem.contacts.posture)
    depths = plan.solution.profile.final_depth
    assert plan.status is Status.OK and plan.friction.model == "soft"
    assert np.abs(together.rows @ depths).max() < 1e-6 * depths.max()


@pytest.mark.slow
def test_forces_that_the_hand_cannot_make_are_told(jaws):
    """Turned about its jaws' line the box needs unequal corners, more than a shift may give."""
    pose = np.eye(4)
    pose[2, 3] = 0.03
    closure = close_hand(jaws, pg.Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=pose))
    capped = pg.GraspConditions(mu=0.6, max_normal_force=0.2)
    with pytest.raises((GraspUndecided, pg.errors.GraspInfeasible)):
        pg.plan_grasp_on(closure.hand, closure, capped)


def test_a_start_beyond_the_object_is_an_early_contact(jaws):
    """The motion from jaws that are on the wrong side of the object says so; from open jaws there is no word of it."""
    pose = np.eye(4)
    pose[2, 3] = 0.03
    closure = close_hand(jaws, pg.Box(size=(0.03, 0.03, 0.05), mass=0.1, pose=pose))
    closed = {finger.name: closure.target[finger.dofs] for finger in closure.hand.fingers}
    touching = {finger.name: closure.q[finger.dofs] for finger in closure.hand.fingers}
    plan = pg.plan_grasp_on(
        closure.hand,
        closure,
        pg.GraspConditions(mu=0.6),
        pg.PlanOptions(motion=MotionSpec(start=closed, posture=touching)),
    )
    assert plan.status is Status.EARLY_CONTACT and plan.status.exit_code == 0
    assert "hits the object on the way" in plan.motion.remedy and "mm deep" in plan.motion.remedy
