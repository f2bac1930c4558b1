"""A grasp without optimised forces: the joints close on beyond the first contact until the object is held.

The paper compares its grasp with joint trajectories simulated in MSC.Adams (Table IV). Here the trajectories are
straight lines in joint space: from the plan's first posture to the one at impact, and beyond it by a share of that way,
the overclosing. The joints follow them exactly; the object is fixed until the end and then let go. The result is the
least overclosing that holds the object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, number, one_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.simulation.options import SimulationSettings
from pinograsp.simulation.settings import Disturbance
from pinograsp.simulation.simulate import simulate
from pinograsp.simulation.task import Task
from pinograsp.simulation.thresholds import bracket

if TYPE_CHECKING:
    from typing_extensions import Unpack

# Overclosings that are tried: the first, the factor from one to the next, and the largest; more ejects the object.
_FIRST, _STEP, _MOST = 0.005, 1.25, 0.3
_SAMPLES = 200  # of the trajectory


class NaiveSettings(SimulationSettings, total=False):
    """Settings of :func:`naive_grasp`: keyword arguments of :func:`~pinograsp.simulation.simulate`."""

    disturbance: Disturbance | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NaiveGrasp:
    """The least overclosing that holds.

    Attributes:
        overclosing: share of the way that is added beyond the contact; None: none up to 0.3 holds.
        simulation: with that overclosing, or with the last one tried.
        lost: largest overclosing tried below it that did not hold.
        simulations: number of simulations that were run.
    """

    overclosing: float | None
    simulation: Simulation
    lost: float
    simulations: int

    __repr__ = brief()

    @property
    def grasp_energy(self) -> float | None:
        """By Eq. (9) [J]; None: no overclosing holds."""
        return None if self.overclosing is None else self.simulation.grasp_energy


def naive_task(
    task: Task, overclosing: float, *, start: ArrayLike | None = None, target: ArrayLike | None = None
) -> Task:
    """The task with straight joint trajectories that close beyond the target.

    Args:
        task: of the plan.
        overclosing: share of the way from start to target that is added beyond the target.
        start: posture (n,) [rad or m]; default: the plan's at t = 0.
        target: posture (n,) [rad or m]; default: the plan's at impact.
    """
    n = task.hand.n
    at_impact = task.q[int(np.searchsorted(task.times, task.impact_time - 1e-12))]
    begin = task.q[0] if start is None else array_of("start", start, (n,))
    end = at_impact if target is None else array_of("target", target, (n,))
    share = np.linspace(0.0, 1.0, _SAMPLES)
    # From rest to rest: the smoothest polynomial of the fifth order.
    way = (1 + number("overclosing", overclosing, at_least=0)) * share**3 * (10 - 15 * share + 6 * share**2)
    rate = (1 + overclosing) * 30 * share**2 * (1 - share) ** 2 / task.final_time
    moved = end - begin
    zero = np.zeros((_SAMPLES, n))
    return replace(
        task,
        times=share * task.final_time,
        q=begin + way[:, None] * moved,
        dq=rate[:, None] * moved,
        torques=zero,
        holding_torques=np.zeros(n),
    )


def naive_grasp(
    plan: PlanRecord | Task | str | Path,
    *,
    start: ArrayLike | None = None,
    target: ArrayLike | None = None,
    drift: float = 5e-3,
    tolerance: float = 0.02,
    **settings: Unpack[NaiveSettings],
) -> NaiveGrasp:
    """The least overclosing with which a hand holds the plan's object, without any optimisation.

    Args:
        plan: as for :func:`~pinograsp.simulation.simulate`.
        start: see :func:`naive_task`.
        target: see :func:`naive_task`.
        drift: largest motion of the object after it was let go [m].
        tolerance: of the overclosing, relative.
        **settings: of :func:`~pinograsp.simulation.simulate`; its time step is 0.5 ms by default.

    Raises:
        InvalidInput: a start and a target that do not differ, or unusable settings.
    """
    task = Task.of(plan)
    for name in settings:
        if name in ("mode", "release", "body"):
            raise InvalidInput(
                f"setting '{name}': not accepted here, the joints follow the commands and the object is let go"
            )
        one_of("setting", name, NaiveSettings.__annotations__)
    chosen: NaiveSettings = {"time_step": 5e-4, **settings}
    simulations: dict[float, Simulation] = {}

    def hold(overclosings: list[float]) -> list[bool]:
        (one,) = overclosings
        tried = simulate(naive_task(task, one, start=start, target=target), mode="prescribed", **chosen)
        simulations[one] = tried
        return [tried.verdict.held and tried.verdict.drift <= drift]

    if not np.any(naive_task(task, 0.0, start=start, target=target).dq):
        raise InvalidInput("naive grasp: expected a start and a target that differ")
    further = np.minimum(_FIRST * _STEP ** np.arange(np.ceil(np.log(_MOST / _FIRST) / np.log(_STEP)) + 1), _MOST)
    found = bracket(hold, 0.0, [], further.tolist(), tolerance, 1)
    best = found.lost if found.held is None else found.held
    assert best is not None
    return NaiveGrasp(
        overclosing=found.held,
        simulation=simulations[best],
        lost=found.lost or 0.0,
        simulations=len(simulations),
    )
