"""The probability that a plan holds with each random error alone, and with all of them together."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pinograsp.checks import brief, instance_of, integer, path_of, processes
from pinograsp.errors import InvalidInput
from pinograsp.interrupts import interrupts_kept
from pinograsp.plan import PlanRecord
from pinograsp.processes import parallel_results
from pinograsp.simulation.options import StudySettings
from pinograsp.simulation.random_errors import TOGETHER, DrawnErrors, Errors, draw_errors, word_size
from pinograsp.simulation.settings import Push
from pinograsp.simulation.task import Task
from pinograsp.simulation.trial_log import TrialLog, TrialRow
from pinograsp.simulation.trials import Case, prepare_trials, run_trial, share_case

if TYPE_CHECKING:
    from typing_extensions import Unpack

FILE, SCHEMA = "monte_carlo.jsonl", "pinograsp.monte_carlo/1"
_Z = 1.959963984540054  # 97.5 % quantile of the normal distribution
_MOST = 1_000_000  # trials


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldCount:
    """How often the object was held.

    Attributes:
        trials: number of simulations.
        held: number of those in which the object was held.
    """

    trials: int
    held: int

    @property
    def probability(self) -> float:
        """Share of the trials that held; nan without trials."""
        return self.held / self.trials if self.trials else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability, by Wilson's score."""
        return wilson(self.held, self.trials)


