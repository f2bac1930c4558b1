"""The force problem, the QP over the multipliers, and the searches, against outside oracles and the published figures."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import PUBLISHED_FORCES
from hypothesis import given, strategies as st
from scipy.optimize import lsq_linear

from pinograsp.contacts import Friction, MarhefkaOrin, contacts_at
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    QP_SOLVERS,
    ForceProblem,
    GridSpec,
    grid_search,
    grid_values,
    refine_multipliers,
)
from pinograsp.forces.grid import pruned
from pinograsp.forces.grid.lattice import first_on_lattice
from pinograsp.forces.solve import multipliers as multipliers_module
from pinograsp.forces.solve.solvers import TOLERANCES, solve_qp
from pinograsp.objects import Cylinder, Sphere


def random_problem(seed, k=None, **settings):
    """Seeded contacts on a vertical cylinder or a sphere, friction and mass at random."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 6)) if k is None else k
    if seed % 2:
        shape = Sphere(radius=0.03, mass=rng.uniform(0.05, 1.0))
        v = rng.normal(size=(k, 3))
        points = 0.03 * v / np.linalg.norm(v, axis=1)[:, None]
    else:
        shape = Cylinder(radius=0.02, height=0.1, mass=rng.uniform(0.05, 1.0))
        a = rng.uniform(0, 2 * np.pi, k)
        points = np.column_stack([0.02 * np.cos(a), 0.02 * np.sin(a), rng.uniform(-0.03, 0.03, k)])
    choices = {"mu": rng.uniform(0.2, 1.2), "balance": ("force", "wrench")[seed // 2 % 2]}
    choices |= {"friction": Friction(), "max_depth": 5e-3, **settings}
    return ForceProblem.holding(shape, contacts_at(None, shape, points), **choices), rng.uniform(0.5, 10, k)


def least_squares(problem, normal):
    """H, b of the net wrench H k + b, built from contact frames with explicit products (Eqs. 15, 27)."""
    H, b = [], problem.load.copy()
    for contact, mu, F in zip(problem.contacts, problem.mu, normal):
        arm = contact.point_o - problem.contacts.com_o
        for axis in (0, 1):
            f = mu * F / np.sqrt(2) * contact.rotation_oc[:, axis]
            H.append(np.concatenate([f, np.cross(arm, f)]))
        f = F * contact.rotation_oc[:, 2]
        b += np.concatenate([f, np.cross(arm, f)])
    H = np.array(H).T
    H[3:] /= problem.moment_length
    b[3:] /= problem.moment_length
    return H[: problem.rows], b[: problem.rows]


# -- the problem -------------------------------------------------------------------------------------------------------


def test_friction_pyramid_is_inscribed_in_the_cone(make_problem):
    """Eqs. (16), (27): |f_x|, |f_y| <= mu F_n / sqrt(2); at the pyramid's corners the cone is met exactly.

    Read with the printed sign of the mu term, no force with F_n > 0 would be admissible."""
    problem = make_problem()
    forces = problem.forces([9.0, 5.0, 4.0], [[1, 1], [-1, 1], [0.5, -1]])
    assert forces[0, 0] == pytest.approx(0.7 * 9 / np.sqrt(2))
    tangential = np.hypot(forces[:, 0], forces[:, 1])
    assert tangential[:2] == pytest.approx(0.7 * forces[:2, 2])
    assert tangential[2] < 0.7 * forces[2, 2]


def test_residual_is_the_equilibrium_of_equation_15(make_problem):
    problem = make_problem(balance="wrench")
    k = np.random.default_rng(0).uniform(-1, 1, (3, 2))
    H, b = least_squares(problem, PUBLISHED_FORCES)
    wrench = problem.residual(problem.forces(PUBLISHED_FORCES, k))
    assert np.allclose(np.concatenate([wrench[:3], wrench[3:] / problem.moment_length]), H @ k.ravel() + b, atol=1e-13)
    assert problem.load[2] == pytest.approx(-1.02 * 9.81)


def test_acceleration_inverts_equation_26(make_problem):
    problem = make_problem()
    A = np.array([0.1, 0.5, 0.9])
    assert problem.acceleration(problem.normal_force(A, 0.9), 0.9) == pytest.approx(A, rel=1e-13)
    assert problem.normal_force(0.5, 0.9) == pytest.approx(5e4 * (0.5 / 2 * 0.01) ** 1.5)


@given(st.integers(0, 500))
def test_support_bounds_every_choice_of_multipliers(seed):
    problem, normal = random_problem(seed)
    rng = np.random.default_rng(seed)
    y = rng.normal(size=problem.rows)
    y /= np.linalg.norm(y)
    bound = normal @ problem.support(y) + y @ problem.scaled_load
    H, b = least_squares(problem, normal)
    for k in rng.choice([-1.0, 1.0, 0.3], (50, 2 * problem.k)):
        assert y @ (H @ k + b) >= bound - 1e-9
    corner = -np.sign(H.T @ y)
    assert y @ (H @ corner + b) == pytest.approx(bound, abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mu": -0.1}, "friction"),
        ({"mu": np.nan}, "finite"),
        ({"mu": [0.5, 0.5]}, "shape"),
        ({"balance": "moments"}, "balance"),
        ({"measure": "energy"}, "measure"),
        ({"final_time": 0.0}, "final time"),
        ({"impact_time_range": (0.95, 0.8)}, "lower <= upper"),
        ({"impact_time_range": (0.8, 1.0)}, "below the final time"),
        ({"acceleration_range": (0.0, 1.0)}, "acceleration range"),
        ({"max_speed": -1}, "maximum speed"),
        ({"max_depth": float("inf")}, "maximum depth"),
        ({"moment_length": 0}, "moment length"),
        ({"gravity_o": [0, 0]}, "gravity"),
    ],
)
def test_bad_problems_are_refused(make_problem, settings, message):
    with pytest.raises(InvalidInput, match=message):
        make_problem(**settings)


# -- the QP over the multipliers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", QP_SOLVERS)
@pytest.mark.parametrize(
    ("mu", "left", "tolerance"), [(0.7, 0.0801, 5e-5), (0.693, 0.0893, 5e-5), (0.8, 0.0, 1e-9), (0.77, 0.0, 1e-9)]
)
def test_published_forces(make_problem, solver, mu, left, tolerance):
    """At the printed normal forces the QP leaves 0.0801 N at mu = 0.7, the published 0.089 N at 0.693, nothing at 0.8."""
    solution = refine_multipliers(make_problem(mu=mu), PUBLISHED_FORCES, solver=solver)
    assert solution.certificate.residual_norm == pytest.approx(left, abs=tolerance)
    assert solution.status is (Status.OK if left == 0 else Status.UNBALANCED)
    assert solution.solver == solver


@pytest.mark.parametrize("solver", QP_SOLVERS)
def test_multipliers_against_scipy_on_random_problems(solver):
    balanced = 0
    for seed in range(60):
        problem, normal = random_problem(seed)
        H, b = least_squares(problem, normal)
        oracle = lsq_linear(H, -b, (-1, 1), tol=1e-14, lsq_solver="exact", method="bvls")
        least = np.linalg.norm(H @ oracle.x + b)
        solution = refine_multipliers(problem, normal, solver=solver)
        assert solution.status in (Status.OK, Status.UNBALANCED)
        assert solution.certificate.residual_norm == pytest.approx(least, rel=1e-6, abs=1e-8)
        assert solution.certificate.lower_bound <= least + 1e-9
        assert np.abs(solution.multipliers).max() <= 1
        assert np.allclose(solution.certificate.residual, problem.residual(solution.forces_c))
        balanced += solution.status is Status.OK
    assert 3 <= balanced <= 57


def test_multipliers_have_least_norm(make_problem):
    for solver in QP_SOLVERS:
        for settings in ({"mu": 0.8}, {"mu": 1.0, "balance": "force"}):
            problem = make_problem(**settings)
            k = cp.Variable(6)
            H, b = least_squares(problem, PUBLISHED_FORCES)
            oracle = cp.Problem(cp.Minimize(cp.sum_squares(k)), [H @ k == -b, cp.abs(k) <= 1])
            oracle.solve(solver=cp.CLARABEL)
            found = refine_multipliers(problem, PUBLISHED_FORCES, solver=solver)
            assert np.linalg.norm(found.multipliers) == pytest.approx(np.sqrt(oracle.value), rel=1e-6)


def test_published_forces_do_not_balance_moments(make_problem):
    """Six rows fix the six tangential forces; the friction they need is read off a plain linear solve."""
    problem = make_problem(balance="wrench", mu=1.0)
    H, b = least_squares(problem, PUBLISHED_FORCES)
    needed = np.abs(np.linalg.solve(H, -b)).max()
    assert needed > 5
    for mu, status in ((0.99 * needed, Status.UNBALANCED), (1.01 * needed, Status.OK)):
        assert refine_multipliers(make_problem(balance="wrench", mu=mu), PUBLISHED_FORCES).status is status


def test_frictionless_and_zero_forces(make_problem):
    for settings, normal in (({"mu": 0.0}, PUBLISHED_FORCES), ({}, (0.0, 0.0, 0.0))):
        solution = refine_multipliers(make_problem(**settings), normal)
        assert solution.status is Status.UNBALANCED and np.all(solution.multipliers == 0)
        assert np.all(np.isfinite(solution.forces_c)) and solution.certificate.residual_norm > 1


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_multipliers_do_not_depend_on_the_unit_of_force(make_problem, scale):
    problem = replace(make_problem(mu=0.7), load=make_problem().load * scale)
    solution = refine_multipliers(problem, np.array(PUBLISHED_FORCES) * scale)
    assert solution.certificate.residual_norm / scale == pytest.approx(0.0801, abs=5e-5)


def test_duplicate_and_collinear_contacts():
    shape = Cylinder(radius=0.02, height=0.1, mass=0.2)
    line = [[0.02, 0, 0], [0.02, 0, 0], [-0.02, 0, 0.01], [-0.02, 0, -0.01]]
    problem = ForceProblem.holding(
        shape, contacts_at(None, shape, line), mu=0.8, balance="wrench", friction=Friction(), max_depth=5e-3
    )
    for solver in QP_SOLVERS:
        assert refine_multipliers(problem, [2, 2, 2, 2], solver=solver).status is Status.OK


def test_misspelt_arguments_are_named():
    shape = Sphere(radius=0.03, mass=0.2)
    contacts = contacts_at(None, shape, [[0.03, 0, 0], [-0.03, 0, 0]])
    for argument in ("balence", "load"):
        with pytest.raises(TypeError, match=f"'{argument}'.* balance, "):
            ForceProblem.holding(shape, contacts, mu=0.7, **{argument: "wrench"})


def test_bad_normal_forces_and_solvers_are_refused(make_problem):
    for normal, message in (([1, 2], "shape"), ([1, 2, -3], ">= 0"), ([1, 2, np.nan], "finite")):
        with pytest.raises(InvalidInput, match=message):
            refine_multipliers(make_problem(), normal)
    with pytest.raises(InvalidInput, match="did you mean 'daqp'"):
        refine_multipliers(make_problem(), PUBLISHED_FORCES, solver="dqap")


def test_a_solver_that_lies_is_caught(make_problem, monkeypatch):
    """A wrong answer or none at all never passes for the minimum."""
    for answer in (lambda n: np.full(n, 0.5), lambda n: None):
        monkeypatch.setattr(multipliers_module, "solve_qp", lambda solver, P, q, answer=answer, **kw: answer(len(q)))
        assert refine_multipliers(make_problem(), PUBLISHED_FORCES).status is Status.INACCURATE


def test_tolerances_are_passed_to_every_solver():
    P, q = np.diag([2.0, 1.0]), np.array([-2.0, 3.0])
    for solver in QP_SOLVERS:
        assert solver == "quadprog" or TOLERANCES[solver]
        x = solve_qp(solver, P, q, lb=np.array([-1.0, -1.0]), ub=np.array([1.0, 1.0]))
        assert np.allclose(x, [1, -1], atol=1e-9)


# -- the searches ------------------------------------------------------------------------------------------------------


def convex_optimum(problem, impact_time, measure):
    """Independent convex solution (CVXPY, Clarabel): forces as variables; returns (objective in mJ or N s, F_n)."""
    tau, law, k = 1 - impact_time, problem.compliance, problem.k
    from math import gamma

    f = cp.Variable((k, 3))
    F = f[:, 2]
    if measure == "work":
        beta = gamma(1.5) * gamma(2.5) / gamma(4.0)
        energy = law.stiffness ** (-2 / 3) * cp.sum(cp.power(F, 5 / 3))
        energy += 2 * 2.5 * law.damping * beta / tau * law.stiffness ** (-7 / 3) * cp.sum(cp.power(F, 7 / 3))
    else:
        c = 2.5 * gamma(2.5) * gamma(0.5) / gamma(3.0) / 2
        energy = law.damping * law.stiffness ** (-5 / 3) * cp.sum(cp.power(F, 5 / 3)) + c * tau * cp.sum(F)
    scale = np.diag([1, 1, 1] + [1 / problem.moment_length] * 3)[: problem.rows]
    wrench = problem.contacts.G @ cp.reshape(f, 3 * k, order="C") + problem.load
    reach = law.stiffness * min(problem.acceleration_range[1] * tau**2 / 2, problem.max_depth) ** 1.5
    constraints = [scale @ wrench == 0, reach >= F]
    constraints += [cp.abs(f[:, axis]) <= cp.multiply(problem.pyramid, F) for axis in (0, 1)]
    task = cp.Problem(cp.Minimize(1e3 * energy), constraints)
    task.solve(solver=cp.CLARABEL)
    return task.value * (1 if measure == "work" else 1e-3), F.value


@pytest.mark.parametrize(("balance", "work_mJ", "within"), [("force", 55.78, 0.01), ("wrench", 57.09, 0.03)])
def test_hybrid_reaches_the_convex_work(make_problem, balance, work_mJ, within):
    problem = make_problem(balance=balance, measure="work")
    optimum, _ = convex_optimum(problem, 0.90, "work")
    assert optimum == pytest.approx(work_mJ, abs=0.006)
    found = grid_search(problem)
    assert found.status is Status.OK
    assert 0.999 * optimum <= 1e3 * found.work <= (1 + within) * optimum
    assert found.residual_force < 1e-9 and (balance == "force" or found.residual_moment < 1e-9)


def test_hybrid_chooses_the_published_impact_time(make_problem):
    found = grid_search(make_problem(measure="impulse"))
    assert found.impact_time == 0.90
    assert found.impulse == pytest.approx(2.977, abs=0.001)
    assert found.normal_forces.sum() == pytest.approx(20.216, abs=0.005)
    assert 1e3 * found.profile.final_depth.max() == pytest.approx(3.33, abs=0.06)
    late = grid_search(make_problem(measure="impulse"), GridSpec(impact_times=[0.95]))
    assert late.status is Status.INFEASIBLE and not late.found


def test_energies_at_the_published_forces(make_problem):
    problem = make_problem()
    assert 1e3 * problem.energy(PUBLISHED_FORCES, 0.90, "work").sum() == pytest.approx(59.24, abs=0.005)
    assert problem.energy(PUBLISHED_FORCES, 0.90, "impulse").sum() == pytest.approx(3.081, abs=0.0005)


def test_paper_search_meets_its_limit_and_the_qp_cannot_leave_its_cell(make_problem):
    problem, grid = make_problem(), GridSpec()
    paper = grid_search(problem, grid, search="paper")
    assert paper.status is Status.OK and paper.impact_time == 0.90
    assert paper.residual_force <= grid.residual_limit
    lattice = (paper.multipliers + 1) / 0.1
    assert np.abs(lattice - np.round(lattice)).max() < 1e-9
    refined = grid_search(problem, grid, search="paper+qp")
    assert np.array_equal(refined.normal_forces, paper.normal_forces)
    assert refined.residual_norm <= paper.residual_norm + 1e-12
    assert refined.status is Status.UNBALANCED  # the cheapest cell uses the limit
    hybrid = grid_search(problem, grid)
    assert hybrid.impulse >= paper.impulse and hybrid.residual_force < 1e-9


def assert_pruned_equals_brute(problem, grid):
    """Same optimum, ties included, same verdict; every cell accounted for."""
    brute, fast = (grid_search(problem, grid, search="paper", method=method) for method in ("brute", "pruned"))
    assert brute.status is fast.status
    assert brute.grid.points == fast.grid.points == grid.points(problem.k)
    for found in (brute, fast):
        assert sum(found.grid.rejections.values()) + found.found == found.grid.cells
    for reason in ("impact time range (Eq. 14)", "deceleration range (Eq. 13c)", "impact speed (Eq. 13b)"):
        assert brute.grid.rejections[reason] == fast.grid.rejections[reason]
    if brute.found:
        assert brute.impact_time == fast.impact_time
        assert np.array_equal(brute.acceleration, fast.acceleration)
        assert np.array_equal(brute.multipliers, fast.multipliers)


@pytest.mark.parametrize("seed", range(120))
def test_pruned_search_equals_brute_force(seed):
    rng = np.random.default_rng(seed)
    k = 1 + seed % 3
    if seed % 4 == 0:  # symmetric contacts: ties in measure and in multipliers
        angles = 2 * np.pi * np.arange(k) / k
        heights = np.zeros(k)
    else:
        angles, heights = rng.uniform(0, 2 * np.pi, k), rng.uniform(-0.02, 0.02, k)
    shape = Cylinder(radius=0.02, height=0.1, mass=rng.uniform(0.05, 1.2))
    points = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), heights])
    problem = ForceProblem.holding(
        shape,
        contacts_at(None, shape, points),
        mu=rng.uniform(0.3, 1.2),
        balance=("force", "wrench")[seed % 2],
        measure=("impulse", "work")[seed // 2 % 2],
        compliance=MarhefkaOrin(exponent=rng.choice([1.0, 1.5, 2.2]), stiffness=rng.choice([5e3, 5e4])),
        max_speed=rng.choice([0.1, 2.0]),
        friction=Friction(),
        max_depth=5e-3,
    )
    low = rng.choice([-1.0, 0.0])
    grid = GridSpec(
        accelerations=np.linspace(0.05, 1.1, int(rng.integers(2, 7))),
        multipliers=np.linspace(low, 1, int(rng.integers(2, 6))),
        impact_times=[0.7, 0.8, 0.85, 0.9, 0.95],
        residual_limit=rng.choice([0.05, 0.5, 2.0, 5.0]),
    )
    assert_pruned_equals_brute(problem, grid)


def test_brute_force_is_a_plain_loop():
    """The oracle itself against nested Python loops, on a grid small enough for them."""
    from itertools import product

    shape = Cylinder(radius=0.02, height=0.1, mass=0.1)
    problem = ForceProblem.holding(
        shape,
        contacts_at(None, shape, [[0.02, 0, 0], [-0.02, 0, 0]]),
        mu=0.9,
        compliance=MarhefkaOrin(stiffness=5e3),
        friction=Friction(),
        max_depth=5e-3,
    )
    grid = GridSpec(
        impact_times=[0.8, 0.9], accelerations=[0.1, 0.2, 0.4, 0.8], multipliers=[-1, -0.3, 0.4, 1], residual_limit=0.6
    )
    best = None
    for t_I in grid.impact_times:
        for A in product(grid.accelerations, repeat=2):
            tau = 1 - t_I
            if any(a * tau > 2 or a * tau**2 / 2 > 5e-3 for a in A):
                continue
            F = np.array([5e3 * (a * tau**2 / 2) ** 1.5 for a in A])
            measure = sum(problem.energy(F, t_I))
            for k in product(grid.multipliers, repeat=4):
                force = problem.load.copy()
                for contact, f, (k1, k2) in zip(problem.contacts, F, (k[:2], k[2:])):
                    h = contact.rotation_oc @ [k1 * 0.9 / 2**0.5 * f, k2 * 0.9 / 2**0.5 * f, f]
                    force += np.concatenate([h, np.cross(contact.point_o - shape.com_o, h)])
                left = np.linalg.norm([*force[:3], *(force[3:] / problem.moment_length)])
                if left <= 0.6 and (best is None or measure < best[0] * (1 - 1e-12)):
                    best = (measure, t_I, A, k)
    found = grid_search(problem, grid, search="paper", method="brute")
    assert best is not None and found.impact_time == best[1]
    # Both follow from the forces, so a point of the grid comes back with the rounding of that.
    assert found.acceleration == pytest.approx(best[2], rel=1e-12)
    assert found.multipliers.ravel() == pytest.approx(best[3], rel=1e-12)


@pytest.mark.slow
def test_blocks_do_not_change_the_result(monkeypatch):
    """Four contacts, with the memory bound so low that the search splits into thousands of blocks."""
    shape = Cylinder(radius=0.02, height=0.1, mass=0.5)
    angles = np.array([0.1, 1.8, 3.3, 4.9])
    points = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), [0.01, -0.01, 0.0, 0.02]])
    problem = ForceProblem.holding(
        shape, contacts_at(None, shape, points), mu=0.6, balance="force", friction=Friction(), max_depth=5e-3
    )
    grid = GridSpec(accelerations=np.linspace(0.05, 1, 9), multipliers=np.linspace(-1, 1, 3), residual_limit=0.5)
    whole = grid_search(problem, grid, search="paper")
    hybrid = grid_search(problem, grid)
    monkeypatch.setattr(pruned, "_PREFIXES", 5)
    split, split_hybrid = grid_search(problem, grid, search="paper"), grid_search(problem, grid)
    brute = grid_search(problem, grid, search="paper", method="brute")
    assert whole.found and hybrid.found
    for a, b in ((whole, split), (whole, brute), (hybrid, split_hybrid)):
        assert a.impact_time == b.impact_time and np.array_equal(a.acceleration, b.acceleration)
        assert sum(b.grid.rejections.values()) + 1 == b.grid.cells


