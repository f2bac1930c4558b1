"""The convex program over contact forces, and its lower bound from the dual. Pure functions.

Variables are per contact x_i = (u_i, F_i): scaled tangential force (and torsion) and normal force, so that friction of
every model reads u_i in F_i U (:mod:`pinograsp.contacts.friction`). The program is

    minimise    sum_i phi(F_i) + 1/2 x'P x + q'x + p max_i F_i
    subject to  A x = b,   u_i in F_i U,   lo <= F <= hi,   R_lo <= R x <= R_hi,

with phi a sum of powers (the grasp energy, Eqs. 9 and 11), A the grasp map (Eq. 15) and R the joint torques. Everything
is made dimensionless first: forces by ``force_scale``, the objective by ``objective_scale``, torque rows to unit norm.

Lower bound. Convexity gives f(x) >= f(z) + f'(z) (x - z) at any point z; adding y'(A x - b) and the weighted torque
rows leaves a linear function that separates over the contacts, and its least value over F_i in [lo, hi], u_i in F_i U
is min(lo s_i, hi s_i) with s_i = c_i,n - support_U(c_i,t). It holds for *any* y, w and z, whichever solver they came
from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from pinograsp.checks import instance_of, number, one_of, shorten
from pinograsp.contacts import Friction
from pinograsp.contacts.compliance import MEASURES, Measure
from pinograsp.errors import InvalidInput
from pinograsp.forces.certificate import load_size_of
from pinograsp.forces.matrices import Matrices, matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.spatial import Array

ObjectiveName = Literal[Measure, "least_squares", "peak", "motor_heat"]
OBJECTIVES: tuple[ObjectiveName, ...] = get_args(ObjectiveName)
# One of them, or the weights of a sum.
Objective: TypeAlias = ObjectiveName | Mapping[ObjectiveName, float]

_LIGHTEST, _HEAVIEST = 1e-100, 1e100  # weights that squares of forces can be multiplied by, and divided by again

# Per grasp-energy measure: (coefficient, exponent) pairs.
EnergyTerms: TypeAlias = Mapping[Measure, Sequence[tuple[float, float]]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """A force problem at one impact time and one objective, dimensionless. See the module for the symbols.

    Attributes:
        matrices: shared with the problem's other programs.
        b: right-hand side of the balance (rows,).
        lo: least F_n (k,).
        hi: largest F_n (k,).
        R_lo: least values of the torque rows (m,).
        R_hi: largest values of the torque rows (m,).
        powers: (coefficient, exponent) pairs of phi.
        P: quadratic objective (k d, k d), or None.
        q: linear objective (k d,).
        peak: p, weight of the largest F_n.
        constant: constant term of the objective.
        force_scale: unit of the forces [N].
        objective_scale: unit of the objective, in its own unit.
    """

    matrices: Matrices
    b: Array
    lo: Array
    hi: Array
    R_lo: Array
    R_hi: Array
    powers: tuple[tuple[float, float], ...]
    P: Array | None
    q: Array
    peak: float
    constant: float
    force_scale: float
    objective_scale: float

    @property
    def friction(self) -> Friction:
        """The friction model."""
        return self.matrices.friction

    @property
    def k(self) -> int:
        """Number of contacts."""
        return self.matrices.k

    @property
    def d(self) -> int:
        """Variables per contact."""
        return self.matrices.d

    @property
    def A(self) -> Array:
        """Balance (rows, k d)."""
        return self.matrices.A

    @property
    def R(self) -> Array:
        """Torque rows (m, k d), of unit norm."""
        return self.matrices.R

    def value(self, x: Array) -> float:
        """The objective at x (k d,), in units of ``objective_scale``, without the constant."""
        F = x[self.d - 1 :: self.d]
        total = float(self.q @ x)
        for coefficient, exponent in self.powers:
            total += coefficient * float((np.maximum(F, 0.0) ** exponent).sum())  # rounding may leave F = -1e-17
        if self.P is not None:
            total += 0.5 * float(x @ self.P @ x)
        return total + self.peak * float(F.max()) if self.peak else total

    def slope(self, F: Array) -> tuple[Array, Array]:
        """First and second derivatives of phi at F (k,) > 0."""
        first, second = np.zeros(self.k), np.zeros(self.k)
        for coefficient, exponent in self.powers:
            if exponent == 1:
                first += coefficient
            else:
                power = (coefficient * exponent) * F ** (exponent - 1)
                first += power
                second += (exponent - 1) * power
        return first, second / np.maximum(F, 1e-300)  # a least normal force may be too small for a float

    def reduce_costs(self, c: Array) -> Array:
        """s_i (k,): least value of c_i . x_i per unit of F_i over u_i in F_i U."""
        c = c.reshape(self.k, self.d)
        return c[:, -1] - self.friction.support(c[:, :-1])

    def lower_bound(self, x: Array, y: Array, w: Array, refine: bool = True) -> float:
        """Certified lower bound of the optimum from any x, y (rows,) and w (m,), without the constant.

        ``refine`` improves it at some cost, where powers of F_n are in the objective.
        """
        F = np.minimum(np.maximum(x[self.d - 1 :: self.d], self.lo), self.hi)
        c = self.q + y @ self.A
        total = -float(y @ self.b)
        if self.P is not None:
            Px = self.P @ x
            c = c + Px
            total -= 0.5 * float(x @ Px)
        if len(w):
            c = c + w @ self.R
            total -= self.rows_at_their_limits(w)
        return total + self.separable(self.reduce_costs(c), F, refine)

    def separable(self, s: Array, F: Array, refine: bool = True) -> float:
        """Lower bound of sum_i phi(F_i) + s_i F_i + p max F over lo <= F <= hi, sharp where F is near the minimiser.

        phi lies above its tangents, so any point of tangency gives a bound: F first, then the minimiser if that is
        better.
        """
        bound = self._at_tangents(s, F)
        if self.powers and not self.peak and refine:
            bound = max(bound, self._at_tangents(s, self._minimiser(s, F)))
        return bound

    def _at_tangents(self, s: Array, F: Array) -> float:
        total = 0.0
        if self.powers:
            first, _ = self.slope(F)
            s = s + first
            total = sum(c * float((F**exponent).sum()) for c, exponent in self.powers) - float(first @ F)
        if self.peak:
            # max F >= theta . F for any weights theta >= 0 of sum one. These cancel negative s, first at contacts
            # below their own largest force (at the others the bound is sharp anyway); the remaining weight goes to the
            # contact with the largest lower bound.
            theta = np.maximum(0.0, -s) / self.peak * (F.max() * (1 - 1e-3) < F)
            free = np.where(self.hi * (1 - 1e-6) > F, theta, 0.0)
            free /= max(1.0, float(free.sum()))
            capped = np.where(self.hi * (1 - 1e-6) > F, 0.0, theta)
            left, wanted = 1.0 - float(free.sum()), float(capped.sum())
            theta = free + (capped * min(1.0, left / wanted) if wanted > 0 else 0.0)
            theta[np.argmax(self.lo)] += 1.0 - float(theta.sum())
            s = s + self.peak * theta
        return total + self.least(s)

    def least(self, s: Array) -> float:
        """Least value of s . F over lo <= F <= hi."""
        return float(np.minimum(self.lo * s, self.hi * s).sum())

    def _minimiser(self, s: Array, F: Array) -> Array:
        """Near argmin of phi(F) + s F over [lo, hi]: a few Newton steps from F."""
        for _ in range(4):
            first, second = self.slope(F)
            step = (first + s) / np.maximum(second, 1e-12)
            F = np.minimum(np.maximum(F - step, np.maximum(self.lo, 0.1 * F)), self.hi)
        return F

    def rows_at_their_limits(self, w: Array) -> float:
        """Largest value of w . R x that the torque limits allow."""
        return float(np.maximum(w * self.R_hi, w * self.R_lo).sum())

    def farkas_bound(self, y: Array, w: Array) -> float:
        """Farkas bound: for *all* admissible x, y . (A x - b) + torque excess weighted by w is at least this.

        Positive: the program is infeasible, and (y, w) proves it.
        """
        c = y @ self.A
        total = -float(y @ self.b)
        if len(w):
            c = c + w @ self.R
            total -= self.rows_at_their_limits(w)
        return total + self.least(self.reduce_costs(c))

    def violations(self, x: Array) -> tuple[float, Array, Array]:
        """Largest violation of friction, of the bounds on F and of the torque rows; gauges (k,); balance residual
        (rows,).
        """
        z = x.reshape(self.k, self.d)
        F = z[:, -1]
        gauge = self.friction.gauge(z[:, :-1])
        worst = float(np.maximum(np.maximum(gauge, self.lo) - F, F - self.hi).max())
        if len(self.R):
            torque = self.R @ x
            worst = max(worst, float(np.maximum(torque - self.R_hi, self.R_lo - torque).max()))
        return max(worst, 0.0), gauge, self.A @ x - self.b

    def remove_residual(self, x: Array, residual: Array) -> Array:
        """x with the balance's residual A x - b removed by the least-norm correction."""
        return x - self.matrices.correction @ residual


