"""What servos and contacts that give way make of a plan: whether it is stable, and its forces on other contacts."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.actuation import (
    FACTORS,
    CompliantHand,
    ForceBand,
    GainLimit,
    ObjectStiffness,
    contact_stiffness,
    force_band,
    gains_within,
    object_stiffness,
    stiffness_scenarios,
)
from pinograsp.contacts.quality import on_edges
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceSolution, StiffnessScenario
from pinograsp.hands import HandModel, servo_gains
from pinograsp.motion import preload_slope, torque_limits
from pinograsp.plan import StiffnessBand
from pinograsp.spatial import Array

_AWAY = 2e-3  # [m] by which the object may give way to the push of a reserve
_FINGERTIP = 0.008  # [m] radius of curvature of links where they touch


def compliant_hand(hand: HandModel, solution: ForceSolution, q: Array, gains: Array) -> CompliantHand:
    """The hand at ``q`` (n,), closed to the planned depths, with servos of ``gains`` (n,) at its joints."""
    contacts, depth = solution.problem.contacts, solution.profile.final_depth
    jacobians = torque_limits(hand, contacts, q, depth=depth, limit=np.inf).jacobian
    return CompliantHand.at(contacts, jacobians, gains=gains)


def describe_band(hand: HandModel, solution: ForceSolution, q: Array) -> StiffnessBand:
    """The band of a plan's record: with the hand's own servos, where their gains are known."""
    gains = servo_gains(hand)
    band = find_band(hand, solution, q, gains, FACTORS)
    return StiffnessBand(
        servos=f"servos of {_in_words(hand, gains)}",
        factors=band.factors,
        normal_forces=band.normal_forces,
        remarks=band.remarks,
    )


def find_band(hand: HandModel, solution: ForceSolution, q: Array, gains: Array, factors: ArrayLike) -> ForceBand:
    """The forces that come on contacts ``factors`` (s,) times as stiff as planned, with servos of ``gains`` (n,)."""
    return force_band(solution, compliant_hand(hand, solution, q, gains), factors)


def find_scenarios(
    hand: HandModel, solution: ForceSolution, q: Array, factors: ArrayLike
) -> tuple[StiffnessScenario, ...]:
    """What a squeeze becomes on contacts ``factors`` (s,) times as stiff as assumed, with the hand's own servos."""
    return stiffness_scenarios(solution, compliant_hand(hand, solution, q, servo_gains(hand)), factors)


def find_gains(hand: HandModel, solution: ForceSolution, q: Array, tolerance: float, factors: ArrayLike) -> GainLimit:
    """The stiffest servos with which no F_n is off by more than ``tolerance`` on these contacts."""
    return gains_within(solution, compliant_hand(hand, solution, q, servo_gains(hand)), tolerance, factors=factors)


def stiffness_of(hand: HandModel, solution: ForceSolution, q: Array, gains: Array) -> ObjectStiffness:
    """Stiffness of the object in a hand at ``q`` (n,) with servos of ``gains`` (n,), under the squeeze.

    Links that touch at several corners are flat there, others are round; the object is as curved as it is.
    """
    problem, contacts, depth = solution.problem, solution.problem.contacts, solution.profile.final_depth
    stiff = contact_stiffness(problem.compliance, solution.normal_forces)
    forces_o = np.einsum("kxc,kc->kx", contacts.rotations_oc, solution.forces_c)
    own, other = _curvatures(solution)
    return object_stiffness(
        contacts.G,
        stiff,
        compliant_hand(hand, solution, q, gains),
        solution.forces_c,
        object_curvature=own,
        hand_curvature=other,
        torsional_stiffness=problem.friction.torsion**2 * stiff.diagonal()[2::3],
        joint_preload=preload_slope(hand, contacts, q, forces_o, depth=depth),
    )


def _curvatures(solution: ForceSolution) -> tuple[Array, Array]:
    """Of the object and of the links at the contacts (k,) [1/m]."""
    contacts, body = solution.problem.contacts, solution.problem.object
    links = [contact.link for contact in contacts]
    rounded = np.array([links.count(link) == 1 for link in links])
    if body is not None:
        rounded &= ~on_edges(body, contacts)
    own, other = np.full(len(links), np.inf), np.zeros(len(links))
    if not rounded.any():
        return own, other
    other[rounded], own[rounded] = 1.0 / _FINGERTIP, 0.0
    if body is not None:
        with suppress(InvalidInput):  # an edge too near for a curvature
            own[rounded] = body.curvature(contacts.points_o[rounded])[0].mean(axis=1)
    # In a hollow that is narrower than the link the two touch at more than a point: flat on flat.
    narrow = own + other <= 0
    own[narrow], other[narrow] = np.inf, 0.0
    return own, other


def instability(hand: HandModel, solution: ForceSolution, q: Array, gains: Array, push: float = 0.0) -> str | None:
    """How the object would leave by itself, or how far it would give way to a ``push`` [N], in words; None where
    servos of ``gains`` (n,) keep it.
    """
    return gives_way(hand, stiffness_of(hand, solution, q, gains), gains, push)


def gives_way(hand: HandModel, held: ObjectStiffness, gains: Array, push: float = 0.0) -> str | None:
    """The same of a stiffness that is known."""
    if held.is_stable():
        away = push * float(np.linalg.norm(np.linalg.pinv(held.matrix)[:3, :3], 2))
        if away <= _AWAY:
            return None
        return (
            f"with servos of {_in_words(hand, gains)} the object gives way by {1e3 * away:.2g} mm to a push of "
            f"{push:.2g} N, and may creep where it is shaken: take stiffer servos, or another grasp"
        )
    servos = f"the equilibrium is unstable: with servos of {_in_words(hand, gains)}"
    if held.margin >= 0:
        return f"{servos} the fingers give way by themselves"
    motion = held.weakest
    turn, way = np.linalg.norm(motion[3:]) * held.moment_length, np.linalg.norm(motion[:3])
    part, does = (motion[3:], "turns about") if turn > way else (motion[:3], "moves along")
    axis = ", ".join(f"{value:.2f}" for value in part / np.linalg.norm(part))
    return f"{servos} the object {does} ({axis}) by itself; squeeze less, or touch it farther apart"


def _in_words(hand: HandModel, gains: Array) -> str:
    """The softest one."""
    j = int(np.argmin(gains))
    unit = "N/m" if hand.is_prismatic(hand.model.getJointId(hand.joint_names[j])) else "N m/rad"
    return f"{gains[j]:.3g} {unit}"
