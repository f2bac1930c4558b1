"""Margins of a grasp against closed forms, linear programs of another solver, and sampled disturbances."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from random_grasps import FAMILIES, Model, normal_force_range, random_grasp, solve as solve_oracle
from scipy.optimize import linprog

from pinograsp.contacts import Friction, contacts_at
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    diagnose,
    disturbance_margin,
    force_closure,
    grasp_margins,
    min_weight,
    optimize_forces,
)
from pinograsp.forces.solve import conic
from pinograsp.objects import Cylinder


def around(contact_set, k, seed, radius=0.03):
    """k random contacts on a sphere, normals to its centre."""
    out = np.random.default_rng(seed).normal(size=(k, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return contact_set([(f"c{i}", "", radius * o, -o, None) for i, o in enumerate(out)])


@pytest.fixture
def solved(make_problem):
    def make(friction=None, mu=0.7, **settings):
        friction = friction or Friction(safety=1.2)
        return optimize_forces(make_problem(balance="wrench", friction=friction, mu=mu, **settings), 0.85)

    return make


def test_friction_figures_are_those_of_the_forces(solved):
    solution = solved()
    margins = grasp_margins(solution)
    f = solution.forces_c
    tangential = np.hypot(f[:, 0], f[:, 1])
    assert margins.least_mu == pytest.approx(tangential / f[:, 2])
    # At full mu: the safety factor of 1.2 leaves a sixth, in the pyramid's own terms.
    used = np.abs(f[:, :2]).max(axis=1) * np.sqrt(2) / (0.7 * f[:, 2])
    assert margins.friction_used == pytest.approx(used) and used.max() == pytest.approx(1 / 1.2)
    # Slip distance: step of that length to the cone's surface reaches it exactly.
    inward = np.array([0.7, -1.0]) / np.hypot(0.7, 1.0)  # of (F_n, |f_t|), towards the inside
    surface = np.column_stack([f[:, 2], tangential]) - margins.slip_distance[:, None] * inward
    assert surface[:, 1] == pytest.approx(0.7 * surface[:, 0])


def test_no_friction_and_tangential_force_slips(make_problem, solved):
    solution = solved()
    slippery = replace(solution, problem=replace(solution.problem, mu=[0.0, 0.7, 0.7]))
    margins = grasp_margins(slippery)
    assert np.isinf(margins.friction_used[0]) and margins.slip_distance[0] < 0 and margins.load_factor == 0


def test_disturbance_ball_of_three_contacts_is_the_parallelepiped_s(solved):
    """Six tangential directions in six dimensions: the set of held wrenches is a parallelepiped, its ball a closed
    form.
    """
    solution = solved()
    problem = solution.problem
    margins = grasp_margins(solution, tolerance=1e-9)
    columns = problem.scaled_columns
    normal = solution.normal_forces
    B = (columns[:, :, :2] * (0.7 / np.sqrt(2) * normal)[None, :, None]).reshape(6, 6)
    centre = -(columns[:, :, 2] @ normal + problem.scaled_load)
    inverse = np.linalg.inv(B)
    distance = (1 - np.abs(inverse @ -centre)) / np.linalg.norm(inverse, axis=1)
    assert margins.disturbance.lower == pytest.approx(distance.min(), rel=1e-6)
    assert margins.disturbance.upper >= margins.disturbance.lower
    weakest = margins.disturbance.direction
    wrench = np.concatenate([weakest[:3], weakest[3:] * problem.moment_length])
    full = replace(problem, friction=Friction())
    assert disturbance_margin(full, wrench, normal_forces=normal) == pytest.approx(distance.min(), rel=1e-5)


@pytest.mark.parametrize("friction", [Friction(edges=8), Friction(model="cone"), Friction(model="soft", torsion=0.002)])
def test_no_sampled_direction_is_weaker_than_the_ball(solved, friction):
    solution = solved(friction=replace(friction, safety=1.3))
    problem = replace(solution.problem, friction=friction)
    margins = grasp_margins(solution, tolerance=1e-3)
    assert 0 < margins.disturbance.lower <= margins.disturbance.upper
    rng = np.random.default_rng(0)
    forces = []
    for _ in range(20):
        direction = rng.normal(size=6)
        direction /= np.linalg.norm(direction)
        wrench = np.concatenate([direction[:3], direction[3:] * problem.moment_length])
        assert disturbance_margin(
            problem, wrench, normal_forces=solution.normal_forces
        ) >= margins.disturbance.lower * (1 - 1e-6)
        pure = np.concatenate([direction[:3] / np.linalg.norm(direction[:3]), np.zeros(3)])
        forces.append(disturbance_margin(problem, pure, normal_forces=solution.normal_forces))
    assert min(forces) >= margins.disturbance_force * (1 - 1e-6)
    assert margins.disturbance.lower * (1 - 1e-6) <= margins.disturbance_force <= min(forces) * 1.0001


def test_disturbance_margins_equal_another_solver_s_linear_program(contact_set):
    rng = np.random.default_rng(1)
    compared = 0
    for seed in range(12):
        contacts = around(contact_set, 5, seed)
        problem = ForceProblem(
            contacts=contacts,
            load=np.append(rng.normal(size=3), 0.01 * rng.normal(size=3)),
            mu=0.8,
            friction=Friction(),
            max_depth=5e-3,
        )
        direction = np.append(rng.normal(size=3), 0.02 * rng.normal(size=3))
        low, high = problem.normal_force_range(0.85)
        found = disturbance_margin(problem, direction, impact_time=0.85)
        f, s = cp.Variable((5, 3)), cp.Variable(nonneg=True)
        half = 0.8 / np.sqrt(2)
        scale = np.array([1, 1, 1, 50, 50, 50.0])
        net = problem.contacts.G @ cp.reshape(f, (15,), order="C") + problem.load + s * direction
        rows = [cp.abs(f[:, 0]) <= half * f[:, 2], cp.abs(f[:, 1]) <= half * f[:, 2], f[:, 2] >= low, f[:, 2] <= high]
        oracle = cp.Problem(cp.Maximize(s), [*rows, cp.multiply(scale, net) == 0])
        oracle.solve(solver="HIGHS")
        if oracle.status == "infeasible":
            assert found == -1.0
        else:
            compared += 1
            assert found == pytest.approx(float(s.value), rel=1e-6)
    assert compared >= 6


@pytest.mark.parametrize(
    "friction", [Friction(), Friction(model="cone"), Friction(model="soft", torsion=0.003)], ids=lambda f: f.model
)
def test_a_load_that_is_too_much_has_no_margin_even_where_more_would_relieve_it(friction):
    body = Cylinder(radius=0.03, height=0.1, mass=4.0)
    angle = np.array([0.0, 2.1, 4.2])
    contacts = contacts_at(None, body, 0.03 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))
    problem = ForceProblem(contacts=contacts, load=[0, 0, -40.0, 0, 0, 0], mu=0.5, friction=friction, max_depth=5e-3)
    assert optimize_forces(problem, 0.9).status is Status.INFEASIBLE
    up = [0, 0, 1.0, 0, 0, 0]
    assert disturbance_margin(problem, up, impact_time=0.9) == -1.0
    least, largest = diagnose(problem, 0.9).load_factors
    assert least < 1e-9 and largest < 1
    # The light load of the same forces is held, and 40 N less weight is more than that.
    light = problem.with_load(0.5 * largest * problem.load)
    assert disturbance_margin(light, up, impact_time=0.9) == pytest.approx(0.5 * largest * 40 + 40 * largest, rel=1e-6)
    normal = optimize_forces(light, 0.9).normal_forces
    assert (
        disturbance_margin(light, up, normal_forces=normal) >= 0 > disturbance_margin(problem, up, normal_forces=normal)
    )
    assert grasp_margins(replace(optimize_forces(light, 0.9), problem=problem)).load_factor == 0


@pytest.mark.parametrize(("family", "fixed"), [(family, fixed) for family in FAMILIES for fixed in (False, True)])
def test_disturbance_margins_equal_another_formulation(family, fixed):
    compared = 0
    for seed in range(24):
        grasp = random_grasp(seed, family=family, k=4 + seed % 3, torques=seed % 3 == 0, degenerate="", load="limit")
        problem, rng = grasp.problem, np.random.default_rng(seed)
        low, high = normal_force_range(problem, grasp.impact_time)
        if np.any(low > high):
            continue
        careful = replace(problem.friction, safety=1.2 * problem.friction.safety)
        held = optimize_forces(replace(problem, friction=careful), grasp.impact_time)
        if fixed and not held.found:
            continue
        direction = rng.normal(size=6) * [1, 1, 1, 0.03, 0.03, 0.03]
        if seed % 2:  # relief: what is not held becomes so
            direction = -problem.load
        model, s = Model(problem, grasp.impact_time), cp.Variable()
        unit = direction / model.scale
        unit[3:] /= problem.moment_length
        rows = [*model.constraints[:-1], model.net + s * unit[: problem.rows] == 0]
        found = {"impact_time": grasp.impact_time}
        if fixed:
            rows.append(held.normal_forces / model.scale == model.F)
            found = {"normal_forces": held.normal_forces}
        ends = [solve_oracle(cp.Minimize(s), rows), solve_oracle(cp.Maximize(s), rows)]
        if any(end[0] == "?" for end in ends) or min(abs(end[1]) for end in ends) < 1e-6:
            continue
        compared += 1
        wanted = ends[1][1] if ends[0][0] == "optimal" and ends[0][1] < 0 < ends[1][1] else -1.0
        assert disturbance_margin(problem, direction, **found) == pytest.approx(wanted, rel=1e-6), grasp
        if compared == 2:
            break
    assert compared == 2


def test_margins_do_not_take_a_solver_at_its_word(solved, contact_set, monkeypatch):
    """A solver that stops early says "solved" as well: figures then may be too small, never too large."""
    solution, contacts = solved(Friction(model="cone", safety=1.3)), around(contact_set, 5, 103)
    problem = replace(solution.problem, friction=Friction(model="cone"))
    directions = np.vstack([np.eye(6), -np.eye(6)]) * np.repeat([1, 0.03], 3)

    def figures():
        margins = grasp_margins(solution, tolerance=0.1)
        free = [disturbance_margin(problem, d, impact_time=0.85) for d in directions]
        fixed = [disturbance_margin(problem, d, normal_forces=solution.normal_forces) for d in directions]
        closure = [force_closure(contacts, 0.39).margin, min_weight(contacts, 0.39)]
        return np.array(
            [*free, *fixed, *closure, margins.load_factor, margins.disturbance_force, margins.disturbance_moment]
        )

    exact = figures()
    assert exact[:24].min() > 0 and exact[24] > 0.01
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        monkeypatch.setitem(conic._SETTINGS, name, 1e-3)
    assert np.all(figures() <= exact * (1 + 1e-6))


def test_load_factor_is_the_margin_along_the_load(solved):
    solution = solved()
    margins = grasp_margins(solution)
    along = disturbance_margin(
        replace(solution.problem, friction=Friction()), solution.problem.load, normal_forces=solution.normal_forces
    )
    assert margins.load_factor == pytest.approx(1 + along, rel=1e-6) and along > 0.05


def test_optimal_forces_without_safety_have_no_margin(make_problem):
    margins = grasp_margins(optimize_forces(make_problem(balance="wrench"), 0.85))
    assert margins.load_factor == pytest.approx(1.0, abs=1e-6) and margins.disturbance.lower == 0


def test_force_balance_has_no_moment_margin(make_problem):
    margins = grasp_margins(optimize_forces(make_problem(balance="force", friction=Friction(safety=1.5)), 0.8))
    assert margins.disturbance_moment is None and margins.disturbance_force > 0


def test_margins_need_forces(make_problem):
    with pytest.raises(InvalidInput, match="status 'infeasible'"):
        grasp_margins(optimize_forces(make_problem(mu=0.1), 0.85))
    problem = make_problem()
    for arguments in (
        {"direction": np.zeros(6), "impact_time": 0.9},
        {"direction": np.ones(6)},
        {"direction": np.ones(6), "impact_time": 0.9, "normal_forces": np.ones(3)},
        {"direction": np.ones(6), "normal_forces": -np.ones(3)},
        {"direction": np.ones(5), "impact_time": 0.9},
    ):
        with pytest.raises(InvalidInput):
            disturbance_margin(problem, arguments.pop("direction"), **arguments)


@pytest.mark.parametrize(
    ("rows", "mu", "friction", "balance", "closed"),
    [
        # Two opposed point contacts cannot hold a turn about their line; soft fingers can.
        ([((1, 0, 0), (-1, 0, 0)), ((-1, 0, 0), (1, 0, 0))], 0.5, Friction(model="cone"), "wrench", False),
        ([((1, 0, 0), (-1, 0, 0)), ((-1, 0, 0), (1, 0, 0))], 0.5, Friction(model="soft", torsion=0.1), "wrench", True),
        ([((1, 0, 0), (-1, 0, 0)), ((-1, 0, 0), (1, 0, 0))], 0.5, Friction(model="cone"), "force", True),
        # Three on an equator of a sphere: every wrench with friction, none without.
        ([((np.cos(a), np.sin(a), 0), (-np.cos(a), -np.sin(a), 0)) for a in (0, 2.1, 4.2)], 0.5, None, "wrench", True),
        ([((np.cos(a), np.sin(a), 0), (-np.cos(a), -np.sin(a), 0)) for a in (0, 2.1, 4.2)], 0.0, None, "wrench", False),
        # All normals parallel, all from one side.
        ([((a, b, 0), (0, 0, 1)) for a, b in ((0, 0), (1, 0), (0, 1), (1, 1))], 0.5, None, "wrench", False),
        ([((1, 0, 0), (-1, 0, 0))], 0.9, None, "wrench", False),
        ([((1, 0, 0), (-1, 0, 0))] * 3, 0.9, None, "wrench", False),
    ],
    ids=["two points", "two soft", "two, forces", "equator", "equator, slippery", "one-sided", "single", "triplicate"],
)
def test_force_closure_of_known_grasps(contact_set, rows, mu, friction, balance, closed):
    contacts = contact_set([(f"c{i}", "", p, n, None) for i, (p, n) in enumerate(rows)])
    found = force_closure(contacts, mu, friction=friction, balance=balance)
    assert found.closed is closed and (found.margin > 0 or not closed)
    if not closed:
        # The separating direction: no sampled contact force has a component against it.
        assert np.linalg.norm(found.separating) == pytest.approx(1.0)
        rng = np.random.default_rng(0)
        f = rng.normal(size=(len(contacts), 200, 3))
        f[..., 2] = 1.0
        f[..., :2] *= (mu * rng.random(f.shape[:2]) / np.linalg.norm(f[..., :2], axis=2))[..., None]
        G = contacts.G.reshape(6, -1, 3)
        for i in range(len(contacts)):
            wrenches = f[i] @ G[:, i].T
            length = np.mean(np.linalg.norm(contacts.points_o, axis=1)) or 1.0
            wrenches[:, 3:] /= length
            assert (wrenches @ found.separating).min() >= -1e-6


def linear_closure(contacts, mu, edges):
    """Largest least weight of a convex combination of edge wrenches that is zero, by HiGHS; and their rank."""
    angles = np.pi / 4 + 2 * np.pi * np.arange(edges) / edges
    edge = np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones(edges)])
    length = np.linalg.norm(contacts.points_o, axis=1).mean()
    G = np.array(contacts.G)
    G[3:] /= length
    W = np.einsum("rkc,ec->rke", G.reshape(6, -1, 3), edge).reshape(6, -1)
    n = W.shape[1]
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_eq=np.vstack([np.hstack([W, np.zeros((6, 1))]), np.append(np.ones(n), 0.0)]),
        b_eq=np.append(np.zeros(6), 1.0),
        A_ub=np.hstack([-np.eye(n), np.ones((n, 1))]),
        b_ub=np.zeros(n),
        bounds=[(None, None)] * n + [(0, None)],
    )
    return (found.x[-1] * n if found.status == 0 else 0.0), np.linalg.matrix_rank(W)


@pytest.mark.parametrize("seed", range(16))
def test_closure_and_min_weight_equal_a_linear_program(contact_set, seed):
    k, mu = 2 + seed % 5, 0.15 + 0.08 * (seed % 4)
    contacts = around(contact_set, k, 100 + seed)
    weight, rank = linear_closure(contacts, mu, 8)
    assert min_weight(contacts, mu, edges=8) == pytest.approx(weight, abs=1e-7)
    found = force_closure(contacts, mu, friction=Friction(edges=8))
    assert found.closed is bool(weight > 1e-7 and rank == 6)


def test_closure_of_many_contacts(contact_set):
    found = force_closure(around(contact_set, 60, 0), 0.4)
    assert found.closed and 0 < found.margin < 1


def test_squeeze_that_does_not_balance_holds_no_load_at_all(make_problem):
    held = optimize_forces(make_problem(balance="wrench"), 0.85)
    nothing = held.problem.with_load(np.zeros(6))
    uneven = grasp_margins(
        replace(held, problem=nothing, forces_c=held.forces_c * [[0.0, 0.0, 1.0], [0, 0, 50.0], [0, 0, 1.0]])
    )
    assert uneven.load_factor == 0.0
    still = optimize_forces(nothing, 0.85)
    assert still.found and grasp_margins(still).load_factor == np.inf
