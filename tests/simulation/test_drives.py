"""Drives, contacts and bases that are not as planned, against closed forms on a chuck of three sliding jaws, whose
servos and contacts are springs in series.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import own_hands
import pytest
from marks import slow_except
from swinging_shape import SHAPES, engine, one_joint, pose

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.objects import Sphere
from pinograsp.plan import ContactLaw
from pinograsp.simulation import BaseMotion, Disturbance, Errors, Push, Servo, monte_carlo, simulate, what_holds
from pinograsp.simulation.causes import find_causes
from pinograsp.simulation.law import NO_TOUCHES, Pressing
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.random_errors import draw_errors
from pinograsp.simulation.task import Task
from pinograsp.storage import read_check

G, MASS, MU, SAFETY = 9.81, 0.3, 0.6, 1.5
KP = 2e3  # [N/m] of the jaws' servos: about as stiff as the contacts
FIXED = {"release": False, "hold": 0.3, "time_step": 5e-4}
FREE = {"hold": 0.6, "time_step": 1e-3}
# Hands close within less than half a second: what they do on their way is not looked at.
BRISK = {"final_time": 0.4, "impact_time_range": (0.2, 0.35)}


def conditions(safety):
    friction = pg.Friction(model="cone", safety=safety)
    return pg.GraspConditions(mu=MU, friction=friction, reserve=None, **BRISK)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("chuck") / "chuck.urdf"
    path.write_text(own_hands.chuck(3), encoding="utf-8")
    hand = pg.load_hand(path)
    closure = pg.close_hand(
        hand, pg.Cylinder(radius=0.02, height=0.08, mass=MASS), start=np.zeros(3), target=np.full(3, 0.05)
    )
    return pg.plan_grasp_on(hand, closure, conditions(SAFETY))


@pytest.fixture(scope="module")
def task(plan):
    return Task.of(plan)


@pytest.fixture(scope="module")
def undisturbed(task):
    return simulate(task, **FREE)


@pytest.fixture(scope="module")
def slippery(task):
    """With a third of the friction: lost."""
    return simulate(task, disturbance=Disturbance(mu=0.2), **FREE)


@pytest.fixture(scope="module")
def linear(task):
    """With contacts of exponent 1 that bear the same forces at the same depths."""
    stiffness = task.normal_forces[0] / task.depths[0]
    return replace(task, law=ContactLaw(stiffness=stiffness, damping=10.0, exponent=1.0))


# -- control -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", slow_except([0.2, 1.0, 20.0], 1.0))
def test_a_servo_and_a_contact_are_springs_in_series(linear, factor):
    """F' = F (C_c + C_h) / (C_c' + C_h); of the position alone C_c / (C_c' + C_h); of the torque alone 1."""
    contact, hand = 1 / linear.law.stiffness, 1 / KP
    ratios = {
        "impedance": (contact + hand) / (contact / factor + hand),
        "position": contact / (contact / factor + hand),
        "torque": 1.0,
    }
    for control, ratio in ratios.items():
        servo = Servo.of(linear.hand, None if control == "torque" else KP, control=control)
        if control == "torque":  # 100 times the stiffness of the softest contact in a second
            servo = replace(servo, damping=servo.damping / 10)
        seen = simulate(linear, servo=servo, disturbance=Disturbance(stiffness=factor), **FIXED)
        # The closed hand presses 0.15 um deeper, a 1e-4 of the depth.
        assert seen.normal_forces[-1] / linear.normal_forces == pytest.approx(np.full(3, ratio), rel=2e-4)
        assert seen.servo["control"] == control


@pytest.mark.slow
def test_default_servos_are_the_position_and_the_torque(task, undisturbed):
    servo = Servo.of(task.hand)
    assert servo.control == "impedance" and servo.stiffness == pytest.approx(np.full(3, 50 / 0.03**2))
    assert not Servo.of(task.hand, control="torque").stiffness.any()
    np.testing.assert_array_equal(undisturbed.normal_forces, simulate(task, servo=servo, **FREE).normal_forces)


@pytest.fixture(scope="module")
def gripped():
    """A box between a gripper's jaws."""
    return pg.plan_grasp_on(
        pg.load_hand("panda"),
        pg.Box(size=(0.04, 0.03, 0.05), mass=0.1, pose=pose(np.eye(3), [0, 0, 0.11])),
        pg.GraspConditions(mu=0.6, **BRISK),
    )


@pytest.mark.slow
@pytest.mark.parametrize("control", slow_except(["torque", "position", "impedance"], "impedance"))
def test_energy_is_kept_by_every_control_with_every_error(gripped, control):
    """On coupled jaws: what the motors put in is stored, or lost in contacts and dry friction."""
    servo = Servo.of(gripped.hand, None if control == "torque" else 5e3, control=control)
    wrong = Disturbance(stiffness=4.0, joint_friction=0.2, joint_offset=1e-4, servo_gain=0.8)
    seen = simulate(gripped, servo=servo, disturbance=wrong, hold=0.1, time_step=5e-4)
    assert seen.verdict.energy_error < 5e-3


def test_servos_are_mujocos_own(task):
    """Actuators as MuJoCo's <position kp="..." kv="..." forcerange="...">."""
    own = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><geom size='1'/><joint name='j'/></body></worldbody><actuator>"
        "<position joint='j' kp='2000' kv='20' forcelimited='true' forcerange='-200 200'/></actuator></mujoco>"
    )
    ours = MujocoEngine(task, time_step=5e-4, servo=Servo.of(task.hand, KP), mass_factor=1.0).model
    for name in ("gaintype", "gainprm", "biastype", "biasprm", "forcelimited", "forcerange"):
        assert np.all(getattr(ours, f"actuator_{name}") == getattr(own, f"actuator_{name}")), name


