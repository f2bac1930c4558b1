"""Whether a plan's equilibrium is stable: a squeeze on springs may tip its object over, as a rod under load buckles."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from pinograsp.actuation import CompliantHand, ObjectStiffness, contact_stiffness, object_stiffness
from pinograsp.contacts.quality import on_edges
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceSolution
from pinograsp.hands import HandModel
from pinograsp.motion import preload_slope, torque_limits
from pinograsp.spatial import Array

SERVO = 50.0  # [N m/rad] stiffness of a small servo; at a sliding joint that of the same, 30 mm from its axis
_LEVER = 0.03  # [m]
_FINGERTIP = 0.008  # [m] radius of curvature of links where they touch


def stiffness_of(hand: HandModel, solution: ForceSolution, q: Array, servo: float = SERVO) -> ObjectStiffness:
    """Stiffness of the object in a hand at ``q`` (n,) with servos of ``servo`` [N m/rad], under the squeeze.

    Links that touch at several corners are flat there, others are round; the object is as curved as it is.
    """
    problem, contacts, depth = solution.problem, solution.problem.contacts, solution.profile.final_depth
    jacobians = torque_limits(hand, contacts, q, depth=depth, limit=np.inf).jacobian
    slides = np.array([hand.is_prismatic(hand.model.getJointId(name)) for name in hand.joint_names])
    compliant = CompliantHand.at(contacts, jacobians, gains=np.where(slides, servo / _LEVER**2, servo))
    stiff = contact_stiffness(problem.compliance, solution.normal_forces)
    normal = stiff.diagonal()[2::3]
    forces_o = np.einsum("kxc,kc->kx", contacts.rotations_oc, solution.forces_c)
    own, other = _curvatures(solution)
    return object_stiffness(
        contacts.G,
        stiff,
        compliant,
        solution.forces_c,
        object_curvature=own,
        hand_curvature=other,
        torsional_stiffness=problem.friction.torsion**2 * normal,
        joint_preload=preload_slope(hand, contacts, q, forces_o, depth=depth),
    )


def _curvatures(solution: ForceSolution) -> tuple[Array, Array]:
    """Of the object and of the links at the contacts (k,) [1/m]."""
    contacts, body = solution.problem.contacts, solution.problem.object
    links = [contact.link for contact in contacts]
    round_ = np.array([links.count(link) == 1 for link in links])
    if body is not None:
        round_ &= ~on_edges(body, contacts)
    own, other = np.full(len(links), np.inf), np.zeros(len(links))
    if not round_.any():
        return own, other
    other[round_], own[round_] = 1.0 / _FINGERTIP, 0.0
    if body is not None:
        with suppress(InvalidInput):  # an edge too near for a curvature
            own[round_] = body.curvature(contacts.points_o[round_])[0].mean(axis=1)
    # In a hollow that is narrower than the link the two touch at more than a point: flat on flat.
    narrow = own + other <= 0
    own[narrow], other[narrow] = np.inf, 0.0
    return own, other


def instability(hand: HandModel, solution: ForceSolution, q: Array, servo: float = SERVO) -> str | None:
    """How the object would leave by itself, in words; None where servos of ``servo`` [N m/rad] keep it."""
    held = stiffness_of(hand, solution, q, servo)
    if held.is_stable():
        return None
    if held.margin >= 0:
        return f"the equilibrium is unstable: with servos of {servo:g} N m/rad the fingers give way by themselves"
    motion = held.weakest
    turn, way = np.linalg.norm(motion[3:]) * held.moment_length, np.linalg.norm(motion[:3])
    part, does = (motion[3:], "turns about") if turn > way else (motion[:3], "moves along")
    axis = ", ".join(f"{value:.2f}" for value in part / np.linalg.norm(part))
    return (
        f"the equilibrium is unstable: with servos of {servo:g} N m/rad the object {does} ({axis}) by itself; squeeze "
        "less, or touch it farther apart"
    )
