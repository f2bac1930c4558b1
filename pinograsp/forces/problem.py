"""The force problem: which contact forces balance the load, within friction and the limits of the penetration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from pinograsp import defaults
from pinograsp.checks import (
    array_of,
    brief,
    each_of,
    finite_of,
    floats_of,
    frozen,
    instance_of,
    integer,
    items_of,
    number,
    one_of,
    read_only,
    rebuilt,
    record_of,
    share_of,
    shown,
)
from pinograsp.contacts import (
    Compliance,
    ContactSet,
    DecelerationShape,
    Friction,
    energy_terms,
    impulse_energy,
    work_energy,
)
from pinograsp.contacts.compliance import MEASURES, Measure
from pinograsp.contacts.deceleration import bounds_of
from pinograsp.contacts.friction import LARGEST_MU, default_friction
from pinograsp.contacts.quality import BALANCES, Balance
from pinograsp.errors import InvalidInput
from pinograsp.forces.standard_form import StandardForms
from pinograsp.objects.body import Body
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array, BoolArray
from pinograsp.words import by_name, lines_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

_ENERGIES = {"impulse": impulse_energy, "work": work_energy}

BY_ACCELERATION = "deceleration range (Eq. 13c)"
BY_SPEED = "impact speed (Eq. 13b)"
BY_DEPTH = "penetration depth (Eq. 13a)"
BY_CAP = "largest normal force of the contact"

# Larger values come from a mistake of units; solvers would lose all digits to rounding.
_STRONG, _DEAR = 1e12, 1e100  # [N], energy per newton
_ENDLESS = 1e300  # [N m] of a torque limit: more overflows when it is scaled


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Underactuation:
    """What fewer drives than joints cannot choose: rows @ (bias + J^T f) = torques, f being the forces on the object.

    The planned forces keep to these equations, the forces under disturbances need not: friction in the joints, and
    their motion, bear what is left of them.

    Attributes:
        rows: combinations (p, n) of the joint torques that no drive makes, of unit length.
        torques: what springs make of them (p,) [N m].
        why: per row, the drive that is in the way (p,).
        friction: share of the contacts' torques that friction in joints and tendons bears [-]: each side may be off by
            so much of the sum over contacts of F_n times its largest arm on the row.
    """

    rows: Array
    torques: Array
    why: tuple[str, ...]
    friction: float = 0.0

    __repr__ = brief()

    def __post_init__(self) -> None:
        rows = array_of("rows of an underactuation", self.rows, (None, None))
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "torques", array_of("torques of an underactuation", self.torques, (len(rows),)))
        object.__setattr__(self, "friction", share_of("friction of an underactuation", self.friction))
        why = items_of("why of an underactuation", self.why, str)
        if len(why) != len(rows):
            raise InvalidInput(f"why of an underactuation: expected one text per row, {len(rows)}, got {len(why)}")
        object.__setattr__(self, "why", why)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueLimits:
    """Limits of the joint torques: |bias + J^T f| <= (1 - reserve) limit, f being the forces on the object.

    Attributes:
        jacobian: of each contact point (k, 6, n), linear velocity first, world axes (``LOCAL_WORLD_ALIGNED``).
        bias: torque without contact at that posture (n,) [N m], usually that of gravity.
        limit: largest |torque| (n,) [N m]; infinity: no limit.
        joints: names (n,).
        reserve: share of each limit that is kept free [-]: forces use |torque| <= (1 - reserve) limit.
        underactuation: what the drives cannot choose of these torques; None: nothing.
    """

    jacobian: Array
    bias: Array
    limit: Array
    joints: tuple[str, ...] = ()
    reserve: float = 0.0
    underactuation: Underactuation | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        jacobian = array_of("contact Jacobians", self.jacobian, (None, 6, None))
        n = jacobian.shape[2]
        limit = floats_of("torque limits", self.limit, f"{n} numbers [N m]")
        if limit.shape != (n,) or not np.all((limit > 0) & ((limit <= _ENDLESS) | (limit == np.inf))):
            raise InvalidInput(
                f"torque limits: expected {n} values > 0, up to {_ENDLESS:g} [N m] or infinity where a joint has none, "
                f"got {shown(limit.tolist())}; a hand description without effort limits needs limit=..."
            )
        joints = items_of("joints of the torque limits", self.joints, str)
        if joints and len(joints) != n:
            raise InvalidInput(f"torque limits: expected {n} joint names, got {len(joints)}")
        bias = array_of("bias torques", self.bias, (n,))
        for name, unit, values in (("contact Jacobians", "m", jacobian), ("bias torques", "N m", bias)):
            if np.abs(values).max(initial=0.0) > _STRONG:
                raise InvalidInput(f"{name}: expected sizes up to {_STRONG:g} [{unit}], got {np.abs(values).max():g}")
        object.__setattr__(self, "jacobian", jacobian)
        object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "limit", read_only(limit))
        object.__setattr__(self, "joints", joints or tuple(f"joint {j + 1}" for j in range(n)))
        object.__setattr__(self, "reserve", share_of("reserve of the torque limits", self.reserve))
        instance_of("underactuation", self.underactuation, Underactuation, type(None))
        if self.underactuation is not None and self.underactuation.rows.shape[1] != n:
            raise InvalidInput(f"underactuation: expected {n} torques, got {self.underactuation.rows.shape[1]}")

    @property
    def usable(self) -> Array:
        """Largest |torque| that forces may use (n,) [N m], which leaves the reserve of the limits free."""
        usable: Array = (1.0 - self.reserve) * self.limit
        return usable

    @property
    def limited(self) -> BoolArray:
        """Which joints have a limit (n,) bool."""
        finite: BoolArray = np.isfinite(self.limit)
        return finite

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Names of the joints that have a limit, in the order of a program's torque rows."""
        return tuple(joint for joint, finite in zip(self.joints, self.limited) if finite)

    def torques(self, forces_o: ArrayLike, moments_o: ArrayLike | None = None) -> Array:
        """Joint torques (n,) [N m] under forces on the object (k, 3) [N] and moments (k, 3) [N m], world axes."""
        shape = (len(self.jacobian), 3)
        tau: Array = self.bias + np.einsum("kxn,kx->n", self.jacobian[:, :3], array_of("forces", forces_o, shape))
        if moments_o is not None:
            tau += np.einsum("kxn,kx->n", self.jacobian[:, 3:], array_of("moments", moments_o, shape))
        return tau


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


