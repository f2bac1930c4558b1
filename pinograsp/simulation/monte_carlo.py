"""Random errors: the probability that a plan holds with each error alone, and with all of them together."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pinograsp.checks import array_of, brief, floats_of, instance_of, integer, number, path_of, processes
from pinograsp.errors import InvalidInput
from pinograsp.interrupts import interrupts_kept, parallel_results
from pinograsp.plan import PlanRecord
from pinograsp.simulation.settings import Disturbance, Push, Servo
from pinograsp.simulation.task import Task
from pinograsp.simulation.trial_log import TrialLog, TrialRow
from pinograsp.simulation.trials import Case, StudySettings, common_settings, handed_over, run_trial

if TYPE_CHECKING:
    from typing_extensions import Unpack

FILE, SCHEMA = "monte_carlo.jsonl", "pinograsp.monte_carlo/1"
TOGETHER = "together"
_Z = 1.959963984540054  # 97.5 % quantile of the normal distribution
_ARM = 0.03  # [m] motion of a sliding joint that compares with one radian of a turning joint, as for the servos
_MOST = 1_000_000  # trials
_LEAST = 0.01  # smallest factor of the mass, and of the servos' gains
_STANDARD_GRAVITY = 9.81  # [m/s^2]


# Errors that may be given as several numbers, and what is expected of those that are ranges.
_SEVERAL = ("position", "rotation", "friction", "stiffness")
_RANGES = {"friction": "0 <= lowest mu <= highest", "stiffness": "0 < lowest factor <= highest"}
# Errors in the order of their random numbers. All together had theirs at the place after the first six.
_FIRST = ("position", "rotation", "friction", "mass", "posture", "push")


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Sizes of the random errors, which are drawn independently of each other; zero switches an error off.

    Attributes:
        position: standard deviation of the object's position along world x, y, z: one number or (3,) [m].
        rotation: standard deviation of the object's rotation vector: one number or (3,) [rad].
        friction: relative standard deviation of mu, the same factor for all contacts [-]; or a pair, between which mu
            is uniform.
        mass: relative standard deviation of the object's mass [-]; the mass is at least a hundredth of the planned one.
        posture: standard deviation of the joints' positions at t = 0 [rad]; for sliding joints 30 mm per radian. The
            servos correct it during the approach. Set it to zero with ``mode="prescribed"``.
        push: largest force on the object's centre of mass, as a share of its weight at 9.81 m/s^2 [-]. Size and
            direction are uniform; start and duration are the defaults of :class:`~pinograsp.simulation.Push`.
        stiffness: a pair, between which the factor of the contacts' K is, its logarithm uniform; 0: as planned.
        joint_offset: standard deviation of what the joints' encoders read too much [rad]; for sliding joints 30 mm per
            radian.
        joint_friction: largest dry friction of the joints [N m]; for sliding joints of a force 30 mm from its axis.
            Each is uniform from 0.
        servo_gain: relative standard deviation of the servos' gains, the same factor for all joints [-]; it is at least
            a hundredth.
    """

    position: float | tuple[float, ...] = 2e-3
    rotation: float | tuple[float, ...] = math.radians(2)
    friction: float | tuple[float, float] = 0.1
    mass: float = 0.1
    posture: float = math.radians(1)
    push: float = 0.2
    stiffness: float | tuple[float, float] = 0.0
    joint_offset: float = 0.0
    joint_friction: float = 0.0
    servo_gain: float = 0.0

    __repr__ = brief()

    def __post_init__(self) -> None:
        kept: float | tuple[float, ...]
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            several = name in _SEVERAL and not isinstance(value, Real)
            if several and floats_of(f"error of {name}", value).ndim:
                values = array_of(f"error of {name}", value, (2 if name in _RANGES else 3,))
                kept = tuple(values.tolist())
                if values.min() < 0 or (name in _RANGES and values[0] > values[1]):
                    raise InvalidInput(f"error of {name}: expected {_RANGES.get(name, 'values >= 0')}, got {kept}")
                if name == "stiffness":
                    for factor in kept:
                        Disturbance(stiffness=factor)  # refuses what no simulation takes
            else:
                kept = number(f"error of {name}", value, at_least=0)
                if name == "stiffness" and kept:
                    raise InvalidInput(f"error of stiffness: expected a pair of factors, or 0, got {kept:g}")
            object.__setattr__(self, name, kept)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the errors that are switched on."""
        return tuple(
            name for name, value in asdict(self).items() if np.any(value) or (name == "friction" and np.ndim(value))
        )

    def summary(self) -> dict[str, Any]:
        """As plain JSON values; of the contacts' and the drives' errors those that are switched on."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
            if name in _FIRST or name in self.kinds
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
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
            [rad or m], push [N], stiffness (factor), joint_offset [rad or m], joint_friction [N m or N] and servo_gain
            (factor).
        settings: of the simulations.
        interrupted: whether Ctrl-C stopped the study; the rows are those until then.
        elapsed: [s].
    """

    errors: Errors
    count: int
    seed: int
    held: dict[str, Held]
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
            size = "all errors" if name == TOGETHER else _size(name, getattr(self.errors, name))
            share = f"{100 * one.probability:5.1f} %" if one.trials else "    - %"
            between = f"[{100 * low:5.1f}, {100 * high:5.1f}]"
            lines.append(f"  {name:{width}s} {share}  {between}  {one.held} of {one.trials}  ({size})")
        if self.interrupted:
            lines.append("  interrupted: only the trials until then")
        return "\n".join(lines)


def _size(name: str, value: float | tuple[float, ...]) -> str:
    """The size of an error in words."""
    if name == "friction" and isinstance(value, tuple):
        return f"mu from {value[0]:g} to {value[1]:g}"
    if name == "stiffness" and isinstance(value, tuple):
        return f"{value[0]:g} to {value[1]:g} times the contacts' K"
    if name == "joint_friction":
        return f"up to {value:g} N m"
    degrees = (180 / math.pi, "deg")
    units = {"position": (1e3, "mm"), "rotation": degrees, "posture": degrees, "joint_offset": degrees}
    factor, unit = units.get(name, (100, "%"))
    shown = ", ".join(f"{factor * one:.4g}" for one in np.atleast_1d(value))
    return f"up to {shown} % of the weight" if name == "push" else f"std {shown} {unit}"


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
    """Simulate a plan with random errors: ``count`` trials with each error alone, and ``count`` with all together.

    Args:
        plan: as for :func:`~pinograsp.simulation.simulate`.
        count: trials with each error, and with all together.
        seed: of the random numbers. The result does not depend on ``jobs``, and the numbers of one error do not depend
            on the others.
        errors: their sizes, default :class:`Errors`.
        jobs: processes (joblib); -1: all cores.
        progress: bar on stderr: None (on a terminal), True or False.
        folder: trials are written to ``monte_carlo.jsonl`` there as they are done. Trials found there, of the same plan
            and settings, are not repeated (``count`` may differ).
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
    task, common = common_settings(plan, settings)
    _check_hold(errors, common["hold"])
    plain = {name: _plain(value) for name, value in common.items()}
    given = {"engine": "mujoco", **plain}  # trials of another engine, which 0.2.0 had, are not mixed with these
    header = {"schema": SCHEMA, "seed": seed, "errors": errors.summary(), "settings": given, "plan": _identity(task)}
    log = TrialLog(file, header)
    names = (*errors.kinds, TOGETHER)
    wanted = [(name, trial) for name in names for trial in range(count)]
    todo = [key for key in wanted if key not in log.rows]
    with log, _bar(len(wanted), len(todo), progress) as bar, handed_over(task, common, jobs) as case:
        trials = ((case, drawn_errors(task, errors, seed, *key), *key) for key in todo)
        interrupted = _run(log, bar, trials, jobs)
    rows = tuple(log.rows[key] for key in wanted if key in log.rows)
    return MonteCarlo(
        errors=errors,
        count=count,
        seed=seed,
        held={name: _counts(rows, name) for name in names},
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


def _counts(rows: tuple[TrialRow, ...], name: str) -> Held:
    own = [row["held"] for row in rows if row["error"] == name]
    return Held(trials=len(own), held=sum(own))


class DrawnErrors(NamedTuple):
    """The random errors of one trial: as plain values by error, as a disturbance, and the factor of mu."""

    values: dict[str, Any]
    disturbance: Disturbance
    mu_factor: float


def drawn_errors(task: Task, errors: Errors, seed: int, name: str, trial: int) -> DrawnErrors:
    """The errors of a trial, ``name`` alone or ``"together"``."""
    every = [field.name for field in fields(Errors)]
    # Each error has its own random numbers: other errors, or more trials, change none of them.
    together = len(_FIRST)
    place = together if name == TOGETHER else every.index(name) + (name not in _FIRST)
    drawn: dict[str, Any] = {}
    given: dict[str, Any] = {}
    mu_factor = 1.0
    for kind in errors.kinds if name == TOGETHER else (name,):
        # The same as spawning the seed for every error, then for every trial, then for every kind.
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place, trial, every.index(kind))))
        value = _drawn(kind, getattr(errors, kind), rng, task)
        drawn[kind] = np.asarray(value).tolist()
        if kind == "friction" and not isinstance(errors.friction, tuple):
            mu_factor = float(value)
        elif kind == "push":
            given["pushes"] = (Push(wrench_o=np.concatenate([value, np.zeros(3)])),)
        else:
            given[_FIELDS.get(kind, kind)] = value
    return DrawnErrors(drawn, Disturbance(**given), mu_factor)


