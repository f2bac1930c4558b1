"""The plan of a search: of the best grasp whose motion can be carried out."""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Generator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pinograsp.checks import flag, instance_of, processes
from pinograsp.contacts import Closure
from pinograsp.contacts.doubt import doubtful_share
from pinograsp.contacts.edges import past_edges
from pinograsp.errors import (
    GraspInfeasible,
    GraspUndecided,
    NoGrasp,
    SearchFailed,
    SimulationDiverged,
    Status,
)
from pinograsp.forces import GraspConditions
from pinograsp.hands import servo_gains
from pinograsp.motion.holding import TILTED, find_tilt
from pinograsp.plan.answer import SIMULATED
from pinograsp.plan.simulation import MOVED
from pinograsp.plan.tolerance import PoseTolerance
from pinograsp.planner.as_commanded import measure_turn
from pinograsp.planner.assemble import pressing_too
from pinograsp.planner.compliance import instability, stiffness_of
from pinograsp.planner.drive_cautions import measure_speeds
from pinograsp.planner.grasp_plan import GraspPlan, add_tolerance
from pinograsp.planner.options import AS_USUAL, PlanOptions
from pinograsp.planner.planning import GraspTask
from pinograsp.planner.tolerance import find_drop, tell_tolerance
from pinograsp.processes import count_processes, forked_results
from pinograsp.synthesis import GraspSearch
from pinograsp.synthesis.found import SOUND, FoundGrasp

FAR = 0.02  # slip of a contact while it presses, relative to the object's size
_OTHER = 0.1  # share by which a force at rest is another one than planned
_TRIES = 4  # plans that are not firm, or lose misplaced objects, before the best of them is taken
# Grasps that keep no reserve, as the search found, before the rest is left: of 21 searches of the catalogue's hands for
# objects up to four times as heavy, where none kept it, no grasp could be planned (223 tried).
_MOST_REFUSED = 3
_MOST_FAULTS = 8  # that :func:`_count_faults` counts, and a squeeze that crushes
_SLOWER = 1.05  # times as long as joints need that would be too fast: forces change a little with the time, too
_SLOWED, _LONGEST = 3, 10.0  # times that a plan is slowed at most, and times as long as asked for
_SHAKEN = 0.5  # of the acceleration that the reserve's force stands for


