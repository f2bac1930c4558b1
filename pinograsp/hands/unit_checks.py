"""Limits and sizes of a hand that look as if they were in other units than metres, radians and seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinograsp.spatial import Array
from pinograsp.words import few, printable

# How notes on limits begin, so that those on others take their place.
ON_LIMITS = "units of limits: "
# Above those of real hands: two turns (motors of some turn 1.5 times, a few files have +-10 rad for no limit), 1 m, 60
# rad/s (the fastest joint of 170 robots) and 10 m/s. Nobody means what is far beyond: it stands for no limit.
_TURN, _SLIDE, _TURNING, _SLIDING = 4 * np.pi, 1.0, 60.0, 10.0
_NO_TURN, _NO_SLIDE = 720.0, 2000.0
_LONGEST, _BASE, _SHORTEST = 1.5, 10.0, 2e-3  # [m] of a link that moves, of what is fixed; of the largest that moves
_MOST_NAMED = 4


class _Unit(NamedTuple):
    """A unit that somebody may have taken, how much of the right one it is, and that."""

    taken: str
    factor: float
    right: str


_DEGREES, _MILLIMETRES = _Unit("degrees", np.pi / 180, "radians"), _Unit("millimetres", 1e-3, "metres")


def limit_notes(joints: Sequence[str], slides: Sequence[bool], lower: Array, upper: Array) -> list[str]:
    """Notes on position limits (n,) that look like degrees or millimetres, with those that they would be."""
    notes = []
    for unit, sliding, least, most in (
        (_DEGREES, False, _TURN, _NO_TURN),
        (_MILLIMETRES, True, _SLIDE, _NO_SLIDE),
    ):
        ends = {
            joint: (low, high)
            for joint, slide, low, high in zip(joints, slides, lower.tolist(), upper.tolist())
            if bool(slide) == sliding and least < max(abs(low), abs(high)) <= most
        }
        if ends:
            given = [f"{printable(joint, 60)} {low:g} .. {high:g}" for joint, (low, high) in ends.items()]
            joint, (low, high) = next(iter(ends.items()))
            notes.append(
                f"{ON_LIMITS}are these in {unit.taken}, {few(given, _MOST_NAMED)}? They are taken as {unit.right}; "
                f"if so, limits={{'{printable(joint, 60)}': ({low * unit.factor:.4g}, {high * unit.factor:.4g}), ...}} "
                "or other numbers in the file"
            )
    return notes


def speed_notes(joints: Sequence[str], slides: Sequence[bool], velocity: Array) -> list[str]:
    """Notes on speed limits (n,) that look like degrees or millimetres a second; powers of ten stand for no limit."""
    notes = []
    for unit, sliding, least in ((_DEGREES, False, _TURNING), (_MILLIMETRES, True, _SLIDING)):
        fast = [
            f"{printable(joint, 60)} {speed:g} ({speed * unit.factor:.4g})"
            for joint, slide, speed in zip(joints, slides, velocity.tolist())
            if bool(slide) == sliding and speed > least and np.log10(speed) % 1 > 1e-9
        ]
        if fast:
            notes.append(
                f"units of speed limits: are these in {unit.taken} a second, in brackets what they would be in "
                f"{unit.right}, {few(fast, _MOST_NAMED)}? They are taken as {unit.right}: if so, change the file"
            )
    return notes


def size_notes(model: pin.Model, geometry: pin.GeometryModel) -> list[str]:
    """Notes on links that are far longer than a finger's, and on fingers smaller than a grain of sand."""
    moving, fixed = dict[str, float](), dict[str, float]()
    for one in geometry.geometryObjects:
        one.geometry.computeLocalAABB()
        lengths, link = moving if one.parentJoint else fixed, model.frames[one.parentFrame].name
        lengths[link] = max(lengths.get(link, 0.0), 2 * float(one.geometry.aabb_radius))
    longest = max(moving.values(), default=_SHORTEST)
    for j in range(1, model.njoints):
        apart = float(np.linalg.norm(model.jointPlacements[j].translation))
        (moving if model.parents[j] else fixed)[f"origin of joint {model.names[j]}"] = apart
    long = [
        f"{printable(name, 80)} {length:.3g} m"
        for lengths, most in ((fixed, _BASE), (moving, _LONGEST))
        for name, length in lengths.items()
        if length > most
    ]
    if long:
        return [
            f"units of sizes: are these in millimetres or inches, {few(long, _MOST_NAMED)}? URDF's are in metres: if "
            "so, change <size>, <origin>, ... in the file, or give its meshes a scale"
        ]
    if longest < _SHORTEST:
        return [
            f"units of sizes: no moving link is longer than {1e3 * longest:.3g} mm: expected metres, was a scale "
            "applied twice?"
        ]
    return []
