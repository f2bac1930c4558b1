"""Forces of a finger that closes on a stop: measured peaks by commanded speed and force limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from pinograsp.checks import array_of, brief, number, one_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.estimates import Estimate

_FORCES = 50  # that are tried between the gentlest and the strongest closing
_SAME = 1e-9  # relative: one speed, or one limit


class ClosingCommand(NamedTuple):
    """The command for a force: closing speed and force limit, in register units, and the expected peak."""

    speed: float
    limit: float
    peak: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosingTable:
    """The largest forces of a finger that closed on a stop, by commanded speed and force limit (c conditions).

    A finger stops late, because its sensor lags and its drive continues. So it presses with more than its limit, the
    more the faster it closes, up to the effort of its drive. Between the conditions that were tried, the peak is
    assumed to grow with speed and with limit, without any other law: see :meth:`predict`.

    Attributes:
        speeds, limits: commanded (c,) in the units of the drive's registers; speeds above 0.
        peaks, low, high: median, 5th and 95th percentile of the peaks of the trials (c,) [``unit``].
        trials: number of trials (c,).
        unit: ``N``, or ``count`` if the force per count is unknown.
        position: commanded with speed and limit, in register units: the closed end, so that the limit stops the finger;
            None: it is not known, or none is sent.

    Raises:
        InvalidInput: the values do not describe such a table.
    """

    speeds: tuple[float, ...]
    limits: tuple[float, ...]
    peaks: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    trials: tuple[int, ...]
    unit: Literal["N", "count"] = "N"
    position: float | None = None

    __repr__ = brief("speeds", "limits", "peaks", "unit")

    def __post_init__(self) -> None:
        speeds = array_of("speeds of a closing table", self.speeds, (None,))
        if not len(speeds):
            raise InvalidInput("closing table: expected one or more conditions, got none")
        for name in ("speeds", "limits", "peaks", "low", "high", "trials"):
            values = array_of(f"{name} of a closing table", getattr(self, name), (len(speeds),))
            if name in ("speeds", "trials") and not np.all(values > 0):
                raise InvalidInput(f"{name} of a closing table: expected values > 0, got {values.tolist()}")
            object.__setattr__(self, name, tuple((values.astype(int) if name == "trials" else values).tolist()))
        if not all(low <= peak <= high for low, peak, high in zip(self.low, self.peaks, self.high)):
            raise InvalidInput("closing table: expected low <= peaks <= high, condition by condition")
        if len(set(zip(self.speeds, self.limits))) < len(speeds):
            raise InvalidInput("closing table: expected each pair of speed and limit once, got one twice")
        one_of("unit of a closing table", self.unit, ("N", "count"))
        if self.position is not None:
            object.__setattr__(self, "position", number("position of a closing table", self.position))

    def predict(self, speed: float, limit: float) -> Estimate:
        """Predict the peak at a speed and limit within those that were tried.

        Between two limits of one speed it is linear. Between two speeds the peak may be that of either, and no table
        shows where the one turns into the other. There 1 / peak is linear in the logarithm of the speed; in the middle
        this is the value whose largest relative error over all possible peaks is least. The interval contains all peaks
        that are possible if they grow with speed and limit, and the scatter of the trials.

        Raises:
            InvalidInput: a speed or limit beyond those that were tried.
        """
        speed, limit = number("speed", speed, above=0), number("limit", limit, at_least=0)
        rows = [(tried, row) for tried in sorted(set(self.speeds)) if (row := self._at_limit(tried, limit)) is not None]
        slower = [one for one in rows if one[0] <= speed * (1 + _SAME)]
        faster = [one for one in rows if one[0] >= speed * (1 - _SAME)]
        if not slower or not faster:
            raise InvalidInput(
                f"closing table: expected a speed and a limit within what was tried, {self.describe_tried()}, got "
                f"{speed:g} and {limit:g}: log closings there, too"
            )
        (slow, one), (fast, other) = slower[-1], faster[0]
        share = 0.0 if fast <= slow * (1 + _SAME) else math.log(speed / slow) / math.log(fast / slow)
        values = max(one.value, _SAME), max(other.value, _SAME)
        return Estimate(
            1 / ((1 - share) / values[0] + share / values[1]), min(one.low, other.low), max(one.high, other.high)
        )

    def _at_limit(self, speed: float, limit: float) -> Estimate | None:
        """The peak at a speed that was tried; None where its limits do not reach as far."""
        rows = self._rows(speed)
        limits = np.array(self.limits)[rows]
        if not limits[0] * (1 - _SAME) <= limit <= limits[-1] * (1 + _SAME):
            return None
        after = min(int(np.searchsorted(limits, limit * (1 - _SAME))), len(rows) - 1)
        if math.isclose(limits[after], limit, rel_tol=_SAME):
            i = rows[after]
            return Estimate(self.peaks[i], self.low[i], self.high[i])
        one, other = rows[after - 1], rows[after]
        value = np.interp(limit, limits[after - 1 : after + 1], [self.peaks[one], self.peaks[other]])
        return Estimate(float(value), min(self.low[one], self.low[other]), max(self.high[one], self.high[other]))

    def _rows(self, speed: float) -> list[int]:
        """Conditions of a speed, by their limits."""
        return sorted((i for i, tried in enumerate(self.speeds) if tried == speed), key=lambda i: self.limits[i])

    def find_touch(self, cap: float) -> ClosingCommand:
        """Find the fastest closing among those tried whose peak stays under a cap [``unit``] in 95 % of the trials, and
        the lowest limit for it.

        Raises:
            InvalidInput: no closing keeps the cap; the message says how near the gentlest comes.
        """
        cap = number("cap", cap, above=0)
        keeps = [i for i, high in enumerate(self.high) if high <= cap]
        if not keeps:
            i = int(np.argmin(self.high))
            raise InvalidInput(
                f"cap: expected one that some closing keeps in 95 % of its trials, got {cap:g} {self.unit}: the "
                f"gentlest that was tried, speed {self.speeds[i]:g} and limit {self.limits[i]:g}, came to "
                f"{self.peaks[i]:.4g} in the median and {self.high[i]:.4g} at the 95th percentile: log a slower one or "
                "a lower limit, or close by position"
            )
        i = min(keeps, key=lambda k: (-self.speeds[k], self.limits[k]))
        return ClosingCommand(self.speeds[i], self.limits[i], self.predict(self.speeds[i], self.limits[i]))

    def find_strongest(self, cap: float) -> ClosingCommand:
        """Find the closing of :meth:`find_command` with the largest peak that stays under a cap [``unit``] in 95 % of
        the trials; else the fastest touch.

        Raises:
            InvalidInput: no closing keeps the cap, as for :meth:`find_touch`.
        """
        forces = np.linspace(min(self.peaks), max(self.peaks), _FORCES)
        keeping = [one for one in map(self.find_command, forces[forces <= cap]) if one.peak.high <= cap]
        return max(keeping, key=lambda one: one.peak.value) if keeping else self.find_touch(cap)

    def find_command(self, force: float) -> ClosingCommand:
        """Find speed and limit for a peak force [``unit``]: the slowest speed that reaches it, at which the peak
        depends least on the commands. If the limits that were tried are whole numbers, so is the found one, rounded up.

        Raises:
            InvalidInput: a force below the gentlest or above the strongest closing.
        """
        force = number("force", force, above=0)
        for speed in sorted(set(self.speeds)):
            rows = self._rows(speed)
            rising = np.maximum.accumulate([self.peaks[i] for i in rows])
            if rising[0] <= force <= rising[-1]:
                limit = float(np.interp(force, rising, [self.limits[i] for i in rows]))
                if all(tried.is_integer() for tried in self.limits):  # a register takes no other
                    limit = math.ceil(limit - _SAME)
                return ClosingCommand(speed, limit, self.predict(speed, limit))
        raise InvalidInput(
            f"force: expected {min(self.peaks):.4g} to {max(self.peaks):.4g} {self.unit}, which this finger presses "
            f"with at what was tried, got {force:g}"
        )

    def __str__(self) -> str:
        """The range of the peaks, and what was tried."""
        return f"{min(self.peaks):.4g} to {max(self.peaks):.4g} {self.unit} at {self.describe_tried()}"

    def describe_tried(self) -> str:
        """Describe the speeds and limits that were tried."""
        return (
            f"speeds {min(self.speeds):g} to {max(self.speeds):g} and limits {min(self.limits):g} to "
            f"{max(self.limits):g}"
        )
