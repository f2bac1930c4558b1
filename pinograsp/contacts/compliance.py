"""The compliant contact law, the penetration profile and the two grasp-energy measures.

With s = t_F - t and tau = t_F - t_I, a constant deceleration of magnitude A gives (Eqs. 20-24)

    ddelta = A s,   delta = (A / 2) (tau^2 - s^2),   impact speed A tau,   final depth delta_F = A tau^2 / 2,

and the normal force at t_F is K delta_F^rho (Eq. 26), since the penetration has come to rest. Any other shape of the
deceleration, A alpha((t - t_I) / tau), changes the factors only: impact speed v A tau, final depth m A tau^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinograsp.checks import array_of, number, one_of
from pinograsp.contacts.deceleration import CONSTANT, DecelerationShape
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
    """Penetration of k contacts that decelerate to rest, all in the same shape (Eqs. 20-24 for the constant one).

    Attributes:
        acceleration: A (k,), magnitude of the peak deceleration [m/s^2].
        impact_time: t_I [s]. final_time: t_F [s].
        shape: deceleration / A over u = (t - t_I) / tau.
    """

    acceleration: np.ndarray
    impact_time: float
    final_time: float
    shape: DecelerationShape = CONSTANT

    def __post_init__(self):
        acceleration = array_of("acceleration", self.acceleration, (None,))
        if np.any(acceleration < 0):
            raise InvalidInput(f"acceleration: expected magnitudes >= 0 [m/s^2], got {acceleration.tolist()}")
        if not isinstance(self.shape, DecelerationShape):
            raise InvalidInput(
                f"deceleration shape: expected a DecelerationShape, got {self.shape!r}: "
                "build one with DecelerationShape.constant, linear, polynomial or sampled"
            )
        object.__setattr__(self, "acceleration", acceleration)
        object.__setattr__(self, "impact_time", number("impact time", self.impact_time, at_least=0, unit="s"))
        object.__setattr__(self, "final_time", number("final time", self.final_time, above=self.impact_time, unit="s"))

    @property
    def duration(self) -> float:
        """tau = t_F - t_I [s]."""
        return self.final_time - self.impact_time

    def _phase(self, t) -> np.ndarray:
        """u = (t - t_I) / tau, below 0 before the impact and above 1 after the end; shape of t with one axis added."""
        return ((np.asarray(t, dtype=float) - self.impact_time) / self.duration)[..., None]

    def depth(self, t) -> np.ndarray:
        """delta (..., k) [m] at times t [s] (Eq. 24b); zero before the impact, ``final_depth`` after the end."""
        return self.acceleration * (self.duration**2 * self.shape.depth(self._phase(t)))

    def rate(self, t) -> np.ndarray:
        """ddelta (..., k) [m/s] at times t [s] (Eq. 21b); zero before the impact and after the end."""
        u = self._phase(t)
        return np.where(u >= 0, self.acceleration * (self.duration * self.shape.rate(u)), 0.0)

    @property
    def impact_speed(self) -> np.ndarray:
        """v A tau (k,) [m/s] (Eq. 22, where v = 1)."""
        return self.acceleration * (self.duration * self.shape.speed_factor)

    @property
    def final_depth(self) -> np.ndarray:
        """m A tau^2 (k,) [m]; m = 1/2 for the constant shape."""
        return self.acceleration * (self.duration**2 * self.shape.depth_factor)


def impulse_energy(compliance: Compliance, final_depth, duration: float, shape: DecelerationShape = CONSTANT):
    """Grasp-energy measure "impulse" [N s] per contact: Eq. (11) as printed, the integral over *time*.

    lambda delta_F^(rho+1) + c K tau delta_F^rho for a deceleration of ``shape`` that ends at depth ``final_depth`` [m]
    after ``duration`` = tau [s]; c is the shape's ``impulse_factor``, (rho+1) B(rho+1, 1/2) / 2 for the constant one.
    """
    rho = compliance.exponent
    depth = np.asarray(final_depth, dtype=float)
    c = shape.impulse_factor(rho)
    return compliance.damping * depth ** (rho + 1) + c * compliance.stiffness * duration * depth**rho


def work_energy(compliance: Compliance, final_depth, duration: float, shape: DecelerationShape = CONSTANT):
    """Grasp-energy measure "work" [J] per contact: Eq. (9) integrated over *depth*.

    K delta_F^(rho+1) + c lambda delta_F^(rho+2) / tau for a deceleration of ``shape`` that ends at ``final_depth`` [m]
    after ``duration`` = tau [s]; c is the shape's ``work_factor``, 2 (rho+1) B(3/2, rho+1) for the constant one.
    """
    rho = compliance.exponent
    depth = np.asarray(final_depth, dtype=float)
    damped = shape.work_factor(rho) * compliance.damping * depth ** (rho + 2) / duration
    return compliance.stiffness * depth ** (rho + 1) + damped


def energy_terms(
    compliance: Compliance, measure: str, duration: float, shape: DecelerationShape = CONSTANT
) -> tuple[tuple[float, float], ...]:
    """A measure as a sum of powers of the final normal force F = K delta_F^rho [N] (Eq. 26).

    Pairs (coefficient, exponent) with energy = sum of coefficient F^exponent, after ``duration`` = tau [s]: in N s for
    ``"impulse"`` (Eq. 11) and in J for ``"work"`` (Eq. 9). Every exponent is at least 1, every coefficient above 0.
    """
    K, damping, rho = compliance.stiffness, compliance.damping, compliance.exponent
    if one_of("measure", measure, ("impulse", "work")) == "impulse":
        stiff = (shape.impulse_factor(rho) * duration, 1.0)
        return ((damping * K ** (-(rho + 1) / rho), (rho + 1) / rho), stiff) if damping > 0 else (stiff,)
    stiff = (K ** (-1 / rho), (rho + 1) / rho)
    if damping == 0:
        return (stiff,)
    return (stiff, (shape.work_factor(rho) * damping / duration * K ** (-(rho + 2) / rho), (rho + 2) / rho))
