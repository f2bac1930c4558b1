"""How the deceleration of a contact is spread over the grasp phase: the shape alpha, its antiderivatives and integrals.

Over the grasp phase, u = (t - t_I) / tau in [0, 1], the deceleration is A alpha(u) with alpha >= 0 and maximum 1, so
that A is the *peak* deceleration and Eq. (13c) bounds what it did. With the rate zero at t_F (Eqs. 20-24 for alpha = 1)

    rate / (A tau) = integral of alpha from u to 1,    depth / (A tau^2) = integral of that from 0 to u.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly

from pinograsp.checks import array_of, brief, floats_of, number, shorten, text_of
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(48) + np.array([[1.0], [0.0]])) / 2  # on [0, 1]
_MOST_POWERS = 50  # of a polynomial: its roots are found one by one, and rounding eats more


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DecelerationShape:
    """Deceleration over the grasp phase, normalised in time and to its peak; the class methods build the usual ones.

    Attributes:
        name: short text for reports.
        alpha: deceleration / A over u in [0, 1], piecewise polynomial, >= 0 [-]; any scale is accepted and normalised
            to maximum 1.
        depth_factor: m [-], final depth = m A tau^2 (constant deceleration: 1/2).
        speed_factor: v [-], impact speed = v A tau (constant deceleration: 1).
    """

    name: str
    alpha: PPoly = field(repr=False)
    depth_factor: float = field(init=False)
    speed_factor: float = field(init=False)
    _constant: bool = field(init=False, repr=False)
    _lost: PPoly = field(init=False, repr=False)
    _depth: PPoly = field(init=False, repr=False)

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        text_of("name of the deceleration shape", self.name)
        alpha = _normalise(self.alpha)
        lost = alpha.antiderivative()  # speed lost since the impact / (A tau)
        speed = float(lost(1.0))
        rate = PPoly(-lost.c, lost.x)
        rate.c[-1] += speed
        depth = rate.antiderivative()
        put("alpha", alpha)
        put("depth_factor", float(depth(1.0)))
        put("speed_factor", speed)
        put("_constant", bool(np.all(alpha.c[:-1] == 0) and np.all(alpha.c[-1] == 1)))
        put("_lost", lost)
        put("_depth", depth)

    @classmethod
    def constant(cls) -> DecelerationShape:
        """alpha = 1: the paper's profile (Eqs. 20-24)."""
        return cls(name="constant", alpha=PPoly(np.ones((1, 1)), np.array([0.0, 1.0])))

    @classmethod
    def linear(cls, start: float, end: float) -> DecelerationShape:
        """From ``start`` at t_I to ``end`` at t_F, both >= 0; only their ratio counts, so (0, 1) rises from zero."""
        start = number("linear deceleration at the impact", start, at_least=0)
        end = number("linear deceleration at the end", end, at_least=0)
        peak = max(start, end)
        if peak == 0:
            raise InvalidInput(
                "linear deceleration: expected a start or an end above 0, got 0 and 0: give at least one positive value"
            )
        start, end = start / peak, end / peak  # first of all, so that end - start cannot overflow
        return cls(name=f"linear {start:g}:{end:g}", alpha=PPoly([[end - start], [start]], [0.0, 1.0]))

    @classmethod
    def polynomial(cls, coefficients: ArrayLike) -> DecelerationShape:
        """sum of ``coefficients[i]`` u^i (n,), lowest power first, >= 0 on [0, 1]; its scale does not matter."""
        c = _numbers("deceleration polynomial", coefficients, "coefficients of 1, u, u^2, ...", least=1)
        return cls(name=f"polynomial of degree {len(c) - 1}", alpha=PPoly(c[::-1, None], [0.0, 1.0]))

    @classmethod
    def from_samples(cls, values: ArrayLike) -> DecelerationShape:
        """Straight lines between n >= 2 ``values`` (n,) >= 0, equally spaced on [0, 1]; their scale does not matter."""
        wanted = "two or more equally spaced values, from t_I to t_F"
        samples = _numbers("deceleration samples", values, wanted, least=2)
        n, lowest = len(samples), samples.argmin()
        if samples[lowest] < 0:
            raise InvalidInput(
                f"deceleration samples: expected values >= 0, got {samples[lowest]:.3g} at index {lowest}: "
                "the contact would speed up again; raise this value to 0 or more"
            )
        samples = samples / (samples.max() or 1.0)  # first of all, so that the slopes cannot overflow
        return cls(
            name=f"{n} samples",
            alpha=PPoly([np.diff(samples) * (n - 1), samples[:-1]], np.linspace(0.0, 1.0, n)),
        )

    def acceleration(self, u: ArrayLike) -> Array:
        """Deceleration / A at u (...), held at its end values outside [0, 1]."""
        # Clipped, since an extremum of 0 or 1 is met to rounding only.
        deceleration: Array = np.minimum(np.maximum(self.alpha(_clip(u)), 0.0), 1.0)
        return deceleration

    def rate(self, u: ArrayLike) -> Array:
        """Rate / (A tau) at u (...): ``speed_factor`` up to u = 0, zero from u = 1 on."""
        # The difference is exactly zero at u = 1; the maximum keeps rounding before it from turning the motion round.
        rate: Array = np.maximum(self.speed_factor - self._lost(_clip(u)), 0.0)
        return rate

    def depth(self, u: ArrayLike) -> Array:
        """Depth / (A tau^2) at u (...): zero up to u = 0, ``depth_factor`` from u = 1 on."""
        depth: Array = self._depth(_clip(u))
        return depth

    @property
    def quadrature(self) -> tuple[Array, Array, Array]:
        """Weights (n,) of an integral over u from 0 to 1, and at its points the depth over the final depth, and its
        rate (n,) [-].

        For functions of the depth that may start as a power of the depth; these are smooth in the fourth root of u.
        """
        ends = self.alpha.x
        u, weights = [], []
        for i, (start, width) in enumerate(zip(ends, np.diff(ends))):
            power = 4 if i == 0 else 1
            u.append(start + width * _NODES**power)
            weights.append(_WEIGHTS * width * power * _NODES ** (power - 1))
        at = np.concatenate(u)
        return np.concatenate(weights), self.depth(at) / self.depth_factor, self.rate(at) / self.depth_factor

    def impulse_factor(self, rho: float) -> float:
        """(rho + 1) times the integral of sigma^rho over u, sigma = depth / final depth: c of "impulse" (Eq. 11)."""
        return _impulse_factor(self, number("contact exponent rho", rho, above=0))

    def work_factor(self, rho: float) -> float:
        """(rho + 1) times the integral of sigma^rho (dsigma/du)^2 over u: the damping term of "work" (Eq. 9)."""
        return _work_factor(self, number("contact exponent rho", rho, above=0))


