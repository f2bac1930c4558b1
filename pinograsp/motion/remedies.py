"""What keeps joints and contact points off their way, and what helps, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pinograsp.contacts import Contact
from pinograsp.forces import ForceProblem
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.grasp_ik import FingerMotion
from pinograsp.motion.letting_go import LetGo
from pinograsp.spatial import Array

_SHIFTED = 1e-4  # [m] of the object as it is let go: worth a note
_ANOTHER_FORCE = 0.1  # share of a force by which it may come otherwise without a note
_HARDLY = 1e-4  # [m] per radian: joints that move contacts less than this do not move them


def explain_miss(
    finger: Finger,
    contacts: Sequence[Contact],
    motion: FingerMotion,
    stopped: Sequence[str],
    closed: bool,
    step: float,
) -> str:
    """What keeps contact points from their paths, and what helps."""
    missed = f"{finger.name} misses its path by {1e3 * motion.errors.max():.2g} mm"
    if stopped:
        return f"{missed}: {'; '.join(stopped)}: widen the limit, or choose another contact posture"
    J = motion.jacobians[0][:, :3]
    # A closed finger follows the depths before anything else.
    rows = np.einsum("cx,cxn->cn", [one.normal_o for one in contacts], J) if closed else J.reshape(-1, J.shape[2])
    asked, ways = len(rows), int(np.sum(np.linalg.svd(rows, compute_uv=False) > _HARDLY))
    moves = f"{missed}: its contacts need {asked} independent {'depths' if closed else 'displacements'}"
    if finger.n < asked:
        coupled = f" (the others of its {len(finger.joints)} follow)" if finger.coupled else ""
        return (
            f"{moves}, but its only actuated joints are {', '.join(finger.actuated)}{coupled}: the motion is the "
            "closest possible; for a closer one, plan fewer contacts on it, or forces that press them alike"
        )
    if ways < asked:
        return f"{moves}, but its joints can produce {ways} in the posture at impact: choose another contact posture"
    if motion.surfaces:
        return (
            f"{missed}: an edge or another part of its link is in the way: place the hand differently, or press less "
            "deep (max_depth)"
        )
    return f"{missed}: its joints could follow: use a smaller time step than {step:g} s"


def name_limit(hand: HandModel, joint: str, value: float) -> str:
    """The limit of a joint that is nearest to a position, with its unit."""
    at = hand.joint_names.index(joint)
    limits = (float(hand.lower[at]), float(hand.upper[at]))
    return name_displacement(hand, joint, min(limits, key=lambda limit: abs(limit - value)))


def name_displacement(hand: HandModel, joint: str, value: float) -> str:
    """A joint's displacement with its unit."""
    slides = hand.is_prismatic(hand.model.getJointId(joint))
    return f"{1e3 * value:.2f} mm" if slides else f"{math.degrees(value):.2f} deg"


def find_outside_limits(hand: HandModel, finger: Finger, q: Array) -> list[tuple[str, float]]:
    """Joints of the finger that leave their limits along q (m, n_f), and by how much [rad]."""
    beyond = np.maximum(hand.lower[finger.dofs] - q, q - hand.upper[finger.dofs]).max(axis=0)
    return [(joint, float(by)) for joint, by in zip(finger.actuated, beyond) if by > 1e-6]


def note_rest(problem: ForceProblem, final_depth: Array, rest: LetGo) -> list[str]:
    """How the object comes to rest as it is let go by a hand that presses to ``final_depth`` (k,) [m], where that is
    worth a note.
    """
    if not rest.balanced:
        return [
            "where the object comes to rest after it is let go could not be predicted, because friction is nearly "
            "used up then: simulate the plan"
        ]
    notes, size = list[str](), float(np.linalg.norm(rest.shift[:3]))
    if size > _SHIFTED:
        notes.append(f"the object shifts by {1e3 * size:.2g} mm when it is let go, and the joints compensate for this")
    others = [
        f"{name} {force:.2g} N (planned {planned:.2g} N)"
        for name, force, planned in zip(
            problem.contacts.names, rest.normal, problem.compliance.normal_force(final_depth)
        )
        if abs(force - planned) > _ANOTHER_FORCE * planned
    ]
    if others:
        notes.append(f"friction that builds up while the hand presses changes the forces: {', '.join(others)}")
    return notes
