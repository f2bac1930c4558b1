"""How a path's parameter moves in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pinograsp.checks import brief
from pinograsp.spatial import Array


class Instants(NamedTuple):
    """Path parameter, its speed, acceleration and jerk at m instants, each (m,) [1, 1/s, 1/s^2, 1/s^3]."""

    s: Array
    speed: Array
    acceleration: Array
    jerk: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timing:
    """The path parameter s over time: of constant acceleration between knots, or the moving average of such a motion.

    The moving average of s keeps to the path and takes longer by its window; its acceleration changes over no less than
    the window instead of at once.

    Attributes:
        times: of the knots (m,) [s], from 0.
        s: there (m,), from 0 to 1.
        speed: there (m,) [1/s].
        window: of the moving average [s]; 0: none.
    """

    times: Array
    s: Array
    speed: Array
    window: float = 0.0

    __repr__ = brief("duration", "window")

    @classmethod
    def of_squares(cls, s: Array, y: Array) -> Timing:
        """The timing with squared speeds y (m,) [1/s^2] at parameters s (m,)."""
        speed = np.sqrt(y)
        took = 2.0 * np.diff(s) / (speed[:-1] + speed[1:])
        return cls(times=np.concatenate([[0.0], np.cumsum(took)]), s=s, speed=speed)

    @classmethod
    def steady(cls, duration: float) -> Timing:
        """The timing of a trajectory, whose parameter is time itself."""
        ends = np.array([0.0, 1.0])
        return cls(times=duration * ends, s=ends, speed=np.full(2, 1.0 / duration))

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1]) + self.window

    def smooth(self, window: float) -> Timing:
        """Its moving average over a window [s]."""
        return replace(self, window=window)

    def speed_up(self, factor: float) -> Timing:
        """The same motion, ``factor`` times as fast."""
        return replace(self, times=self.times / factor, speed=self.speed * factor, window=self.window / factor)

    def at(self, times: Array) -> Instants:
        """The motion at instants (m,) [s]; the acceleration at a knot is that after it."""
        if not self.window:
            return self._plain(times)[1]
        now, since = self._plain(times), self._plain(times - self.window)
        mean = [(a - b) / self.window for a, b in zip((now[0], *now[1][:3]), (since[0], *since[1][:3]))]
        return Instants(np.clip(mean[0], 0.0, 1.0), *mean[1:])

    def _plain(self, times: Array) -> tuple[Array, Instants]:
        """The integral of s, and the motion without a moving average; at rest before and after it."""
        step = np.diff(self.times)
        rise = np.diff(self.speed) / step
        area = step * self.s[:-1] + step**2 * self.speed[:-1] / 2.0 + step**3 * rise / 6.0
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(step) - 1)
        t = np.clip(times, 0.0, self.times[-1]) - self.times[i]
        s, v, a = self.s[i], self.speed[i], rise[i]
        whole = np.concatenate([[0.0], np.cumsum(area)])[i] + t * s + t**2 * v / 2.0 + t**3 * a / 6.0
        whole = whole + np.maximum(times - self.times[-1], 0.0)
        inside = (times >= 0.0) & (times <= self.times[-1])
        moving = Instants(
            np.clip(s + t * v + t**2 * a / 2.0, 0.0, 1.0),
            np.where(inside, np.maximum(v + t * a, 0.0), 0.0),
            np.where(inside, a, 0.0),
            np.zeros_like(t),
        )
        return whole, moving
