"""Random errors: how probably a plan holds, against each error alone and against all at once."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, fields
from numbers import Real
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pinograsp.checks import array_of, brief, floats_of, instance_of, integer, number, path_of, processes
from pinograsp.errors import InvalidInput
from pinograsp.interrupts import interrupts_kept, parallel_results
from pinograsp.referee.settings import Disturbance, Push, Servo
from pinograsp.referee.trial_log import TrialLog
from pinograsp.referee.trials import Outcome, common_settings, handed_over, run_trial

FILE, SCHEMA = "monte_carlo.jsonl", "pinograsp.monte_carlo/1"
TOGETHER = "together"
_Z = 1.959963984540054  # 97.5 % quantile of the normal distribution
_ARM = 0.03  # [m] what a radian of a turning joint is to a sliding one, as for the servos
_MOST = 1_000_000  # trials
_LIGHTEST = 0.01  # of the planned mass
_STANDARD_GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Sizes of the random errors, drawn independently of each other; zero switches one off.

    Attributes:
        position: of the object, std along world x, y, z: one number or (3,) [m].
        rotation: of the object, std of its rotation vector: one number or (3,) [rad].
        friction: relative std of mu, the same for all contacts, never below zero [-]; or a pair: mu is uniform between
            them.
        mass: relative std of the object's mass, never below a hundredth of it [-].
        posture: of the joints at t = 0, std [rad]; sliding joints 30 mm per radian. The servos take it away on the way;
            ``mode="prescribed"`` leaves it out.
        push: on the object's centre of mass, largest force as a share of its weight at 9.81 m/s^2 [-]: uniform in size
            and in direction, as long and as late as :class:`~pinograsp.referee.Push`.
    """

    position: float | tuple[float, ...] = 2e-3
    rotation: float | tuple[float, ...] = math.radians(2)
    friction: float | tuple[float, float] = 0.1
    mass: float = 0.1
    posture: float = math.radians(1)
    push: float = 0.2

    def __post_init__(self):
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            several = name in ("position", "rotation", "friction") and not isinstance(value, Real)
            if several and floats_of(f"error of {name}", value).ndim:
                kept = tuple(array_of(f"error of {name}", value, (2 if name == "friction" else 3,)).tolist())
                if min(kept) < 0 or (name == "friction" and kept[0] > kept[1]):
                    wanted = "0 <= lowest mu <= highest" if name == "friction" else "values >= 0"
                    raise InvalidInput(f"error of {name}: expected {wanted}, got {kept}")
            else:
                kept = number(f"error of {name}", value, at_least=0)
            object.__setattr__(self, name, kept)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the errors that are switched on."""
        return tuple(
            name for name, value in asdict(self).items() if np.any(value) or (name == "friction" and np.ndim(value))
        )

    def summary(self) -> dict:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """How often it held.

    Attributes:
        trials, held: numbers of simulations.
    """

    trials: int
    held: int

    @property
    def probability(self) -> float:
        """Share that held; nan without trials."""
        return self.held / self.trials if self.trials else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability, by Wilson's score."""
        return wilson(self.held, self.trials)


