"""Commands in the units of the drives' registers: steps of encoders, units of effort, speeds and limits of closings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from pinograsp.errors import InvalidInput
from pinograsp.handover.jaws import group_contacts, write_table
from pinograsp.handover.trajectory import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.hands.closing_table import ClosingCommand
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array
from pinograsp.words import no_formula

Units: TypeAlias = Literal["SI", "register"]

_STEPS = 2  # of a register: below, what comes is another force
_PRESSES = 1e-6  # share of the largest effort: less does not press


class FingerClosing(NamedTuple):
    """The command of a drive whose finger closes on the object up to a force limit.

    Attributes:
        drive: its name.
        force: planned force of the fingers that it moves [N].
        position: commanded position, that of the closed end [register units]; None: it is not known.
        command: closing speed, force limit and expected force, from the drive's closing table.
    """

    drive: str
    force: float
    position: float | None
    command: ClosingCommand


def closing_commands(plan: PlanRecord) -> tuple[FingerClosing, ...]:
    """Return speed and limit of each drive whose closing table is known and whose finger touches the object.

    The force of a finger is the sum of its contacts' normal forces, as if it pressed on a stop; that of a drive of
    several fingers, such as two jaws, is the largest of them.

    Raises:
        InvalidInput: no touching drive has a closing table in newtons; a force that it does not produce.
    """
    hand = plan.require_hand()
    forces = press_of_drives(hand, plan.contacts.links, plan.forces.normal_forces)
    found = []
    for drive in hand.drives:
        force = forces[drive.name]
        if drive.closing is None or force <= 0:
            continue
        if drive.closing.unit != "N":
            raise InvalidInput(
                f"drive {drive.name}: expected a closing table in newtons, got one in counts: press on a scale, and "
                "identify it with --newtons"
            )
        try:
            command = drive.closing.find_command(force)
            found.append(FingerClosing(drive.name, force, drive.closing.position, command))
        except InvalidInput as error:
            raise InvalidInput(
                f"drive {drive.name}: {error}: plan for more (a larger reserve), or leave its finger out (wishes)"
            ) from None
    if not found:
        raise InvalidInput(
            "units='register' with command='jaw': expected a drive with a closing table whose finger touches the "
            "object, got none: take a data sheet that has one, such as inspire_rh56, or identify it from logs"
        )
    return tuple(found)


def press_of_drives(hand: HandModel, links: Sequence[str], forces: Array) -> dict[str, float]:
    """By drive, the largest force of its fingers [N], from the normal forces (k,) of contacts on links."""
    parts = group_contacts(hand, links)
    return {
        drive.name: max(
            (
                float(forces[parts.get(finger.name, [])].sum())
                for finger in hand.fingers
                if set(finger.actuated) & set(drive.joints)
            ),
            default=0.0,
        )
        for drive in hand.drives
    }


def write_closings(closings: Sequence[FingerClosing], path: str | Path) -> None:
    """Write a line per drive: ``drive``, ``position`` of the closed end (empty where it is not known), ``speed``,
    ``limit`` [register units], ``force_N`` of the plan, and ``expected_N``, ``low_N``, ``high_N`` of the closing table.

    Raises:
        ResultsNotWritten: the place cannot be written.
    """
    rows = [
        [
            no_formula(one.drive),
            *("" if value is None else _tidy(value) for value in (one.position, one.command.speed, one.command.limit)),
            one.force,
            *one.command.peak,
        ]
        for one in closings
    ]
    write_table(path, ["drive", "position", "speed", "limit", "force_N", "expected_N", "low_N", "high_N"], rows)


def write_registers(plan: PlanRecord, drives: JointTrajectory, path: str | Path, *, efforts: bool) -> tuple[str, ...]:
    """Write a trajectory of drives in whole register units: ``time``, and by drive ``DRIVE/position`` [encoder steps
    from where its coordinate is zero] and ``DRIVE/effort`` [units of its effort register].

    Args:
        plan: the plan of the hand with these drives.
        drives: from :func:`~pinograsp.handover.drive_commands`.
        path: an existing file is replaced.
        efforts: whether efforts are commanded, in columns of their own; else only positions.

    Returns:
        Notes on rounding: one unit as a share of the drives' holding efforts, and in newtons at their fingers, and the
        drives that hold with less than two units.

    Raises:
        InvalidInput: drives whose encoder step, or whose effort step, is not known. ResultsNotWritten.
    """
    hand = plan.require_hand()
    wanted = {"step": [drive.step for drive in hand.drives]}
    if efforts:
        if not any(wanted["step"]):  # torques alone, then
            del wanted["step"]
        wanted["effort_step"] = [drive.effort_step for drive in hand.drives]
    for figure, values in wanted.items():
        if missing := [drive.name for drive, value in zip(hand.drives, values) if value is None]:
            raise InvalidInput(
                f"units='register': expected drives whose {figure} is known, got none for "
                f"{', '.join(missing[:4])}{' and more' if len(missing) > 4 else ''}: give a data sheet that has it, "
                "such as leap, or a file"
            )
    head, columns, notes = ["time"], [], list[str]()
    if "step" in wanted:
        head += [f"{no_formula(name)}/position" for name in drives.names]
        columns.append(np.rint(drives.q / np.array(wanted["step"], dtype=float)))
    if efforts:
        head += [f"{no_formula(name)}/effort" for name in drives.names]
        steps = np.array(wanted["effort_step"], dtype=float)
        columns.append(np.rint(drives.effort / steps))
        forces = press_of_drives(hand, plan.contacts.links, plan.forces.normal_forces)
        notes = _tell_rounding(hand, np.abs(drives.effort[-1]), steps, forces)
    whole = np.column_stack(columns).astype(int).tolist()
    write_table(path, head, [[time, *row] for time, row in zip(drives.times.tolist(), whole)])
    return tuple(notes)


def _tell_rounding(hand: HandModel, held: Array, steps: Array, forces: dict[str, float]) -> list[str]:
    """What a unit of the effort registers is of the efforts (m,) that drives hold with, and of their ``forces`` [N]."""
    presses = np.array([forces[drive.name] for drive in hand.drives])
    pressing = (held > _PRESSES * held.max()) & (presses > 0)
    if not pressing.any():
        return []
    share = 100 * steps[pressing] / held[pressing]
    worth = presses[pressing] * share / 100
    notes = [
        f"one unit of the effort registers is {share.min():.2g} to {share.max():.2g} % of the drives' holding efforts, "
        f"up to {worth.max():.2g} N of their fingers' forces"
    ]
    for i in np.flatnonzero(pressing & (held < _STEPS * steps)).tolist():
        drive = hand.drives[i].name
        notes.append(
            f"drive {drive} holds with {held[i] / steps[i]:.2g} units of its register: rounding changes its effort by "
            f"up to {50 * steps[i] / held[i]:.0f} %, and the {forces[drive]:.2g} N of its finger with it"
        )
    return notes


def _tidy(value: float) -> int | float:
    return round(value) if value == round(value) else float(f"{value:.6g}")
