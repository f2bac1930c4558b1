"""Single trials of a study: their common settings, the plan for other processes, and their outcomes."""

from __future__ import annotations

import contextlib
import functools
import inspect
import pickle
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import cloudpickle
import joblib

from pinograsp.checks import instance_of, number, one_of
from pinograsp.errors import InvalidInput, SimulationDiverged
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord
from pinograsp.simulation.settings import SUPPORTS, Disturbance, Servo
from pinograsp.simulation.simulate import MODES, Mode, SimulationSettings, simulate, task_of
from pinograsp.simulation.task import Task
from pinograsp.writing import write_errors

# Set by the studies themselves; an object that is never let go would always be held.
_NOT_ACCEPTED = ("plan", "release", "disturbance")


class TrialSettings(SimulationSettings, total=False):
    """Settings that the trials of a study share: keyword arguments of :func:`~pinograsp.simulation.simulate`."""

    mode: Mode


class StudySettings(TrialSettings, total=False):
    """Settings that a study accepts: those of its trials, and the object where the plan has none."""

    body: Body | None


# A task with the settings of its trials, or the path of a file that holds both.
Case: TypeAlias = tuple[Task, TrialSettings] | str

_DEFAULTS = {
    name: one.default
    for name, one in inspect.signature(simulate).parameters.items()
    if name in TrialSettings.__annotations__
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Outcome of one simulation.

    Attributes:
        held: whether the object stayed in the hand.
        reason: why, in words; of a lost object with the first cause.
        drift: of the object [m]; None: the simulation diverged.
    """

    held: bool
    reason: str
    drift: float | None


def common_settings(plan: PlanRecord | Task | str | Path, settings: StudySettings) -> tuple[Task, TrialSettings]:
    """The task of a plan, and all settings of its trials, defaults included.

    Raises:
        InvalidInput: a plan that cannot be simulated, or a setting that does not exist here.
    """
    given: dict[str, Any] = dict(settings)
    body = given.pop("body", None)
    task = task_of(plan, body)
    for name in given:
        if name in _NOT_ACCEPTED:
            raise InvalidInput(f"setting '{name}': not accepted here, the study sets it for every trial")
        one_of("setting", name, _DEFAULTS)
    values = _DEFAULTS | given
    servo = values["servo"]
    return task, TrialSettings(
        hold=number("hold", values["hold"]),
        mode=one_of("mode", values["mode"], MODES),
        servo=Servo.of(task.hand) if servo is None else instance_of("servo", servo, Servo),
        time_step=number("time step", values["time_step"]),
        sample=number("sample", values["sample"]),
        support=one_of("support", values["support"], SUPPORTS),
        letting_go=number("letting go", values["letting_go"]),
    )


@contextlib.contextmanager
def handed_over(task: Task, settings: TrialSettings, jobs: int) -> Iterator[Case]:
    """A task with its settings as :func:`run_trial` takes them; for several processes, as a temporary file.

    Meshes are large: with a file, each process reads them only once.
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
def _read(path: str) -> tuple[Task, TrialSettings]:
    case: tuple[Task, TrialSettings] = pickle.loads(Path(path).read_bytes())
    return case


def run_trial(case: Case, disturbance: Disturbance, mu_factor: float = 1.0) -> Outcome:
    """Simulate a task; ``mu_factor`` scales the friction of every contact, unless the disturbance sets mu."""
    task, settings = _read(case) if isinstance(case, str) else case
    if mu_factor != 1.0:
        task = replace(task, mu=mu_factor * task.mu)
    try:
        verdict = simulate(task, disturbance=disturbance, **settings).verdict
    except SimulationDiverged as error:
        return Outcome(held=False, reason=str(error), drift=None)
    return Outcome(held=verdict.held, reason="; ".join((verdict.reason, *verdict.causes[:1])), drift=verdict.drift)
