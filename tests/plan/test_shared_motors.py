"""Plans on hands whose joints share motors: warnings where these cannot make the torques."""

from __future__ import annotations

import own_hands
import pytest

import pinograsp as pg
from pinograsp.errors import GraspInfeasible, NoGrasp
from pinograsp.hands import Drive, Spring


@pytest.fixture(scope="module")
def chuck(tmp_path_factory):
    """Three sliding jaws around the upright axis, with a motor each."""
    path = tmp_path_factory.mktemp("chuck") / "chuck.urdf"
    path.write_text(own_hands.chuck(3))
    return pg.load_hand(path)


def plan_of(hand):
    ball = pg.Sphere(radius=0.02, mass=0.1)
    return pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6))


def about_motors(plan):
    return [text for text in plan.cautions if "motor" in text or "drive " in text]


def shared(hand, *arms, limit=100.0, exact=True):
    return hand.with_drives([Drive(name="chuck", joints=hand.joint_names, arms=arms, limit=limit, exact=exact)])


def test_one_motor_can_press_three_jaws_alike(chuck):
    plan = plan_of(shared(chuck, 1.0, 1.0, 1.0))
    assert about_motors(plan_of(chuck)) == about_motors(plan) == []


def test_harder_with_one_of_them_as_far_as_friction_goes(chuck):
    plan = plan_of(shared(chuck, 1.0, 1.0, 1.5))
    first, second, third = abs(plan.motion.holding_torques)
    assert first == pytest.approx(second, rel=0.15) and third / (first + second) == pytest.approx(0.75, rel=0.15)
    assert plan.reserve.above_unrestricted > 0.1
    (told,) = about_motors(plan)  # friction bears it, and commands that leave it to friction are refused
    assert "6.8" in told.split("%")[0]


@pytest.mark.slow
def test_but_not_four_times_as_hard(chuck):
    with pytest.raises(GraspInfeasible, match="that this hand can produce.*drive 'chuck', which moves several joints"):
        plan_of(shared(chuck, 1.0, 1.0, 4.0))
    (told,) = about_motors(plan_of(shared(chuck, 1.0, 1.0, 4.0, exact=False)))
    assert told.startswith("the 3 joints have 1 motors between them, which cannot produce these torques: slide")


@pytest.mark.slow
def test_a_spring_can_make_up_for_it(chuck):
    """Of the third jaw the motor does too much by as much as the spring takes."""
    plan = plan_of(chuck)
    force, place = abs(plan.motion.holding_torques).mean(), plan.motion.q[-1, 2]
    spring = Spring(joint=chuck.joint_names[2], stiffness=force / 0.01, rest=place - 0.01)
    hand = shared(chuck, 1.0, 1.0, 2.0).with_drives(shared(chuck, 1.0, 1.0, 2.0).drives, [spring])
    assert plan_of(hand).reserve.above_unrestricted < plan_of(shared(chuck, 1.0, 1.0, 2.0)).reserve.above_unrestricted
    (told,) = about_motors(plan_of(hand))
    assert "on the way" in told  # where the spring is not yet stretched


@pytest.mark.slow
def test_a_motor_that_is_too_weak(chuck):
    force = abs(plan_of(chuck).motion.holding_torques).mean()
    with pytest.raises(NoGrasp):
        plan_of(shared(chuck, 1.0, 1.0, 1.0, limit=0.5 * force))
    hand = shared(chuck, 1.0, 1.0, 1.0, limit=0.5 * force)
    plan = pg.plan_grasp_on(hand, pg.Sphere(radius=0.02, mass=0.1), pg.GraspConditions(mu=0.6, torque_limit=None))
    (told,) = about_motors(plan)
    assert told.startswith("drive chuck holds with ") and f"more than its limit of {0.5 * force:.3g}" in told