@pytest.mark.slow
def test_servo_gains_are_those_of_a_servo_with_them(task):
    servo = Servo.of(task.hand, KP)
    firmer = replace(servo, stiffness=1.5 * servo.stiffness, damping=1.5 * servo.damping)
    one = simulate(task, servo=servo, disturbance=Disturbance(servo_gain=1.5), **FREE)
    np.testing.assert_array_equal(one.normal_forces, simulate(task, servo=firmer, **FREE).normal_forces)
    torque = Servo.of(task.hand, control="torque")
    assert torque.scale_gains(2.0) is torque


def test_gain_errors_of_torque_control_are_those_of_the_torques(linear):
    """F' = factor F."""
    servo = Servo.of(linear.hand, control="torque")
    servo = replace(servo, damping=servo.damping / 10)
    seen = simulate(linear, servo=servo, disturbance=Disturbance(servo_gain=1.3), **FIXED)
    assert seen.normal_forces[-1] / linear.normal_forces == pytest.approx(np.full(3, 1.3), rel=1e-4)
    same = simulate(linear, servo=servo, disturbance=Disturbance(drive_gain=np.full(linear.hand.n, 1.3)), **FIXED)
    np.testing.assert_allclose(same.normal_forces[-1], seen.normal_forces[-1], rtol=1e-3)
    for wrong in (0.0, -1.0, [1.0, 0.0], np.nan):
        with pytest.raises(InvalidInput, match="drive gain"):
            Disturbance(drive_gain=wrong)


def test_late_commands_shift_all_that_waits_for_the_hand(linear):
    late, settings = 0.066, {"time_step": 5e-4, "hold": 0.1}
    plain = simulate(linear, **settings)
    shifted = simulate(linear, disturbance=Disturbance(command_delay=late), **settings)
    assert shifted.times[-1] - plain.times[-1] == pytest.approx(late, abs=2e-3)
    assert shifted.release - plain.release == pytest.approx(late, abs=1e-6)
    assert shifted.verdict.held == plain.verdict.held
    np.testing.assert_allclose(shifted.normal_forces[-1], plain.normal_forces[-1], rtol=1e-2)
    each = np.linspace(0.0, late, linear.hand.n)  # the last of them is waited for
    assert simulate(linear, disturbance=Disturbance(command_delay=each), **settings).release == shifted.release
    assert Disturbance(command_delay=late).summary()["command_delay"] == late
    for wrong in (-0.1, 66.0, np.nan):
        with pytest.raises(InvalidInput, match="command delay"):
            Disturbance(command_delay=wrong)


