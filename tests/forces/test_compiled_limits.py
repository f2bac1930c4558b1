"""Torque rows, pyramids of many edges and the largest force in the core, against linear and cone programs of others."""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog
from whole_forces import problem_with

from pinograsp.contacts import Friction
from pinograsp.errors import Status
from pinograsp.forces import ForceProblem, ForceSolver, load_factor, optimize_forces, to_qp, to_socp
from pinograsp.forces.solve.solver_order import SolverOrder
from pinograsp.forces.torque_limits import TorqueLimits

T_I = 0.85
FRESH = int(np.random.default_rng().integers(10**6))
PYRAMIDS = (4, 6, 8, 16)
TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


@pytest.fixture
def compiled_alone(monkeypatch):
    """The general methods are not asked."""
    monkeypatch.setattr(SolverOrder, "solve", lambda *_, **__: pytest.fail("the general method was asked"))


def limits(k: int, share: float, rng) -> TorqueLimits:
    """Fingers of three joints, one for each contact, with weak motors and gravity."""
    jacobian = np.zeros((k, 6, 3 * k))
    for i in range(k):
        jacobian[i, :, 3 * i : 3 * i + 3] = rng.normal(size=(6, 3)) * 0.05
    return TorqueLimits(jacobian=jacobian, bias=rng.uniform(-0.01, 0.01, 3 * k), limit=np.full(3 * k, share))


def problems(k: int, count: int, edges: int, share: float | None):
    """Random problems, some of which hold and some do not; ``share``: size of the torque limits [N m]."""
    rng = np.random.default_rng(FRESH)
    for i in range(count):
        problem = problem_with("pyramid", k, FRESH + i)
        torques = None if share is None else limits(k, share * float(np.exp(rng.normal())), rng)
        load = problem.load * float(np.exp(rng.normal()))
        yield replace(problem, load=load, friction=Friction(edges=edges), torques=torques)


def by_highs(problem: ForceProblem, objective: str = "peak"):
    """HiGHS's answer to the linear program, whose objective is the largest F_n."""
    qp = to_qp(problem, T_I, objective=objective)
    bounds = np.column_stack([qp.lb, qp.ub])
    return qp, linprog(qp.q, qp.G, qp.h, qp.A, qp.b, bounds, method="highs", options=TIGHT)


def by_clarabel(problem: ForceProblem, objective: str) -> tuple[str, float]:
    socp = to_socp(problem, T_I, objective=objective)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(
        sp.csc_matrix(sp.triu(socp.P)), socp.q, socp.A, socp.b, socp.cones.clarabel(), settings
    ).solve()
    return str(found.status), found.obj_val * socp.objective_scale + socp.constant


@pytest.mark.parametrize("share", [None, 0.05])
@pytest.mark.parametrize("edges", PYRAMIDS)
@pytest.mark.parametrize("k", [3, 7, 15])
def test_the_least_largest_force_is_that_of_highs(k, edges, share):
    for problem in problems(k, 4, edges, share):
        qp, known = by_highs(problem)
        assert known.status in (0, 2), FRESH
        found = optimize_forces(problem, T_I, objective="peak")
        if known.status == 2:
            assert found.status is Status.INFEASIBLE, FRESH
            continue
        assert found.status is Status.OK, FRESH
        assert found.certificate.objective == pytest.approx(known.fun * qp.objective_scale, rel=1e-6), FRESH
        assert found.normal_forces.max() == pytest.approx(found.certificate.objective, rel=1e-9)
        assert found.certificate.is_optimal()


def test_the_least_largest_force_is_hardly_ever_asked_of_the_general_method():
    """Some programs are too degenerate for interior points, with torque limits many: then DAQP answers."""
    solvers = []
    for k in (3, 7, 15):
        for edges in PYRAMIDS:
            for problem in problems(k, 40, edges, None):
                found = optimize_forces(problem, T_I, objective="peak")
                if found.status is Status.OK:
                    solvers.append(found.solver)
    # 4 of 66,000 such problems were.
    assert solvers.count("interior") >= max(0.99 * len(solvers), 200), FRESH


