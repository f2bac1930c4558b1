"""Why a hand has no grasp, in words: what is in the way, and what would do, each tried by planning with it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from pinograsp.errors import (
    GraspInfeasible,
    GraspUndecided,
    PinograspError,
    SearchFailed,
    SearchInterrupted,
    Status,
)
from pinograsp.forces import (
    ConvexSolution,
    ForceProblem,
    ForceSolution,
    GridSolution,
    Objective,
    Reserve,
    RobustForces,
    optimize_grasp,
    search_reserve,
)
from pinograsp.forces.diagnosis import proof_in_words
from pinograsp.forces.relaxation import (
    LARGEST_FRICTION,
    Relaxation,
    Setup,
    describe_relaxations,
    find_relaxations,
    forces_exist,
    relax,
)
from pinograsp.hands import HandModel, servo_gains
from pinograsp.motion import PressingTogether, pressing_together, torque_limits, torques_matter
from pinograsp.planner.grasp_plan import GraspPlan

_Solution = TypeVar("_Solution", bound=ForceSolution)
_TRIED = 8  # options that are planned with
_WIDER = (1.0, 1.1, 1.3)  # times the least that forces need: postures and impact times move with them
_PATIENCE = 20.0  # [s] for which whole plans are tried
_COARSE = 0.1  # of figures that whole plans are tried for


class Option(NamedTuple):
    """What would do: limits to relax, all of them together, and what the plan with it comes out as."""

    relaxations: tuple[Relaxation, ...]
    status: Status


def with_advice(error: SearchFailed, hand: HandModel, setup: Setup, plan: Callable[[Setup], GraspPlan]) -> SearchFailed:
    """The same error with what would do, each tried by planning with it.

    Args:
        error: what a plan of the set-up ended in.
        hand: whose plan it was.
        setup: what was planned; ``error.solution.problem`` has the torque limits where they were known.
        plan: plans a set-up, or raises.
    """
    if isinstance(error, SearchInterrupted):
        return error
    searched = _with_torques(hand, error.solution.problem, setup)
    slides = hand.slides.tolist()
    options = _options(hand, setup, searched, plan)
    lines: Sequence[str] = describe_relaxations(
        [option.relaxations for option in options],
        searched,
        slides,
        ["" if option.status is Status.OK else f" (the plan is then {option.status})" for option in options],
    )
    remedy = "Tried, and would suffice: " + "".join(lines[1:2]).strip()
    if not lines:
        lines = [
            "relaxing limits, one by one or together, does not make it a grasp (torques, normal forces, friction up "
            f"to {LARGEST_FRICTION:g}, mass, the reserve's parts): other contacts are needed"
        ]
        remedy = "Other contacts are needed: close the hand elsewhere, or search with more samples or another seed."
    return type(error)("\n".join([str(error), *lines]), error.solution, remedy=remedy)


def _with_torques(hand: HandModel, problem: ForceProblem, setup: Setup) -> Setup:
    """The set-up with the torque limits of the posture that touches, where others are not known."""
    posture = problem.contacts.posture
    if problem.torques is None and posture is not None and torques_matter(hand, setup.limit):
        limits = torque_limits(hand, problem.contacts, posture, limit=setup.limit, gravity_o=problem.gravity_o)
        problem = replace(problem, torques=limits)
    return replace(setup, problem=problem)


class _PatienceLostError(Exception):
    """Whole plans were tried for long enough."""


def _options(hand: HandModel, setup: Setup, searched: Setup, plan: Callable[[Setup], GraspPlan]) -> list[Option]:
    """What would do; those whose plans are ``OK``, or all where there is none."""
    contacts = searched.problem.contacts
    rows = None
    if setup.reserve is not None and contacts.posture is not None:
        rows = pressing_together(hand, contacts, contacts.posture).rows

    deadline = time.monotonic() + _PATIENCE

    def attempt(other: Setup) -> Status | None:
        if time.monotonic() > deadline:
            raise _PatienceLostError
        return try_plan(plan, other)

    found: list[Option] = []
    by_forces = not forces_exist(searched, rows)
    if by_forces:
        candidates = find_relaxations(searched, lambda other: forces_exist(other, rows))
    else:  # whole plans show what else is in the way
        candidates = find_relaxations(setup, lambda other: attempt(other) is not None, sharp=_COARSE)
    with contextlib.suppress(_PatienceLostError):  # what was found by then is told
        for relaxations, _ in zip(candidates, range(_TRIED)):
            for times in _WIDER:
                wider = tuple(one.wider(times).round_figure(searched) for one in relaxations)
                status = attempt(relax(setup, wider))
                if status is not None:
                    found.append(Option(relaxations=wider, status=status))
                    break
    good = [option for option in found if option.status is Status.OK]
    return good or found


def try_plan(plan: Callable[[Setup], GraspPlan], setup: Setup) -> Status | None:
    """How a plan of the set-up comes out; None where it does not."""
    try:
        status = plan(setup).status
    except PinograspError:
        return None
    return None if status.exit_code else status


def list_couplings(problem: ForceProblem) -> tuple[str, ...]:
    """What is in the way of joint torques that could be chosen one by one, in words."""
    under = None if problem.torques is None else problem.torques.underactuation
    return () if under is None else tuple(dict.fromkeys(under.why))


def free_drives(problem: ForceProblem, why: str | None = None) -> ForceProblem:
    """The problem without the equations of an underactuated hand, or without those of one drive."""
    torques = problem.torques
    if torques is None or torques.underactuation is None:
        return problem
    under = torques.underactuation
    left = [i for i, own in enumerate(under.why) if why is not None and own != why]
    why_left = tuple(under.why[i] for i in left)
    kept = replace(under, rows=under.rows[left], torques=under.torques[left], why=why_left, stops=under.stops[left])
    return replace(problem, torques=replace(torques, underactuation=kept if left else None))


def _drives_in_the_way(problem: ForceProblem, holds: Callable[[ForceProblem], bool]) -> str:
    """What the hand's drives have to do with it that no forces are found, "" where it is not their fault."""
    reasons = list_couplings(problem)
    if not reasons or not holds(free_drives(problem)):
        return ""
    alone = [why for why in reasons if holds(free_drives(problem, why))]
    which = f"in the way: {'; or '.join(alone)}" if alone else f"in the way together: {'; '.join(reasons)}"
    return (
        "no grasp found that this hand can produce: forces hold the object, but its drives cannot produce the "
        f"necessary joint torques ({which}); choose another grasp, or another drive"
    )


