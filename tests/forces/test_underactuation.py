"""Forces whose joint torques come from fewer drives than joints, against the same programs written in CVXPY."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
import random_grasps

from pinograsp.contacts import Friction
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    LoadSet,
    TorqueLimits,
    Underactuation,
    diagnose,
    optimize_forces,
    optimize_robust,
)

IMPACT, JOINTS = 0.9, 5


def underactuated(seed, rows, *, off=0.0, friction=0.0, stops=None):
    """A random grasp whose torques keep to ``rows`` equations, which some admissible forces do where ``off`` is 0."""
    rng = np.random.default_rng([31, seed])
    problem = random_grasps.random_grasp(seed, family="cone", k=6, torques=False, degenerate="", load="plain").problem
    problem = replace(
        problem,
        balance="wrench",
        max_normal_force=None,
        load=0.2 * problem.load,
        friction=Friction(model="cone", safety=1.2),
    )
    jacobian, bias = 0.05 * rng.normal(size=(6, 6, JOINTS)), 0.02 * rng.normal(size=JOINTS)
    found = optimize_forces(problem, IMPACT, objective="least_squares")
    if found.status is not Status.OK:
        pytest.skip("the drawn load cannot be held at all")
    forces = np.einsum("kxc,kc->kx", problem.contacts.rotations_oc, found.forces_c)
    torques = bias + np.einsum("kxn,kx->n", jacobian[:, :3], forces)
    combinations = rng.normal(size=(rows, JOINTS))
    combinations /= np.linalg.norm(combinations, axis=1)[:, None]
    value = combinations @ torques + off + 1e-3 * rng.normal(size=rows)
    under = Underactuation(rows=combinations, torques=value, why=("a tendon",) * rows, friction=friction, stops=stops)
    limits = TorqueLimits(jacobian=jacobian, bias=bias, limit=np.full(JOINTS, np.inf), underactuation=under)
    return replace(problem, torques=limits)


def in_cvxpy(problem, objective, loads=None):
    """Least cost of forces in cones, written from the definitions; with ``loads`` of the common normal forces."""
    k, contacts, torques = problem.k, problem.contacts, problem.torques
    low, high = problem.normal_force_range(IMPACT)
    mu = problem.mu / problem.friction.safety
    F, conditions, own = cp.Variable(k), [], None
    for load in [problem.load] if loads is None else [problem.load, *loads]:
        tangential = cp.Variable((k, 2))
        forces = cp.vstack([contacts.rotations_oc[i] @ cp.hstack([tangential[i], F[i]]) for i in range(k)])
        arms = contacts.points_o - contacts.com_o
        moments = sum(np.cross(arms[i], np.eye(3)).T @ forces[i] for i in range(k))
        conditions += [cp.sum(forces, axis=0) == -load[:3], moments == -load[3:]]
        conditions += [cp.norm(tangential[i]) <= mu[i] * F[i] for i in range(k)]
        if own is None:
            own = tangential
            tau = torques.bias + sum(torques.jacobian[i, :3].T @ forces[i] for i in range(k))
            if torques.underactuation is not None:
                under = torques.underactuation
                arms = np.array([[np.linalg.norm(row @ J[:3].T) for J in torques.jacobian] for row in under.rows])
                left, borne = under.rows @ tau - under.torques, under.friction * arms @ F
                conditions += [left[i] <= borne[i] for i in range(len(under.rows)) if under.stops[i] != 1]
                conditions += [left[i] >= -borne[i] for i in range(len(under.rows)) if under.stops[i] != -1]
    conditions += [low <= F, high >= F]
    cost = cp.max(F) if objective == "peak" else cp.sum_squares(F) + cp.sum_squares(own)
    program = cp.Problem(cp.Minimize(cost), conditions)
    program.solve(solver=cp.CLARABEL)
    return program.value if program.status == "optimal" else np.inf


@pytest.mark.parametrize(("rows", "friction"), [(1, 0.0), (2, 0.0), (2, 0.01)])
@pytest.mark.parametrize("objective", ["least_squares", "peak"])
@pytest.mark.parametrize("seed", range(6))
def test_least_cost_with_equations_on_the_torques(seed, rows, friction, objective):
    problem = underactuated(seed, rows, off=0.01 if friction else 0.0, friction=friction)
    found, expected = optimize_forces(problem, IMPACT, objective=objective), in_cvxpy(problem, objective)
    if not np.isfinite(expected):
        assert found.status is Status.INFEASIBLE
        return
    assert found.status is Status.OK and found.certificate.is_optimal()
    assert found.certificate.objective == pytest.approx(expected, rel=1e-5)
    forces = np.einsum("kxc,kc->kx", problem.contacts.rotations_oc, found.forces_c)
    under = problem.torques.underactuation
    left = np.abs(under.rows @ problem.torques.torques(forces) - under.torques)
    if friction:
        arms = np.linalg.norm(np.einsum("pn,kxn->pkx", under.rows, problem.torques.jacobian[:, :3]), axis=2)
        left = left - friction * arms @ found.normal_forces
    assert left.max() < 1e-5 * np.linalg.norm(problem.load)


@pytest.mark.parametrize("stops", [(1, -1), (-1, 0), (1, 1)])
@pytest.mark.parametrize("seed", range(6))
def test_joints_at_their_ends_bear_one_side(seed, stops):
    problem = underactuated(seed, 2, off=0.05, friction=0.01, stops=stops)
    found, expected = optimize_forces(problem, IMPACT, objective="peak"), in_cvxpy(problem, "peak")
    if not np.isfinite(expected):
        assert found.status is Status.INFEASIBLE
        return
    assert found.status is Status.OK and found.certificate.objective == pytest.approx(expected, rel=1e-5)
    under = problem.torques.underactuation
    strict = replace(problem.torques, underactuation=replace(under, stops=None))
    assert in_cvxpy(replace(problem, torques=strict), "peak") >= expected - 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_torques_that_no_forces_bring_about_are_proven_so(seed):
    problem = underactuated(seed, 2, off=1e4)
    found = optimize_forces(problem, IMPACT, objective="peak")
    assert found.status is Status.INFEASIBLE and found.infeasibility.margin > 0
    assert not np.isfinite(in_cvxpy(problem, "peak"))
    free = replace(problem, torques=replace(problem.torques, underactuation=None))
    assert optimize_forces(free, IMPACT, objective="peak").status is Status.OK
    assert diagnose(problem, IMPACT)


@pytest.mark.parametrize("seed", range(6))
def test_one_squeeze_for_several_loads_keeps_to_them_under_its_own(seed):
    """The planned forces, not those under a disturbance."""
    problem, rng = underactuated(seed, 1), np.random.default_rng(seed)
    loads = problem.load + 0.1 * np.linalg.norm(problem.load) * rng.normal(size=(4, 6)) * [1, 1, 1, 0.02, 0.02, 0.02]
    found = optimize_robust(problem, LoadSet(loads=loads), IMPACT, objective="peak")
    expected = in_cvxpy(problem, "peak", loads)
    if not np.isfinite(expected):
        assert found.status is not Status.OK
        return
    assert found.status is Status.OK
    assert found.certificate.objective == pytest.approx(expected, rel=1e-5)
    own = found.under(problem.load)
    forces, under = np.einsum("kxc,kc->kx", problem.contacts.rotations_oc, own.forces_c), problem.torques.underactuation
    left = under.rows @ problem.torques.torques(forces) - under.torques
    assert np.abs(left).max() < 1e-5 * np.linalg.norm(problem.load)
    assert np.abs(own.forces_c[:, 2] - found.normal_forces).max() < 1e-9 * found.normal_forces.max()


@pytest.mark.parametrize("seed", range(4))
def test_compiled_and_general_methods_agree(seed):
    problem = underactuated(seed, 2, friction=0.01)
    ours, other = (
        optimize_forces(problem, IMPACT, objective="least_squares", solver=name) for name in ("interior", "clarabel")
    )
    assert (ours.status, ours.solver) == (Status.OK, "interior") and other.solver == "clarabel"
    assert ours.forces_c == pytest.approx(other.forces_c, rel=1e-3, abs=1e-4 * np.abs(other.forces_c).max())


def test_equations_of_the_wrong_size_are_refused():
    with pytest.raises(InvalidInput, match="rows of an underactuation"):
        Underactuation(rows=np.zeros(3), torques=np.zeros(1), why=("x",))
    with pytest.raises(InvalidInput, match="one text per row"):
        Underactuation(rows=np.zeros((2, 3)), torques=np.zeros(2), why=("x",))
    for wrong in ([2], [0.5], [0, 0], "up"):
        with pytest.raises(InvalidInput, match="stops"):
            Underactuation(rows=np.zeros((1, 3)), torques=np.zeros(1), why=("x",), stops=wrong)
    three = Underactuation(rows=np.zeros((1, 3)), torques=np.zeros(1), why=("x",))
    with pytest.raises(InvalidInput, match="expected 4 torques, got 3"):
        TorqueLimits(jacobian=np.zeros((2, 6, 4)), bias=np.zeros(4), limit=np.ones(4), underactuation=three)
    assert isinstance(underactuated(1, 1), ForceProblem)