def plan_best(
    found: GraspSearch,
    conditions: GraspConditions,
    options: PlanOptions = AS_USUAL,
    *,
    jobs: int = -1,
    progress: bool | None = None,
    check: bool = False,
) -> GraspPlan:
    """Plan the grasps of a search, best first, until one comes out ``OK``.

    Some plans come last: contacts slide far while they press, lie on edges or press past them; other links press on the
    object, too; the forces differ from the planned ones; or the hand's own servos and the contacts let the object go,
    or give way far to its weight or the push of the reserve (:meth:`GraspPlan.object_stiffness`). Of the firm plans,
    those come first that keep more objects displaced by 5 mm and 5 deg; in hands of position servos of known stiffness,
    those in which the push turns the object less; and those that let the object drop by no more than 5 mm if only the
    hand holds it from the touch on. Where joints would move faster than their limits, the plan takes as long as they
    need (t_I, t_F), and a note says so.

    Args:
        found: what :func:`~pinograsp.synthesis.find_grasps` found.
        conditions: friction, limits, balance and the reserve.
        options: how to search, as for :func:`~pinograsp.planner.plan_grasp_on`.
        jobs: processes, which plan the next grasps meanwhile; -1: all cores. One outside the main thread, on other
            systems than Linux, and for grids. The result is the same.
        progress: bar on stderr: None (on a terminal), True or False.
        check: also simulate the plan, at rest and then shaken with half of what its reserve covers; this takes
            some seconds, more for meshes that are not convex. If it is lost, the next one is simulated: lost plans come
            last, with a warning; held ones have a note.

    Returns:
        The first plan that is ``OK``, and held if it is checked; if there is none, the plan of the best grasp that
        could be planned, with its status. A plan of those that come last is returned only if the first few are all of
        that kind: the one with the fewest faults.

    Raises:
        GraspNotFound: the search found no grasp.
        NoGrasp: no grasp could be planned; this is the failure of the best one.

    Example:
        >>> import pinograsp as pg
        >>> hand, ball = pg.load_hand("panda"), pg.Sphere(radius=0.02, mass=0.1)
        >>> conditions = pg.GraspConditions(mu=0.6)
        >>> found = pg.find_grasps(hand, ball, conditions, count=4, seed=0, jobs=1)
        >>> plan = pg.plan_best(found, conditions)
        >>> print(plan.status)
        ok

    See Also:
        :func:`~pinograsp.synthesis.find_grasps`, :func:`~pinograsp.planner.plan_grasp_on`,
        :class:`~pinograsp.planner.GraspPlan`.
    """
    instance_of("search", found, GraspSearch)
    flag("check", check)
    refused: list[tuple[NoGrasp, GraspTask]] = []
    plans = _rank(found, conditions, options, jobs, progress, check, refused)
    with contextlib.closing(plans):
        best = next(plans, None)
    if best is not None:
        plan = best.plan
        if plan.status not in (Status.OK, Status.INTERRUPTED):
            plan = replace(plan, notes=(*plan.notes, "no plan is ok: another seed, or more samples, may find one"))
            return _check(plan)[0] if check else plan
        return add_tolerance(plan, tell_tolerance(plan, plan.closure, known=best.tolerance), best.drop)
    near = [GraspTask.of_closure(one.closure, conditions, options) for one in found.near]
    raise _refusal(refused, len(found.grasps), near, (*filter(None, [found.size_remark]), *found.unmet))


def plan_each(
    found: GraspSearch,
    conditions: GraspConditions,
    options: PlanOptions = AS_USUAL,
    *,
    jobs: int = -1,
    progress: bool | None = None,
    check: bool = False,
    refused: list[tuple[NoGrasp, GraspTask]] | None = None,
) -> Generator[GraspPlan]:
    """The plans of a search's grasps, each once, as far as they are asked for: that of :func:`plan_best` first.

    Without their tolerance (:meth:`GraspPlan.with_tolerance`). Arguments as of :func:`plan_best`; ``refused``: is given
    the grasps that could not be planned.
    """
    with contextlib.closing(_rank(found, conditions, options, jobs, progress, check, refused)) as plans:
        for one in plans:
            yield one.plan


def _rank(
    found: GraspSearch,
    conditions: GraspConditions,
    options: PlanOptions,
    jobs: int,
    progress: bool | None,
    check: bool,
    refused: list[tuple[NoGrasp, GraspTask]] | None,
) -> Generator[_Planned]:
    """As :func:`plan_each`."""
    grasps = found.grasps or (found.best,)
    jobs = 1 if options.search != "convex" else count_processes(processes(jobs))
    work = [
        (i, one, conditions, options, progress if jobs == 1 else False, not check, jobs > 1)
        for i, one in enumerate(grasps)
    ]
    bodies = [part for one in grasps for part in (one.closure, one.closure.hand, one.closure.object)]
    waiting: list[_Planned] = []
    tried = failed = 0
    with forked_results(_plan, work, jobs, known=(*bodies, conditions, options)) as results:
        for grasp, one in zip(grasps, results):
            if isinstance(one, NoGrasp):
                if refused is not None:
                    refused.append((one, GraspTask.of_closure(grasp.closure, conditions, options, progress=progress)))
                failed += 1
                if failed >= _MOST_REFUSED and not (grasp.withstands or waiting):
                    break
                continue
            if one.plan.status is Status.INTERRUPTED:
                yield one
                continue
            if not one.whole and (not waiting or one.faults < waiting[0].faults):  # else it cannot be the better one
                one = one.with_losses()
            if not one.faults and not one.checked:
                one = one.with_check()
            if not one.faults:
                yield one
                continue
            heapq.heappush(waiting, one)
            tried += one.plan.status is Status.OK
            if tried >= _TRIES or (tried > 1 and grasp.sound < SOUND):  # two of those that are not sound
                yield _take_best(waiting)
        while waiting:
            yield _take_best(waiting)


