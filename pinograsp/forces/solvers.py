"""The only place that calls a QP solver: every tolerance is passed explicitly, none is left to a default."""

from __future__ import annotations

import warnings

import numpy as np
import qpsolvers

from pinograsp.checks import one_of

# ProxQP's and OSQP's own defaults (1e-3 to 1e-5) leave residuals that our certificates refuse; below 1e-10 Clarabel
# stops short on the nearly singular Hessian. OSQP's polishing is off: it prints to stdout whatever `verbose` says.
# DAQP's tolerances bound the violation in multiplier units; quadprog is exact and takes none.
TOLERANCES: dict[str, dict[str, float]] = {
    "daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11},
    "proxqp": {"eps_abs": 1e-11, "eps_rel": 0.0, "max_iter": 10_000},
    "osqp": {"eps_abs": 1e-11, "eps_rel": 0.0, "max_iter": 100_000, "eps_prim_inf": 1e-9, "polishing": False},
    "quadprog": {},
    "piqp": {"eps_abs": 1e-11, "eps_rel": 0.0, "eps_duality_gap_abs": 1e-11, "eps_duality_gap_rel": 0.0},
    "clarabel": {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10},
}
SOLVERS = tuple(TOLERANCES)


def solve_qp(solver: str, P, q, A=None, b=None, lb=None, ub=None) -> np.ndarray | None:
    """min 1/2 x'P x + q'x subject to A x = b, lb <= x <= ub; None where the solver finds no solution.

    The answer is the solver's own word: callers certify it with their own residuals.
    """
    one_of("solver", solver, SOLVERS)
    with warnings.catch_warnings():
        # qpsolvers tells users of dense matrices that OSQP and Clarabel convert them; here they are tiny.
        warnings.simplefilter("ignore")
        x = qpsolvers.solve_qp(P, q, A=A, b=b, lb=lb, ub=ub, solver=solver, **TOLERANCES[solver])
    # proxsuite and piqp hand out views of their own memory.
    return None if x is None or not np.all(np.isfinite(x)) else np.array(x)
