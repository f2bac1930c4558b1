"""Carrying in simulation: what is planned is held, what is not is lost."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from panda_allegro import arm_with_allegro
from panda_path import JOINTS, START, WAYPOINTS

import pinograsp as pg
from pinograsp.carry import plan_carry, simulate_carry
from pinograsp.carry.simulation import LETTING_GO, build_simulation_task, choose_servo
from pinograsp.errors import InvalidInput
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Push, simulate

STEP = 1e-3  # [s]
OVER = {"panda_joint2": 0.4, "panda_joint4": -0.5, "panda_joint6": 3.6}


def angle(R):
    return np.degrees(np.linalg.norm(pin.log3(R)))


@pytest.fixture(scope="module")
def slow(arm, grasp):
    """With a third of the joints' speeds."""
    return plan_carry(arm, grasp, WAYPOINTS, intervals=100, speed=arm.velocity / 3)


@pytest.fixture(scope="module")
def seen(slow):
    return simulate_carry(slow, time_step=STEP, hold=0.3)


@pytest.mark.slow
def test_a_slow_carry_is_held(arm, slow, seen):
    assert seen.verdict.held, seen.verdict.causes
    assert seen.verdict.drift < 2e-3 and seen.verdict.turn < 2.0
    assert any("carried along the path" in note for note in seen.notes)
    # Poses of the record are the world's: the object went with the palm.
    palms = np.array([arm.frame_placements(q, [arm.palm])[0] for q in seen.q[[seen.complete, -1]]])
    poses = seen.object_poses[[seen.complete, -1]]
    assert np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]) > 0.3
    in_palm = np.linalg.inv(palms) @ poses
    assert np.linalg.norm(in_palm[1, :3, 3] - in_palm[0, :3, 3]) == pytest.approx(seen.verdict.drift, abs=1e-4)


@pytest.mark.slow
def test_the_arm_is_where_its_path_says(slow, seen):
    start = seen.times[-1] - 0.3 - LETTING_GO - slow.duration
    arm = [slow.robot.joint_names.index(joint) for joint in JOINTS]
    for share in (0.2, 0.5, 0.8, 1.0):
        i = int(np.argmin(np.abs(seen.times - start - share * slow.duration)))
        s = slow.timing.at(np.clip(seen.times[[i]] - start, 0.0, slow.duration)).s
        np.testing.assert_allclose(seen.q[i, arm], slow.path.at(s).q[0], atol=np.radians(0.3))


def test_fingers_press_as_the_plan_says(slow, seen):
    start = seen.times[-1] - 0.3 - LETTING_GO - slow.duration
    way = (seen.times > start) & (seen.times < start + slow.duration)
    planned = np.interp(seen.times[way] - start, slow.instants, slow.squeeze)
    assert np.percentile(np.abs(seen.normal_forces[way].sum(axis=1) / planned - 1), 90) < 0.1


@pytest.mark.slow
def test_on_ice_it_is_lost(slow):
    lost = simulate_carry(slow, time_step=STEP, hold=0.2, disturbance=Disturbance(mu=0.05))
    assert not lost.verdict.held
    assert any("slipped" in cause or "opened" in cause for cause in lost.verdict.causes)


@pytest.mark.slow
def test_a_push_on_the_way_comes_after_a_shorter_hold(slow):
    """As hard as the weight five times over, once the arm moves: the hand is not asked for that."""
    push = Push(wrench_o=[0.0, 0.0, -10.0, 0.0, 0.0, 0.0], start=0.4, duration=0.1)
    lost = simulate_carry(slow, time_step=STEP, hold=0.1, disturbance=Disturbance(pushes=(push,)))
    assert not lost.verdict.held
    with pytest.raises(InvalidInput, match="end of a push"):
        simulate_carry(slow, time_step=STEP, hold=0.1, disturbance=Disturbance(pushes=(replace(push, start=9.0),)))


@pytest.mark.slow
def test_three_times_as_fast_as_planned_it_is_lost(arm, smoothed):
    """The hand squeezes as for the plan, and the motors of the arm have no limits."""
    quick = replace(
        smoothed, timing=smoothed.timing.speed_up(3), times=smoothed.times / 3, instants=smoothed.instants / 3
    )
    task = build_simulation_task(quick, LETTING_GO)
    limit = np.where(np.isin(arm.joint_names, JOINTS), np.inf, task.torque_limit)
    lost = simulate(replace(task, torque_limit=limit), servo=choose_servo(quick), time_step=STEP, hold=0.3)
    assert not lost.verdict.held
    assert lost.verdict.drift > 5e-3


@pytest.mark.slow
def test_turned_upside_down(arm, grasp):
    ends = {joint: [start, OVER.get(joint, start)] for joint, start in zip(JOINTS, START)}
    plan = plan_carry(arm, grasp, ends, intervals=100, speed=arm.velocity / 3)
    seen = simulate_carry(plan, time_step=STEP, hold=0.3)
    first, last = (arm.frame_placements(plan.q[i], [arm.palm])[0][:3, :3] for i in (0, -1))
    assert angle(last @ first.T) > 120
    assert seen.verdict.held, seen.verdict.causes
    assert seen.verdict.turn < 3.0 and seen.verdict.tilt < 3.0


def test_servos_of_the_arm_are_stable_along_the_way(slow):
    """Damping that acts at the beginning of a step: its fastest rate has to be below two per step, of the arm's joints."""
    servo, model = choose_servo(slow), slow.robot.model
    for q in slow.q[::25]:
        mass = np.triu(pin.crba(model, model.createData(), np.array(q)))
        mass += np.triu(mass, 1).T + np.diag(servo.rotor - model.armature)
        arm = np.ix_(range(len(JOINTS)), range(len(JOINTS)))
        rates = np.linalg.eigvals(np.linalg.solve(mass[arm], np.diag(servo.damping[: len(JOINTS)])))
        assert np.abs(rates).max() < 2.0 / 1e-3


def test_only_plans_of_carrying(grasp):
    with pytest.raises(InvalidInput, match="plan"):
        simulate_carry(grasp)


@pytest.mark.slow
def test_a_hand_that_was_planned_alone_carries_on_an_arm(tmp_path):
    robot, hand, conditions = arm_with_allegro(tmp_path), pg.load_hand("allegro_right"), pg.GraspConditions(mu=0.6)
    search = pg.find_grasps(hand, pg.Sphere(radius=0.035, mass=0.15), conditions, count=8, seed=3, jobs=1)
    plan = plan_carry(robot, plan_best(search, conditions), WAYPOINTS, intervals=100, squeeze="constant")
    seen = simulate_carry(plan, time_step=STEP)
    assert seen.verdict.held, seen.verdict.causes
    assert seen.verdict.drift < 3e-3
    ice = simulate_carry(plan, time_step=STEP, disturbance=Disturbance(mu=0.05))
    assert not ice.verdict.held