@pytest.mark.parametrize("objective", ["least_squares", "work"])
@pytest.mark.parametrize("edges", PYRAMIDS)
@pytest.mark.parametrize("k", [3, 15])
def test_torque_rows_and_edges_have_clarabels_optimum(compiled_alone, k, edges, objective):
    for problem in problems(k, 5, edges, 0.05):
        status, value = by_clarabel(problem, objective)
        found = optimize_forces(problem, T_I, objective=objective)
        # Of 1,000 such problems Clarabel leaves two without an answer; HiGHS says whether these hold.
        holds = status.endswith("Solved") or (status == "InsufficientProgress" and by_highs(problem)[1].status == 0)
        assert (found.status is Status.OK) == holds, (FRESH, status)
        if found.status is Status.OK:
            assert found.solver in ("newton", "interior") and found.certificate.is_optimal()
            if status.endswith("Solved"):
                close = 1e-5 if status == "Solved" else 1e-4
                assert found.certificate.objective == pytest.approx(value, rel=close), (FRESH, status)
            torque = problem.torques.torques(np.einsum("kij,kj->ki", problem.contacts.rotations_oc, found.forces_c))
            assert np.all(np.abs(torque) <= problem.torques.usable * (1 + 1e-6) + 1e-9)


@pytest.mark.parametrize("edges", [4, 8])
@pytest.mark.parametrize("limited", [False, True])
def test_up_to_the_largest_load(edges, limited):
    """Answers a little below the largest load that is held, proofs a little above it."""
    for problem in problems(5, 3, edges, 0.2 if limited else None):
        largest = load_factor(problem, impact_time=T_I)
        if largest is None or not 1e-2 < largest < 1e3:
            continue
        for off in (1e-2, 1e-4, 1e-6):
            solver = ForceSolver(problem, T_I, objective="least_squares")
            assert solver.solve((1 - off) * largest * problem.load).status is Status.OK, FRESH
            assert solver.solve((1 + off) * largest * problem.load).status is Status.INFEASIBLE, FRESH


@pytest.mark.parametrize("edges", PYRAMIDS)
@pytest.mark.parametrize("k", [3, 8, 20])
def test_proofs_with_torque_limits_are_sharp(compiled_alone, k, edges):
    """What a proof says holds for all admissible forces (HiGHS finds the least of it), and the closest forces miss
    balance and torque limits by no more.
    """
    proven = 0
    for problem in problems(k, 60, edges, 0.01):
        if proven > 3:
            break
        found = optimize_forces(problem, T_I, objective="least_squares")
        if found.status is Status.OK:
            continue
        proof, own = found.infeasibility, problem.torques
        proven += 1
        # direction . r + weights . tau - |weights| . limit, in newtons of the contact forces x.
        qp, _ = by_highs(problem)
        n, force = 3 * k, qp.force_scale
        widths = np.array([column.scale for column in qp.columns[:n]]).reshape(k, 3)
        rotations = problem.contacts.rotations_oc
        world = np.einsum("kij,kj->kij", rotations, widths)  # per unit of x
        torque = np.einsum("kxn,kxj->nkj", own.jacobian[:, :3], world).reshape(len(own.limit), n)
        weights = proof.direction @ (qp.A[:, :n] * force) + proof.joint_weights @ torque
        fixed = -(proof.direction @ qp.b) * force + proof.joint_weights @ own.bias
        fixed -= np.abs(proof.joint_weights) @ own.usable
        friction = qp.G[: edges * k, :n]
        within = np.column_stack([qp.lb, qp.ub])[:n]
        # Each of its methods stops at admissible forces a little before the least: the lower is the nearer.
        rows = (weights, friction, qp.h[: edges * k])
        tried = [linprog(*rows, bounds=within, method=f"highs-{how}", options=TIGHT) for how in ("ds", "ipm")]
        least = min((one for one in tried if one.status == 0), key=lambda one: one.fun)
        # It is the difference of two sums, no better known than the larger of them; more than there is, it never claims.
        sums = max(abs(least.fun), abs(fixed))
        assert least.fun + fixed == pytest.approx(proof.margin, rel=1e-6, abs=max(1e-6 * sums, 1e-8 * force)), FRESH
        assert proof.margin <= least.fun + fixed + 1e-8 * force, FRESH
        named = {joint for joint, weight in zip(own.joints, proof.joint_weights) if weight}
        assert set(proof.at_torque) <= named
    assert proven > 3, FRESH
