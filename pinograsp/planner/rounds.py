"""Forces and a motion that bring each other about: rounds of force search, motion and torque limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import instance_of, one_of
from pinograsp.errors import GraspUndecided, InvalidInput, Status
from pinograsp.forces import (
    SEARCHES,
    ConvexSolution,
    ForceProblem,
    ForceSolution,
    Reserve,
    RobustForces,
    SqueezeScenario,
    TorqueLimits,
    grid_search,
    optimize_grasp,
    producible_reserve,
    reserve_along,
    search_reserve,
)
from pinograsp.forces.relaxation import Setup
from pinograsp.forces.solve.solvers import check_qp_solver
from pinograsp.hands import HandModel
from pinograsp.motion import (
    PressingTogether,
    draft_motion,
    normal_at_rest,
    plan_motion,
    pressing_together,
    torque_limits,
    torques_matter,
)
from pinograsp.plan import Motion, PlanReserve
from pinograsp.planner.assemble import record_reserve
from pinograsp.planner.compliance import find_scenarios
from pinograsp.planner.options import PlanOptions
from pinograsp.planner.refusals import (
    explain_grid,
    explain_proof,
    explain_unmade,
    free_drives,
    list_couplings,
    no_forces,
    refuse_failure,
    refuse_no_squeeze,
)
from pinograsp.planner.stopwatch import Stopwatch
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRounds:
    """How long forces and motion are searched in turn.

    Attributes:
        torques: rounds until the holding torques at the posture found are within their limits.
        settled: change of the Jacobians from one of them to the next that is none [-, m].
        coming: rounds that plan the forces that friction leaves.
        comes: share of a force from which on it is another one [-].
        gained: what such a round may leave of the largest share at most [-].
        firmer: times the planned forces that are looked at for how forces go on.
        firmest: times the planned forces that are worth it.
    """

    torques: int = 6
    settled: float = 1e-5
    coming: int = 3
    comes: float = 0.03
    gained: float = 0.7
    firmer: float = 1.2
    firmest: float = 1.5


# Weighed in benchmarks/grasps.py: columns ``error``, how far simulated forces are off the planned ones, and ``plan_s``.
ROUNDS = PlanRounds()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForcesAndMotion:
    """What the rounds end with.

    Attributes:
        forces: contact forces at t_F.
        motion: that brings them about.
        elapsed: ``{"forces": ..., "motion": ...}`` [s].
        reserve: what the forces withstand besides the load; None: they were searched for the load alone.
    """

    forces: ForceSolution
    motion: Motion
    elapsed: Mapping[str, float]
    reserve: PlanReserve | None = None

    def after(self, elapsed: Mapping[str, float]) -> ForcesAndMotion:
        """With the seconds ``elapsed`` before, by stage, added to its own."""
        return replace(self, elapsed={stage: took + elapsed[stage] for stage, took in self.elapsed.items()})


def search_forces_and_motion(
    hand: HandModel, setup: Setup, options: PlanOptions, progress: bool | None
) -> ForcesAndMotion:
    """Contact forces for a set-up, and the motion of the hand that brings them about.

    Raises:
        InvalidInput: options that do not go with the set-up. SearchFailed: there are no forces, or none were found.
    """
    if setup.reserve is not None:
        if options.search != "convex" or options.solver not in ("auto", "clarabel"):
            raise InvalidInput(
                f"reserve: expected none (GraspConditions(reserve=None)) with search='{options.search}' and "
                f"solver='{options.solver}': a squeeze for several loads is a convex problem, which clarabel solves"
            )
        return _search_squeeze(hand, setup, options, setup.reserve)
    if options.search == "convex":
        return _search_optimum(hand, setup, options, progress)
    if options.objective is not None or setup.limit is not None:
        raise InvalidInput(
            f"objective, torque limit: expected none with search='{options.search}', which supports neither"
        )
    return _search_grid(hand, setup.problem, options, progress)


def _search_grid(
    hand: HandModel, problem: ForceProblem, options: PlanOptions, progress: bool | None
) -> ForcesAndMotion:
    watch = Stopwatch("forces", "motion")
    solver = check_qp_solver("daqp" if options.solver == "auto" else options.solver, "solver of a grid")
    kind = one_of("search", options.search, SEARCHES)
    forces = grid_search(problem, options.grid, search=kind, solver=solver, progress=progress)
    refuse_failure(forces, explain_grid)
    watch.stop("forces")
    motion = plan_motion(hand, forces, options.motion)
    watch.stop("motion")
    return ForcesAndMotion(forces=forces, motion=motion, elapsed=watch.elapsed)


def _search_optimum(hand: HandModel, setup: Setup, options: PlanOptions, progress: bool | None) -> ForcesAndMotion:
    """The torques depend on the posture at t_F, which depends on the forces: a few rounds settle both."""
    problem, limit = setup.problem, setup.limit
    heated = isinstance(options.objective, str | Mapping) and "motor_heat" in options.objective
    if limit is None and heated and problem.torques is None:
        limit = np.full(hand.n, np.inf)  # motor heat needs the Jacobians, at the posture that is found
    if limit is not None and not heated and not torques_matter(hand, limit):
        limit, problem = None, replace(problem, torques=None)
    watch, rounds = Stopwatch("forces", "motion"), 1
    # The first round finds a posture without knowing the torques.
    searched = problem if limit is None else replace(problem, torques=None)
    objective = options.objective if limit is None else None
    while True:
        forces = optimize_grasp(searched, objective=objective, solver=options.solver, progress=progress)
        refuse_failure(forces, explain_proof)
        watch.stop("forces")
        draft = draft_motion(hand, forces, options.motion)
        watch.stop("motion")
        if limit is None or forces.status is Status.INTERRUPTED or rounds == ROUNDS.torques:
            break
        limits = _limits_at(hand, forces, draft.posture, limit)
        if _are_settled(limits, searched.torques):
            break
        searched, objective, rounds = replace(problem, torques=limits), options.objective, rounds + 1
    motion = draft.finish()
    watch.stop("motion")
    return ForcesAndMotion(forces=forces, motion=motion, elapsed=watch.elapsed)


def _limits_at(hand: HandModel, forces: ForceSolution, posture: Array, limit: Array) -> TorqueLimits:
    """The torque limits at the posture (n,) at which a hand presses with these forces."""
    problem, depth = forces.problem, forces.profile.final_depth
    return torque_limits(hand, problem.contacts, posture, depth=depth, limit=limit, gravity_o=problem.gravity_o)


def _are_settled(limits: TorqueLimits, known: TorqueLimits | None) -> bool:
    """Whether the forces were searched with these limits."""
    return known is not None and bool(np.abs(limits.jacobian - known.jacobian).max() < ROUNDS.settled)


def _search_squeeze(hand: HandModel, setup: Setup, options: PlanOptions, reserve: Reserve) -> ForcesAndMotion:
    """One squeeze for all loads of the reserve; rounds for the torque limits as in :func:`_search_optimum`."""
    problem, limit = setup.problem, setup.limit if torques_matter(hand, setup.limit) else None
    watch, rounds, tried, start = Stopwatch("forces", "motion"), 1, 0, None
    searched, posture = problem, problem.contacts.posture
    together = None if posture is None else pressing_together(hand, problem.contacts, posture)
    while True:
        solved, freely = searched, search_reserve(searched, reserve, objective=options.objective, start=start)
        tried += freely.tried
        refuse_no_squeeze(freely, searched, reserve, options.objective)
        squeeze = freely
        rows = np.zeros((0, problem.k)) if together is None else together.rows
        if len(rows) or reserve.has_scenarios:
            squeeze = _search_producible(hand, searched, squeeze, reserve, options, posture, together)
            tried += squeeze.tried
        forces = squeeze.under(problem.load)
        watch.stop("forces")
        draft = draft_motion(hand, forces, options.motion, corrected=not reserve.has_scenarios)
        posture = draft.posture
        watch.stop("motion")
        if limit is None:
            break
        limits = _limits_at(hand, forces, posture, limit)
        if _are_settled(limits, searched.torques):
            break
        searched, start, rounds = replace(problem, torques=limits), squeeze.impact_time, rounds + 1
        if rounds > ROUNDS.torques:
            break
    motion = draft.finish()
    watch.stop("motion")
    least = _least_of_any_hand(freely, solved, reserve, options)
    watch.stop("forces")
    for _ in range(ROUNDS.coming):
        coming = _search_as_they_come(hand, searched, options, reserve, squeeze, motion)
        if coming is None:
            break
        squeeze, forces, motion = coming
        tried += squeeze.tried
    record = record_reserve(reserve, squeeze, hand, tried, least)
    return ForcesAndMotion(forces=forces, motion=motion, elapsed=watch.elapsed, reserve=record)


def _least_of_any_hand(squeeze: RobustForces, problem: ForceProblem, reserve: Reserve, options: PlanOptions) -> float:
    """Lower bound of the objective of a hand that could make any forces."""
    if list_couplings(problem):
        start = squeeze.impact_time
        squeeze = search_reserve(free_drives(problem), reserve, objective=options.objective, start=start)
    return squeeze.certificate.lower_bound if squeeze.certificate is not None else 0.0


def _search_producible(
    hand: HandModel,
    problem: ForceProblem,
    squeeze: RobustForces,
    reserve: Reserve,
    options: PlanOptions,
    posture: Array | None,
    together: PressingTogether | None,
) -> RobustForces:
    """A squeeze that the hand's joints can make in a posture (n,), in all scenarios of the reserve."""
    rows = np.zeros((0, problem.k)) if together is None else together.rows

    def scenarios_of(solution: ForceSolution) -> tuple[SqueezeScenario, ...]:
        return find_scenarios(hand, solution, instance_of("posture of the contacts", posture, np.ndarray), reserve)

    scenarios = scenarios_of if reserve.has_scenarios else None
    producible = producible_reserve(problem, reserve, squeeze, rows, objective=options.objective, scenarios=scenarios)
    if producible.status is not Status.OK:
        raise GraspUndecided(explain_unmade(hand, problem, reserve, together), no_forces(producible, problem))
    return producible


