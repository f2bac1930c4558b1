"""How deep contacts are over the grasp phase: the penetration profile.

With s = t_F - t and tau = t_F - t_I, a constant deceleration of magnitude A gives (Eqs. 20-24)

    ddelta = A s,   delta = (A / 2) (tau^2 - s^2),   impact speed A tau,   final depth delta_F = A tau^2 / 2.

Any other shape of the deceleration, A alpha((t - t_I) / tau), changes the factors only: impact speed v A tau, final
depth m A tau^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, finite_of, number, shorten
from pinograsp.contacts.deceleration import CONSTANT, DecelerationShape
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

_LONGEST = 1e9  # [s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PenetrationProfile:
    """Penetration of k contacts that decelerate to rest, all in the same shape (Eqs. 20-24 for the constant one).

    Attributes:
        acceleration: A (k,), magnitude of the peak deceleration [m/s^2].
        impact_time: t_I [s].
        final_time: t_F [s].
        shape: deceleration / A over u = (t - t_I) / tau.
    """

    acceleration: Array
    impact_time: float
    final_time: float
    shape: DecelerationShape = CONSTANT

    __repr__ = brief()

    def __post_init__(self) -> None:
        acceleration = array_of("acceleration", self.acceleration, (None,))
        if np.any(acceleration < 0):
            raise InvalidInput(f"acceleration: expected magnitudes >= 0 [m/s^2], got {acceleration.tolist()}")
        if not isinstance(self.shape, DecelerationShape):
            raise InvalidInput(
                f"deceleration shape: expected a DecelerationShape, got {shorten(self.shape)}: "
                "build one with DecelerationShape.constant, linear, polynomial or sampled"
            )
        object.__setattr__(self, "acceleration", acceleration)
        object.__setattr__(self, "impact_time", number("impact time", self.impact_time, at_least=0, unit="s"))
        object.__setattr__(
            self,
            "final_time",
            number("final time", self.final_time, above=self.impact_time, at_most=_LONGEST, unit="s"),
        )

    @property
    def duration(self) -> float:
        """tau = t_F - t_I [s]."""
        return self.final_time - self.impact_time

    def _phase(self, t: ArrayLike) -> Array:
        """u = (t - t_I) / tau, below 0 before the impact and above 1 after the end; shape of t with one axis added."""
        return ((finite_of("time", t) - self.impact_time) / self.duration)[..., None]

    def depth(self, t: ArrayLike) -> Array:
        """delta (..., k) [m] at times t [s] (Eq. 24b); zero before the impact, ``final_depth`` after the end."""
        return self.acceleration * (self.duration**2 * self.shape.depth(self._phase(t)))

    def rate(self, t: ArrayLike) -> Array:
        """ddelta (..., k) [m/s] at times t [s] (Eq. 21b); zero before the impact and after the end."""
        u = self._phase(t)
        return np.where(u >= 0, self.acceleration * (self.duration * self.shape.rate(u)), 0.0)

    @property
    def impact_speed(self) -> Array:
        """v A tau (k,) [m/s] (Eq. 22, where v = 1)."""
        return self.acceleration * (self.duration * self.shape.speed_factor)

    @property
    def final_depth(self) -> Array:
        """m A tau^2 (k,) [m]; m = 1/2 for the constant shape."""
        return self.acceleration * (self.duration**2 * self.shape.depth_factor)
