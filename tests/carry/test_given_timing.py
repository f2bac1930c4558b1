"""Smoothed and given timings, squeezes that are commanded once or slowly, and scenarios."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from marks import slow_except
from panda_path import INTERVALS, JOINTS, WAYPOINTS

from pinograsp.carry import ArmPath, CarryScenario, plan_carry
from pinograsp.carry.timing import Timing
from pinograsp.errors import CarryInfeasible, InvalidInput
from pinograsp.forces import optimize_forces
from pinograsp.forces.matrices import elastic_reaction
from pinograsp.handover import JointTrajectory


def trajectory_of(plan, faster=1.0, samples=800):
    """The arm's part of a plan as others would write it down."""
    times = np.linspace(0.0, plan.duration, samples)
    moving = plan.timing.at(times)
    point = plan.path.at(moving.s)
    v, a = moving.speed[:, None] * faster, moving.acceleration[:, None] * faster**2
    return JointTrajectory(
        names=plan.path.joints,
        times=times / faster,
        q=point.q,
        dq=point.slope * v,
        ddq=point.slope * a + point.bend * v**2,
        effort=np.zeros_like(point.q),
    )


def at_load(grasp, plan, load, **changes):
    """The force problem of one load with what a plan keeps free."""
    problem = grasp.problem
    friction = replace(problem.friction, safety=problem.friction.safety / (1.0 - plan.reserve))
    return replace(
        problem, load=load, friction=friction, torques=None, balance="wrench", min_normal_force=None, **changes
    )


# -- timing ------------------------------------------------------------------------------------------------------------


def test_a_moving_average_is_one():
    rng = np.random.default_rng(4)
    y = np.concatenate([[0.0], rng.uniform(0.5, 3.0, 7), [0.0]])
    timing = Timing.of_squares(np.linspace(0, 1, 9), y)
    window, dense = 0.13, np.linspace(0.0, 1.0, 4001)[1:-1]
    smooth = timing.smooth(window)
    assert smooth.duration == pytest.approx(timing.duration + window)
    for t in (0.02, 0.2, 0.5, smooth.duration - 0.05):
        steps = timing.at(t - window + window * (np.arange(2000) + 0.5) / 2000)
        for mean, of in zip(smooth.at(np.array([t])), steps[:3]):
            assert float(mean[0]) == pytest.approx(float(of.mean()), rel=2e-3, abs=2e-3)
    times = smooth.duration * dense
    s, v, a, j = smooth.at(times)
    assert (np.diff(s) >= 0).all() and s[0] < 1e-6 and s[-1] > 1 - 1e-6
    dt = times[1] - times[0]
    for value, derivative, of in ((s, v, "speed"), (v, a, "acceleration")):
        found = np.gradient(value, dt)[2:-2]
        assert np.abs(found - derivative[2:-2]).max() < 1e-2 * np.abs(derivative).max(), of
    # The acceleration is continuous, and its slope bounded.
    assert np.abs(np.diff(a)).max() <= 1.01 * np.abs(j).max() * dt


def test_faster_is_the_same_way_in_less_time():
    timing = Timing.of_squares(np.linspace(0, 1, 5), np.array([0.0, 1.0, 2.0, 1.5, 0.0])).smooth(0.1)
    times, twice = np.linspace(0.0, timing.duration, 33), timing.speed_up(2.0)
    assert twice.duration == pytest.approx(timing.duration / 2)
    for order, (slow, fast) in enumerate(zip(timing.at(times), twice.at(times / 2))):
        np.testing.assert_allclose(fast, slow * 2**order, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_a_smoothed_plan_keeps_to_the_limits(arm, carried, smoothed):
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    assert carried.fastest == pytest.approx(smoothed.fastest)
    assert smoothed.duration >= carried.duration
    assert smoothed.gap == pytest.approx(carried.gap)
    assert smoothed.factor >= 1 - 1e-9
    assert (np.abs(smoothed.torques[:, moving]) <= 0.9 * arm.effort[moving] * (1 + 1e-6)).all()
    assert (np.abs(smoothed.dq[:, moving]) <= 0.9 * arm.velocity[moving] * (1 + 1e-6)).all()
    assert (smoothed.friction_use <= 1 + 1e-6).all()
    # Accelerations change less from sample to sample than those that jump.
    changes = [np.abs(np.diff(plan.ddq[:, moving], axis=0)).max() for plan in (smoothed, carried)]
    assert changes[0] < 0.5 * changes[1]


def test_jerk_is_limited(arm, grasp):
    most = 400.0
    plan = plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, jerk=most)
    times = np.linspace(0.0, plan.duration, 6001)[1:-1]
    moving = plan.timing.at(times)
    point = plan.path.at(moving.s)
    v, a = moving.speed[:, None], moving.acceleration[:, None]
    jerk = np.abs(np.diff(point.slope * a + point.bend * v**2, axis=0)).max() / (times[1] - times[0])
    assert 0.5 * most < jerk <= most * (1 - plan.reserve) * 1.02
    assert plan.duration > plan.fastest


