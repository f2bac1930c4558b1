"""What the drives of a hand are to be sent so that a plan's forces come."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pinograsp.checks import at_least_zero, each_of, number, one_of, path_of
from pinograsp.errors import InvalidInput
from pinograsp.handover.actuators import Controls, write_keyframes
from pinograsp.handover.build import Sampling, joint_trajectory
from pinograsp.handover.trajectory import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import SHORTFALL, below_steps, solve_efforts
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array

if TYPE_CHECKING:
    from typing_extensions import Unpack

Command: TypeAlias = Literal["torque", "position", "impedance", "jaw"]
SERVO: tuple[Command, ...] = ("torque", "position", "impedance")
COMMANDS: tuple[Command, ...] = get_args(Command)

_SLACK = 1e-6  # relative to a limit, and [rad or m] beyond a range
_NOTHING = 1e-9  # of the largest torque: rounding


class Commanding(Sampling, total=False):
    """How a plan becomes commands: the keyword arguments of :func:`drive_commands`."""

    stiffness: ArrayLike | None
    damping: ArrayLike | None
    shortfall: float | None


def drive_commands(
    plan: PlanRecord,
    command: Command,
    *,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    shortfall: float | None = SHORTFALL,
    rate: float = 1000.0,
    start: ArrayLike | None = None,
    lead: float | None = None,
    blend: float | None = None,
) -> JointTrajectory:
    """Compute the commands of a hand's drives over time: a trajectory whose columns are the drives (m,).

    The efforts e produce the torques of the plan minus those of springs, by least squares of transmission.T @ e - tau.
    After t_F they are those of the plan's holding torques. By ``command``:

    - ``torque``: ``effort`` is e; ``q`` is the planned coordinate of the drive, a = transmission @ q.
    - ``position``: for servos without feed-forward, kp (a_ref - a) + kd (da_ref - da): ``q`` is a_ref = a + e / kp, and
      ``dq``, ``ddq`` are its derivatives; ``effort`` is 0, ``stiffness`` (m,) is kp.
    - ``impedance``: for kp (a_ref - a) + kd (da_ref - da) + effort: ``q`` is the plan's a, ``effort`` is e, and the
      gains go with them, as ``stiffness`` and ``damping`` (m,).

    Args:
        plan: new or read back.
        command: ``torque``, ``position`` or ``impedance``; for jaws see :func:`pinograsp.handover.jaw_commands`.
        stiffness: kp, one number or (m,) [N m/rad or N/m, effort per unit of a]; default: that of each drive.
        damping: kd, one number or (m,) [effort per unit of da/dt]; default: that of each drive.
        shortfall: share of the largest torque that the drives may miss at any joint [-], if there are fewer drives than
            joints; a note gives it. None: any.
        rate, start, lead, blend: as for :func:`joint_trajectory`.

    Raises:
        InvalidInput: as :func:`joint_trajectory`; a hand without drives; gains that neither the drives nor the
            arguments have; torques that the drives cannot produce.
    """
    one_of("command", command, SERVO)
    joints = joint_trajectory(plan, rate=rate, start=start, lead=lead, blend=blend)
    return in_drives(plan.require_hand(), joints, command, stiffness, damping, shortfall)


def make_commands(
    plan: PlanRecord,
    command: Command | None = None,
    *,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    shortfall: float | None = SHORTFALL,
    **sampling: Unpack[Sampling],
) -> JointTrajectory:
    """The trajectory of the joints without a ``command``, else that of the drives; of jaws, coordinates and efforts."""
    if command is not None:
        one_of("command", command, COMMANDS)
        own: Command = "torque" if command == "jaw" else command
        return drive_commands(plan, own, stiffness=stiffness, damping=damping, shortfall=shortfall, **sampling)
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        if value is not None:
            raise InvalidInput(f"{name}: expected with command='position' or 'impedance', got it alone")
    return joint_trajectory(plan, **sampling)


def write_drive_keyframes(
    plan: PlanRecord,
    path: str | Path,
    command: Command,
    *,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    shortfall: float | None = SHORTFALL,
    **sampling: Unpack[Sampling],
) -> JointTrajectory:
    """Write keyframes and controls as :meth:`JointTrajectory.to_mujoco` for a hand with an actuator per drive.

    In their order, these are motors whose control is the effort (``torque``), or position servos of the gains given
    (else), whose control makes up for the feed-forward: a_ref + (effort + kd da) / kp. Arguments as for
    :func:`drive_commands`; returns the trajectory of the drives.
    """
    path = path_of("path", path)
    one_of("suffix of MuJoCo keyframes", path.suffix, (".xml",))
    if one_of("command", command, COMMANDS) == "jaw":
        raise InvalidInput(
            "command='jaw': expected scene=True, got keyframes alone: the force is a limit of the model's actuator; "
            "take to_mujoco(scene=True), or command='torque'"
        )
    joints = joint_trajectory(plan, **sampling)
    drives = in_drives(plan.require_hand(), joints, command, stiffness, damping, shortfall)
    ctrl = drives.effort if command == "torque" else drives.q
    if drives.stiffness is not None and drives.damping is not None:
        ctrl = drives.q + (drives.effort + drives.damping * drives.dq) / drives.stiffness
    every = joints.with_followers()
    found = Controls(qpos=every.q, qvel=every.dq, ctrl=ctrl, joints=every.names, actuators=drives.names)
    write_keyframes(path, joints.times, joints.impact_time, found)
    return drives


def in_drives(
    hand: HandModel,
    joints: JointTrajectory,
    command: Command,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    shortfall: float | None = SHORTFALL,
) -> JointTrajectory:
    """A trajectory of the hand's joints as commands of its drives, see :func:`drive_commands`."""
    require_drives(hand)
    kp = gains(hand, "stiffness", stiffness) if command in ("position", "impedance") else None
    kd = gains(hand, "damping", damping) if command == "impedance" else None
    S = hand.transmission.T
    effort, notes = efforts(hand, joints.q, joints.effort, shortfall)
    a, da, dda = joints.q @ S, joints.dq @ S, joints.ddq @ S
    if command == "position" and kp is not None:
        notes += below_steps(hand, effort[-1], kp)
        a, da, dda = _ahead(joints.times, a + effort / kp)
        notes += _range_notes(hand, a)
        effort = np.zeros_like(effort)
    return JointTrajectory(
        names=tuple(drive.name for drive in hand.drives),
        times=joints.times,
        q=a,
        dq=da,
        ddq=dda,
        effort=effort,
        joints=tuple(drive.name for drive in hand.drives),
        begin=joints.begin,
        impact_time=joints.impact_time,
        final_time=joints.final_time,
        blends=joints.blends,
        deviation=None if joints.deviation is None else joints.deviation @ np.abs(S),
        contact_deviation=joints.contact_deviation,
        stiffness=kp,
        damping=kd,
        notes=(*joints.notes, *notes),
    )