def _search_as_they_come(
    hand: HandModel,
    problem: ForceProblem,
    options: PlanOptions,
    reserve: Reserve,
    squeeze: RobustForces,
    motion: Motion,
) -> tuple[RobustForces, ConvexSolution, Motion] | None:
    """Another squeeze, of the normal forces that the hand leaves once the object is let go, with its motion; None where
    they come as planned, or no nearer to the plan.

    Where one motor moves many joints, friction and the object's weight share the forces out, whatever was planned. How
    they go on from there, a firmer grip shows.
    """
    left = _largest_change(squeeze.normal_forces, motion)
    if left < ROUNDS.comes or reserve.has_scenarios:
        return None
    forces = squeeze.under(problem.load)
    firmer = normal_at_rest(
        hand, replace(forces, forces_c=ROUNDS.firmer * forces.forces_c, torsion=ROUNDS.firmer * forces.torsion)
    )
    if firmer is None:
        return None
    come = motion.settled_forces
    other = reserve_along(problem, reserve, squeeze, come, firmer - come, objective=options.objective)
    if other.status is not Status.OK or other.normal_forces.sum() > ROUNDS.firmest * squeeze.normal_forces.sum():
        return None
    forces = other.under(problem.load)
    other_motion = plan_motion(hand, forces, options.motion)
    if (
        _largest_change(other.normal_forces, other_motion) > ROUNDS.gained * left
        or other_motion.status is not motion.status
    ):
        return None
    return other, forces, other_motion


def _largest_change(planned: Array, motion: Motion) -> float:
    """The largest share by which a normal force comes out other than ``planned`` (k,) [N]."""
    return float(np.abs(motion.settled_forces / planned - 1.0).max())