@pytest.mark.parametrize("balance", ["force", "wrench"])
def test_a_grid_of_7e13_points(make_problem, balance):
    grid = GridSpec(accelerations=np.linspace(0.01, 1, 60))
    problem = make_problem(balance=balance)
    assert grid.points(3) > 7e13
    found = grid_search(problem, grid, search="paper")
    if balance == "force":
        assert found.status is Status.OK and found.residual_force <= grid.residual_limit
    else:
        assert found.status is Status.INFEASIBLE and "search='hybrid'" in found.explain()


@pytest.mark.slow
def test_five_contacts_stay_within_memory():
    """2.4e9 cells in four blocks of one million prefixes at most."""
    import tracemalloc

    rng = np.random.default_rng(5)
    shape = Cylinder(radius=0.02, height=0.1, mass=0.4)
    angles = np.linspace(0, 2 * np.pi, 6)[:5] + rng.uniform(-0.2, 0.2, 5)
    points = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), rng.uniform(-0.03, 0.03, 5)])
    problem = ForceProblem.holding(
        shape, contacts_at(None, shape, points), mu=0.6, balance="wrench", friction=Friction(), max_depth=5e-3
    )
    tracemalloc.start()
    found = grid_search(problem, GridSpec(accelerations=np.linspace(0.05, 1, 60), impact_times=[0.9]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.status is Status.OK and found.residual_norm < 1e-9
    assert peak < 2**28


@pytest.mark.slow
def test_lattice_search_finds_the_first_point():
    """Against listing the lattice: two contacts, both balances."""
    for seed in range(30):
        problem, normal = random_problem(seed, k=2)
        values = np.linspace(-1, 1, 5)
        columns = problem.scaled_columns
        tangential = columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]
        grid = GridSpec(multipliers=values)
        from pinograsp.forces.grid.cells import options

        listed = []
        for index in np.ndindex(5, 5, 5, 5):
            k = values[list(index)].reshape(2, 2)
            net = problem.residual(problem.forces(normal, k))
            listed.append((problem.scaled_norm(net), index))
        limit = float(np.quantile([left for left, _ in listed], 0.02))
        expected = next((i for left, i in listed if left <= limit), None)
        found = first_on_lattice(options(problem, grid), normal, problem.scaled_load, values, tangential, limit)
        assert found is not None and tuple(found.ravel()) == expected


def test_refining_the_grid_never_raises_the_optimum(make_problem):
    """A metamorphic check: each grid contains the one before."""
    for balance in ("force", "wrench"):
        problem = make_problem(balance=balance, measure="work", mu=0.9)
        previous = np.inf
        for step in (0.09, 0.03, 0.01, 0.005):
            found = grid_search(problem, GridSpec(accelerations=grid_values(0.01, 1.0, step)))
            if found.found:
                assert found.work <= previous * (1 + 1e-12)
                previous = found.work
        optimum = min(convex_optimum(problem, t, "work")[0] for t in (0.8, 0.85, 0.9))
        assert np.isfinite(previous) and 1e3 * previous >= 0.999 * optimum


def test_order_of_contacts_does_not_matter(cylinder):
    points = np.array([[-2.6, -9.6, 61.5], [4.7, 8.8, 71.0], [1.7, 9.7, 50.0]]) * 1e-3
    energies = set()
    for order in ([0, 1, 2], [2, 0, 1], [1, 0, 2]):
        problem = ForceProblem.holding(
            cylinder,
            contacts_at(None, cylinder, points[order]),
            mu=0.7,
            measure="work",
            friction=Friction(),
            max_depth=5e-3,
        )
        energies.add(round(grid_search(problem).work, 14))
    assert len(energies) == 1


def test_infeasible_load_explains_itself(make_problem):
    problem = replace(make_problem(), load=np.array([0, 0, -500.0, 0, 0, 0]))
    for search in ("hybrid", "paper", "paper+qp"):
        found = grid_search(problem, search=search)
        assert found.status is Status.INFEASIBLE and found.acceleration.size == 0
        assert "closest to balance" in found.explain() and "Eq. 13a" in found.explain()
        with pytest.raises(InvalidInput, match="found no forces"):
            _ = found.profile


@pytest.mark.slow
def test_ctrl_c_returns_what_there_is(make_problem, monkeypatch):
    calls = []

    def interrupt(*args, **kwargs):
        calls.append(1)
        if len(calls) > 2:
            raise KeyboardInterrupt
        return refine_multipliers(*args, **kwargs)

    monkeypatch.setattr(pruned, "refine_multipliers", interrupt)
    found = grid_search(make_problem())
    assert found.status is Status.INTERRUPTED and not found.found

    from pinograsp.forces.grid import cells as grid_module

    real = grid_module._first_hits
    monkeypatch.setattr(
        grid_module, "_first_hits", lambda *a: real(*a) if len(calls) < 40 and not calls.append(1) else _stop()
    )
    small = GridSpec(accelerations=np.linspace(0.3, 1, 9), multipliers=np.linspace(-1, 1, 7), residual_limit=2.0)
    found = grid_search(make_problem(mu=0.9), small, search="paper", method="brute")
    assert found.status is Status.INTERRUPTED


def _stop():
    raise KeyboardInterrupt


def test_progress_bar_is_drawn_when_asked_for(make_problem, capsys):
    grid_search(make_problem(), GridSpec(accelerations=np.linspace(0.1, 1, 9)), progress=True)
    assert "hybrid search" in capsys.readouterr().err
    grid_search(make_problem(), GridSpec(accelerations=np.linspace(0.1, 1, 9)))
    assert capsys.readouterr().err == ""  # not a terminal


def test_grid_values_end_where_they_should():
    values = grid_values(0.01, 1.0, 0.005)
    assert values.size == 199 and values[-1] == 1.0 and values[0] == 0.01
    assert grid_values(0.8, 0.95, 0.05).tolist() == [0.8, 0.85, 0.9, 0.95]
    assert grid_values(0.0, 1.0, 0.3).tolist() == [0.0, 0.3, 0.6, 0.9]
    assert grid_values(1.0, 0.0, 0.1).size == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"accelerations": []}, "empty grid"),
        ({"impact_times": grid_values(0.9, 0.8, 0.1)}, "empty grid"),
        ({"multipliers": [0.5, 0.2]}, "increasing"),
        ({"multipliers": [-2.0, 0]}, r"\[-1, 1\]"),
        ({"accelerations": [0.0, 1.0]}, "> 0"),
        ({"accelerations": [np.nan]}, "finite"),
        ({"residual_limit": -1}, "residual limit"),
    ],
)
def test_bad_grids_are_refused(settings, message):
    with pytest.raises(InvalidInput, match=message):
        GridSpec(**settings)


