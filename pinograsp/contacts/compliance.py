"""The contact law: how the normal force follows the penetration, and what that costs by the two grasp-energy measures.

A law says how it presses at rest; what is derived from that is written once, in :class:`Compliance`. The laws of the
package are the paper's (:class:`MarhefkaOrin`), :func:`~pinograsp.contacts.hertz` from materials, and a table of
measurements (:class:`~pinograsp.contacts.MeasuredCompliance`).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeAlias, cast, get_args, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from pinograsp.checks import alike, at_least_zero, finite_of, instance_of, number, one_of, shorten
from pinograsp.contacts.deceleration import CONSTANT, DecelerationShape
from pinograsp.errors import InvalidInput
from pinograsp.plan import ContactLaw
from pinograsp.spatial import Array

Measure = Literal["impulse", "work"]
MEASURES: tuple[Measure, ...] = get_args(Measure)
# Pairs (coefficient, exponent): a sum of powers of F_n.
Powers: TypeAlias = tuple[tuple[float, float], ...]

# An energy that is no sum of powers is fitted by these, all convex, at that many forces up to the largest one. Eight is
# what the core takes. A fit that is off by more than that share of the largest energy is refused: a preference for
# gentle grasps needs no more digits, and what forces cost is told by the law itself.
_EXPONENTS = np.array([1.0, 1.25, 1.5, 5 / 3, 2.0, 2.5, 3.0, 4.0])
_FITTED, _POOR = 40, 0.1
# Of a law that is kept as a table, to that many times the largest depth: simulated hands press deeper than planned.
_SAMPLES, _BEYOND = 65, 4.0


@runtime_checkable
class Compliance(Protocol):
    """A contact law F_n = f(delta) (1 + loss ddelta). Laws of your own derive from this class.

    A law defines ``force``, ``depth``, ``slope`` and ``energy`` for numbers and arrays of any shape. Everything else
    follows from these; override it if you know a closed form.
    """

    @abstractmethod
    def force(self, depth: ArrayLike) -> Array:
        """f [N] at rest at penetration ``depth`` [m]: zero up to depth 0, rising above."""

    @abstractmethod
    def depth(self, force: ArrayLike) -> Array:
        """Penetration [m] at rest under a normal force >= 0 [N]: the inverse of ``force`` (of Eq. 26)."""

    @abstractmethod
    def slope(self, depth: ArrayLike) -> Array:
        """df/ddelta [N/m] at penetration ``depth`` >= 0 [m]: the normal stiffness."""

    @abstractmethod
    def energy(self, depth: ArrayLike) -> Array:
        """Stored energy of the contact [J] at penetration ``depth`` [m]: the integral of f from depth 0."""

    @property
    def loss(self) -> float:
        """Damping: share by which the force grows with the rate of the depth [s/m]."""
        return 0.0

    @property
    def measure_factor(self) -> float:
        """Ratio of the two measures to impulse and work of a contact [-]: rho + 1 for the paper's law."""
        return 1.0

    def normal_force(self, depth: ArrayLike, rate: ArrayLike = 0.0) -> Array:
        """F_n [N] at penetration ``depth`` [m] and ``rate`` [m/s]; zero without penetration."""
        depths, rates = finite_of("depth", depth), finite_of("rate", rate)
        alike("depth and rate", depths, rates)
        return (1.0 + self.loss * rates) * self.force(depths)

    def scale(self, factor: float) -> Compliance:
        """Return the law of contacts that press ``factor`` times as much at any depth."""
        return _Scaled(self, number("stiffness factor", factor, above=0))

    def impulse(self, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT) -> Array:
        """Grasp-energy measure "impulse" [N s]: the integral of F_n over time, times ``measure_factor`` (Eq. 11).

        Of a deceleration of ``shape`` that ends at depth ``final_depth`` [m] after ``duration`` = tau [s].
        """
        depth, tau = _check_measured(final_depth, duration, shape)
        measure: Array = self.measure_factor * (
            tau * self._integrate_force(depth, shape) + self.loss * self.energy(depth)
        )
        return measure

    def work(self, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT) -> Array:
        """Grasp-energy measure "work" [J]: the integral of F_n over depth, times ``measure_factor`` (Eq. 9).

        Arguments as for :meth:`impulse`.
        """
        depth, tau = _check_measured(final_depth, duration, shape)
        measure: Array = self.measure_factor * (
            self.energy(depth) + self.loss / tau * self._integrate_damping(depth, shape)
        )
        return measure

    def powers(
        self, measure: Measure, duration: float, shape: DecelerationShape = CONSTANT, *, largest: float
    ) -> Powers:
        """A measure as a sum of powers of the final normal force F [N], the form that solvers need.

        The sum has exponents >= 1 and coefficients > 0, and is fitted at forces up to ``largest`` [N] to a tenth of the
        largest energy. With ``duration`` = tau [s] only the coefficients change, each of them monotonically.

        Raises:
            InvalidInput: no such sum comes near enough, because the energy is not convex.
        """
        _, tau = _check_measured(0.0, duration, shape)
        forces = number("largest force", largest, above=0, at_most=1e12, unit="N") * np.arange(1, _FITTED + 1) / _FITTED
        depths = self.depth(forces)
        if one_of("measure", measure, MEASURES) == "impulse":
            parts = (tau, self._integrate_force(depths, shape)), (self.loss, self.energy(depths))
        else:
            parts = (1.0, self.energy(depths)), (self.loss / tau, self._integrate_damping(depths, shape))
        basis = (forces[:, None] / forces[-1]) ** _EXPONENTS
        fits = [(share, nnls(basis, values)[0]) for share, values in parts if share > 0]
        wanted, fitted = (sum(share * values for share, values in all_parts) for all_parts in (parts, fits))
        off = float(np.abs(basis @ fitted - wanted).max() / np.max(wanted))
        if not off <= _POOR:
            raise InvalidInput(
                f"contact law: expected an energy '{measure}' that is nearly convex in the normal force up to "
                f"{forces[-1]:.3g} N, got one that sums of powers miss by {100 * off:.2g} % of the largest: use "
                "another objective, such as 'least_squares'"
            )
        return tuple(
            (float(self.measure_factor * share * coefficient / forces[-1] ** exponent), float(exponent))
            for share, fit in fits
            for coefficient, exponent in zip(fit, _EXPONENTS)
            if coefficient > 0
        )

    def numbers(self, deepest: float) -> ContactLaw:
        """The numbers of the law, for plans: here a table of forces, up to well above the depth ``deepest`` [m].

        :func:`law_of` reads them.
        """
        depths = _BEYOND * number("deepest", deepest, above=0, unit="m") * np.linspace(0.0, 1.0, _SAMPLES) ** 2
        table = np.column_stack([depths, self.force(depths)])
        return ContactLaw(stiffness=1.0, damping=self.loss, exponent=0.0, table=table)

    def _integrate_force(self, final_depth: Array, shape: DecelerationShape) -> Array:
        """Integral of f over u, 0 to 1 [N]."""
        weights, sigma, _ = shape.quadrature
        return np.asarray(self.force(final_depth[..., None] * sigma) @ weights)

    def _integrate_damping(self, final_depth: Array, shape: DecelerationShape) -> Array:
        """Integral of f (ddelta/du)^2 over u, 0 to 1 [N m^2]."""
        weights, sigma, rate = shape.quadrature
        return np.asarray(final_depth**2 * (self.force(final_depth[..., None] * sigma) @ (weights * rate**2)))


