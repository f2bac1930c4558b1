"""What servos that give way make of a plan: stable or not, forces on other contacts, against simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.hands import servo_gains
from pinograsp.planner.compliance import instability
from pinograsp.simulation import Disturbance, Servo


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper", {"forces.search": "convex"}).plan()


def test_stiff_servos_keep_the_object_and_soft_ones_let_it_tip(plan):
    solution, q = plan.solution, plan.motion.q[-1]
    assert not [caution for caution in plan.cautions if "unstable" in caution]
    assert instability(plan.hand, solution, q, servo_gains(plan.hand)) is None
    told = instability(plan.hand, solution, q, servo_gains(plan.hand, 0.2))
    assert told is not None and told.startswith("the equilibrium is unstable: with servos of 0.2 N m/rad the object ")
    margins = [plan.object_stiffness(servo).margin for servo in (1.0, 5.0, 50.0, 1e6)]
    assert margins == sorted(margins)


def test_servos_of_ones_own_are_taken_and_soft_ones_told(plan):
    """Gains that a hand's drives have, at a joint of its own with the arm squared; those of others are the usual ones."""
    hand = plan.hand
    first, *others = hand.drives
    soft = hand.with_drives([replace(first, arms=(2.0,), control="position", stiffness=0.75), *others])
    assert soft.servo_stiffness[0] == 3.0 and np.isnan(soft.servo_stiffness[1:]).all()
    for gains in (servo_gains(soft), Servo.of(soft).stiffness):
        assert gains[0] == 3.0 and np.all(gains[1:] == servo_gains(hand)[1:])
    solution, q = plan.solution, plan.motion.q[-1]
    gains = servo_gains(hand, 2.0)
    told = instability(hand, solution, q, gains, push=5.0)
    away = 5.0 * np.linalg.norm(np.linalg.inv(plan.object_stiffness(2.0).matrix)[:3, :3], 2)
    assert plan.object_stiffness(2.0).is_stable() and f"gives way by {1e3 * away:.2g} mm" in told
    assert instability(hand, solution, q, gains, push=1e-3) is None


@pytest.mark.slow
@pytest.mark.parametrize(("servo", "holds"), [(0.2, False), (10.0, True)])
def test_simulations_agree_on_what_is_stable(plan, servo, holds):
    seen = pg.simulate(plan, hold=2.0, servo=Servo.of(plan.hand, stiffness=servo))
    assert seen.verdict.held is holds
    assert plan.object_stiffness(servo).is_stable() is holds


@pytest.mark.slow
def test_bands_of_a_plan(plan):
    """The planned forces on contacts as planned; on harder ones the more, the stiffer the servos; not with torques."""
    planned = plan.forces.normal_forces
    soft, stiff, limp = (plan.force_band(servo, [0.5, 1.0, 5.0]) for servo in (5.0, 50.0, 0.0))
    assert soft.normal_forces[1] == pytest.approx(planned, rel=1e-6)
    assert np.all(stiff.highest > soft.highest) and np.all(soft.highest > planned)
    assert limp.normal_forces == pytest.approx(np.tile(planned, (3, 1)), rel=1e-6)
    within = plan.gains_within(0.2, [0.5, 1.0, 5.0])
    assert within.band.deviation <= 0.2 < stiff.deviation
    for bad in (-1.0, np.nan, [1.0, 2.0]):
        with pytest.raises(InvalidInput, match="servo stiffness"):
            plan.force_band(bad)


@pytest.mark.slow
def test_harder_contacts_press_as_the_band_says(plan):
    band = plan.force_band(5.0, [5.0])
    seen = pg.simulate(plan, servo=Servo.of(plan.hand, stiffness=5.0), disturbance=Disturbance(stiffness=5.0))
    order = [seen.parts.index(name) for name in plan.problem.contacts.names]
    assert seen.verdict.held
    assert seen.normal_forces[-1][order] == pytest.approx(band.normal_forces[0], rel=0.15)
