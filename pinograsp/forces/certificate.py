"""When an answer counts: the certificate of forces, the proof that there are none, and the one set of tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pinograsp.checks import brief, items_of, number, shorten
from pinograsp.errors import InvalidInput
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array, BoolArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How far an answer may miss its conditions and still be accepted.

    Solvers stop at tighter tolerances of their own; acceptance depends on these alone.

    Attributes:
        residual: of the balance, relative to the load [-].
        violation: of friction, bounds on F_n and torque limits, relative to the load or the largest F_n [-].
        gap: between objective and lower bound, relative to the objective [-].
        proof: margin that a proof of infeasibility must exceed, relative to the load [-]: a thousand times the
            rounding of its closed form.
        active: limits within this relative distance count as active [-].
    """

    residual: float = 1e-9
    violation: float = 1e-8
    gap: float = 1e-6
    proof: float = 1e-11
    active: float = 1e-6

    def __post_init__(self) -> None:
        for one in fields(self):
            number(f"tolerance of {one.name}", getattr(self, one.name))

    def accepts(
        self, *, residual_norm: Any, load_size: Any, violation: Any, force_size: Any, gap: Any, objective_size: Any
    ) -> Any:
        """The rule of :meth:`Certificate.is_optimal`, for numbers and arrays alike. NaN fails."""
        return (
            (residual_norm <= self.residual * load_size)
            & (violation <= self.violation * force_size)
            & (gap <= self.gap * objective_size)
        )


TOLERANCE = Tolerance()

# Objectives can vanish (motor heat, where contact forces cancel gravity). Where one is below the first share of the
# usual cost (that of forces of the load's size, or of no forces), the gap is measured against the second share of it.
NEGLIGIBLE, VANISHING = 1e-5, 1e-2
_WEIGHTLESS = 1e-6  # relative to the least normal force: the size of a smaller load is no measure of the forces


def load_size_of(load: Array, least: Array) -> float:
    """The size that forces are compared with [N]: that of the load (rows,), or of the least F_n (k,) without a load."""
    largest = float(least.max())
    size = max(float(np.sqrt(load @ load)), _WEIGHTLESS * largest) if np.any(load) else largest
    return size or 1.0