def checked_law(law: object) -> Compliance:
    """``law`` if it is a contact law, else :class:`~pinograsp.errors.InvalidInput`."""
    if Compliance in type(law).__mro__:  # at once: isinstance() looks at each member of a protocol
        return cast(Compliance, law)
    if not isinstance(law, Compliance) or isinstance(law, type):
        raise InvalidInput(f"compliance: expected a Compliance, such as MarhefkaOrin(...), got {shorten(law)}")
    return law


@dataclass(frozen=True, kw_only=True)
class MarhefkaOrin(Compliance):
    """Marhefka and Orin's law F_n = (lambda ddelta + K) delta^rho (Eq. 4, [3] of the paper).

    Attributes:
        stiffness: K [N/m^rho].
        damping: lambda [N s/m^(rho+1)].
        exponent: rho [-].

    Example:
        >>> import pinograsp as pg
        >>> law = pg.MarhefkaOrin(stiffness=5e4, exponent=1.5)
        >>> print(f"{law.force(1e-3):.2f} N at 1 mm, {1e3 * law.depth(10.0):.2f} mm at 10 N")
        1.58 N at 1 mm, 3.42 mm at 10 N

    See Also:
        :class:`~pinograsp.forces.ForceProblem`, whose ``compliance`` it is by default.
    """

    stiffness: float = 5.0e4
    damping: float = 100.0
    exponent: float = 1.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", number("contact stiffness K", self.stiffness, above=0, unit="N/m^rho"))
        object.__setattr__(self, "damping", number("contact damping lambda", self.damping, at_least=0))
        object.__setattr__(self, "exponent", number("contact exponent rho", self.exponent, above=0))

    def force(self, depth: ArrayLike) -> Array:
        """K delta^rho [N]; zero without penetration."""
        return np.asarray(self.stiffness * np.maximum(depth, 0.0) ** self.exponent)

    def depth(self, force: ArrayLike) -> Array:
        """Penetration [m] at rest under a normal force [N]: the inverse of Eq. (26)."""
        return (at_least_zero("normal force", force) / self.stiffness) ** (1 / self.exponent)

    def slope(self, depth: ArrayLike) -> Array:
        """rho K delta^(rho-1) [N/m]; infinite at depth 0 if rho < 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.exponent * self.stiffness * np.maximum(depth, 0.0) ** (self.exponent - 1))

    def energy(self, depth: ArrayLike) -> Array:
        """K delta^(rho+1) / (rho+1) [J]."""
        return np.asarray(self.stiffness / (self.exponent + 1) * np.maximum(depth, 0.0) ** (self.exponent + 1))

    @property
    def loss(self) -> float:
        """lambda / K [s/m]."""
        return self.damping / self.stiffness

    @property
    def measure_factor(self) -> float:
        """rho + 1."""
        return self.exponent + 1

    def scale(self, factor: float) -> MarhefkaOrin:
        """``factor`` times K, and the same damping."""
        return replace(self, stiffness=factor * self.stiffness)

    def impulse(self, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT) -> Array:
        """lambda delta_F^(rho+1) + c K tau delta_F^rho [N s] (Eq. 11 as printed, the integral over *time*).

        c is the shape's ``impulse_factor``, (rho+1) B(rho+1, 1/2) / 2 for the constant one.
        """
        (depth, tau), rho = _check_measured(final_depth, duration, shape), self.exponent
        c = shape.impulse_factor(rho)
        return self.damping * depth ** (rho + 1) + c * self.stiffness * tau * depth**rho

    def work(self, final_depth: ArrayLike, duration: float, shape: DecelerationShape = CONSTANT) -> Array:
        """K delta_F^(rho+1) + c lambda delta_F^(rho+2) / tau [J] (Eq. 9 integrated over *depth*).

        c is the shape's ``work_factor``, 2 (rho+1) B(3/2, rho+1) for the constant one.
        """
        (depth, tau), rho = _check_measured(final_depth, duration, shape), self.exponent
        return self.stiffness * depth ** (rho + 1) + shape.work_factor(rho) * self.damping * depth ** (rho + 2) / tau

    def powers(
        self, measure: Measure, duration: float, shape: DecelerationShape = CONSTANT, *, largest: float = 0.0
    ) -> Powers:
        """As for any law; with F = K delta_F^rho (Eq. 26) both measures are exactly such sums, for any F."""
        (_, tau), K, rho, damping = _check_measured(0.0, duration, shape), self.stiffness, self.exponent, self.damping
        if one_of("measure", measure, MEASURES) == "impulse":
            stiff = (shape.impulse_factor(rho) * tau, 1.0)
            return ((damping * K ** (-(rho + 1) / rho), (rho + 1) / rho), stiff) if damping > 0 else (stiff,)
        stiff = (K ** (-1 / rho), (rho + 1) / rho)
        if damping == 0:
            return (stiff,)
        return (stiff, (shape.work_factor(rho) * damping / tau * K ** (-(rho + 2) / rho), (rho + 2) / rho))

    def numbers(self, deepest: float = 0.0) -> ContactLaw:
        """K, lambda and rho."""
        return ContactLaw(stiffness=self.stiffness, damping=self.damping, exponent=self.exponent)


@dataclass(frozen=True)
class _Scaled(Compliance):
    """A law that presses ``factor`` times as much."""

    law: Compliance
    factor: float

    def force(self, depth: ArrayLike) -> Array:
        return self.factor * self.law.force(depth)

    def depth(self, force: ArrayLike) -> Array:
        return self.law.depth(np.asarray(force) / self.factor)

    def slope(self, depth: ArrayLike) -> Array:
        return self.factor * self.law.slope(depth)

    def energy(self, depth: ArrayLike) -> Array:
        return self.factor * self.law.energy(depth)

    @property
    def loss(self) -> float:
        return self.law.loss / self.factor


def _check_measured(depth: ArrayLike, duration: float, shape: DecelerationShape) -> tuple[Array, float]:
    instance_of("shape", shape, DecelerationShape)
    return at_least_zero("depth", depth), number("duration", duration, above=0, unit="s")
