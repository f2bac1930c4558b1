"""The paper's grid search (Appendix A.2, steps 1-14): the grid, its tables, and plain brute force as the oracle.

Every search here breaks ties alike: least measure; among equal measures the first point in grid order
(t_I, then A of contact 1, 2, ..., then k1, k2 of contact 1, 2, ...). Measures are compared as integers (2^-50 of the
largest entry), so that equal sums are equal whatever their order of addition.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pinograsp.checks import array_of, brief, frozen, instance_of, integer, number, read_only, shorten
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.problem import BY_ACCELERATION, BY_DEPTH, BY_SPEED, ForceProblem
from pinograsp.forces.solution import GridLog, GridSolution
from pinograsp.spatial import Array, IntArray

BY_TIME = "impact time range (Eq. 14)"
BY_BALANCE = "balance, whatever the multipliers (Eqs. 15, 16)"
BY_LATTICE = "balance on the multiplier grid (Eqs. 15, 27)"
BY_MEASURE = "measure above the optimum (Eq. 12)"

# Bounds are inclusive; a value built by adding steps may exceed its bound by rounding.
_ROUNDING = 1 + 1e-12
_MOST_VALUES = 10**6
_BLOCK = 2**18  # points evaluated at once by brute force: 12 MB of wrenches


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridSpec:
    """The grid: every contact takes every A, k1 and k2; one t_I for the whole hand.

    Attributes:
        impact_times: t_I (nt,) [s].
        accelerations: A (na,) [m/s^2], increasing.
        multipliers: k1 and k2 (nk,) in [-1, 1], increasing.
        residual_limit: largest norm of the residual that counts as balance on the grid [N] (moments over the moment
            length).

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6, friction=pg.Friction())
        >>> grid = pg.GridSpec(impact_times=[0.9], accelerations=np.arange(0.5, 1.5, 0.01))
        >>> print(pg.grid_search(problem, grid).status)
        ok

    See Also:
        :func:`~pinograsp.forces.grid_search`.
    """

    impact_times: Array = field(default_factory=lambda: grid_values(0.80, 0.95, 0.05))
    accelerations: Array = field(default_factory=lambda: grid_values(0.01, 1.0, 0.005))
    multipliers: Array = field(default_factory=lambda: grid_values(-1.0, 1.0, 0.1))
    residual_limit: float = 0.1

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            impact_times: ArrayLike = ...,
            accelerations: ArrayLike = ...,
            multipliers: ArrayLike = ...,
            residual_limit: float = ...,
        ) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        for name in ("impact_times", "accelerations", "multipliers"):
            values = array_of(f"grid {name}", getattr(self, name), (None,))
            if values.size == 0:
                raise InvalidInput(f"grid {name}: expected at least one value, got an empty grid")
            if np.any(np.diff(values) <= 0):
                raise InvalidInput(f"grid {name}: expected increasing values, got {shorten(values.tolist())}")
            object.__setattr__(self, name, values)
        if np.any(np.abs(self.multipliers) > _ROUNDING):
            raise InvalidInput(
                f"grid multipliers: expected values in [-1, 1], got {shorten(self.multipliers.tolist())}"
            )
        if self.accelerations[0] <= 0:
            raise InvalidInput(f"grid accelerations: expected values > 0 [m/s^2], got {self.accelerations[0]:g}")
        object.__setattr__(self, "residual_limit", number("residual limit", self.residual_limit, at_least=0, unit="N"))

    def cells(self, k: int) -> int:
        """Points in (t_I, A) for k contacts."""
        decelerations: int = self.accelerations.size ** _contacts(k)
        return self.impact_times.size * decelerations

    def points(self, k: int) -> int:
        """Points of the full grid for k contacts."""
        multipliers: int = self.multipliers.size ** (2 * _contacts(k))
        return self.cells(k) * multipliers


def _contacts(k: int) -> int:
    return integer("contacts", k, at_least=0, at_most=1000)


def grid_values(start: float, stop: float, step: float) -> Array:
    """Return start, start + step, ... up to ``stop`` (included if it lies on the grid), rounded to 12 decimals."""
    start, stop, step = number("grid start", start), number("grid stop", stop), number("grid step", step, above=0)
    if (stop - start) / step > _MOST_VALUES:
        raise InvalidInput(
            f"grid step: expected at most {_MOST_VALUES} values, got {(stop - start) / step:g} from {start:g} to "
            f"{stop:g}"
        )
    count = int(np.floor((stop - start) / step * _ROUNDING + 1e-9)) + 1
    values: Array = start + step * np.arange(max(count, 0), dtype=float)
    return read_only(values.round(12))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimeTable:
    """The admissible decelerations at one impact time: A, F_n [N] and the measure as an integer, all increasing."""

    impact_time: float
    index: int
    acceleration: Array
    normal_force: Array
    cost: IntArray


def tabulate(problem: ForceProblem, grid: GridSpec) -> tuple[list[TimeTable], dict[str, int]]:
    """Steps 1-8: the part of the grid that meets Eqs. (13) and (14), and how many cells each of them rejected."""
    A, k = instance_of("grid", grid, GridSpec).accelerations, problem.k
    rejections = {by: 0 for by in (BY_TIME, BY_ACCELERATION, BY_SPEED, BY_DEPTH, BY_BALANCE, BY_LATTICE, BY_MEASURE)}
    kept = []
    for index, impact_time in enumerate(grid.impact_times):
        low, high = problem.impact_time_range
        if not (low / _ROUNDING <= impact_time <= high * _ROUNDING) or impact_time >= problem.final_time:
            rejections[BY_TIME] += A.size**k
            continue
        tau = problem.final_time - impact_time
        tests = {
            BY_ACCELERATION: (problem.acceleration_range[0] / _ROUNDING <= A)
            & (problem.acceleration_range[1] * _ROUNDING >= A),
            BY_SPEED: problem.shape.speed_factor * A * tau <= problem.max_speed * _ROUNDING,
            BY_DEPTH: problem.shape.depth_factor * A * tau**2 <= problem.max_depth * _ROUNDING,
        }
        passing = np.ones(A.size, dtype=bool)
        for reason, test in tests.items():
            before = int(passing.sum())
            passing &= test
            rejections[reason] += before**k - int(passing.sum()) ** k
        if passing.any():
            kept.append((index, impact_time, A[passing]))
    if not kept:
        return [], rejections
    normal = [problem.normal_force(A, t) for _, t, A in kept]
    measure = [problem.energy(F, t) for F, (_, t, _) in zip(normal, kept)]
    largest = max(float(m[-1]) for m in measure)
    tables = [
        TimeTable(
            impact_time=float(t),
            index=index,
            acceleration=A,
            normal_force=F,
            cost=np.rint(m / largest * 2.0**50).astype(np.int64),
        )
        for (index, t, A), F, m in zip(kept, normal, measure)
    ]
    return tables, rejections


def options(problem: ForceProblem, grid: GridSpec) -> Array:
    """Unit contact wrenches (k, nk^2, rows) of every (k1, k2) in grid order, per newton of normal force (Eq. 28)."""
    k1, k2 = (v.ravel() for v in np.meshgrid(grid.multipliers, grid.multipliers, indexing="ij"))
    columns = problem.scaled_columns.transpose(1, 2, 0)
    tangential = np.stack([k1, k2], axis=1) @ columns[:, :2]
    wrenches: Array = problem.pyramid[:, None, None] * tangential + columns[:, 2][:, None, :]
    return wrenches


def progress_bar(total: int | None, what: str, unit: str, progress: bool | None) -> tqdm:
    """A progress bar on stderr: shown for long searches on a terminal (None), always (True) or never (False)."""
    return tqdm(
        total=total,
        desc=what,
        unit=unit,
        unit_scale=total is not None,
        disable=None if progress is None else not progress,
        delay=1.0 if progress is None else 0.0,
        leave=False,
    )


def brute_force(problem: ForceProblem, grid: GridSpec, *, progress: bool | None = None) -> GridSolution:
    """Every point of the grid, one after the other: the oracle of the pruned search and the benchmark's baseline.

    Vectorised over blocks, so memory stays bounded; time grows with ``grid.points``. Ctrl-C returns the best so far.
    """
    started = time.perf_counter()
    tables, rejections = tabulate(problem, grid)
    k, per_contact = problem.k, grid.multipliers.size**2
    combinations = per_contact**k
    units, load = options(problem, grid), problem.scaled_load
    best: tuple[int, TimeTable, IntArray, int] | None = None  # cost, table, cell, combination
    interrupted = False
    bar = progress_bar(sum(t.cost.size**k for t in tables), "brute force", "cell", progress)
    try:
        for table in tables:
            shape = (table.cost.size,) * k
            batch = max(1, _BLOCK // combinations)
            for first in range(0, table.cost.size**k, batch):
                flat = np.arange(first, min(first + batch, table.cost.size**k))
                cells = np.stack(np.unravel_index(flat, shape), axis=1)
                hits = _first_hits(table.normal_force[cells], units, load, grid.residual_limit, combinations)
                costs = table.cost[cells].sum(axis=1)
                rejections[BY_LATTICE] += int(np.sum(hits < 0))
                rejections[BY_MEASURE] += int(np.sum(hits >= 0))
                costs[hits < 0] = np.iinfo(np.int64).max
                j = int(np.argmin(costs))
                if hits[j] >= 0 and (best is None or costs[j] < best[0]):
                    best = (int(costs[j]), table, cells[j], int(hits[j]))
                bar.update(flat.size)
    except KeyboardInterrupt:
        interrupted = True
    bar.close()
    status = Status.INTERRUPTED if interrupted else Status.OK if best else Status.INFEASIBLE
    cell: Cell | None = None
    if best:
        rejections[BY_MEASURE] -= 1
        _, table, indices, combination = best
        pairs = np.array(np.unravel_index(combination, (per_contact,) * k))
        chosen = np.stack(np.unravel_index(pairs, (grid.multipliers.size,) * 2), axis=1)
        cell = Cell(table=table, indices=indices, multipliers=grid.multipliers[chosen])
    log = grid_log(problem, grid, cell, rejections)
    return grid_solution(problem, cell, status=status, search="paper", log=log, started=started)


def _first_hits(normal_forces: Array, units: Array, load: Array, limit: float, combinations: int) -> IntArray:
    """Per cell the first combination of options within the limit, or -1."""
    k, per_contact, rows = units.shape
    hits = np.full(len(normal_forces), -1, dtype=np.int64)
    for first in range(0, combinations, _BLOCK):
        flat = np.arange(first, min(first + _BLOCK, combinations))
        chosen = np.stack(np.unravel_index(flat, (per_contact,) * k))
        stacked = np.stack([units[i][chosen[i]] for i in range(k)])
        net = (normal_forces @ stacked.reshape(k, -1)).reshape(len(normal_forces), flat.size, rows) + load
        within = np.einsum("bcr,bcr->bc", net, net) <= limit**2
        found = within.any(axis=1) & (hits < 0)
        hits[found] = first + np.argmax(within[found], axis=1)
        if np.all(hits >= 0):
            break
    return hits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cell:
    """A point of the grid in (t_I, A) with multipliers.

    Attributes:
        table: of its impact time.
        indices: index of each contact's deceleration in the table (k,).
        multipliers: (k1, k2) (k, 2).
        residual_bound: certified least norm of the residual of any multipliers there [N]; 0 where none is computed.
    """

    table: TimeTable
    indices: IntArray
    multipliers: Array
    residual_bound: float = 0.0


def grid_log(
    problem: ForceProblem,
    grid: GridSpec,
    cell: Cell | None,
    rejections: dict[str, int],
    *,
    qp_solves: int = 0,
    cuts: int = 0,
    closest: Array | None = None,
) -> GridLog:
    """The log of a finished search; ``closest`` is the least residual seen (6,) [N, N m]."""
    return GridLog(
        points=grid.points(problem.k),
        cells=grid.cells(problem.k),
        qp_solves=qp_solves,
        cuts=cuts,
        rejections=rejections,
        residual_bound=0.0 if cell is None else cell.residual_bound,
        closest=read_only(np.zeros(6) if cell is not None or closest is None else closest),
    )


def grid_solution(
    problem: ForceProblem,
    cell: Cell | None,
    *,
    status: Status,
    search: str,
    log: GridLog,
    started: float,
    solver: str = "",
) -> GridSolution:
    """The record of a finished search."""
    if cell is None:
        impact_time, forces = None, np.zeros((0, 3))
    else:
        impact_time = cell.table.impact_time
        forces = problem.forces(cell.table.normal_force[cell.indices], cell.multipliers)
    return GridSolution(
        status=status,
        problem=problem,
        search=search,
        solver=solver,
        impact_time=impact_time,
        forces_c=frozen(forces),
        torsion=frozen(np.zeros(len(forces))),
        grid=log,
        elapsed=time.perf_counter() - started,
    )