def wilson(held: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a probability of which ``held`` of ``trials`` were seen (E. B. Wilson, 1927)."""
    if not trials:
        return 0.0, 1.0
    share, z2 = held / trials, _Z**2 / trials
    middle = (share + z2 / 2) / (1 + z2)
    half = _Z / (1 + z2) * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials))
    # Rounding must not shut out what has been seen.
    return max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MonteCarlo:
    """What came of random errors.

    Attributes:
        errors: their sizes.
        count: trials asked for, of each error and of all together.
        seed: of the random numbers.
        held: by error, and ``"together"``.
        rows: the trials: ``error``, ``trial``, ``drawn`` (position [m], rotation [rad], friction: factor or mu, mass:
            factor, posture [rad or m], push [N]), ``held``, ``drift_m`` (None: the simulation diverged), ``reason``.
        settings: of the simulations.
        interrupted: whether it was stopped (Ctrl-C): the rows are those until then.
        elapsed: [s].
    """

    errors: Errors
    count: int
    seed: int
    held: dict[str, Held]
    rows: tuple[dict, ...]
    settings: dict
    interrupted: bool
    elapsed: float

    __repr__ = brief()

    def summary(self) -> dict:
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

    def arrays(self) -> dict[str, np.ndarray]:
        """Samples: ``<error>_trial``, ``_held``, ``_drift`` [m], ``_reason`` (t,), ``_drawn_<kind>`` (t,) or (t, d)."""
        out = {}
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
        for name, one in self.held.items():
            low, high = one.interval
            size = "all errors" if name == TOGETHER else _size(name, getattr(self.errors, name))
            share = f"{100 * one.probability:5.1f} %" if one.trials else "    - %"
            between = f"[{100 * low:5.1f}, {100 * high:5.1f}]"
            lines.append(f"  {name:9s} {share}  {between}  {one.held} of {one.trials}  ({size})")
        if self.interrupted:
            lines.append("  interrupted: these are the trials until then")
        return "\n".join(lines)


def _size(name: str, value) -> str:
    if name == "friction" and isinstance(value, tuple):
        return f"mu from {value[0]:g} to {value[1]:g}"
    degrees = (180 / math.pi, "deg")
    factor, unit = {"position": (1e3, "mm"), "rotation": degrees, "posture": degrees}.get(name, (100, "%"))
    shown = ", ".join(f"{factor * one:.4g}" for one in np.atleast_1d(value))
    return f"up to {shown} % of the weight" if name == "push" else f"std {shown} {unit}"


def monte_carlo(
    plan,
    *,
    count: int = 100,
    seed: int = 0,
    errors: Errors | None = None,
    jobs: int = -1,
    progress: bool | None = None,
    folder: str | Path | None = None,
    **settings,
) -> MonteCarlo:
    """Simulate a plan under random errors: ``count`` trials with each error alone, and ``count`` with all at once.

    Args:
        plan: as for :func:`~pinograsp.referee.simulate`.
        count: trials of each.
        seed: of the random numbers; the result does not depend on ``jobs``, nor an error's numbers on which others are
            switched on.
        errors: their sizes, default :class:`Errors`.
        jobs: processes (joblib); -1: all cores.
        progress: bar on stderr: None (on a terminal), True or False.
        folder: rows go into ``monte_carlo.jsonl`` there as they come, and those found there, of the same plan and
            settings, are not simulated again (``count`` may differ).
        **settings: of :func:`~pinograsp.referee.simulate`.

    Returns:
        Probabilities and trials, also after Ctrl-C. A simulation that diverges counts as lost.

    Raises:
        InvalidInput: unusable settings; a hold too short for the push; a folder with rows of another plan or of other
            settings.
        ResultsNotWritten: the folder cannot be written, or another process writes trials there.
    """
    started = time.perf_counter()
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    errors = Errors() if errors is None else instance_of("errors", errors, Errors)
    jobs = processes(jobs)
    instance_of("progress", progress, bool, type(None))
    folder = None if folder is None else path_of("folder", folder)
    task, settings = common_settings(plan, settings)
    push = Push(wrench_o=np.zeros(6))
    over = push.start + push.duration
    if errors.push and settings["hold"] < over:
        raise InvalidInput(f"hold: expected at least {over:g} s, the end of the push, got {settings['hold']:g} s")

    told = {name: _plain(value) for name, value in settings.items()}
    header = {"schema": SCHEMA, "seed": seed, "errors": errors.summary(), "settings": told, "plan": _identity(task)}
    log = TrialLog(None if folder is None else folder / FILE, header)
    names = (*errors.kinds, TOGETHER)
    wanted = [(name, trial) for name in names for trial in range(count)]
    todo = [key for key in wanted if key not in log.rows]
    interrupted = False
    bar = tqdm(
        total=len(wanted),
        initial=len(wanted) - len(todo),
        desc="Monte Carlo",
        unit="trial",
        disable=None if progress is None else not progress,
        leave=False,
    )
    with log, bar, handed_over(task, settings, jobs) as case, interrupts_kept() as interrupt:
        trials = ((case, *drawn_errors(task, errors, seed, name, trial), name, trial) for name, trial in todo)
        try:
            # As they come, so that an interruption loses none that is done.
            with parallel_results(_try, trials, jobs, return_as="generator_unordered") as results:
                for name, trial, drawn, outcome in results:
                    log.add(
                        {
                            "error": name,
                            "trial": trial,
                            "drawn": drawn,
                            "held": outcome.held,
                            "drift_m": outcome.drift,
                            "reason": outcome.reason,
                        }
                    )
                    bar.update()
                    interrupt()
        except KeyboardInterrupt:
            interrupted = True
    rows = tuple(log.rows[key] for key in wanted if key in log.rows)
    held = {}
    for name in names:
        own = [row["held"] for row in rows if row["error"] == name]
        held[name] = Held(trials=len(own), held=sum(own))
    return MonteCarlo(
        errors=errors,
        count=count,
        seed=seed,
        held=held,
        rows=rows,
        settings=told,
        interrupted=interrupted,
        elapsed=time.perf_counter() - started,
    )


def _try(
    case, drawn: dict, disturbance: Disturbance, mu_factor: float, name: str, trial: int
) -> tuple[str, int, dict, Outcome]:
    return name, trial, drawn, run_trial(case, disturbance, mu_factor)


def drawn_errors(task, errors: Errors, seed: int, name: str, trial: int) -> tuple[dict, Disturbance, float]:
    """A trial's errors as plain values, as a disturbance, and the factor of mu."""
    every = [field.name for field in fields(Errors)]
    # An error's numbers are its own: switching another on or off, or more trials, changes none of them.
    place = len(every) if name == TOGETHER else every.index(name)
    drawn, told, mu_factor = {}, {}, 1.0
    for kind in errors.kinds if name == TOGETHER else (name,):
        size = getattr(errors, kind)
        # What spawning the seed for every error, that for every trial, and that for every kind gives.
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place, trial, every.index(kind))))
        if kind in ("position", "rotation"):
            value = told["object_offset" if kind == "position" else "object_turn"] = rng.normal(size=3) * size
        elif kind == "friction":
            if isinstance(size, tuple):
                value = told["mu"] = rng.uniform(*size)
            else:
                value = mu_factor = max(0.0, 1.0 + size * rng.normal())
        elif kind == "mass":
            value = told["mass_factor"] = max(_LIGHTEST, 1.0 + size * rng.normal())
        elif kind == "posture":
            model = task.hand.model
            slides = [task.hand.is_prismatic(model.getJointId(joint)) for joint in task.hand.joint_names]
            value = told["start_error"] = rng.normal(size=task.hand.n) * size * np.where(slides, _ARM, 1.0)
        else:
            direction = rng.normal(size=3)
            most = size * task.body.mass * _STANDARD_GRAVITY
            value = rng.uniform(0.0, most) * direction / np.linalg.norm(direction)
            told["pushes"] = (Push(wrench_o=np.concatenate([value, np.zeros(3)])),)
        drawn[kind] = np.asarray(value).tolist()
    return drawn, Disturbance(**told), mu_factor


def _plain(value):
    if isinstance(value, Servo):
        return {name: getattr(value, name).tolist() for name in ("stiffness", "damping", "rotor")}
    return value.item() if isinstance(value, np.generic) else value


def _identity(task) -> dict:
    """What tells a plan from others, as plain values."""
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
        "law": list(task.law),
        "torsion": task.torsion,
        "object": type(task.body).__name__,
        "object_mass": task.body.mass,
        "object_inertia": task.body.inertia_b.tolist(),
        "object_pose": task.body.pose.tolist(),
        **{name: np.asarray(getattr(task, name)).tolist() for name in names},
    }
