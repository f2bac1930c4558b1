"""Effort limits of joints, of more than a description says of each by itself: known motors, jaws that move at once, and
what no hand makes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from pinograsp.hands.drives import Drive
from pinograsp.hands.model import Finger, HandModel
from pinograsp.spatial import Array, BoolArray
from pinograsp.words import few, printable

# Of the force at a fingertip [N]: adaptive grippers press with up to 235 N, the weakest hands with 3 N.
_LEAST, _MOST = 1.5, 500.0
_HEAVIEST = 50.0  # [kg] at a fingertip: geared motors of grippers are as a few
_NAMED = 4
PLACEHOLDERS = "effort limits that look like placeholders"  # how such a note begins


def with_effort_limits(hand: HandModel, efforts: Mapping[str, float], drives: Iterable[Drive]) -> HandModel:
    """The same hand with effort limits that count known motors, and all jaws that a joint moves; these are noted.

    Where the limits of a joint's motors are known, what they can do is the limit. Else the description limits the
    effort of each joint by itself: where the first joint of a finger moves the first joints of others, as in a gripper
    with two jaws, its torque in a plan is that of all of them, tau = sum |factor_j| tau_j. Jaws press with equal forces
    on what they hold, so that the weakest ends it: tau <= min(limits) sum |factor_j|. Joints farther out on the same
    finger only transmit; jaws without a limit of their own count nothing.

    Args:
        hand: with the limits of its independent joints alone.
        efforts: the joints' own limits as the description has them, coupled ones included [N m or N]; 0: none.
        drives: known motors.
    """
    limits, notes = hand.effort.copy(), list(hand.notes)
    for i, joint in enumerate(hand.joint_names):
        made = [arm * drive.limit for drive in drives for name, arm in zip(drive.joints, drive.arms) if name == joint]
        most, jaws = float(np.abs(made).sum()), _jaws(hand, joint, efforts)
        if made and np.isfinite(most):
            limits[i] = most
        elif len(jaws) > 1:
            each, unit = min(efforts[jaw] for jaw in jaws), "N" if hand.slides[i] else "N m"
            limits[i] = each * sum(jaws.values())
            notes.append(
                f"effort limit of {joint}: {each:g} {unit} at each of the {len(jaws)} jaws that it moves, "
                f"{limits[i]:g} {unit} together"
            )
    model = hand.model.copy()
    model.effortLimit = limits
    return replace(hand, model=model, notes=tuple(notes))


def placeholder_notes(hand: HandModel) -> list[str]:
    """Notes on effort limits that no hand has, by the force at a fingertip that they make; and on inertias of motors,
    by the mass there.
    """
    arms, notes = _arms(hand), list[str]()
    heavy = [
        f"{printable(joint, 60)} {own:.3g} {'kg' if sliding else 'kg m^2'} (as {own / arm**2:.2g} kg at a fingertip)"
        for joint, own, arm, sliding in zip(hand.joint_names, np.ravel(hand.model.armature), arms, hand.slides)
        if arm > 0 and own > _HEAVIEST * arm**2
    ]
    if heavy:
        notes.append(
            f"motors' inertias (armature) that look like placeholders: {few(heavy, _NAMED)}; plans and simulations use "
            "them nevertheless: correct the file"
        )
    odd = [
        f"{printable(joint, 60)} {effort:g} {'N' if sliding else 'N m'} ({effort / arm:.2g} N at a fingertip)"
        for joint, effort, arm, sliding, is_one in zip(
            hand.joint_names, hand.effort, arms, hand.slides, _are_placeholders(hand, arms)
        )
        if is_one
    ]
    if odd:
        notes.append(
            f"{PLACEHOLDERS}: {few(odd, _NAMED)}; plans respect them: correct the file, or give the torques of the "
            "motors, GraspConditions(torque_limit=...), --torque-limit"
        )
    return notes


def find_placeholders(hand: HandModel) -> BoolArray:
    """Which joints have an effort limit that no hand has (n,): too little or too much force at a fingertip; limits of
    known motors are none.
    """
    return _are_placeholders(hand, _arms(hand))


def _are_placeholders(hand: HandModel, arms: Array) -> BoolArray:
    known = {name for drive in hand.drives if (one := drive.source("limit")) and not one.guess for name in drive.joints}
    force = np.divide(hand.effort, arms, out=np.full(hand.n, _LEAST), where=(arms > 0) & (hand.effort > 0))
    odd: BoolArray = ((force < _LEAST) | (force > _MOST)) & ~np.isin(hand.joint_names, sorted(known))
    return odd


def _arms(hand: HandModel) -> Array:
    """Effort per newton at a fingertip (n,) [m; 1 where joints slide]; 0 of joints of no finger."""
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, (hand.lower + hand.upper) / 2)
    arms = np.zeros(hand.n)
    for finger in hand.fingers:
        for i in finger.dofs:
            first = next(j for j in finger.joint_ids if hand.model.joints[j].idx_v == i)
            arms[i] += abs(hand.ratio(first)) * (1.0 if hand.slides[i] else _reach(hand, data, finger, first))
    return arms


def _reach(hand: HandModel, data: pin.Data, finger: Finger, joint: int) -> float:
    """Distance of a finger's farthest point from one of its joints, at most [m]."""
    origin, beyond = data.oMi[joint].translation, finger.joint_ids[finger.joint_ids.index(joint) :]
    reach = 0.0
    for one in hand.geometry.geometryObjects:
        if one.parentJoint in beyond:
            one.geometry.computeLocalAABB()
            centre = data.oMi[one.parentJoint].act(one.placement.act(np.array(one.geometry.aabb_center)))
            reach = max(reach, float(np.linalg.norm(centre - origin)) + float(one.geometry.aabb_radius))
    return reach


def _jaws(hand: HandModel, joint: str, efforts: Mapping[str, float]) -> dict[str, float]:
    """First joints of fingers that ``joint``, itself one, moves, with the size of their factors: those with limits."""
    first = {finger.joints[0] for finger in hand.fingers if efforts.get(finger.joints[0], 0.0) > 0}
    if joint not in first:
        return {}
    moved = {name: one for name, one in hand.couplings.items() if name in first and one.followed == joint}
    return {joint: 1.0, **{name: abs(one.factor) for name, one in moved.items()}}
