"""``pinograsp bench``."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp.cli.screen import show, tell, tell_missing_core
from pinograsp.cli.session import Session

if TYPE_CHECKING:
    from pinograsp.forces import ForceProblem
    from pinograsp.spatial import Array

_REPEATS, _BATCH = 200, 10_000
_MOST_CONTACTS = 200  # more take minutes and gigabytes


def bench(
    *,
    contacts: Annotated[list[int] | None, typer.Option(help="Numbers of contacts; repeatable.")] = None,
    session: Session,
) -> None:
    """Measure the speed of this machine: one load of a ForceSolver, one step of OnlineForces, a batch of problems.

    Seeded random grasps on a cylinder with exact friction cones and least
    squares; medians over 200 loads. Comparisons with other solvers are in the
    sources, in benchmarks.

    Examples:
      pinograsp bench

      pinograsp bench --contacts 5 --contacts 16 --json
    """
    import numpy as np

    import pinograsp as pg
    from pinograsp import core
    from pinograsp.errors import InvalidInput

    contacts = contacts or [3, 10, 50]
    for k in contacts:
        if not 3 <= k <= _MOST_CONTACTS:
            raise InvalidInput(f"--contacts: expected at least 3 and at most {_MOST_CONTACTS}, got {k}")
    fast = core.is_installed()
    if not fast:
        tell_missing_core()
    rows: list[dict[str, Any]] = []
    for k in contacts:
        problem, loads = _problem(k)
        solver = pg.ForceSolver(problem, 0.9, objective="least_squares")
        rows.append({"contacts": k, "solve_us": _median(solver.solve, loads)})
        if fast:
            online = pg.OnlineForces(problem, normal_forces=(0.01, 30.0))
            rows[-1]["online_step_us"] = _median(online.step, loads)
            small = pg.ForceBatch.of([problem.with_load(load) for load in loads], 0.9)
            arrays: dict[str, Any] = {
                name: np.concatenate([getattr(small, name)] * (_BATCH // len(loads)))
                for name in ("points", "rotations", "loads", "mu", "low", "high", "counts", "moment_lengths")
            }
            batch = pg.ForceBatch(**arrays, friction=problem.friction)
            pg.solve_batch(small)
            rows[-1]["batch_per_problem_us"] = round(1e6 * pg.solve_batch(batch).elapsed / len(batch), 2)
    if session.as_json:
        session.print_json({"compiled": fast, "rows": rows})
        return
    columns = list(rows[0])
    tell("  ".join(columns))
    for row in rows:
        typer.echo("  ".join(f"{row[name]:>{len(name)}}" for name in columns))
    first = rows[0]
    told = f"{first['contacts']} contacts: {first['solve_us']:g} us per load"
    if fast:
        told += f", {first['online_step_us']:g} us per step of a loop, {first['batch_per_problem_us']:g} us in a batch"
    show([], [("How fast?", told)])


def _problem(k: int) -> tuple[ForceProblem, Array]:
    """A grasp of k contacts around a cylinder, and random loads near its weight."""
    import numpy as np

    import pinograsp as pg

    rng = np.random.default_rng(k)
    angle = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-0.2, 0.2, k)
    points = 0.03 * np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.5, 0.5, k)])
    body = pg.Cylinder(radius=0.03, height=0.2, mass=0.2)
    problem = pg.ForceProblem.holding(
        body, pg.contacts_at(None, body, points), mu=0.8, friction=pg.Friction(model="cone")
    )
    spread = rng.normal(size=(_REPEATS, 6)) * [0.3, 0.3, 0.3, 3e-3, 3e-3, 3e-3]
    return problem, np.array(problem.load) + spread


def _median(call: Callable[[Array], object], loads: Array) -> float:
    """Median time of a call [us]."""
    import statistics

    spent, clock = [], time.perf_counter
    for load in (loads[0], *loads):  # the first one warms up
        begun = clock()
        call(load)
        spent.append(clock() - begun)
    return round(1e6 * statistics.median(spent[1:]), 1)