def test_unknown_searches_are_refused(make_problem):
    for options in ({"search": "all"}, {"method": "magic"}, {"solver": "gurobi"}):
        with pytest.raises(InvalidInput, match="expected one of"):
            grid_search(make_problem(), **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(6))
def test_pruned_search_equals_brute_force_on_larger_grids(kind, often):
    """Both balances with each of three limits of the residual, four times."""
    for seed in range(kind, 24, 6)[: often(4)]:
        rng = np.random.default_rng(1000 + seed)
        angles = np.sort(rng.uniform(0, 2 * np.pi, 3))
        shape = Cylinder(radius=0.02, height=0.1, mass=rng.uniform(0.1, 0.8))
        points = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), rng.uniform(-0.02, 0.02, 3)])
        problem = ForceProblem.holding(
            shape,
            contacts_at(None, shape, points),
            mu=rng.uniform(0.5, 1.0),
            balance=("force", "wrench")[seed % 2],
            friction=Friction(),
            max_depth=5e-3,
        )
        grid = GridSpec(
            accelerations=np.linspace(0.1, 1, 8),
            multipliers=np.linspace(-1, 1, 6),
            residual_limit=(0.2, 1.0, 0.05)[seed % 3],
        )
        assert_pruned_equals_brute(problem, grid)
