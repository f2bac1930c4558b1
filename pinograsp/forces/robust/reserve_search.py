"""Squeezes that withstand a reserve: at one impact time, over all of them, and those that a hand can press to."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, instance_of
from pinograsp.contacts import Compliance
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.forces import RobustForces, SqueezeScenario
from pinograsp.forces.robust.optimum import Restrictions, optimize_robust, robust_at, robust_weights
from pinograsp.forces.robust.reserve import Reserve, held_body
from pinograsp.forces.solution import ConvexSolution
from pinograsp.forces.solve.program import Objective
from pinograsp.spatial import Array

# A search over t_I ends at that share of the range, or after so many programs of some 10 ms each.
_NARROW, _MOST_TRIED = 5e-3, 16
# Rounds of linearised depths, the share of the largest force at which they are linearised at least, and what is left.
_MADE_ROUNDS, _LITTLE, _MADE = 12, 1e-3, 1e-7
# Other impact times that are tried, and how much longer the squeeze takes with the first of them.
_OTHER_TIMES, _LITTLE_LONGER = 4, 1.05
# Share of the largest force by which forces may still change from one round to the next: what is linearised about them
# is off by the square of it.
_AGAIN = 1e-2
_GOLDEN = (3 - np.sqrt(5)) / 2


class _ReserveProgram:
    """The program of holding a problem's object with a reserve, at any impact time.

    Attributes:
        kept: the problem with what the reserve keeps back.
        loads: of the reserve.
    """

    def __init__(self, problem: ForceProblem, reserve: Reserve, objective: Objective | None):
        instance_of("problem", problem, ForceProblem)
        instance_of("reserve", reserve, Reserve)
        self.weights = robust_weights(objective, problem)
        self.loads, self.kept = reserve.load_set(held_body(problem), problem.gravity_o), reserve.problem(problem)

    def solve(
        self, impact_time: float, restrictions: Restrictions | None = None, *, proven: bool = False
    ) -> RobustForces:
        """As :func:`robust_at`, where the contacts react as springs."""
        return robust_at(
            self.kept,
            self.loads,
            impact_time,
            self.weights,
            reaction="elastic",
            restrictions=restrictions,
            proven=proven,
        )

    def times_near(self, squeeze: RobustForces) -> list[float]:
        """The impact time of a squeeze, then others up to the earliest [s]: the squeeze takes longer by a ratio each
        time, at first by little, so that the first that does leaves the object little time to drop.
        """
        end, own = self.kept.final_time, squeeze.impact_time
        longest = end - min(self.kept.impact_time_range[0], own)
        durations = np.geomspace(min(_LITTLE_LONGER * (end - own), longest), longest, _OTHER_TIMES)
        return [own, *(end - durations).tolist()]


def optimize_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    impact_time: float,
    *,
    objective: Objective | None = None,
) -> RobustForces:
    """Find the least-cost normal forces that hold a problem's object with a reserve, for an impact at one t_I.

    The loads are those of :meth:`Reserve.load_set`. The normal forces are those under the problem's own load, the
    weight; they change with a load as if the contacts were equal springs.

    Args:
        problem: of holding an object (``ForceProblem.holding``), without the reserve.
        reserve: what to withstand besides the weight.
        impact_time: t_I [s].
        objective: as for :func:`~pinograsp.forces.optimize_robust`.

    Raises:
        InvalidInput: a problem without an object, or another objective.
    """
    program = _ReserveProgram(problem, reserve, objective)
    return optimize_robust(program.kept, program.loads, impact_time, objective=objective, reaction="elastic")


def search_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    *,
    objective: Objective | None = None,
    start: float | None = None,
) -> RobustForces:
    """Search the impact times for the least-cost squeeze, with a certified program at each of them.

    Late impacts cost less but leave less time to press. If the latest impact costs no more than one just before it, it
    is taken; else the search narrows an interval around the best impact time so far. Its squeeze is the proven optimum
    at its own impact time; it is not proven that no other impact time is cheaper.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to withstand besides the weight.
        objective: as for :func:`~pinograsp.forces.optimize_robust`.
        start: impact time of an earlier squeeze [s]; if it holds and no torque limit is reached, the search is skipped.

    Returns:
        The squeeze; ``INFEASIBLE``: no impact time admits any (proven), ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, or another objective.
    """
    started, program = time.perf_counter(), _ReserveProgram(problem, reserve, objective)
    early, late = problem.impact_time_range
    tried: dict[float, RobustForces] = {}

    def cost(t: float) -> float:
        if t not in tried:
            tried[t] = program.solve(t)
        certificate = tried[t].certificate
        return np.inf if tried[t].status is not Status.OK or certificate is None else certificate.objective

    if start is not None and cost(start) < np.inf:
        found = tried[start]
        if found.certificate is not None and not found.certificate.at_torque:
            return found
    narrow = _NARROW * (late - early)
    if cost(late) < np.inf and cost(late) <= cost(late - 0.99 * narrow):
        return replace(tried[late], tried=len(tried), elapsed=time.perf_counter() - started)
    if cost(late) == np.inf:  # what all impact times allow together is asked first, which may save all others
        none = program.solve(early, Restrictions(bounds=widest_range(program.kept)), proven=True)
        if none.status is not Status.OK:
            return replace(none, tried=len(tried), elapsed=time.perf_counter() - started)
    first = np.linspace(early, late, 4).tolist() if late > early else [early]
    if min([cost(t) for t in first]) == np.inf:
        none = replace(tried[early], status=Status.INACCURATE)
        return replace(none, tried=len(tried), elapsed=time.perf_counter() - started)
    while len(tried) < _MOST_TRIED:
        times = sorted(tried)
        best = min(range(len(times)), key=lambda i: cost(times[i]))
        before, after = times[max(best - 1, 0)], times[min(best + 1, len(times) - 1)]
        if after - before <= narrow:
            break
        at = times[best]
        if best in (0, len(times) - 1):
            cost(at + 0.99 * narrow if best == 0 else at - 0.99 * narrow)
            continue
        # The larger of the two parts beside the best, at the golden section.
        cost(at + _GOLDEN * (after - at) if after - at > at - before else at - _GOLDEN * (at - before))
    best_time = min(tried, key=cost)
    return replace(tried[best_time], tried=len(tried), elapsed=time.perf_counter() - started)


def least_squeeze(problem: ForceProblem, reserve: Reserve, *, rows: ArrayLike | None = None) -> Array | None:
    """Find normal forces (k,) [N] of a squeeze that withstands the reserve, within the limits of any impact time.

    The largest force is as small as possible; None: there is no such squeeze. One program, for searches.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to withstand besides the weight.
        rows: combinations (p, k) of the depths that the hand cannot change [-], as for :func:`producible_reserve`, here
            linearised at even forces alone.
    """
    program = _ReserveProgram(problem, reserve, "peak")
    made = np.zeros((0, problem.k)) if rows is None else array_of("rows", rows, (None, problem.k))
    # About even forces F the depths are (1 + (f / F - 1) / rho) times the same: only the ratios of the forces count,
    # where rho, the law's own or that of its slope at the load's share of a contact, does not depend on the depth.
    share = _power_at(problem.compliance, problem.scaled_norm(problem.load) / problem.k)
    fixed = np.asarray(made @ (share * np.eye(problem.k) + (1.0 - share) / problem.k)), np.zeros(len(made))
    found = program.solve(problem.impact_time_range[0], Restrictions(bounds=widest_range(program.kept), fixed=fixed))
    return found.normal_forces if found.status is Status.OK else None


def producible_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    squeeze: RobustForces,
    rows: ArrayLike,
    *,
    objective: Objective | None = None,
    scenarios: Callable[[ConvexSolution], Sequence[SqueezeScenario]] | None = None,
) -> RobustForces:
    """Find the least-cost squeeze with depths that the hand can produce, at or near the impact time of ``squeeze``.

    ``rows`` times the depths are zero. Because F_n = K delta^rho is not linear, these equations are linearised, first
    at even forces and then at the forces found, until the forces satisfy them. The change of the squeeze in scenarios
    is linearised in the same way.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to withstand besides the weight.
        squeeze: from :func:`search_reserve`, with any depths.
        rows: combinations (p, k) of the depths that the hand cannot change [-].
        objective: as for :func:`~pinograsp.forces.optimize_robust`.
        scenarios: how the forces under the problem's load change with contacts of another stiffness, or with drives of
            other efforts, to first order; None: everything is as assumed.

    Returns:
        The squeeze; ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, a squeeze without forces, or another objective.
    """
    started, program = time.perf_counter(), _ReserveProgram(problem, reserve, objective)
    rows = array_of("rows", rows, (None, problem.k))
    if not len(squeeze.normal_forces):
        raise InvalidInput(f"squeeze: expected one with forces, got status '{squeeze.status}'")
    if not len(rows) and scenarios is None:
        return squeeze
    law, tried = problem.compliance, 0
    found = replace(squeeze, status=Status.INACCURATE)
    for t in program.times_near(squeeze):
        F = np.full(problem.k, squeeze.normal_forces.mean()) if len(rows) else squeeze.normal_forces
        last = squeeze
        for _ in range(_MADE_ROUNDS):
            least = np.maximum(F, _LITTLE * F.max())
            depths = law.depth(least)
            slopes = 1.0 / law.slope(depths)
            size = float(slopes.max())
            equations = rows * slopes / size, rows @ (slopes * F - depths) / size
            others = () if scenarios is None else scenarios(last.under(problem.load))
            found = program.solve(t, Restrictions(fixed=equations, scenarios=others))
            tried += 1
            if found.status is not Status.OK:
                break
            before, F = F, found.normal_forces
            depths = law.depth(F)
            made = np.abs(rows @ depths).max(initial=0.0) <= _MADE * depths.max()
            if made and (scenarios is None or np.abs(F - before).max() <= _AGAIN * F.max()):
                return replace(found, tried=tried, elapsed=time.perf_counter() - started)
            last = found
    return replace(found, status=Status.INACCURATE, tried=tried, elapsed=time.perf_counter() - started)


def reserve_along(
    problem: ForceProblem,
    reserve: Reserve,
    squeeze: RobustForces,
    start: ArrayLike,
    direction: ArrayLike,
    *,
    objective: Objective | None = None,
) -> RobustForces:
    """Find the least-cost squeeze among those whose normal forces are ``start`` plus a multiple of ``direction``.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to withstand besides the weight.
        squeeze: from :func:`search_reserve`; the new squeeze is at or near its impact time.
        start: normal forces (k,) [N].
        direction: of their change (k,), not all 0.
        objective: as for :func:`~pinograsp.forces.optimize_robust`.

    Returns:
        The squeeze; ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, forces that cannot be used, or another objective.
    """
    began, program = time.perf_counter(), _ReserveProgram(problem, reserve, objective)
    start, direction = array_of("start", start, (problem.k,)), array_of("direction", direction, (problem.k,))
    size = float(np.linalg.norm(direction))
    if not size > 0:
        raise InvalidInput("direction: expected one in which a normal force changes, got zeros")
    across = np.eye(problem.k) - np.outer(direction, direction) / size**2
    found, tried = replace(squeeze, status=Status.INACCURATE), 0
    for t in program.times_near(squeeze):
        found = program.solve(t, Restrictions(fixed=(across, across @ start)))
        tried += 1
        if found.status is Status.OK:
            break
    return replace(found, tried=tried, elapsed=time.perf_counter() - began)


def _power_at(law: Compliance, force: float) -> float:
    """1 / rho [-] of the power law that touches a law at a normal force [N]."""
    depth = law.depth(force or 1.0)
    return float((force or 1.0) / (depth * law.slope(depth)))


def widest_range(kept: ForceProblem) -> tuple[Array, Array]:
    """All that any impact time allows of F_n: the least lower bound, of the latest one, to the largest upper bound."""
    early, late = kept.impact_time_range
    return kept.normal_force_range(late)[0], kept.normal_force_range(early)[1]
