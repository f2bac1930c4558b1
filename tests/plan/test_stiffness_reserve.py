"""Squeezes that hold on contacts softer and stiffer than assumed, with the servos that the hand has."""

from __future__ import annotations

import secrets
from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.cases.object_case import ObjectCase
from pinograsp.errors import GraspUndecided, InvalidInput, Status
from pinograsp.forces import disturbance_margin
from pinograsp.planner import load_run, save_run
from pinograsp.planner.compliance import find_scenarios
from pinograsp.report import list_results
from pinograsp.simulation import Disturbance, Servo

FACTORS = [0.2, 1.0, 5.0]
RESERVE = pg.Reserve(softer=5.0, stiffer=5.0)


def planned(gain, reserve):
    """An Allegro hand with servos of this gain [N m/rad] around a ball."""
    closure = ObjectCase.of(
        hand="allegro_right", object="sphere:radius=0.035,mass=0.1", at=(0.06, 0.0, 0.06), wrap=True
    ).closure()
    servos = [replace(drive, control="position", stiffness=gain) for drive in closure.hand.drives]
    closure = replace(closure, hand=closure.hand.with_drives(servos))
    return pg.plan_grasp_on(closure.hand, closure, pg.GraspConditions(mu=0.7, reserve=reserve))


@pytest.fixture(scope="module")
def bare():
    return planned(10.0, pg.Reserve())


@pytest.fixture(scope="module")
def plan():
    return planned(10.0, RESERVE)


def least_margin(plan, normal_forces):
    """The push that these normal forces withstand in six directions, as share of the reserve's."""
    problem = replace(plan.solution.problem, torques=None, min_normal_force=None)
    push = plan.reserve.force * np.hstack([np.vstack([np.eye(3), -np.eye(3)]), np.zeros((6, 3))])
    return min(disturbance_margin(problem, one, normal_forces=normal_forces, reaction="elastic") for one in push)


@pytest.mark.slow
def test_the_reserve_is_borne_at_both_ends(bare, plan):
    """On softer contacts the default squeeze lacks its reserve; that which is planned for them has it."""
    assert plan.status is Status.OK and plan.forces.certificate.relative_gap <= 1e-6
    ours, default = (one.force_band(factors=FACTORS).normal_forces for one in (plan, bare))
    assert [least_margin(bare, forces) > 0.99 for forces in default] == [False, True, True]
    assert all(least_margin(plan, forces) > 0.98 for forces in ours)
    assert plan.forces.normal_forces.sum() > 1.2 * bare.forces.normal_forces.sum()


@pytest.mark.slow
def test_it_is_kept_and_shown(plan, tmp_path):
    assert "contacts 5 times as soft, contacts 5 times as stiff" in str(dict(list_results(plan.with_margins())))
    kept = load_run(save_run(plan, tmp_path / "run")).reserve
    assert (kept.softer, kept.stiffer) == (5.0, 5.0)
    assert (
        ObjectCase.of(hand="allegro_right", object="sphere:radius=0.03,mass=0.1", reserve="softer=5").reserve.softer
        == 5.0
    )
    for wrong in ({"softer": 0.5}, {"stiffer": 0.0}, {"softer": np.nan}):
        with pytest.raises(InvalidInput, match="reserve: "):
            pg.Reserve(**wrong)


@pytest.mark.slow
def test_torque_control_needs_no_more_on_other_contacts():
    """Torques give the planned forces on contacts of any stiffness."""
    bare, plan = (planned(1e-3, reserve) for reserve in (pg.Reserve(), RESERVE))
    assert plan.forces.normal_forces == pytest.approx(bare.forces.normal_forces, rel=0.01)


