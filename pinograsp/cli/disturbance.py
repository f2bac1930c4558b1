"""Options of ``pinograsp check`` that say what is otherwise than planned."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinograsp.cli.options import read_numbers
from pinograsp.cli.session import option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.hands import HandModel
    from pinograsp.simulation import Disturbance
    from pinograsp.simulation.task import Task
    from pinograsp.spatial import Array

_difference = partial(option, "Differences from the plan")


@dataclass(frozen=True, slots=True, kw_only=True)
class DisturbanceOptions:
    """What is otherwise than planned."""

    push: list[str] | None = _difference(
        "Push the object with this force \\[N], optionally with ,MX,MY,MZ \\[N m] and @START+DURATION \\[s]; "
        "repeatable.",
        metavar="FX,FY,FZ",
    )
    shake: str | None = _difference(
        "Shake the hand with this acceleration \\[m/s^2], optionally @FREQUENCY \\[Hz].", metavar="AX,AY,AZ"
    )
    mu: float | None = _difference("Friction coefficient instead of the plan's.")
    mass: float | None = _difference("Mass of the object instead of the plan's \\[kg].")
    offset: str | None = _difference("Offset of the object \\[mm].", metavar="X,Y,Z")
    turn: str | None = _difference("Rotation of the object \\[deg].", metavar="RX,RY,RZ")
    start_error: float = _difference("Offset of every joint at the start \\[deg, mm].", default=0.0)
    base_motion: Path | None = _difference(
        "Accelerations of the hand's base: lines T,AX,AY,AZ with T after t_F \\[s, m/s^2], interpolated linearly.",
        metavar="FILE.csv",
    )
    base_path: Path | None = _difference(
        "Positions of the hand's base: lines T,X,Y,Z with T after t_F \\[s, m], joined by a cubic spline from "
        "rest to rest.",
        metavar="FILE.csv",
    )
    stiffness: float = _difference(
        "Factor on the contact law's K; above 1 the object is stiffer than assumed.", default=1.0
    )
    joint_friction: str | None = _difference(
        "Dry friction of all joints, or of each joint \\[N m, N].", metavar="F[,F...]"
    )
    joint_offset: str | None = _difference(
        "Calibration error of all encoders, or of each encoder \\[deg, mm].", metavar="O[,O...]"
    )
    servo_gain: float = _difference(
        "Factor on the servos' gains; with --control torque, on the motors' torques.", default=1.0
    )
    drive_gain: str | None = _difference(
        "Share of the commanded effort that all drives produce, or each drive: a factor.", metavar="G[,G...]"
    )
    delay: str | None = _difference(
        "Delay with which all drives, or each drive, follow their commands \\[ms].", metavar="D[,D...]"
    )

    def read(self, task: Task) -> Disturbance:
        """As a disturbance of the task; :class:`InvalidInput` for texts that say none."""
        import numpy as np

        from pinograsp.checks import number
        from pinograsp.simulation import BaseMotion, Disturbance, Push

        pushes = []
        for text in self.push or ():
            values, _, when = text.partition("@")
            start, _, duration = when.partition("+")
            wrench = read_numbers("--push", values, (3, 6))
            timing = {}
            if start:
                timing["start"] = read_numbers("--push", start, (1,))[0]
            if duration:
                timing["duration"] = read_numbers("--push", duration, (1,))[0]
            pushes.append(Push(wrench_o=np.array([*wrench, *[0.0] * (6 - len(wrench))]), **timing))
        given: dict[str, Any] = {"pushes": tuple(pushes), "mu": self.mu}
        if self.shake is not None:
            values, _, frequency = self.shake.partition("@")
            given["shake"] = read_numbers("--shake", values, (3,))
            if frequency:
                given["shake_frequency"] = read_numbers("--shake", frequency, (1,))[0]
        if self.mass is not None:
            given["mass_factor"] = number("--mass", self.mass, above=0, unit="kg") / task.body.mass
        if self.offset is not None:
            given["object_offset"] = 1e-3 * np.array(read_numbers("--offset", self.offset, (3,)))
        if self.turn is not None:
            given["object_turn"] = np.radians(read_numbers("--turn", self.turn, (3,)))
        given |= {"stiffness": self.stiffness, "servo_gain": self.servo_gain}
        if self.base_motion is not None and self.base_path is not None:
            raise InvalidInput("--base-path: expected without --base-motion, both give the motion of the base")
        if self.base_motion is not None:
            times, rows = _read_rows("--base-motion", self.base_motion)
            given["base_motion"] = BaseMotion(times=times, accelerations=rows)
        if self.base_path is not None:
            given["base_motion"] = BaseMotion.through(*_read_rows("--base-path", self.base_path))
        hand = task.hand
        if self.start_error:
            given["start_error"] = read_of_joints(hand, "--start-error", str(self.start_error), math.radians(1), 1e-3)
        if self.joint_offset is not None:
            given["joint_offset"] = read_of_joints(hand, "--joint-offset", self.joint_offset, math.radians(1), 1e-3)
        if self.joint_friction is not None:
            given["joint_friction"] = read_of_joints(hand, "--joint-friction", self.joint_friction, 1.0, 1.0)
        if self.drive_gain is not None:
            given["drive_gain"] = read_of_joints(hand, "--drive-gain", self.drive_gain, 1.0, 1.0)
        if self.delay is not None:
            given["command_delay"] = read_of_joints(hand, "--delay", self.delay, 1e-3, 1e-3)
        return Disturbance(**given)


def read_of_joints(hand: HandModel, option: str, text: str, turning: float, sliding: float) -> Array:
    """Values of the joints (n,), from one number or n, times the unit of turning or sliding joints."""
    import numpy as np

    values = read_numbers(option, text, (1,) if hand.n == 1 else (1, hand.n))
    each: Array = np.array(values) * np.where(hand.slides, sliding, turning)
    return each


def _read_rows(option: str, path: Path) -> tuple[Array, Array]:
    """Times (m,) and vectors (m, 3) in a CSV file."""
    import numpy as np

    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{option}: expected a readable file of text, got '{path}' ({error})") from error
    rows = np.array([read_numbers(option, line, (4,)) for line in lines if line.strip()]).reshape(-1, 4)
    return rows[:, 0], rows[:, 1:]
