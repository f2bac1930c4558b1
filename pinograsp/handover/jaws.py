"""What grippers are sent: width and force, as plain numbers and as ROS 2's parallel gripper command."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pinograsp.checks import brief, flag, instance_of, items_of, one_of, path_of, text_of
from pinograsp.errors import InvalidInput
from pinograsp.handover.commands import efforts, require_drives
from pinograsp.handover.yaml_text import write_gripper_yaml
from pinograsp.hands import HandModel
from pinograsp.hands.drives import Drive
from pinograsp.hands.efforts import SHORTFALL
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array
from pinograsp.words import no_formula
from pinograsp.writing import write_file

_LEAST = 1e-6  # share of the drive's limit, or N: less does not press
_MOMENT = 1e-6  # [s] in which a speed is measured
_OTHER_WIDTH = 5e-3  # [m] that an object may be wider or narrower for a grasp to count: the default of libfranka


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTarget:
    """The command of one joint of a gripper.

    Attributes:
        joint: its name.
        position: planned holding position [rad or m].
        closed: end of its travel in the closing direction [rad or m]; ``position`` if it has none.
        effort: largest size of its own effort [N m or N]: if jaws slide together, without that of the others; if a
            linkage or gears turn others, the whole torque at the driven joint, and 0 at the others.
        follows: whether it follows another joint.
    """

    joint: str
    position: float
    closed: float
    effort: float
    follows: bool

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True)
class JawCommand:
    """How a drive of a gripper holds after t_F.

    Attributes:
        drive: its name.
        coordinate: the drive's own, transmission @ q [rad or m].
        effort: of the drive, its size [N or N m].
        width: distance between the two jaws' contact points at the end, each the mean weighted by force [m]; None if
            the hand does not press with exactly two parts. It is smaller than the object's by the assumed compression
            of the contacts (:attr:`pinograsp.Material`), so it is a servo command, not what the gripper measures on a
            rigid object.
        touch_width: the same at t_I, when the jaws touch: that of the object [m]. Grippers that compare their
            measurement with the command need this one.
        touch_speed: rate by which the width shrinks at t_I [m/s]: the closing speed for jaws with a speed command.
        other_width: largest difference between the final width and ``touch_width`` at which the grasp still counts [m]:
            5 mm, or the assumed compression of the contacts if that is more.
        jaw_force: force of one jaw along the line between these points, the larger of both [N]; None as for ``width``.
        total_force: of both jaws [N].
        joints: the joints that it moves, followers included.
    """

    drive: str
    coordinate: float
    effort: float
    width: float | None
    touch_width: float | None
    touch_speed: float | None
    other_width: float | None
    jaw_force: float | None
    total_force: float | None
    joints: tuple[JointTarget, ...]

    __repr__ = brief()

    def describe(self) -> str:
        """Widths and force, as a line of text."""
        if self.width is None or self.touch_width is None or self.jaw_force is None:
            return f"{self.drive}: effort {self.effort:.4g}"
        give = self.touch_width - self.width
        return (
            f"{self.drive}: {1e3 * self.touch_width:.2f} mm wide where the jaws touch, {1e3 * self.width:.2f} mm at "
            f"the end ({1e3 * give:.2f} mm of assumed give of the contacts), {self.jaw_force:.4g} N per jaw"
        )

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, units in the names."""
        return {
            "drive": self.drive,
            "coordinate": self.coordinate,
            "effort": self.effort,
            "width_m": self.width,
            "width_at_touch_m": self.touch_width,
            "speed_m_s": self.touch_speed,
            "epsilon_m": self.other_width,
            "force_per_jaw_N": self.jaw_force,
            "force_total_N": self.total_force,
            "joints": [asdict(one) for one in self.joints],
        }


