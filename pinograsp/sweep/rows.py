"""The rows of a sweep: what a worker makes of the inputs of its plans, and the columns of the table."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections.abc import Iterator

import numpy as np

from pinograsp.cases.sweep_file import Base
from pinograsp.errors import ExtraMissing, PinograspError, Status, status_of
from pinograsp.forces import ForceBatch, solve_batch

# Columns beside index and inputs, with their kinds; empty where a row has no such figure.
FIGURES = {
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


_LONGEST = 1.0  # [s] of a chunk: rows may take much longer than those before them


def kind_of(values: list) -> str:
    """The kind of an input's column: that of all its values, or ``"json"``."""
    for kind, accepted in (("flag", bool), ("whole", int), ("number", int | float), ("text", str)):
        if kind != "text" and any(isinstance(value, int) and abs(value) >= 2**63 for value in values):
            continue  # no column of numbers takes it
        if all(isinstance(value, accepted) and isinstance(value, bool) == (kind == "flag") for value in values):
            return kind
    if all(isinstance(value, list | tuple) and kind_of(list(value)) in ("whole", "number") for value in values):
        return "numbers"
    return "json"


# The compiled code and the hands that are kept do not stand several threads.
_ONE_AT_A_TIME = threading.Lock()


def run_chunk(payload: str, rows: list[tuple[int, dict]]) -> tuple[list[dict], float, list[int]]:
    """What workers do: the rows of a chunk, given as index and inputs, the seconds they took, and the indices of those
    left over when it had lasted for long.
    """
    with _ONE_AT_A_TIME:
        base = _base(payload)
        started = time.perf_counter()
        if base.what == "forces":
            made = _forces(base, rows, started)
        else:
            made = list(_in_time(started, rows, lambda inputs: _row(_planned, base, inputs)))
        told = [{"index": index, **inputs, **row} for (index, inputs), row in zip(rows, made)]
        return told, time.perf_counter() - started, [index for index, _ in rows[len(made) :]]


def _in_time(started: float, rows: list[tuple[int, dict]], make) -> Iterator[dict]:
    """What ``make`` makes of the inputs of rows, until time is up."""
    for _, inputs in rows:
        yield make(inputs)
        if time.perf_counter() - started > _LONGEST:
            return


@functools.lru_cache(maxsize=1)
def _base(payload: str) -> Base:
    return Base.model_validate_json(payload)


def _row(make, *args) -> dict:
    """What ``make`` returns, or its failure as a row."""
    started = time.perf_counter()
    try:
        return make(*args)
    except ExtraMissing:
        raise
    except Exception as error:  # one row's failure, of whatever kind, is not the sweep's
        status = status_of(error)
        text = str(error) if isinstance(error, PinograspError) else f"{type(error).__name__}: {error}"
        if status is Status.INTERRUPTED:
            raise KeyboardInterrupt from error
        return {"status": str(status), "message": text, "elapsed_s": time.perf_counter() - started}


def _planned(base: Base, inputs: dict) -> dict:
    plan = base.case(inputs).plan(progress=False)
    if plan.status is Status.INTERRUPTED:  # the search hears Ctrl-C first
        raise KeyboardInterrupt
    told = plan.summary()
    margins, forces = told["margins"], told["normal_forces_N"]

    def of(values: dict, pick) -> float | None:
        return pick((value for value in values.values() if value is not None), default=None)

    return {
        **{name: told[name] for name in FIGURES["plan"] if name in told},
        **{name: margins[name] for name in FIGURES["plan"] if name in margins},
        "message": "; ".join([told["remedy"], *told["notes"]]) if plan.status is not Status.OK else None,
        "contacts": list(forces),
        "normal_forces_N": list(forces.values()),
        "normal_force_sum_N": sum(forces.values()),
        "normal_force_max_N": max(forces.values()),
        "tracking_error_max_m": of(told["tracking_error_m"], max),
        "relative_gap": (told["certificate"] or {}).get("relative_gap"),
        "friction_used_max": of(margins["friction_used"], max),
        "least_mu_max": of(margins["least_mu"], max),
        "slip_distance_min_N": of(margins["slip_distance_N"], min),
    }


def _forces(base: Base, rows: list[tuple[int, dict]], started: float) -> list[dict]:
    """Forces alone: one batch for all rows of one friction model, balance and objective."""
    groups: dict = {}
    made = list(_in_time(started, rows, lambda inputs: _row(_problem, base, inputs)))
    for i, row in enumerate(made):
        if "problem" in row:
            groups.setdefault(row["group"], []).append(i)
    for (_, _, objective), which in groups.items():
        solved = _row(_solved, [made[i] for i in which], json.loads(objective))
        for place, i in enumerate(which):
            made[i] = solved.get(place, solved)  # one failure is that of all of them
    seconds = time.perf_counter() - started
    return [{**row, "elapsed_s": seconds / len(made)} for row in made]


def _problem(base: Base, inputs: dict) -> dict:
    """A row's problem, impact time, and what it shares with its batch; or that its limits leave no force."""
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
    return {"problem": problem, "at": at, "group": (problem.friction, problem.balance, objective)}


def _solved(group: list[dict], objective) -> dict[int, dict]:
    """The rows of one batch, by their place in it."""
    problems, times = [one["problem"] for one in group], [one["at"] for one in group]
    answers = solve_batch(ForceBatch.of(problems, times), objective=objective, threads=1)
    made = {}
    for i, (problem, at, status) in enumerate(zip(problems, times, answers.status)):
        made[i] = {
            "status": str(status),
            "message": status.remedy or None,
            "impact_time_s": at,
            "contacts": list(problem.contacts.names),
        }
        if status is not Status.OK:
            continue
        normal = answers.forces_c[i, : problem.k, 2]
        made[i] |= {
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
    return made