def weights_of(objective: Objective | None, problem: ForceProblem | None) -> dict[str, float]:
    """The objective as ``{name: weight >= 0}``; None stands for the problem's measure. ``problem``: None, any without
    torques.

    Raises:
        InvalidInput: unknown names, negative weights, none positive, or motor heat without torques.
    """
    if problem is not None:
        objective = instance_of("problem", problem, ForceProblem).measure if objective is None else objective
    if isinstance(objective, str):
        objective = {objective: 1.0}
    if not isinstance(objective, Mapping) or not objective:
        raise InvalidInput(
            f"objective: expected a name or {{name: weight}} of {', '.join(OBJECTIVES)}, got {shorten(objective)}"
        )
    weights: dict[str, float] = {}
    for name, weight in objective.items():
        weights[one_of("objective", name, OBJECTIVES)] = own = number(f"weight of {shorten(name)}", weight, at_least=0)
        if own and not _LIGHTEST <= own <= _HEAVIEST:
            raise InvalidInput(
                f"weight of {shorten(name)}: expected 0, or {_LIGHTEST:g} to {_HEAVIEST:g}, got {own:g}: only the "
                "ratios of the weights matter"
            )
    if not any(weights.values()):
        raise InvalidInput("objective: expected at least one weight above 0")
    if weights.get("motor_heat") and (problem is None or problem.torques is None):
        raise InvalidInput(
            "objective 'motor_heat': expected a problem with torques=TorqueLimits(...) (see torque_limits)"
        )
    return weights


