"""Programs with second-order cones, by an interior-point method (Clarabel, through its own interface).

Friction cones are second-order cones, powers of F_n are power cones: t >= F^p is (t, 1, F) in K_pow(1/p). The sparse
matrices do not change with the impact time: they are built once per problem and objective.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.forces.answers import Answer
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.program import Program
from pinograsp.spatial import Array

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

Cone: TypeAlias = "clarabel.ZeroConeT | clarabel.NonnegativeConeT | clarabel.SecondOrderConeT | clarabel.PowerConeT"


def settings() -> clarabel.DefaultSettings:
    """Clarabel's settings, with explicit tolerances."""
    explicit = clarabel.DefaultSettings()
    for name, value in _SETTINGS.items():
        setattr(explicit, name, value)
    return explicit


def solve(P: sp.spmatrix, q: Array, A: sp.spmatrix, b: Array, cones: Sequence[Cone]) -> clarabel.DefaultSolution:
    """Clarabel's solution, whatever its status: callers certify x and z themselves."""
    return clarabel.DefaultSolver(P, q, A, b, cones, settings()).solve()


def cone_rows(matrices: Matrices) -> tuple[sp.csc_matrix, sp.csc_matrix, list[int], sp.csc_matrix]:
    """Constraint blocks on x that every program shares, as rows of A x + s = b.

    The linear inequality block for [F >= lo, F <= hi, facets], the second-order block, its cone sizes, and the
    selection of F (k, k d).
    """
    k, d, friction = matrices.k, matrices.d, matrices.friction
    n = k * d
    normal = np.arange(d - 1, n, d)
    select = sp.csc_matrix((np.ones(k), (np.arange(k), normal)), shape=(k, n))
    D = friction.facets
    facets = sp.kron(sp.identity(k), np.hstack([D, -np.ones((len(D), 1))])) if len(D) else sp.csc_matrix((0, n))
    linear = sp.vstack([-select, select, facets], format="csc")
    if friction.polyhedral:
        return linear, sp.csc_matrix((0, n)), [], select
    inside = friction.round_dimensions + 1  # (F, u)
    block = np.zeros((inside, d))
    block[0, -1] = -1.0
    block[np.arange(1, inside), np.arange(inside - 1)] = -1.0
    return linear, sp.csc_matrix(sp.kron(sp.identity(k), block)), [inside] * k, select


class LimitRows(NamedTuple):
    """Friction and the bounds of F_n as rows of A x + s = b.

    Attributes:
        fixed: equations: normal forces that are fixed.
        fixed_b: their right-hand side.
        linear: inequalities.
        linear_b: their right-hand side.
        second: rows of second-order cones, right-hand side zero.
        sizes: of the second-order cones.
    """

    fixed: sp.csc_matrix
    fixed_b: Array
    linear: sp.csc_matrix
    linear_b: Array
    second: sp.csc_matrix
    sizes: list[int]


def limit_rows(program: Program) -> LimitRows:
    """Friction and the bounds of F_n as rows on x.

    Fixed normal forces are equations: as two inequalities they would leave no interior to an interior-point method.
    """
    k, n = program.k, program.k * program.d
    linear, second, sizes, select = cone_rows(program.matrices)
    facets = linear[2 * k :]
    if np.array_equal(program.lo, program.hi):
        return LimitRows(select, program.lo, facets, np.zeros(facets.shape[0]), second, sizes)
    limits = np.concatenate([-program.lo, program.hi, np.zeros(facets.shape[0])])
    return LimitRows(sp.csc_matrix((0, n)), np.zeros(0), linear, limits, second, sizes)


def solve_linear(
    program: Program,
    equal: sp.spmatrix,
    equal_b: Array,
    q: Array,
    *,
    least: sp.spmatrix | None = None,
    torques: bool = False,
) -> tuple[Array, Array, Array] | None:
    """min q . z over z = (x, further columns), x within friction and bounds (and torque limits).

    Subject to ``equal`` z = ``equal_b`` and ``least`` z >= 0. Returns z, the multipliers of the equations and those of
    the torque rows; callers certify them. None where they are not finite.
    """
    n = program.k * program.d
    fixed, fixed_b, linear, linear_b, second, sizes = limit_rows(program)
    blocks = [linear, *((sp.csc_matrix(program.R), sp.csc_matrix(-program.R)) if torques else ())]
    limits = [linear_b, *((program.R_hi, -program.R_lo) if torques else ())]

    def wide(block: sp.spmatrix) -> sp.spmatrix:
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


