"""Solvers by name: all that qpsolvers finds, and functions of the caller's own, whose answers are judged."""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np
import pytest
import qpsolvers
from random_grasps import random_grasp
from scipy.optimize import minimize

import pinograsp as pg
from pinograsp import forces
from pinograsp.errors import InvalidInput, Status

T_I = 0.9


@pytest.fixture(scope="module")
def disc():
    body = pg.Cylinder(radius=0.03, height=0.1, mass=0.2)
    angles = np.deg2rad([0, 130, 230])
    points = np.column_stack([0.03 * np.cos(angles), 0.03 * np.sin(angles), [0.01, 0.0, -0.01]])
    return pg.ForceProblem.holding(
        body, pg.contacts_at(None, body, points), mu=0.7, friction=pg.Friction(), max_depth=5e-3
    )


@pytest.fixture
def register():
    """Registers solvers for one test."""
    names = []

    def put(name, function, **options):
        forces.register_solver(name, function, **options)
        names.append(name)

    yield put
    for name in names:
        forces.unregister_solver(name)


def alternating(qp, steps=4000, rho=1.0, sigma=1e-6):
    """A toy ADMM: equations, inequalities and bounds as rows l <= C x <= u; x and multipliers."""
    n = len(qp.q)
    C = np.vstack([qp.A, qp.G, np.eye(n)])
    low = np.concatenate([qp.b, np.full(len(qp.h), -np.inf), qp.lb])
    high = np.concatenate([qp.b, qp.h, qp.ub])
    weight = np.full(len(C), rho)
    weight[: len(qp.b)] *= 1e3
    step = np.linalg.inv(qp.P + sigma * np.eye(n) + C.T @ (weight[:, None] * C))
    x, z, y = np.zeros(n), np.zeros(len(C)), np.zeros(len(C))
    for _ in range(steps):
        x = step @ (sigma * x - qp.q + C.T @ (weight * z - y))
        z = np.clip(C @ x + y / weight, low, high)
        y = y + weight * (C @ x - z)
    p, m = len(qp.b), len(qp.h)
    return forces.SolverAnswer(x, y[:p], y[p : p + m], y[p + m :])