# -- given timings -----------------------------------------------------------------------------------------------------


def test_a_given_timing_has_the_loads_of_its_motion(arm, grasp, smoothed):
    plan = plan_carry(arm, grasp, trajectory_of(smoothed), timing="given", intervals=INTERVALS)
    assert plan.duration == pytest.approx(smoothed.duration)
    assert plan.fastest is plan.lower_bound is plan.gap is None
    assert plan.factor == pytest.approx(smoothed.factor, abs=0.02)
    size = np.abs(smoothed.loads[:, :3]).max()
    np.testing.assert_allclose(plan.loads[2:-2, :3], smoothed.loads[2:-2, :3], atol=0.02 * size)
    np.testing.assert_allclose(plan.squeeze[2:-2], smoothed.squeeze[2:-2], rtol=0.05)
    assert "times as fast" in plan.describe()


def weak(grasp, most):
    """The grasp with small caps: it is what binds."""
    return replace(grasp, solution=replace(grasp.solution, problem=replace(grasp.problem, max_normal_force=most)))


@pytest.mark.slow
def test_what_is_too_fast_is_proven_and_told_how_fast_it_may_be(arm, grasp):
    held = weak(grasp, 1.3)
    free = {"intervals": INTERVALS, "reserve": 0.0, "disturbance": 0.0}
    plan = plan_carry(arm, held, WAYPOINTS, **free)
    options = {"timing": "given", "speed": 100.0, "torque_limit": 1e4, **free}
    most = plan_carry(arm, held, trajectory_of(plan), **options).factor
    assert 1.0 <= most < 1.5
    plan_carry(arm, held, trajectory_of(plan, 0.999 * most), **options)
    with pytest.raises(CarryInfeasible, match=r"cannot hold the object at this speed.*proven") as raised:
        plan_carry(arm, held, trajectory_of(plan, 1.1 * most), **options)
    assert raised.value.factor == pytest.approx(1 / 1.1, rel=1e-3)
    assert 0 < raised.value.at < 1
    assert raised.value.solution.infeasibility is not None


# -- squeezes ----------------------------------------------------------------------------------------------------------


def least_common(grasp, plan, most_change=None):
    """The same program, by cvxpy: normal forces commanded once (None), or with limited changes."""
    problem = at_load(grasp, plan, plan.loads[0])
    contacts, N, k = problem.contacts, len(plan.loads), problem.k
    scale = np.concatenate([np.ones(3), np.full(3, 1 / problem.moment_length)])
    C = elastic_reaction(problem)
    rows = 1 if most_change is None else N
    F, limits = cp.Variable((rows, k)), []
    mu = problem.mu / problem.friction.safety
    limits.append(F >= 0)
    for i, load in enumerate(plan.loads):
        f = cp.Variable((k, 3))
        world = [contacts.rotations_oc[c] @ f[c] for c in range(k)]
        arms = contacts.points_o - contacts.com_o
        crosses = [np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in arms]
        limits += [sum(world) == -load[:3], sum(X @ w for X, w in zip(crosses, world)) == -load[3:]]
        normal = F[0 if rows == 1 else i] + C @ (scale * (load - plan.loads[0]))
        limits += [f[:, 2] == normal, f[:, 2] >= grasp.problem.min_normal_force, f[:, 2] <= 0.9 * 50.0]
        limits += [cp.norm(f[c, :2]) <= mu[c] * f[c, 2] for c in range(k)]
    if rows > 1:
        limits.append(cp.abs(F[1:] - F[:-1]) <= most_change)
    program = cp.Problem(cp.Minimize(cp.sum_squares(F) / rows), limits)
    program.solve(solver="CLARABEL")
    return F.value, program.value


