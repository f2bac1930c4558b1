"""The compliant contact law, the penetration profile and the two grasp-energy measures.

With s = t_F - t and tau = t_F - t_I, a constant deceleration of magnitude A gives (Eqs. 20-24)

    ddelta = A s,   delta = (A / 2) (tau^2 - s^2),   impact speed A tau,   final depth delta_F = A tau^2 / 2,

and the normal force at t_F is K delta_F^rho (Eq. 26), since the penetration has come to rest. Any other shape of the
deceleration, A alpha((t - t_I) / tau), changes the factors only: impact speed v A tau, final depth m A tau^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ellipkm1, elliprd

from pinograsp.checks import alike, array_of, at_least_zero, brief, finite_of, instance_of, number, one_of, shown
from pinograsp.contacts.deceleration import CONSTANT, DecelerationShape
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

Measure = Literal["impulse", "work"]
MEASURES: tuple[Measure, ...] = get_args(Measure)
# A gap that opens this much more slowly in one direction than the bodies curve is a line contact: what is left of a
# difference of two equal curvatures is rounding, and the patch would be ten thousand times longer than wide.
_LINE = 1e-9
_LONGEST = 1e9  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """Marhefka-Orin contact law F_n = (lambda ddelta + K) delta^rho (Eq. 4, [3] of the paper).

    Attributes:
        stiffness: K [N/m^rho].
        damping: lambda [N s/m^(rho+1)].
        exponent: rho [-].
    """

    stiffness: float = 5.0e4
    damping: float = 100.0
    exponent: float = 1.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", number("contact stiffness K", self.stiffness, above=0, unit="N/m^rho"))
        object.__setattr__(self, "damping", number("contact damping lambda", self.damping, at_least=0))
        object.__setattr__(self, "exponent", number("contact exponent rho", self.exponent, above=0))

    @classmethod
    def hertz(
        cls,
        *,
        young: ArrayLike,
        poisson: ArrayLike,
        curvatures: ArrayLike,
        angle: float = 0.0,
        damping: float = 0.0,
    ) -> Compliance:
        """Hertz's law F_n = K delta^1.5 of two elastic bodies that touch at a point.

        K. L. Johnson, Contact Mechanics (Cambridge University Press, 1985), chapter 4; ``depth`` is the approach of the
        two bodies. Let A x^2 + B y^2 be the gap between the undeformed surfaces, A <= B, b <= a the semi-axes of the
        patch, 1 / E* = (1 - nu_1^2) / E_1 + (1 - nu_2^2) / E_2, K(m) and E(m) the complete elliptic integrals and
        D = (K - E) / m. Then m = 1 - (b/a)^2 solves B/A = (K - D) / ((1 - m) D), and

            stiffness = (2 pi / 3) E* sqrt(D / A) / K^1.5,

        which where A = B is 4/3 E* sqrt(R) with R = 1 / (2 A).

        Args:
            young: Young's moduli (E_1, E_2) [Pa].
            poisson: Poisson's ratios (nu_1, nu_2) [-].
            curvatures: principal curvatures (2, 2) [1/m], one row per body, the smaller first, positive where the body
                is convex: what the shapes' ``curvature`` gives.
            angle: between the directions of the bodies' first curvatures [rad].
            damping: lambda [N s/m^2.5]; Hertz's contact itself has none.

        Raises:
            InvalidInput: materials that do not exist, or a gap that does not open in both directions.
        """
        moduli, ratios = array_of("Young's moduli", young, (2,)), array_of("Poisson's ratios", poisson, (2,))
        if np.any(moduli <= 0):
            raise InvalidInput(f"Young's moduli: expected two numbers > 0 [Pa], got {moduli.tolist()}")
        if np.any((ratios <= -1) | (ratios > 0.5)):
            raise InvalidInput(f"Poisson's ratios: expected two numbers > -1 and <= 0.5, got {ratios.tolist()}")
        A, B = _gap_curvatures(array_of("curvatures", curvatures, (2, 2)), number("angle", angle, unit="rad"))
        modulus = 1 / ((1 - ratios**2) / moduli).sum()

        # From 1 - m = (b/a)^2, and D as Carlson's integral: (K - E) / m has no digits left near a circle.
        def integrals(slimness: float) -> tuple[float, float]:
            return ellipkm1(slimness), elliprd(0.0, slimness, 1.0) / 3

        def miss(log_slimness: float) -> float:
            slimness = np.exp(log_slimness)
            K, D = integrals(slimness)
            return float(np.log((K - D) / (slimness * D)) - np.log(B / A))

        # B/A is 1 at a circle, where rounding may put it on either side, and far beyond 1 / _LINE at exp(-30).
        slimness = 1.0 if miss(0.0) >= 0 else np.exp(brentq(miss, -30.0, 0.0, xtol=1e-15, rtol=1e-14))
        K, D = integrals(slimness)
        return cls(stiffness=2 * np.pi / 3 * modulus * np.sqrt(D / A) / K**1.5, damping=damping, exponent=1.5)

    def normal_force(self, depth: ArrayLike, rate: ArrayLike = 0.0) -> Array:
        """F_n [N] at penetration ``depth`` [m] and ``rate`` [m/s] (Eq. 4); zero where there is no penetration."""
        depths, rates = finite_of("depth", depth), finite_of("rate", rate)
        alike("depth and rate", depths, rates)
        return (self.damping * rates + self.stiffness) * np.maximum(depths, 0.0) ** self.exponent

    def depth(self, force: ArrayLike) -> Array:
        """Penetration [m] at rest under a normal force [N]: the inverse of Eq. (26)."""
        return (at_least_zero("normal force", force) / self.stiffness) ** (1 / self.exponent)


def _gap_curvatures(curvatures: Array, angle: float) -> tuple[float, float]:
    """A <= B [1/m] of the gap A x^2 + B y^2 between two bodies with principal curvatures (2, 2) [1/m].

    K. L. Johnson, Contact Mechanics (1985), section 4.1. Raises :class:`InvalidInput` where A is not above zero.
    """
    (first, second), total = np.diff(curvatures, axis=1)[:, 0], curvatures.sum()
    # |d1 + d2 exp(2 i angle)|: its square is Johnson's d1^2 + d2^2 + 2 d1 d2 cos(2 angle).
    spread = np.hypot(first + second * np.cos(2 * angle), second * np.sin(2 * angle))
    slow, fast = float(total - spread) / 4, float(total + spread) / 4
    rounding = _LINE * np.abs(curvatures).max()
    if slow > rounding:
        return slow, fast
    touching = "along a line or an area" if slow >= -rounding else "at more than one point (one is hollow)"
    raise InvalidInput(
        f"curvatures: expected bodies whose gap opens in both directions, got relative curvatures {2 * slow:.6g} and "
        f"{2 * fast:.6g} [1/m] from {curvatures.tolist()}: they touch {touching}, and Hertz's point contact needs "
        "relative curvature in both directions. Give one body a crown (an ellipsoid instead of a cylinder or a plane), "
        "or use a measured Compliance(stiffness=..., exponent=...)"
    )


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
                f"deceleration shape: expected a DecelerationShape, got {shown(self.shape)}: "
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


def _checked(
    compliance: Compliance, depth: ArrayLike, duration: float, shape: DecelerationShape
) -> tuple[float, Array, float]:
    """The law's exponent, the depth and the duration, all checked."""
    instance_of("compliance", compliance, Compliance)
    instance_of("deceleration shape", shape, DecelerationShape)
    return compliance.exponent, at_least_zero("depth", depth), number("duration", duration, above=0, unit="s")


