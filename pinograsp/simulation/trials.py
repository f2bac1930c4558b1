"""Single trials of a study: their common settings, the plan for other processes, and their outcomes."""

from __future__ import annotations

import contextlib
import functools
import pickle
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from pinograsp.checks import one_of
from pinograsp.errors import InvalidInput, SimulationDiverged
from pinograsp.plan import PlanRecord
from pinograsp.simulation.options import SimulationOptions, StudySettings
from pinograsp.simulation.schedule import choose_servo, choose_support
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.simulate import simulate_task
from pinograsp.simulation.task import Task
from pinograsp.writing import write_errors

# Set by the studies themselves; an object that is never let go would always be held.
_NOT_ACCEPTED = ("plan", "release", "disturbance")


# A task with the options of its trials, or the path of a file that holds both.
Case: TypeAlias = tuple[Task, SimulationOptions] | str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOutcome:
    """TrialOutcome of one simulation.

    Attributes:
        held: whether the object stayed in the hand.
        reason: why, in words; of a lost object with the first cause.
        drift: of the object [m]; None: the simulation diverged.
    """

    held: bool
    reason: str
    drift: float | None


def prepare_trials(plan: PlanRecord | Task | str | Path, settings: StudySettings) -> tuple[Task, SimulationOptions]:
    """The task of a plan, and the options of its trials, the servo included.

    Raises:
        InvalidInput: a plan that cannot be simulated, or a setting that does not exist here.
    """
    given: dict[str, Any] = dict(settings)
    task = Task.of(plan, given.pop("body", None))
    for name in given:
        if name in _NOT_ACCEPTED:
            raise InvalidInput(f"setting '{name}': not accepted here, the study sets it for every trial")
        one_of("setting", name, StudySettings.__annotations__)
    options = choose_support(task, SimulationOptions(**given))
    return task, replace(options, servo=choose_servo(task)) if options.servo is None else options


@contextlib.contextmanager
def share_case(task: Task, options: SimulationOptions, jobs: int) -> Iterator[Case]:
    """A task with its options as :func:`run_trial` takes them; for several processes, as a temporary file.

    Meshes are large: with a file, each process reads them only once.
    """
    import cloudpickle
    import joblib  # slow to import

    if joblib.effective_n_jobs(jobs) == 1:
        yield task, options
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.pickle"
        with write_errors(path):
            path.write_bytes(cloudpickle.dumps((task, options)))
        yield str(path)


@functools.lru_cache(maxsize=1)
def _read_case(path: str) -> tuple[Task, SimulationOptions]:
    case: tuple[Task, SimulationOptions] = pickle.loads(Path(path).read_bytes())
    return case


def run_trial(case: Case, disturbance: Disturbance, mu_factor: float = 1.0) -> TrialOutcome:
    """Simulate a task; ``mu_factor`` scales the friction of every contact, unless the disturbance sets mu."""
    task, options = _read_case(case) if isinstance(case, str) else case
    if mu_factor != 1.0:
        task = replace(task, mu=mu_factor * task.mu)
    try:
        verdict = simulate_task(task, replace(options, disturbance=disturbance)).verdict
    except SimulationDiverged as error:
        return TrialOutcome(held=False, reason=str(error), drift=None)
    return TrialOutcome(held=verdict.held, reason="; ".join((verdict.reason, *verdict.causes[:1])), drift=verdict.drift)
