"""The global optimum over the impact time: figures of the case study, the certificate, the log, what goes wrong."""

from __future__ import annotations

import itertools
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from random_grasps import contact_set_of

from pinograsp.contacts import DecelerationShape, Friction
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    TorqueLimits,
    grid_search,
    optimize_forces,
    optimize_grasp,
)
from pinograsp.forces.grid import global_optimum as module
from pinograsp.forces.solve.solver_order import SolverOrder


def least_peak(problem) -> float:
    """Smallest largest normal force of any balanced forces [N]: a linear program by HiGHS, from G alone."""
    k, rows = problem.k, problem.rows
    f, top = cp.Variable((k, 3)), cp.Variable()
    half = problem.mu / np.sqrt(2)
    G = problem.contacts.G
    limits = [
        cp.abs(f[:, 0]) <= cp.multiply(half, f[:, 2]),
        cp.abs(f[:, 1]) <= cp.multiply(half, f[:, 2]),
        f[:, 2] <= top,
    ]
    net = G @ cp.reshape(f, (3 * k,), order="C") + problem.load
    scale = np.array([1.0] * 3 + [50.0] * 3)[:rows]
    cp.Problem(cp.Minimize(top), [*limits, cp.multiply(scale, net[:rows]) == 0]).solve(solver="HIGHS")
    return float(top.value)


@pytest.mark.parametrize(("balance", "published"), [("force", 0.91877), ("wrench", 0.91674)])
def test_latest_impact_is_where_the_largest_deceleration_just_gives_the_least_peak(make_problem, balance, published):
    """The impulse falls with the duration, so the optimum is the shortest one that still reaches the forces (Eq. 26)."""
    problem = make_problem(balance=balance, measure="impulse")
    best = optimize_grasp(problem)
    law = problem.compliance
    depth = (least_peak(problem) / law.stiffness) ** (1 / law.exponent)
    shortest = np.sqrt(2 * depth / problem.acceleration_range[1])
    assert best.status is Status.OK and best.certificate.relative_gap <= 1e-6
    # The impulse is proportional to the duration there: a gap of 1e-6 allows as much in the duration.
    assert 1 - best.impact_time == pytest.approx(shortest, rel=2e-6)
    assert best.impact_time == pytest.approx(published, abs=1e-5)


@pytest.mark.parametrize(
    ("balance", "measure", "expected"),
    [
        ("force", "work", 55.78e-3),
        ("wrench", "work", 57.09e-3),
        # c K tau sum(delta^rho) + lambda sum(delta^2.5) at the forces and impact times of the test above.
        ("force", "impulse", 2.4182),
        ("wrench", "impulse", 2.4787),
    ],
)
def test_case_study_optima(make_problem, balance, measure, expected):
    best = optimize_grasp(make_problem(balance=balance, measure=measure))
    assert best.certificate.objective == pytest.approx(expected, rel=1e-4)
    assert best.certificate.relative_gap <= 1e-6
    total = best.work if measure == "work" else best.impulse
    assert total == pytest.approx(best.certificate.objective, rel=1e-12)
    assert best.residual_force < 1e-9 and (balance == "force" or best.residual_moment < 1e-9)


def test_grid_costs_more_than_the_certified_optimum(make_problem):
    problem = make_problem(balance="wrench", measure="impulse")
    saving = 1 - optimize_grasp(problem).impulse / grid_search(problem).impulse
    assert 0.17 < saving < 0.19


@pytest.mark.parametrize("measure", ["work", "impulse"])
@pytest.mark.parametrize(
    "shape",
    [
        DecelerationShape.constant(),
        DecelerationShape.linear(1, 0.2),
        DecelerationShape.polynomial([1, -2, 2]),
        DecelerationShape.from_samples([0.2, 1.0, 0.4]),
    ],
    ids=["constant", "linear", "polynomial", "sampled"],
)
def test_no_impact_time_beats_the_bound(make_problem, measure, shape):
    problem = make_problem(balance="wrench", measure=measure, shape=shape, friction=Friction(model="cone"))
    best = optimize_grasp(problem)
    assert best.status is Status.OK and best.certificate.relative_gap <= 1e-6
    for t in np.linspace(*problem.impact_time_range, 31):
        other = optimize_forces(problem, t)
        if other.status is Status.OK:
            assert other.certificate.objective >= best.certificate.lower_bound * (1 - 1e-12)
    assert best.profile.final_depth.max() <= problem.max_depth * (1 + 1e-9)
    assert best.acceleration.max() <= problem.acceleration_range[1] * (1 + 1e-9)
    assert best.profile.impact_speed.max() <= problem.max_speed


def test_log_covers_the_whole_range(make_problem):
    problem = make_problem(balance="wrench", measure="impulse")
    best = optimize_grasp(problem)
    leaves = sorted((b for b in best.branches if b.fate != "split"), key=lambda b: b.start)
    assert leaves[0].start == problem.impact_time_range[0] and leaves[-1].end == problem.impact_time_range[1]
    assert all(a.end == b.start for a, b in itertools.pairwise(leaves))
    assert min(b.lower_bound for b in leaves) >= best.certificate.lower_bound * (1 - 1e-12)
    assert {b.fate for b in leaves} == {"infeasible", "bounded"}


def test_objectives_without_energy_do_not_depend_on_the_impact_time(make_problem):
    problem = make_problem(balance="wrench")
    for objective in ("least_squares", "peak"):
        best = optimize_grasp(problem, objective=objective)
        early = optimize_forces(problem, problem.impact_time_range[0], objective=objective)
        assert best.certificate.objective == pytest.approx(early.certificate.objective, rel=1e-9)


