"""Caps of contacts that hold for what fingers press with when they close, not for what they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem
from pinograsp.handover.jaws import group_contacts
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


def tell_caps(hand: HandModel, problem: ForceProblem) -> Iterator[str]:
    """What the caps of a problem of :func:`lower_caps` are, in words."""
    if problem.max_normal_force is None:
        return
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
