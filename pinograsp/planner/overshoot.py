"""Caps of contacts that hold for what fingers press with when they close, not for what they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem
from pinograsp.handover.jaws import group_contacts
from pinograsp.handover.registers import press_of_drives
from pinograsp.hands import HandModel
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.drives import Drive


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
    early, late = problem.impact_time_range
    latest = problem.final_time - least
    if late <= latest:
        return problem
    if latest <= 0.0:
        raise InvalidInput(
            f"final time: expected more than {least:.3g} s, for which fingers press that touch gently enough for their "
            f"drives' latency, got {problem.final_time:g} s"
        )
    return replace(problem, impact_time_range=(min(early, latest), latest))


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
            f"the squeeze takes {least:.3g} s or more, so that a finger that is to stop where it touches goes on for "
            "its drive's latency and stays under its cap"
        )
    for finger in _closing_fingers(hand, problem):
        cap = float(problem.max_normal_force[finger.contacts].sum())
        if min(finger.table.peaks) <= cap <= max(finger.table.peaks):
            high = finger.table.find_command(cap).peak.high
            yield (
                f"drive {finger.drive.name} is asked for {cap:.3g} N at most: up to {high:.3g} N come of that in 95 % "
                "of its closings"
            )


def _closing_fingers(hand: HandModel, problem: ForceProblem) -> Iterator[_Finger]:
    parts = group_contacts(hand, [contact.link for contact in problem.contacts])
    for drive in hand.drives:
        if drive.closing is None or drive.closing.unit != "N":
            continue
        for finger in hand.fingers:
            if parts.get(finger.name) and set(finger.actuated) & set(drive.joints):
                yield _Finger(drive, drive.closing, parts[finger.name])