def by_slsqp(qp):
    """SciPy's: x alone."""
    rows = [{"type": "eq", "fun": lambda x: qp.A @ x - qp.b, "jac": lambda x: qp.A}]
    rows.append({"type": "ineq", "fun": lambda x: qp.h - qp.G @ x, "jac": lambda x: -qp.G})
    found = minimize(
        lambda x: (0.5 * x @ qp.P @ x + qp.q @ x, qp.P @ x + qp.q),
        np.zeros(len(qp.q)),
        jac=True,
        method="SLSQP",
        bounds=list(zip(qp.lb, qp.ub)),
        constraints=rows,
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return found.x if found.success else None


def by_clarabel(socp):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    return clarabel.DefaultSolver(socp.P, socp.q, socp.A, socp.b, socp.cones.clarabel(), settings).solve()


@pytest.mark.parametrize("solver", qpsolvers.available_solvers)
@pytest.mark.parametrize("objective", ["least_squares", "work"])
def test_every_solver_that_qpsolvers_finds_is_a_solver(disc, solver, objective):
    assert solver in forces.available_solvers()
    found = pg.optimize_forces(disc, T_I, objective=objective, solver=solver)
    expected = pg.optimize_forces(disc, T_I, objective=objective, solver="clarabel")
    assert found.status is Status.OK and found.certificate.is_optimal()
    assert found.certificate.objective == pytest.approx(expected.certificate.objective, rel=1e-5)


@pytest.mark.parametrize("solver", sorted({*qpsolvers.available_solvers} & {"highs", "osqp", "piqp", "scs"}))
def test_the_answers_are_the_solver_s_own(disc, solver):
    assert pg.optimize_forces(disc, T_I, objective="work", solver=solver).solver == solver


def test_unknown_solvers_are_refused_with_those_that_are_there(disc):
    for call in (
        lambda name: pg.optimize_forces(disc, T_I, solver=name),
        lambda name: pg.optimize_grasp(disc, solver=name),
        lambda name: pg.ForceSolver(disc, T_I, solver=name),
    ):
        with pytest.raises(InvalidInput, match=r"solver: expected one of auto, interior, newton, .*daqp.*did you mean"):
            call("dapq")
    with pytest.raises(InvalidInput, match=r"solver: expected one of .*daqp"):
        pg.grid_search(disc, solver="newton")


@pytest.mark.parametrize(
    ("function", "objective"), [(alternating, "least_squares"), (by_slsqp, "least_squares"), (by_slsqp, "impulse")]
)
def test_a_qp_solver_of_one_s_own(disc, register, function, objective):
    calls = []

    def counted(qp):
        calls.append(qp)
        return function(qp)

    register("mine", counted)
    assert "mine" in forces.available_solvers() and "mine" in forces.qp_solvers()
    found = pg.optimize_forces(disc, T_I, objective=objective, solver="mine")
    expected = pg.optimize_forces(disc, T_I, objective=objective, solver="daqp")
    assert calls and (found.status, found.solver) == (Status.OK, "mine")
    assert found.certificate.objective == pytest.approx(expected.certificate.objective, rel=1e-6)
    # The same function takes what to_qp gives.
    qp = forces.to_qp(disc, T_I, objective="least_squares")
    answer = function(qp)
    assert qp.solution(getattr(answer, "x", answer)).certificate.relative_gap <= 1e-6


def test_everything_that_takes_a_solver_takes_one_s_own(disc, register):
    register("mine", lambda qp: qpsolvers.solve_problem(qpsolvers.Problem(*qp.matrices), solver="piqp", eps_abs=1e-11))
    cheapest = pg.optimize_grasp(disc, objective="work", solver="mine", gap=1e-4)
    assert (cheapest.status, cheapest.solver) == (Status.OK, "mine")
    solver = pg.ForceSolver(disc, T_I, objective="least_squares", solver="mine")
    assert solver.solve(0.5 * disc.load).solver == "mine"
    cone = replace(disc, friction=pg.Friction(model="cone"))
    assert pg.optimize_forces(cone, T_I, objective="least_squares", solver="mine").solver == "mine"
    ours = forces.refine_multipliers(disc, cheapest.normal_forces, solver="mine").certificate
    assert ours.objective == pytest.approx(
        forces.refine_multipliers(disc, cheapest.normal_forces).certificate.objective, abs=1e-8
    )


def test_a_cone_solver_of_one_s_own(disc, register):
    register("mine", by_clarabel, takes="socp")
    register("mine, without multipliers", lambda socp: np.array(by_clarabel(socp).x), takes="socp")
    assert "mine" in forces.available_solvers() and "mine" not in forces.qp_solvers()
    for friction in (pg.Friction(), pg.Friction(model="soft", torsion=4e-3)):
        problem = replace(disc, friction=friction)
        expected = pg.optimize_forces(problem, T_I, objective="work").certificate.objective
        for name in ("mine", "mine, without multipliers"):
            found = pg.optimize_forces(problem, T_I, objective="work", solver=name)
            assert (found.status, found.solver) == (Status.OK, name)
            assert found.certificate.objective == pytest.approx(expected, rel=1e-6)


WRONG = {
    "nothing": lambda program: None,
    "zeros": lambda program: np.zeros(len(program.q)),
    "not a number": lambda program: np.full(len(program.q), np.nan),
    "huge": lambda program: np.full(len(program.q), 1e200),
    "boast": lambda program: forces.SolverAnswer(np.zeros(len(program.q)), *_boast(program)),
}


def _boast(program):
    """Multipliers that would prove anything, if they were believed."""
    if isinstance(program, forces.QuadraticProgram):
        return np.full(len(program.b), 1e6), np.full(len(program.h), 1e6), np.zeros(len(program.q))
    return None, np.full(len(program.b), 1e6)


@pytest.mark.parametrize("takes", ["qp", "socp"])
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_answer_is_never_accepted(disc, register, takes, wrong):
    register("wrong", WRONG[wrong], takes=takes)
    found = pg.optimize_forces(disc, T_I, objective="least_squares", solver="wrong")
    assert found.status is Status.OK and found.solver in ("daqp", "clarabel")
    expected = pg.optimize_forces(disc, T_I, objective="least_squares").certificate.objective
    assert found.certificate.objective == pytest.approx(expected, rel=1e-6)
    hopeless = pg.optimize_forces(disc.with_load(1e6 * disc.load), T_I, objective="least_squares", solver="wrong")
    assert hopeless.status is Status.INFEASIBLE and hopeless.infeasibility.margin > 0


def test_what_a_function_does_wrong_is_said(disc, register):
    def broken(qp):
        raise ZeroDivisionError("mine")

    register("short", lambda qp: [1.0, 2.0])
    register("short multipliers", lambda qp: forces.SolverAnswer(np.zeros(len(qp.q)), y=[1.0], z=np.zeros(len(qp.h))))
    register("text", lambda qp: "solved")
    register("broken", broken)
    for name, match in (("short", "x from solver 'short'.*9"), ("short multipliers", "y from"), ("text", "x from")):
        with pytest.raises(InvalidInput, match=match):
            pg.optimize_forces(disc, T_I, objective="least_squares", solver=name)
    with pytest.raises(ZeroDivisionError, match="mine"):
        pg.optimize_forces(disc, T_I, solver="broken")
    # Cones are solved by QPs that need the last one's multipliers.
    register("alone", lambda qp: alternating(qp).x)
    with pytest.raises(InvalidInput, match="'alone'.*cones.*takes='socp'"):
        pg.optimize_forces(replace(disc, friction=pg.Friction(model="cone")), T_I, solver="alone")


def test_names_are_free_once(disc, register):
    register("mine", alternating)
    for name in ("mine", "auto", "newton", "daqp"):
        with pytest.raises(InvalidInput, match="name that is free"):
            forces.register_solver(name, alternating)
    with pytest.raises(InvalidInput, match="function"):
        forces.register_solver("other", "alternating")
    with pytest.raises(InvalidInput, match="takes"):
        forces.register_solver("other", alternating, takes="lp")
    with pytest.raises(InvalidInput, match="not empty"):
        forces.register_solver(" ", alternating)
    with pytest.raises(InvalidInput, match="registered solver: expected one of mine"):
        forces.unregister_solver("daqp")
    forces.register_solver("brief", alternating)
    forces.unregister_solver("brief")
    assert "brief" not in forces.available_solvers()
    with pytest.raises(InvalidInput, match="solver"):
        pg.optimize_forces(disc, T_I, solver="brief")


def test_a_function_cannot_spoil_what_is_kept(register):
    """It gets its own arrays: after it has overwritten them the same solver still answers right."""

    def spoiled(qp):
        found = qpsolvers.solve_problem(qpsolvers.Problem(*qp.matrices), solver="daqp")
        for array in vars(qp).values():
            array[...] = 1e3
        return found

    register("spoiling", spoiled)
    grasp = random_grasp(3, family="pyramid", torques=True, load="plain", degenerate="")
    solver = pg.ForceSolver(grasp.problem, grasp.impact_time, objective="least_squares", solver="spoiling")
    first, second = solver.solve(), solver.solve()
    assert first.status == second.status and np.array_equal(first.forces_c, second.forces_c)