def jaw_commands(plan: PlanRecord, *, shortfall: float | None = SHORTFALL) -> tuple[JawCommand, ...]:
    """Return width and force of a gripper's drives, with which the plan holds after t_F.

    These are the drives whose control is ``jaw``, or the only drive of a hand. Efforts are those of the plan's holding
    torques.

    Args:
        plan: new or read back.
        shortfall: share of the largest holding torque that the drives may miss, as for :func:`drive_commands`; None:
            any.

    Raises:
        InvalidInput: a plan without its hand; a hand without jaws; a drive that does not press; torques that the drives
            cannot produce.
    """
    hand = instance_of("plan", plan, PlanRecord).require_hand()
    require_drives(hand)
    drives = [drive for drive in hand.drives if drive.control == "jaw"] or list(hand.drives)
    if len(drives) > 1 and drives[0].control != "jaw":
        raise InvalidInput(
            f"command='jaw': expected drives with control 'jaw', got {len(hand.drives)} drives of hand '{hand.name}' "
            "with other controls: take another command, or say which are jaws, hand.with_drives([Drive(..., "
            "control='jaw')]), and plan with that hand"
        )
    made, q = hand.transmission, plan.motion.q[-1]
    needed = efforts(hand, q[None], plan.motion.holding_torques[None], shortfall)[0][0]
    press = _find_press(hand, plan)
    found = []
    for drive in drives:
        row = hand.drives.index(drive)
        effort = float(needed[row])
        if abs(effort) <= _LEAST * min(drive.limit, 1.0):
            raise InvalidInput(
                f"command='jaw': expected a drive that presses, got an effort of {effort:.3g} for '{drive.name}': "
                "take command='position', or a plan whose contacts it presses"
            )
        found.append(
            JawCommand(
                drive=drive.name,
                coordinate=float(made[row] @ q),
                effort=abs(effort),
                joints=_targets(hand, drive, effort, q),
                **press._asdict(),
            )
        )
    return tuple(found)


def _targets(hand: HandModel, drive: Drive, effort: float, q: Array) -> tuple[JointTarget, ...]:
    targets = []
    for joint, arm in zip(drive.joints, drive.arms):
        followers = {name: one for name, one in hand.couplings.items() if one.followed == joint}
        # Jaws that slide together share the force, each presses with its own; where a linkage or gears turn others, the
        # joint that is driven has all of the torque, and nothing drives those.
        j = hand.joint_names.index(joint)
        sliding = all(hand.is_prismatic(hand.model.getJointId(name)) for name in (joint, *followers))
        torque = effort * arm / (1.0 + (sum(one.factor**2 for one in followers.values()) if sliding else 0.0))
        end = float((hand.upper if torque > 0 else hand.lower)[j])
        position = float(q[j])
        closed = end if math.isfinite(end) else position
        targets.append(JointTarget(joint=joint, position=position, closed=closed, effort=abs(torque), follows=False))
        targets += [
            JointTarget(
                joint=name,
                position=one.factor * position + one.offset,
                closed=one.factor * closed + one.offset,
                effort=abs(one.factor * torque) if sliding else 0.0,
                follows=True,
            )
            for name, one in followers.items()
        ]
    return tuple(targets)


def group_contacts(hand: HandModel, links: Iterable[str]) -> dict[str, list[int]]:
    """Contacts by the finger whose links touch; those of the palm, and of no link, under ""."""
    parts: dict[str, list[int]] = {}
    for i, link in enumerate(links):
        frame = hand.model.frames[hand.frame_id(link)] if link else None
        joint = 0 if frame is None else int(frame.parentJoint)
        name = next((finger.name for finger in hand.fingers if joint in finger.joint_ids), "")
        parts.setdefault(name, []).append(i)
    return parts


class _Press(NamedTuple):
    """Widths, speed and forces of :class:`JawCommand`; None where the hand does not press with exactly two parts."""

    width: float | None = None
    touch_width: float | None = None
    touch_speed: float | None = None
    other_width: float | None = None
    jaw_force: float | None = None
    total_force: float | None = None


