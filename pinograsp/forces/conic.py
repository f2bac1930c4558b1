"""Programs with second-order cones, by an interior-point method (Clarabel, through its own interface).

Friction cones are second-order cones, powers of F_n are power cones: t >= F^p is (t, 1, F) in K_pow(1/p). Everything
that does not change with the impact time (the sparse matrices) is built once per problem and objective.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.forces.answers import Answer
from pinograsp.forces.program import Program

_SETTINGS = {
    "tol_gap_abs": 1e-11,
    "tol_gap_rel": 1e-11,
    "tol_feas": 1e-11,
    "tol_infeas_abs": 1e-11,
    "tol_infeas_rel": 1e-11,
    "max_iter": 200,
    "verbose": False,
    "max_threads": 1,
}
HUGE = 1e100  # squares of larger numbers are not finite


def settings() -> clarabel.DefaultSettings:
    """Clarabel's settings with every tolerance that matters stated."""
    made = clarabel.DefaultSettings()
    for name, value in _SETTINGS.items():
        setattr(made, name, value)
    return made


def solve(P, q, A, b, cones):
    """Clarabel's solution: whatever its status says, callers certify x and z themselves."""
    return clarabel.DefaultSolver(P, q, A, b, cones, settings()).solve()


def cone_rows(program: Program) -> tuple[sp.csc_matrix, sp.csc_matrix, list[int], sp.csc_matrix]:
    """Constraint blocks on x that every program shares, as rows of A x + s = b.

    The linear inequality block for [F >= lo, F <= hi, facets], the second-order block, its cone sizes, and the
    selection of F (k, k d).
    """
    k, d = program.k, program.d
    n = k * d
    normal = np.arange(d - 1, n, d)
    select = sp.csc_matrix((np.ones(k), (np.arange(k), normal)), shape=(k, n))
    D = program.friction.facets
    facets = sp.kron(sp.identity(k), np.hstack([D, -np.ones((len(D), 1))])) if len(D) else sp.csc_matrix((0, n))
    linear = sp.vstack([-select, select, facets], format="csc")
    if program.friction.polyhedral:
        return linear, sp.csc_matrix((0, n)), [], select
    inside = program.friction.round_dimensions + 1  # (F, u)
    block = np.zeros((inside, d))
    block[0, -1] = -1.0
    block[np.arange(1, inside), np.arange(inside - 1)] = -1.0
    return linear, sp.csc_matrix(sp.kron(sp.identity(k), block)), [inside] * k, select


def limit_rows(program: Program):
    """Friction and the bounds of F_n as rows on x: equations and their right-hand side, inequalities and theirs, cones
    and sizes.

    Normal forces that are fixed are equations: as two inequalities they would leave an interior-point method no
    interior.
    """
    k, n = program.k, program.k * program.d
    linear, second, sizes, select = cone_rows(program)
    facets = linear[2 * k :]
    if np.array_equal(program.lo, program.hi):
        return select, program.lo, facets, np.zeros(facets.shape[0]), second, sizes
    limits = np.concatenate([-program.lo, program.hi, np.zeros(facets.shape[0])])
    return sp.csc_matrix((0, n)), np.zeros(0), linear, limits, second, sizes


