"""What the motors of a hand can do, against what a plan asks of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pinograsp.forces import ForceSolution
from pinograsp.handover.registers import press_of_drives
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import SHORTFALL, below_steps, exceed_ways, solve_efforts
from pinograsp.hands.servos import unknown_stiffness
from pinograsp.motion.torques import beyond_limits, drives_limit
from pinograsp.plan import Motion
from pinograsp.spatial import Array

_ROUNDING = 1e-3  # forces lie on their limits
_LABOURS = 0.9  # share of a torque limit: worth a warning
# Of a limit that is a guess: those that could be compared with a maker's figure were 1.4 to 21 times too large.
_GUESSED = 0.5
_BEARS = 1e-6  # share of the largest effort


def drive_cautions(hand: HandModel, solution: ForceSolution, motion: Motion) -> Iterator[str]:
    """Torques that the motors cannot make, efforts and speeds beyond limits or near those that are guesses, drives that
    cannot press so gently, servos that are sent less than they resolve.
    """
    q, torques = np.vstack([motion.q, motion.q[-1:]]), np.vstack([motion.torques, motion.holding_torques])
    efforts, holding = solve_efforts(hand, q, torques), solve_efforts(hand, q[-1:], torques[-1:])
    for where, needed, then in (
        ("", holding, "; joints and forces settle at other values"),
        (" on the way", efforts, ""),
    ):
        if needed.shortfall > SHORTFALL:
            worst = int(needed.undone.argmax())
            yield (
                f"the {hand.n} joints have {len(hand.drives)} motors between them, which cannot produce these "
                f"torques{where}: {hand.joint_names[worst]} lacks {needed.undone[worst]:.2g} {_unit(hand, worst)}, "
                f"{100 * needed.shortfall:.3g} % of the largest torque{then}"
            )
            break
    held = np.abs(efforts.drives[-1])
    for drive, effort, peak in zip(hand.drives, held, np.abs(efforts.drives).max(axis=0)):
        if effort > drive.limit * (1 + _ROUNDING):
            yield f"drive {drive.name} holds with {effort:.3g}, more than its limit of {drive.limit:.3g}"
        elif peak > drive.limit * (1 + _ROUNDING):
            yield f"drive {drive.name} needs up to {peak:.3g} on the way, more than its limit of {drive.limit:.3g}"
        elif drive.continuous is not None and effort > drive.continuous * (1 + _ROUNDING):
            yield (
                f"drive {drive.name} holds with {effort:.3g}, more than its continuous effort of "
                f"{drive.continuous:.3g}: it overheats, or gives way"
            )
    for drive, effort in zip(hand.drives, held):
        if _BEARS * held.max() < effort < drive.floor * (1 - _ROUNDING):
            yield (
                f"drive {drive.name} presses with {drive.floor:.3g} at least, but the plan needs {effort:.3g}: its "
                f"contacts get {drive.floor / effort:.2g} times these forces; plan for more (a larger reserve), or use "
                "a gentler hand if the object is fragile"
            )
    contacts = solution.problem.contacts
    pressing = press_of_drives(hand, [contact.link for contact in contacts], solution.normal_forces)
    for drive in hand.drives:
        least, force = 0.0 if drive.closing is None else min(drive.closing.peaks), pressing[drive.name]
        if drive.closing is not None and drive.closing.unit == "N" and 0 < force < least * (1 - _ROUNDING):
            yield (
                f"drive {drive.name} closes with {least:.3g} N at least, but the plan needs {force:.3g} N of its "
                f"finger, which exerts {least / force:.2g} times as much; plan for more (a larger reserve), or use a "
                "gentler hand if the object is fragile"
            )
    stiffness = [drive.stiffness if drive.control == "position" else None for drive in hand.drives]
    yield from below_steps(hand, held, np.array(stiffness, dtype=float))
    yield from _too_fast(hand, motion)
    yield from _near_limits(hand, solution, motion, torques)


def find_wrong_way(hand: HandModel, motion: Motion) -> str:
    """In words, the drive that would have to hold with an effort that it can make the other way only; "": none."""
    q, torques = motion.q[-1:], motion.holding_torques[None]
    for i in np.flatnonzero(exceed_ways(hand, q, torques)[0]).tolist():
        drive, effort = hand.drives[i], solve_efforts(hand, q, torques).drives[0, i]
        if drive.efforts is not None:
            least, most = drive.efforts
            return (
                f"drive {drive.name} would have to hold with {effort:.3g}, but produces {least:g} to {most:g}: if it "
                "can do more than its description says, give drives=[Drive(...)]"
            )
    return ""


def drive_notes(hand: HandModel, motion: Motion) -> list[str]:
    """Guesses that a plan rests on: limits of motors that hold, and the stiffness of servos."""
    held = np.abs(solve_efforts(hand, motion.q[-1:], motion.holding_torques[None]).drives[0])
    guesses: dict[str, list[str]] = {}
    for drive, effort in zip(hand.drives, held):
        source = drive.source("limit")
        if source is not None and source.guess and effort > _BEARS * held.max():
            guesses.setdefault(source.text, []).append(drive.name)
    notes = [f"the limit of {', '.join(names)} is a guess: {text}" for text, names in guesses.items()]
    assumed = unknown_stiffness(hand)
    return notes if assumed is None else [*notes, assumed]


def measure_speeds(hand: HandModel, motion: Motion) -> Array:
    """The largest speed of each joint, over its limit (n,) [-]."""
    return np.asarray(np.abs(motion.dq).max(axis=0) / hand.speed_limits)


def _too_fast(hand: HandModel, motion: Motion) -> Iterator[str]:
    """Joints that move faster than they can."""
    limit, peak = hand.speed_limits, np.abs(motion.dq).max(axis=0)
    ratio = measure_speeds(hand, motion)
    worst, more = int(ratio.argmax()), int((ratio > 1 + _ROUNDING).sum()) - 1
    if more >= 0:
        unit = "m/s" if hand.slides[worst] else "rad/s"
        early = np.abs(motion.dq[: motion.impact + 1, worst]).max() == peak[worst]
        when = "in the approach" if early else "while it presses"
        yield (
            f"{hand.joint_names[worst]} moves at up to {peak[worst]:.3g} {unit} {when}, {ratio[worst]:.3g} times its "
            f"speed limit of {limit[worst]:g} {unit}{f', and {more} more are too fast' if more else ''}: choose a "
            "nearer start, or give it more time (final_time, impact_time_range)"
        )


def _near_limits(hand: HandModel, solution: ForceSolution, motion: Motion, torques: Array) -> Iterator[str]:
    """Joints whose ``torques`` (m, n) pass their own limits, or that hold near those of the plan or near a guess."""
    own, held, beyond = drives_limit(hand), np.abs(motion.holding_torques), beyond_limits(hand, torques)
    planned = own if solution.problem.torques is None else solution.problem.torques.limit
    sources = ((drive.joints, drive.source("limit")) for drive in hand.drives)
    guessed = {joint for joints, source in sources if source is not None and source.guess for joint in joints}
    yield from beyond.values()
    for joint, torque, limit, most in zip(hand.joint_names, held, planned, own):
        if joint in beyond:
            continue
        if torque > _LABOURS * (1 + _ROUNDING) * limit:
            yield f"{joint} holds with {100 * torque / limit:.0f} % of its torque limit"
        elif joint in guessed and torque > _GUESSED * most:
            yield (
                f"{joint} holds with {100 * torque / most:.0f} % of a limit that is a guess and may be more than its "
                "motor produces"
            )


def _unit(hand: HandModel, joint: int) -> str:
    return "N" if hand.slides[joint] else "N m"
