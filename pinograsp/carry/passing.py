"""How paths are passed: the fastest timing, a given one, and moving averages."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.constraints import PathConstraints
from pinograsp.carry.passage import Passage
from pinograsp.carry.program import CarrySolution
from pinograsp.carry.refusals import refuse_path
from pinograsp.carry.solving import solve_carry
from pinograsp.carry.task import CarryTask
from pinograsp.carry.timing import Timing
from pinograsp.spatial import Array

_ACCURACY = 1e-7  # relative, of the duration
_ALONE = 1e-6  # of how fast each interval may be passed by itself
_SLOWER, _SLOWER_ALONE = 1e-6, 2e-5  # squared speeds less than the fastest: there is room for a choice of forces
_WINDOWS = 1.5 ** np.arange(12)  # times the ramp, or the smallest, tried against a limit of the jerk
_SMALLEST = 0.02  # [s] of these, where no ramp is asked for
_MOST = 10.0  # times as fast as a known timing: what is beyond does not matter


def pass_fastest(task: CarryTask) -> Passage:
    """The fastest timing of the path from rest to rest, with its lower bound.

    Raises:
        CarryInfeasible, CarryUndecided: there is none, or none was found.
    """
    N = task.count
    s = np.linspace(0.0, 1.0, N + 1)
    middle = (s[:-1] + s[1:]) / 2.0
    places = task.constrain(middle, s)
    found = solve_carry(places.least_time, accuracy=_ACCURACY)
    if not found.is_solution:
        raise refuse_path(places, middle, found)
    y = found.y * (1.0 - _SLOWER)
    timing = Timing.of_squares(s, y)
    # Half the way of an interval, at its acceleration.
    b, a = (y[:-1] + y[1:]) / 2.0, np.diff(y) * N / 2.0
    return Passage(
        timing=timing,
        instants=timing.times[:-1] + (s[1] - s[0]) / (timing.speed[:-1] + np.sqrt(b)),
        knots=timing.times,
        places=places,
        constraints=places.follow(a, b, y, _MOST),
        level=1.0,
        headroom=np.ones(N),
        solution=found,
        fastest=True,
    )


def pass_timed(task: CarryTask, timing: Timing) -> Passage:
    """A known timing, and how many times as fast each interval of it may be passed.

    Raises:
        CarryInfeasible, CarryUndecided: there are no forces even at rest, or none were found.
    """
    knots = np.linspace(0.0, timing.duration, task.count + 1)
    instants = (knots[:-1] + knots[1:]) / 2.0
    moving, ends = timing.at(instants), timing.at(knots)
    places = task.constrain(moving.s, ends.s)
    constraints = places.follow(moving.acceleration, moving.speed**2, ends.speed**2, _MOST)
    found, headroom = find_fastest_anywhere(constraints)
    if not found.is_solution:
        raise refuse_path(constraints, moving.s, found)
    return Passage(
        timing=timing,
        instants=instants,
        knots=knots,
        places=places,
        constraints=constraints,
        level=1.0,
        headroom=headroom,
        solution=found,
    )


def pass_smoothly(task: CarryTask, timing: Timing, ramp: float, jerk: Array | None) -> Passage:
    """The fastest of some moving averages of a timing, over ``ramp`` [s] at least, that keeps to the limits.

    ``jerk``: largest of the robot's joints (n,) [rad/s^3 or m/s^3]; None: no limit.
    """
    best: Passage | None = None
    for window in [ramp] if jerk is None else (ramp or _SMALLEST) * _WINDOWS:
        passage = pass_timed(task, timing.smooth(float(window)))
        factor = min(passage.factor, 1.0)
        if jerk is not None:
            share = (1.0 - task.settings.reserve) * jerk / _measure_jerk(task, passage.timing)
            factor = min(factor, float(share.min()) ** (1 / 3))
        passage = passage.speed_up(factor)
        if best is not None and passage.timing.duration >= best.timing.duration:
            break
        best = passage
    assert best is not None
    return best


def find_fastest_anywhere(constraints: PathConstraints) -> tuple[CarrySolution, Array]:
    """How fast each interval may be passed by itself (N,)."""
    found = solve_carry(constraints.fastest_anywhere, accuracy=_ALONE)
    return found, np.asarray(np.sqrt((1.0 - _SLOWER_ALONE) * found.y.reshape(-1, 2).mean(axis=1)))


def _measure_jerk(task: CarryTask, timing: Timing) -> Array:
    """Largest |jerk| of each joint (n,) [rad/s^3 or m/s^3]."""
    moving = timing.at(np.linspace(0.0, timing.duration, 4 * task.count + 1))
    _, slope, bend, twist = task.path.at(moving.s)
    v, a, j = (part[:, None] for part in moving[1:])
    jerk = np.abs(slope * j + 3.0 * bend * v * a + twist * v**3).max(axis=0)
    found = np.full(task.robot.n, 1e-12)
    found[task.loaded[0].find_joints(task.path)] = np.maximum(jerk, 1e-12)
    return found
