"""What is in the way where a search finds nothing: grasps of wider conditions, and what of these they need."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pinograsp.forces import GraspConditions, optimize_forces
from pinograsp.forces.relaxation import LARGEST_FRICTION, Setup, describe_relaxations, find_relaxations, forces_exist
from pinograsp.motion import effort_of, pressing_together
from pinograsp.synthesis.found import FoundGrasp, problem_of

_RUBBER = 1.5  # friction of the widest conditions: that of rubber, or any at all where it is that already
_WIDE = 1e4  # times a limit: none


def wider_conditions(conditions: GraspConditions) -> Iterator[GraspConditions]:
    """Without the limits of forces and torques; then with more friction, too."""
    low, high = conditions.acceleration_range
    wide = replace(
        conditions,
        torque_limit=None,
        max_normal_force=None,
        max_depth=_WIDE * conditions.max_depth,
        max_speed=_WIDE * conditions.max_speed,
        acceleration_range=(low / _WIDE, _WIDE * high),
    )
    yield wide
    yield replace(wide, mu=_RUBBER if conditions.mu < _RUBBER else LARGEST_FRICTION)


def what_would_do(near: tuple[FoundGrasp, ...], conditions: GraspConditions, impact_time: float) -> tuple[str, ...]:
    """In words, what lets forces hold the best grasp of wider conditions; empty where there is none."""
    if not near:
        return ()
    closure = near[0].closure
    hand, contacts = closure.hand, closure.contacts()
    problem = problem_of(hand, closure.object, contacts, conditions)
    limit = None if conditions.torque_limit is None else effort_of(hand, conditions.torque_limit)
    setup = Setup(problem, None if conditions.reserve is None else conditions.reserve.of_hand(hand), limit)
    rows = None if contacts.posture is None else pressing_together(hand, contacts, contacts.posture).rows

    def does(other: Setup) -> bool:
        return forces_exist(other, rows) and optimize_forces(other.problem, impact_time).found

    return describe_relaxations(tuple(find_relaxations(setup, does)), setup, hand.slides.tolist())