def wilson(held: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a probability, from ``held`` out of ``trials`` (E. B. Wilson, 1927)."""
    if not trials:
        return 0.0, 1.0
    share, z2 = held / trials, _Z**2 / trials
    middle = (share + z2 / 2) / (1 + z2)
    half = _Z / (1 + z2) * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials))
    # Rounding must not exclude the observed share.
    return max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MonteCarlo:
    """Results of a study with random errors.

    Attributes:
        errors: their sizes.
        count: requested trials with each error, and with all together.
        seed: of the random numbers.
        held: counts by error, and ``"together"``.
        rows: the trials; ``drawn`` holds position [m], rotation [rad], friction (factor or mu), mass (factor), posture
            [rad or m], push [N], stiffness (factor), joint_offset [rad or m], joint_friction [N m or N], servo_gain
            (factor) and pose (displacement [m] and rotation vector [rad]).
        settings: of the simulations.
        interrupted: whether Ctrl-C stopped the study; it then has the rows until then.
        elapsed: [s].
    """

    errors: Errors
    count: int
    seed: int
    held: dict[str, HoldCount]
    rows: tuple[TrialRow, ...]
    settings: dict[str, Any]
    interrupted: bool
    elapsed: float

    __repr__ = brief()

    def __str__(self) -> str:
        return self.describe()

    def summary(self) -> dict[str, Any]:
        """Probabilities and settings as plain JSON values."""
        return {
            "count": self.count,
            "seed": self.seed,
            "errors": self.errors.summary(),
            "held": {
                name: {
                    "trials": one.trials,
                    "held": one.held,
                    "probability": one.probability if one.trials else None,
                    "interval_95": list(one.interval),
                }
                for name, one in self.held.items()
            },
            "settings": self.settings,
            "interrupted": self.interrupted,
            "elapsed_s": self.elapsed,
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The trials as arrays: ``<error>_trial``, ``_held``, ``_drift`` [m], ``_reason`` (t,), ``_drawn_<kind>`` (t,)
        or (t, d).
        """
        out: dict[str, NDArray[Any]] = {}
        for name in self.held:
            rows = [row for row in self.rows if row["error"] == name]
            out[f"{name}_trial"] = np.array([row["trial"] for row in rows], dtype=int)
            out[f"{name}_held"] = np.array([row["held"] for row in rows], dtype=bool)
            out[f"{name}_drift"] = np.array([row["drift_m"] for row in rows], dtype=float)  # nan for None
            out[f"{name}_reason"] = np.array([row["reason"] for row in rows], dtype=str)
            for kind in self.errors.kinds if name == TOGETHER else (name,):
                out[f"{name}_drawn_{kind}"] = np.array([row["drawn"][kind] for row in rows], dtype=float)
        return out

    def describe(self) -> str:
        """The probabilities as readable text."""
        lines = ["probability of holding, 95 % confidence:"]
        width = max(9, *map(len, self.held))
        for name, one in self.held.items():
            low, high = one.interval
            size = "all errors" if name == TOGETHER else word_size(name, getattr(self.errors, name))
            share = f"{100 * one.probability:5.1f} %" if one.trials else "    - %"
            between = f"[{100 * low:5.1f}, {100 * high:5.1f}]"
            lines.append(f"  {name:{width}s} {share}  {between}  {one.held} of {one.trials}  ({size})")
        if self.interrupted:
            lines.append("  interrupted: only the trials until then")
        return "\n".join(lines)


def monte_carlo(
    plan: PlanRecord | Task | str | Path,
    *,
    count: int = 100,
    seed: int = 0,
    errors: Errors | None = None,
    jobs: int = -1,
    progress: bool | None = None,
    folder: str | Path | None = None,
    **settings: Unpack[StudySettings],
) -> MonteCarlo:
    """Simulate a plan with random errors: ``count`` trials with each error alone, and ``count`` with all together; of
    poses alone (:meth:`Errors.of_pose`) ``count`` in all.

    Args:
        plan: as for :func:`~pinograsp.simulation.simulate`.
        count: trials with each error, and with all together.
        seed: of the random numbers. The result does not depend on ``jobs``, and the numbers of one error do not depend
            on the others.
        errors: their sizes, default :class:`Errors`.
        jobs: processes (joblib); -1: all cores.
        progress: bar on stderr: None (on a terminal), True or False.
        folder: folder in which finished trials are written to ``monte_carlo.jsonl``. Trials of the same plan and
            settings that are already there are not repeated (``count`` may differ).
        **settings: of :func:`~pinograsp.simulation.simulate`.

    Returns:
        Probabilities and trials, also after Ctrl-C. A simulation that diverges counts as lost.

    Raises:
        InvalidInput: unusable settings; a hold too short for the push; a folder with trials of another plan or of other
            settings.
        ResultsNotWritten: the folder cannot be written, or another process writes trials there.
    """
    started = time.perf_counter()
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    errors = Errors() if errors is None else instance_of("errors", errors, Errors)
    jobs = processes(jobs)
    instance_of("progress", progress, bool, type(None))
    file = None if folder is None else path_of("folder", folder) / FILE
    task, options = prepare_trials(plan, settings)
    _check_hold(errors, options.hold)
    plain = options.summary()
    header = {
        "schema": SCHEMA,
        "seed": seed,
        "errors": errors.summary(),
        "settings": {"engine": "mujoco", **plain},  # 0.2.0 had another one: its trials are not mixed with these
        "plan": _identify(task),
    }
    log = TrialLog(file, header)
    names = errors.kinds if errors.kinds == ("pose",) else (*errors.kinds, TOGETHER)
    wanted = [(name, trial) for name in names for trial in range(count)]
    todo = [key for key in wanted if key not in log.rows]
    with log, _bar(len(wanted), len(todo), progress) as bar, share_case(task, options, jobs) as case:
        trials = ((case, draw_errors(task, errors, seed, *key), *key) for key in todo)
        interrupted = _run(log, bar, trials, jobs)
    rows = tuple(log.rows[key] for key in wanted if key in log.rows)
    return MonteCarlo(
        errors=errors,
        count=count,
        seed=seed,
        held={name: _count(rows, name) for name in names},
        rows=rows,
        settings=plain,
        interrupted=interrupted,
        elapsed=time.perf_counter() - started,
    )


def _check_hold(errors: Errors, hold: float) -> None:
    """Refuse a hold that ends before the random push."""
    push = Push(wrench_o=np.zeros(6))
    over = push.start + push.duration
    if errors.push and hold < over:
        raise InvalidInput(f"hold: expected at least {over:g} s, the end of the push, got {hold:g} s")


def _bar(total: int, left: int, progress: bool | None) -> tqdm:
    hidden = None if progress is None else not progress
    return tqdm(total=total, initial=total - left, desc="Monte Carlo", unit="trial", disable=hidden, leave=False)


def _run(log: TrialLog, bar: tqdm, trials: Iterator[tuple[Case, DrawnErrors, str, int]], jobs: int) -> bool:
    """Simulate the trials and log them; returns whether Ctrl-C stopped it."""
    with interrupts_kept() as interrupt:
        try:
            # Rows are logged as they come, so that an interruption loses none that is done.
            with parallel_results(_try, trials, jobs, return_as="generator_unordered") as rows:
                for row in rows:
                    log.add(row)
                    bar.update()
                    interrupt()
        except KeyboardInterrupt:
            return True
    return False


def _try(case: Case, drawn: DrawnErrors, name: str, trial: int) -> TrialRow:
    outcome = run_trial(case, drawn.disturbance, drawn.mu_factor)
    return {
        "error": name,
        "trial": trial,
        "drawn": drawn.values,
        "held": outcome.held,
        "drift_m": outcome.drift,
        "reason": outcome.reason,
    }


def _count(rows: tuple[TrialRow, ...], name: str) -> HoldCount:
    own = [row["held"] for row in rows if row["error"] == name]
    return HoldCount(trials=len(own), held=sum(own))


def _identify(task: Task) -> dict[str, Any]:
    """Plain values by which a plan is recognised."""
    names = ("points_o", "normal_forces", "holding_torques", "mu", "load", "gravity_o")
    return {
        "hand": task.hand.name,
        "joints": list(task.hand.joint_names),
        "hand_pose": task.hand.pose.tolist(),
        "start": task.q[0].tolist(),
        "middle": task.q[len(task.q) // 2].tolist(),
        "end": task.q[-1].tolist(),
        "torque_limit": [float(v) if np.isfinite(v) else None for v in task.torque_limit],
        "shapes": [type(one.geometry).__name__ for one in task.hand.geometry.geometryObjects],
        "object_radius": task.body.bounding_radius,
        "impact_time": task.impact_time,
        "final_time": task.final_time,
        "law": [task.law.stiffness, task.law.damping, task.law.exponent, *task.law.table.ravel().tolist()],
        "torsion": task.torsion,
        "object": type(task.body).__name__,
        "object_mass": task.body.mass,
        "object_inertia": task.body.inertia_b.tolist(),
        "object_pose": task.body.pose.tolist(),
        **{name: np.asarray(getattr(task, name)).tolist() for name in names},
    }