def _find_press(hand: HandModel, plan: PlanRecord) -> _Press:
    """How two jaws press: between their contact points, each the mean weighted by force."""
    contacts, motion = plan.contacts, plan.motion
    parts = group_contacts(hand, contacts.links)
    if len(parts) != 2 or not all(contacts.links):
        return _Press()
    q, rate = motion.q[motion.impact], motion.dq[motion.impact]
    postures = q, motion.q[-1], q + _MOMENT * rate
    touching, *placements = (hand.frame_placements(one, contacts.links) for one in postures)
    ends = np.array(
        [
            [(after @ np.linalg.solve(before, [*point, 1.0]))[:3] for after in later]
            for point, before, *later in zip(contacts.points_o, touching, *placements)
        ]
    )
    weights = np.maximum(plan.forces.normal_forces, 1e-12)
    one, two = parts.values()
    first, apart, soon = (
        np.average(places[two], axis=0, weights=weights[two]) - np.average(places[one], axis=0, weights=weights[one])
        for places in (contacts.points_o, ends[:, 0], ends[:, 1])
    )
    touch_width, width = float(np.linalg.norm(first)), float(np.linalg.norm(apart))
    if width == 0:
        return _Press()
    forces = [abs(float(motion.forces_o[-1, rows].sum(axis=0) @ apart)) / width for rows in (one, two)]
    return _Press(
        width=width,
        touch_width=touch_width,
        touch_speed=max(0.0, (touch_width - float(np.linalg.norm(soon))) / _MOMENT),
        other_width=max(_OTHER_WIDTH, touch_width - width),
        jaw_force=max(forces),
        total_force=sum(forces),
    )


def gripper_message(
    jaws: Sequence[JawCommand],
    path: str | Path | None = None,
    *,
    followers: bool = False,
    frame: str = "",
) -> dict[str, Any]:
    """Return the goal of a ``control_msgs/action/ParallelGripperCommand`` as plain values, and write it if you give a
    path.

    Its ``command``, a ``sensor_msgs/JointState``, has for each joint the position [m or rad] at the end of its travel
    in the closing direction, so that the gripper presses until it reaches ``effort`` [N or N m]: the joint's own, which
    is the force of one jaw if jaws slide, and the whole torque of the motor if it turns others. A gripper that stops at
    the planned position would hardly press. ``velocity`` is empty, which sets no limit. Send it with ``ros2 action
    send_goal NAME control_msgs/action/ParallelGripperCommand "$(cat FILE)"``.

    Args:
        jaws: from :func:`jaw_commands`.
        path: ``.yaml``, ``.yml`` or ``.json``; an existing file is replaced.
        followers: add the joints that follow; most controllers accept one joint.
        frame: ``header.frame_id``.

    Raises:
        InvalidInput: another suffix. ResultsNotWritten.
    """
    jaws = items_of("jaws", jaws, JawCommand)
    if path is not None:
        path = path_of("path", path)
        one_of("suffix of a ROS 2 message", path.suffix, (".yaml", ".yml", ".json"))
    flag("followers", followers)
    joints = [one for jaw in jaws for one in jaw.joints if followers or not one.follows]
    message: dict[str, Any] = {
        "command": {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": text_of("frame", frame)},
            "name": [one.joint for one in joints],
            "position": [one.closed for one in joints],
            "velocity": [],
            "effort": [one.effort for one in joints],
        }
    }
    if path is not None:
        content = json.dumps(message, allow_nan=False) + "\n" if path.suffix == ".json" else write_gripper_yaml(message)
        write_file(path, content.encode())
    return message


_COLUMNS = ("position", "closed", "effort")
_SHARED = ("width_m", "width_at_touch_m", "speed_m_s", "epsilon_m", "force_per_jaw_N", "force_total_N")


def write_jaws(jaws: Sequence[JawCommand], path: str | Path) -> None:
    """Write a table with a line per drive and joint: ``drive``, ``joint``, ``position``, ``closed`` [m or rad],
    ``effort`` (the joint's own [N or N m]), ``width_m``, ``width_at_touch_m``, ``speed_m_s``, ``epsilon_m``,
    ``force_per_jaw_N``, ``force_total_N``, as :meth:`JawCommand.summary`.

    Raises:
        ResultsNotWritten: the place cannot be written.
    """
    rows = []
    for jaw in items_of("jaws", jaws, JawCommand):
        values = jaw.summary()
        shared = ["" if values[name] is None else repr(values[name]) for name in _SHARED]
        for one in jaw.joints:
            own = [repr(getattr(one, name)) for name in _COLUMNS]
            rows.append([no_formula(jaw.drive), no_formula(one.joint), *own, *shared])
    write_table(path, ["drive", "joint", *_COLUMNS, *_SHARED], rows)


def write_table(path: str | Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a line of names and a line for each row, with commas between; an existing file is replaced."""
    path = path_of("path", path)
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow(head)
    table.writerows(rows)
    write_file(path, written.getvalue().encode())
