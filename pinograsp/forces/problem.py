"""The force problem: which contact forces balance the load, within friction and the limits of the penetration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pinograsp.checks import array_of, number, one_of, read_only
from pinograsp.contacts import Compliance, ContactSet, impulse_energy, work_energy
from pinograsp.errors import InvalidInput

BALANCES = ("wrench", "force")
MEASURES = ("impulse", "work")
_ENERGIES = {"impulse": impulse_energy, "work": work_energy}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceProblem:
    """k contacts, a load, friction, and the constraints of Eqs. (13)-(16).

    Attributes:
        contacts: the contact points and frames.
        load: external wrench on the object (6,), linear first, about the centre of mass, world axes [N, N m].
        mu: friction coefficient per contact (k,) [-]; a number applies to all.
        compliance: the contact law.
        balance: ``"wrench"`` (forces and moments, the default) or ``"force"`` (forces only, the paper's Eq. 15).
        measure: grasp energy that is minimised, ``"impulse"`` [N s] (Eq. 11) or ``"work"`` [J] (Eq. 9).
        final_time: t_F [s]. impact_time_range: admissible t_I [s] (Eq. 14).
        acceleration_range: admissible A [m/s^2] (Eq. 13c). max_speed: bound on A tau [m/s] (Eq. 13b).
        max_depth: bound on delta_F [m] (Eq. 13a).
        moment_length: moments are divided by it so that they compare with forces [m]; default: the mean distance of
            the contacts from the centre of mass.
        gravity_o: gravity (3,) [m/s^2]; it acts on the hand too, when joint torques are computed.
    """

    contacts: ContactSet
    load: np.ndarray
    mu: np.ndarray
    compliance: Compliance = field(default_factory=Compliance)
    balance: str = "wrench"
    measure: str = "impulse"
    final_time: float = 1.0
    impact_time_range: tuple[float, float] = (0.80, 0.95)
    acceleration_range: tuple[float, float] = (0.01, 1.0)
    max_speed: float = 2.0
    max_depth: float = 5e-3
    moment_length: float | None = None
    gravity_o: np.ndarray = (0.0, 0.0, -9.81)

    def __post_init__(self):
        def put(name, value):
            object.__setattr__(self, name, value)

        k = len(self.contacts)
        put("load", array_of("load", self.load, (6,)))
        put("gravity_o", array_of("gravity", self.gravity_o, (3,)))
        mu = array_of("mu", np.broadcast_to(self.mu, (k,)) if np.ndim(self.mu) == 0 else self.mu, (k,))
        if np.any(mu < 0):
            raise InvalidInput(f"mu: expected friction coefficients >= 0, got {mu.tolist()}")
        put("mu", mu)
        one_of("balance", self.balance, BALANCES)
        one_of("measure", self.measure, MEASURES)
        put("final_time", number("final time t_F", self.final_time, above=0, unit="s"))
        put("impact_time_range", _range("impact time range", self.impact_time_range, "s", above=0))
        if self.impact_time_range[1] >= self.final_time:
            raise InvalidInput(
                f"impact time range: expected below the final time {self.final_time:g} s, got {self.impact_time_range[1]:g} s"
            )
        put("acceleration_range", _range("acceleration range", self.acceleration_range, "m/s^2", above=0))
        put("max_speed", number("maximum speed", self.max_speed, above=0, unit="m/s"))
        put("max_depth", number("maximum depth", self.max_depth, above=0, unit="m"))
        if self.moment_length is None:
            mean = float(np.linalg.norm(self.contacts.points_o - self.contacts.com_o, axis=1).mean())
            put("moment_length", mean if mean > 0 else 1.0)
        else:
            put("moment_length", number("moment length", self.moment_length, above=0, unit="m"))

    @classmethod
    def holding(cls, object, contacts: ContactSet, *, gravity_o=(0.0, 0.0, -9.81), **settings) -> ForceProblem:
        """The problem of holding ``object`` against gravity (3,) [m/s^2]; ``settings`` are the class's attributes."""
        weight = object.mass * array_of("gravity", gravity_o, (3,))
        load = np.concatenate([weight, np.zeros(3)])
        return cls(contacts=contacts, load=load, gravity_o=gravity_o, **settings)

    @property
    def k(self) -> int:
        """Number of contacts."""
        return len(self.contacts)

    @property
    def rows(self) -> int:
        """Balance rows: 3 for forces, 6 for the wrench."""
        return 3 if self.balance == "force" else 6

    @property
    def pyramid(self) -> np.ndarray:
        """mu / sqrt(2) (k,): half-width of the inscribed friction pyramid per unit normal force (Eq. 16)."""
        return self.mu / np.sqrt(2)

    @property
    def scaled_columns(self) -> np.ndarray:
        """Grasp map with moments divided by ``moment_length``: (rows, k, 3), columns per contact x, y, z [-]."""
        G = np.array(self.contacts.G)
        G[3:] /= self.moment_length
        return read_only(G[: self.rows].reshape(self.rows, self.k, 3))

    @property
    def scaled_load(self) -> np.ndarray:
        """Load (rows,) with moments divided by ``moment_length`` [N]."""
        return read_only(np.concatenate([self.load[:3], self.load[3:] / self.moment_length])[: self.rows])

    def normal_force(self, acceleration, impact_time: float) -> np.ndarray:
        """F_n at t_F [N] for decelerations A [m/s^2] and an impact at t_I [s] (Eq. 26)."""
        depth = np.asarray(acceleration, dtype=float) / 2 * (self.final_time - impact_time) ** 2
        return self.compliance.normal_force(depth)

    def acceleration(self, normal_force, impact_time: float) -> np.ndarray:
        """Deceleration A [m/s^2] that ends at these normal forces [N]: Eq. (26) solved for A."""
        return 2 * self.compliance.depth(normal_force) / (self.final_time - impact_time) ** 2

    def energy(self, normal_force, impact_time: float, measure: str | None = None) -> np.ndarray:
        """Grasp energy per contact for final normal forces [N] and an impact at t_I [s]; in the measure's unit."""
        energy = _ENERGIES[one_of("measure", measure or self.measure, MEASURES)]
        return energy(self.compliance, self.compliance.depth(normal_force), self.final_time - impact_time)

    def forces(self, normal_force, multipliers) -> np.ndarray:
        """Contact forces f_c (k, 3) [N] from normal forces (k,) and multipliers (k, 2) (Eqs. 27, 28)."""
        normal_force = np.asarray(normal_force, dtype=float)
        tangential = np.asarray(multipliers, dtype=float) * (self.pyramid * normal_force)[:, None]
        return np.column_stack([tangential, normal_force])

    def residual(self, forces_c) -> np.ndarray:
        """Net wrench (6,) on the object, load included [N, N m]: zero at equilibrium (Eq. 15)."""
        return self.contacts.G @ np.asarray(forces_c, dtype=float).ravel() + self.load

    def scaled_norm(self, wrench) -> float:
        """Norm [N] of a wrench (6,) in the balance rows, moments divided by ``moment_length``."""
        return float(np.linalg.norm(np.concatenate([wrench[:3], wrench[3:] / self.moment_length])[: self.rows]))

    def support(self, direction) -> np.ndarray:
        """s_i(y) (k,): least component along ``direction`` y (rows,) that contact i can give per newton of F_n.

        y . n_i - mu/sqrt(2) (|y . x_i| + |y . y_i|), the support of the unit pyramid. For any unit y and any
        multipliers the net wrench is at least sum_i F_i s_i(y) + y . load: a bound linear in the normal forces.
        """
        along = np.einsum("r,rkc->kc", np.asarray(direction, dtype=float), self.scaled_columns)
        return along[:, 2] - self.pyramid * (np.abs(along[:, 0]) + np.abs(along[:, 1]))


def _range(name: str, value, unit: str, above: float) -> tuple[float, float]:
    low, high = array_of(name, value, (2,))
    if not (above < low <= high):
        raise InvalidInput(f"{name}: expected {above:g} < lower <= upper [{unit}], got {low:g} and {high:g}")
    return float(low), float(high)
