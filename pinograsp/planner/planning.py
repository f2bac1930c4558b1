"""From a force problem, or a hand and an object, to a grasp plan: the only file that knows the order of the stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from pinograsp.checks import instance_of, one_of
from pinograsp.contacts import Closure, close_hand
from pinograsp.contacts.support_plane import SupportPlane
from pinograsp.errors import GraspInfeasible, GraspUndecided, InvalidInput, SearchFailed, Status
from pinograsp.forces import (
    SEARCHES,
    BackendName,
    ConvexSolution,
    ForceProblem,
    ForceSolution,
    GraspConditions,
    GridSpec,
    Objective,
    Reserve,
    RobustForces,
    StiffnessScenario,
    TorqueLimit,
    grid_search,
    optimize_grasp,
    producible_reserve,
    qp_solvers,
    reserve_along,
    search_reserve,
)
from pinograsp.forces.relaxation import Setup
from pinograsp.hands import HandModel
from pinograsp.motion import (
    MotionSpec,
    PressingTogether,
    effort_of,
    normal_at_rest,
    plan_motion,
    pressing_together,
    torque_limits,
    torques_matter,
)
from pinograsp.objects.body import Body
from pinograsp.plan import Motion, PlanReserve
from pinograsp.planner.assemble import assembled, reserve_of
from pinograsp.planner.compliance import scenarios_of
from pinograsp.planner.drive_cautions import find_wrong_way
from pinograsp.planner.grasp_plan import GraspPlan
from pinograsp.planner.refusals import (
    freed,
    no_forces,
    not_made,
    proof,
    refuse_failure,
    refuse_no_squeeze,
    rejections,
    underactuated,
    with_advice,
)
from pinograsp.spatial import Array

Search = Literal["convex", "hybrid", "paper", "paper+qp"]

_SEARCHES: tuple[Search, ...] = get_args(Search)
# Rounds of force search and motion until the holding torques at the posture found are within their limits.
_TORQUE_ROUNDS = 6
_SETTLED = 1e-5  # [-, m] of the Jacobians from one round to the next
# Rounds that plan the forces that friction leaves, the share of a force from which on it is another one, and what a
# round has to leave of it at most.
_COMING_ROUNDS, _COMES, _GAINED = 3, 0.03, 0.7
_FIRMER, _FIRMEST = 1.2, 1.5  # times the planned forces: looked at, and worth it


@dataclass(frozen=True, slots=True, kw_only=True)
class _Choices:
    """How to search: the options that both planners share."""

    search: Search
    grid: GridSpec | None
    solver: BackendName
    objective: Objective | None
    motion: MotionSpec | None
    progress: bool | None

    def __post_init__(self) -> None:
        one_of("search", self.search, _SEARCHES)
        instance_of("grid", self.grid, GridSpec, type(None))
        instance_of("solver", self.solver, str)
        instance_of("motion", self.motion, MotionSpec, type(None))


# Eight options beside hand and problem: each is one stage's own, with a default that fits all problems.
def plan_grasp(
    hand: HandModel,
    problem: ForceProblem,
    *,
    search: Search = "convex",
    grid: GridSpec | None = None,
    solver: BackendName = "auto",
    objective: Objective | None = None,
    torque_limit: TorqueLimit = None,
    motion: MotionSpec | None = None,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan a grasp: least-energy contact forces, then the joint motion and torques with the least peak torque.

    Args:
        hand: the hand, placed in the world.
        problem: contacts (of this hand), load, friction and limits.
        search: ``"convex"``: the certified global optimum (:func:`~pinograsp.forces.optimize_grasp`), with any friction
            model; or a grid, see :func:`~pinograsp.forces.grid_search`.
        grid: of a grid search; None: the paper's.
        solver: name of the solver; ``"auto"``: the search's own.
        objective: of the convex search, a name or ``{name: weight}``; None: the problem's measure.
        torque_limit: the convex search keeps the holding torques at t_F within it: largest |torque| (n,) or one number
            [N m], or ``"effort"``: the hand's own effort limits (joints without one are not limited: a caution names
            them); None: the problem's own limits, if it has any.
        motion: postures and sampling.
        progress: bar on stderr: None (on a terminal), True or False.

    Returns:
        The plan with its status: ``OK``; ``UNBALANCED`` where the QP found that the paper's grid point balances only
        within its net-force limit; ``JOINT_LIMIT`` or ``NOT_TRACKED`` where the motion is at fault; ``INTERRUPTED``.

    Raises:
        GraspInfeasible: there are no forces; carries the search record and says why: the grid's rejection histogram, or
            the convex search's proof with its diagnosis.
        GraspUndecided: no forces were found, and none are ruled out.
        SearchInterrupted: stopped (Ctrl-C) before any forces were found.
        InvalidInput: an objective or torque limit without the convex search.
        ContactNotReached: a finger cannot reach its contact points.
    """
    instance_of("hand", hand, HandModel)
    instance_of("problem", problem, ForceProblem)
    choices = _Choices(search=search, grid=grid, solver=solver, objective=objective, motion=motion, progress=progress)
    limit = None if torque_limit is None else effort_of(hand, torque_limit)
    return GraspTask(hand=hand, setup=Setup(problem, None, limit), choices=choices).planned()