def require_drives(hand: HandModel) -> None:
    """:class:`InvalidInput` for a hand without drives."""
    if not hand.drives:
        raise InvalidInput(
            f"command: expected a hand with drives, got '{hand.name}' without any: give its motors, "
            "hand.with_drives([Drive(name=..., joints=..., arms=...)]), and plan with it"
        )


def gains(hand: HandModel, name: Literal["stiffness", "damping"], value: ArrayLike | None) -> Array:
    """The given gains, or those of the drives (m,); :class:`InvalidInput` names the drives that have none."""
    if value is None:
        own = [getattr(drive, name) for drive in hand.drives]
        unknown = [drive.name for drive, one in zip(hand.drives, own) if one is None]
        if unknown:
            raise InvalidInput(
                f"{name}: expected one for each drive of hand '{hand.name}', got none for {', '.join(unknown)}: give "
                f"{name}=, one number or one per drive ({len(own)},) [effort per unit of the drive's coordinate"
                f"{' and second' if name == 'damping' else ''}], or drives that have it (Drive({name}=...))"
            )
        value = own
    found = at_least_zero(name, each_of(name, value, len(hand.drives)))
    if name == "stiffness" and np.any(found == 0):
        raise InvalidInput(f"stiffness: expected values > 0, got {found.tolist()}: command='torque' needs none")
    return found


def efforts(hand: HandModel, q: Array, torques: Array, shortfall: float | None) -> tuple[Array, list[str]]:
    """Efforts of the drives (s, m) that make the torques (s, n) at q (s, n) best, and notes on what they leave undone;
    :class:`InvalidInput` where that is more than the share ``shortfall`` of the largest torque.
    """
    allowed = None if shortfall is None else number("shortfall", shortfall, at_least=0)
    effort, undone, largest = solve_efforts(hand, q, torques)
    worst = int(np.argmax(undone))
    notes = []
    if undone[worst] > _NOTHING * max(largest, 1e-9):
        short = ", ".join(
            f"{hand.joint_names[j]} {undone[j]:.3g}" for j in np.argsort(-undone)[:4] if undone[j] > _NOTHING * largest
        )
        text = (
            f"{len(hand.drives)} drive{'s' * (len(hand.drives) != 1)} cannot produce the torques of {hand.n} joints, "
            f"which are off by up to {short} N m or N, {100 * undone[worst] / largest:.3g} % of the largest torque"
        )
        if allowed is not None and undone[worst] > allowed * largest:
            raise InvalidInput(
                f"command: expected torques that the drives of hand '{hand.name}' can produce within {100 * allowed:g} "
                f"%; {text}: the hand would not exert the planned forces. Use joint torques (no command=), plan with "
                "drives that move each joint, or give shortfall=None for the nearest torques that they can produce"
            )
        notes.append(text)
    for drive, peak in zip(hand.drives, np.abs(effort).max(axis=0)):
        if peak > drive.limit * (1 + _SLACK):
            notes.append(f"drive {drive.name} needs up to {peak:.3g}, more than its limit of {drive.limit:g}")
    return effort, notes


def _ahead(times: Array, reference: Array) -> tuple[Array, Array, Array]:
    """A reference (s, m) with its derivatives, at rest at both ends."""
    if times.size < 2:
        return reference, np.zeros_like(reference), np.zeros_like(reference)
    spline = CubicSpline(times, reference, bc_type="clamped")
    velocity, acceleration = spline(times, 1), spline(times, 2)
    for ends in (velocity, acceleration):
        ends[0] = ends[-1] = 0.0
    return reference, velocity, acceleration


def _range_notes(hand: HandModel, reference: Array) -> list[str]:
    """References beyond the range of a drive's coordinate: servos that clip them make less force."""
    arms = hand.transmission
    with np.errstate(invalid="ignore"):  # joints without limits that a drive does not move
        ends = np.where(arms == 0, 0.0, np.array([arms * hand.lower, arms * hand.upper]))
    ends = np.sort(ends, axis=0).sum(axis=2)
    beyond = np.maximum(ends[0] - reference, reference - ends[1]).max(axis=0)
    return [
        f"drive {drive.name} is sent {by:.3g} rad or m beyond its joints' range: a controller that clips this produces "
        "less force"
        for drive, by in zip(hand.drives, beyond)
        if by > _SLACK
    ]
