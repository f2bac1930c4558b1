"""Exact search of the grid's cells in increasing measure, with half-spaces that reject many cells at once.

The measure does not depend on the multipliers, so the cells (t_I, A_1..A_k) are visited in order of measure. A cell
is rejected by a lower bound of the residual of any multipliers, and the direction y of that bound rejects a half-space
of normal forces at once (a Benders cut):

    sum_i F_i s_i(y) + y . load > limit   =>   no multipliers balance these F   (s_i: ForceProblem.support).

Cells are never listed: for every choice of the first k-1 decelerations only the interval of the last one that no cut
rejects is kept, so the work grows with na^(k-1), and it is done in blocks, which bounds the memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pinograsp.errors import Status
from pinograsp.forces.certificate import TOLERANCE, load_size_of
from pinograsp.forces.grid import cells as g
from pinograsp.forces.grid.cells import Cell, GridSpec, TimeTable, grid_solution, options, tabulate
from pinograsp.forces.grid.lattice import first_on_lattice
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import GridSolution
from pinograsp.forces.solve.multipliers import MultiplierSolution, refine_multipliers
from pinograsp.forces.solve.solvers import QPSolverName, check_qp_solver
from pinograsp.spatial import Array, IntArray

_PREFIXES = 2**20  # prefixes held at once: about 60 MB
_NEVER = np.iinfo(np.int64).max


def pruned_search(
    problem: ForceProblem, grid: GridSpec, *, solver: QPSolverName = "daqp", progress: bool | None = None
) -> GridSolution:
    """The paper's grid search with the same optimum as :func:`~pinograsp.forces.grid.cells.brute_force`, ties included.

    A cell that no continuous multipliers balance within ``grid.residual_limit`` is rejected; in the others the
    multiplier grid is searched. ``solver`` only computes bounds, each of which is checked: it can change the computing
    time, not the result.
    """
    units = options(problem, grid)
    columns = problem.scaled_columns[:, :, :2] * problem.pyramid[None, :, None]

    def accept(table: TimeTable, cell: IntArray, refined: MultiplierSolution) -> Array | None:
        normal = table.normal_force[cell]
        found = first_on_lattice(
            units, normal, problem.scaled_load, grid.multipliers, columns * normal[None, :, None], grid.residual_limit
        )
        return None if found is None else grid.multipliers[found]

    return _search(problem, grid, grid.residual_limit, accept, "paper", solver, progress)


def hybrid_search(
    problem: ForceProblem, grid: GridSpec, *, solver: QPSolverName = "daqp", progress: bool | None = None
) -> GridSolution:
    """Grid over (t_I, A) only, the QP over the multipliers deciding each cell: the first balanced cell is optimal."""

    def accept(table: TimeTable, cell: IntArray, refined: MultiplierSolution) -> Array | None:
        return refined.multipliers if refined.status is Status.OK else None

    return _search(problem, grid, None, accept, "hybrid", solver, progress)


Accept: TypeAlias = Callable[[TimeTable, IntArray, MultiplierSolution], Array | None]


class _Closest(NamedTuple):
    """The least residual seen (6,) and its norm [N]."""

    norm: float
    residual: Array


class _Best(NamedTuple):
    """The best cell so far; cells are ordered by (cost, index of the impact time)."""

    order: tuple[int, int]
    cell: Cell


class _Search:
    """State of one search: its cuts, the count of rejected cells, the least residual seen, the best cell so far."""

    def __init__(
        self,
        problem: ForceProblem,
        limit: float,
        exact: bool,
        accept: Accept,
        solver: QPSolverName,
        rejections: dict[str, int],
        bar: tqdm,
    ):
        self.problem, self.limit, self.accept, self.solver = problem, limit, accept, solver
        self.rejections, self.bar = rejections, bar
        self.lattice = g.BY_BALANCE if exact else g.BY_LATTICE
        self.cuts: list[tuple[Array, float]] = []  # (support per contact, offset): rejected where sum > limit
        self.qp_solves = 0
        self.uncertain = False
        self.closest = _Closest(np.inf, np.zeros(6))
        self.best: _Best | None = None

    def reject(self, reason: str, count: int) -> None:
        self.rejections[reason] += count
        self.bar.update(count)

    def visit(self, table: TimeTable, lead: tuple[int, ...]) -> None:
        """All cells of one impact time whose first indices are ``lead``, split until a block fits in memory."""
        m, left = table.cost.size, self.problem.k - len(lead)
        cost = int(table.cost[list(lead)].sum()) + left * int(table.cost[0])
        if self.best is not None and (cost, table.index) >= self.best.order:
            self.reject(g.BY_MEASURE, m**left)
            return
        forces = table.normal_force
        for support, offset in self.cuts:
            rest = np.minimum(support[len(lead) :] * forces[0], support[len(lead) :] * forces[-1]).sum()
            if support[: len(lead)] @ forces[list(lead)] + rest + offset > self.limit:
                self.reject(g.BY_BALANCE, m**left)
                return
        if m ** (left - 1) <= _PREFIXES:
            self._block(table, lead)
        else:
            for a in range(m):
                self.visit(table, (*lead, a))

    def _block(self, table: TimeTable, lead: tuple[int, ...]) -> None:
        m, free = table.cost.size, self.problem.k - len(lead) - 1
        prefix_cost = _outer_sum([table.cost] * free) + table.cost[list(lead)].sum()
        lo = np.zeros(prefix_cost.size, dtype=np.int32)
        hi = np.full(prefix_cost.size, m, dtype=np.int32)

        def cut(support: Array, offset: float) -> None:
            """Shrink every prefix's interval of the last deceleration by one half-space."""
            F, last = table.normal_force, support[-1]
            spent = _outer_sum([s * F for s in support[len(lead) : -1]])
            spent = spent + support[: len(lead)] @ F[list(lead)] + offset
            before = int((hi - lo).sum())
            room = self.limit - spent
            if last > 0:
                np.minimum(hi, np.searchsorted(F, room / last, side="right"), out=hi, casting="same_kind")
            elif last < 0:
                np.maximum(lo, np.searchsorted(F, room / last, side="left"), out=lo, casting="same_kind")
            else:
                hi[room < 0] = 0
            np.maximum(hi, lo, out=hi)
            self.reject(g.BY_BALANCE, before - int((hi - lo).sum()))

        def find_upcoming() -> IntArray:
            return np.where(lo < hi, prefix_cost + table.cost[np.minimum(lo, m - 1)], _NEVER)

        for known in self.cuts:
            cut(*known)
        following = find_upcoming()
        while True:
            j = int(np.argmin(following))
            cost = int(following[j])
            if cost == _NEVER or (self.best is not None and (cost, table.index) >= self.best.order):
                break
            cell = np.array([*lead, *np.unravel_index(j, (m,) * free), lo[j]], dtype=int)
            refined = self._refine(table, cell)
            half_space = (self.problem.support(refined.direction), float(refined.direction @ self.problem.scaled_load))
            if refined.certificate.lower_bound > self.limit:
                self.cuts.append(half_space)
                cut(*half_space)
                if lo[j] == cell[-1] and hi[j] > lo[j]:  # rounding kept the cell that the bound rejects
                    lo[j] += 1
                    self.reject(g.BY_BALANCE, 1)
                following = find_upcoming()
                continue
            multipliers = self.accept(table, cell, refined)
            lo[j] += 1
            if multipliers is not None:
                if self.best is not None:
                    self.reject(g.BY_MEASURE, 1)
                bound = refined.certificate.lower_bound
                found = Cell(table=table, indices=cell, multipliers=multipliers, residual_bound=bound)
                self.best = _Best((cost, table.index), found)
                self.bar.update(1)
                break
            self.uncertain |= refined.status is Status.INACCURATE
            self.reject(self.lattice, 1)
            following[j] = prefix_cost[j] + table.cost[lo[j]] if lo[j] < hi[j] else _NEVER
        self.reject(g.BY_MEASURE, int((hi - lo).sum()))

    def _refine(self, table: TimeTable, cell: IntArray) -> MultiplierSolution:
        self.qp_solves += 1
        refined = refine_multipliers(self.problem, table.normal_force[cell], solver=self.solver)
        if refined.certificate.objective < self.closest.norm:
            self.closest = _Closest(refined.certificate.objective, refined.certificate.residual)
        return refined


