"""The grasp that nobody optimised: every joint goes on closing as before, in proportion, until the object is held.

The paper compares its grasp with joint trajectories played in MSC.Adams as they are (Table IV). Here they run straight
from the plan's first posture to the one at impact, all joints in the same share of the way, and on past it; the joints
are moved as commanded, the object is fixed until the end and then let go. How far on is the least that holds the same
object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import array_of, brief, number
from pinograsp.errors import InvalidInput
from pinograsp.plan import Simulation
from pinograsp.referee.simulate import simulate
from pinograsp.referee.task import Task

_FIRST, _STEP, _MOST = 0.005, 1.25, 0.3  # of the way: overclosings that are tried; too much throws the object out again
_SAMPLES = 200  # of the trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NaiveGrasp:
    """The least overclosing that holds.

    Attributes:
        overclosing: share of the way beyond the touch; None where none up to 0.3 of the way holds.
        simulation: of that, or of the last one tried.
        lost: largest share that did not hold below it.
        simulations: how many were run.
    """

    overclosing: float | None
    simulation: Simulation
    lost: float
    simulations: int

    __repr__ = brief()

    @property
    def grasp_energy(self) -> float | None:
        """By Eq. (9) [J]; None where nothing holds."""
        return None if self.overclosing is None else self.simulation.grasp_energy


def naive_task(task: Task, overclosing: float, *, start=None, target=None) -> Task:
    """The plan's task with straight joint trajectories that close on beyond the touch.

    Args:
        overclosing: share of the way from start to target that is gone beyond it.
        start, target: postures (n,) [rad or m]; default: the plan's at t = 0 and at impact.
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
    plan, *, start=None, target=None, drift: float = 5e-3, tolerance: float = 0.02, **settings
) -> NaiveGrasp:
    """The least that a hand must go on closing to hold the plan's object, optimising nothing.

    Args:
        plan: as for :func:`simulate`.
        start, target: see :func:`naive_task`.
        drift: what the object may move after it was let go [m].
        tolerance: of the overclosing, relative.
        settings: of :func:`simulate`.

    Raises:
        InvalidInput: a start and a target that do not differ.
    """
    task = plan if isinstance(plan, Task) else Task.of(plan)
    for name in {"mode", "release", "body"} & settings.keys():
        raise InvalidInput(
            f"setting '{name}': not accepted here, the joints are moved as commanded and the object is let go"
        )
    tried = 0

    def attempt(overclosing: float) -> Simulation:
        nonlocal tried
        tried += 1
        return simulate(
            naive_task(task, overclosing, start=start, target=target),
            mode="prescribed",
            **{"time_step": 5e-4, **settings},
        )

    def holds(one: Simulation) -> bool:
        return one.verdict.held and one.verdict.drift <= drift

    if not np.any(naive_task(task, 0.0, start=start, target=target).dq):
        raise InvalidInput("naive grasp: expected a start and a target that differ")
    found = attempt(0.0)
    if holds(found):  # caught without pressing
        return NaiveGrasp(overclosing=0.0, simulation=found, lost=0.0, simulations=tried)
    low, high = 0.0, _FIRST
    found = attempt(high)
    while not holds(found) and high < _MOST:
        low, high = high, min(_STEP * high, _MOST)
        found = attempt(high)
    if not holds(found):
        return NaiveGrasp(overclosing=None, simulation=found, lost=high, simulations=tried)
    while high - low > tolerance * high:
        middle = 0.5 * (low + high)
        other = attempt(middle)
        if holds(other):
            high, found = middle, other
        else:
            low = middle
    return NaiveGrasp(overclosing=high, simulation=found, lost=low, simulations=tried)
