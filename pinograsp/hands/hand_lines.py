"""A hand in words: its fingers, joints, limits, masses and drives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pinograsp.hands.drives import SERVO, SLIDING_SERVO, Drive, Spring
from pinograsp.hands.reach import measure_reach
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
                f"motors can produce {most[joint]:g} {unit} at {joint}, more than its effort limit of {effort:g} "
                f"{unit}, which plans respect"
            )
    return found


def _describe_drives(
    drives: Sequence[Drive], springs: Sequence[Spring], slides: Sequence[bool], each: bool
) -> list[str]:
    """Lines about drives, where their figures come from, and springs.

    ``slides``: which springs are at sliding joints; ``each``: a drive at each joint.
    """
    plain = each and all(set(drive.arms) == {1.0} and drive.figures <= {"limit"} for drive in drives)
    controls = {drive.control for drive in drives}
    lines = [f"  drives: {len(drives)}"]
    if plain and len(controls) == 1:
        lines = [f"  drives: {len(drives)}, one at each joint ({controls.pop()})"]
    else:
        for drive in drives:
            limit = f"{drive.limit:g}" if np.isfinite(drive.limit) else "not given"
            if drive.efforts is not None:
                limit = f"{drive.efforts[0]:g} to {drive.efforts[1]:g}"
            others = (
                ("stiffness", drive.stiffness),
                ("damping", drive.damping),
                ("encoder step", drive.step),
                ("floor", drive.floor or None),
                ("continuous", drive.continuous),
                ("effort step", drive.effort_step),
                ("backlash", drive.backlash),
                ("friction", drive.friction),
                ("latency [s]", drive.latency),
            )
            known = "".join(f", {name} {value:.4g}" for name, value in others if value is not None)
            lines.append(f"    {drive}, limit {limit}{known}")
            if drive.closing is not None:
                lines.append(f"      closing on a stop: {drive.closing}")
            if drive.contact_stiffness is not None:
                low, high = drive.contact_stiffness
                lines.append(f"      contacts of its fingers: {low:.3g} to {high:.3g} times as stiff as planned")
    lines += [f"    {source}" for source in unlike(drive.sources for drive in drives)]
    if any(drive.stiffness is None for drive in drives):
        lines.append(
            f"    stiffness if none is given: a guess, {SERVO:g} N m/rad ({SLIDING_SERVO:.3g} N/m of jaws that slide)"
        )
    for spring, sliding in zip(springs, slides):
        stiff, at = ("N/m", "m") if sliding else ("N m/rad", "rad")
        lines.append(f"  spring at {spring.joint}: {spring.stiffness:g} {stiff}, at rest at {spring.rest:g} {at}")
    return lines


def describe_hand(hand: Any) -> list[str]:
    """Lines on fingers, joints, links, limits, masses, drives and notes of a ``HandModel``.

    By these it describes itself, so that its type is not known here.
    """
    model = hand.model
    coupled = model.njoints - 1 - hand.n
    joints = f"{hand.n} joint{'s' * (hand.n != 1)}"
    if coupled:
        joints += f" that move{'s' * (hand.n == 1)} {coupled} more"
    fingers = f"{len(hand.fingers)} finger{'s' * (len(hand.fingers) != 1)}"
    lines = [f"hand {hand.name}: {joints}, {fingers} on '{hand.palm}', {hand.mass:.3f} kg ({hand.source})"]
    for finger in hand.fingers:
        lines.append(f"  {finger.name}: {1e3 * hand.finger_mass(finger.name):.1f} g, tip '{finger.tip}'")
        lines += [
            f"    {joint} -> {link}: {_describe_bounds(hand, j)}"
            for joint, link, j in zip(finger.joints, finger.links, finger.joint_ids)
        ]
    on_fingers = {j for finger in hand.fingers for j in finger.joint_ids}
    if others := [j for j in range(1, model.njoints) if j not in on_fingers]:
        lines.append("  joints on no finger:")
        stays = {name: f", stays at {value:+.3f}" for name, value in hand.posture.items()}
        lines += [
            f"    {name}: {_describe_bounds(hand, j)}{stays.get(name, '')}" for j in others if (name := model.names[j])
        ]
    if (reach := measure_reach(hand)) is not None:
        first = hand.joint_names[hand.arm[0]]
        lines.append(f"  arm: {len(hand.arm)} joints, moves the palm up to {reach:.2f} m from '{first}'")
    listed = [name for finger in hand.fingers for name in finger.joints if name in hand.joint_names]
    if listed != [name for name in hand.joint_names if name in listed]:
        lines.append(f"  order of q: {', '.join(hand.joint_names)}")
    slides = [hand.is_prismatic(model.getJointId(spring.joint)) for spring in hand.springs]
    lines += _describe_drives(hand.drives, hand.springs, slides, hand.direct_drive and hand.n > 1)
    return [*lines, *(f"  note: {note}" for note in hand.notes)]


def _describe_bounds(hand: Any, joint_id: int) -> str:
    """Limits of a joint with their units, or what it follows."""
    model, i = hand.model, hand.model.joints[joint_id].idx_v
    if coupling := hand.couplings.get(model.names[joint_id]):
        return f"follows {coupling}"
    length, force = ("m", "N") if hand.is_prismatic(joint_id) else ("rad", "N m")
    effort = f"{model.effortLimit[i]:g} {force}" if model.effortLimit[i] else "not given"
    return f"{model.lowerPositionLimit[i]:+.3f} .. {model.upperPositionLimit[i]:+.3f} {length}, effort {effort}"
