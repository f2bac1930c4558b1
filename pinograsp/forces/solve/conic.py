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

from pinograsp.forces.matrices import Matrices
from pinograsp.forces.solve.answers import ProgramAnswer
from pinograsp.forces.solve.program import Program
from pinograsp.forces.solve.standard_form import Cones, ConicProgram
from pinograsp.spatial import Array, IntArray

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
_CAREFUL = 0.9  # of the way to the boundary; Clarabel's own 0.99 gets stuck now and then
_HARDLY = 1e-9  # of what the rows of a balance reach best: less is nothing
HUGE = 1e100  # squares of larger numbers are not finite

Cone: TypeAlias = "clarabel.ZeroConeT | clarabel.NonnegativeConeT | clarabel.SecondOrderConeT | clarabel.PowerConeT"


def solve(
    P: sp.spmatrix, q: Array, A: sp.spmatrix, b: Array, cones: Sequence[Cone], *, careful: bool = False
) -> clarabel.DefaultSolution:
    """Clarabel's solution, whatever its status: callers certify x and z themselves; ``careful``: with shorter steps."""
    explicit = clarabel.DefaultSettings()
    for name, value in _SETTINGS.items():
        setattr(explicit, name, value)
    if careful:
        explicit.max_step_fraction = _CAREFUL
    return clarabel.DefaultSolver(P, q, A, b, cones, explicit).solve()


def even_rows(rows: Array) -> Array:
    """Combinations (m, m) of rows (m, n) that all have size 1: the solver ends before it balances what forces reach
    hardly, if that counts for little.
    """
    u, found, _ = np.linalg.svd(rows)
    sizes = np.zeros(len(rows))
    sizes[: len(found)] = found
    evened: Array = (u / np.where(sizes > _HARDLY * sizes[0], sizes, sizes[0])).T
    return evened


def sparse(rows: Array) -> sp.csc_matrix:
    """Dense rows (m, n) as Clarabel takes them; for some tens of contacts dense blocks are far faster to stack."""
    columns = np.ascontiguousarray(rows.T)
    kept = columns != 0.0
    starts = np.append(0, np.cumsum(kept.sum(axis=1)))
    return sp.csc_matrix((columns[kept], np.nonzero(kept)[1], starts), shape=rows.shape)


def stack_blocks(blocks: Sequence[Sequence[Array | None]], widths: Sequence[int]) -> Array:
    """Block rows one above the other, of columns of these widths; None: zeros."""
    heights = [next(len(block) for block in row if block is not None) for row in blocks]
    found = np.zeros((sum(heights), sum(widths)))
    lefts, top = np.append(0, np.cumsum(widths)), 0
    for row, height in zip(blocks, heights):
        for left, right, block in zip(lefts[:-1], lefts[1:], row):
            if block is not None:
                found[top : top + height, left:right] = block
        top += height
    return found


class Triplets:
    """Rows of a sparse matrix while they are put together, for programs with blocks of columns of their own per load.

    Columns: F (k), then u of each load (``per_load``), then any others.

    Attributes:
        height: number of rows so far.
    """

    def __init__(self, k: int, per_load: int):
        self._k, self._per_load, self.height = k, per_load, 0
        self._rows: list[IntArray] = []
        self._columns: list[IntArray] = []
        self._values: list[Array] = []

    def add(self, *blocks: tuple[Array, int]) -> None:
        """Append rows: dense blocks of as many rows side by side, each with its first column."""
        for block, left in blocks:
            rows, columns = np.nonzero(block)
            self._put(rows + self.height, columns + left, block[rows, columns])
        self.height += len(blocks[0][0])

    def of_every_load(self, block: Array, loads: int, shares: tuple[Array, Array] | None = None) -> None:
        """Append rows on x = (u, F) of one load, once for each load.

        ``shares``: matrices (loads, k, k) and (loads, k, per_load) of the common F and of the first load's u in the F
        of each load; None: the common F is that of all.
        """
        if not len(block):
            return
        split = block.reshape(len(block), self._k, -1)
        normal, across = split[:, :, -1], split[:, :, :-1].reshape(len(block), -1)
        at = self.height + len(block) * np.arange(loads)[:, None]
        parts = [(across, self._k, self._per_load)]
        if shares is None:
            parts.append((normal, 0, 0))
        for part, left, step in parts:
            rows, columns = np.nonzero(part)
            shift = left + step * np.arange(loads)[:, None]
            self._put((rows + at).ravel(), (columns + shift).ravel(), np.tile(part[rows, columns], loads))
        for share, left in zip(shares or (), (0, self._k)):
            each = normal @ share
            load, rows, columns = np.nonzero(each)
            self._put(self.height + load * len(block) + rows, left + columns, each[load, rows, columns])
        self.height += loads * len(block)

    def _put(self, rows: IntArray, columns: IntArray, values: Array) -> None:
        self._rows.append(rows)
        self._columns.append(columns)
        self._values.append(values)

    def matrix(self, width: int) -> sp.csc_matrix:
        """The rows, of that many columns."""
        where = np.concatenate(self._rows), np.concatenate(self._columns)
        return sp.csc_matrix((np.concatenate(self._values), where), shape=(self.height, width))