class ConicMethod:
    """The interior-point method, for programs that share these matrices and the exponents of their powers.

    Attributes:
        exponents: of the powers of F_n that are not linear.
    """

    def __init__(self, matrices: Matrices, exponents: tuple[float, ...]):
        """Stack the rows. Columns: x, the largest F_n where it counts, one per power and contact."""
        k, n, m = matrices.k, matrices.k * matrices.d, len(matrices.R)
        peak, extra = int(matrices.peak > 0), len(exponents) * k
        linear, second, sizes, select = cone_rows(matrices)

        def wide(block: sp.spmatrix, middle: sp.spmatrix | None = None) -> sp.spmatrix:
            middle = sp.csc_matrix((block.shape[0], peak)) if middle is None else middle
            return sp.hstack([block, middle, sp.csc_matrix((block.shape[0], extra))])

        torque = sp.csc_matrix(np.vstack([matrices.R, -matrices.R]))
        blocks = [wide(sp.csc_matrix(matrices.A)), wide(linear), wide(torque)]
        if peak:
            blocks.append(wide(select, sp.csc_matrix(-np.ones((k, 1)))))
        blocks.append(wide(second))
        cones = [clarabel.ZeroConeT(matrices.rows), clarabel.NonnegativeConeT(linear.shape[0] + 2 * m + peak * k)]
        cones += [clarabel.SecondOrderConeT(size) for size in sizes]
        normal = np.arange(matrices.d - 1, n, matrices.d)
        for j, exponent in enumerate(exponents):
            rows = sp.lil_matrix((3 * k, n + peak + extra))
            rows[np.arange(0, 3 * k, 3), n + peak + j * k + np.arange(k)] = -1.0
            rows[np.arange(2, 3 * k, 3), normal] = -1.0
            blocks.append(rows)
            cones += [clarabel.PowerConeT(1 / exponent)] * k
        self.exponents, self._A, self._cones = exponents, sp.csc_matrix(sp.vstack(blocks)), cones
        self._torque_at = matrices.rows + linear.shape[0]

    def solve(self, program: Program) -> Answer | None:
        """The interior-point method's answer; None where it is not finite."""
        k, n, m, at = program.k, program.k * program.d, len(program.R), len(program.b)
        size = self._A.shape[1]
        q = np.zeros(size)
        q[:n] = program.q
        for coefficient, exponent in program.powers:
            if exponent == 1:
                q[program.d - 1 : n : program.d] += coefficient
        first = n + (program.peak > 0)
        q[n:first] = program.peak
        curved = [coefficient for coefficient, exponent in program.powers if exponent != 1]
        for j, coefficient in enumerate(curved):
            q[first + j * k : first + (j + 1) * k] = coefficient
        b = np.zeros(self._A.shape[0])
        b[:at] = program.b
        b[at : at + k], b[at + k : at + 2 * k] = -program.lo, program.hi
        rows = self._torque_at
        b[rows : rows + m], b[rows + m : rows + 2 * m] = program.R_hi, -program.R_lo
        if curved:
            b[len(b) - 3 * k * len(curved) + 1 :: 3] = 1.0
        P = sp.csc_matrix((size, size))
        if program.P is not None:
            P = sp.csc_matrix(sp.triu(sp.block_diag([sp.csc_matrix(program.P), sp.csc_matrix((size - n,) * 2)])))
        found = solve(P, q, self._A, b, self._cones)
        x, z = np.array(found.x), np.array(found.z)
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            return None
        return Answer(x[:n], z[:at], z[rows : rows + m] - z[rows + m : rows + 2 * m])


def exponents_of(program: Program) -> tuple[float, ...]:
    """Exponents of the powers of F_n that are not linear."""
    return tuple(exponent for _, exponent in program.powers if exponent != 1)
