"""Closings on a stop: how hard a finger presses when it is told a speed and a force limit, and why."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from pinograsp.checks import array_of, brief, items_of, number, read_only
from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.estimates import Estimate
from pinograsp.identification.estimates import widen
from pinograsp.identification.logs import Log
from pinograsp.spatial import Array

_NOISE = 6.0  # times the scatter at rest: a force
_CLEAR = 2.0  # times that threshold: a closing
_REST = 0.05  # quantile of the forces that is taken for no force
_LEAST = 0.04  # of the largest force of a log: less is no closing
_DECAY = (0.08, 0.85)  # of a peak: between these a register's decay after the opening is looked at
_MOVES = 0.05  # of the range of positions: a finger that has opened
_CURVED = 0.15  # [-] in log force: a decay that is no exponential
_RESAMPLES = 400
_TRIALS = (0.05, 0.95)  # quantiles of the trials that a table keeps
# Positions are whole numbers, and not all that scatters is drawn: intervals of the contact law are widened, so that
# they hold the truths that benchmarks/identified_logs.py hides as often as they say.
_WIDER, _SHARE = 1.5, 0.005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactFit:
    """Force over closing distance at rest: K (s (x - start))^rho, with the closing direction s (Eq. 4 without its
    rate).

    Attributes:
        positions, forces: of the closings at rest (n,) [units of the log].
        start: position where the force begins.
        stiffness, exponent: K [force per distance^rho] and rho.
        error: median relative error of the forces [-].
        fits: start, K and rho (f, 3), first of all closings, then of the bootstrap samples.
    """

    positions: Array
    forces: Array
    start: Estimate
    stiffness: Estimate
    exponent: Estimate
    error: float
    fits: Array

    __repr__ = brief("start", "stiffness", "exponent", "error")

    def slope(self, force: float) -> Estimate:
        """Return dF/dx at a force within those of the closings [force unit per position unit]. It is known well even if
        start and exponent, which trade off against each other, are not.

        Raises:
            InvalidInput: the force is beyond those of the closings.
        """
        force = number("force", force, at_least=float(self.forces.min()), at_most=float(self.forces.max()))
        k, rho = self.fits[:, 1], self.fits[:, 2]
        slopes = rho * k ** (1 / rho) * force ** (1 - 1 / rho)
        return widen(slopes[0], slopes, _WIDER, _SHARE)

    def find_ratios(self) -> tuple[float, float] | None:
        """Return the least and largest stiffness over that of the best fit [-], at the middle of the forces, for the
        ``contact_stiffness`` of a data sheet; None: the slope is not known at all.
        """
        try:
            softer, stiffer = self.reserve_factors(float(np.median(self.forces)))
        except InvalidInput:
            return None
        return 1.0 / softer, stiffer

    def reserve_factors(self, force: float) -> tuple[float, float]:
        """Return how many times softer and stiffer than its best fit the contact may be [-], for ``Reserve(softer=)``
        and ``stiffer=``: the ratios of K for the interval of the slope at a force.

        Raises:
            InvalidInput: the force is beyond those of the closings, or the slope is not known at all.
        """
        slope, rho = self.slope(force), self.fits[0, 2]
        if slope.low <= 0:
            raise InvalidInput(
                f"contact: expected a slope that is known, got {slope.low:.3g} to {slope.high:.3g}: log closings with "
                "more limits of the force"
            )
        return float((slope.value / slope.low) ** rho), float((slope.high / slope.value) ** rho)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedClosings:
    """The results from logs of closings.

    Attributes:
        table: peaks by speed and limit.
        peaks: {(speed, limit): peaks of the trials}.
        sensor_lag: time constant by which the force register follows the force [s]; None if the log does not determine
            it.
        free_speeds: {commanded speed: speed of the position before the contact [position unit/s]}.
        contact: force over closing distance; None if the log does not determine it.
        unknown: what these logs do not determine, each with the experiment that would.
        remarks: what was left out, and other remarks.
    """

    table: ClosingTable
    peaks: dict[tuple[float, float], Array]
    sensor_lag: Estimate | None
    free_speeds: dict[float, float]
    contact: ContactFit | None
    unknown: tuple[str, ...]
    remarks: tuple[str, ...]

    __repr__ = brief("table", "sensor_lag", "contact", "unknown")


class _Closing(NamedTuple):
    """One closing: samples of one log from the opening before it to the next."""

    speed: float
    limit: float
    peak: float
    rest: float  # position at the peak, where the finger stands still
    lag: float  # [s]; NaN where the decay is not in the log
    free_speed: float  # NaN where the way before the contact is not in the log


def identify_closings(
    logs: Iterable[Log], *, newtons: Sequence[float] | None = None, seed: int = 0
) -> IdentifiedClosings:
    """Identify from logs how hard a finger presses when it closes on a stop.

    Args:
        logs: logs with ``speed`` and ``limit``; a closing is the part between two openings.
        newtons: slope and offset of newtons over counts, for forces in counts; None: forces stay in counts.
        seed: of the bootstrap.

    Raises:
        InvalidInput: no logs, logs of different units, without speed or limit, or without a closing; ``newtons`` for
            forces that are already in newtons.
    """
    found = items_of("logs", logs, Log)
    if not found:
        raise InvalidInput("logs: expected one or more, got none")
    units = found[0].units
    for log in found:
        if log.units != units:
            raise InvalidInput(
                f"logs: expected one set of units, got {dict(units)} and {dict(log.units)} ({log.source})"
            )
    scale, offset = _newtons(newtons, units["force"])
    closings: list[_Closing] = []
    remarks: list[str] = []
    for log in found:
        these, empty = _find_closings(log, scale, offset)
        closings += these
        if empty:
            remarks.append(f"{log.source}: {empty} rises of the force are left out because they are not closings")
    if not closings:
        raise InvalidInput(
            "logs: expected closings on a stop, got none: the force never rises over its scatter at rest"
        )
    unit: Literal["N", "count"] = "N" if units["force"] == "N" or newtons is not None else "count"
    peaks = {
        pair: read_only(np.array([one.peak for one in closings if (one.speed, one.limit) == pair]))
        for pair in sorted({(one.speed, one.limit) for one in closings})
    }
    table = _tabulate(peaks, unit)
    rng = np.random.default_rng(seed)
    lags = np.array([one.lag for one in closings if np.isfinite(one.lag)])
    lag = _estimate(lags, rng) if len(lags) >= 3 else None
    contact = _fit_contact(closings, rng)
    unknown = list(_name_unknown(table, lag, contact, units["position"], unit))
    return IdentifiedClosings(
        table=table,
        peaks=peaks,
        sensor_lag=lag,
        free_speeds=_find_free_speeds(closings),
        contact=contact,
        unknown=tuple(unknown),
        remarks=tuple(remarks),
    )


def _newtons(newtons: Sequence[float] | None, unit: str) -> tuple[float, float]:
    if newtons is None:
        return 1.0, 0.0
    slope, offset = array_of("newtons", newtons, (2,)).tolist()
    if unit == "N" or slope <= 0:
        raise InvalidInput(f"newtons: expected slope > 0 and offset for forces in counts, got {newtons} for {unit}")
    return slope, offset


def _find_closings(log: Log, slope: float, offset: float) -> tuple[list[_Closing], int]:
    """The closings of a log, their forces in newtons where slope and offset say so, and how many rises of
    the force were none.
    """
    if log.speed is None or log.limit is None:
        missing = " and ".join(name for name in ("speed", "limit") if getattr(log, name) is None)
        raise InvalidInput(
            f"log {log.source}: expected {missing}, got none: name its column, or the number that holds for the whole "
            "file (speed=250)"
        )
    rest = float(np.quantile(log.force, _REST))
    scatter = float(np.median(np.abs(np.diff(log.force))))
    threshold = rest + max(_NOISE * scatter, _LEAST * (float(log.force.max()) - rest))
    found, empty = [], 0
    for rows in _split(log.force, rest, threshold):
        force, position = log.force[rows], log.position[rows]
        last = _find_last_peak(force)
        at = rows.start + int(np.argmax(force > threshold))
        if at == 0 or force[last] - rest < _CLEAR * (threshold - rest):  # pressed already as the log began, or shook
            empty += 1
            continue
        top = rows.start + int(np.argmax(force))
        peak = slope * float(force[last]) + offset
        found.append(
            _Closing(
                speed=float(log.speed[top]),
                limit=float(log.limit[top]),
                peak=peak,
                rest=float(position[last]),
                lag=_find_lag(log.time[rows], force - rest, position, last),
                free_speed=_find_free_speed(log, rows.start, at),
            )
        )
    return found, empty


def _split(force: Array, rest: float, threshold: float) -> list[slice]:
    """Samples from one return of the force to rest to the next; numbers of trials would cut where their authors like,
    as between a peak and its decay.
    """
    # Over the threshold it presses, under half of it it rests, and in between it goes on with what it did.
    state = np.select([force > threshold, force < (rest + threshold) / 2], [1, -1], 0)
    known = np.maximum.accumulate(np.where(state != 0, np.arange(len(force)), 0))
    presses = state[known] == 1
    ends = np.flatnonzero(presses[:-1] & ~presses[1:]) + 1
    edges = [0, *ends.tolist(), len(force)]
    return [slice(one, other) for one, other in itertools.pairwise(edges) if presses[one:other].any()]


def _find_last_peak(force: Array) -> int:
    """Last sample of the largest force."""
    return len(force) - 1 - int(np.argmax(force[::-1]))


def _find_lag(time: Array, force: Array, position: Array, peak: int) -> float:
    """Time constant of the decay after the finger has opened: force there is none, and the register still falls."""
    way = np.abs(position - position[peak])
    open_ = way > _MOVES * max(float(np.ptp(position)), 1e-12)
    after = np.arange(len(force)) > peak
    share = force / max(force[peak], 1e-12)
    rows = after & open_ & (share > _DECAY[0]) & (share < _DECAY[1])
    if rows.sum() < 5:
        return float("nan")
    times, logs = time[rows], np.log(share[rows])
    slope, start = np.polyfit(times, logs, 1)
    left = logs - (slope * times + start)
    return float(-1 / slope) if slope < 0 and np.abs(left).max() < _CURVED else float("nan")


def _find_free_speed(log: Log, first: int, contact: int) -> float:
    """Speed of the last half of the way before the contact [position unit/s]."""
    position, time = log.position[first : contact + 1], log.time[first : contact + 1]
    whole = position[-1] - position[0]
    rows = (np.abs(position - position[0]) > abs(whole) / 2) & (np.abs(position[-1] - position) > 0.05 * abs(whole))
    if rows.sum() < 3 or whole == 0:
        return float("nan")
    return float(abs(np.polyfit(time[rows], position[rows], 1)[0]))


def _find_free_speeds(closings: list[_Closing]) -> dict[float, float]:
    speeds = {}
    for speed in sorted({one.speed for one in closings}):
        values = [one.free_speed for one in closings if one.speed == speed and np.isfinite(one.free_speed)]
        if values:
            speeds[speed] = float(np.median(values))
    return speeds


def _tabulate(peaks: dict[tuple[float, float], Array], unit: Literal["N", "count"]) -> ClosingTable:
    speeds, limits = np.array(list(peaks)).T
    median = np.array([np.median(values) for values in peaks.values()])
    low, high = np.array([np.quantile(values, _TRIALS, method="inverted_cdf") for values in peaks.values()]).T
    return ClosingTable(
        speeds=tuple(speeds.tolist()),
        limits=tuple(limits.tolist()),
        peaks=tuple(median.tolist()),
        low=tuple(np.minimum(low, median).tolist()),
        high=tuple(np.maximum(high, median).tolist()),
        trials=tuple(len(values) for values in peaks.values()),
        unit=unit,
    )


def _estimate(values: Array, rng: np.random.Generator) -> Estimate:
    drawn = np.median(values[rng.integers(len(values), size=(_RESAMPLES, len(values)))], axis=1)
    return widen(float(np.median(values)), drawn)


def _fit_contact(closings: list[_Closing], rng: np.random.Generator) -> ContactFit | None:
    """The law through the closings' rests; None where there are too few, or where they lie at one place."""
    x, f = np.array([one.rest for one in closings]), np.array([one.peak for one in closings])
    if len(np.unique(x)) < 4 or f.min() <= 0 or f.max() < 2 * f.min():
        return None
    sign = 1.0 if np.polyfit(x, f, 1)[0] > 0 else -1.0
    x = sign * x
    fits = [_fit_power(x, f)]
    for _ in range(_RESAMPLES // 4):
        drawn = rng.integers(len(x), size=len(x))
        if len(np.unique(x[drawn])) >= 4:
            fits.append(_fit_power(x[drawn], f[drawn], fits[0]))
    start, stiffness, exponent = (widen(column[0], column, _WIDER) for column in np.array(fits).T)
    modelled = stiffness.value * np.maximum(x - start.value, 0) ** exponent.value
    if sign < 0:
        start = Estimate(-start.value, -start.high, -start.low)
    return ContactFit(
        positions=read_only(sign * x),
        forces=read_only(f),
        start=start,
        stiffness=stiffness,
        exponent=exponent,
        error=float(np.median(np.abs(modelled / f - 1))),
        fits=read_only(np.array(fits)),
    )


def _fit_power(x: Array, f: Array, near: tuple[float, float, float] | None = None) -> tuple[float, float, float]:
    """Start, K and rho of f = K (x - start)^rho, least squares of the relative error; from several starts, or ``near``
    a fit of like data.
    """
    width, least = float(np.ptp(x)), float(x.min())
    bounds = ([least - 5 * width, -np.inf, 0.3], [least, np.inf, 6.0])

    def residual(p: Array) -> Array:
        log_force: Array = p[1] + p[2] * np.log(np.maximum(x - p[0], 1e-9 * width) / width)
        return log_force - np.log(f)

    firsts = [[least - ahead * width, np.log(np.median(f)), 1.5] for ahead in (0.05, 0.3, 1.0)]
    if near is not None:
        begin = float(np.clip(near[0], bounds[0][0], least - 1e-6 * width))
        firsts = [[begin, np.log(near[1] * width ** near[2]), near[2]]]
    fits = [least_squares(residual, first, loss="soft_l1", bounds=bounds) for first in firsts]
    start, log_f, exponent = min(fits, key=lambda fit: fit.cost).x
    return float(start), float(np.exp(log_f) / width**exponent), float(exponent)


def _name_unknown(
    table: ClosingTable, lag: Estimate | None, contact: ContactFit | None, position: str, force: str
) -> Iterable[str]:
    if force == "count":
        yield "newtons: forces are counts; press on a scale at five limits or more, and give slope and offset"
    if position == "count":
        yield "depth in metres: positions are counts; measure how far the fingertip moves between two positions"
    if lag is None:
        yield "lag of the force sensor: the log has no decay after an opening; continue to log while the finger opens"
    if contact is None:
        yield "contact law: all closings end at one position or force; close with limits from the least to the largest"
    if len(np.unique(table.speeds)) < 2:
        yield "overshoot by speed: the logs have only one speed; close twice as fast once"
    yield "latency from command to motion: the log has no time at which a command was sent"
