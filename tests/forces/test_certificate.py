"""One rule for when an answer counts, on every path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp import forces
from pinograsp.errors import Status
from pinograsp.forces import TOLERANCE, Tolerance

T_I = 0.85


@pytest.fixture(scope="module")
def certificate():
    body = pg.Cylinder(radius=0.03, height=0.1, mass=0.2)
    points = [[0.03, 0, 0], [-0.015, 0.0259, 0.01], [-0.015, -0.0259, -0.01]]
    problem = pg.ForceProblem.holding(
        body, pg.contacts_at(None, body, points, tolerance=1e-2), mu=0.8, friction=pg.Friction(), max_depth=5e-3
    )
    found = pg.optimize_forces(problem, T_I, objective="least_squares", solver="clarabel")
    assert found.status is Status.OK
    return found.certificate


@pytest.mark.parametrize(
    "change",
    [
        lambda c, share: {"residual_norm": share * TOLERANCE.residual * c.load_size},
        lambda c, share: {"violation": share * TOLERANCE.violation * c.force_size},
        lambda c, share: {"lower_bound": c.objective - share * TOLERANCE.gap * c.objective_size},
    ],
    ids=["residual", "violation", "gap"],
)
def test_each_number_counts_to_its_tolerance(certificate, change):
    assert certificate.is_optimal()
    assert replace(certificate, **change(certificate, 0.99)).is_optimal()
    assert not replace(certificate, **change(certificate, 1.01)).is_optimal()
    # A number that was not computed must not pass, nor must one that is beyond a tolerance of the caller's own.
    assert not replace(certificate, **change(certificate, np.nan)).is_optimal()
    strict = Tolerance(residual=0.5e-9, violation=0.5e-8, gap=0.5e-6)
    assert not replace(certificate, **change(certificate, 0.99)).is_optimal(strict)


def test_a_certificate_tells_what_the_forces_leave(certificate):
    assert certificate.residual.shape == (6,)
    assert certificate.residual_norm <= 1e-9 * certificate.load_size
    assert certificate.residual_force == pytest.approx(np.linalg.norm(certificate.residual[:3]))
    assert certificate.gap == certificate.objective - certificate.lower_bound


@pytest.mark.parametrize("solver", ["newton", "interior", "daqp", "clarabel", "quadprog"])
def test_answers_count_by_the_same_rule_on_every_path(make_problem, solver):
    problem = make_problem(balance="wrench", measure="work")
    single = pg.optimize_forces(problem, T_I, solver=solver)
    assert single.status is Status.OK and single.certificate.is_optimal()
    assert pg.ForceSolver(problem, T_I, solver=solver).solve().certificate.is_optimal()
    best = pg.optimize_grasp(problem, solver=solver, gap=1e-6)
    assert best.status is Status.OK and best.certificate.is_optimal()
    assert best.certificate.lower_bound <= single.certificate.objective * (1 + 1e-9)


def test_batch_robust_and_multipliers_count_by_the_same_rule(make_problem):
    problem = make_problem(balance="wrench", measure="work")
    held = pg.solve_batch(pg.ForceBatch.of([problem, problem.with_load(100 * problem.load)], T_I), objective="work")
    assert held.is_optimal().tolist() == held.ok.tolist() == [True, False]
    assert not held.is_optimal(Tolerance(residual=0.0, violation=0.0, gap=0.0)).any()
    robust = pg.optimize_robust(problem, pg.LoadSet.around(problem.load, mass_range=(0.9, 1.1)), T_I)
    assert robust.status is Status.OK and robust.certificate.is_optimal()
    assert not robust.certificate.is_optimal(Tolerance(gap=-1.0))
    grid = pg.grid_search(problem)
    assert grid.status is Status.OK
    balanced = forces.refine_multipliers(problem, grid.normal_forces)
    assert balanced.status is Status.OK and balanced.certificate.is_optimal()
    slipping = forces.refine_multipliers(replace(problem, mu=0.1), grid.normal_forces)
    assert slipping.status is Status.UNBALANCED and not slipping.certificate.is_optimal()
    assert slipping.certificate.relative_gap <= TOLERANCE.gap