# As above; mu, friction and limits come with the conditions.
def plan_grasp_on(
    hand: HandModel,
    body: Body | Closure,
    conditions: GraspConditions,
    *,
    search: Search = "convex",
    grid: GridSpec | None = None,
    solver: BackendName = "auto",
    objective: Objective | None = None,
    motion: MotionSpec | None = None,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan a grasp on an object: close the hand on it, then :func:`plan_grasp` with the contacts found.

    With a reserve (``conditions.reserve``) the forces are the squeeze that bears it, over the impact times
    (:func:`~pinograsp.forces.search_reserve`), and ``plan.solution`` is its reaction to the weight alone.

    Args:
        hand: the hand, placed in the world.
        body: the object; or this hand closed on it already (:func:`~pinograsp.contacts.close_hand`).
        conditions: friction, limits and what is to be balanced.
        search: as for :func:`plan_grasp`; the grids know neither torque limits nor a reserve
            (``GraspConditions(torque_limit=None, reserve=None)``).
        grid: as for :func:`plan_grasp`.
        solver: as for :func:`plan_grasp`.
        objective: as for :func:`plan_grasp`; with a reserve ``"impulse"``, ``"work"``, ``"peak"`` or weights of these.
        motion: postures and sampling; None: from the open hand to the posture that touches.
        progress: as for :func:`plan_grasp`.

    Raises:
        InvalidInput: another hand than the closure's, or a hand that touches nothing. Others as for :func:`plan_grasp`.
    """
    task = task_on(
        hand,
        body,
        conditions,
        search=search,
        grid=grid,
        solver=solver,
        objective=objective,
        motion=motion,
        progress=progress,
    )
    return task.planned()


def task_on(
    hand: HandModel,
    body: Body | Closure,
    conditions: GraspConditions,
    *,
    search: Search = "convex",
    grid: GridSpec | None = None,
    solver: BackendName = "auto",
    objective: Objective | None = None,
    motion: MotionSpec | None = None,
    progress: bool | None = None,
) -> GraspTask:
    """What :func:`plan_grasp_on` plans, with its arguments."""
    started = time.perf_counter()
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body, Closure)
    instance_of("conditions", conditions, GraspConditions)
    closure = body if isinstance(body, Closure) else close_hand(hand, body)
    if not _same(hand, closure.hand):
        raise InvalidInput("hand: expected the closure's own, where it was closed (closure.hand), got another one")
    if motion is None:
        motion = MotionSpec(
            start={finger.name: closure.start[finger.dofs] for finger in hand.fingers},
            posture={finger.name: closure.q[finger.dofs] for finger in hand.fingers},
        )
    held = instance_of("object", closure.object, Body)
    if conditions.table:
        motion = replace(motion, table=SupportPlane.under(held, conditions.gravity_o))
    choices = _Choices(search=search, grid=grid, solver=solver, objective=objective, motion=motion, progress=progress)
    problem = conditions.problem(held, closure.contacts())
    limit = None if conditions.torque_limit is None else effort_of(hand, conditions.torque_limit)
    return GraspTask(
        hand=closure.hand,
        setup=Setup(problem, conditions.reserve, limit),
        choices=choices,
        elapsed={"closing": time.perf_counter() - started},
        closure=closure,
        conditions=conditions,
    )


def _same(one: HandModel, other: HandModel) -> bool:
    """Whether they are the same hand in the same place."""
    return one is other or (
        one.name == other.name and one.joint_names == other.joint_names and np.array_equal(one.pose, other.pose)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspTask:
    """What is to be planned, and how.

    Attributes:
        hand: placed in the world.
        setup: the forces' problem, the reserve, and the limit of the holding torques (n,) [N m], infinity: none.
        choices: how to search.
        elapsed: of the stages before [s].
        closure: the hand closed on the object; None: contacts were given.
        conditions: under which it is held; None: a problem was given.
    """

    hand: HandModel
    setup: Setup
    choices: _Choices
    elapsed: Mapping[str, float] = field(default_factory=dict)
    closure: Closure | None = None
    conditions: GraspConditions | None = None

    def planned(self) -> GraspPlan:
        """The plan; :class:`SearchFailed` says what would do, see :meth:`advised`."""
        try:
            return self.attempt()
        except SearchFailed as error:
            raise self.advised(error) from None

    def advised(self, error: SearchFailed) -> SearchFailed:
        """What an attempt ended in, with what would do."""
        quiet = replace(self.choices, progress=False)
        return with_advice(
            error, self.hand, self.setup, lambda other: replace(self._with(other), choices=quiet).attempt()
        )

    def _with(self, setup: Setup) -> GraspTask:
        """The same task with another problem or reserve."""
        body, closure = setup.problem.object, self.closure
        if closure is not None and body is not None and body is not closure.object:
            closure = replace(closure, object=body)
        return replace(self, setup=setup, closure=closure)

    def attempt(self) -> GraspPlan:
        """Forces, then motion."""
        hand, choices = self.hand, self.choices
        problem, reserve, limit = self.setup.problem, self.setup.reserve, self.setup.limit
        kept = None
        if reserve is not None:
            if choices.search != "convex" or choices.solver not in ("auto", "clarabel"):
                raise InvalidInput(
                    f"reserve: expected none (GraspConditions(reserve=None)) with search='{choices.search}' and "
                    f"solver='{choices.solver}': a squeeze for several loads is convex, its solver is clarabel"
                )
            forces, motion, spent, kept = _by_reserve(hand, problem, choices, limit, reserve)
        elif choices.search != "convex":
            if choices.objective is not None or limit is not None:
                raise InvalidInput(
                    f"objective, torque limit: expected none with search='{choices.search}', the grids know neither"
                )
            forces, motion, spent = _by_grid(hand, problem, choices)
        else:
            forces, motion, spent = _by_optimum(hand, problem, choices, limit)
        if wrong := find_wrong_way(hand, motion):
            raise GraspInfeasible(f"no grasp that this hand can make: {wrong}", forces)
        notes: tuple[str, ...] = ()
        if limit is not None and not np.isfinite(limit).any():
            notes = (f"no joint of '{hand.name}' has an effort limit: torques are not limited",)
        return assembled(
            hand,
            forces,
            motion,
            elapsed={**self.elapsed, **spent},
            closure=self.closure,
            conditions=self.conditions,
            reserve=kept,
            notes=notes,
        )


Stages = tuple[ForceSolution, Motion, dict[str, float]]


def _by_grid(hand: HandModel, problem: ForceProblem, choices: _Choices) -> Stages:
    started = time.perf_counter()
    solver = one_of("solver of a grid", "daqp" if choices.solver == "auto" else choices.solver, qp_solvers())
    kind = one_of("search", choices.search, SEARCHES)
    forces = grid_search(problem, choices.grid, search=kind, solver=solver, progress=choices.progress)
    refuse_failure(forces, rejections)
    found = time.perf_counter()
    motion = plan_motion(hand, forces, choices.motion)
    return forces, motion, {"forces": found - started, "motion": time.perf_counter() - found}


def _by_optimum(hand: HandModel, problem: ForceProblem, choices: _Choices, limit: Array | None) -> Stages:
    """The torques depend on the posture at t_F, which depends on the forces: a few rounds settle both."""
    heated = isinstance(choices.objective, str | Mapping) and "motor_heat" in choices.objective
    if limit is None and heated and problem.torques is None:
        limit = np.full(hand.n, np.inf)  # motor heat needs the Jacobians, at the posture that is found
    if limit is not None and not heated and not torques_matter(hand, limit):
        limit, problem = None, replace(problem, torques=None)
    spent = {"forces": 0.0, "motion": 0.0}
    # The first round finds a posture without knowing the torques.
    searched = problem if limit is None else replace(problem, torques=None)
    objective = choices.objective if limit is None else None
    for _ in range(_TORQUE_ROUNDS):
        started = time.perf_counter()
        forces = optimize_grasp(searched, objective=objective, backend=choices.solver, progress=choices.progress)
        refuse_failure(forces, proof)
        found = time.perf_counter()
        motion = plan_motion(hand, forces, choices.motion)
        spent["forces"] += found - started
        spent["motion"] += time.perf_counter() - found
        if limit is None or forces.status is Status.INTERRUPTED:
            break
        limits = torque_limits(
            hand,
            problem.contacts,
            motion.q[-1],
            depth=forces.profile.final_depth,
            limit=limit,
            gravity_o=problem.gravity_o,
        )
        known = searched.torques
        if known is not None and np.abs(limits.jacobian - known.jacobian).max() < _SETTLED:
            break
        searched, objective = replace(problem, torques=limits), choices.objective
    return forces, motion, spent


def _by_reserve(
    hand: HandModel, problem: ForceProblem, choices: _Choices, limit: Array | None, reserve: Reserve
) -> tuple[ForceSolution, Motion, dict[str, float], PlanReserve]:
    """One squeeze for all loads of the reserve; rounds for the torque limits as in :func:`_by_optimum`."""
    if not torques_matter(hand, limit):
        limit = None
    spent = {"forces": 0.0, "motion": 0.0}
    searched, start, tried = problem, None, 0
    together: PressingTogether | None = None
    posture = problem.contacts.posture
    if posture is not None:
        together = pressing_together(hand, problem.contacts, posture)
    for _ in range(_TORQUE_ROUNDS):
        started = time.perf_counter()
        squeeze = search_reserve(searched, reserve, objective=choices.objective, start=start)
        tried += squeeze.tried
        refuse_no_squeeze(squeeze, searched, reserve, choices.objective)
        least = squeeze.certificate.lower_bound if squeeze.certificate is not None else 0.0
        if underactuated(searched):
            any_hand = search_reserve(freed(searched), reserve, objective=choices.objective)
            least = any_hand.certificate.lower_bound if any_hand.certificate is not None else 0.0
        rows = np.zeros((0, problem.k)) if together is None else together.rows
        if len(rows) or reserve.stiffness_factors:
            scenarios = _on_other_contacts(hand, reserve, posture)
            squeeze = producible_reserve(
                searched, reserve, squeeze, rows, objective=choices.objective, scenarios=scenarios
            )
            tried += squeeze.tried
            if squeeze.status is not Status.OK:
                raise GraspUndecided(not_made(hand, searched, reserve, together), no_forces(squeeze, searched))
        forces = squeeze.under(problem.load)
        found = time.perf_counter()
        motion = plan_motion(hand, forces, choices.motion, corrected=not reserve.stiffness_factors)
        posture = motion.q[-1]
        spent["forces"] += found - started
        spent["motion"] += time.perf_counter() - found
        if limit is None:
            break
        limits = torque_limits(
            hand,
            problem.contacts,
            motion.q[-1],
            depth=forces.profile.final_depth,
            limit=limit,
            gravity_o=problem.gravity_o,
        )
        known = searched.torques
        if known is not None and np.abs(limits.jacobian - known.jacobian).max() < _SETTLED:
            break
        searched, start = replace(problem, torques=limits), squeeze.impact_time
    for _ in range(_COMING_ROUNDS):
        coming = _as_they_come(hand, searched, choices, reserve, squeeze, motion)
        if coming is None:
            break
        squeeze, forces, motion = coming
        tried += squeeze.tried
    return forces, motion, spent, reserve_of(reserve, squeeze, tried, least)


def _as_they_come(
    hand: HandModel,
    problem: ForceProblem,
    choices: _Choices,
    reserve: Reserve,
    squeeze: RobustForces,
    motion: Motion,
) -> tuple[RobustForces, ConvexSolution, Motion] | None:
    """Another squeeze, of the normal forces that the hand leaves once the object is let go, with its motion; None where
    they come as planned, or no nearer to the plan.

    Where one motor moves many joints, friction and the object's weight share the forces out, whatever was planned. How
    they go on from there, a firmer grip shows.
    """
    left = _other_than(squeeze.normal_forces, motion)
    if left < _COMES or reserve.stiffness_factors:
        return None
    forces = squeeze.under(problem.load)
    firmer = normal_at_rest(hand, replace(forces, forces_c=_FIRMER * forces.forces_c, torsion=_FIRMER * forces.torsion))
    if firmer is None:
        return None
    come = motion.settled_forces
    other = reserve_along(problem, reserve, squeeze, come, firmer - come, objective=choices.objective)
    if other.status is not Status.OK or other.normal_forces.sum() > _FIRMEST * squeeze.normal_forces.sum():
        return None
    forces = other.under(problem.load)
    other_motion = plan_motion(hand, forces, choices.motion)
    if _other_than(other.normal_forces, other_motion) > _GAINED * left or other_motion.status is not motion.status:
        return None
    return other, forces, other_motion


def _other_than(planned: Array, motion: Motion) -> float:
    """The largest share by which a normal force comes out other than ``planned`` (k,) [N]."""
    return float(np.abs(motion.settled_forces / planned - 1.0).max())


def _on_other_contacts(
    hand: HandModel, reserve: Reserve, posture: Array | None
) -> Callable[[ForceSolution], tuple[StiffnessScenario, ...]] | None:
    """What a squeeze becomes on contacts of another stiffness in a posture (n,), about that of touch at first; None
    where the reserve has no such contacts.
    """
    factors = reserve.stiffness_factors
    if not factors:
        return None
    q = instance_of("posture of the contacts", posture, np.ndarray)
    return lambda solution: scenarios_of(hand, solution, q, factors)
