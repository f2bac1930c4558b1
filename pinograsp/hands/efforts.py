"""What the drives of a hand make of joint torques: their efforts, what they leave undone, how far a servo is sent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from pinograsp.hands.model import HandModel
from pinograsp.spatial import Array, BoolArray, IntArray

# Share of the largest torque that drives, which are fewer than the joints, may leave undone: friction and reserve bear
# a few per cent. Beyond it a plan has a warning, and its commands are refused.
SHORTFALL = 0.05
_ROUNDING = 1e-3  # share of the largest effort: forces lie on their limits
_STEPS = 2.0  # of an encoder: a servo that is sent less makes its force by chance
_AT_STOP = 1e-3  # of its range: a joint that is so near its end rests on it
_UNKNOWN, _MOST_OFF = (
    0.3,
    0.95,
)  # by which share efforts are off: where nobody has measured it; that squeezes are asked for
_BEARS = 0.05  # of the largest effort: drives that make less do not matter


class Efforts(NamedTuple):
    """Efforts of the drives that make joint torques best, by least squares.

    Attributes:
        drives: (s, m) [N or N m].
        undone: what they leave of the torques at most, by joint (n,) [N m or N].
        largest: torque that is asked for, springs deducted.
    """

    drives: Array
    undone: Array
    largest: float

    @property
    def shortfall(self) -> float:
        """Share of the largest torque that is left undone at the worst joint."""
        return float(self.undone.max(initial=0.0)) / self.largest if self.largest > 0 else 0.0


def spring_torques(hand: HandModel, q: Array) -> Array:
    """Torques that the hand's springs make (..., n) at ``q`` (..., n)."""
    torques = np.zeros_like(q, dtype=float)
    for spring in hand.springs:
        joint = hand.joint_names.index(spring.joint)
        torques[..., joint] -= spring.stiffness * (q[..., joint] - spring.rest)
    return torques


def find_stops(hand: HandModel, q: Array) -> IntArray:
    """Ends of their ranges that joints rest on (..., n) at ``q`` (..., n): 1 the lower, -1 the upper, 0 neither.

    Of joints that share drives, or have none, alone: what presses them against their end, it takes, and not the drives.
    """
    sharing = np.array([ratio.row != 0 for ratio in hand.ratios]).reshape(-1, hand.n).any(axis=0)
    ranges = hand.upper - hand.lower
    room = _AT_STOP * np.where(np.isfinite(ranges), ranges, 0.0)
    stops: IntArray = sharing * ((q <= hand.lower + room).astype(int) - (q >= hand.upper - room).astype(int))
    return stops


def solve_efforts(hand: HandModel, q: Array, torques: Array) -> Efforts:
    """The efforts of the drives that make ``torques`` (s, n) at ``q`` (s, n) best; springs make their part, and joints
    at the end of their range rest on it.
    """
    wanted = torques - spring_torques(hand, q)  # torques are without the springs
    made, stops = hand.transmission, find_stops(hand, q)
    drives: Array = wanted @ np.linalg.pinv(made)
    left = wanted - drives @ made
    largest = float(np.abs(wanted).max(initial=0.0))
    for stopped in np.unique(stops[stops.any(axis=1)], axis=0):
        rows, free = (stops == stopped).all(axis=1), stopped == 0
        # Where the other joints tell all efforts, the stops take the rest.
        drives[rows] = wanted[rows][:, free] @ np.linalg.pinv(made[:, free])
        left[rows] = wanted[rows] - drives[rows] @ made
        borne = np.where(free, left[rows], np.minimum(left[rows] * stopped, 0.0) * stopped)
        unsure = np.abs(borne).max(axis=1) > _ROUNDING * largest
        if np.linalg.matrix_rank(made[:, free]) < np.linalg.matrix_rank(made):
            unsure[:] = True
        left[rows] = borne
        pushes = np.diag(stopped)[:, ~free]
        columns = np.column_stack([made.T, -made.T, pushes])
        for row in np.flatnonzero(rows)[unsure]:
            solution = nnls(columns, wanted[row])[0]
            drives[row] = solution[: len(made)] - solution[len(made) : 2 * len(made)]
            left[row] = wanted[row] - columns @ solution
    undone = np.abs(left).max(axis=0, initial=0.0)
    return Efforts(drives=drives, undone=undone, largest=largest)


def exceed_ways(hand: HandModel, q: Array, torques: Array) -> BoolArray:
    """Which drives (s, m) would have to act the other way than they can to make ``torques`` (s, n) at ``q`` (s, n)."""
    ranges = [(-np.inf, np.inf) if drive.efforts is None else drive.efforts for drive in hand.drives]
    if not np.isfinite(ranges).any():
        return np.zeros((len(q), len(ranges)), dtype=bool)
    least, most = np.array(ranges).T
    efforts = solve_efforts(hand, q, torques).drives
    slack = _ROUNDING * np.abs(efforts).max(axis=1, keepdims=True)
    beyond: BoolArray = (efforts < least - slack) | (efforts > most + slack)
    return beyond


def below_steps(hand: HandModel, efforts: Array, stiffness: Array) -> list[str]:
    """In words, drives whose servos make their effort of ``efforts`` (m,) by a way of less than two encoder steps, or
    less than their backlash.

    Args:
        hand: whose drives have an encoder step.
        efforts: that the servos hold [N or N m].
        stiffness: of the servos (m,), effort per unit of the drive's coordinate; NaN: not a servo, or not known.
    """
    least = _BEARS * float(np.abs(efforts).max(initial=0.0))
    found = []
    for drive, effort, kp in zip(hand.drives, np.abs(efforts).tolist(), stiffness.tolist()):
        if drive.step is None or not kp > 0 or effort <= least:
            continue
        way = effort / kp
        if drive.backlash is not None and way < drive.backlash:
            found.append(
                f"drive {drive.name} is sent {way:.2g} rad or m beyond where it holds, less than the backlash of "
                f"{drive.backlash:.2g} in its gears: unless its encoder is behind them, it may press with nothing; "
                "press harder, or take softer servos"
            )
        elif way < _STEPS * drive.step:
            found.append(
                f"drive {drive.name} is sent {way:.2g} rad or m beyond where it holds, {way / drive.step:.2g} steps of "
                f"its encoder ({drive.step:.3g}): a step is {100 * drive.step / way:.0f} % of its effort; press "
                "harder, or take softer servos"
            )
    return found


def effort_shares(hand: HandModel) -> Array:
    """By which share the torque at each joint may be off what its drives are told (n,) [-]: what the intervals of their
    ``effort_step`` leave open; 0.3 where that is not known.
    """
    shares = np.zeros(hand.n)
    for row, drive in zip(hand.transmission, hand.drives):
        source, share = drive.source("effort_step"), _UNKNOWN
        if drive.effort_step is not None and source is not None and source.interval is not None:
            share = min(max(abs(end / drive.effort_step - 1.0) for end in source.interval), _MOST_OFF)
        shares = np.maximum(shares, np.where(row != 0, share, 0.0))
    return shares
