"""The rows of a sweep: how a worker computes them from their inputs, and the columns of the table."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np

from pinograsp.cases.sweep_rows import SweepBase
from pinograsp.contacts import Friction
from pinograsp.contacts.quality import Balance
from pinograsp.errors import ExtraMissing, PinograspError, Status, status_of
from pinograsp.forces import ForceBatch, ForceProblem, Objective, solve_batch
from pinograsp.hands.file_reads import noting_files

_Result = TypeVar("_Result")

# A row of the table, or of inputs: plain values by column.
Row: TypeAlias = dict[str, Any]
# Kinds of columns.
Kind = Literal["text", "json", "number", "whole", "flag", "numbers", "texts"]

# Columns beside index and inputs, with their kinds; empty where a row has no such value.
FIGURES: dict[Literal["plan", "forces"], dict[str, Kind]] = {
    "plan": {
        "status": "text",
        "message": "text",
        "search": "text",
        "solver": "text",
        "impact_time_s": "number",
        "work_J": "number",
        "impulse_Ns": "number",
        "normal_force_sum_N": "number",
        "normal_force_max_N": "number",
        "contacts": "texts",
        "normal_forces_N": "numbers",
        "residual_N": "number",
        "residual_Nm": "number",
        "max_penetration_m": "number",
        "peak_torque_Nm": "number",
        "tracking_error_max_m": "number",
        "relative_gap": "number",
        "friction_used_max": "number",
        "least_mu_max": "number",
        "slip_distance_min_N": "number",
        "load_factor": "number",
        "disturbance_any_N": "number",
        "disturbance_force_N": "number",
        "disturbance_moment_Nm": "number",
        "force_closure": "flag",
        "ferrari_canny_L1": "number",
        "min_singular_value": "number",
        "isotropy": "number",
        "elapsed_s": "number",
    },
    "forces": {
        "status": "text",
        "message": "text",
        "impact_time_s": "number",
        "work_J": "number",
        "impulse_Ns": "number",
        "normal_force_sum_N": "number",
        "normal_force_max_N": "number",
        "contacts": "texts",
        "normal_forces_N": "numbers",
        "objective": "number",
        "lower_bound": "number",
        "residual_N": "number",
        "violation_N": "number",
        "elapsed_s": "number",
    },
}


_LONGEST = 1.0  # [s] of a chunk: its rows may take much longer than earlier ones
_SCALARS: tuple[tuple[Kind, tuple[type, ...]], ...] = (
    ("flag", (bool,)),
    ("whole", (int,)),
    ("number", (int, float)),
    ("text", (str,)),
)


def kind_of(values: list[Any]) -> Kind:
    """The kind of an input's column: that of all its values, or ``"json"``."""
    for kind, accepted in _SCALARS:
        if kind != "text" and any(isinstance(value, int) and abs(value) >= 2**63 for value in values):
            continue  # too large for a column of numbers
        if all(isinstance(value, accepted) and isinstance(value, bool) == (kind == "flag") for value in values):
            return kind
    if all(isinstance(value, list | tuple) and kind_of(list(value)) in ("whole", "number") for value in values):
        return "numbers"
    return "json"


# Compiled code and cached hands are not safe for several threads.
_ONE_AT_A_TIME = threading.Lock()


class ChunkResult(NamedTuple):
    """What a worker returns: the rows of a chunk, their duration [s], and the indices of the rows that it left over."""

    rows: list[Row]
    seconds: float
    left: list[int]


def run_chunk(payload: str, rows: list[tuple[int, Row]]) -> ChunkResult:
    """Compute the rows of a chunk, given as index and inputs; rows are left over where the chunk takes too long.

    Raises:
        PinograspError: a file of the sweep's hands or objects has changed since it began.
    """
    with _ONE_AT_A_TIME, noting_files() as files:
        base = _base(payload)
        started = time.perf_counter()
        if base.what == "forces":
            results = _forces(base, rows, started)
        else:
            results = list(_in_time(started, rows, functools.partial(_row, _plan, base)))
        for path, digest in files.items():
            if digest != base.files.get(path, digest):
                raise PinograspError(
                    f"'{path}' has changed while the sweep was running; completed rows are kept: put it back and start "
                    "again, or give another folder"
                )
        done = [{"index": index, **inputs, **row} for (index, inputs), row in zip(rows, results)]
        return ChunkResult(done, time.perf_counter() - started, [index for index, _ in rows[len(results) :]])


def _in_time(started: float, rows: list[tuple[int, Row]], result_of: Callable[[Row], _Result]) -> Iterator[_Result]:
    """The results of the inputs of rows, until the time is up."""
    for _, inputs in rows:
        yield result_of(inputs)
        if time.perf_counter() - started > _LONGEST:
            return


@functools.lru_cache(maxsize=1)
def _base(payload: str) -> SweepBase:
    return SweepBase.model_validate_json(payload)


def _row(compute: Callable[[SweepBase, Row], _Result], base: SweepBase, inputs: Row) -> _Result | Row:
    """What ``compute`` returns, or its failure as a row."""
    started = time.perf_counter()
    try:
        return compute(base, inputs)
    except Exception as error:
        return _failure(error, time.perf_counter() - started)


