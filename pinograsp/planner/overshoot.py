"""Caps of contacts that hold for what fingers press with when they close, not for what they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, Reserve
from pinograsp.handover.jaws import group_contacts
from pinograsp.handover.registers import press_of_drives
from pinograsp.hands import HandModel
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.drives import Drive
from pinograsp.plan import Motion

# A finger's blow may take that share of its contacts' caps: the rest is for what its drives press with meanwhile. Where
# the reserve names no stiffer contacts, it is reckoned on ones that many times as stiff as planned: steel for rubber.
_BLOW, _STIFFEST = 0.5, 20.0
# The squeeze is made longer up to that many times: a slower one lets an object drop that nothing else holds.
_LONGEST = 2.0


class _Finger(NamedTuple):
    """A finger whose drive has a closing table in newtons, and its contacts."""

    drive: Drive
    table: ClosingTable
    contacts: list[int]


def lower_caps(hand: HandModel, problem: ForceProblem) -> ForceProblem:
    """The problem with caps on normal forces that fingers keep when they close, by the tables of their drives.

    A finger that is asked for a force comes to more in some of its closings: it is asked for no more than what keeps
    the sum of its contacts' caps in 95 % of them.

    Raises:
        InvalidInput: a cap under what the gentlest closing of a finger comes to.
    """
    if problem.max_normal_force is None:
        return problem
    caps = np.array(problem.max_normal_force)
    for finger in _closing_fingers(hand, problem):
        cap = float(caps[finger.contacts].sum())
        if cap >= max(finger.table.high):
            continue
        try:
            kept = finger.table.find_strongest(cap).peak.value
        except InvalidInput as error:
            raise InvalidInput(f"largest normal force: drive {finger.drive.name}: {error}") from None
        caps[finger.contacts] *= min(1.0, kept / cap)
    return problem if np.array_equal(caps, problem.max_normal_force) else replace(problem, max_normal_force=caps)


def slow_squeeze(hand: HandModel, problem: ForceProblem) -> ForceProblem:
    """The problem with impact times at which fingers touch slowly enough for their caps.

    A finger that is to stop where it touches goes on for the latency of its drive, at the speed of the impact (Eq. 22),
    c delta_F / tau: delta_F is the final depth, tau = t_F - t_I, c that of the deceleration's shape (2 for the constant
    one). With tau at least c times the latency that is within delta_F, and so within the cap.

    Raises:
        InvalidInput: a final time that leaves no time for that.
    """
    least = _least_squeeze(hand, problem)
    if least >= problem.final_time:
        raise InvalidInput(
            f"final time: expected more than {least:.3g} s, so that fingers touch gently enough for their drives' "
            f"latency, got {problem.final_time:g} s"
        )
    return _squeeze_for(problem, least)


def soften_blow(hand: HandModel, problem: ForceProblem, motion: Motion, reserve: Reserve | None) -> ForceProblem:
    """The problem with impact times at which fingers whose drives are not as told keep their caps when they touch.

    Such a finger touches earlier or later than planned, and stops in a blow: the contact takes up its kinetic energy
    (the largest from shortly before t_I on). With half of the caps for the blow, on contacts as stiff as the reserve
    reckons with, speeds are to fall by the root of the ratio of the energies; they go as 1 / (t_F - t_I) (Eq. 22).
    """
    if problem.max_normal_force is None or reserve is None or not reserve.drive:
        return problem
    stiffer = reserve.stiffness_range[1]
    stiff = problem.compliance.scale(stiffer if stiffer > 1 else _STIFFEST)
    taken = stiff.energy(stiff.depth(_BLOW * problem.max_normal_force))
    touch, end = float(motion.times[motion.impact]), float(motion.times[-1])
    nearly = motion.times >= touch - (end - touch)
    inertia = hand.joint_inertia(motion.q[-1])
    over = 1.0
    for name, contacts in group_contacts(hand, [contact.link for contact in problem.contacts]).items():
        if (finger := next((one for one in hand.fingers if one.name == name), None)) is None:
            continue
        rates = motion.dq[np.ix_(nearly, finger.dofs)]
        energies = 0.5 * np.einsum("mi,ij,mj->m", rates, inertia[np.ix_(finger.dofs, finger.dofs)], rates)
        over = max(over, float(energies.max() / taken[contacts].sum()))
    return _squeeze_for(problem, min(_LONGEST, over**0.5) * (end - touch) if over > 1 else 0.0)


def _squeeze_for(problem: ForceProblem, least: float) -> ForceProblem:
    """The problem with impact times ``least`` or more before t_F [s]."""
    early, late = problem.impact_time_range
    latest = problem.final_time - least
    return problem if late <= latest else replace(problem, impact_time_range=(min(early, latest), latest))


def _least_squeeze(hand: HandModel, problem: ForceProblem) -> float:
    """The least t_F - t_I [s] for the latency of drives that press under a cap; 0: none is known."""
    if problem.max_normal_force is None:
        return 0.0
    pressing = press_of_drives(hand, [contact.link for contact in problem.contacts], np.ones(problem.k))
    slowest = max((drive.latency or 0.0 for drive in hand.drives if pressing[drive.name] > 0), default=0.0)
    return slowest * problem.shape.speed_factor / problem.shape.depth_factor


def tell_caps(hand: HandModel, problem: ForceProblem) -> Iterator[str]:
    """What the caps of a problem of :func:`lower_caps` are, in words."""
    if problem.max_normal_force is None:
        return
    if (least := _least_squeeze(hand, problem)) > 0:
        yield (
            f"the squeeze takes {least:.3g} s or more, so that a finger that continues for its drive's latency after "
            "it touches stays under its cap"
        )
    for finger in _closing_fingers(hand, problem):
        cap = float(problem.max_normal_force[finger.contacts].sum())
        if min(finger.table.peaks) <= cap <= max(finger.table.peaks):
            high = finger.table.find_command(cap).peak.high
            yield (
                f"drive {finger.drive.name} is asked for {cap:.3g} N at most, and exerts up to {high:.3g} N then in 95 "
                "% of its closings"
            )


def _closing_fingers(hand: HandModel, problem: ForceProblem) -> Iterator[_Finger]:
    parts = group_contacts(hand, [contact.link for contact in problem.contacts])
    for drive in hand.drives:
        if drive.closing is None or drive.closing.unit != "N":
            continue
        for finger in hand.fingers:
            if parts.get(finger.name) and set(finger.actuated) & set(drive.joints):
                yield _Finger(drive, drive.closing, parts[finger.name])