def _plan(
    order: int,
    grasp: FoundGrasp,
    conditions: GraspConditions,
    options: PlanOptions,
    progress: bool | None,
    checked: bool,
    whole: bool,
) -> _Planned | NoGrasp:
    """A grasp's plan with its faults, with losses if it is to be ``whole``; or why there is none. ``checked``: it needs
    no simulation.
    """
    try:
        plan = _plan_in_time(grasp.closure, conditions, options, progress)
    except NoGrasp as error:
        return error
    faults = _MOST_FAULTS + 1
    if plan.status is Status.OK:
        faults = _count_faults(plan, grasp.closure) + int(grasp.crushes)
    good = plan.status is Status.OK
    one = _Planned(float(faults), order, plan, grasp.closure, whole=False, checked=checked or not good)
    return one.with_losses() if whole and good else one


def _plan_in_time(
    closure: Closure, conditions: GraspConditions, options: PlanOptions, progress: bool | None
) -> GraspPlan:
    """A closure's plan; where its hand would close faster than its joints can, one that takes as long as they need.

    Raises:
        NoGrasp: as :meth:`GraspTask.attempt`.
    """
    plan = GraspTask.of_closure(closure, conditions, options, progress=progress).attempt()
    hand, asked = closure.hand, conditions.final_time
    for _ in range(_SLOWED):  # another t_I of those allowed may be the best one then
        ratio = measure_speeds(hand, plan.motion)
        worst = int(ratio.argmax())
        factor = _SLOWER * float(ratio[worst])
        final, (first, last) = factor * conditions.final_time, conditions.impact_time_range
        if factor <= _SLOWER or final > _LONGEST * asked:
            break
        conditions = replace(conditions, final_time=final, impact_time_range=(factor * first, factor * last))
        try:
            slower = GraspTask.of_closure(closure, conditions, options, progress=progress).attempt()
        except NoGrasp:
            break
        unit = "m/s" if hand.slides[worst] else "rad/s"
        note = (
            f"t_F is {final:.3g} s instead of {asked:g} s, because of the speed limit of {hand.joint_names[worst]}, "
            f"{hand.velocity[worst]:g} {unit}"
        )
        plan = replace(slower, notes=(*slower.notes, note))
    return plan


class _Planned(NamedTuple):
    """A plan that is not quite as wished: its faults, in what order it came, its closure, and whether losses count
    already, and whether it needs no simulation (any more); then the tolerance of the errors that are asked about, and
    how far the object drops [m].
    """

    faults: float
    order: int
    plan: GraspPlan
    closure: Closure
    whole: bool
    checked: bool
    tolerance: PoseTolerance | None = None
    drop: float | None = None

    def with_losses(self) -> _Planned:
        """With what of misplaced objects is lost, how far a push turns it, and whether it drops."""
        tolerance = tell_tolerance(self.plan, self.closure, quick=True)
        lost = 0.0 if tolerance is None else 1.0 - tolerance.kept
        lost += measure_turn(self.plan) if self.plan.status is Status.OK else 0.0
        drop = find_drop(self.plan)
        lost += drop > MOVED
        return self._replace(faults=self.faults + lost, whole=True, tolerance=tolerance, drop=drop)

    def with_check(self) -> _Planned:
        """With what its simulation says."""
        plan, held = _check(self.plan)
        return self._replace(faults=self.faults + (0 if held else _MOST_FAULTS), plan=plan, checked=True)