def refuse_no_squeeze(
    squeeze: RobustForces, problem: ForceProblem, reserve: Reserve, objective: Objective | None
) -> None:
    """Raise what came of a search without a squeeze."""
    if squeeze.status is Status.OK:
        return
    none = no_forces(squeeze, problem)

    def withstands(other: ForceProblem) -> bool:
        return search_reserve(other, reserve, objective=objective).status is Status.OK

    if not_made := _drives_in_the_way(problem, withstands):
        raise GraspInfeasible(not_made, none) if squeeze.status is Status.INFEASIBLE else GraspUndecided(not_made, none)
    if squeeze.status is not Status.INFEASIBLE:
        raise GraspUndecided(
            "no grasp found that holds the object with its reserve, but it is not proven that none exists", none
        )
    raise GraspInfeasible("no grasp holds the object with its reserve (proven at every impact time)", none)


def no_forces(squeeze: RobustForces, problem: ForceProblem) -> ConvexSolution:
    """The record of a squeeze that was not found."""
    return ConvexSolution(
        status=squeeze.status,
        problem=problem,
        search="robust",
        solver="clarabel",
        impact_time=None,
        forces_c=np.zeros((0, 3)),
        elapsed=squeeze.elapsed,
        weights=squeeze.weights,
        infeasibility=squeeze.infeasibility,
    )


def explain_unmade(hand: HandModel, problem: ForceProblem, reserve: Reserve, together: PressingTogether | None) -> str:
    """Why the hand cannot make the forces that would hold the object."""
    if reserve.has_scenarios:
        gains = servo_gains(hand)
        asked = [f"{name}={getattr(reserve, name):g}" for name in ("softer", "stiffer", "drive")]
        return (
            "no grasp found that holds with contacts as soft and as stiff, and drives as weak and as strong, as the "
            f"reserve requires ({', '.join(asked)}): forces hold the object as assumed, but not the forces that servos "
            f"of {gains.min():.3g} to {gains.max():.3g} N m/rad (sliding joints: N/m) exert then"
        )
    moves = np.zeros((0, hand.n)) if together is None else together.moves
    driving = [name for name, column in zip(hand.joint_names, moves.T) if np.any(column)]
    return (
        f"no grasp found that this hand can produce: forces hold the object with its reserve, but {', '.join(driving)} "
        f"press {problem.k} contacts together, and the depths that they can produce do not hold it"
    )


def refuse_failure(forces: _Solution, why: Callable[[_Solution], str]) -> None:
    """Raise what came of a search without forces; ``why``: what it has to say for itself."""
    if forces.found and forces.status is not Status.INACCURATE:
        return
    if forces.status is Status.INFEASIBLE:
        raise GraspInfeasible(why(forces), forces)
    kind = SearchInterrupted if forces.status is Status.INTERRUPTED else GraspUndecided
    raise kind(f"no grasp found ({forces.status}), but it is not proven that none exists", forces)


def explain_grid(forces: GridSolution) -> str:
    """What a grid has to say for itself."""
    return f"no grasp found on the grid\n{forces.explain()}"


def explain_proof(forces: ForceSolution) -> str:
    """The proof, at the impact time that admits the largest forces."""
    if not_made := _drives_in_the_way(forces.problem, lambda other: optimize_grasp(other, progress=False).found):
        return not_made
    at = forces.problem.impact_time_range[0]
    return f"no grasp: every impact time is proven infeasible\n{proof_in_words(forces.problem, at)}"
