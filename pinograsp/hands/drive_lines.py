"""Drives in words: what a hand's description says of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pinograsp.hands.drives import SERVO, SLIDING_SERVO, Drive, Spring
from pinograsp.hands.sources import unlike
from pinograsp.spatial import Array


def beyond_effort(joints: Sequence[str], efforts: Array, slides: Sequence[bool], drives: Iterable[Drive]) -> list[str]:
    """In words, the joints (n) at which drives can do more than the joint's own effort limit (n,) allows."""
    most = dict.fromkeys(joints, 0.0)
    for drive in drives:
        for joint, arm in zip(drive.joints, drive.arms):
            most[joint] += abs(arm) * drive.limit
    found = []
    for joint, effort, sliding in zip(joints, efforts, slides):
        unit = "N" if sliding else "N m"
        if np.isfinite(most[joint]) and most[joint] > effort * (1 + 1e-9):
            found.append(
                f"motors can do {most[joint]:g} {unit} at {joint}, more than its effort limit of {effort:g} {unit}, "
                "which plans keep"
            )
    return found


def lines_on_drives(
    drives: Sequence[Drive], springs: Sequence[Spring], slides: Sequence[bool], each: bool
) -> list[str]:
    """Lines about drives, where their figures come from, and springs.

    ``slides``: which springs are at sliding joints; ``each``: a drive at each joint.
    """
    plain = each and all(set(drive.arms) == {1.0} and drive.stiffness is None for drive in drives)
    controls = {drive.control for drive in drives}
    lines = [f"  drives: {len(drives)}"]
    if plain and len(controls) == 1:
        lines = [f"  drives: {len(drives)}, one at each joint ({controls.pop()})"]
    else:
        for drive in drives:
            limit = f"{drive.limit:g}" if np.isfinite(drive.limit) else "not given"
            if drive.efforts is not None:
                limit = f"{drive.efforts[0]:g} to {drive.efforts[1]:g}"
            others = (("stiffness", drive.stiffness), ("damping", drive.damping), ("encoder step", drive.step))
            known = "".join(f", {name} {value:.4g}" for name, value in others if value is not None)
            lines.append(f"    {drive}, limit {limit}{known}")
    lines += [f"    {source}" for source in unlike(drive.sources for drive in drives)]
    if any(drive.stiffness is None for drive in drives):
        lines.append(
            f"    stiffness where none is told: a guess, {SERVO:g} N m/rad ({SLIDING_SERVO:.3g} N/m of jaws that slide)"
        )
    for spring, sliding in zip(springs, slides):
        stiff, at = ("N/m", "m") if sliding else ("N m/rad", "rad")
        lines.append(f"  spring at {spring.joint}: {spring.stiffness:g} {stiff}, at rest at {spring.rest:g} {at}")
    return lines