def impulse_energy(
    compliance: Compliance, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT
) -> Array:
    """Grasp-energy measure "impulse" [N s] per contact: Eq. (11) as printed, the integral over *time*.

    lambda delta_F^(rho+1) + c K tau delta_F^rho for a deceleration of ``shape`` that ends at depth ``final_depth`` [m]
    after ``duration`` = tau [s]; c is the shape's ``impulse_factor``, (rho+1) B(rho+1, 1/2) / 2 for the constant one.
    """
    rho, depth, duration = _checked(compliance, final_depth, duration, shape)
    c = shape.impulse_factor(rho)
    return compliance.damping * depth ** (rho + 1) + c * compliance.stiffness * duration * depth**rho


def work_energy(
    compliance: Compliance, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT
) -> Array:
    """Grasp-energy measure "work" [J] per contact: Eq. (9) integrated over *depth*, rho + 1 times the work that the
    contact does.

    K delta_F^(rho+1) + c lambda delta_F^(rho+2) / tau for a deceleration of ``shape`` that ends at ``final_depth`` [m]
    after ``duration`` = tau [s]; c is the shape's ``work_factor``, 2 (rho+1) B(3/2, rho+1) for the constant one.
    """
    rho, depth, duration = _checked(compliance, final_depth, duration, shape)
    damped = shape.work_factor(rho) * compliance.damping * depth ** (rho + 2) / duration
    return compliance.stiffness * depth ** (rho + 1) + damped


def energy_terms(
    compliance: Compliance, measure: Measure, duration: float, shape: DecelerationShape = CONSTANT
) -> tuple[tuple[float, float], ...]:
    """A measure as a sum of powers of the final normal force F = K delta_F^rho [N] (Eq. 26).

    Pairs (coefficient, exponent) with energy = sum of coefficient F^exponent, after ``duration`` = tau [s]: in N s for
    ``"impulse"`` (Eq. 11) and in J for ``"work"`` (Eq. 9). Every exponent is at least 1, every coefficient above 0.
    """
    rho, _, duration = _checked(compliance, 0.0, duration, shape)
    K, damping = compliance.stiffness, compliance.damping
    if one_of("measure", measure, MEASURES) == "impulse":
        stiff = (shape.impulse_factor(rho) * duration, 1.0)
        return ((damping * K ** (-(rho + 1) / rho), (rho + 1) / rho), stiff) if damping > 0 else (stiff,)
    stiff = (K ** (-1 / rho), (rho + 1) / rho)
    if damping == 0:
        return (stiff,)
    return (stiff, (shape.work_factor(rho) * damping / duration * K ** (-(rho + 2) / rho), (rho + 2) / rho))
