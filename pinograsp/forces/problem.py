"""The force problem: which contact forces balance the load, within friction and the limits of the penetration."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pinograsp import defaults
from pinograsp.checks import (
    array_of,
    brief,
    each_of,
    finite_of,
    frozen,
    instance_of,
    integer,
    number,
    one_of,
    read_only,
    rebuild,
    record_of,
    shorten,
)
from pinograsp.contacts import (
    ContactSet,
    Friction,
)
from pinograsp.contacts.compliance import MEASURES, Measure
from pinograsp.contacts.friction import LARGEST_MU, default_friction
from pinograsp.errors import InvalidInput
from pinograsp.forces.settings import ForceArguments, ForceSettings
from pinograsp.forces.torque_limits import TorqueLimits
from pinograsp.objects.body import Body
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array
from pinograsp.words import by_name, lines_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

BY_ACCELERATION = "deceleration range (Eq. 13c)"
BY_SPEED = "impact speed (Eq. 13b)"
BY_DEPTH = "penetration depth (Eq. 13a)"
BY_CAP = "largest normal force of the contact"

# Larger values come from a mistake of units; solvers would lose all digits to rounding.
_STRONG, _DEAR = 1e12, 1e100  # [N], energy per newton


class NormalForceLimits(NamedTuple):
    """Range of F_n at t_F.

    Attributes:
        least: smallest admissible F_n [N].
        largest: largest admissible F_n [N].
        reason: which of Eqs. (13) sets the largest.
    """

    least: float
    largest: float
    reason: str


class ProblemOptions(ForceArguments, total=False):
    """The optional arguments of :class:`ForceProblem` that describe neither contacts nor object."""

    min_normal_force: ArrayLike | None
    max_normal_force: ArrayLike | None
    torques: TorqueLimits | None


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: with_load copies all attributes at once
class ForceProblem(ForceSettings):
    """k contacts, a load, friction, and the constraints of Eqs. (13)-(16).

    Attributes:
        contacts: the contact points and frames.
        load: external wrench on the object (6,), linear first, about the centre of mass, world axes [N, N m].
        mu: friction coefficient of each contact (k,) [-]; a number applies to all.
        min_normal_force: least F_n (k,) [N] besides the limits of the penetration; a number applies to all.
        max_normal_force: caps on F_n (k,) [N] besides the limits of the penetration; a number applies to all.
        torques: limits of the joint torques, or None.
        object: the held shape (of :mod:`pinograsp.objects`), if it is known; the depth of links is measured from its
            surface.
        scaled_columns: grasp map with moments divided by ``moment_length``: (rows, k, 3), columns per contact x, y, z
            [-].

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> print(problem.load.round(2), problem.mu)
        [ 0.    0.   -1.96  0.    0.    0.  ] [0.6 0.6 0.6]

    See Also:
        :func:`~pinograsp.forces.optimize_grasp`, :func:`~pinograsp.forces.optimize_forces`,
        :func:`~pinograsp.forces.diagnose`.
    """

    contacts: ContactSet
    load: Array
    mu: Array
    min_normal_force: Array | None = None
    max_normal_force: Array | None = None
    torques: TorqueLimits | None = None
    object: Body | None = None
    scaled_columns: Array = field(init=False, repr=False)

    if TYPE_CHECKING:  # what was None is known here; arguments may be numbers and lists, attributes are arrays
        friction: Friction = Friction()
        moment_length: float = 1.0

        def __init__(
            self,
            *,
            contacts: ContactSet,
            load: ArrayLike,
            mu: ArrayLike,
            object: Body | None = ...,
            **settings: Unpack[ProblemOptions],
        ) -> None: ...

    __repr__ = brief("contacts", "balance", "measure", "mu", "friction", "load", "final_time", "object")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        force, moment = (float(np.linalg.norm(part)) for part in (self.load[:3], self.load[3:]))
        balance = "forces and moments" if self.balance == "wrench" else "forces alone"
        low, high = self.impact_time_range
        return lines_of(
            f"{self.k} contacts hold a load of {force:.3g} N and {moment:.3g} N m, {balance} in balance",
            f"mu: {by_name(self.contacts.names, self.mu.tolist())} ({self.friction.model}, safety factor "
            f"{self.friction.safety:g})",
            f"least {self.measure}; impact from {low:g} to {high:g} s, complete at {self.final_time:g} s",
        )

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        super().__post_init__()
        k = len(instance_of("contacts", self.contacts, ContactSet))
        put("load", _load(self.load))
        mu = each_of("mu", self.mu, k)
        if np.any((mu < 0) | (mu > LARGEST_MU)):
            raise InvalidInput(
                f"mu: expected friction coefficients >= 0, up to {LARGEST_MU:g}, got {shorten(mu.tolist())}"
            )
        put("mu", mu)
        if self.friction is None:
            put("friction", default_friction(contact.finger for contact in self.contacts))
        instance_of("torques", self.torques, TorqueLimits, type(None))
        instance_of("object", self.object, Body, type(None))
        if self.min_normal_force is not None:
            floor = each_of("least normal forces", self.min_normal_force, k)
            if np.any((floor < 0) | (floor > _STRONG)):
                raise InvalidInput(
                    f"least normal forces: expected values from 0 to {_STRONG:g} [N], got {shorten(floor.tolist())}"
                )
            put("min_normal_force", floor)
        if self.max_normal_force is not None:
            cap = each_of("largest normal forces", self.max_normal_force, k)
            if np.any(cap <= 0):
                raise InvalidInput(f"largest normal forces: expected values > 0 [N], got {shorten(cap.tolist())}")
            put("max_normal_force", cap)
            if self.min_normal_force is not None and np.any(self.min_normal_force > cap):
                raise InvalidInput(
                    f"normal forces: expected a least value up to the largest [N], got "
                    f"{shorten(self.min_normal_force.tolist())} and {shorten(cap.tolist())}"
                )
        if self.torques is not None and len(self.torques.jacobian) != k:
            raise InvalidInput(f"torques: expected Jacobians of {k} contacts, got {len(self.torques.jacobian)}")
        put("moment_length", self.contacts.checked_moment_length(self.moment_length))
        G = np.array(self.contacts.G)
        G[3:] /= self.moment_length
        put("scaled_columns", read_only(G[: self.rows].reshape(self.rows, k, 3)))
        put("_preparations", {})

    def __reduce__(self) -> tuple[Any, ...]:
        return rebuild(self)

    @classmethod
    def holding(
        cls,
        object: Body,
        contacts: ContactSet,
        *,
        mu: ArrayLike,
        **settings: Unpack[ProblemOptions],
    ) -> ForceProblem:
        """Return the problem of holding ``object`` against ``gravity_o`` (3,) [m/s^2]; ``settings``: other attributes.

        Raises:
            InvalidInput: a value that cannot be used.
            TypeError: an argument that the class does not have.
        """
        known = ProblemOptions.__annotations__
        if unknown := [name for name in settings if name not in known]:
            raise TypeError(
                f"ForceProblem.holding() got an unexpected keyword argument '{unknown[0]}'; besides mu it takes "
                f"{', '.join(known)}"
            )
        gravity = array_of("gravity", settings.get("gravity_o", defaults.GRAVITY), (3,))
        with np.errstate(over="ignore"):  # an infinite load is refused
            weight = instance_of("object", object, Body).mass * gravity
        load = np.concatenate([weight, np.zeros(3)])
        return cls(contacts=contacts, load=load, mu=mu, object=object, **settings)

    def with_load(self, load: ArrayLike) -> ForceProblem:
        """Return the same problem under another load (6,) [N, N m]: for loops in which nothing else changes."""
        return record_of(ForceProblem, self.__dict__ | {"load": _load(load)})

    @property
    def preparations(self) -> dict[Hashable, Any]:
        """What :func:`~pinograsp.forces.optimize_forces` has prepared independently of the load; problems from
        :meth:`with_load` share it.
        """
        preparations: dict[Hashable, Any] = self.__dict__["_preparations"]
        return preparations

    @property
    def k(self) -> int:
        """Number of contacts."""
        return len(self.contacts)

    @property
    def rows(self) -> int:
        """Balance rows: 3 for forces, 6 for the wrench."""
        return 3 if self.balance == "force" else 6

    @property
    def pyramid(self) -> Array:
        """mu / (safety sqrt(2)) (k,): half-width of the inscribed friction pyramid per newton of F_n (Eq. 16)."""
        half_width: Array = self.mu / (self.friction.safety * np.sqrt(2))
        return half_width

    @property
    def scaled_load(self) -> Array:
        """Load (rows,) with moments divided by ``moment_length`` [N]."""
        return frozen(self.scale_wrenches(self.load))

    def scale_wrenches(self, wrenches: Array) -> Array:
        """Wrenches (..., 6) [N, N m] in the balance rows (..., rows), moments divided by ``moment_length`` [N]."""
        return np.concatenate([wrenches[..., :3], wrenches[..., 3:] / self.moment_length], axis=-1)[..., : self.rows]

    def depth_per_acceleration(self, impact_time: float) -> float:
        """Final depth per deceleration [s^2] for an impact at t_I [s]: tau^2 / 2 if constant (Eq. 24b)."""
        return self.shape.depth_factor * (self.final_time - self.checked_impact_time(impact_time)) ** 2

    @property
    def deepest_force(self) -> float:
        """F_n at rest at ``max_depth`` [N]."""
        with np.errstate(over="ignore"):
            return min(float(self.compliance.force(self.max_depth)), _STRONG)

    def normal_force(self, acceleration: ArrayLike, impact_time: float) -> Array:
        """F_n at t_F [N] for decelerations A [m/s^2] and an impact at t_I [s] (Eq. 26)."""
        depth: Array = finite_of("deceleration", acceleration) * self.depth_per_acceleration(impact_time)
        return self.compliance.normal_force(depth)

    def acceleration(self, normal_force: ArrayLike, impact_time: float) -> Array:
        """Deceleration A [m/s^2] that ends at these normal forces [N]: Eq. (26) solved for A."""
        acceleration: Array = self.compliance.depth(normal_force) / self.depth_per_acceleration(impact_time)
        return acceleration

    def checked_impact_time(self, impact_time: float) -> float:
        """``impact_time`` as a number [s] below the final time, or :class:`InvalidInput`."""
        impact_time = number("impact time t_I", impact_time, at_least=0, unit="s")
        if impact_time >= self.final_time:
            raise InvalidInput(
                f"impact time t_I: expected below the final time {self.final_time:g} s, got {impact_time:g} s"
            )
        return impact_time

    def normal_force_range(self, impact_time: float) -> tuple[Array, Array]:
        """Least and largest F_n at t_F (k,), (k,) [N] that Eqs. (13) and the caps allow for an impact at t_I [s]."""
        low, high, _ = self.normal_force_limits(self.checked_impact_time(impact_time))
        floor, cap = self.min_normal_force, self.max_normal_force
        least = np.full(self.k, low) if floor is None else np.maximum(floor, low)
        return least, np.full(self.k, high) if cap is None else np.minimum(cap, high)

    def binding_bound(self, impact_time: float, contact: int) -> str:
        """Which limit sets the largest F_n of a contact at t_I [s]: a name of Eqs. (13), or the contact's cap."""
        contact = integer("contact", contact, at_least=0, at_most=self.k - 1)
        _, high, reason = self.normal_force_limits(self.checked_impact_time(impact_time))
        capped = self.max_normal_force is not None and self.max_normal_force[contact] < high
        return BY_CAP if capped else reason

    def normal_force_limits(self, impact_time: float) -> NormalForceLimits:
        """The range of F_n at t_F that Eqs. (13) allow for an impact at t_I [s], without the contacts' own limits."""
        depth, tau = self.depth_per_acceleration(impact_time), self.final_time - impact_time
        limits = {
            BY_ACCELERATION: self.acceleration_range[1] * depth,
            BY_SPEED: self.max_speed / (self.shape.speed_factor * tau) * depth,
            BY_DEPTH: self.max_depth,
        }
        reason = min(limits, key=limits.__getitem__)
        with np.errstate(over="ignore"):  # infinite
            low, high = self.compliance.force(np.array([self.acceleration_range[0] * depth, limits[reason]])).tolist()
        if not low <= _STRONG:
            raise InvalidInput(
                f"contact law: expected a least normal force of at most {_STRONG:g} N, got {low:.3g} N from "
                f"{self.compliance}; check it, and the least acceleration"
            )
        return NormalForceLimits(low, min(high, _STRONG), reason)

    def energy_terms(self, impact_time: float, measure: Measure | None = None) -> tuple[tuple[float, float], ...]:
        """The measure as a sum of powers of F_n: (coefficient, exponent) pairs, in the measure's unit."""
        name = one_of("measure", self.measure if measure is None else measure, MEASURES)
        duration = self.final_time - self.checked_impact_time(impact_time)
        try:
            terms = self.compliance.powers(name, duration, self.shape, largest=self.deepest_force)
        except OverflowError:
            terms = ((float("inf"), 1.0),)
        if not all(0 < coefficient <= _DEAR for coefficient, _ in terms):
            raise InvalidInput(
                f"contact law: expected an energy per newton above 0 and up to {_DEAR:g}, got "
                f"{', '.join(f'{coefficient:.3g}' for coefficient, _ in terms)}; check {self.compliance}"
            )
        return terms

    def energy(self, normal_force: ArrayLike, impact_time: float, measure: Measure | None = None) -> Array:
        """Grasp energy per contact for final normal forces [N] and an impact at t_I [s]; in the measure's unit."""
        name = one_of("measure", self.measure if measure is None else measure, MEASURES)
        energy = self.compliance.impulse if name == "impulse" else self.compliance.work
        depth = self.compliance.depth(normal_force)
        return energy(depth, self.final_time - self.checked_impact_time(impact_time), self.shape)

    def forces(self, normal_force: ArrayLike, multipliers: ArrayLike) -> Array:
        """Contact forces f_c (k, 3) [N] from normal forces (k,) and multipliers (k, 2) (Eqs. 27, 28)."""
        normal_force = array_of("normal forces", normal_force, (self.k,))
        tangential = array_of("multipliers", multipliers, (self.k, 2)) * (self.pyramid * normal_force)[:, None]
        return np.column_stack([tangential, normal_force])

    def residual(self, forces_c: ArrayLike, torsion: ArrayLike | None = None) -> Array:
        """Net wrench (6,) on the object, load included [N, N m]: zero at equilibrium (Eq. 15).

        ``forces_c`` (k, 3) [N]; ``torsion`` (k,) [N m], moments about the contact normals (soft fingers).
        """
        wrench: Array = self.contacts.G @ array_of("forces", forces_c, (self.k, 3)).ravel() + self.load
        if torsion is not None:
            wrench[3:] += array_of("torsion", torsion, (self.k,)) @ self.contacts.rotations_oc[:, :, 2]
        return wrench

    def scaled_norm(self, wrench: ArrayLike) -> float:
        """Norm [N] of a wrench (6,) in the balance rows, moments divided by ``moment_length``."""
        return float(np.linalg.norm(self.scale_wrenches(array_of("wrench", wrench, (6,)))))

    def support(self, direction: ArrayLike) -> Array:
        """s_i(y) (k,): least component along ``direction`` y (rows,) that contact i can give per newton of F_n.

        y . n_i - mu/sqrt(2) (|y . x_i| + |y . y_i|), the support of the unit pyramid. For any unit y and any
        multipliers the net wrench is at least sum_i F_i s_i(y) + y . load: a bound linear in the normal forces.
        """
        along = np.einsum("r,rkc->kc", array_of("direction", direction, (self.rows,)), self.scaled_columns)
        least: Array = along[:, 2] - self.pyramid * (np.abs(along[:, 0]) + np.abs(along[:, 1]))
        return least


def _load(value: ArrayLike) -> Array:
    if type(value) is np.ndarray and value.shape == (6,) and value.dtype == np.float64:  # the quick way
        load: Array = value.copy()
        if np.vdot(load, load) <= _STRONG**2:
            return frozen(load)
    load = array_of("load", value, (6,))
    if not np.vdot(load, load) <= _STRONG**2:  # np.vdot overflows without a warning
        raise InvalidInput(f"load: expected at most {_STRONG:g} N and N m, got {load.tolist()}")
    return load
