"""The least friction and the largest load with which a plan holds, found by simulations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import joblib
import numpy as np

from pinograsp.checks import brief, instance_of, number, processes
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord
from pinograsp.simulation.options import SimulationOptions, StudySettings
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.task import Task
from pinograsp.simulation.trials import prepare_trials, run_trial, share_case

if TYPE_CHECKING:
    from typing_extensions import Unpack

_DOUBLINGS = 6  # of the plan's value, at most, in the search for a bracket
_NOTHING = 1e-6  # share of the plan's value below which a threshold counts as zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """The limit up to which a plan holds.

    Attributes:
        lost: nearest value with which the object was lost; None: it was held with all.
        held: nearest value with which the object was held; None: it was lost with all.
        tried: the simulations in order, as (value, held).
        planned: the planner's own threshold, where it was given.
    """

    lost: float | None
    held: float | None
    tried: tuple[tuple[float, bool], ...]
    planned: float | None = None
    _quantity: ClassVar[str] = "value"

    __repr__ = brief()

    @property
    def value(self) -> float | None:
        """The threshold, on the side that held."""
        return self.held

    @property
    def simulations(self) -> int:
        """Number of simulations."""
        return len(self.tried)

    @property
    def ratio(self) -> float | None:
        """Threshold divided by the planner's; None where either is missing."""
        return None if self.held is None or not self.planned else self.held / self.planned

    def summary(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "lost": self.lost,
            "held": self.held,
            "planned": self.planned,
            "ratio": self.ratio,
            "simulations": self.simulations,
            "tried": [list(one) for one in self.tried],
        }

    def __str__(self) -> str:
        return self.describe()

    def describe(self) -> str:
        """As readable text."""
        if self.held is None:
            text = f"lost with every {self._quantity} tried, the last was {self.tried[-1][0]:.4g}"
        elif self.lost is None:
            text = f"held with every {self._quantity} tried, the last was {self.tried[-1][0]:.4g}"
        else:
            text = f"holds with {self._quantity} {self.held:.4g}, is lost with {self.lost:.4g}"
        if self.planned is not None:
            text += f"; planned {self.planned:.4g}" + ("" if self.ratio is None else f", ratio {self.ratio:.4f}")
        return f"{text} ({self.simulations} simulations)"


class SlipThreshold(Threshold):
    """Smallest friction coefficient of all contacts that holds, see :class:`Threshold` [-]."""

    __slots__ = ()
    _quantity = "mu"


class LoadThreshold(Threshold):
    """Largest mass that holds, as a multiple of the planned, see :class:`Threshold` [-]."""

    __slots__ = ()
    _quantity = "mass factor"


def slip_threshold(
    plan: PlanRecord | Task | str | Path,
    *,
    tolerance: float = 0.01,
    planned: float | None = None,
    jobs: int = 1,
    disturbance: Disturbance | None = None,
    **settings: Unpack[StudySettings],
) -> SlipThreshold:
    """Find the smallest friction coefficient, the same for all contacts, with which a plan still holds.

    The method is bisection between 0 and the plan's largest mu, or above it if that does not hold. A grasp need not
    hold with every larger mu: the result is the bracket that was found, not a proof. Slip that is too slow for the
    verdict counts as held: if a share e of the friction is missing, the object accelerates with e g; e = 0.1 % shows
    after 0.6 s.

    Args:
        plan: as for :func:`~pinograsp.simulation.simulate`.
        tolerance: (held - lost) / held at the end [-].
        planned: smallest mu according to the planner, for comparison.
        jobs: processes; with more than one, further values are tried in advance. The result is the same.
        disturbance: other differences from the plan.
        **settings: of :func:`~pinograsp.simulation.simulate`.

    Raises:
        InvalidInput: unusable settings.
    """
    task, options = prepare_trials(plan, settings)
    start = float(np.max(task.mu))
    if start <= 0:
        raise InvalidInput("slip_threshold: expected a plan with friction, its mu is 0")
    search = _ThresholdSearch(tolerance=tolerance, planned=planned, jobs=jobs, disturbance=disturbance)
    doublings = [start * 2.0**i for i in range(1, _DOUBLINGS + 1)]
    return SlipThreshold(**search.run(task, options, start, [0.0], doublings, "mu"))


