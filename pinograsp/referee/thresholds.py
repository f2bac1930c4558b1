"""How little friction and how much load a plan stands, by trying."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import joblib
import numpy as np

from pinograsp.checks import instance_of, number, processes
from pinograsp.errors import InvalidInput
from pinograsp.referee.settings import Disturbance
from pinograsp.referee.trials import common_settings, handed_over, run_trial

_DOUBLINGS = 6  # how far beyond the plan a bracket is looked for
_NOTHING = 1e-6  # of the plan's value: a threshold below that is zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """Where holding ends.

    Attributes:
        lost: value that was lost; None: none was.
        held: value that held; None: none did.
        tried: the simulations in order, (value, held).
        planned: the planner's own threshold, where it was given.
    """

    lost: float | None
    held: float | None
    tried: tuple[tuple[float, bool], ...]
    planned: float | None = None
    _quantity: ClassVar[str] = "value"

    @property
    def value(self) -> float | None:
        """The threshold, on the side that held."""
        return self.held

    @property
    def simulations(self) -> int:
        """Their number."""
        return len(self.tried)

    @property
    def ratio(self) -> float | None:
        """Threshold over the planner's; None where either is missing."""
        return None if self.held is None or not self.planned else self.held / self.planned

    def summary(self) -> dict:
        """As plain JSON values."""
        return {
            "lost": self.lost,
            "held": self.held,
            "planned": self.planned,
            "ratio": self.ratio,
            "simulations": self.simulations,
            "tried": [list(one) for one in self.tried],
        }

    def describe(self) -> str:
        """As readable text."""
        if self.held is None:
            said = f"lost with every {self._quantity} that was tried, the last was {self.tried[-1][0]:.4g}"
        elif self.lost is None:
            said = f"held with every {self._quantity} that was tried, the last was {self.tried[-1][0]:.4g}"
        else:
            said = f"holds with {self._quantity} {self.held:.4g}, is lost with {self.lost:.4g}"
        if self.planned is not None:
            said += f"; planned {self.planned:.4g}" + ("" if self.ratio is None else f", ratio {self.ratio:.4f}")
        return f"{said} ({self.simulations} simulations)"


class SlipThreshold(Threshold):
    """Smallest friction coefficient of all contacts that holds, see :class:`Threshold` [-]."""

    __slots__ = ()
    _quantity = "mu"


class LoadThreshold(Threshold):
    """Largest mass that holds, as a multiple of the planned, see :class:`Threshold` [-]."""

    __slots__ = ()
    _quantity = "mass factor"


def slip_threshold(
    plan,
    *,
    tolerance: float = 0.01,
    planned: float | None = None,
    jobs: int = 1,
    disturbance: Disturbance | None = None,
    **settings,
) -> SlipThreshold:
    """The smallest friction coefficient, the same for all contacts, with which a plan still holds.

    Bisection between 0 and the plan's mu (the largest), or above it where that does not hold. Nothing says that a grasp
    holds with every larger mu: the bracket that was found is returned, not a proof. What slides too slowly for the
    verdict counts as held: short of friction by a share e the object sets off with e g, and 0.1 % shows after 0.6 s.

    Args:
        plan: as for :func:`~pinograsp.referee.simulate`.
        tolerance: (held - lost) / held at the end [-].
        planned: smallest mu by the planner's account, for comparison.
        jobs: processes; with more than one, values are tried in advance that may not be needed. The result is the same.
        disturbance: what else is not as planned.
        **settings: of :func:`~pinograsp.referee.simulate`.

    Raises:
        InvalidInput: unusable settings.
    """
    task, settings = common_settings(plan, settings)
    start = float(np.max(task.mu))
    if start <= 0:
        raise InvalidInput("slip_threshold: expected a plan with friction, its mu is 0")
    return _search(
        SlipThreshold,
        task,
        settings,
        tolerance,
        planned,
        jobs,
        disturbance,
        "mu",
        start,
        [0.0],
        [start * 2.0**i for i in range(1, _DOUBLINGS + 1)],
    )


def load_threshold(
    plan,
    *,
    tolerance: float = 0.01,
    planned: float | None = None,
    jobs: int = 1,
    disturbance: Disturbance | None = None,
    **settings,
) -> LoadThreshold:
    """The largest mass factor of the object with which a plan still holds; grip forces stay those of the plan.

    Bisection, after doublings of the planned mass until it is lost, or halvings until it holds. Nothing says that every
    lighter object is held: the bracket that was found is returned. Arguments and errors: :func:`slip_threshold`;
    ``tolerance`` is (lost - held) / lost.
    """
    task, settings = common_settings(plan, settings)
    halvings, doublings = ([2.0 ** (sign * i) for i in range(1, _DOUBLINGS + 1)] for sign in (-1, 1))
    return _search(
        LoadThreshold, task, settings, tolerance, planned, jobs, disturbance, "mass_factor", 1.0, doublings, halvings
    )


def _search(kind, task, settings, tolerance, planned, jobs, disturbance, name: str, start: float, harder, easier):
    tolerance = number("tolerance", tolerance, above=0)
    planned = None if planned is None else number("planned", planned, at_least=0)
    base = Disturbance() if disturbance is None else disturbance
    instance_of("disturbance", base, Disturbance)
    jobs = processes(jobs)
    with handed_over(task, settings, jobs) as case:
        run = joblib.Parallel(n_jobs=jobs)

        def hold(values: list[float]) -> list[bool]:
            outcomes = run(joblib.delayed(run_trial)(case, replace(base, **{name: value})) for value in values)
            return [one.held for one in outcomes]

        lost, held, tried = bracket(hold, start, harder, easier, tolerance, joblib.effective_n_jobs(jobs))
    return kind(lost=lost, held=held, tried=tuple(tried), planned=planned)


def bracket(hold: Callable, start: float, harder: list[float], easier: list[float], tolerance: float, ahead: int):
    """Bracket (lost, held), and values tried. ``hold``: of values, whether they hold; ``ahead``: how many at once."""
    known: dict[float, bool] = {}
    tried: list[tuple[float, bool]] = []

    def at(values: list[float]) -> bool:
        """Whether the first holds; the others may be asked for next."""
        if values[0] not in known:
            known.update(zip(values, hold(values)))
        tried.append((values[0], known[values[0]]))
        return tried[-1][1]

    lost = held = None
    if at([start, *harder[: ahead - 1]]):
        held, way = start, harder
    else:
        lost, way = start, easier
    for i, value in enumerate(way):
        holds = at([value, *(one for one in way[i + 1 : i + ahead] if one not in known)])
        lost, held = (lost, value) if holds else (value, held)
        if lost is not None and held is not None:
            break
    while None not in (lost, held) and abs(held - lost) > max(tolerance * max(held, lost), _NOTHING * start):
        if at(_next(lost, held, ahead, known)):
            held = tried[-1][0]
        else:
            lost = tried[-1][0]
    return lost, held, tried


def _next(lost: float, held: float, count: int, known) -> list[float]:
    """Middles of a bracket, of its halves, of their halves...: the values a bisection may ask for, soonest first."""
    brackets, values = [(lost, held)], []
    while len(values) < count:
        lost, held = brackets.pop(0)
        middle = 0.5 * (lost + held)
        brackets += [(lost, middle), (middle, held)]
        if not values or middle not in known:
            values.append(middle)
    return values
