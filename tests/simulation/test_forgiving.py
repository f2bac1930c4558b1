"""Objects that are not where the plan has them: servos that forgive while the hand closes, and what supports them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.hands import servo_gains
from pinograsp.simulation import Disturbance, Servo, simulate

AWAY, COARSE = 5e-3, 5e-4  # [m], [s]


@pytest.fixture(scope="module")
def standing():
    """A ball on a table in an Allegro hand."""
    hand, conditions = pg.load_hand("allegro_right"), pg.GraspConditions(mu=0.6, table=True)
    ball = pg.Sphere(radius=0.0375, mass=0.18)
    found = pg.find_grasps(hand, ball, conditions, count=16, seed=4, jobs=1, progress=False)
    return pg.plan_best(found, conditions)


@pytest.mark.slow
def test_an_error_takes_a_share_of_the_force_or_adds_it(standing):
    """A joint held off by 5 mm at 6 cm or more is off by 0.08 rad: half of its torque, where a stiff servo's is used up.

    Friction, which holds the fixed object, takes or gives as much again.
    """
    rng = np.random.default_rng()
    changed = {"soft": [], "stiff": []}
    for direction in rng.normal(size=(4, 3)):
        error = Disturbance(object_offset=AWAY * direction / np.linalg.norm(direction))
        for name, servo in (("soft", None), ("stiff", Servo.of(standing.hand))):
            seen = simulate(standing, release=False, hold=0.0, servo=servo, disturbance=error, time_step=COARSE)
            complete = np.searchsorted(seen.times, standing.forces.final_time - 1e-9)
            planned = seen.planned_forces > 0  # other links may touch a misplaced object, too
            share = seen.normal_forces[complete, planned] / seen.planned_forces[planned]
            changed[name].append(np.abs(share - 1.0).max())
    assert max(changed["soft"]) < 2.0
    assert np.median(changed["stiff"]) > 2.0 * np.median(changed["soft"])


def test_gains_are_the_torques_over_what_is_forgiven(standing):
    hand, motion = standing.hand, standing.motion
    gains, own = motion.closing_stiffness, servo_gains(hand)
    assert np.all(gains <= own) and np.all(gains > 0)
    assert gains.max() > 2 * gains.min()  # not one gain for all
    bearing = np.abs(motion.holding_torques) > 0.1
    assert gains[bearing] * 0.15 == pytest.approx(np.abs(motion.holding_torques[bearing]), rel=0.7)  # gravity besides


@pytest.mark.parametrize("stiffness", [10.0, None])
def test_motors_that_take_positions_keep_the_gains_that_are_told(standing, stiffness):
    drives = [replace(drive, control="position", stiffness=stiffness) for drive in standing.hand.drives]
    hand = standing.hand.with_drives(drives)
    plan = pg.plan_grasp_on(hand, replace(standing.closure, hand=hand), standing.conditions)
    if stiffness is None:
        assert plan.motion.closing_stiffness == pytest.approx(standing.motion.closing_stiffness, rel=0.2)
    else:
        assert plan.motion.closing_stiffness is None


def test_jaws_that_slide_stay_as_they_are():
    jaws, conditions = pg.load_hand("panda"), pg.GraspConditions(mu=0.6)
    box = pg.Box(size=(0.03, 0.03, 0.05), mass=0.05)
    plan = pg.plan_best(pg.find_grasps(jaws, box, conditions, count=16, seed=0, jobs=1, progress=False), conditions)
    assert plan.motion.closing_stiffness is None


def test_joints_are_held_where_they_are(standing):
    """A tenth of a second after t_F, wherever the object is: from then on they move no more than stiff servos let them."""
    error = Disturbance(object_offset=[0.0, AWAY, 0.0])
    seen = simulate(standing, disturbance=error, hold=0.5, support="fixed", time_step=COARSE)
    assert seen.verdict.held
    after = seen.times > standing.forces.final_time + 0.11
    assert np.ptp(seen.q[after], axis=0).max() < 0.01
    stiff = simulate(
        standing, disturbance=error, hold=0.5, support="fixed", time_step=COARSE, servo=Servo.of(standing.hand)
    )
    # Stiff servos bring the joints to where they are commanded, 5 mm off the plan or not.
    there, commanded = (np.abs(one.q[after][-1] - standing.motion.q[-1]).max() for one in (seen, stiff))
    assert there > 3.0 * commanded
    assert np.ptp(seen.torques[after][-1] - standing.motion.holding_torques) < 0.5


@pytest.mark.slow
def test_the_plan_knows_its_table(standing):
    """What the plan stands on is what supports the object, unless another support is asked for."""
    settings = {"hold": 0.1, "time_step": COARSE}
    floating = pg.plan_grasp_on(standing.hand, standing.closure, pg.GraspConditions(mu=0.6))
    assert standing.on_table and not floating.on_table
    own, table, fixed = (
        simulate(standing, **settings, **given) for given in ({}, {"support": "table"}, {"support": "fixed"})
    )
    assert np.array_equal(own.normal_forces, table.normal_forces)
    assert not np.array_equal(own.object_poses, fixed.object_poses)
    assert simulate(standing, release=False, **settings).verdict.held


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, [1.0, 2.0]])
def test_gains_that_cannot_be(standing, wrong):
    servo = Servo.of(standing.hand)
    closing = wrong if isinstance(wrong, list) else np.full(standing.hand.n, wrong)
    with pytest.raises(InvalidInput, match="while closing"):
        Servo(stiffness=servo.stiffness, damping=servo.damping, rotor=servo.rotor, closing=closing)


def test_torque_control_has_none(standing):
    limp = Servo.of(standing.hand, control="torque")
    with pytest.raises(InvalidInput, match="none with control='torque'"):
        Servo(
            stiffness=limp.stiffness,
            damping=limp.damping,
            rotor=limp.rotor,
            control="torque",
            closing=np.ones(standing.hand.n),
        )