def load_threshold(
    plan: PlanRecord | Task | str | Path,
    *,
    tolerance: float = 0.01,
    planned: float | None = None,
    jobs: int = 1,
    disturbance: Disturbance | None = None,
    **settings: Unpack[StudySettings],
) -> LoadThreshold:
    """Find the largest mass factor of the object with which a plan still holds, with the plan's grip forces.

    The planned mass is doubled until the object is lost, or halved until it is held; then bisection. A lighter object
    need not be held: the result is the bracket that was found. Arguments and errors: as for :func:`slip_threshold`;
    ``tolerance`` is (lost - held) / lost.
    """
    task, options = prepare_trials(plan, settings)
    halvings, doublings = ([2.0 ** (sign * i) for i in range(1, _DOUBLINGS + 1)] for sign in (-1, 1))
    search = _ThresholdSearch(tolerance=tolerance, planned=planned, jobs=jobs, disturbance=disturbance)
    return LoadThreshold(**search.run(task, options, 1.0, doublings, halvings, "mass_factor"))


class _ThresholdSearch:
    """The arguments that both searches share, checked."""

    def __init__(self, *, tolerance: float, planned: float | None, jobs: int, disturbance: Disturbance | None):
        self.tolerance, self.jobs = number("tolerance", tolerance, above=0), processes(jobs)
        self.planned = None if planned is None else number("planned", planned, at_least=0)
        self.disturbance = Disturbance() if disturbance is None else disturbance
        instance_of("disturbance", self.disturbance, Disturbance)

    def run(
        self, task: Task, options: SimulationOptions, start: float, harder: list[float], easier: list[float], name: str
    ) -> dict[str, Any]:
        """The threshold of the value of a disturbance's field ``name``, see :func:`bracket`."""
        with share_case(task, options, self.jobs) as case:
            parallel = joblib.Parallel(n_jobs=self.jobs)

            def hold(values: list[float]) -> list[bool]:
                changes: list[dict[str, Any]] = [{name: value} for value in values]
                disturbances = (replace(self.disturbance, **change) for change in changes)
                return [one.held for one in parallel(joblib.delayed(run_trial)(case, one) for one in disturbances)]

            found = bracket(hold, start, harder, easier, self.tolerance, joblib.effective_n_jobs(self.jobs))
        return {"lost": found.lost, "held": found.held, "tried": tuple(found.tried), "planned": self.planned}


class Bracket(NamedTuple):
    """The nearest values with which the object was lost and held (None: there is none), and all that were tried."""

    lost: float | None
    held: float | None
    tried: list[tuple[float, bool]]


def bracket(
    hold: Callable[[list[float]], list[bool]],
    start: float,
    harder: list[float],
    easier: list[float],
    tolerance: float,
    ahead: int,
) -> Bracket:
    """Bracket of the value at which holding ends.

    Args:
        hold: of a list of values, whether the object is held with each.
        start: value to begin with.
        harder: values to try in order where the start holds.
        easier: values to try in order where it does not.
        tolerance: relative width of the bracket.
        ahead: number of values to try at once.
    """
    known: dict[float, bool] = {}
    tried: list[tuple[float, bool]] = []

    def try_first(values: list[float]) -> bool:
        """Whether the first value holds; the others may be needed next."""
        if values[0] not in known:
            known.update(zip(values, hold(values)))
        tried.append((values[0], known[values[0]]))
        return tried[-1][1]

    lost: float | None = None
    held: float | None = None
    if try_first([start, *harder[: ahead - 1]]):
        held, way = start, harder
    else:
        lost, way = start, easier
    for i, value in enumerate(way):
        holds = try_first([value, *(one for one in way[i + 1 : i + ahead] if one not in known)])
        lost, held = (lost, value) if holds else (value, held)
        if lost is not None and held is not None:
            break
    while (
        lost is not None and held is not None and abs(held - lost) > max(tolerance * max(held, lost), _NOTHING * start)
    ):
        if try_first(_find_next(lost, held, ahead, known)):
            held = tried[-1][0]
        else:
            lost = tried[-1][0]
    return Bracket(lost, held, tried)


def _find_next(lost: float, held: float, count: int, known: Mapping[float, bool]) -> list[float]:
    """Values that a bisection may need next, in order: the middle of the bracket, those of its halves, and so on."""
    brackets: list[tuple[float, float]] = [(lost, held)]
    values: list[float] = []
    while len(values) < count:
        lost, held = brackets.pop(0)
        middle = 0.5 * (lost + held)
        brackets += [(lost, middle), (middle, held)]
        if not values or middle not in known:
            values.append(middle)
    return values