@pytest.mark.slow
def test_drives_that_are_weaker_or_stronger(bare, tmp_path):
    """What comes in the simulation is what the plan reckons with, whichever drives are off, and it is held."""
    plan = planned(10.0, pg.Reserve(drive=0.3))
    assert plan.status is Status.OK and plan.forces.certificate.relative_gap <= 1e-6
    assert 1.05 < plan.forces.normal_forces.sum() / bare.forces.normal_forces.sum() < 1 / 0.7
    assert "drives 30 % weaker or stronger" in str(dict(list_results(plan.with_margins())))
    assert load_run(save_run(plan, tmp_path / "run")).reserve.drive == 0.3
    told = find_scenarios(plan.hand, plan.solution, plan.motion.q[-1], pg.Reserve(drive=0.3))
    forces = plan.forces.forces_c
    reckoned = [one.normal @ forces[:, 2] + one.tangential @ forces[:, :2].ravel() + one.offset for one in told[:2]]
    assert all(least_margin(plan, one) > 0.98 for one in reckoned)
    servo = Servo.of(plan.hand, 10.0)
    own = np.random.default_rng(secrets.randbelow(2**32)).uniform(0.7, 1.3, plan.hand.n)
    for gain, expected in ((0.7, reckoned[0]), (1.3, reckoned[1]), (own, None)):
        seen = pg.simulate(plan, servo=servo, support="fixed", disturbance=Disturbance(drive_gain=gain))
        assert seen.verdict.held
        if expected is not None:
            order = [seen.parts.index(name) for name in plan.contacts.names]
            assert seen.normal_forces[-1][order] == pytest.approx(expected, rel=0.1, abs=0.05 * expected.max())


@pytest.mark.slow
def test_stiffness_that_no_squeeze_bears_is_told(monkeypatch):
    # What would do is looked for until it is found, also on slow machines.
    monkeypatch.setattr("pinograsp.planner.refusals._PATIENCE", np.inf)
    with pytest.raises(GraspUndecided, match="servos of 500 to 500 N m/rad") as refused:
        planned(500.0, pg.Reserve(softer=1.0, stiffer=1000.0))
    assert "Reserve(stiffer=" in str(refused.value)


@pytest.mark.slow
def test_simulated_on_softer_contacts(plan):
    servo = Servo.of(plan.hand, 10.0)
    seen = pg.simulate(plan, servo=servo, support="fixed", disturbance=Disturbance(stiffness=0.2))
    order = [seen.parts.index(name) for name in plan.contacts.names]
    told = plan.force_band(factors=[0.2]).normal_forces[0]
    assert seen.verdict.held
    assert seen.normal_forces[-1][order] == pytest.approx(told, rel=0.15, abs=0.05 * told.max())


@pytest.mark.slow
def test_jaws_press_with_what_their_drive_makes():
    """An effort, wherever they come to: 0.7 of it is to be what the squeeze would be without doubt about the drive."""
    hand, ball, conditions = pg.load_hand("panda"), pg.Sphere(radius=0.03, mass=0.1), pg.GraspConditions(mu=0.6)
    found = pg.find_grasps(hand, ball, conditions, count=16, seed=3, jobs=1, progress=False)
    sure, plain = (
        pg.plan_best(found, replace(conditions, reserve=one)) for one in (pg.Reserve(drive=0.3), pg.Reserve())
    )
    ratio = sure.forces.normal_forces.sum() / plain.forces.normal_forces.sum()
    assert ratio == pytest.approx(1 / 0.7, rel=0.02)
    for gain in (0.7, 1.3):
        error = Disturbance(drive_gain=gain, stiffness=0.3, mu=0.5)
        assert pg.simulate(sure, disturbance=error, hold=0.3, support="fixed").verdict.held


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [0.3, 20.0])
def test_jaws_press_as_planned_on_other_contacts(stiffness):
    """From t_I on they close on until they press with the plan's effort; overshoot and gears leave a little more."""
    box, conditions = pg.Box(size=(0.05, 0.05, 0.12), mass=0.3), pg.GraspConditions(mu=0.6)
    found = pg.find_grasps(pg.load_hand("panda"), box, conditions, count=16, seed=4, jobs=1, progress=False)
    plan = pg.plan_best(found, conditions)
    other = pg.simulate(plan, disturbance=Disturbance(stiffness=stiffness), support="fixed", hold=0.3)
    ratio = other.normal_forces[-1].sum() / plan.forces.normal_forces.sum()
    assert other.verdict.held and 0.97 < ratio < 1.15
    stiff = Servo.of(plan.hand)
    position = pg.simulate(plan, servo=stiff, disturbance=Disturbance(stiffness=stiffness), support="fixed", hold=0.3)
    assert not 0.5 < position.normal_forces[-1].sum() / plan.forces.normal_forces.sum() < 2.0