# Fields of a disturbance that are not named as the errors.
_FIELDS = {
    "position": "object_offset",
    "rotation": "object_turn",
    "friction": "mu",
    "mass": "mass_factor",
    "posture": "start_error",
}


def _drawn(kind: str, size: Any, rng: np.random.Generator, task: Task) -> Any:
    """One random error of a kind, a number or an array."""
    if kind in ("position", "rotation"):
        return rng.normal(size=3) * size
    if kind == "friction":
        return rng.uniform(*size) if isinstance(size, tuple) else max(0.0, 1.0 + size * rng.normal())
    if kind in ("mass", "servo_gain"):
        return max(_LEAST, 1.0 + size * rng.normal())
    if kind == "stiffness":
        return float(np.clip(np.exp(rng.uniform(*np.log(size))), *size))
    if kind == "push":
        direction = rng.normal(size=3)
        most = size * task.body.mass * _STANDARD_GRAVITY
        return rng.uniform(0.0, most) * direction / np.linalg.norm(direction)
    slides = task.hand.slides
    if kind == "joint_friction":
        return rng.uniform(size=task.hand.n) * size / np.where(slides, _ARM, 1.0)
    return rng.normal(size=task.hand.n) * size * np.where(slides, _ARM, 1.0)


def _plain(value: object) -> object:
    """A setting as a JSON value."""
    if isinstance(value, Servo):
        gains = {name: getattr(value, name).tolist() for name in ("stiffness", "damping", "rotor")}
        return gains if value.control == "impedance" else {**gains, "control": value.control}
    return value.item() if isinstance(value, np.generic) else value


def _identity(task: Task) -> dict[str, Any]:
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