@pytest.mark.slow
def test_a_constant_squeeze_is_the_least_that_bears_all(arm, grasp):
    plan = plan_carry(arm, grasp, WAYPOINTS, intervals=25, squeeze="constant", disturbance=0)
    assert np.ptp(plan.commanded, axis=0).max() < 1e-9
    C, scale = (
        elastic_reaction(grasp.problem),
        np.concatenate([np.ones(3), np.full(3, 1 / grasp.problem.moment_length)]),
    )
    change = (plan.loads - plan.loads[0]) * scale @ C.T
    np.testing.assert_allclose(plan.normal_forces, plan.commanded + change, atol=1e-6)
    assert (plan.friction_use <= 1 + 1e-5).all()
    _, value = least_common(grasp, plan)
    assert (plan.commanded[0] ** 2).sum() == pytest.approx(value, rel=1e-4)


@pytest.mark.slow
def test_a_slow_squeeze_changes_slowly_and_lies_between(arm, grasp):
    options = {"intervals": 25, "disturbance": 0.0}
    constant = plan_carry(arm, grasp, WAYPOINTS, squeeze="constant", **options)
    slow, quick = (plan_carry(arm, grasp, WAYPOINTS, squeeze=rate, **options) for rate in (2.0, 1e4))
    for rate, plan in ((2.0, slow), (1e4, quick)):
        steps = np.diff(plan.instants)[:, None]
        assert (np.abs(np.diff(plan.commanded, axis=0)) <= rate * steps * (1 + 1e-5) + 1e-7).all()
        assert (plan.friction_use <= 1 + 1e-5).all()
    sizes = [(plan.commanded**2).sum(axis=1).mean() for plan in (quick, slow, constant)]
    assert sizes[0] <= sizes[1] * (1 + 1e-6) and sizes[1] <= sizes[2] * (1 + 1e-6)
    assert sizes[0] < sizes[2]
    _, value = least_common(grasp, slow, 2.0 * np.diff(slow.instants)[:, None])
    assert sizes[1] == pytest.approx(value, rel=1e-4)


@pytest.mark.slow
def test_where_no_constant_squeeze_bears_it_the_arm_goes_slower_or_says_so(arm, grasp):
    held = weak(grasp, 1.0)
    free = {"intervals": 25, "disturbance": 0.0}
    least = plan_carry(arm, held, WAYPOINTS, **free)
    constant = plan_carry(arm, held, WAYPOINTS, squeeze="constant", **free)
    assert constant.duration > 1.05 * least.duration
    proven = "no constant squeeze withstands the whole path at this speed, proven"
    with pytest.raises(CarryInfeasible, match=proven) as told:
        plan_carry(arm, held, trajectory_of(least, 0.995), timing="given", squeeze="constant", **free)
    assert told.value.factor == pytest.approx(least.duration / constant.duration, rel=0.05)


# -- scenarios ---------------------------------------------------------------------------------------------------------

SCENARIOS = (CarryScenario(mass=1.3), CarryScenario(mass=0.7, com=(0.0, 0.005, 0.0)), CarryScenario(mu=0.8))