class ProblemSettings(TypedDict, total=False):
    """The optional arguments of :class:`ForceProblem` that describe neither contacts nor object."""

    compliance: Compliance
    balance: Balance
    measure: Measure
    final_time: float
    impact_time_range: tuple[float, float]
    acceleration_range: tuple[float, float]
    max_speed: float
    max_depth: float
    moment_length: float | None
    friction: Friction | None
    min_normal_force: ArrayLike | None
    max_normal_force: ArrayLike | None
    torques: TorqueLimits | None
    shape: DecelerationShape


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: with_load copies all attributes at once
class ForceProblem(StandardForms):
    """k contacts, a load, friction, and the constraints of Eqs. (13)-(16).

    Attributes:
        contacts: the contact points and frames.
        load: external wrench on the object (6,), linear first, about the centre of mass, world axes [N, N m].
        mu: friction coefficient of each contact (k,) [-]; a number applies to all.
        compliance: the contact law.
        balance: ``"wrench"`` (forces and moments, the default) or ``"force"`` (forces only, the paper's Eq. 15).
        measure: grasp energy that is minimised, ``"impulse"`` [N s] (Eq. 11) or ``"work"`` [J] (Eq. 9).
        final_time: t_F [s].
        impact_time_range: admissible t_I [s] (Eq. 14).
        acceleration_range: admissible A [m/s^2] (Eq. 13c).
        max_speed: bound on A tau [m/s] (Eq. 13b).
        max_depth: bound on delta_F [m] (Eq. 13a).
        moment_length: moments are divided by this length so that they compare with forces [m]; default (None): the
            mean distance of the contacts from the centre of mass.
        gravity_o: gravity (3,) [m/s^2]; it acts on the hand too, when joint torques are computed.
        friction: the friction model with its safety factor; default (None): cones, and soft fingers (5 mm of torsion)
            where no more than two fingers touch, which would hold nothing against turning about their line otherwise.
            The grids need the paper's pyramid, ``Friction()``.
        min_normal_force: least F_n (k,) [N] besides the limits of the penetration; a number applies to all.
        max_normal_force: caps on F_n (k,) [N] besides the limits of the penetration; a number applies to all.
        torques: limits of the joint torques, or None.
        shape: of the deceleration over the grasp phase; constant by default, as in the paper.
        object: the held shape (of :mod:`pinograsp.objects`), where it is known; the depth of links is measured from its
            surface.
        scaled_columns: grasp map with moments divided by ``moment_length``: (rows, k, 3), columns per contact x, y, z
            [-].
    """

    contacts: ContactSet
    load: Array
    mu: Array
    compliance: Compliance = field(default_factory=Compliance)
    balance: Balance = "wrench"
    measure: Measure = "impulse"
    final_time: float = defaults.FINAL_TIME
    impact_time_range: tuple[float, float] = defaults.IMPACT_TIMES
    acceleration_range: tuple[float, float] = defaults.ACCELERATIONS
    max_speed: float = defaults.MAX_SPEED
    max_depth: float = defaults.MAX_DEPTH
    moment_length: float = None  # type: ignore[assignment]  # None becomes a length in __post_init__
    gravity_o: Array = defaults.GRAVITY  # type: ignore[assignment]  # becomes an array in __post_init__
    friction: Friction = None  # type: ignore[assignment]  # None becomes a model in __post_init__
    min_normal_force: Array | None = None
    max_normal_force: Array | None = None
    torques: TorqueLimits | None = None
    shape: DecelerationShape = field(default_factory=DecelerationShape.constant)
    object: Body | None = None
    scaled_columns: Array = field(init=False, repr=False)

    if TYPE_CHECKING:  # arguments may be numbers and lists, attributes are arrays

        def __init__(
            self,
            *,
            contacts: ContactSet,
            load: ArrayLike,
            mu: ArrayLike,
            gravity_o: ArrayLike = ...,
            object: Body | None = ...,
            **settings: Unpack[ProblemSettings],
        ) -> None: ...

    __repr__ = brief("contacts", "balance", "measure", "mu", "friction", "load", "final_time", "object")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        force, moment = (float(np.linalg.norm(part)) for part in (self.load[:3], self.load[3:]))
        balance = "forces and moments" if self.balance == "wrench" else "forces alone"
        low, high = self.impact_time_range
        return lines_of(
            f"{self.k} contacts bear a load of {force:.3g} N and {moment:.3g} N m, {balance} in balance",
            f"mu: {by_name(self.contacts.names, self.mu.tolist())} ({self.friction.model}, safety factor "
            f"{self.friction.safety:g})",
            f"least {self.measure}; impact from {low:g} to {high:g} s, complete at {self.final_time:g} s",
        )

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        k = len(instance_of("contacts", self.contacts, ContactSet))
        put("load", _load(self.load))
        put("gravity_o", array_of("gravity", self.gravity_o, (3,)))
        mu = each_of("mu", self.mu, k)
        if np.any((mu < 0) | (mu > LARGEST_MU)):
            raise InvalidInput(
                f"mu: expected friction coefficients >= 0, up to {LARGEST_MU:g}, got {shown(mu.tolist())}"
            )
        put("mu", mu)
        one_of("balance", self.balance, BALANCES)
        one_of("measure", self.measure, MEASURES)
        bounds = (self.final_time, self.impact_time_range, self.acceleration_range, self.max_speed, self.max_depth)
        for name, value in bounds_of(*bounds).items():
            put(name, value)
        instance_of("compliance", self.compliance, Compliance)
        if self.friction is None:
            put("friction", default_friction(contact.finger for contact in self.contacts))
        instance_of("friction", self.friction, Friction)
        instance_of("torques", self.torques, TorqueLimits, type(None))
        instance_of("shape", self.shape, DecelerationShape)
        instance_of("object", self.object, Body, type(None))
        if self.min_normal_force is not None:
            floor = each_of("least normal forces", self.min_normal_force, k)
            if np.any((floor < 0) | (floor > _STRONG)):
                raise InvalidInput(
                    f"least normal forces: expected values from 0 to {_STRONG:g} [N], got {shown(floor.tolist())}"
                )
            put("min_normal_force", floor)
        if self.max_normal_force is not None:
            cap = each_of("largest normal forces", self.max_normal_force, k)
            if np.any(cap <= 0):
                raise InvalidInput(f"largest normal forces: expected values > 0 [N], got {shown(cap.tolist())}")
            put("max_normal_force", cap)
            if self.min_normal_force is not None and np.any(self.min_normal_force > cap):
                raise InvalidInput(
                    f"normal forces: expected a least value up to the largest [N], got "
                    f"{shown(self.min_normal_force.tolist())} and {shown(cap.tolist())}"
                )
        if self.torques is not None and len(self.torques.jacobian) != k:
            raise InvalidInput(f"torques: expected Jacobians of {k} contacts, got {len(self.torques.jacobian)}")
        put("moment_length", self.contacts.checked_moment_length(self.moment_length))
        G = np.array(self.contacts.G)
        G[3:] /= self.moment_length
        put("scaled_columns", read_only(G[: self.rows].reshape(self.rows, k, 3)))

    def __reduce__(self) -> tuple[Any, ...]:
        return rebuilt(self)

    @classmethod
    def holding(
        cls,
        object: Body,
        contacts: ContactSet,
        *,
        mu: ArrayLike,
        gravity_o: ArrayLike = defaults.GRAVITY,
        **settings: Unpack[ProblemSettings],
    ) -> ForceProblem:
        """The problem of holding ``object`` against gravity (3,) [m/s^2].

        ``settings`` are optional attributes of the class: compliance, balance, measure, final_time, impact_time_range,
        acceleration_range, max_speed, max_depth, moment_length, friction, min_normal_force, max_normal_force,
        torques, shape.

        Raises:
            InvalidInput: a value that cannot be used.
            TypeError: an argument that the class does not have.
        """
        if unknown := [name for name in settings if name not in ProblemSettings.__annotations__]:
            raise TypeError(
                f"ForceProblem.holding() got an unexpected keyword argument '{unknown[0]}'; besides mu and gravity_o "
                f"it takes {', '.join(ProblemSettings.__annotations__)}"
            )
        with np.errstate(over="ignore"):  # an infinite load is refused
            weight = instance_of("object", object, Body).mass * array_of("gravity", gravity_o, (3,))
        load = np.concatenate([weight, np.zeros(3)])
        return cls(contacts=contacts, load=load, mu=mu, gravity_o=gravity_o, object=object, **settings)

    def with_load(self, load: ArrayLike) -> ForceProblem:
        """The same problem under another load (6,) [N, N m]: for loops where nothing else changes."""
        return record_of(ForceProblem, self.__dict__ | {"load": _load(load)})

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
        return read_only(np.concatenate([self.load[:3], self.load[3:] / self.moment_length])[: self.rows])

    def depth_per_acceleration(self, impact_time: float) -> float:
        """Final depth per deceleration [s^2] for an impact at t_I [s]: tau^2 / 2 if constant (Eq. 24b)."""
        return self.shape.depth_factor * (self.final_time - self.checked_impact_time(impact_time)) ** 2

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
        K, rho = self.compliance.stiffness, self.compliance.exponent

        def force(depth: float) -> float:
            try:
                return float(K * depth**rho)
            except OverflowError:
                return np.inf

        low, high = force(self.acceleration_range[0] * depth), force(limits[reason])
        if not low <= _STRONG:
            raise InvalidInput(
                f"contact law: expected a least normal force of at most {_STRONG:g} N, got {low:.3g} N at a stiffness "
                f"of {K:g} N/m^rho and an exponent of {rho:g}; check these, and the least acceleration"
            )
        return NormalForceLimits(low, min(high, _STRONG), reason)

    def energy_terms(self, impact_time: float, measure: Measure | None = None) -> tuple[tuple[float, float], ...]:
        """The measure as a sum of powers of F_n: (coefficient, exponent) pairs, in the measure's unit."""
        name = one_of("measure", self.measure if measure is None else measure, MEASURES)
        duration = self.final_time - self.checked_impact_time(impact_time)
        try:
            terms = energy_terms(self.compliance, name, duration, self.shape)
        except OverflowError:
            terms = ((float("inf"), 1.0),)
        if not all(0 < coefficient <= _DEAR for coefficient, _ in terms):
            raise InvalidInput(
                f"contact law: expected an energy per newton above 0 and up to {_DEAR:g}, got "
                f"{', '.join(f'{coefficient:.3g}' for coefficient, _ in terms)}; check stiffness, exponent and "
                f"damping of {self.compliance}"
            )
        return terms

    def energy(self, normal_force: ArrayLike, impact_time: float, measure: Measure | None = None) -> Array:
        """Grasp energy per contact for final normal forces [N] and an impact at t_I [s]; in the measure's unit."""
        energy = _ENERGIES[one_of("measure", self.measure if measure is None else measure, MEASURES)]
        depth = self.compliance.depth(normal_force)
        return energy(self.compliance, depth, self.final_time - self.checked_impact_time(impact_time), self.shape)

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
        wrench = array_of("wrench", wrench, (6,))
        return float(np.linalg.norm(np.concatenate([wrench[:3], wrench[3:] / self.moment_length])[: self.rows]))

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