def objective_size_of(objective: float, constant: float) -> float:
    """The size that the gap is compared with: the objective, unless it vanishes; ``constant`` is part of it."""
    usual = max(1.0, abs(constant))
    size = abs(objective)
    return VANISHING * usual if size < NEGLIGIBLE * usual else size


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: see record_of
class Certificate:
    """Why an answer can be trusted: computed from the answer by this package, not reported by a solver.

    Attributes:
        objective: its value at the forces, in its own unit.
        lower_bound: proven: no admissible forces cost less, in the same unit.
        residual: net wrench of forces and load (6,), linear first, about the centre of mass, world axes [N, N m].
        residual_norm: norm of the residual in the balance rows, moments over the moment length [N].
        violation: largest violation of friction, of the bounds on F_n or of a torque limit (there: the change of
            contact forces that would remove it) [N].
        load_size: ``residual_norm`` is compared with it: size of the load, or of the least F_n without one [N].
        force_size: ``violation`` is compared with it: ``load_size`` or the largest F_n, whichever is larger [N].
        objective_size: the gap is compared with it: the objective, or 1 % of the cost of forces of the load's size if
            the objective vanishes.
        at_friction: contacts at their friction limit (k,) bool.
        at_least: contacts at their least normal force (k,) bool.
        at_most: contacts at their largest normal force (k,) bool.
        at_torque: joints at their torque limit.
    """

    objective: float
    lower_bound: float
    residual: Array
    residual_norm: float
    violation: float
    load_size: float
    force_size: float
    objective_size: float
    at_friction: BoolArray
    at_least: BoolArray
    at_most: BoolArray
    at_torque: tuple[str, ...] = ()

    __repr__ = brief()
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        proven = "optimal" if self.is_optimal() else "not proven optimal"
        bound = f"no forces cost less than {self.lower_bound:.6g} (gap {self.relative_gap:.1e})"
        missed = f"balance missed by {self.residual_norm:.1e} N, limits by {self.violation:.1e} N"
        return f"{proven}: objective {self.objective:.6g}, {bound}; {missed}"

    @property
    def gap(self) -> float:
        """objective - lower_bound, in the objective's unit."""
        return self.objective - self.lower_bound

    @property
    def relative_gap(self) -> float:
        """Gap relative to ``objective_size`` [-]."""
        return self.gap / self.objective_size

    @property
    def residual_force(self) -> float:
        """Norm of the residual's force [N]."""
        return float(np.linalg.norm(self.residual[:3]))

    @property
    def residual_moment(self) -> float:
        """Norm of the residual's moment about the centre of mass [N m]."""
        return float(np.linalg.norm(self.residual[3:]))

    def is_optimal(self, tolerance: Tolerance = TOLERANCE) -> bool:
        """Whether the forces are admissible and no others cost less, within the tolerances.

        That is: residual_norm <= tolerance.residual * load_size,
        violation <= tolerance.violation * force_size, and objective - lower_bound <= tolerance.gap * objective_size.

        Raises:
            InvalidInput: a number instead of a :class:`Tolerance`, which has one number for each of the three.
        """
        if not isinstance(tolerance, Tolerance):
            raise InvalidInput(
                "tolerance: expected a Tolerance, which has one number for the balance, the limits and the gap each, "
                f"as Tolerance(gap=1e-6), got {shorten(tolerance)}"
            )
        return bool(
            tolerance.accepts(
                residual_norm=self.residual_norm,
                load_size=self.load_size,
                violation=self.violation,
                force_size=self.force_size,
                gap=self.gap,
                objective_size=self.objective_size,
            )
        )

    def active(self, names: Sequence[str]) -> tuple[str, ...]:
        """The active limits in words, for contacts called ``names``."""
        names = items_of("names", names, str)
        words = [
            f"{name}: {limit}"
            for limit, mask in (
                ("friction limit", self.at_friction),
                ("least normal force", self.at_least),
                ("largest normal force", self.at_most),
            )
            for name, meets in zip(names, mask)
            if meets
        ]
        return (*words, *(f"{joint}: torque limit" for joint in self.at_torque))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Infeasibility:
    """Proof that no admissible forces balance the load at one impact time, and the forces that come closest.

    Attributes:
        margin: least residual (and torque beyond its limits) that any admissible forces leave along ``direction`` [N];
            positive, computed in closed form.
        direction: wrench (6,) of the proof, unit in the balance rows [-]: moments over the moment length.
        joint_weights: weights of the joint torques in the proof (n,) [1/m]; zero if torque limits play no part. With r
            the residual in the balance rows (moments over the moment length) and tau the joint torques of *any*
            admissible forces, direction . r + joint_weights . tau - |joint_weights| . limit >= margin, although balance
            and limits require at most 0.
        closest_c: closest admissible forces (k, 3) [N].
        closest_torsion: their moments about the contact normals (k,) [N m].
        residual: net wrench of the closest forces and the load (6,) [N, N m].
        at_friction: contacts whose closest force meets its friction limit (k,) bool.
        at_least: contacts whose closest force meets its least normal force (k,) bool.
        at_most: contacts whose closest force meets its largest normal force (k,) bool.
        at_torque: joints whose torque limit is part of the proof.
        crossed: contacts whose bounds on F_n exclude each other (k,) bool.
    """

    margin: float
    direction: Array
    joint_weights: Array
    closest_c: Array
    closest_torsion: Array
    residual: Array
    at_friction: BoolArray
    at_least: BoolArray
    at_most: BoolArray
    at_torque: tuple[str, ...]
    crossed: BoolArray

    __repr__ = brief()

    def __str__(self) -> str:
        limits = f", with the torque limits of {', '.join(self.at_torque)}" if self.at_torque else ""
        return f"proven: {self.least_left()}{limits}"

    def least_left(self) -> str:
        """State in words the least residual that any admissible forces leave, with its norm."""
        over = " and of the torques above their limits" if self.at_torque else ""
        return (
            f"any admissible forces leave at least {self.margin:.4g} N of the net wrench{over} (norm of force and "
            "moment, the moment over the moment length)"
        )