def energy_terms_at(problem: ForceProblem, weights: Mapping[str, float], impact_time: float) -> EnergyTerms:
    """Per grasp-energy measure of the objective its powers of F_n at t_I [s], as :func:`assemble` takes them."""
    return {m: problem.energy_terms(impact_time, m) for m in MEASURES if weights.get(m)}


def program_at(problem: ForceProblem, matrices: Matrices, impact_time: float) -> Program:
    """The program of a problem at t_I [s]; ``matrices``: of the problem and the objective."""
    terms = energy_terms_at(problem, matrices.weights, impact_time)
    return assemble(matrices, problem.scaled_load, terms, *problem.normal_force_range(impact_time))


def feasibility(problem: ForceProblem, lo: Array, hi: Array) -> Program:
    """The program where only its constraints matter, for F_n in [lo, hi] (k,) [N]."""
    return assemble(matrices_of(problem, {"peak": 1.0}), problem.scaled_load, {}, lo, hi)


def assemble(matrices: Matrices, load: Array, terms: EnergyTerms, lo: Array, hi: Array) -> Program:
    """The program of a force problem.

    Args:
        matrices: of its contacts, friction, torque limits and objective.
        load: in the balance rows (rows,), moments over the moment length [N].
        terms: per grasp-energy measure of the objective its powers of F_n [N] (:func:`energy_terms_at`).
        lo: least F_n (k,) [N].
        hi: largest F_n (k,) [N].
    """
    weights, scale = matrices.weights, load_size_of(load, lo)
    powers = [(weights[m] * c * scale**e, e) for m in MEASURES if weights.get(m) for c, e in terms[m]]
    sizes = [c for c, _ in powers]
    peak = matrices.peak * scale
    if peak:
        sizes.append(peak)
    if matrices.P is not None:
        sizes.append(0.5 * matrices.P_size * scale**2)
    unit = max(sizes) if max(sizes) > 0 else 1.0
    R_lo, R_hi = matrices.R_lo, matrices.R_hi
    if len(R_lo):
        # Limits that no admissible forces reach are lowered to just beyond their reach: huge values spoil a solver's
        # scaling.
        reach = np.maximum(2.0 * matrices.R_reach @ hi, scale)
        R_lo, R_hi = np.maximum(R_lo, np.minimum(-reach, R_hi)), np.minimum(R_hi, np.maximum(reach, R_lo))
        R_lo, R_hi = R_lo / scale, R_hi / scale
    return Program(
        matrices=matrices,
        b=-load / scale,
        lo=lo / scale,
        hi=hi / scale,
        R_lo=R_lo,
        R_hi=R_hi,
        powers=tuple((c / unit, e) for c, e in powers),
        P=None if matrices.P is None else matrices.P * (scale**2 / unit),
        q=matrices.q * (scale / unit),
        peak=peak / unit,
        constant=matrices.constant / unit,
        force_scale=scale,
        objective_scale=unit,
    )