def _outer_sum(terms: list[NDArray[Any]]) -> NDArray[Any]:
    """All sums of one entry per term, flattened in grid order (the last term runs fastest)."""
    total = np.zeros(1, dtype=terms[0].dtype if terms else np.int64)
    for term in terms:
        total = (total[:, None] + term).ravel()
    return total


def _search(
    problem: ForceProblem,
    grid: GridSpec,
    limit: float | None,
    accept: Accept,
    name: str,
    solver: QPSolverName,
    progress: bool | None,
) -> GridSolution:
    """``limit``: largest norm of the residual that counts as balance [N]; None: the certificates' tolerance."""
    started = time.perf_counter()
    check_qp_solver(solver)
    tables, rejections = tabulate(problem, grid)
    bar = g.progress_bar(sum(t.cost.size**problem.k for t in tables), f"{name} search", "cell", progress)
    least, _ = problem.normal_force_range(problem.impact_time_range[1])
    balanced = TOLERANCE.residual * load_size_of(problem.scaled_load, least)
    limit = balanced if limit is None else limit
    exact = limit <= balanced
    search = _Search(problem, limit, exact, accept, solver, rejections, bar)
    interrupted = False
    try:
        # The impact time that can be cheapest first: its optimum then prunes the others.
        for table in sorted(tables, key=lambda t: (int(t.cost[0]), t.index)):
            search.visit(table, ())
    except KeyboardInterrupt:
        interrupted = True
    bar.close()
    if interrupted:
        status = Status.INTERRUPTED
    elif search.best is not None:
        status = Status.OK
    else:
        status = Status.INACCURATE if search.uncertain and exact else Status.INFEASIBLE
    cell = None if search.best is None else search.best.cell
    log = g.grid_log(
        problem,
        grid,
        cell,
        rejections,
        qp_solves=search.qp_solves,
        cuts=len(search.cuts),
        closest=search.closest.residual,
    )
    return grid_solution(
        problem,
        cell,
        status=status,
        search=name,
        log=log,
        started=started,
        solver=solver if name == "hybrid" else "",
    )
