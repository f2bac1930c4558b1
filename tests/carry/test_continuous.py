"""Arms with joints that turn without end: paths beyond +-180 deg, a turn further on, wrapped."""

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.carry import plan_carry, simulate_carry
from pinograsp.carry.simulation import choose_servo
from pinograsp.errors import CarryInfeasible, InvalidInput
from pinograsp.handover import JointTrajectory

SPEED = 2.0  # [rad/s] of the arm's joints, alone in their way
FREE = {"ramp": 0, "reserve": 0, "disturbance": 0, "intervals": 40}


def link(name, mass, centre, size):
    inertia = '<inertia ixx="2e-5" iyy="2e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial><collision><origin xyz="{centre}"/>'
        f'<geometry><box size="{size}"/></geometry></collision></link>'
    )


def joint(name, kind, parent, child, axis, rest):
    ends = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{rest}</joint>'


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Jaws on a post that turns, about an axis that leans."""
    jaw = '<limit lower="0" upper="0.04" effort="40" velocity="0.2"/>'
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/>'
        + link("post", 0.4, "0 0 -0.2", "0.05 0.05 0.1")
        + link("body", 0.4, "0 0 -0.02", "0.06 0.1 0.04")
        + link("left", 0.05, "0 0.004 0.06", "0.016 0.008 0.04")
        + link("right", 0.05, "0 -0.004 0.06", "0.016 0.008 0.04")
        + joint("turn", "continuous", "base", "post", "0.6 0 0.8", f'<limit effort="1" velocity="{SPEED}"/>')
        + joint("tilt", "revolute", "post", "body", "0 1 0", '<limit lower="-1" upper="1" effort="5" velocity="2"/>')
        + joint("l", "prismatic", "body", "left", "0 1 0", jaw)
        + joint("r", "prismatic", "body", "right", "0 -1 0", jaw + '<mimic joint="l"/>')
        + "</robot>"
    )
    return path


@pytest.fixture(scope="module")
def arm(file):
    return pg.load_hand(file)


@pytest.fixture(scope="module")
def grasp(arm):
    at = np.eye(4)
    at[2, 3] = 0.06
    box = pg.Box(size=(0.03, 0.03, 0.06), mass=0.2).placed(at)
    return pg.plan_grasp_on(arm, box, pg.GraspConditions(mu=0.6, reserve=None), progress=False)


@pytest.mark.parametrize(
    "way",
    [(2.5, 3.6), *(pytest.param(way, marks=pytest.mark.slow) for way in ((-2.0, -5.0), (0.0, 4 * np.pi), (7.5, 6.0)))],
)
def test_a_continuous_joint_goes_as_far_as_the_path(arm, grasp, way):
    """As with limits that are far away, and no faster than its speed allows."""
    free = replace(arm, continuous=()).with_limits({"turn": (-20.0, 20.0)})
    plan, same = (plan_carry(one, grasp, {"turn": way}, **FREE) for one in (arm, free))
    assert plan.duration == pytest.approx(same.duration, rel=1e-9)
    assert plan.duration >= abs(way[1] - way[0]) / SPEED
    np.testing.assert_allclose(plan.trajectory(rate=100.0).q[[0, -1], arm.joint_names.index("turn")], way, atol=1e-9)


def test_a_turn_further_on_is_the_same(arm, grasp):
    way, options = np.array([-0.4, 0.1, 0.7]), FREE | {"acceleration": 3.0}
    plan, on = (plan_carry(arm, grasp, {"turn": way + 2 * np.pi * k}, **options) for k in (0, 1))
    assert on.duration == pytest.approx(plan.duration, rel=1e-6)
    # The timing is optimal to 1e-7, its loads to the square root of that, of 2 N and 3 rad/s^2.
    np.testing.assert_allclose(on.loads, plan.loads, atol=2e-3)


def test_other_joints_and_limits_that_are_given_hold(arm, grasp, file):
    with pytest.raises(InvalidInput, match=r"'tilt' goes 0.5 rad beyond its limits.*load_hand\(limits=\)"):
        plan_carry(arm, grasp, {"turn": [3.0, 4.0], "tilt": [0.0, 1.5]}, **FREE)
    with pytest.raises(InvalidInput, match="'turn' goes 0.3 rad beyond its limits"):
        plan_carry(pg.load_hand(file, limits={"turn": (-3.5, 3.5)}), grasp, {"turn": [3.0, 3.8]}, **FREE)


def test_what_a_continuous_joint_leads_has_its_limits(file):
    text = file.read_text().replace('upper="1" effort="5" velocity="2"/>', 'upper="1"/><mimic joint="turn"/>')
    led = file.with_name("led.urdf")
    led.write_text(text)
    assert pg.load_hand(file).continuous == ("turn",)
    assert pg.load_hand(led).continuous == ()


@pytest.mark.slow
def test_it_stays_continuous_in_a_run(arm, grasp, tmp_path):
    back = pg.load_run(pg.save_run(grasp, tmp_path / "run"))
    assert back.hand.continuous == arm.continuous
    low, high = back.hand.travel
    turn = arm.joint_names.index("turn")
    assert np.isinf([low[turn], high[turn]]).all() and np.isfinite(np.delete([low, high], turn, axis=1)).all()


def test_a_motor_far_too_strong_for_its_link_is_no_stiffer_than_steps_bear(grasp, file):
    """A servo of 500 N m on half a kilogram would ring faster than the engine steps, and fling the object away."""
    strong = file.with_name("strong.urdf")
    strong.write_text(file.read_text().replace('effort="5"', 'effort="500"'))
    servo = choose_servo(plan_carry(pg.load_hand(strong), grasp, {"turn": [2.9, 3.5]}, **FREE))
    # Stiffness over damping is half of the natural frequency; damping has to be below two per step of a millisecond.
    assert (4.0 * servo.stiffness / servo.damping)[:2].max() < 2.0 / 1e-3


@pytest.mark.slow
def test_simulated_it_hits_no_limit(arm, grasp):
    plan = plan_carry(arm, grasp, {"turn": [2.9, 3.5]}, acceleration=2.0, intervals=40)
    assert not simulate_carry(plan).verdict.limit_hits


def test_a_way_round_between_two_waypoints_is_told(arm, grasp):
    """Angles that a driver wraps: the numbers say nearly a whole turn back, and that is planned, with a warning."""
    plan = plan_carry(arm, grasp, {"turn": [3.0, -3.0]}, **FREE)
    assert plan.duration >= 6.0 / SPEED
    assert any("turn" in one and "343.8 deg" in one for one in plan.cautions)
    unwrapped = plan_carry(arm, grasp, {"turn": np.unwrap([3.0, -3.0])}, **FREE)
    assert unwrapped.duration < 1.0
    for sure in (unwrapped, plan_carry(arm, grasp, {"turn": [0.0, 6.0]}, **FREE)):
        assert not any("unwrap" in one for one in sure.cautions)


def test_a_wrapped_trajectory_is_too_fast_and_told(arm, grasp):
    q, zero = np.array([[3.0], [3.1], [-3.1], [-3.0]]), np.zeros((4, 1))
    way = JointTrajectory(names=("turn",), times=[0.0, 0.1, 0.2, 0.3], q=q, dq=zero, ddq=zero, effort=zero)
    with pytest.raises(CarryInfeasible, match="speed of turn.*unwrap"):
        plan_carry(arm, grasp, way, timing="given", **FREE | {"ramp": 0.05})
