"""A contact law that was measured: forces at depths."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, PPoly

from pinograsp.checks import array_of, at_least_zero, brief, number, read_only
from pinograsp.contacts.compliance import Compliance, MarhefkaOrin
from pinograsp.errors import InvalidInput
from pinograsp.plan import ContactLaw
from pinograsp.spatial import Array

_HALVINGS = 60  # of the interval between two depths: to the last digit


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredCompliance(Compliance):
    """A law through measured points, monotone and smooth between them (Fritsch and Carlson's cubics).

    The force is 0 at depth 0; beyond the last point the curve continues with its final slope.

    Attributes:
        depths: of the points (m,) [m], rising from 0 or above; at least one above 0.
        forces: at them (m,) [N], rising as well; 0 at depth 0.
        damping: share by which the force grows with the rate of the depth [s/m].
    """

    depths: Array
    forces: Array
    damping: float = 0.0
    _force: PPoly = field(init=False, repr=False)
    _energy: PPoly = field(init=False, repr=False)

    __repr__ = brief("depths", "forces", "damping")

    def __post_init__(self) -> None:
        depths, forces = array_of("depths", self.depths, (None,)), array_of("forces", self.forces, (None,))
        if len(depths) != len(forces):
            raise InvalidInput(f"measured law: expected as many depths as forces, got {len(depths)} and {len(forces)}")
        if len(depths) and depths[0] > 0:
            depths, forces = np.append(0.0, depths), np.append(0.0, forces)
        rises = np.all(np.diff(depths) > 0) and np.all(np.diff(forces) > 0)
        if len(depths) < 2 or depths[0] != 0 or forces[0] != 0 or not rises:
            raise InvalidInput(
                "measured law: expected depths and forces that rise from 0 m and 0 N, point by point, got depths "
                f"{depths.tolist()} and forces {forces.tolist()}: take the points in the order of their depths, and "
                "one for each depth"
            )
        curve = PchipInterpolator(depths, forces)
        steep = float(curve.derivative()(depths[-1])) or float((forces[-1] - forces[-2]) / (depths[-1] - depths[-2]))
        beyond = np.array([0.0, 0.0, steep, forces[-1]])
        force = PPoly(np.column_stack([curve.c, beyond]), np.append(depths, 2 * depths[-1]))
        object.__setattr__(self, "depths", read_only(depths))
        object.__setattr__(self, "forces", read_only(forces))
        object.__setattr__(self, "damping", number("damping", self.damping, at_least=0, unit="s/m"))
        object.__setattr__(self, "_force", force)
        object.__setattr__(self, "_energy", force.antiderivative())

    @property
    def loss(self) -> float:
        """The damping [s/m]."""
        return self.damping

    def force(self, depth: ArrayLike) -> Array:
        """F_n [N] at rest at penetration ``depth`` [m]."""
        return np.asarray(self._force(np.maximum(depth, 0.0)))

    def depth(self, force: ArrayLike) -> Array:
        """Penetration [m] at rest under a normal force >= 0 [N]."""
        wanted = at_least_zero("normal force", force)
        at = np.searchsorted(self.forces, wanted, side="right")
        last = at == len(self.forces)
        low = self.depths[at - 1]
        high = np.where(last, low, self.depths[np.minimum(at, len(self.depths) - 1)])
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            under = self._force(middle) <= wanted
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        steep = self._force.c[-2, -1]
        return np.where(last, self.depths[-1] + (wanted - self.forces[-1]) / steep, low)

    def slope(self, depth: ArrayLike) -> Array:
        """df/ddelta [N/m] at penetration ``depth`` >= 0 [m]."""
        return np.asarray(self._force(np.maximum(depth, 0.0), 1))

    def energy(self, depth: ArrayLike) -> Array:
        """Stored energy of the contact [J] at penetration ``depth`` [m]."""
        return np.asarray(self._energy(np.maximum(depth, 0.0)))

    def numbers(self, deepest: float = 0.0) -> ContactLaw:
        """The points and the damping."""
        table = np.column_stack([self.depths, self.forces])
        return ContactLaw(stiffness=1.0, damping=self.damping, exponent=0.0, table=table)


def law_of(stored: ContactLaw) -> Compliance:
    """Return the law whose numbers a plan keeps (:meth:`Compliance.numbers`)."""
    if len(stored.table):
        return MeasuredCompliance(depths=stored.table[:, 0], forces=stored.table[:, 1], damping=stored.damping)
    return MarhefkaOrin(stiffness=stored.stiffness, damping=stored.damping, exponent=stored.exponent)
