"""Ways of an arm around obstacles, by OMPL."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from pinograsp.errors import ExtraMissing
from pinograsp.pick.arm import Arm
from pinograsp.spatial import Array

_LOOKS = 20_000  # at postures, in each search, after which it gives up: a second or two
_STEP = 0.02  # [rad or m] between postures of a way that are looked at
_SHORTCUTS = 30  # that are tried in each round
_TRIES, _SHORTENINGS = 3, 3  # ways that are looked for, of which the shortest is taken; rounds of shortcuts in each
_LOCK = threading.Lock()  # OMPL's random numbers are those of the whole process


def find_way(arm: Arm, start: Array, goal: Array, *, seed: int) -> Array | None:
    """Postures (w, a) from ``start`` to ``goal`` (a,), straight from one to the next, free as far as a quick look sees
    (:meth:`Arm.seems_free`); None: none was found.

    The shortest of several of RRT-Connect (Kuffner and LaValle 2000) in the arm's joints, each shortened.

    Args:
        arm: with what it holds and what stands around.
        start, goal: free postures.
        seed: of the random numbers.

    Raises:
        ExtraMissing: OMPL is not installed.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise ExtraMissing("ways around obstacles are found by OMPL: pip install 'pinograsp[arm]'") from error
    a = len(start)
    with _LOCK:
        util.setLogLevel(util.LOG_NONE)
        util.RNG.setSeed(seed + 1)  # 0 is none
        space, bounds = base.RealVectorStateSpace(a), base.RealVectorBounds(a)
        # A start on its limit, or beyond by rounding, is inside.
        low, high = np.minimum(arm.lower, np.minimum(start, goal)), np.maximum(arm.upper, np.maximum(start, goal))
        for i in range(a):
            bounds.setLow(i, float(low[i]))
            bounds.setHigh(i, float(high[i]))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        looks = 0

        def is_valid(state: Any) -> bool:
            nonlocal looks
            looks += 1
            return arm.seems_free(np.array([state[i] for i in range(a)]))

        information.setStateValidityChecker(is_valid)
        information.setStateValidityCheckingResolution(_STEP / space.getMaximumExtent())
        information.setup()
        found = list[Array]()
        for _ in range(_TRIES):
            most = looks + _LOOKS
            problem = base.ProblemDefinition(information)
            problem.setStartAndGoalStates(_state(information, start), _state(information, goal))
            planner = geometric.RRTConnect(information)
            planner.setProblemDefinition(problem)
            planner.setup()
            # By looks, not by time: the same seed is the same way on any machine.
            planner.solve(base.PlannerTerminationCondition(lambda most=most: looks > most))
            if not problem.hasExactSolution():
                continue
            path = problem.getSolutionPath()
            simplifier = geometric.PathSimplifier(information)
            for _ in range(_SHORTENINGS):
                simplifier.reduceVertices(path)
                simplifier.partialShortcutPath(path, _SHORTCUTS, _SHORTCUTS)
            simplifier.collapseCloseVertices(path)
            found.append(np.array([[path.getState(k)[i] for i in range(a)] for k in range(path.getStateCount())]))
    return min(found, key=measure_way, default=None)


def measure_way(way: Array) -> float:
    """Length of a way (w, a) in joint space [rad or m]."""
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def is_straight(arm: Arm, start: Array, goal: Array) -> bool:
    """Whether nothing is in the way from one posture straight to the other."""
    count = max(2, int(np.ceil(np.abs(goal - start).max() / _STEP)) + 1)
    return all(arm.is_free(x) for x in start + np.linspace(0.0, 1.0, count)[:, None] * (goal - start))


def _state(information: Any, x: Array) -> Any:
    state = information.allocState()
    for i, value in enumerate(x.tolist()):
        state[i] = value
    return state
