"""The only place that calls a QP solver of others: all tolerances are passed explicitly."""

from __future__ import annotations

import warnings
from typing import Any, Literal, get_args

import daqp
import numpy as np
import qpsolvers

from pinograsp.checks import one_of
from pinograsp.spatial import Array

# The defaults of ProxQP and OSQP (1e-3 to 1e-5) leave residuals that the certificates reject; below 1e-10 Clarabel
# stops early on the nearly singular Hessian. OSQP's polishing is off, as it prints to stdout even without `verbose`.
# Its first step size suits Hessians near one: with the default, 0.1, some problems take more than 100,000 steps. DAQP's
# tolerances bound the violation in multiplier units; quadprog is exact and has none.
TOLERANCES: dict[str, dict[str, Any]] = {
    "daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11},
    "proxqp": {"eps_abs": 1e-11, "eps_rel": 0.0, "max_iter": 10_000},
    "osqp": {
        "eps_abs": 1e-11,
        "eps_rel": 0.0,
        "rho": 1.0,
        "max_iter": 100_000,
        "eps_prim_inf": 1e-9,
        "polishing": False,
    },
    "quadprog": {},
    "piqp": {"eps_abs": 1e-11, "eps_rel": 0.0, "eps_duality_gap_abs": 1e-11, "eps_duality_gap_rel": 0.0},
    "clarabel": {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10},
}
SolverName = Literal["daqp", "proxqp", "osqp", "quadprog", "piqp", "clarabel"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)


def solve_qp(
    solver: str,
    P: Array,
    q: Array,
    A: Array | None = None,
    b: Array | None = None,
    lb: Array | None = None,
    ub: Array | None = None,
) -> Array | None:
    """min 1/2 x'P x + q'x subject to A x = b, lb <= x <= ub; None where the solver finds no solution.

    The answer is not checked here: callers certify it with their own residuals.
    """
    one_of("solver", solver, SOLVERS)
    with warnings.catch_warnings():
        # qpsolvers warns that OSQP and Clarabel convert dense matrices; here they are tiny.
        warnings.simplefilter("ignore")
        x = qpsolvers.solve_qp(P, q, A=A, b=b, lb=lb, ub=ub, solver=solver, **TOLERANCES[solver])
    # proxsuite and piqp return views of their own memory.
    return None if x is None or not np.all(np.isfinite(x)) else np.array(x)


def solve_rows(
    solver: str, H: Array, f: Array, C: Array, lower: Array, upper: Array, equalities: int
) -> tuple[Array, Array] | None:
    """min 1/2 x'H x + f'x subject to lower <= (x, C x) <= upper: primal x and multipliers, or None.

    The bounds start with those of the n variables; the last ``equalities`` rows of C are equalities. Multipliers (one
    per bound) are positive at an upper bound, negative at a lower one: H x + f + lam_x + C' lam_rows = 0. DAQP is
    called through its own interface: qpsolvers' conversion costs as much as the solve.
    """
    n, rows = len(f), len(C)
    if solver == "daqp":
        sense = np.zeros(n + rows, dtype=np.int32)
        sense[n + rows - equalities :] = 5
        x, _, flag, info = daqp.solve(H, f, C, upper, lower, sense, eps_prox=0.0, **TOLERANCES["daqp"])
        return (x, info["lam"]) if flag > 0 and np.isfinite(x).all() else None
    split = rows - equalities
    low, high = np.isfinite(lower[n : n + split]), np.isfinite(upper[n : n + split])
    G = np.vstack([C[:split][high], -C[:split][low]])
    h = np.concatenate([upper[n : n + split][high], -lower[n : n + split][low]])
    problem = qpsolvers.Problem(H, f, G, h, C[split:], upper[n + split :], lower[:n], upper[:n])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = qpsolvers.solve_problem(problem, solver=solver, **TOLERANCES[solver])
        except (qpsolvers.ProblemError, qpsolvers.SolverError):  # quadprog: a Hessian that is nearly singular
            return None
    if found.x is None or found.z is None or not np.all(np.isfinite(found.x)):
        return None
    lam = np.zeros(n + rows)
    lam[:n] = found.z_box
    inner, count = lam[n : n + split], int(high.sum())
    inner[high] += found.z[:count]
    inner[low] -= found.z[count:]
    lam[n + split :] = found.y
    return np.array(found.x), lam
