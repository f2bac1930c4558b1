"""Logs of a hand that moves freely: positions of its joints and efforts of its drives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from pinograsp.checks import array_of, brief, number, path_of, read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.identification.logs import read_columns
from pinograsp.spatial import Array, BoolArray

_WINDOW = 0.1  # [s] over which positions are smoothed and differentiated
_SLOW = 0.05  # of a joint's largest speed: below, friction takes any value
_GAP = 0.2  # [s] between two samples of a log of motion, at most
FEWEST = 50  # samples in motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionLog:
    """Joint positions and drives' efforts over time (s).

    Attributes:
        source: the file, or what else it is.
        times: in equal steps (s,) [s].
        q: of the hand's joints (s, n) [rad or m].
        effort: of the hand's drives in the units of their registers, such as current (s, m); NaN: not logged.
    """

    source: str
    times: Array
    q: Array
    effort: Array

    __repr__ = brief("source", "times", "q")

    def __post_init__(self) -> None:
        times = array_of("times of a log", self.times, (None,))
        steps = np.diff(times)
        if len(times) < 2 * FEWEST or not np.all(steps > 0) or np.ptp(steps) > 0.5 * np.median(steps):
            raise InvalidInput(
                f"log {self.source}: expected {2 * FEWEST} samples or more in equal steps of time, got {len(times)} "
                f"in steps of {steps.min(initial=0):g} to {steps.max(initial=0):g} s"
            )
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "q", read_only(array_of("positions of a log", self.q, (len(times), None))))
        effort = np.asarray(self.effort, dtype=float)
        if effort.ndim != 2 or len(effort) != len(times) or np.isinf(effort).any():
            raise InvalidInput(f"efforts of log {self.source}: expected ({len(times)}, m), got {effort.shape}")
        object.__setattr__(self, "effort", read_only(effort))


def read_motion(
    path: str | Path,
    hand: HandModel,
    *,
    time: str = "time",
    position: str = "{}/position",
    effort: str = "{}/effort",
    position_step: float = 1.0,
) -> MotionLog:
    """Read a log of joints and drives with a column for each: CSV, Parquet or a bag of ROS.

    Args:
        path: the file.
        hand: the hand with these joints and drives.
        time: column of the time [s].
        position, effort: names of the columns of the joints' positions and the drives' registers, with ``{}`` for the
            name. Joints without a column are at the hand's resting posture, drives without one are not identified.
        position_step: radians or metres of one unit of position.

    Raises:
        InvalidInput: not such a table, no column of a joint or drive, time that does not increase or has gaps of 0.2 s.
    """
    path = path_of("log", path)
    step = number("position_step", position_step)
    joints = {position.format(name): name for name in hand.joint_names}
    drives = {effort.format(drive.name): drive.name for drive in hand.drives}
    table = read_columns(path, [time, *joints, *drives], needed=[time])
    if not table.keys() & joints.keys() or not table.keys() & drives.keys():
        raise InvalidInput(
            f"log {path}: expected columns as '{next(iter(joints))}' and '{next(iter(drives), '')}', got none of them: "
            "give their names, position='{}_pos', effort='{}_current'"
        )
    times = table[time]
    q = np.tile(hand.resting, (len(times), 1))
    for column, name in joints.items():
        if column in table:
            q[:, hand.joint_names.index(name)] = step * table[column]
    blank = np.full(len(times), np.nan)
    registers = np.column_stack([table.get(column, blank) for column in drives])
    even = _even_out(path, times)
    evened = [np.column_stack([np.interp(even, times, one) for one in values.T]) for values in (q, registers)]
    return MotionLog(source=str(path), times=even, q=evened[0], effort=evened[1])


def _even_out(path: Path, times: Array) -> Array:
    """Times in equal steps over a log whose own are not quite equal, as those of buses are."""
    steps = np.diff(times)
    step = float(np.median(steps))
    if not np.all(steps > 0) or steps.max() > _GAP:
        row = int(np.argmax(~(steps > 0) | (steps > _GAP)))
        raise InvalidInput(
            f"log {path}: expected time that rises by at most {_GAP:g} s, got {times[row]:g} s and then "
            f"{times[row + 1]:g} s in sample {row + 2}: cut the log there"
        )
    return np.asarray(times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-9) + 1))


def find_window(log: MotionLog) -> int:
    """Samples that are smoothed together, odd."""
    return max(5, int(_WINDOW / np.median(np.diff(log.times))) | 1)


def differentiate(log: MotionLog) -> tuple[Array, Array, Array]:
    """q, dq and ddq (s, n), by polynomials of third degree through neighbours."""
    dt, width = float(np.median(np.diff(log.times))), find_window(log)
    q, dq, ddq = (savgol_filter(log.q, width, 3, deriv=k, delta=dt, axis=0) for k in range(3))
    return q, dq, ddq


def find_moving(dq: Array, width: int) -> BoolArray:
    """Samples (s,) that are fast enough, and so are all that were smoothed together with them."""
    slow = np.abs(dq) <= max(_SLOW * float(np.quantile(np.abs(dq), 0.95)), 1e-6)
    slow[:width] = slow[-width:] = True
    near: BoolArray = np.convolve(slow, np.ones(width), mode="same") < 0.5
    return near