def solve_linear(
    program: Program, equal, equal_b, q, *, least=None, torques: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """min q . z over z = (x, further columns), x within friction and bounds (and torque limits).

    ``equal`` z = ``equal_b`` are its first rows, ``least`` z >= 0 further ones. z, multipliers of those rows and of the
    torque rows, for callers to certify: finite, no more. None where they are not.
    """
    n = program.k * program.d
    fixed, fixed_b, linear, linear_b, second, sizes = limit_rows(program)
    blocks = [linear, *((sp.csc_matrix(program.R), sp.csc_matrix(-program.R)) if torques else ())]
    limits = [linear_b, *((program.R_hi, -program.R_lo) if torques else ())]

    def wide(block):
        return sp.hstack([block, sp.csc_matrix((block.shape[0], len(q) - n))])

    rows = [wide(block) for block in blocks]
    if least is not None:
        rows.append(-least)
        limits.append(np.zeros(least.shape[0]))
    A = sp.vstack([equal, wide(fixed), *rows, wide(second)], format="csc")
    b = np.concatenate([equal_b, fixed_b, *limits, np.zeros(second.shape[0])])
    cones = [
        clarabel.ZeroConeT(len(equal_b) + len(fixed_b)),
        clarabel.NonnegativeConeT(sum(row.shape[0] for row in rows)),
    ]
    cones += [clarabel.SecondOrderConeT(size) for size in sizes]
    found = solve(sp.csc_matrix((len(q), len(q))), q, A, b, cones)
    z, dual = np.array(found.x), np.array(found.z)
    if not (np.abs(z).max() < HUGE and np.abs(dual).max() < HUGE):
        return None
    at, m = len(equal_b) + len(fixed_b) + len(linear_b), len(program.R) if torques else 0
    return z, dual[: len(equal_b)], dual[at : at + m] - dual[at + m : at + 2 * m]


def solve_conic(program: Program) -> Answer | None:
    """The interior-point method's answer; None where it is not finite."""
    k, n = program.k, program.k * program.d
    powers = [(c, p) for c, p in program.powers if p != 1]
    parts = program.cache.get("conic")
    if parts is None:
        parts = _matrices(program, powers)
        program.cache["conic"] = parts
    P, A, cones, facets = parts
    q = np.zeros(A.shape[1])
    q[:n] = program.q
    for c, p in program.powers:
        if p == 1:
            q[program.d - 1 : n : program.d] += c
    q[n : n + (program.peak > 0)] = program.peak
    first = n + (program.peak > 0)
    for j, (c, _) in enumerate(powers):
        q[first + j * k : first + (j + 1) * k] = c
    b = np.zeros(A.shape[0])
    at = len(program.b)
    b[:at] = program.b
    b[at : at + k], b[at + k : at + 2 * k] = -program.lo, program.hi
    rows = at + 2 * k + facets
    m = len(program.R)
    b[rows : rows + m], b[rows + m : rows + 2 * m] = program.R_hi, -program.R_lo
    if powers:
        b[len(b) - 3 * k * len(powers) + 1 :: 3] = 1.0
    scaled = (
        P * 1.0
        if program.P is None
        else sp.csc_matrix(sp.triu(sp.block_diag([sp.csc_matrix(program.P), sp.csc_matrix((len(q) - n,) * 2)])))
    )
    found = solve(scaled, q, A, b, cones)
    x, z = np.array(found.x), np.array(found.z)
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        return None
    return Answer(x[:n], z[:at], z[rows : rows + m] - z[rows + m : rows + 2 * m])


def _matrices(program: Program, powers):
    """P (empty), A, the cones and the number of facets. Columns: x, the peak if any, one per power and contact."""
    k, n, m = program.k, program.k * program.d, len(program.R)
    peak, extra = int(program.peak > 0), len(powers) * k
    linear, second, sizes, select = cone_rows(program)

    def wide(block, middle=None):
        middle = sp.csc_matrix((block.shape[0], peak)) if middle is None else middle
        return sp.hstack([block, middle, sp.csc_matrix((block.shape[0], extra))])

    blocks = [wide(sp.csc_matrix(program.A)), wide(linear), wide(sp.csc_matrix(np.vstack([program.R, -program.R])))]
    if peak:
        blocks.append(wide(select, sp.csc_matrix(-np.ones((k, 1)))))
    blocks.append(wide(second))
    cones = [clarabel.ZeroConeT(len(program.b)), clarabel.NonnegativeConeT(linear.shape[0] + 2 * m + peak * k)]
    cones += [clarabel.SecondOrderConeT(size) for size in sizes]
    normal = np.arange(program.d - 1, n, program.d)
    for j, (_, p) in enumerate(powers):
        rows = sp.lil_matrix((3 * k, n + peak + extra))
        rows[np.arange(0, 3 * k, 3), n + peak + j * k + np.arange(k)] = -1.0
        rows[np.arange(2, 3 * k, 3), normal] = -1.0
        blocks.append(rows)
        cones += [clarabel.PowerConeT(1 / p)] * k
    A = sp.csc_matrix(sp.vstack(blocks))
    size = A.shape[1]
    return sp.csc_matrix((size, size)), A, cones, linear.shape[0] - 2 * k
