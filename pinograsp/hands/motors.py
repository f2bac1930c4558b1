"""Motors and springs as a file has them, and the drives of a hand that they make."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.hands.coupling import Coupling
from pinograsp.hands.drives import LARGEST_ARM, LEAST_ARM, ON_DRIVES, Control, Drive, Spring


@dataclass(slots=True, kw_only=True)
class Motor:
    """A motor as a file gives it: ``arms`` by joint, coupled ones and those outside of the hand included.

    ``remark``: what the user should know of it.
    """

    name: str
    arms: dict[str, float]
    control: Control = "torque"
    limit: float = math.inf
    efforts: tuple[float, float] | None = None
    stiffness: float | None = None
    damping: float | None = None
    remark: str = ""


@dataclass(slots=True, kw_only=True)
class Actuation:
    """Motors and springs of a file.

    Attributes:
        motors, springs: in the order of the file, at any of its joints.
        alone: coupled joints have one motor between them, even where the file names one at each.
        notes: for the user.
    """

    motors: list[Motor] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    alone: bool = False
    notes: list[str] = field(default_factory=list)


def motors_at(found: Actuation) -> dict[str, list[str]]:
    """Names of a file's motors, by the joints that they move."""
    names: dict[str, list[str]] = {}
    for motor in found.motors:
        for joint in motor.arms:
            names.setdefault(joint, []).append(motor.name)
    return names


def drives_of(
    found: Actuation, joints: Sequence[str], couplings: Mapping[str, Coupling], efforts: ArrayLike
) -> tuple[Drive, ...]:
    """Drives of the independent ``joints`` (n), from the motors of a file.

    Args:
        found: motors at any joint; those at none of the hand's are left out.
        joints: names of the independent joints.
        couplings: of the coupled joints.
        efforts: limits of the joints (n,) [N m or N], infinity where there are none; they bound a motor at one joint.
    """
    limits = dict(zip(joints, np.ravel(efforts).tolist()))
    motors = _one_per_group(found.motors, couplings) if found.alone else found.motors
    drives: list[Drive] = []
    taken: Counter[str] = Counter()
    for motor in motors:
        arms: dict[str, float] = {}
        for joint, arm in motor.arms.items():
            one = couplings.get(joint, Coupling(followed=joint, factor=1.0, offset=0.0))
            if one.followed in limits:
                arms[one.followed] = arms.get(one.followed, 0.0) + arm * one.factor
        arms = {joint: arm for joint, arm in arms.items() if LEAST_ARM <= abs(arm) <= LARGEST_ARM}
        if not arms:
            continue
        limit, ways = motor.limit, motor.efforts
        if len(arms) == 1:
            limit = min(limit, *(limits[joint] / abs(arm) for joint, arm in arms.items()))
        if ways is not None:
            ways = max(ways[0], -limit), min(ways[1], limit)
        name = motor.name
        while name in taken:
            taken[motor.name] += 1
            name = f"{motor.name} {taken[motor.name]}"
        taken[name] += 1
        drives.append(
            Drive(
                name=name,
                joints=tuple(arms),
                arms=tuple(arms.values()),
                control=motor.control,
                limit=limit if limit > 0 else math.inf,
                efforts=ways if limit > 0 else None,
                stiffness=motor.stiffness if motor.control == "position" else None,
                damping=motor.damping,
            )
        )
    return tuple(drives)


def _one_per_group(motors: list[Motor], couplings: Mapping[str, Coupling]) -> list[Motor]:
    """Of the motors at joints that move together, the one at the joint that the others follow, or else the first."""
    kept: dict[str, Motor] = {}
    for motor in motors:
        (joint,) = motor.arms
        leader = couplings[joint].followed if joint in couplings else joint
        if leader == joint or leader not in kept:
            kept[leader] = motor
    return list(kept.values())


def remarks_on(motors: Iterable[Motor], joints: Iterable[str]) -> list[str]:
    """Notes on those of a file's motors that move any of the hand's ``joints``."""
    own = set(joints)
    told: dict[str, list[str]] = {}
    for motor in motors:
        if motor.remark and not own.isdisjoint(motor.arms):
            told.setdefault(motor.remark, []).append(motor.name)
    return [f"{ON_DRIVES}{remark}: {', '.join(names)}" for remark, names in told.items()]


def on_joints(drives: Iterable[Drive], joints: Sequence[str], efforts: ArrayLike) -> tuple[Drive, ...]:
    """What the drives do at ``joints``; those without a limit do at none more than its effort limit (n,) [N m or N]."""
    limits = dict(zip(joints, np.ravel(efforts).tolist()))
    found = []
    for drive in drives:
        arms = {joint: arm for joint, arm in zip(drive.joints, drive.arms) if joint in limits}
        if arms:
            limit = min(limits[joint] / abs(arm) for joint, arm in arms.items())
            limit = drive.limit if drive.limit < math.inf else limit
            ways = drive.efforts if limit == drive.limit else None
            found.append(replace(drive, joints=tuple(arms), arms=tuple(arms.values()), limit=limit, efforts=ways))
    return tuple(found)


def springs_of(found: Actuation, joints: Sequence[str], couplings: Mapping[str, Coupling]) -> tuple[Spring, ...]:
    """Springs at the independent ``joints``, from those of a file at any joint: one spring for all that act on one."""
    sums: dict[str, tuple[float, float]] = {}  # stiffness, and its product with the position at rest
    for spring in found.springs:
        one = couplings.get(spring.joint, Coupling(followed=spring.joint, factor=1.0, offset=0.0))
        if one.followed in joints:
            # A joint at f q + o: the torque on q is -k f (f q + o - rest).
            stiffness, moment = sums.get(one.followed, (0.0, 0.0))
            own = spring.stiffness * one.factor
            sums[one.followed] = (stiffness + own * one.factor, moment + own * (spring.rest - one.offset))
    return tuple(
        Spring(joint=joint, stiffness=stiffness, rest=moment / stiffness)
        for joint, (stiffness, moment) in sums.items()
        if stiffness > 0
    )