class ConeRows(NamedTuple):
    """Constraint blocks on x that every program shares, as rows of A x + s = b.

    Attributes:
        select: selection of F (k, k d).
        facets: inequalities of polyhedral friction, right-hand side zero.
        second: rows of second-order cones, right-hand side zero.
        sizes: of the second-order cones.
    """

    select: Array
    facets: Array
    second: Array
    sizes: list[int]


def cone_rows(matrices: Matrices) -> ConeRows:
    """Selection of the normal forces, and friction as facets or second-order cones."""
    k, d, friction = matrices.k, matrices.d, matrices.friction
    n = k * d
    select = np.zeros((k, n))
    select[np.arange(k), np.arange(d - 1, n, d)] = 1.0
    D = friction.facets
    facets = np.asarray(np.kron(np.eye(k), np.hstack([D, -np.ones((len(D), 1))])), dtype=float)
    if friction.polyhedral:
        return ConeRows(select, facets, np.zeros((0, n)), [])
    inside = friction.round_dimensions + 1  # (F, u)
    block = np.zeros((inside, d))
    block[0, -1] = -1.0
    block[np.arange(1, inside), np.arange(inside - 1)] = -1.0
    return ConeRows(select, facets, np.asarray(np.kron(np.eye(k), block), dtype=float), [inside] * k)


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

    fixed: Array
    fixed_b: Array
    linear: Array
    linear_b: Array
    second: Array
    sizes: list[int]


def limit_rows(program: Program) -> LimitRows:
    """Friction and the bounds of F_n as rows on x.

    Fixed normal forces are equations: as two inequalities they would leave no interior to an interior-point method.
    """
    select, facets, second, sizes = cone_rows(program.matrices)
    if np.array_equal(program.lo, program.hi):
        return LimitRows(select, program.lo, facets, np.zeros(len(facets)), second, sizes)
    limits = np.concatenate([-program.lo, program.hi, np.zeros(len(facets))])
    linear = np.concatenate([-select, select, facets])
    return LimitRows(select[:0], np.zeros(0), linear, limits, second, sizes)


def solve_linear(
    program: Program,
    equal: Array,
    equal_b: Array,
    q: Array,
    *,
    least: Array | None = None,
    torques: bool = False,
) -> tuple[Array, Array, Array] | None:
    """min q . z over z = (x, further columns), x within friction and bounds (and torque limits).

    Subject to ``equal`` z = ``equal_b`` and ``least`` z >= 0. Returns z, the multipliers of the equations and those of
    the torque rows; callers certify them. None where they are not finite.
    """
    n, m = program.k * program.d, len(program.R) if torques else 0
    fixed, fixed_b, linear, linear_b, second, sizes = limit_rows(program)
    least = np.zeros((0, len(q))) if least is None else least
    R = program.R[:m]
    inside = np.concatenate([fixed, linear, R, -R, second])
    x_rows = np.hstack([inside, np.zeros((len(inside), len(q) - n))])
    at = len(fixed) + len(linear) + 2 * m
    A = np.concatenate([equal, x_rows[:at], -least, x_rows[at:]])
    torque_b = (program.R_hi, -program.R_lo) if torques else ()
    b = np.concatenate([equal_b, fixed_b, linear_b, *torque_b, np.zeros(len(least) + len(second))])
    cones = [
        clarabel.ZeroConeT(len(equal_b) + len(fixed_b)),
        clarabel.NonnegativeConeT(len(linear) + 2 * m + len(least)),
    ]
    cones += [clarabel.SecondOrderConeT(size) for size in sizes]
    found = solve(sp.csc_matrix((len(q), len(q))), q, sparse(A), b, cones)
    z, dual = np.array(found.x), np.array(found.z)
    if not (np.abs(z).max() < HUGE and np.abs(dual).max() < HUGE):
        return None
    at = len(equal_b) + len(fixed_b) + len(linear_b)
    return z, dual[: len(equal_b)], dual[at : at + m] - dual[at + m : at + 2 * m]