def _clip(u: ArrayLike) -> Array:
    phase = floats_of("u", u)
    if np.isnan(phase).any():
        raise InvalidInput(f"u: expected numbers, got {shorten(phase.tolist())}")
    return np.minimum(np.maximum(phase, 0.0), 1.0)


def _numbers(name: str, value: ArrayLike, wanted: str, *, least: int) -> Array:
    """``value`` as a finite array of ``least`` or more numbers, or :class:`InvalidInput` that asks for ``wanted``."""
    try:
        array = array_of(name, value, (None,))
    except InvalidInput as error:
        raise InvalidInput(f"{error}: give {wanted}") from None
    if len(array) < least:
        raise InvalidInput(f"{name}: expected at least {least} numbers, got {len(array)}: give {wanted}")
    return array


def _normalise(alpha: PPoly) -> PPoly:
    """A private copy of ``alpha`` with maximum 1 on [0, 1]; :class:`InvalidInput` unless it is a shape."""
    if not isinstance(alpha, PPoly) or alpha.c.ndim != 2 or np.iscomplexobj(alpha.c):
        raise InvalidInput(
            f"deceleration shape: expected a real, scalar scipy.interpolate.PPoly over [0, 1], got {shorten(alpha)}: "
            "build it with DecelerationShape.constant, linear, polynomial or sampled"
        )
    x = np.array(alpha.x, dtype=float)
    if x[0] != 0 or x[-1] != 1 or not np.all(np.diff(x) > 0):
        raise InvalidInput(
            f"deceleration shape: expected breakpoints rising from 0 to 1, got {x[0]:g} to {x[-1]:g}: "
            "use u = (t - t_I) / tau as the variable"
        )
    if len(alpha.c) > _MOST_POWERS:
        raise InvalidInput(
            f"deceleration shape: expected at most {_MOST_POWERS} powers of u, got {len(alpha.c)}: sample it"
        )
    scale = np.abs(alpha.c).max()
    if not np.isfinite(scale):
        raise InvalidInput("deceleration shape: expected finite coefficients, got NaN or infinity: give finite numbers")
    if scale == 0:
        raise InvalidInput(
            "deceleration shape: expected a deceleration above 0 somewhere on [0, 1], got zero everywhere: "
            "give at least one positive value"
        )
    alpha = PPoly(alpha.c / scale, x)  # first of all, so that sums of huge or tiny coefficients stay in range
    u, values = _extremes(alpha)
    lowest, peak = values.argmin(), values.max()
    # What Horner's scheme may be off by where the polynomial touches zero.
    rounding = 64 * np.finfo(float).eps * np.abs(alpha.c).sum(axis=0).max()
    if values[lowest] < -rounding:
        raise InvalidInput(
            f"deceleration shape: expected >= 0 on [0, 1], got {scale * values[lowest]:.3g} at u = {u[lowest]:.3g}: "
            f"the contact would speed up again; add at least {-scale * values[lowest]:.3g} or choose another shape"
        )
    return PPoly(alpha.c / peak, x)


