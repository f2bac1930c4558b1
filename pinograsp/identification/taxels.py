"""Calibration of a taxel, from presses against a load cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from scipy.stats import spearmanr

from pinograsp.checks import array_of
from pinograsp.errors import InvalidInput
from pinograsp.reflex.taxels import TaxelCalibration

_STEPS = 16  # of the force, between which knots lie
_REST = 0.02  # of the largest force: less is none
_FEWEST = 3  # samples of a step
_FOLLOWS = 0.5  # rank correlation under which counts do not follow the force
_STILL = 2  # last steps in which counts no longer change: the taxel is saturated
_FINEST = 1e-3  # of the span of counts: a change, however little noise there is
# Counts of a taxel that works: beyond rest, beyond a saturated end and beyond an end that is not, in spans.
_IDLE, _SATURATED, _OPEN = 0.25, 0.02, 0.5
_LENT = 5.0  # samples' worth of the scatter of all that each knot's scatter is mixed with


def identify_taxel(raw: ArrayLike, forces: ArrayLike, *, valid: tuple[float, float] | None = None) -> TaxelCalibration:
    """Force by raw counts of a taxel, by least squares of the forces over monotone curves that are 0 at rest.

    Where counts no longer follow the force, the taxel is saturated: the curve ends before, and tells the least that
    presses.

    Args:
        raw: counts of the taxel (s,), in the order of time, of presses from rest to the largest force and back.
        forces: of a load cell that the same is pressed by (s,) [N], 0 at rest.
        valid: least and largest count of a taxel that works; others are dead. None: those of the log, wider by a
            quarter of its span where nothing presses, by half of it where more may press than was logged, and by a
            fiftieth where the taxel is saturated.

    Raises:
        InvalidInput: arrays of other sizes, no samples at rest, counts that do not follow the force.
    """
    counts, pressed = array_of("raw", raw, (None,)), array_of("forces", forces, (None,))
    if counts.shape != pressed.shape or len(counts) < 2:
        raise InvalidInput(
            f"raw and forces: expected as many samples of both, got shapes {counts.shape} and {pressed.shape}"
        )
    most = float(pressed.max())
    resting = pressed < _REST * most
    if most <= 0 or resting.sum() < _FEWEST:
        raise InvalidInput(
            f"forces: expected presses that begin at rest, 0 N, got {pressed.min():.4g} to {most:.4g} N: take off what "
            "the load cell says at rest, and log before and after each press"
        )
    along = float(spearmanr(counts, pressed).statistic) if np.ptp(counts) > 0 else 0.0
    sign = 1.0 if along > 0 else -1.0
    x = sign * counts  # grows with the force
    rest = float(np.median(x[resting]))
    noise = 1.4826 * float(np.median(np.abs(x[resting] - rest)))
    span = float(x.max()) - rest
    least = max(2 * noise, _FINEST * span)
    step = np.where(resting, -1, np.minimum((_STEPS * pressed / most).astype(int), _STEPS - 1))
    knots, last = [rest], -1
    for i in range(_STEPS):
        if (step == i).sum() >= _FEWEST and (middle := float(np.median(x[step == i]))) > knots[-1] + least:
            knots.append(middle)
            last = i
    saturated = step.max() - last >= _STILL
    if saturated:  # where counts of any larger force begin
        end = float(np.median(x[step > last])) - 3 * noise
        knots = [*(knot for knot in knots if knot < end - least), end]
    if len(knots) < 3 or abs(along) < _FOLLOWS:
        raise InvalidInput(
            f"raw: expected counts that follow the force, got some whose rank correlation with it is {along:.2g}: are "
            "both of the same time, and of the taxel that was pressed?"
        )
    k = np.array(knots)
    told = x <= k[-1] if saturated else np.ones(len(x), dtype=bool)
    rises, _ = nnls(np.clip((x[told, None] - k[:-1]) / np.diff(k), 0.0, 1.0), pressed[told])
    curve = np.concatenate([[0.0], np.cumsum(rises)])
    left = pressed[told] - np.interp(x[told], k, curve)
    nearness = np.array([np.interp(x[told], k, one) for one in np.eye(len(k))])  # of samples to knots
    scatter = (nearness @ left**2 + _LENT * np.mean(left**2)) / (nearness.sum(axis=1) + _LENT)
    grows = np.gradient(pressed)[told] > 0
    apart = []  # mean of what is left while the force grows, less that while it falls, by knot
    for near in nearness * ~resting[told]:
        weights = near[grows].sum(), near[~grows].sum()
        if min(weights) >= _FEWEST:
            apart.append(abs(near[grows] @ left[grows] / weights[0] - near[~grows] @ left[~grows] / weights[1]))
    if valid is None:
        ends = rest - _IDLE * span, float(x.max()) + (_SATURATED if saturated else _OPEN) * span
        valid = (min(float(x.min()), ends[0]), ends[1]) if sign > 0 else (-ends[1], max(-float(x.min()), -ends[0]))
    return TaxelCalibration(
        counts=sign * k,
        forces=curve,
        noise=np.sqrt(scatter),
        valid=valid,
        hysteresis=float(max(apart)) if apart else None,
    )