@pytest.mark.slow
@pytest.mark.parametrize("squeeze", slow_except(["least", "constant"], "constant"))
def test_scenarios_cost_time_or_squeeze(arm, grasp, squeeze):
    held, options = weak(grasp, 1.6), {"intervals": 25, "squeeze": squeeze, "disturbance": 0.0}
    one = plan_carry(arm, held, WAYPOINTS, **options)
    all_of_them = plan_carry(arm, held, WAYPOINTS, scenarios=SCENARIOS, **options)
    assert all_of_them.duration >= one.duration * (1 - 1e-6)
    at_rest = [float(plan.squeeze[0]) for plan in (one, all_of_them)]
    assert at_rest[1] > at_rest[0]
    # Every scenario alone is no slower.
    for scenario in SCENARIOS:
        alone = plan_carry(arm, held, WAYPOINTS, scenarios=[scenario], **options)
        assert alone.fastest <= all_of_them.fastest * (1 + 1e-6)


def test_a_heavier_object_as_scenario_is_borne_by_the_squeeze(arm, grasp):
    """Its forces exist with the common squeeze: normal forces differ from the planned as on equal springs."""
    plan = plan_carry(arm, grasp, WAYPOINTS, intervals=25, scenarios=[CarryScenario(mass=1.5)])
    problem = grasp.problem
    scale = np.concatenate([np.ones(3), np.full(3, 1 / problem.moment_length)])
    C = elastic_reaction(problem)
    for i in range(0, 25, 4):
        load = 1.5 * plan.loads[i]
        normal = plan.normal_forces[i] + C @ (scale * (load - plan.loads[i]))
        assert (normal >= -1e-6).all()
        found = optimize_forces(
            at_load(grasp, plan, load, max_normal_force=normal + 2e-3), 0.9 * problem.final_time, objective="peak"
        )
        assert found.found


def test_the_arm_bears_the_heavier_object(arm, grasp):
    """Torque limits hold in every scenario."""
    one, heavy = (
        plan_carry(arm, grasp, WAYPOINTS, intervals=25, reserve=0.0, ramp=0, scenarios=scenarios, speed=100.0)
        for scenarios in ((), (CarryScenario(mass=8.0),))
    )
    assert heavy.fastest > 1.01 * one.fastest


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [{"mass": 0.0}, {"mass": np.nan}, {"mu": -1.0}, {"com": [0.0, 0.0]}])
def test_scenarios_that_cannot_be(wrong):
    with pytest.raises(InvalidInput):
        CarryScenario(**wrong)


def test_joints_that_are_too_fast_are_named(arm, grasp, smoothed):
    """Whatever the forces: the speed or the torque of a joint rules a timing out by itself."""
    with pytest.raises(CarryInfeasible, match=r"times the largest speed of panda_joint\d") as told:
        plan_carry(arm, grasp, trajectory_of(smoothed, 1.5), timing="given", intervals=INTERVALS)
    assert told.value.factor == pytest.approx(smoothed.factor / 1.5, rel=0.02)
    with pytest.raises(CarryInfeasible, match=r"times the largest torque of panda_joint\d"):
        plan_carry(arm, grasp, trajectory_of(smoothed, 4.0), timing="given", intervals=INTERVALS, speed=100.0)


def test_a_whole_trajectory_is_taken_back(arm, grasp, smoothed, tmp_path):
    """Its fingers' columns are left out: they hold."""
    smoothed.trajectory(rate=500.0).to_csv(tmp_path / "a.csv")
    again = plan_carry(arm, grasp, ArmPath.read(tmp_path / "a.csv"), timing="given", intervals=INTERVALS)
    assert again.path.joints == JOINTS and again.duration == pytest.approx(smoothed.duration)
    assert not any("at rest" in note for note in again.notes)


def test_what_begins_at_speed_is_told(arm, grasp):
    path = ArmPath(joints=JOINTS, s=[0.0, 0.5, 1.0], q=np.array(list(WAYPOINTS.values())).T, times=[0.0, 1.0, 2.0])
    plan = plan_carry(arm, grasp, path, timing="given", intervals=INTERVALS)
    assert any("does not begin and end at rest" in note for note in plan.notes)


def test_jerk_of_a_given_timing_is_refused(arm, grasp, smoothed):
    with pytest.raises(InvalidInput, match="jerk"):
        plan_carry(arm, grasp, trajectory_of(smoothed), timing="given", jerk=10.0)
