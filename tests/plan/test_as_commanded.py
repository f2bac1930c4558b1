"""How far the push of a reserve turns the object of a plan whose hand has nothing but position servos."""

from __future__ import annotations

from dataclasses import replace

import own_hands
import pytest

import pinograsp as pg
from pinograsp.hands import Drive
from pinograsp.planner.as_commanded import measure_turn

JAWS = 3


def with_servos(hand, stiffness, control="position", **settings):
    return hand.with_drives(
        Drive(name=joint, joints=(joint,), arms=(1.0,), control=control, stiffness=stiffness, **settings)
        for joint in hand.joint_names
    )


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """A ball between three jaws that close on its middle."""
    path = tmp_path_factory.mktemp("hand") / "chuck.urdf"
    path.write_text(own_hands.chuck(JAWS), encoding="utf-8")
    hand = with_servos(pg.load_hand(path), 4000.0)
    return pg.plan_grasp_on(hand, pg.Sphere(radius=0.03, mass=0.1), pg.GraspConditions(mu=0.8))


def test_servos_that_hold_and_servos_that_let_go(plan):
    """A servo that is told q + tau / kp presses with tau, however stiff it is, but no harder than it can."""
    for stiffness in (40.0, 4000.0):
        assert measure_turn(replace(plan, hand=with_servos(plan.hand, stiffness))) == 0.0
    assert measure_turn(replace(plan, hand=with_servos(plan.hand, 4000.0, limit=0.1))) == 1.0


def test_where_nobody_knows_the_servos_nothing_is_said(plan):
    for stiffness, control in ((None, "position"), (None, "torque")):
        assert measure_turn(replace(plan, hand=with_servos(plan.hand, stiffness, control))) == 0.0
    assert measure_turn(replace(plan, reserve=None)) == 0.0