def _extremes(alpha: PPoly) -> tuple[Array, Array]:
    """Places u and values of alpha that hold its extremes on [0, 1]: both ends of every piece, and turning points."""
    right = np.zeros(alpha.c.shape[1])
    for c in alpha.c:  # Horner's scheme, since at a jump alpha(x) is the value of the next piece
        right = right * np.diff(alpha.x) + c
    u, values = [alpha.x[:-1], alpha.x[1:]], [alpha.c[-1], right]
    if len(alpha.c) > 2:
        turns = alpha.derivative().roots(discontinuity=False, extrapolate=False)
        turns = turns[np.isfinite(turns)]  # NaN marks pieces that are constant
        u, values = [*u, turns], [*values, alpha(turns)]
    return np.concatenate(u), np.concatenate(values)


def _beta(a: float, b: float) -> float:
    return math.exp(math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b))


# Searches and controllers ask for the same few exponents again and again.
@lru_cache(maxsize=256)
def _impulse_factor(shape: DecelerationShape, rho: float) -> float:
    if shape._constant:
        return (rho + 1) * _beta(rho + 1, 0.5) / 2
    return (rho + 1) * _power_integral(shape, rho, lambda slope: 1.0)


@lru_cache(maxsize=256)
def _work_factor(shape: DecelerationShape, rho: float) -> float:
    if shape._constant:
        return 2 * (rho + 1) * _beta(1.5, rho + 1)
    return (rho + 1) * _power_integral(shape, rho, lambda slope: slope * slope)


def _power_integral(shape: DecelerationShape, rho: float, weight: Callable[[float], float]) -> float:
    """Integral of sigma^rho weight(dsigma/du) over u in [0, 1], sigma = depth / final depth; about 1e-13 relative."""
    from scipy.integrate import quad

    sigma = PPoly(shape._depth.c / shape.depth_factor, shape._depth.x)
    pieces = zip(sigma.c.T.tolist(), sigma.derivative().c.T.tolist(), np.diff(sigma.x).tolist())
    parts = []
    for i, (depth, slope, width) in enumerate(pieces):
        # sigma starts like u, so sigma^rho has a power singularity at the impact and none later (sigma is concave and
        # rises to 1, hence sigma >= u). In the first piece u = width w^4 makes it as smooth as w^(4 rho + 3).
        power = 4 if i == 0 else 1

        def integrand(
            w: float,
            depth: list[float] = depth,
            slope: list[float] = slope,
            width: float = width,
            power: int = power,
        ) -> float:
            x = width * w**power
            return float(_horner(depth, x) ** rho * weight(_horner(slope, x)) * power * w ** (power - 1))

        # full_output, since QUADPACK warns of rounding when it comes this near to machine precision.
        part = quad(integrand, 0.0, 1.0, epsabs=0.0, epsrel=1e-13, limit=200, full_output=1)[0]
        parts.append(width * part)
    return math.fsum(parts)


def _horner(coefficients: list[float], x: float) -> float:
    value = 0.0
    for c in coefficients:
        value = value * x + c
    return value


CONSTANT = DecelerationShape.constant()


_LONGEST = 1e9  # [s] thirty years; depths are proportional to the square


def bounds_of(
    final_time: float,
    impact_time_range: ArrayLike,
    acceleration_range: ArrayLike,
    max_speed: float,
    max_depth: float,
) -> dict[str, object]:
    """Times and bounds of Eq. (13) and (14) by name, checked."""
    final_time = number("final time t_F", final_time, above=0, at_most=_LONGEST, unit="s")
    low, high = _range("impact time range", impact_time_range, "s")
    if high >= final_time:
        raise InvalidInput(f"impact time range: expected below the final time {final_time:g} s, got {high:g} s")
    return {
        "final_time": final_time,
        "impact_time_range": (low, high),
        "acceleration_range": _range("acceleration range", acceleration_range, "m/s^2"),
        "max_speed": number("maximum speed", max_speed, above=0, unit="m/s"),
        "max_depth": number("maximum depth", max_depth, above=0, unit="m"),
    }


def _range(name: str, value: ArrayLike, unit: str) -> tuple[float, float]:
    low, high = array_of(name, value, (2,))
    if not 0 < low <= high:
        raise InvalidInput(f"{name}: expected 0 < lower <= upper [{unit}], got {low:g} and {high:g}")
    return float(low), float(high)