def test_weighted_sum_lies_between_its_parts(make_problem):
    problem = make_problem(balance="wrench")
    both = optimize_grasp(problem, objective={"work": 20.0, "impulse": 1.0})
    least = [20 * optimize_grasp(problem, objective="work").work, optimize_grasp(problem, objective="impulse").impulse]
    assert both.certificate.objective == pytest.approx(20 * both.work + both.impulse, rel=1e-9)
    assert both.certificate.objective >= sum(least) * (1 - 2e-6)


def test_infeasible_at_every_impact_time_is_proven(make_problem):
    found = optimize_grasp(make_problem(balance="wrench", mu=0.2))
    assert found.status is Status.INFEASIBLE and not found.found
    assert found.infeasibility.margin > 0
    assert all(branch.fate in ("split", "infeasible") for branch in found.branches)


def test_torque_limits_narrow_the_search(make_problem, contacts):
    free = optimize_grasp(make_problem(balance="wrench", measure="work"))
    rng = np.random.default_rng(3)
    J = np.concatenate([rng.normal(size=(3, 3, 4)) * 0.05, np.zeros((3, 3, 4))], axis=1)
    limits = TorqueLimits(jacobian=J, bias=np.zeros(4), limit=np.full(4, 10.0))
    used = np.abs(limits.torques(np.einsum("kij,kj->ki", contacts.rotations_oc, free.forces_c)))
    loose = TorqueLimits(jacobian=J, bias=np.zeros(4), limit=used.max() * 1.01 * np.ones(4))
    same = optimize_grasp(make_problem(balance="wrench", measure="work", torques=loose))
    assert same.certificate.objective == pytest.approx(free.certificate.objective, rel=1e-8)
    force = make_problem(balance="force", measure="work")
    free = optimize_grasp(force)
    used = np.abs(limits.torques(np.einsum("kij,kj->ki", contacts.rotations_oc, free.forces_c)))
    tight = TorqueLimits(jacobian=J, bias=np.zeros(4), limit=used.max() * 0.97 * np.ones(4))
    narrowed = optimize_grasp(replace(force, torques=tight))
    if narrowed.status is Status.OK:
        assert narrowed.certificate.objective > free.certificate.objective * (1 + 1e-9)
        assert narrowed.certificate.at_torque
    else:
        assert narrowed.infeasibility.at_torque


def test_interrupted_search_keeps_its_best_and_a_valid_bound(make_problem, monkeypatch):
    problem = make_problem(balance="wrench", measure="impulse")
    full = optimize_grasp(problem)
    solve, calls = SolverOrder.solve, []

    def interrupted(*args, **settings):
        calls.append(1)
        if len(calls) > 12:
            raise KeyboardInterrupt
        return solve(*args, **settings)

    monkeypatch.setattr(SolverOrder, "solve", interrupted)
    part = optimize_grasp(problem)
    assert part.status is Status.INTERRUPTED and part.found
    assert part.certificate.lower_bound <= full.certificate.objective <= part.certificate.objective
    assert part.certificate.relative_gap > 1e-6


def test_unusable_settings(make_problem):
    problem = make_problem()
    for bad in ({"gap": 0}, {"gap": 1e-12}, {"gap": float("nan")}, {"objective": "beauty"}, {"solver": "magic"}):
        with pytest.raises(InvalidInput):
            optimize_grasp(problem, **bad)


def test_progress_bar_goes_to_stderr(make_problem, capsys):
    optimize_grasp(make_problem(balance="wrench", measure="impulse"), progress=True)
    shown = capsys.readouterr()
    assert "branch and bound" in shown.err and shown.out == ""


@pytest.mark.parametrize("objective", ["impulse", "peak", "least_squares"])
@pytest.mark.parametrize("miss", [3e-10, -3e-10])
def test_contacts_at_the_very_limit_of_friction_end_the_search(miss, objective):
    """Two contacts whose pyramids just meet, or just do not, under next to no load: no solver can tell."""
    tilt = np.arctan(0.5 / np.sqrt(2)) + miss
    normals = [[-np.cos(tilt), np.sin(tilt), 0], [np.cos(tilt), np.sin(tilt), 0]]
    problem = ForceProblem(
        contacts=contact_set_of([[0.03, 0, 0], [-0.03, 0, 0]], normals),
        load=[0, 0, -1e-6, 0, 0, 0],
        mu=0.5,
        friction=Friction(),
        max_depth=5e-3,
    )
    found = optimize_grasp(problem, objective=objective)
    assert found.status in (Status.OK, Status.INFEASIBLE, Status.INACCURATE) and len(found.branches) <= 500
    assert found.status is not Status.INFEASIBLE or found.infeasibility.margin > 0


def test_too_many_intervals_leave_an_honest_bound(make_problem, monkeypatch):
    problem = make_problem(balance="wrench", measure="impulse")
    best = optimize_grasp(problem)
    monkeypatch.setattr(module, "_MOST", 4)
    some = optimize_grasp(problem)
    assert some.status is Status.INACCURATE and [b.fate for b in some.branches].count("split") == 4
    assert any(b.fate == "unresolved" for b in some.branches)
    assert some.certificate.lower_bound <= best.certificate.objective <= some.certificate.objective
    assert some.certificate.relative_gap > 1e-6