class ConicMethod:
    """The interior-point method, for programs that share these matrices and the exponents of their powers.

    Attributes:
        exponents: of the powers of F_n that are not linear.
        torque_at: first row of the upper torque limits; the lower ones follow them.
    """

    def __init__(self, matrices: Matrices, exponents: tuple[float, ...]):
        """Stack the rows. Columns: x, the largest F_n where it counts, one per power and contact."""
        k, n, m = matrices.k, matrices.k * matrices.d, len(matrices.R)
        peak, extra = int(matrices.peak > 0), len(exponents) * k
        select, facets, second, sizes = cone_rows(matrices)
        linear = np.concatenate([-select, select, facets])
        blocks: list[list[Array | None]] = [
            [matrices.A, None, None],
            [linear, None, None],
            [matrices.R, None, None],
            [-matrices.R, None, None],
        ]
        if peak:
            blocks.append([select, -np.ones((k, 1)), None])
        blocks.append([second, None, None])
        powers: list[float] = []
        for j, exponent in enumerate(exponents):
            on_force, on_power = np.zeros((3 * k, n)), np.zeros((3 * k, extra))
            on_power[np.arange(0, 3 * k, 3), j * k + np.arange(k)] = -1.0
            on_force[2::3] = -select
            blocks.append([on_force, None, on_power])
            powers += [1 / exponent] * k
        self.exponents, self._A = exponents, sparse(stack_blocks(blocks, (n, peak, extra)))
        self._cones = Cones(matrices.rows, len(linear) + 2 * m + peak * k, tuple(sizes), tuple(powers))
        self.torque_at = matrices.rows + len(linear)

    def standard_form(self, program: Program) -> ConicProgram:
        """The program, which shares this method's matrices and exponents, over cones."""
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
        rows = self.torque_at
        b[rows : rows + m], b[rows + m : rows + 2 * m] = program.R_hi, -program.R_lo
        if curved:
            b[len(b) - 3 * k * len(curved) + 1 :: 3] = 1.0
        P = sp.csc_matrix((size, size))
        if program.P is not None:
            P = sp.csc_matrix(sp.block_diag([sp.csc_matrix(program.P), sp.csc_matrix((size - n,) * 2)]))
        return ConicProgram(P=P, q=q, A=self._A, b=b, cones=self._cones)

    def solve(self, program: Program) -> ProgramAnswer | None:
        """The interior-point method's answer; None where it is not finite."""
        socp = self.standard_form(program)
        found = solve(sp.csc_matrix(sp.triu(socp.P)), socp.q, socp.A, socp.b, socp.cones.clarabel())
        x, z = np.array(found.x), np.array(found.z)
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            return None
        return self.answer(program, x, z)

    def answer(self, program: Program, x: Array, z: Array | None) -> ProgramAnswer:
        """The answer of the unknowns x, and of the rows' multipliers z."""
        n, m, rows = program.k * program.d, len(program.R), self.torque_at
        if z is None:
            return ProgramAnswer.alone(x[:n])
        return ProgramAnswer(x[:n], z[: len(program.b)], z[rows : rows + m] - z[rows + m : rows + 2 * m])


def exponents_of(program: Program) -> tuple[float, ...]:
    """Exponents of the powers of F_n that are not linear."""
    return tuple(exponent for _, exponent in program.powers if exponent != 1)
