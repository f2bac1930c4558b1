"""The compliant contact law, the penetration profile and the two grasp-energy measures.

With s = t_F - t and tau = t_F - t_I, a constant deceleration of magnitude A gives (Eqs. 20-24)

    ddelta = A s,   delta = (A / 2) (tau^2 - s^2),   impact speed A tau,   final depth delta_F = A tau^2 / 2,

and the normal force at t_F is K delta_F^rho (Eq. 26), since the penetration has come to rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import array_of, number
from pinograsp.errors import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """Marhefka-Orin contact law F_n = (lambda ddelta + K) delta^rho (Eq. 4, [3] of the paper).

    Attributes:
        stiffness: K [N/m^rho]. damping: lambda [N s/m^(rho+1)]. exponent: rho [-].
    """

    stiffness: float = 5.0e4
    damping: float = 100.0
    exponent: float = 1.5

    def __post_init__(self):
        object.__setattr__(self, "stiffness", number("contact stiffness K", self.stiffness, above=0, unit="N/m^rho"))
        object.__setattr__(self, "damping", number("contact damping lambda", self.damping, at_least=0))
        object.__setattr__(self, "exponent", number("contact exponent rho", self.exponent, above=0))

    def normal_force(self, depth, rate=0.0):
        """F_n [N] at penetration ``depth`` [m] and ``rate`` [m/s] (Eq. 4); zero where there is no penetration."""
        depth = np.maximum(depth, 0.0)
        return (self.damping * np.asarray(rate) + self.stiffness) * depth**self.exponent

    def depth(self, force):
        """Penetration [m] at rest under a normal force [N]: the inverse of Eq. (26)."""
        return (np.asarray(force, dtype=float) / self.stiffness) ** (1 / self.exponent)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PenetrationProfile:
    """Penetration of k contacts under constant deceleration (Eqs. 20-24).

    Attributes:
        acceleration: A (k,), magnitude of the deceleration [m/s^2].
        impact_time: t_I [s]. final_time: t_F [s].
    """

    acceleration: np.ndarray
    impact_time: float
    final_time: float

    def __post_init__(self):
        acceleration = array_of("acceleration", self.acceleration, (None,))
        if np.any(acceleration < 0):
            raise InvalidInput(f"acceleration: expected magnitudes >= 0 [m/s^2], got {acceleration.tolist()}")
        object.__setattr__(self, "acceleration", acceleration)
        object.__setattr__(self, "impact_time", number("impact time", self.impact_time, at_least=0, unit="s"))
        object.__setattr__(self, "final_time", number("final time", self.final_time, above=self.impact_time, unit="s"))

    @property
    def duration(self) -> float:
        """tau = t_F - t_I [s]."""
        return self.final_time - self.impact_time

    def _to_go(self, t) -> np.ndarray:
        """s = t_F - t, held at tau before the impact and at 0 after the end; shape of t with one axis added."""
        return np.clip(self.final_time - np.asarray(t, dtype=float), 0.0, self.duration)[..., None]

    def depth(self, t) -> np.ndarray:
        """delta (..., k) [m] at times t [s] (Eq. 24b)."""
        return self.acceleration / 2 * (self.duration**2 - self._to_go(t) ** 2)

    def rate(self, t) -> np.ndarray:
        """ddelta (..., k) [m/s] at times t [s] (Eq. 21b); zero before the impact."""
        started = np.asarray(t, dtype=float)[..., None] >= self.impact_time
        return np.where(started, self.acceleration * self._to_go(t), 0.0)

    @property
    def impact_speed(self) -> np.ndarray:
        """A tau (k,) [m/s] (Eq. 22)."""
        return self.acceleration * self.duration

    @property
    def final_depth(self) -> np.ndarray:
        """A tau^2 / 2 (k,) [m]."""
        return self.acceleration / 2 * self.duration**2


def _beta(a: float, b: float) -> float:
    return math.exp(math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b))


def impulse_energy(compliance: Compliance, final_depth, duration: float):
    """Grasp-energy measure "impulse" [N s] per contact: Eq. (11) as printed, the integral over *time*.

    lambda delta_F^(rho+1) + c K tau delta_F^rho with c = (rho+1) B(rho+1, 1/2) / 2, for constant deceleration that ends
    at depth ``final_depth`` [m] after ``duration`` = tau [s].
    """
    rho = compliance.exponent
    depth = np.asarray(final_depth, dtype=float)
    c = (rho + 1) * _beta(rho + 1, 0.5) / 2
    return compliance.damping * depth ** (rho + 1) + c * compliance.stiffness * duration * depth**rho


def work_energy(compliance: Compliance, final_depth, duration: float):
    """Grasp-energy measure "work" [J] per contact: Eq. (9) integrated over *depth*.

    K delta_F^(rho+1) + 2 (rho+1) lambda delta_F^(rho+2) B(3/2, rho+1) / tau, for constant deceleration that ends at
    depth ``final_depth`` [m] after ``duration`` = tau [s].
    """
    rho = compliance.exponent
    depth = np.asarray(final_depth, dtype=float)
    damped = 2 * (rho + 1) * compliance.damping * depth ** (rho + 2) * _beta(1.5, rho + 1) / duration
    return compliance.stiffness * depth ** (rho + 1) + damped
