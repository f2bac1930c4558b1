"""A plan that asks more of motors, speeds or encoders than they have says so."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import own_hands
import pytest
from marks import slow_except
from shipped_hands import loaded

import pinograsp as pg
from pinograsp.errors import GraspInfeasible, PinograspError, Status
from pinograsp.hands import Drive, Source
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.spatial import pose_of

CONDITIONS = pg.GraspConditions(mu=0.7)


def gripper(tmp_path, effort=60.0, velocity=0.1, drives=None):
    """Two sliding jaws of that effort limit [N] and speed limit [m/s]."""
    path = tmp_path / "gripper.urdf"
    limits = f'effort="{effort}" velocity="{velocity}"'
    path.write_text(own_hands.PARALLEL_GRIPPER.replace('effort="60" velocity="0.1"', limits))
    return pg.load_hand(path, drives=drives)


def block(hand, mass=0.1, height=0.035):
    at = hand.frame_placements(hand.resting, [hand.palm])[0] @ pose_of([0.0, 0.0, height], np.eye(3))
    return pg.Box(size=(0.03, 0.03, 0.05), mass=mass).placed(at)


def squeezed(hand, force, height=0.035):
    """A plan in which two jaws hold a block whose weight asks for ``force`` [N] of each."""
    body = block(hand, 2 * 0.8 * force / 9.81, height)
    conditions = pg.GraspConditions(
        mu=0.8, reserve=None, max_depth=0.03, friction=pg.Friction(model="soft", torsion=0.02)
    )
    return pg.plan_grasp_on(hand, body, conditions)


def told(plan, words):
    return [text for text in plan.cautions if words in text]


# -- limits of jaws ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_pandas_jaws_press_with_what_their_maker_says():
    """With 55 and 67 N each: the maker allows 70 N. Not with 73 N."""
    for force in (55.0, 67.0):
        plan = squeezed(loaded("panda"), force, 0.1034)
        assert plan.status is Status.OK
        assert abs(plan.motion.holding_torques[0]) == pytest.approx(2 * force, rel=1e-3)
    with pytest.raises(GraspInfeasible):
        squeezed(loaded("panda"), 73.0, 0.1034)


@pytest.mark.slow
@pytest.mark.parametrize("effort", slow_except([12.0, 235.0], 12.0))
def test_each_of_two_jaws_presses_with_its_own_effort(tmp_path, effort):
    hand = gripper(tmp_path, effort)
    assert squeezed(hand, 0.85 * effort).forces.normal_forces.sum() == pytest.approx(2 * 0.85 * effort, rel=1e-3)
    with pytest.raises(GraspInfeasible):
        squeezed(hand, 1.05 * effort)


def test_torques_beyond_a_limit_that_was_left_out(tmp_path):
    """Planned without torque limits, jaws of 10 N that press with 25 N: a warning, once, in newtons."""
    hand = gripper(tmp_path, effort=10.0)
    conditions = pg.GraspConditions(mu=0.7, torque_limit=None)
    plan = pg.plan_grasp_on(hand, block(hand, 2.0), conditions)
    assert abs(plan.motion.holding_torques[0]) > 20.0
    (text,) = told(plan, "more than its effort limit of 20 N")
    assert "left_slide" in text and "N m" not in text and text not in plan.notes


# -- guesses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("guess", "share", "cautions"), [(True, 0.3, 0), (True, 0.7, 1), (False, 0.7, 0)])
def test_a_guess_is_noted_and_warned_of_from_half_of_it_on(tmp_path, guess, share, cautions):
    stated = Source(figure="limit", text="the colour of its cover", guess=guess)
    drive = Drive(name="motor", joints=("left_slide",), arms=(2.0,), control="jaw", limit=50.0, sources=(stated,))
    plan = squeezed(gripper(tmp_path, drives=[drive]), share * 50.0)
    assert len([note for note in plan.notes if "the colour of its cover" in note]) == guess
    assert len(told(plan, "a guess")) == cautions


# -- speeds ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [0.012, 0.03, 0.2])
def test_a_speed_limit_that_is_passed(tmp_path, velocity):
    hand = gripper(tmp_path, velocity=velocity)
    plan = pg.plan_grasp_on(hand, block(hand), CONDITIONS)
    peak = np.abs(plan.motion.dq).max()
    cautions = told(plan, "speed limit")
    assert len(cautions) == (peak > velocity)
    if cautions:
        assert all(part in cautions[0] for part in ("left_slide", f"{peak:.3g} m/s", f"{velocity:g} m/s"))


@pytest.mark.slow
def test_more_time_is_what_helps(tmp_path):
    hand = gripper(tmp_path, velocity=0.03)
    slower = pg.GraspConditions(mu=0.7, final_time=2.5, impact_time_range=(2.2, 2.4))
    assert told(pg.plan_grasp_on(hand, block(hand), CONDITIONS), "final_time")
    assert not told(pg.plan_grasp_on(hand, block(hand), slower), "speed limit")


# -- encoders ----------------------------------------------------------------------------------------------------------


def servo_plan(tmp_path, steps):
    """A plan whose servo is sent that many encoder steps beyond where it holds."""
    hand = gripper(tmp_path)
    servo = Drive(name="servo", joints=("left_slide",), arms=(1.0,), control="position", stiffness=4e4)
    plan = squeezed(hand.with_drives([servo]), 20.0)
    way = abs(plan.motion.holding_torques[0]) / 4e4
    return squeezed(hand.with_drives([replace(servo, step=way / steps)]), 20.0)


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "cautions"), [(0.4, 1), (1.9, 1), (2.1, 0), (50.0, 0)])
def test_servos_that_are_sent_less_than_two_steps(tmp_path, steps, cautions):
    plan = servo_plan(tmp_path, steps)
    texts = told(plan, "encoder")
    assert len(texts) == cautions and all(f"{steps:.2g} steps" in text and "servo" in text for text in texts)
    sent = plan.to_csv(tmp_path / "way.csv", command="position")
    assert len([note for note in sent.notes if "encoder" in note]) == cautions
    softer = plan.to_csv(tmp_path / "way.csv", command="position", stiffness=100.0)
    assert not [note for note in softer.notes if "encoder" in note]


@pytest.mark.slow
def test_the_so101s_stiffness_of_a_simulator_is_beyond_its_encoder():
    """998 N m/rad would hold a small ball with a twentieth of a step of 2 pi / 4096."""
    hand = loaded("so101")
    ball, conditions = pg.Sphere(radius=0.018, mass=0.06), pg.GraspConditions(mu=0.6)
    stiff = hand.with_drives([replace(hand.drives[0], stiffness=998.22)])
    for one, few in ((hand, False), (stiff, True)):
        found = pg.find_grasps(one, ball, conditions, count=4, seed=0, progress=False)
        plan = pg.plan_best(found, conditions)
        drive, step = one.drives[0], 2 * math.pi / 4096
        way = abs(plan.motion.holding_torques[0]) / drive.stiffness
        assert (way < 2 * step) == few and bool(told(plan, "encoder")) == (way < max(2 * step, drive.backlash))


# -- motors that cannot ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("third", "exact"), [(1.0, True), (1.02, False), (1.2, False), (1.4, True), (2.5, False)])
def test_a_caution_where_commands_are_refused_and_only_there(tmp_path, third, exact):
    path = tmp_path / "chuck.urdf"
    path.write_text(own_hands.chuck(3))
    hand = pg.load_hand(path)
    motor = Drive(name="motor", joints=hand.joint_names, arms=(1.0, 1.0, third), exact=exact)
    plan = pg.plan_grasp_on(hand.with_drives([motor]), pg.Sphere(radius=0.02, mass=0.1), pg.GraspConditions(mu=0.6))
    try:
        plan.to_csv(tmp_path / "efforts.csv", command="torque")
        refused = False
    except PinograspError:
        refused = True
    tau, arms = np.array(plan.motion.holding_torques), np.array([[1.0, 1.0, third]])
    left = np.abs(tau - arms.T @ np.linalg.lstsq(arms.T, tau, rcond=None)[0]).max() / np.abs(tau).max()
    texts = told(plan, "cannot produce these torques")
    assert bool(texts) == refused == (left > 0.05)
    assert all(f"{100 * left:.3g} % of the largest torque" in text for text in texts)


@pytest.mark.slow
def test_what_the_hey5s_motors_leave_is_told():
    """Springs that nobody has published share its torques: three motors alone leave most of them."""
    can, conditions = pg.Cylinder(radius=0.03, height=0.12, mass=0.2), pg.GraspConditions(mu=0.8)
    hand = loaded("hey5")
    plan = pg.plan_best(pg.find_grasps(hand, can, conditions, count=6, seed=2, progress=False), conditions)
    tau, arms = np.array(plan.motion.holding_torques), np.array(hand.transmission)
    left = np.abs(tau - arms.T @ np.linalg.lstsq(arms.T, tau, rcond=None)[0]).max() / np.abs(tau).max()
    (text,) = told(plan, "cannot produce these torques")
    assert left > 0.5 and f"{100 * left:.3g} %" in text


# -- ok means within every limit ---------------------------------------------------------------------------------------


def within(plan):
    """Whether torques and speeds of the whole motion are within the hand's limits and its drives'."""
    hand, motion = plan.hand, plan.motion
    torques = np.vstack([motion.torques, motion.holding_torques])
    efforts = np.abs(torques @ np.linalg.pinv(hand.transmission))
    fast = np.abs(motion.dq) > np.where(hand.velocity > 0, hand.velocity, np.inf) * 1.001
    most = np.abs(torques) > hand.effort_or_infinity * 1.001
    return not (fast.any() or most.any() or (efforts > np.array([one.limit for one in hand.drives]) * 1.001).any())


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_a_plan_without_a_caution_is_within_all_limits(name):
    hand = loaded(name)
    any_torque = pg.GraspConditions(mu=0.6, torque_limit=None)
    for mass, seed in ((0.05, 3), (1.0, 4)):
        ball = pg.Sphere(radius=0.03 if hand.n > 2 else 0.015, mass=mass)
        try:
            found = pg.find_grasps(hand, ball, any_torque, count=4, seed=seed, progress=False)
        except PinograspError:
            continue
        for torque_limit in ("effort", None, 3.0):
            try:
                plan = pg.plan_best(found, pg.GraspConditions(mu=0.6, torque_limit=torque_limit))
            except PinograspError:
                continue  # no plan promises nothing
            assert plan.status is not Status.OK or within(plan) or told(plan, "limit")


JAWS = """<mujoco><worldbody><body name="base"><geom type="box" size="0.03 0.05 0.02"/>
  <body name="l" pos="0 0 0.03"><joint name="jl" type="slide" axis="0 {l} 0" range="{r}"/>
  <geom type="box" size="0.008 0.004 0.02" pos="0 0.0{y} 0.03"/></body>
  <body name="r" pos="0 0 0.03"><joint name="jr" type="slide" axis="0 {right} 0" range="{r}"/>
  <geom type="box" size="0.008 0.004 0.02" pos="0 -0.0{y} 0.03"/></body></body></worldbody>
  <equality><joint joint1="jl" joint2="jr"/></equality>
  <actuator><motor name="grip" joint="jr" forcerange="{force}"/></actuator></mujoco>"""
# Positive positions are open, or closed.
OPENS, CLOSES = {"l": 1, "right": -1, "r": "0 0.04", "y": "04"}, {"l": -1, "right": 1, "r": "0 0.04", "y": "44"}


@pytest.mark.parametrize(
    ("way", "force", "fits"),
    [
        (OPENS, "-30 30", True),
        (OPENS, "-30 0", True),
        (OPENS, "-30 1", True),
        (OPENS, "0 30", False),
        (OPENS, "-1 30", False),
        (CLOSES, "0 30", True),
        (CLOSES, "-30 0", False),
    ],
)
def test_motors_that_act_one_way_hold_that_way_only(way, force, fits):
    """The sign of MuJoCo's own motor that closes the jaws decides; ranges are kept by records."""
    from pinograsp.hands.record import hand_of, hand_record

    hand = pg.load_hand(JAWS.format(force=force, **way))
    least, most = (float(value) for value in force.split())
    assert hand.drives[0].efforts == (None if least == -most else (least, most))
    assert hand_of(hand_record(hand)).drives == hand.drives
    at = hand.frame_placements(hand.resting, [hand.palm])[0] @ pose_of([0.0, 0.0, 0.06], np.eye(3))
    body = pg.Box(size=(0.02, 0.03, 0.03), mass=0.1).placed(at)
    conditions = pg.GraspConditions(mu=0.6, reserve=None, friction=pg.Friction(model="soft", torsion=0.01))
    closed = pg.close_hand(hand, body)
    (code,) = pg.certify(closed.hand, body, closed.q[None], conditions).reason
    assert Status.from_code(code) is (Status.HELD if fits else Status.DRIVES)
    if fits:
        effort = pg.plan_grasp_on(hand, body, conditions, progress=False).motion.holding_torques[0]
        assert least - 1e-9 <= effort <= most + 1e-9
        return
    with pytest.raises(GraspInfeasible, match=f"drive grip .* produces {least:g} to {most:g}"):
        pg.plan_grasp_on(hand, body, conditions, progress=False)


