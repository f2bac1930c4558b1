"""Ways of an arm around obstacles, by OMPL."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from pinograsp.errors import ExtraMissing
from pinograsp.pick.arm import Arm
from pinograsp.pick.upright import Upright
from pinograsp.spatial import Array

_LOOKS, _FEWEST = 20_000, 5_000  # at postures, in each search, after which it gives up: a second, or a third of one
_LEAN = 0.3  # of a look: what it takes to bring an object upright
_STEP = 0.02  # [rad or m] between postures of a way that are looked at
_SHORTCUTS = 30  # that are tried in each round
_TILTED = 0.6  # of the largest tilt: what ways are looked for with
_ROUNDING = 1e-3  # [-] of a sine
_SAME = 1e-6  # [rad or m] postures this close are one
_TRIES, _SHORTENINGS = 3, 3  # ways that are looked for, of which the shortest is taken; rounds of shortcuts in each
_LOCK = threading.Lock()  # OMPL's random numbers are those of the whole process


class Patience:
    """How many postures a search of a way looks at: half as many each time that one was in vain."""

    def __init__(self) -> None:
        self.looks = _LOOKS

    def lose(self) -> None:
        """A search was in vain."""
        self.looks = max(_FEWEST, self.looks // 2)


def find_way(
    arm: Arm, start: Array, goal: Array, *, seed: int, patience: Patience, upright: Upright | None = None
) -> Array | None:
    """Postures (w, a) from ``start`` to ``goal`` (a,), straight from one to the next, free as far as a quick look sees
    (:meth:`Arm.seems_free`); None: none was found.

    The shortest of several of RRT-Connect (Kuffner and LaValle 2000) in the arm's joints, each shortened; by projection
    on postures that keep an object upright (Kingston, Moll and Kavraki 2019).

    Args:
        arm: with what it holds and what stands around.
        start, goal: free postures.
        seed: of the random numbers.
        patience: of all searches of one pick.
        upright: how far what is held may tilt; None: anyhow.

    Raises:
        ExtraMissing: OMPL is not installed.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise ExtraMissing("OMPL finds the paths around obstacles: pip install 'pinograsp[arm]'") from error
    a, spent = len(start), 0.0

    def count_lean() -> None:
        nonlocal spent
        spent += _LEAN

    with _LOCK:
        util.setLogLevel(util.LOG_NONE)
        util.RNG.setSeed(seed + 1)  # 0 is none
        joints, bounds = base.RealVectorStateSpace(a), base.RealVectorBounds(a)
        # A start on its limit, or beyond by rounding, is inside.
        low, high = np.minimum(arm.lower, np.minimum(start, goal)), np.maximum(arm.upper, np.maximum(start, goal))
        for i in range(a):
            bounds.setLow(i, float(low[i]))
            bounds.setHigh(i, float(high[i]))
        joints.setBounds(bounds)
        if upright is None:
            space, information = joints, base.SpaceInformation(joints)
        else:
            least = max(float(np.linalg.norm(upright.lean(x))) for x in (start, goal)) + _ROUNDING
            tolerance = max(least, np.sin(_TILTED * min(upright.most, np.pi / 2.0)))
            constraint = _make_constraint(base, upright, a, float(tolerance), count_lean)
            space = base.ProjectedStateSpace(joints, constraint)
            information = base.ConstrainedSpaceInformation(space)

        def is_valid(state: Any) -> bool:
            nonlocal spent
            spent += 1.0
            x = np.array([state[i] for i in range(a)])
            return arm.seems_free(x) and (upright is None or bool(upright.measure(x) <= upright.most))

        information.setStateValidityChecker(is_valid)
        information.setStateValidityCheckingResolution(_STEP / space.getMaximumExtent())
        information.setup()
        found = list[Array]()
        for _ in range(_TRIES):
            most = spent + patience.looks
            problem = base.ProblemDefinition(information)
            problem.setStartAndGoalStates(_state(information, start), _state(information, goal))
            planner = geometric.RRTConnect(information)
            planner.setProblemDefinition(problem)
            planner.setup()
            # By looks, not by time: the same seed is the same way on any machine.
            planner.solve(base.PlannerTerminationCondition(lambda most=most: spent > most))
            if not problem.hasExactSolution():
                break
            path = problem.getSolutionPath()
            simplifier = geometric.PathSimplifier(information)
            for _ in range(_SHORTENINGS):
                simplifier.reduceVertices(path)
                simplifier.partialShortcutPath(path, _SHORTCUTS, _SHORTCUTS)
            simplifier.collapseCloseVertices(path)
            if upright is not None:
                path.interpolate()
            way = np.array([[path.getState(k)[i] for i in range(a)] for k in range(path.getStateCount())])
            apart = np.abs(np.diff(way, axis=0)).max(axis=1) > _SAME
            found.append(way[np.concatenate([[True], apart])])
    if not found:
        patience.lose()
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
    if hasattr(state, "copy"):  # of spaces with constraints
        state.copy(x)
        return state
    for i, value in enumerate(x.tolist()):
        state[i] = value
    return state


def _make_constraint(base: Any, upright: Upright, a: int, tolerance: float, count: Callable[[], None]) -> Any:
    """OMPL's, of postures that tilt an object by less than that [-, a sine]; ``count`` is called at each projection."""

    class Level(base.Constraint):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(a, 2, tolerance)

        def function(self, x: Array, out: Array) -> None:
            out[:] = upright.lean(x)

        def project(self, x: Array) -> bool:
            count()
            return upright.project(x, tolerance)

    return Level()