def _failure(error: Exception, elapsed: float) -> Row:
    """The failure of a row, of any kind, which must not stop the sweep; a missing extra and Ctrl-C do."""
    if isinstance(error, ExtraMissing):
        raise error
    status = status_of(error)
    if status is Status.INTERRUPTED:
        raise KeyboardInterrupt from error
    text = str(error) if isinstance(error, PinograspError) else f"{type(error).__name__}: {error}"
    return {"status": str(status), "message": text, "elapsed_s": elapsed}


def _plan(base: SweepBase, inputs: Row) -> Row:
    plan = base.case(inputs).plan(progress=False)
    if plan.status is Status.INTERRUPTED:  # the search catches Ctrl-C
        raise KeyboardInterrupt
    summary = plan.summary()
    margins, forces = summary["margins"], summary["normal_forces_N"]

    def drop_missing(values: dict[str, float | None]) -> list[float]:
        return [value for value in values.values() if value is not None]

    return {
        **{name: summary[name] for name in FIGURES["plan"] if name in summary},
        **{name: margins[name] for name in FIGURES["plan"] if name in margins},
        "message": "; ".join([summary["remedy"], *summary["notes"]]) if plan.status is not Status.OK else None,
        "contacts": list(forces),
        "normal_forces_N": list(forces.values()),
        "normal_force_sum_N": sum(forces.values()),
        "normal_force_max_N": max(forces.values()),
        "tracking_error_max_m": max(drop_missing(summary["tracking_error_m"]), default=None),
        "relative_gap": (summary["certificate"] or {}).get("relative_gap"),
        "friction_used_max": max(drop_missing(margins["friction_used"]), default=None),
        "least_mu_max": max(drop_missing(margins["least_mu"]), default=None),
        "slip_distance_min_N": min(drop_missing(margins["slip_distance_N"]), default=None),
    }


class _Problem(NamedTuple):
    """A row's force problem, its impact time [s], and what it shares with the rows of its batch."""

    problem: ForceProblem
    at: float
    group: tuple[Friction, Balance, str]


def _forces(base: SweepBase, rows: list[tuple[int, Row]], started: float) -> list[Row]:
    """Rows of contact forces only: one batch for all rows with the same friction model, balance and objective."""
    groups: dict[tuple[Friction, Balance, str], list[int]] = {}
    prepared = list(_in_time(started, rows, functools.partial(_row, _problem, base)))
    results: list[Row] = [{} if isinstance(one, _Problem) else one for one in prepared]
    for i, one in enumerate(prepared):
        if isinstance(one, _Problem):
            groups.setdefault(one.group, []).append(i)
    for (_, _, objective), which in groups.items():
        batch = [one for i in which if isinstance(one := prepared[i], _Problem)]
        try:
            solved = _solve_batch(batch, json.loads(objective))
        except Exception as error:  # a failure of the batch is that of all its rows
            solved = [_failure(error, 0.0)] * len(batch)
        for i, row in zip(which, solved):
            results[i] = row
    seconds = time.perf_counter() - started
    return [{**row, "elapsed_s": seconds / len(results)} for row in results]


def _problem(base: SweepBase, inputs: Row) -> _Problem | Row:
    """A row's problem; or its result, where its limits leave no force."""
    case = base.case(inputs)
    problem = case.problem()
    at = problem.checked_impact_time(base.impact_time(inputs))
    low, high = problem.normal_force_range(at)
    if np.any(low > high):
        return {
            "status": str(Status.INFEASIBLE),
            "message": "the limits leave no normal force at this impact time",
            "impact_time_s": at,
        }
    objective = json.dumps(problem.measure if case.objective is None else case.objective, sort_keys=True)
    return _Problem(problem, at, (problem.friction, problem.balance, objective))


def _solve_batch(batch: list[_Problem], objective: Objective) -> list[Row]:
    """The rows of one batch."""
    problems, times = [one.problem for one in batch], [one.at for one in batch]
    answers = solve_batch(ForceBatch.of(problems, times), objective=objective, threads=1)
    rows: list[Row] = []
    for i, (problem, at, status) in enumerate(zip(problems, times, answers.status)):
        row: Row = {
            "status": str(status),
            "message": status.remedy or None,
            "impact_time_s": at,
            "contacts": list(problem.contacts.names),
        }
        rows.append(row)
        if status is not Status.OK:
            continue
        normal = answers.forces_c[i, : problem.k, 2]
        row |= {
            "work_J": float(problem.energy(normal, at, "work").sum()),
            "impulse_Ns": float(problem.energy(normal, at, "impulse").sum()),
            "normal_forces_N": normal.tolist(),
            "normal_force_sum_N": float(normal.sum()),
            "normal_force_max_N": float(normal.max()),
            "objective": float(answers.objective[i]),
            "lower_bound": float(answers.lower_bound[i]),
            "residual_N": float(answers.residual_norm[i]),
            "violation_N": float(answers.violation[i]),
        }
    return rows
