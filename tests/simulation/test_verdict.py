"""The verdict of the simulation on motions of the object that are written down here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.objects import Box
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Servo, simulate
from pinograsp.simulation.options import SimulationOptions
from pinograsp.simulation.task import Task
from pinograsp.simulation.verdict import Expected, judge

SURFACE = {"forces.search": "convex", "forces.balance": "wrench", "friction.safety": 1.1, "motion.touch": "surface"}


@pytest.fixture(scope="module")
def judged():
    """The verdict on a held object that moves as told after its release: x [m] of the time since then [s]."""
    plan = pg.load_case("paper", SURFACE).plan()
    task, seen = Task.of(plan), simulate(plan, hold=1.0, time_step=1e-3)
    expected = Expected(np.zeros(len(seen.parts)), task.settled_forces)

    def verdict(course, shaken):
        poses = np.array(seen.object_poses)
        since = np.maximum(seen.times - plan.forces.final_time, 0.0)
        poses[:] = poses[seen.complete]
        poses[:, 0, 3] += course(since)
        moved = replace(seen, object_poses=poses)
        swing = Disturbance() if shaken is None else Disturbance(shake=[1.0, 0, 0], shake_frequency=1 / shaken)
        options = SimulationOptions(disturbance=swing)
        return judge(task, moved, expected, plan.forces.final_time, gone=False, options=options)

    return verdict


@pytest.mark.parametrize("frequency", [2.0, 7.0, 30.0])
def test_swaying_with_the_hand_is_no_creep(judged, frequency):
    def sway(t):
        return 2e-3 * np.sin(2 * np.pi * frequency * t)

    assert judged(sway, 1 / frequency).held
    still = judged(sway, None)
    assert not still.held and ("creeps" in still.reason or "swings" in still.reason)
    for shaken in (None, 1 / frequency):
        crept = judged(lambda t: sway(t) / 4 + 3e-3 * t, shaken)
        assert not crept.held and "creeps" in crept.reason


def test_a_small_swing_about_a_place_is_told_and_held(judged):
    seen = judged(lambda t: 4e-4 * np.sin(2 * np.pi * 33.0 * t), None)
    assert seen.held and "swinging by 0.8" in seen.reason
    assert not judged(lambda t: 4e-4 * np.sin(2 * np.pi * 33.0 * t) + 4e-3 * t, None).held


@pytest.mark.parametrize("cycles", [0.9, 1.0, 1.4, 2.3, 6.0])
@pytest.mark.parametrize("phase", np.linspace(0.0, 2 * np.pi, 6, endpoint=False))
def test_a_swing_is_no_creep_whatever_its_period_and_phase(judged, cycles, phase):
    """A bottle that jaws hold by its neck swings for seconds; so many cycles of that are in the last fifth."""

    def swing(t):
        return 8e-4 * np.exp(-0.1 * t) * np.sin(2 * np.pi * cycles * t / 0.2 + phase)

    assert judged(swing, None).held
    crept = judged(lambda t: swing(t) + 3e-3 * t, None)
    assert not crept.held and "creeps" in crept.reason


@pytest.mark.parametrize("decay", [0.3, 1.0, 3.0])
def test_a_creep_that_slows_down_is_no_swing(judged, decay):
    """It goes by 0.8 mm in the last fifth."""
    size = 8e-4 / (np.exp(-0.8 * decay) - np.exp(-decay))
    seen = judged(lambda t: size * (1.0 - np.exp(-decay * t)), None)
    assert not seen.held


def test_of_a_slow_shaking_the_end_counts(judged):
    assert not judged(lambda t: 4e-3 * t, 5.0).held
    assert judged(lambda t: 4e-3 * np.minimum(t, 0.5), 5.0).held
    assert not judged(lambda t: 12e-3 * np.minimum(t, 0.5), 5.0).held


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1e-3, 1e-2])
def test_light_objects_get_steps_that_resolve_their_swings(mass):
    """Coarse steps alone threw an object of a gram out of a grasp that holds it."""
    body = Box(size=(0.04, 0.03, 0.05), mass=mass, pose=pin.SE3(np.eye(3), np.array([0, 0, 0.11])).homogeneous)
    plan = pg.plan_grasp_on(pg.load_hand("panda"), body, pg.GraspConditions(mu=0.6))
    seen = simulate(plan, hold=0.3, time_step=1e-3)
    swings = np.sqrt(2 * 2e4 / mass)  # [rad/s] on the tangential springs of two contacts
    assert seen.verdict.held and seen.time_step * swings < 0.7
    assert any("a light object swings fast" in note for note in seen.notes)
    fixed = simulate(plan, hold=0.1, time_step=1e-3, release=False)
    assert fixed.time_step == 1e-3 and not any("light" in note for note in fixed.notes)


@pytest.mark.slow
def test_what_the_plan_foresees_after_letting_go_is_compared_too():
    """Friction that builds up while coupled fingers press changes the forces; the plan says by how much."""
    hand, conditions = pg.load_hand("psyonic_left"), pg.GraspConditions(mu=0.6)
    body = pg.Cylinder(radius=0.024, height=0.12, mass=0.06)
    plan = plan_best(pg.find_grasps(hand, body, conditions, count=8, seed=3, jobs=1, progress=False), conditions)
    # What is foreseen is of servos as stiff as they are, and an object that is fixed until t_F.
    simulation = simulate(plan, hold=0.6, time_step=5e-4, support="fixed", servo=Servo.of(hand))
    planned, settled = plan.forces.normal_forces, plan.motion.settled_forces
    order = [simulation.parts.index(name) for name in plan.contacts.names]
    end = simulation.normal_forces[simulation.times > simulation.times[-1] - 0.05][:, order].mean(axis=0)
    off = np.abs(end - settled) / np.maximum(planned, 0.05 * planned.max())
    assert simulation.verdict.settled_error == pytest.approx(off.max(), abs=0.02)
    assert np.abs(end - settled).sum() < max(np.abs(end - planned).sum(), 0.03 * planned.sum())
    assert simulate(plan, release=False, hold=0.0, time_step=5e-4).verdict.settled_error is None


@pytest.mark.parametrize("hold", [0.001, 0.002, 0.02])
def test_short_holds_have_a_verdict(hold):
    seen = simulate(pg.load_case("paper", SURFACE).plan(), hold=hold, time_step=1e-3)
    assert isinstance(seen.verdict.held, bool)
