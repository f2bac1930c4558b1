"""The only place that calls a QP solver of others: all tolerances are passed explicitly."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import daqp
import numpy as np
import scipy.sparse as sp

from pinograsp.checks import one_of
from pinograsp.forces.solve.registry import Answered, ask_solver, list_registered
from pinograsp.forces.solve.standard_form import QuadraticProgram
from pinograsp.spatial import Array, BoolArray

if TYPE_CHECKING:
    import qpsolvers

# The defaults of ProxQP and OSQP (1e-3 to 1e-5) leave residuals that the certificates reject; below 1e-10 Clarabel
# stops early on the nearly singular Hessian. OSQP's polishing is off, as it prints to stdout even without `verbose`.
# Its first step size suits Hessians near one: with the default, 0.1, some problems take more than 100,000 steps. DAQP's
# tolerances bound the violation in multiplier units; quadprog is exact and has none. 1e-10 is the least that HiGHS
# takes, and its active sets may cycle without end. Solvers that are not named here run with their defaults.
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
    "ecos": {"abstol": 1e-11, "reltol": 1e-11, "feastol": 1e-11},
    "highs": {
        "primal_feasibility_tolerance": 1e-10,
        "dual_feasibility_tolerance": 1e-10,
        "qp_iteration_limit": 10_000,
    },
    "scs": {"eps_abs": 1e-10, "eps_rel": 0.0, "max_iters": 100_000},
}
# Those that come with the package; all that are there: qp_solvers().
OwnQPSolver = Literal["daqp", "proxqp", "osqp", "clarabel"]
QPSolverName: TypeAlias = OwnQPSolver | str
QP_SOLVERS: tuple[OwnQPSolver, ...] = get_args(OwnQPSolver)
_NO_INFINITY = ("ecos",)  # bounds that are infinite must not be handed to them


def qp_solvers() -> tuple[str, ...]:
    """Return the names of all available QP solvers: those that qpsolvers finds, and registered ones for QPs."""
    import qpsolvers  # slow to import, and brings every solver that is there

    return (*qpsolvers.available_solvers, *list_registered("qp"))


def check_qp_solver(name: object, what: str = "solver") -> str:
    """``name`` if it is a QP solver that is there; else :class:`~pinograsp.errors.InvalidInput`.

    DAQP is: the others are known to qpsolvers, which is slow to import.
    """
    return one_of(what, name, ("daqp",) if isinstance(name, str) and name == "daqp" else qp_solvers())


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
    n = len(q)
    none = np.zeros((0, n)), np.zeros(0)
    rows = none if A is None or b is None else (A, b)
    low, high = np.full(n, -np.inf) if lb is None else lb, np.full(n, np.inf) if ub is None else ub
    if solver == "daqp":
        lower, upper = (np.concatenate([limit, rows[1]]) for limit in (low, high))
        solved = solve_rows(solver, P, q, rows[0], lower, upper, len(rows[1]))
        return None if solved is None else solved[0]
    qp = QuadraticProgram(P=P, q=q, G=none[0], h=none[1], A=rows[0], b=rows[1], lb=low, ub=high)
    found = _solve(solver, qp, only_found=True)
    return None if found is None else found.x


def quadratic(
    H: Array, f: Array, C: Array, lower: Array, upper: Array, equalities: int
) -> tuple[QuadraticProgram, BoolArray, BoolArray]:
    """The QP of :func:`solve_rows`, and which inequality rows of C have an upper and a lower limit: G has these rows,
    in this order.
    """
    n, split = len(f), len(C) - equalities
    low, high = np.isfinite(lower[n : n + split]), np.isfinite(upper[n : n + split])
    G = np.vstack([C[:split][high], -C[:split][low]])
    h = np.concatenate([upper[n : n + split][high], -lower[n : n + split][low]])
    qp = QuadraticProgram(P=H, q=f, G=G, h=h, A=C[split:], b=upper[n + split :], lb=lower[:n], ub=upper[:n])
    return qp, high, low


def solve_rows(
    solver: str, H: Array, f: Array, C: Array, lower: Array, upper: Array, equalities: int
) -> tuple[Array, Array | None] | None:
    """min 1/2 x'H x + f'x subject to lower <= (x, C x) <= upper: primal x and multipliers, or None.

    The bounds start with those of the n variables; the last ``equalities`` rows of C are equalities. Multipliers (one
    per bound) are positive at an upper bound, negative at a lower one: H x + f + lam_x + C' lam_rows = 0; None where a
    registered solver gives none. DAQP is called through its own interface: qpsolvers' conversion costs as much as the
    solve.
    """
    n, rows = len(f), len(C)
    if solver == "daqp":
        sense = np.zeros(n + rows, dtype=np.int32)
        sense[n + rows - equalities :] = 5
        x, _, flag, info = daqp.solve(H, f, C, upper, lower, sense, eps_prox=0.0, **TOLERANCES["daqp"])
        return (x, info["lam"]) if flag > 0 and np.isfinite(x).all() else None
    qp, high, low = quadratic(H, f, C, lower, upper, equalities)
    found = _solve(solver, qp)
    if found is None:
        return None
    x, y, z, z_box = found
    if y is None or z is None:
        return x, None
    lam = np.zeros(n + rows)
    if z_box is not None:
        lam[:n] = z_box
    split = rows - equalities
    inner, count = lam[n : n + split], int(high.sum())
    inner[high] += z[:count]
    inner[low] -= z[count:]
    lam[n + split :] = y
    return x, lam


def _solve(solver: str, qp: QuadraticProgram, *, only_found: bool = False) -> Answered | None:
    """The answer of a solver; None where it has none. ``only_found``: nor where it does not call it a solution."""
    if solver in list_registered():
        return ask_solver(solver, qp)
    import qpsolvers

    check_qp_solver(solver)
    try:
        found = solve_by_qpsolvers(solver, qp, state_qp(solver, qp), **TOLERANCES.get(solver, {}))
    except (qpsolvers.ProblemError, qpsolvers.SolverError):  # quadprog, ECOS: a Hessian that is nearly singular
        return None
    if found.x is None or not np.all(np.isfinite(found.x)) or (only_found and not found.found):
        return None
    # proxsuite and piqp return views of their own memory.
    return Answered(np.array(found.x), found.y, found.z, found.z_box)


def state_qp(solver: str, qp: QuadraticProgram) -> qpsolvers.Problem:
    """The QP as qpsolvers hands it to this solver without another conversion: sparse where it takes nothing else."""
    import qpsolvers

    P, q, G, h, A, b, lb, ub = qp.matrices
    if solver in _NO_INFINITY:
        low, high, one = np.isfinite(qp.lb), np.isfinite(qp.ub), np.eye(len(qp.q))
        G, h = np.vstack([qp.G, one[high], -one[low]]), np.concatenate([qp.h, qp.ub[high], -qp.lb[low]])
        lb = ub = None
    elif solver not in qpsolvers.dense_solvers:
        P, G, A = (None if rows is None else sp.csc_matrix(rows) for rows in (P, G, A))
    return qpsolvers.Problem(P, q, G, h, A, b, lb, ub)


def solve_by_qpsolvers(
    solver: str, qp: QuadraticProgram, problem: qpsolvers.Problem, **settings: Any
) -> qpsolvers.Solution:
    """qpsolvers' solution, whatever it says, of the QP and what :func:`state_qp` makes of it, with these settings."""
    import qpsolvers

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what they remark on is judged elsewhere
        found = qpsolvers.solve_problem(problem, solver=solver, **settings)
    if solver in _NO_INFINITY and found.z is not None:
        low, high, m = np.isfinite(qp.lb), np.isfinite(qp.ub), len(qp.h)
        count = int(high.sum())
        found.z_box = np.zeros(len(qp.q))
        found.z_box[high] += found.z[m : m + count]
        found.z_box[low] -= found.z[m + count :]
        found.z = found.z[:m]
    return found
