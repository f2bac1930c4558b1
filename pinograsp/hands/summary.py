"""Hands as plain data: one of them in full, and the catalogue as a table."""

from __future__ import annotations

from typing import Any

from pinograsp.errors import ExtraMissing, HandNotLoaded
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.hands.drive_records import drive_record
from pinograsp.hands.libraries import LIBRARIES, list_library
from pinograsp.hands.load import load_hand
from pinograsp.hands.model import HandModel
from pinograsp.hands.reach import measure_reach
from pinograsp.processes import count_few, forked_results


def record(hand: HandModel) -> dict[str, Any]:
    """Joints with limits and units, couplings, drives, fingers, masses and notes of a hand: numbers and texts only."""
    joints = []
    for i, name in enumerate(hand.joint_names):
        slides = hand.is_prismatic(hand.model.getJointId(name))
        joints.append(
            {
                "name": name,
                "type": "prismatic" if slides else "revolute",
                "unit": "m" if slides else "rad",
                "lower": float(hand.lower[i]),
                "upper": float(hand.upper[i]),
                "effort_unit": "N" if slides else "N m",
                "effort": float(hand.effort[i]) or None,
                "velocity": float(hand.velocity[i]) or None,
            }
        )
    return {
        "name": hand.name,
        "source": hand.source,
        "palm": hand.palm,
        "mass_kg": hand.mass,
        "joints": joints,
        "coupled": [
            {"name": name, "follows": one.followed, "multiplier": one.factor, "offset": one.offset}
            for name, one in hand.couplings.items()
        ],
        "arm": {"joints": [hand.joint_names[i] for i in hand.arm], "reach_m": measure_reach(hand)},
        "drives": [drive_record(drive) for drive in hand.drives],
        "passive_joints": list(hand.passive_joints),
        "springs": [{"joint": one.joint, "stiffness": one.stiffness, "rest": one.rest} for one in hand.springs],
        "fingers": [
            {
                "name": finger.name,
                "tip": finger.tip,
                "joints": list(finger.joints),
                "links": list(finger.links),
                "actuated": list(finger.actuated),
                "mass_kg": hand.finger_mass(finger.name),
            }
            for finger in hand.fingers
        ],
        "notes": list(hand.notes),
    }


def overview() -> tuple[list[dict[str, Any]], list[str]]:
    """One row per hand of the catalogue, and the problems of those that cannot be loaded."""
    names = [(name,) for name in CATALOGUE]
    with forked_results(_row, names, count_few()) as found:
        rows = list(found)
    return [row for row in rows if isinstance(row, dict)], [row for row in rows if isinstance(row, str)]


def _row(name: str) -> dict[str, Any] | str:
    """A hand of the catalogue; where it cannot be loaded, why: a missing one does not hide the others."""
    try:
        hand = load_hand(name)
    except HandNotLoaded as error:
        return str(error)
    return {
        "name": name,
        "title": CATALOGUE[name].title,
        "actuated_joints": hand.n,
        "moving_joints": hand.n + len(hand.couplings),
        "mass_kg": round(hand.mass, 6),
        "fingers": [finger.name for finger in hand.fingers],
        "effort": _effort_ranges(hand),
    }


def library_names() -> dict[str, list[str] | None]:
    """Names of hands and grippers by library, as ``load_hand`` takes them; None: its package is not installed."""
    names: dict[str, list[str] | None] = {}
    for library in LIBRARIES:
        try:
            names[library] = [f"{library}:{name}" for name in list_library(library)]
        except ExtraMissing:
            names[library] = None
    return names


def _effort_ranges(hand: HandModel) -> dict[str, list[float]]:
    """Least and largest effort limit by unit; joints without one are left out."""
    ranges: dict[str, list[float]] = {}
    for joint, effort in zip(hand.joint_names, hand.effort.tolist()):
        if effort:
            unit = "N" if hand.is_prismatic(hand.model.getJointId(joint)) else "N m"
            low, high = ranges.get(unit, (effort, effort))
            ranges[unit] = [min(low, effort), max(high, effort)]
    return ranges


def cells(row: dict[str, Any]) -> list[str]:
    """A row of the overview as text: name, title, joints, moving joints, mass [kg], fingers, effort limits."""
    efforts = [
        f"{low:g} {unit}" if low == high else f"{low:g} to {high:g} {unit}"
        for unit, (low, high) in row["effort"].items()
    ]
    return [
        row["name"],
        row["title"],
        str(row["actuated_joints"]),
        str(row["moving_joints"]),
        f"{row['mass_kg']:.3f}",
        ", ".join(row["fingers"]),
        ", ".join(efforts) or "none",
    ]
