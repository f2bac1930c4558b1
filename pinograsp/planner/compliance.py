"""What servos and contacts that give way make of a plan: whether it is stable, and its forces on other contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.actuation import (
    FACTORS,
    CompliantHand,
    ForceBand,
    GainLimit,
    ObjectStiffness,
    drive_scenarios,
    force_band,
    gains_within,
    stiffness_scenarios,
)
from pinograsp.forces import ForceSolution, Reserve, SqueezeScenario
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.efforts import effort_shares
from pinograsp.hands.servos import find_pressing
from pinograsp.motion.holding import AWAY, compliant_hand, held_stiffness, push_away
from pinograsp.motion.torques import soften_servos
from pinograsp.plan import StiffnessBand
from pinograsp.spatial import Array

_STIFF = 1e3  # times a servo's gain: as if it did not yield


def describe_band(hand: HandModel, solution: ForceSolution, q: Array) -> StiffnessBand:
    """The band of a plan's record."""
    yielding = _closing_hand(hand, solution, q)
    band = force_band(solution, yielding, FACTORS)
    return StiffnessBand(
        servos=_in_words(hand, yielding.gains),
        factors=band.factors,
        normal_forces=band.normal_forces,
        remarks=band.remarks,
    )


def find_band(
    hand: HandModel, solution: ForceSolution, q: Array, stiffness: ArrayLike | None, factors: ArrayLike
) -> ForceBand:
    """The forces that come on contacts ``factors`` (s,) times as stiff as planned, with servos of a ``stiffness``, one
    number or (n,) [N m/rad or N/m]; None: with those that the hand closes with.
    """
    if stiffness is None:
        return force_band(solution, _closing_hand(hand, solution, q), factors)
    return force_band(solution, _yielding_hand(hand, solution, q, servo_gains(hand, stiffness)), factors)


def find_scenarios(hand: HandModel, solution: ForceSolution, q: Array, reserve: Reserve) -> tuple[SqueezeScenario, ...]:
    """What a squeeze becomes on the softest and stiffest contacts of a reserve, and from its weakest and strongest
    drives, with the servos that the hand closes with.
    """
    yielding = _closing_hand(hand, solution, q)
    found = stiffness_scenarios(solution, yielding, reserve.stiffness_factors) if reserve.stiffness_factors else ()
    share = effort_shares(hand) if reserve.drive == "sheet" else reserve.drive
    return found + (drive_scenarios(solution, yielding, share) if np.any(share) else ())


def find_gains(hand: HandModel, solution: ForceSolution, q: Array, tolerance: float, factors: ArrayLike) -> GainLimit:
    """The stiffest servos with which no F_n is off by more than ``tolerance`` on these contacts."""
    return gains_within(solution, _yielding_hand(hand, solution, q, servo_gains(hand)), tolerance, factors=factors)


def stiffness_of(hand: HandModel, solution: ForceSolution, q: Array, gains: Array) -> ObjectStiffness:
    """Stiffness of the object in a hand at ``q`` (n,) with servos of ``gains`` (n,), under the squeeze."""
    depth = solution.profile.final_depth
    return held_stiffness(hand, solution.problem, solution.forces_c, q, gains, depth)


def instability(
    hand: HandModel,
    solution: ForceSolution,
    q: Array,
    gains: Array,
    push: float = 0.0,
    held: ObjectStiffness | None = None,
) -> str | None:
    """How the object would leave by itself, or how far it would give way to a ``push`` [N], in words; None where
    servos of ``gains`` (n,) keep it. ``held``: as of :func:`stiffness_of`, if it is known.
    """
    held = stiffness_of(hand, solution, q, gains) if held is None else held
    if leaves := tell_leaving(hand, held, gains):
        return leaves
    away = push_away(held, push)
    if away <= AWAY:
        return None
    stiff = push_away(stiffness_of(hand, solution, q, _STIFF * gains), push)
    remedy = f"{'use stiffer servos, or' if stiff <= AWAY else 'its contacts are too soft,'} choose another grasp"
    return (
        f"with {_in_words(hand, gains)} the object gives way by {1e3 * away:.2g} mm to a push of {push:.2g} N, and may "
        f"creep if it is shaken: {remedy}"
    )


def tell_leaving(hand: HandModel, held: ObjectStiffness, gains: Array) -> str | None:
    """How the object would leave by itself, in words; None where it stays."""
    if held.is_stable():
        return None
    servos = f"the equilibrium is unstable: with {_in_words(hand, gains)}"
    if held.margin >= 0:
        return f"{servos} the fingers give way by themselves"
    motion = held.weakest
    turn, way = np.linalg.norm(motion[3:]) * held.moment_length, np.linalg.norm(motion[:3])
    part, does = (motion[3:], "turns about") if turn > way else (motion[:3], "moves along")
    axis = ", ".join(f"{value:.2f}" for value in part / np.linalg.norm(part))
    return f"{servos} the object {does} ({axis}) by itself; squeeze less, or choose contacts farther apart"


def _yielding_hand(hand: HandModel, solution: ForceSolution, q: Array, gains: Array) -> CompliantHand:
    return compliant_hand(hand, solution.problem.contacts, q, gains, solution.profile.final_depth)


def _closing_hand(hand: HandModel, solution: ForceSolution, q: Array) -> CompliantHand:
    """The hand with the servos that it closes with; jaws press with their drive's effort, wherever they come to."""
    contacts = solution.problem.contacts
    yielding = _yielding_hand(hand, solution, q, servo_gains(hand))
    soft = None
    if contacts.posture is not None:
        soft = soften_servos(hand, yielding.jacobian.T @ solution.forces_c.ravel())
    gains = yielding.gains if soft is None else soft
    return replace(yielding, gains=np.where(find_pressing(hand), 0.0, gains))


def _in_words(hand: HandModel, gains: Array) -> str:
    """The softest of the servos."""
    j = int(np.argmin(gains))
    if gains[j] == 0.0:
        return f"'{hand.joint_names[j]}' pressing with its effort"
    unit = "N/m" if hand.is_prismatic(hand.model.getJointId(hand.joint_names[j])) else "N m/rad"
    return f"servos of {gains[j]:.3g} {unit}"