# -- joints ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction, stays", [(0.11, 0.02), (0.09, 0.018), (0.05, 0.01), (0.0, 0.0)])
def test_dry_friction_holds_a_deflection_up_to_its_limit(friction, stays):
    """A joint 0.02 rad away from where a servo of 5 N m/rad wants it comes as near as friction / 5 N m/rad."""
    body = Sphere(radius=0.03, mass=0.1, pose=pose(np.eye(3), [0, 0, 1.0]))
    made = engine(SHAPES["sphere"], body, gravity=np.zeros(3), servo=5.0, friction=friction)
    made.place(np.full(1, 0.02), np.zeros(1), body.pose)
    nothing = Pressing(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    for _ in range(2000):
        made.touches()
        made.step(np.zeros(1), np.zeros(1), np.zeros(1), NO_TOUCHES, nothing, np.zeros(6))
    assert made.q[0] == pytest.approx(stays, abs=1e-5)
    assert made.friction[0] == pytest.approx(5.0 * stays if friction else 0.0, abs=1e-4)
    assert abs(made.dq[0]) < 1e-4


@pytest.mark.slow
def test_dry_friction_of_a_whole_hand_keeps_account_of_energy():
    """Twenty joints that push each other."""
    brisk = {"forces.search": "convex", "limits.final_time": 0.4, "limits.impact_time": [0.2, 0.35]}
    plan = pg.load_case("paper", brisk).plan(progress=False)
    servo = Servo.of(plan.hand, 5.0)
    rubbed, free = (
        simulate(plan, servo=servo, disturbance=Disturbance(joint_friction=size), hold=0.1, time_step=5e-4)
        for size in (5e-3, 0.0)
    )
    assert np.abs(rubbed.q - free.q).max() > 5e-4
    assert max(rubbed.verdict.energy_error, free.verdict.energy_error) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("control", ["impedance", "torque"])
def test_dry_friction_takes_its_share_of_a_grip(linear, control):
    """Jaws that come to rest as they close press with f C_h / (C_c + C_h) too little, the edge of the dead band."""
    contact, hand, friction = 1 / linear.law.stiffness, 1 / KP, 0.3
    servo = Servo.of(linear.hand, None if control == "torque" else KP, control=control)
    if control == "torque":
        servo = replace(servo, damping=servo.damping / 10)
    band = friction * (1.0 if control == "torque" else hand / (contact + hand))
    wrong = Disturbance(joint_friction=friction)
    seen = simulate(linear, servo=servo, disturbance=wrong, **FIXED)
    missing = linear.normal_forces - seen.normal_forces[-1]
    assert np.all(missing <= band * (1 + 1e-6)) and missing == pytest.approx(np.full(3, band), rel=0.03)


@pytest.mark.slow
def test_an_encoder_that_reads_too_much_presses_less(linear):
    """F' = F - offset / (C_c + C_h)."""
    offset = np.array([1e-4, 0.0, -2e-4])
    wrong = Disturbance(joint_offset=offset)
    seen = simulate(linear, servo=Servo.of(linear.hand, KP), disturbance=wrong, **FIXED)
    expected = linear.normal_forces - offset / (1 / linear.law.stiffness + 1 / KP)
    assert seen.normal_forces[-1] == pytest.approx(expected, rel=1e-4)
    assert seen.q[0] == pytest.approx(linear.q[0] - offset, abs=1e-12)  # it starts where it thinks that it is


# -- contacts ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("rho", slow_except([1.0, 1.5], 1.5))
def test_harder_contacts_press_and_damp_as_told(task, rho):
    """At the planned depths F grows as K, and what is damped on the way with the factor^(1 + 1 / (2 rho))."""
    stated, factor = replace(task, law=replace(task.law, damping=50.0, exponent=rho)), 4.0
    runs = [simulate(stated, mode="prescribed", disturbance=Disturbance(stiffness=f), **FIXED) for f in (1.0, factor)]
    assert runs[1].normal_forces[-1] == pytest.approx(factor * runs[0].normal_forces[-1], rel=1e-9)
    damped = [run.energies["damped"][-1] for run in runs]
    assert damped[1] / damped[0] == pytest.approx(factor ** (1 + 1 / (2 * rho)), rel=1e-6)


@pytest.mark.slow
def test_hard_contacts_get_steps_that_resolve_them(task):
    for factor, mass_factor in ((1e3, 1.0), (20.0, 0.1)):
        hard = Disturbance(stiffness=factor, mass_factor=mass_factor)
        seen = simulate(task, disturbance=hard, hold=0.05, time_step=1e-3)
        K, rho = task.law.stiffness, task.law.exponent
        swings = math.sqrt(3 * factor * K * rho * task.depths[0] ** (rho - 1) / MASS)  # [rad/s]
        assert seen.time_step < 1e-3 and seen.time_step * swings < 0.61
        assert any("hard object swings fast" in note for note in seen.notes)
    soft = simulate(task, disturbance=Disturbance(stiffness=0.2), hold=0.05, time_step=5e-4)
    assert soft.time_step == 5e-4


# -- base --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_constant_acceleration_of_the_base_is_tilted_gravity(task):
    """The fingers bear m (a - g), as where gravity is g - a."""
    acceleration = np.array([0.8, -0.4, 0.6])
    motion = BaseMotion(times=[0.0, 0.5, 0.8], accelerations=np.tile(acceleration, (3, 1)))
    firm = Servo.of(task.hand, 2e5)
    seen = simulate(task, disturbance=Disturbance(base_motion=motion), servo=firm, **FREE)
    assert seen.verdict.held and seen.verdict.energy_error is None
    last = seen.times > seen.times[-1] - 0.05
    borne = seen.forces_o[last].sum(axis=1).mean(axis=0)
    assert borne == pytest.approx(MASS * (acceleration + [0, 0, G]), abs=1e-3 * MASS * G)
    tilted = simulate(replace(task, gravity_o=[0, 0, -G] - acceleration), servo=firm, **FREE)
    assert seen.normal_forces[-1] == pytest.approx(tilted.normal_forces[-1], rel=2e-3)


@pytest.mark.slow
def test_a_shaken_base_is_one_that_moves_so(task):
    times, shake = np.linspace(0, 0.8, 401), np.array([1.0, 0.5, 0.0])
    swing = np.sin(2 * np.pi * 3.0 * times)[:, None] * shake
    one = simulate(task, disturbance=Disturbance(shake=shake), **FREE)
    other = simulate(task, disturbance=Disturbance(base_motion=BaseMotion(times=times, accelerations=swing)), **FREE)
    # Linear between samples 2 ms apart: (2 pi 3 Hz 2 ms)^2 / 8 of it, but for the last moment.
    assert other.normal_forces == pytest.approx(one.normal_forces, abs=1e-3)
    both = Disturbance(shake=shake, base_motion=BaseMotion(times=times, accelerations=-swing))
    assert np.abs(both.acceleration(0.1)).max() < 1e-3


@pytest.mark.slow
def test_a_base_that_moves_along_a_path_adds_inertial_forces(task):
    """The fingers bear m (a - g); an undamped swing of the object on its contacts averages out over 0.1 s."""
    times = np.linspace(0.0, 0.8, 9)
    path = np.stack([0.02 * np.sin(np.pi * times / 0.8) ** 2, 0.0 * times, 0.015 * (times / 0.8) ** 3], axis=1)
    motion = BaseMotion.through(times, path)
    seen = simulate(task, disturbance=Disturbance(base_motion=motion), servo=Servo.of(task.hand, 2e5), **FREE)
    since, borne = seen.times - task.final_time, seen.forces_o.sum(axis=1)
    for start in np.arange(0.25, 0.65, 0.1):
        during = (since >= start) & (since < start + 0.1)
        felt = np.mean([motion.at(one) for one in since[during]], axis=0)
        expected = MASS * (felt + [0, 0, G])
        assert borne[during].mean(axis=0) == pytest.approx(expected, abs=3e-3 * MASS * G)
    assert np.ptp([motion.at(one) for one in times], axis=0).max() > 0.5  # and it is no small motion


def test_a_path_of_the_base_is_what_its_accelerations_make():
    times, path = np.array([0.1, 0.2, 0.4, 0.5]), np.array([[0, 0, 0], [1, 0, 2], [1, 3, 2], [2, 3, 0]])
    motion = BaseMotion.through(times, path)
    instants = np.linspace(0.1, 0.5, 40001)
    step, felt = instants[1] - instants[0], np.array([motion.at(one) for one in instants])
    speed = np.cumsum(0.5 * step * (felt[1:] + felt[:-1]), axis=0)
    assert speed[-1] == pytest.approx(np.zeros(3), abs=1e-6)  # at rest at the end, too
    for time, place in zip(times[1:], path[1:]):
        assert step * speed[instants[1:] <= time + 1e-9].sum(axis=0) == pytest.approx(place, abs=1e-2)


def test_a_base_rests_before_and_after_its_motion():
    motion = BaseMotion(times=[0.1, 0.2, 0.4], accelerations=[[1, 0, 0], [3, 0, -2], [0, 4, 0]])
    at = {0.0: [0, 0, 0], 0.1: [1, 0, 0], 0.15: [2, 0, -1], 0.3: [1.5, 2, -1], 0.4: [0, 4, 0], 0.41: [0, 0, 0]}
    for time, acceleration in at.items():
        assert motion.at(time) == pytest.approx(acceleration)
        assert Disturbance(base_motion=motion).acceleration(time) == pytest.approx(acceleration)


# -- why it was lost ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_motor_at_its_limit_is_a_cause(task):
    weak = replace(task, torque_limit=np.array([200.0, 1.2, 200.0]))
    verdict = simulate(weak, servo=Servo.of(task.hand, KP), **FREE).verdict
    assert not verdict.held
    assert verdict.causes[0].startswith("motor 'slide1' at its torque limit, 1.2 N, from ")
    assert any("effort limit of joint 'slide1'" in remedy for remedy in verdict.remedies)


@pytest.mark.parametrize(
    ("since", "until", "told"),
    [
        (0.35, 0.37, None),  # too short
        (0.1, 0.2, None),  # before the hand touches
        (0.3, 0.45, "from 0.300 to 0.450 s"),
        (0.5, 9.0, "from 0.500 s on"),
    ],
)
def test_a_motor_that_was_at_its_limit_for_a_while_is_a_cause(task, slippery, since, until, told):
    seen, torques = slippery, np.array(slippery.torques)
    torques[(seen.times > since - 1e-6) & (seen.times < until - 1e-3), 1] = -task.torque_limit[1]
    causes, _ = find_causes(task, replace(seen, torques=torques), Servo.of(task.hand), Disturbance(mu=0.2))
    motors = [cause for cause in causes if cause.startswith("motor")]
    expected = [] if told is None else [f"motor 'slide1' at its torque limit, 200 N, {told}"]
    assert [one.replace("0.448 s", "0.450 s") for one in motors] == expected


@pytest.mark.slow
def test_the_contact_that_slips_first_is_a_cause(task, undisturbed, slippery):
    verdict = slippery.verdict
    assert not verdict.held
    assert verdict.causes and all("slipped from" in cause for cause in verdict.causes)
    assert "mu=0.2," in verdict.remedies[0] and "Reserve" not in verdict.remedies[0]
    heavy = simulate(task, disturbance=Disturbance(mass_factor=8.0), **FREE).verdict
    assert f"mass={8 * task.body.mass:.3g} kg" in heavy.remedies[0]
    assert undisturbed.verdict.causes == undisturbed.verdict.remedies == ()


@pytest.mark.slow
def test_positions_alone_press_too_little(task):
    servo = Servo.of(task.hand, KP, control="position")
    verdict = simulate(task, servo=servo, **FREE).verdict
    assert not verdict.held
    assert any("% of the planned forces" in cause for cause in verdict.causes)
    assert "feed-forward" in verdict.remedies[0]
    beside = simulate(task, disturbance=Disturbance(object_offset=[0.0, 0.0, 0.2]), **FREE).verdict
    assert "never touched" in beside.causes[0]


@pytest.mark.slow
def test_dry_friction_asks_for_stiffer_servos(task):
    """Softer ones would lose more of the forces; with contacts of another stiffness they would lose less."""
    servo = Servo.of(task.hand, KP)
    rubbed = simulate(task, servo=servo, disturbance=Disturbance(joint_friction=1.5), **FREE).verdict
    assert not rubbed.held and rubbed.remedies[0].startswith("stiffer servos")
    assert not any(remedy.startswith("softer") for remedy in rubbed.remedies)
    soft = simulate(task, servo=servo, disturbance=Disturbance(stiffness=0.2), **FREE).verdict
    assert not soft.held and soft.remedies[0].startswith("softer servos")


@pytest.mark.slow
def test_a_hand_that_gives_way_without_a_slip_is_a_cause():
    """Torques alone keep nothing in place: the paper's fingers and their object fall over together."""
    plan = pg.load_case("paper").plan(progress=False)
    servo = Servo.of(plan.hand, control="torque")
    verdict = simulate(plan, servo=servo, hold=0.5, time_step=5e-4).verdict
    assert not verdict.held and len(verdict.causes) == 1
    assert " gave way, by more than 2 deg from 1." in verdict.causes[0]
    assert verdict.remedies == (
        "soft servos besides the torques, which keep the fingers in place: control='impedance'",
    )


@pytest.mark.slow
def test_motions_without_servos_have_no_motors_at_their_limits(task):
    weak = replace(task, torque_limit=np.full(3, 1e-3))
    verdict = simulate(weak, mode="prescribed", disturbance=Disturbance(mu=0.1), **FREE).verdict
    assert verdict.causes and not any("motor" in cause for cause in verdict.causes)


# -- what would have held ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_would_have_held_is_what_a_plan_with_it_holds(plan):
    """The jaws need k mu F_n = m g: with mu = 0.2 instead of 0.6, 3 / 1.5 times the squeeze, or the friction."""
    slippery, coarse = Disturbance(mu=0.2), {"hold": 0.6, "time_step": 1e-3}
    found = what_holds(plan, disturbance=slippery, **coarse)
    assert ("without mu", True) in found.changes
    for needed in (found.friction, found.squeeze):
        assert needed.lost < MU / 0.2 / SAFETY * 1.01 and needed.held == pytest.approx(MU / 0.2 / SAFETY, rel=0.05)
    assert found.mu == 0.2 and not found.weak
    told = found.describe()
    assert "without mu: held" in told and "2.00 times the squeeze (1.94 times: lost)" in told
    assert "mu = 0.4: held" in told and "own margins" not in told  # this plan has none
    json.dumps(found.summary(), allow_nan=False)


@pytest.mark.slow
def test_a_plan_with_the_squeeze_that_would_have_held_holds(plan):
    for factor, held in ((1.96, False), (2.04, True)):
        closure = pg.close_hand(plan.hand, plan.body, start=np.zeros(3), target=np.full(3, 0.05))
        firmer = pg.plan_grasp_on(plan.hand, closure, conditions(factor * SAFETY))
        assert simulate(firmer, disturbance=Disturbance(mu=0.2), **FREE).verdict.held == held


@pytest.mark.slow
def test_every_load_counts_in_the_squeeze(task):
    """A push of twice the weight needs as much as a mass of three times: 3 / 1.5 times the squeeze."""
    push = Push(wrench_o=[0, 0, -2 * MASS * G, 0, 0, 0], start=0.1, duration=0.4)
    motion = BaseMotion(times=[0.1, 0.2, 0.7], accelerations=[[0, 0, 0], [0, 0, 2 * G], [0, 0, 2 * G]])
    for wrong in (Disturbance(pushes=push), Disturbance(mass_factor=3.0), Disturbance(base_motion=motion)):
        found = what_holds(task, disturbance=wrong, hold=0.6, time_step=1e-3)
        assert found.squeeze.held == pytest.approx(2.0, rel=0.1)
        assert found.margins is None


@pytest.mark.slow
@pytest.mark.no_cover
def test_drives_and_limits_that_would_have_held(task):
    coarse = {"hold": 0.6, "time_step": 1e-3, "tolerance": 0.5}  # only the changes are looked at
    weak = replace(task, torque_limit=np.array([200.0, 1.2, 200.0]))
    found = what_holds(weak, servo=Servo.of(task.hand, KP), **coarse)
    assert dict(found.changes)["without torque limits"]
    assert "slide1" in found.weak
    alone = what_holds(task, servo=Servo.of(task.hand, KP, control="position"), **coarse)
    assert dict(alone.changes)["the plan's torques as feed-forward, control='impedance'"]
    slack = Servo.of(task.hand, control="torque")
    limp = what_holds(task, servo=slack, disturbance=Disturbance(servo_gain=0.5), **coarse)
    assert dict(limp.changes) == {
        "without servo_gain": True,
        "the default servos besides the torques, control='impedance'": True,
    }
    beside = what_holds(task, disturbance=Disturbance(object_offset=[0.0, 0.0, 0.2]), **coarse)
    assert dict(beside.changes)["without object_offset"] and beside.friction.held is None
    assert "more friction: lost" in beside.describe() and "more squeeze: lost" in beside.describe()
    exact = what_holds(task, mode="prescribed", disturbance=Disturbance(mu=0.1), **coarse)
    assert list(dict(exact.changes)) == ["without mu"]


@pytest.mark.slow
def test_what_holds_takes_plans_that_are_lost(task):
    with pytest.raises(InvalidInput, match="expected a plan that is lost"):
        what_holds(task, **FREE)
    with pytest.raises(InvalidInput, match="tolerance"):
        what_holds(task, disturbance=Disturbance(mu=0.2), tolerance=0.0)


@pytest.mark.slow
def test_trials_that_are_lost_say_why(task):
    off = dict.fromkeys(("position", "rotation", "mass", "posture", "push"), 0.0)
    errors = Errors(**off, friction=(0.1, 0.2))
    study = monte_carlo(task, count=1, errors=errors, jobs=1, progress=False, hold=0.3, time_step=1e-3)
    assert all("; contact 'jaw" in row["reason"] and "slipped from" in row["reason"] for row in study.rows)


@pytest.mark.slow
def test_causes_are_in_records_reports_and_on_the_command_line(command, plan, tmp_path):
    folder = pg.save_run(plan, tmp_path / "run")
    code, out, _ = command("check", str(folder), "--hold", "0.3", "--time-step", "1e-3", "--mu", "0.2", "--what-holds")
    assert code == 3 and "Why?" in out and "contact '" in out and "mu=0.2, not " in " ".join(out.split())
    assert "each change alone" in out
    told = (folder / "check" / "check.md").read_text(encoding="utf-8")
    assert "what would have held" in told
    assert json.loads((folder / "check" / "check.json").read_text())["what_holds"]["changes"]["without mu"]
    code, out, _ = command("check", str(folder), "--hold", "0.3", "--mu", "0.2")
    assert code == 3 and "each change alone" not in out
    assert "**Why lost?**" in told and "**What helps?**" in told and "slipped from" in told
    kept = read_check(folder / "check")
    assert kept.verdict.causes and kept.verdict.remedies and kept.servo["control"] == "impedance"
    assert command("report", str(folder))[0] == 0
    assert "Why lost?" in (folder / "report.md").read_text(encoding="utf-8")


# -- random errors -----------------------------------------------------------------------------------------------------


def test_random_errors_of_old_seeds_stay(task):
    """As they were before there were errors of drives and contacts."""
    drives = {"stiffness": (0.2, 20.0), "joint_offset": 0.01, "joint_friction": 0.1, "servo_gain": 0.2}
    for errors in (Errors(), Errors(**drives)):
        drawn = draw_errors(task, errors, 3, "together", 7).values
        assert drawn["position"] == pytest.approx([-0.0002141587276928946, 0.0023003047648119906, 0.004053651291638904])
        assert drawn["mass"] == pytest.approx(1.1082069071742164)
        assert drawn["friction"] == pytest.approx(1.0556739535822794)
        assert draw_errors(task, errors, 3, "mass", 7).values["mass"] == pytest.approx(1.1892693244953618)
    assert Errors().kinds == ("position", "rotation", "friction", "mass", "posture", "push")
    assert tuple(Errors().summary()) == Errors().kinds


@pytest.mark.slow
def test_random_drives_and_contacts_have_the_sizes_asked_for(task):
    errors = Errors(stiffness=(0.2, 20.0), joint_offset=0.01, joint_friction=0.1, servo_gain=0.2)
    draws = [draw_errors(task, errors, 1, "together", i) for i in range(1000)]
    values = {kind: np.array([one.values[kind] for one in draws]) for kind in errors.kinds[6:]}
    logs = np.log(values["stiffness"])
    assert math.log(0.2) <= logs.min() and logs.max() <= math.log(20)
    assert (logs.mean(), logs.std()) == pytest.approx((math.log(2), math.log(100) / math.sqrt(12)), abs=0.13)
    assert values["joint_offset"].std(axis=0) == pytest.approx([0.01 * 0.03] * 3, rel=0.07)  # the jaws slide
    assert values["joint_friction"].mean(axis=0) == pytest.approx([0.05 / 0.03] * 3, rel=0.07)
    assert (values["servo_gain"].mean(), values["servo_gain"].std()) == pytest.approx((1, 0.2), rel=0.07)
    _, disturbance, _ = draws[0]
    assert disturbance.summary()["joint_offset"] == values["joint_offset"][0].tolist()
    alone = [draw_errors(task, errors, 1, "stiffness", i).values["stiffness"] for i in range(5)]
    assert not np.isin(alone, values["stiffness"]).any()


@pytest.mark.slow
def test_a_study_of_drives_and_contacts(task):
    off = dict.fromkeys(("position", "rotation", "friction", "mass", "posture", "push"), 0.0)
    errors = Errors(**off, stiffness=(0.5, 2.0), joint_friction=1e-3)
    study = monte_carlo(task, count=1, errors=errors, jobs=1, progress=False, hold=0.3, time_step=1e-3)
    assert list(study.held) == ["stiffness", "joint_friction", "together"]
    assert "0.5 to 2 times the contacts' K" in study.describe() and "up to 0.001 N m" in study.describe()
    json.dumps(study.summary(), allow_nan=False)


# -- commands, errors --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_takes_control_and_errors_of_drives(command, plan, tmp_path, no_rendering):
    folder = pg.save_run(plan, tmp_path / "run")
    (tmp_path / "base.csv").write_text("0,0.1,0,0\n0.1,0,0,0.2\n", encoding="utf-8")
    options = (
        f"--control position --kp 40 --stiffness 2 --joint-friction 0.1,0,0.2 --joint-offset 0.01 --servo-gain 1.1 "
        f"--base-motion {tmp_path / 'base.csv'} --hold 0.02 --time-step 1e-3 --json"
    )
    code, out, _ = command("check", str(folder), *options.split())
    assert code in (0, 3)
    told = json.loads(out)
    assert told["servo"] == {"control": "position", "stiffness": 4e4}  # N/mm, the jaws slide
    assert told["disturbance"] == {
        "base_motion": {"times_s": [0.0, 0.1], "m_s2": [[0.1, 0.0, 0.0], [0.0, 0.0, 0.2]]},
        "stiffness": 2.0,
        "servo_gain": 1.1,
        "joint_offset": pytest.approx([1e-5] * 3),
        "joint_friction": [0.1, 0.0, 0.2],
    }
    path = ("--base-path", str(tmp_path / "base.csv"), "--hold", "0.05", "--time-step", "1e-3")
    code, out, _ = command("check", str(folder), *path, "--json")
    motion = BaseMotion.through([0.0, 0.1], [[0.1, 0, 0], [0, 0, 0.2]])
    assert json.loads(out)["disturbance"]["base_motion"]["m_s2"] == motion.accelerations.tolist()
    errors = ("--errors", "stiffness=0.5:2,joint_offset=0.001,position=0,push=0,mass=0,posture=0,rotation=0,friction=0")
    study = ("--monte-carlo", "1", "--hold", "0.3", "--time-step", "1e-3", *errors, "--json")
    code, out, _ = command("check", str(folder), *study)
    assert list(json.loads(out)["monte_carlo"]["held"]) == ["stiffness", "joint_offset", "together"]
    for wrong in (
        ("--base-path", str(tmp_path / "base.csv"), "--base-motion", str(tmp_path / "base.csv")),
        ("--errors", "mass=0.1"),
        ("--monte-carlo", "1", "--errors", "weight=0.1"),
        ("--monte-carlo", "1", "--errors", "mass=0.1,mass=0.2"),
        ("--monte-carlo", "1", "--errors", "stiffness=2"),
        ("--monte-carlo", "1", "--errors", "mass="),
        ("--control", "speed"),
        ("--control", "torque", "--kp", "5"),
        ("--kp", "0"),
        ("--kp", "1,2"),
        ("--prescribed", "--control", "torque"),
        ("--stiffness", "0"),
        ("--joint-friction", "-1"),
        ("--base-motion", str(tmp_path / "none.csv")),
        ("--base-motion", str(folder / "plan.json")),
        ("--servo-gain", "0"),
    ):
        code, _, err = command("check", str(folder), *wrong)
        assert code == 2 and "expected" in err, wrong


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mode": "sideways"}, "mode: expected one of"),
        ({"hold": -1.0}, "hold: expected"),
        ({"hold": 0.0}, "hold: expected at least one step"),
        ({"hold": 1e308}, "hold, time step: expected at most 2000000 steps"),
        ({"time_step": 0.0}, "time step: expected"),
        ({"time_step": 1e-320}, "hold, time step: expected at most 2000000 steps"),
        ({"time_step": 0.2}, r"time step: expected at most 0.04 s"),
        ({"letting_go": np.nan}, "letting go: expected"),
        ({"sample": 0.7}, "sample: expected at most"),
        ({"disturbance": {"mu": 0.1}}, "disturbance: expected a Disturbance"),
        ({"servo": 3}, "servo: expected a Servo"),
        ({"mode": "prescribed", "disturbance": Disturbance(start_error=np.zeros(3))}, "start error"),
        ({"disturbance": Disturbance(joint_offset=[0.1, 0.2])}, r"joint offset: expected shape \(3,\), got \(2,\)"),
        ({"disturbance": Disturbance(joint_friction=np.ones(5))}, r"joint friction: expected shape \(3,\), got \(5,\)"),
        ({"mode": "prescribed", "disturbance": Disturbance(joint_offset=0.1)}, "joint offset: expected only with"),
        ({"mode": "prescribed", "disturbance": Disturbance(joint_friction=0.1)}, "joint friction: expected only with"),
        ({"mode": "prescribed", "disturbance": Disturbance(servo_gain=2.0)}, "servo gain: expected only with"),
        (
            {"disturbance": Disturbance(base_motion=BaseMotion(times=[0, 9], accelerations=np.ones((2, 3))))},
            "motion to end within 1.2 s of t_F .*, got 9 s: hold for longer",
        ),
        (
            {
                "release": False,
                "disturbance": Disturbance(base_motion=BaseMotion(times=[0, 0.1], accelerations=np.ones((2, 3)))),
            },
            "base motion: expected with release=True",
        ),
    ],
)
def test_unusable_settings_are_refused(task, settings, message):
    with pytest.raises(InvalidInput, match=message):
        simulate(task, **settings)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Push(wrench_o=[1, 2, 3]), "expected"),
        (lambda: Push(wrench_o=np.zeros(6), duration=0.0), "expected"),
        (lambda: Disturbance(mu=-0.1), "expected"),
        (lambda: Disturbance(mu=1e308), "expected"),
        (lambda: Disturbance(mass_factor=0.0), "expected"),
        (lambda: Disturbance(shake=[1, np.nan, 0]), "expected"),
        (lambda: Disturbance(pushes=(1,)), "expected"),
        (lambda: Disturbance(stiffness=0.0), "stiffness factor: expected"),
        (lambda: Disturbance(stiffness=1e6), "stiffness factor: expected"),
        (lambda: Disturbance(servo_gain=-1.0), "servo gain: expected"),
        (lambda: Disturbance(joint_friction=-0.1), "joint friction .*: expected values >= 0"),
        (lambda: Disturbance(joint_friction="much"), "joint friction .*: expected numbers"),
        (lambda: Disturbance(joint_offset=math.nan), "joint offset .*: expected"),
        (lambda: Disturbance(joint_offset=[[0.1]]), "joint offset .*: expected shape"),
        (lambda: Disturbance(base_motion=[[0, 0, 0]]), "base motion: expected a BaseMotion"),
        (lambda: BaseMotion(times=[0.0], accelerations=[[0, 0, 0]]), "expected two or more that grow"),
        (lambda: BaseMotion(times=[0.2, 0.1], accelerations=np.zeros((2, 3))), "expected two or more that grow"),
        (lambda: BaseMotion(times=[-1, 1], accelerations=np.zeros((2, 3))), "expected two or more that grow"),
        (lambda: BaseMotion(times=[0, 1], accelerations=np.zeros((3, 3))), r"expected shape \(2, 3\), got \(3, 3\)"),
        (lambda: BaseMotion.through([0, 1], np.zeros((3, 3))), r"positions of the base .*expected shape \(2, 3\)"),
        (lambda: BaseMotion.through([0, 1e-300], [[0, 0, 0], [1, 0, 0]]), "accelerations"),
        (lambda: BaseMotion.through([0, 1], [[0, 0, 0], [1e308, 0, 0]]), "accelerations"),
        (lambda: Servo.of(one_joint(SHAPES["sphere"]), 5.0, control="torque"), "expected none with control='torque'"),
        (lambda: Servo.of(one_joint(SHAPES["sphere"]), control="speed"), "servo control: expected one of"),
        (lambda: Servo.of(one_joint(SHAPES["sphere"]), 0.0), "servo stiffness: expected values > 0"),
        (
            lambda: Servo(stiffness=np.ones(1), damping=np.ones(1), rotor=np.zeros(1), control="torque"),
            "servo stiffness: expected 0 with control='torque'",
        ),
        (lambda: Servo(stiffness=np.zeros(1), damping=np.ones(1), rotor=np.zeros(1)), "expected values > 0"),
        (lambda: Errors(stiffness=20.0), "error of stiffness: expected a pair of factors, or 0"),
        (lambda: Errors(stiffness=(20.0, 0.2)), "error of stiffness: expected 0 < lowest factor <= highest"),
        (lambda: Errors(stiffness=(0.0, 1.0)), "stiffness factor: expected"),
        (lambda: Errors(joint_offset=(0.1, 0.2)), "error of joint_offset"),
    ],
)
def test_unusable_drives_and_contacts_are_refused(make, message):
    with pytest.raises(InvalidInput, match=message):
        make()
