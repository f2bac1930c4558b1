"""Calibration of a taxel, from presses against a load cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from scipy.stats import spearmanr

from pinograsp.checks import array_of, integer
from pinograsp.errors import InvalidInput
from pinograsp.reflex.taxels import TaxelCalibration
from pinograsp.spatial import Array, BoolArray

_STEPS = 16  # of the force, between which knots lie
_REST = 0.02  # of the largest force: less is none
_FEWEST = 3  # samples of a step
_FOLLOWS = 0.5  # rank correlation under which counts do not follow the force
_STILL = 2  # last steps in which counts no longer change: the taxel is saturated
_FINEST = 1e-3  # of the span of counts: a change, however little noise there is
# Counts of a taxel that works: beyond rest, beyond a saturated end and beyond an end that is not, in spans.
_IDLE, _SATURATED, _OPEN = 0.25, 0.02, 0.5
_LENT = 5.0  # samples' worth of the scatter of all that each knot's scatter is mixed with


def find_lag(raw: ArrayLike, forces: ArrayLike, *, most: int) -> int:
    """Find by how many samples the forces of a load cell follow the counts of a taxel: the lag with the least scatter
    of the forces about the calibration. Offsets of clocks and filters look like hysteresis; conversely, hysteresis that
    does not depend on the speed of the presses counts as a lag as far as it looks like one.

    Args:
        raw, forces: as for :func:`identify_taxel`.
        most: largest lag that is tried, in both directions [samples].

    Raises:
        InvalidInput: as there, with any lag; or the log is too short.
    """
    counts, pressed = _pair(raw, forces)
    most = integer("most", most, at_least=0, at_most=len(counts) // 4)
    found: dict[int, float] = {}
    for lag in range(-most, most + 1):
        try:
            calibration = identify_taxel(counts, pressed, lag=lag)
        except InvalidInput as error:
            refused = error
            continue
        x, force = _shift(counts, pressed, lag)
        told = calibration.measure(x)
        off = (told.forces - force)[~told.beyond]
        found[lag] = float(np.sqrt(np.mean(off**2))) / calibration.forces[-1]
    if not found:
        raise refused
    return min(found, key=lambda lag: (found[lag], abs(lag)))


def identify_taxel(
    raw: ArrayLike, forces: ArrayLike, *, lag: int = 0, valid: tuple[float, float] | None = None
) -> TaxelCalibration:
    """Calibrate the force of a taxel from its raw counts, by least squares over monotone curves that are 0 at rest.

    If counts no longer follow the force, the taxel is saturated: the curve ends before, and its last force is a lower
    bound.

    Args:
        raw: counts of the taxel (s,), in the order of time, of presses from rest to the largest force and back.
        forces: of a load cell under the same presses (s,) [N], 0 at rest.
        lag: samples by which the forces follow the counts, see :func:`find_lag`.
        valid: least and largest count of a working taxel; other counts mean that it is dead. None: those of the log,
            extended by a quarter of its span at rest, and at the other end by half of it, or by a fiftieth if the taxel
            is saturated.

    Raises:
        InvalidInput: arrays of other sizes, no samples at rest, counts that do not follow the force.
    """
    counts, pressed = _pair(raw, forces)
    counts, pressed = _shift(counts, pressed, integer("lag", lag, at_least=2 - len(counts), at_most=len(counts) - 2))
    most = float(pressed.max())
    resting = pressed < _REST * most
    if most <= 0 or resting.sum() < _FEWEST:
        raise InvalidInput(
            f"forces: expected presses that begin at rest, 0 N, got {pressed.min():.4g} to {most:.4g} N: subtract the "
            "load cell's reading at rest, and log before and after each press"
        )
    sign = 1.0 if (along := _rank_correlation(counts, pressed)) > 0 else -1.0
    x = sign * counts  # grows with the force
    knots, saturated = _place_knots(x, pressed, resting)
    curve = np.zeros(1)
    told = x <= knots[-1] if saturated else np.ones(len(x), dtype=bool)
    if len(knots) > 2 and abs(along) >= _FOLLOWS:
        rises, _ = nnls(np.clip((x[told, None] - knots[:-1]) / np.diff(knots), 0.0, 1.0), pressed[told])
        curve = np.concatenate([[0.0], np.cumsum(rises)])
    if not curve[-1] > 0:
        raise InvalidInput(
            f"raw: expected counts that follow the force, got some whose rank correlation with it is {along:.2g}: are "
            "both recorded at the same time (find_lag measures the lag), and from the taxel that was pressed?"
        )
    off = pressed[told] - np.interp(x[told], knots, curve)
    nearness = np.array([np.interp(x[told], knots, one) for one in np.eye(len(knots))])  # of samples to knots
    scatter = (nearness @ off**2 + _LENT * np.mean(off**2)) / (nearness.sum(axis=1) + _LENT)
    if valid is None:
        span = float(x.max()) - knots[0]
        low = min(float(x.min()), knots[0] - _IDLE * span)
        high = float(x.max()) + (_SATURATED if saturated else _OPEN) * span
        valid = (low, high) if sign > 0 else (-high, -low)
    return TaxelCalibration(
        counts=sign * knots,
        forces=curve,
        noise=np.sqrt(scatter),
        valid=valid,
        hysteresis=_find_hysteresis(off, nearness * ~resting[told], np.gradient(pressed)[told] > 0),
    )


def _rank_correlation(counts: Array, pressed: Array) -> float:
    return float(spearmanr(counts, pressed).statistic) if np.ptp(counts) > 0 and np.ptp(pressed) > 0 else 0.0


def _place_knots(x: Array, pressed: Array, resting: BoolArray) -> tuple[Array, bool]:
    """Counts between which the curve is straight, evenly apart in force, as far as they grow by more than their noise
    at rest; whether the taxel is saturated beyond.
    """
    rest = float(np.median(x[resting]))
    noise = 1.4826 * float(np.median(np.abs(x[resting] - rest)))
    least = max(2 * noise, _FINEST * (float(x.max()) - rest))
    step = np.where(resting, -1, np.minimum((_STEPS * pressed / pressed.max()).astype(int), _STEPS - 1))
    knots, last = [rest], -1
    for i in range(_STEPS):
        if (step == i).sum() >= _FEWEST and (middle := float(np.median(x[step == i]))) > knots[-1] + least:
            knots.append(middle)
            last = i
    saturated = bool(step.max() - last >= _STILL)
    if saturated:  # where counts of any larger force begin
        end = float(np.median(x[step > last])) - 3 * noise
        knots = [*(knot for knot in knots if knot < end - least), end]
    return np.array(knots), saturated


def _find_hysteresis(off: Array, nearness: Array, grows: BoolArray) -> float | None:
    """Largest difference [N] between means of what is off the curve (s,) while the force grows and while it falls, by
    nearness to the knots (m, s); None where one of them was not logged.
    """
    apart = []
    for near in nearness:
        weights = near[grows].sum(), near[~grows].sum()
        if min(weights) >= _FEWEST:
            apart.append(abs(near[grows] @ off[grows] / weights[0] - near[~grows] @ off[~grows] / weights[1]))
    return float(max(apart)) if apart else None


def _pair(raw: ArrayLike, forces: ArrayLike) -> tuple[Array, Array]:
    counts, pressed = array_of("raw", raw, (None,)), array_of("forces", forces, (None,))
    if counts.shape != pressed.shape or len(counts) < 2:
        raise InvalidInput(
            f"raw and forces: expected as many samples of both, got shapes {counts.shape} and {pressed.shape}"
        )
    return counts, pressed


def _shift(counts: Array, pressed: Array, lag: int) -> tuple[Array, Array]:
    """Counts and the forces that belong to them."""
    s = len(counts)
    return counts[max(-lag, 0) : s - max(lag, 0)], pressed[max(lag, 0) : s - max(-lag, 0)]
