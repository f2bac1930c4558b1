"""One trial of many: the settings they share, the plan handed to other processes, and what came of it."""

from __future__ import annotations

import contextlib
import functools
import inspect
import pickle
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cloudpickle
import joblib

from pinograsp.checks import instance_of, number, one_of
from pinograsp.errors import InvalidInput, SimulationDiverged
from pinograsp.plan import PlanRecord
from pinograsp.referee.settings import Disturbance, Servo
from pinograsp.referee.simulate import simulate
from pinograsp.referee.task import Task
from pinograsp.writing import write_errors

# "body" belongs to the task, and what is never let go always holds.
_OTHERS = ("plan", "body", "release", "disturbance")
_DEFAULTS = {name: one.default for name, one in inspect.signature(simulate).parameters.items() if name not in _OTHERS}


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of one simulation.

    Attributes:
        held: whether the object stayed.
        reason: in words.
        drift: of the object [m]; None where the simulation diverged.
    """

    held: bool
    reason: str
    drift: float | None


def common_settings(plan: PlanRecord | Task | str | Path, settings: dict) -> tuple[Task, dict]:
    """The task of a plan, and all settings of its simulations, defaults included.

    Raises:
        InvalidInput: a plan that cannot be simulated, or a setting that does not exist here.
    """
    settings = dict(settings)
    body = settings.pop("body", None)
    task = plan if isinstance(plan, Task) else Task.of(plan, body)
    for name in settings:
        if name in _OTHERS:
            raise InvalidInput(f"setting '{name}': not accepted here, every trial is told by the study")
        one_of("setting", name, _DEFAULTS)
    settings = _DEFAULTS | settings
    for name, default in _DEFAULTS.items():
        if isinstance(default, float):
            settings[name] = number(name.replace("_", " "), settings[name])
    servo = settings["servo"]
    settings["servo"] = Servo.of(task.hand) if servo is None else instance_of("servo", servo, Servo)
    return task, settings


@contextlib.contextmanager
def handed_over(task: Task, settings: dict, jobs: int) -> Iterator[tuple[Task, dict] | str]:
    """A task with its settings as :func:`run_trial` takes them: for several processes, the path of a file for a while.

    Meshes are heavy: they go to every process once.
    """
    if joblib.effective_n_jobs(jobs) == 1:
        yield task, settings
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.pickle"
        with write_errors(path):
            path.write_bytes(cloudpickle.dumps((task, settings)))
        yield str(path)


@functools.lru_cache(maxsize=1)
def _read(path: str) -> tuple[Task, dict]:
    return pickle.loads(Path(path).read_bytes())


def run_trial(case: tuple[Task, dict] | str, disturbance: Disturbance, mu_factor: float = 1.0) -> Outcome:
    """Simulate a task; ``mu_factor`` times the friction of every contact where the disturbance does not set it."""
    task, settings = _read(case) if isinstance(case, str) else case
    if mu_factor != 1.0:
        task = replace(task, mu=mu_factor * task.mu)
    try:
        verdict = simulate(task, disturbance=disturbance, **settings).verdict
    except SimulationDiverged as error:
        return Outcome(held=False, reason=str(error), drift=None)
    return Outcome(held=verdict.held, reason=verdict.reason, drift=verdict.drift)