def _take_best(waiting: list[_Planned]) -> _Planned:
    """The plan with the fewest faults, taken from a heap. What takes a while is only asked of those that come first."""
    while not (waiting[0].whole and waiting[0].checked):
        first = waiting[0]
        heapq.heapreplace(waiting, first.with_check() if first.whole else first.with_losses())
    return heapq.heappop(waiting)


def _refusal(
    refused: list[tuple[NoGrasp, GraspTask]], found: int, near: list[GraspTask], remarks: tuple[str, ...]
) -> NoGrasp:
    """What came of the best of ``found`` grasps, none of which could be planned: a failure, with what would do, after
    ``remarks``: the object's size or wishes, where these are in the way.

    It is that of the best grasp; or, where one of wider conditions fails under the given ones, too, of that one.
    """
    error, task = refused[0]
    for other in near:
        try:
            other.attempt()
        except SearchFailed as failure:
            error, task = failure, other
            break
        except NoGrasp:
            continue
    if not isinstance(error, SearchFailed):
        return error
    told = task.advise(error)
    if len(refused) == 1 and not remarks:
        return told
    proven = sum(isinstance(one, GraspInfeasible) for one, _ in refused)
    how = {len(refused): "proven for each of them", 0: "not proven"}.get(proven, f"proven for {proven} of them")
    which = f"{found} grasps" if found <= len(refused) else f"{len(refused)} best of the {found} grasps"
    lead = f"none of the {which} that were found can be planned ({how}). The nearest one:"
    if len(refused) == 1:
        lead = "the one grasp that was found cannot be planned:"
    lead = "\n".join([*remarks, lead])
    kind = type(told) if proven in (0, len(refused)) else GraspUndecided
    return kind(f"{lead} {told}", told.solution, remedy=told.remedy)


def _check(plan: GraspPlan) -> tuple[GraspPlan, bool]:
    """The plan with what its simulation says, and whether it was held."""
    from pinograsp.simulation import Disturbance, simulate  # slow to import

    acceleration = 0.0 if plan.reserve is None else plan.reserve.force / plan.body_mass
    shake = _SHAKEN * acceleration * np.ones(3) / np.sqrt(3.0)
    try:
        verdict = simulate(plan, disturbance=Disturbance(shake=shake)).verdict
        held, reason = verdict.held, verdict.reason
    except SimulationDiverged as error:
        held, reason = False, str(error)
    told = f"{SIMULATED}shaken with {_SHAKEN * acceleration:.2g} m/s^2): {'held' if held else 'lost'}, {reason}"
    if held:
        return replace(plan, notes=(*plan.notes, told)), True
    return replace(plan, cautions=(told, *plan.cautions)), False


def _count_faults(plan: GraspPlan, closure: Closure) -> int:
    """How much speaks against a plan: contacts that slide, lie on edges or press past them, forces that come out other
    than planned, other links that press, an object that leaves by itself, is easily pushed away or tilts.
    """
    slip, solution = np.asarray(plan.motion.slip), plan.solution
    planned, push = plan.forces.normal_forces, 0.0 if plan.reserve is None else plan.reserve.force
    gains, q = servo_gains(plan.hand), plan.motion.q[-1]
    held = stiffness_of(plan.hand, solution, q, gains)
    return sum(
        (
            bool(slip.size) and float(slip.max()) > FAR * closure.object.bounding_radius,
            doubtful_share(plan.hand, closure.object, solution.problem.contacts, planned) > 0,
            float(np.abs(plan.motion.settled_forces / planned - 1.0).max()) > _OTHER,
            bool(past_edges(closure.object, solution.problem.contacts, plan.forces.final_depths).any()),
            bool(pressing_too(plan.hand, solution, q)),
            bool(instability(plan.hand, solution, q, gains, push, held)),
            find_tilt(held, solution.problem.load) > TILTED,
        )
    )
