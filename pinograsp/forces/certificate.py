"""When an answer counts: the certificate of forces, the proof that there are none, and the one set of tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pinograsp.checks import brief

Number = TypeVar("Number", float, np.ndarray)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """What an answer may miss and still count.

    Solvers stop at tighter values of their own; an answer is accepted by these alone.

    Attributes:
        residual: of the balance, relative to the load [-].
        violation: of friction, bounds on F_n and torque limits, relative to the load or the largest F_n [-].
        gap: between objective and lower bound, relative to the objective [-].
        proof: margin that a proof of infeasibility must exceed, relative to the load [-]: a thousand times the
            rounding of its closed form.
        active: a limit met to this share is active [-].
    """

    residual: float = 1e-9
    violation: float = 1e-8
    gap: float = 1e-6
    proof: float = 1e-11
    active: float = 1e-6


TOLERANCE = Tolerance()

# Objectives can vanish (motor heat, where contact forces cancel gravity): below the one share of what forces like the
# load, or none at all, cost, the gap is measured against the other.
_NEGLIGIBLE, _VANISHING = 1e-5, 1e-2
_WEIGHTLESS = 1e-6  # of the least normal force: a smaller load says nothing of the forces


def load_size_of(load: np.ndarray, least: np.ndarray) -> float:
    """What forces are measured against [N]: the size of the load (rows,), or of the least F_n (k,) without one."""
    largest = float(least.max())
    size = max(float(np.sqrt(load @ load)), _WEIGHTLESS * largest) if np.any(load) else largest
    return size or 1.0


def objective_size_of(objective: float, constant: float) -> float:
    """What the gap of an objective with that constant is measured against: the objective, where it does not vanish."""
    usual = max(1.0, abs(constant))
    size = abs(objective)
    return _VANISHING * usual if size < _NEGLIGIBLE * usual else size


def is_optimal(
    *,
    residual_norm: Number,
    load_size: Number,
    violation: Number,
    force_size: Number,
    gap: Number,
    objective_size: Number,
    tolerance: Tolerance = TOLERANCE,
) -> bool | np.ndarray:
    """The rule of :meth:`Certificate.is_optimal`, for numbers and arrays alike. What is not a number fails."""
    return (
        (residual_norm <= tolerance.residual * load_size)
        & (violation <= tolerance.violation * force_size)
        & (gap <= tolerance.gap * objective_size)
    )


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: see record_of
class Certificate:
    """Why an answer can be trusted: computed from the answer by this package, not reported by a solver.

    Attributes:
        objective: its value at the forces, in its own unit.
        lower_bound: proven: no admissible forces cost less, in the same unit.
        residual: what forces and load leave over (6,), linear first, about the centre of mass, world axes [N, N m].
        residual_norm: norm of the residual in the balance rows, moments over the moment length [N].
        violation: largest violation of friction, of the bounds on F_n or of a torque limit (there: the change of
            contact forces that would mend it) [N].
        load_size: what ``residual_norm`` is measured against: size of the load, or of the least F_n without one [N].
        force_size: what ``violation`` is measured against: ``load_size`` or the largest F_n, whichever is more [N].
        objective_size: what the gap is measured against: the objective, or 1 % of what forces like the load cost
            where it vanishes.
        at_friction: contacts at their friction limit (k,) bool.
        at_least: contacts at their least normal force (k,) bool.
        at_most: contacts at their largest normal force (k,) bool.
        at_torque: joints at their torque limit.
    """

    objective: float
    lower_bound: float
    residual: np.ndarray
    residual_norm: float
    violation: float
    load_size: float
    force_size: float
    objective_size: float
    at_friction: np.ndarray
    at_least: np.ndarray
    at_most: np.ndarray
    at_torque: tuple[str, ...] = ()

    __repr__ = brief()

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
        """Whether the forces are admissible and no others cost less.

        Each to its tolerance: residual_norm <= tolerance.residual * load_size,
        violation <= tolerance.violation * force_size, and objective - lower_bound <= tolerance.gap * objective_size.
        """
        return is_optimal(
            residual_norm=self.residual_norm,
            load_size=self.load_size,
            violation=self.violation,
            force_size=self.force_size,
            gap=self.objective - self.lower_bound,
            objective_size=self.objective_size,
            tolerance=tolerance,
        )

    def active(self, names: Sequence[str]) -> tuple[str, ...]:
        """The active limits in words, for contacts called ``names``."""
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
        margin: whatever the forces, at least this much of the residual (and of torque beyond its limits) is left [N],
            measured along ``direction``. Checked in closed form; positive.
        direction: wrench (6,) of the proof, unit in the balance rows [-]: moments over the moment length.
        joint_weights: part of the proof on the joint torques (n,) [1/m]; zero where torque limits play no part. With
            r the residual in the balance rows (moments over the moment length) and tau the joint torques of *any*
            admissible forces, direction . r + joint_weights . tau - |joint_weights| . limit >= margin, though balance
            and limits ask for at most 0.
        closest_c: closest admissible forces (k, 3) [N].
        closest_torsion: their moments about the contact normals (k,) [N m].
        residual: what the closest forces leave over (6,) [N, N m].
        at_friction: contacts whose closest force meets its friction limit (k,) bool.
        at_least: contacts whose closest force meets its least normal force (k,) bool.
        at_most: contacts whose closest force meets its largest normal force (k,) bool.
        at_torque: joints whose torque limit takes part.
        crossed: contacts whose bounds on F_n exclude each other (k,) bool.
    """

    margin: float
    direction: np.ndarray
    joint_weights: np.ndarray
    closest_c: np.ndarray
    closest_torsion: np.ndarray
    residual: np.ndarray
    at_friction: np.ndarray
    at_least: np.ndarray
    at_most: np.ndarray
    at_torque: tuple[str, ...]
    crossed: np.ndarray

    __repr__ = brief()