@pytest.mark.parametrize("efforts", [(0.0, 4.0), (3.0, -3.0), (-5.0, 1.0), (0.0, float("nan")), "x", (1.0,)])
def test_efforts_that_do_not_fit_the_limit_are_refused(efforts):
    with pytest.raises(PinograspError, match="efforts of drive 'd'"):
        Drive(name="d", joints=("j",), arms=(1.0,), limit=3.0, efforts=efforts)


# -- grippers that press no gentler ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("times", "cautions"), [(2.5, 1), (0.9, 0)])
def test_drives_that_cannot_press_so_gently(tmp_path, times, cautions):
    hand = gripper(tmp_path)
    jaws = [Drive(name=joint, joints=(joint,), arms=(1.0,), limit=60.0) for joint in hand.joint_names]
    plan = squeezed(hand.with_drives(jaws), 10.0)
    held = np.abs(plan.motion.holding_torques)
    floored = [replace(jaw, floor=times * float(effort)) for jaw, effort in zip(jaws, held)]
    texts = told(squeezed(hand.with_drives(floored), 10.0), "presses with")
    assert len(texts) == cautions * len(jaws) and all("2.5 times these forces" in text for text in texts)


def test_a_floor_above_the_limit_is_refused():
    with pytest.raises(PinograspError, match="floor of drive 'jaw': expected at most its limit 60, got 70"):
        Drive(name="jaw", joints=("slide",), arms=(1.0,), limit=60.0, floor=70.0)
