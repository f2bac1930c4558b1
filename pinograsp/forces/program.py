"""The convex program over contact forces, its lower bound from the dual, and its certificate. Pure functions.

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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import instance_of, number, one_of, shown
from pinograsp.contacts import Friction
from pinograsp.errors import InvalidInput
from pinograsp.forces.certificate import load_size_of
from pinograsp.forces.problem import MEASURES, ForceProblem, kept

OBJECTIVES = (*MEASURES, "least_squares", "peak", "motor_heat")
_OBJECTIVES = 8  # whose matrices are kept with the contacts: some 90 kB each for 30 contacts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """A force problem at one impact time and one objective, dimensionless. See the module for the symbols.

    Attributes:
        friction: the model.
        k: contacts.
        d: numbers per contact. A (rows, k d), b (rows,). lo, hi (k,).
        R (m, k d), R_lo, R_hi (m,): torque rows, scaled to unit norm.
        powers: (coefficient, exponent) pairs of phi.
        P (k d, k d) or None, q (k d,), peak p, constant: the rest of the objective.
        force_scale [N]; objective_scale in the objective's unit.
    """

    friction: Friction
    k: int
    d: int
    A: np.ndarray
    b: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    R: np.ndarray
    R_lo: np.ndarray
    R_hi: np.ndarray
    powers: tuple[tuple[float, float], ...]
    P: np.ndarray | None
    q: np.ndarray
    peak: float
    constant: float
    force_scale: float
    objective_scale: float
    cache: dict

    def value(self, x: np.ndarray) -> float:
        """The objective at x (k d,), in units of ``objective_scale``, without the constant."""
        F = x[self.d - 1 :: self.d]
        total = float(self.q @ x)
        for coefficient, exponent in self.powers:
            total += coefficient * float((np.maximum(F, 0.0) ** exponent).sum())  # rounding may leave F = -1e-17
        if self.P is not None:
            total += 0.5 * float(x @ self.P @ x)
        return total + self.peak * float(F.max()) if self.peak else total

    def slope(self, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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

    def reduced(self, c: np.ndarray) -> np.ndarray:
        """s_i (k,): least value of c_i . x_i per unit of F_i over u_i in F_i U."""
        c = c.reshape(self.k, self.d)
        return c[:, -1] - self.friction.support(c[:, :-1])

    def lower_bound(self, x: np.ndarray, y: np.ndarray, w: np.ndarray, refine: bool = True) -> float:
        """Certified lower bound of the optimum from any x, y (rows,) and w (m,), without the constant.

        ``refine`` spends more on it where powers of F_n are in the objective.
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
        return total + self.separable(self.reduced(c), F, refine)

    def separable(self, s: np.ndarray, F: np.ndarray, refine: bool = True) -> float:
        """Lower bound of sum_i phi(F_i) + s_i F_i + p max F over lo <= F <= hi, sharp where F is near the minimiser.

        phi lies above its tangents, so any point of tangency gives a bound: F first, then the minimiser if that is
        better.
        """
        bound = self._at_tangents(s, F)
        if self.powers and not self.peak and refine:
            bound = max(bound, self._at_tangents(s, self._minimiser(s, F)))
        return bound

    def _at_tangents(self, s: np.ndarray, F: np.ndarray) -> float:
        total = 0.0
        if self.powers:
            first, _ = self.slope(F)
            s = s + first
            total = sum(c * float((F**exponent).sum()) for c, exponent in self.powers) - float(first @ F)
        if self.peak:
            # max F >= theta . F for any weights theta >= 0 of sum one: these cancel what they can, at contacts below
            # their own largest force first (at the others the bound is sharp without); the rest goes to the largest
            # lower bound.
            theta = np.maximum(0.0, -s) / self.peak * (F.max() * (1 - 1e-3) < F)
            free = np.where(self.hi * (1 - 1e-6) > F, theta, 0.0)
            free /= max(1.0, float(free.sum()))
            capped = np.where(self.hi * (1 - 1e-6) > F, 0.0, theta)
            left, wanted = 1.0 - float(free.sum()), float(capped.sum())
            theta = free + (capped * min(1.0, left / wanted) if wanted > 0 else 0.0)
            theta[np.argmax(self.lo)] += 1.0 - float(theta.sum())
            s = s + self.peak * theta
        return total + self.least(s)

    def least(self, s: np.ndarray) -> float:
        """Least value of s . F over lo <= F <= hi."""
        return float(np.minimum(self.lo * s, self.hi * s).sum())

    def _minimiser(self, s: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Near argmin of phi(F) + s F over [lo, hi]: a few Newton steps from F."""
        for _ in range(4):
            first, second = self.slope(F)
            step = (first + s) / np.maximum(second, 1e-12)
            F = np.minimum(np.maximum(F - step, np.maximum(self.lo, 0.1 * F)), self.hi)
        return F

    def rows_at_their_limits(self, w: np.ndarray) -> float:
        """Largest value of w . R x that the torque limits allow."""
        return float(np.maximum(w * self.R_hi, w * self.R_lo).sum())

    def excluded(self, y: np.ndarray, w: np.ndarray) -> float:
        """Farkas bound: for *all* admissible x, y . (A x - b) + torque excess weighted by w is at least this.

        Positive: the program is infeasible, and (y, w) proves it.
        """
        c = y @ self.A
        total = -float(y @ self.b)
        if len(w):
            c = c + w @ self.R
            total -= self.rows_at_their_limits(w)
        return total + self.least(self.reduced(c))

    def violations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
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

    def settled(self, x: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """x with the balance's residual A x - b removed by the least-norm correction."""
        if "A_pinv" not in self.cache:
            self.cache["A_pinv"] = np.linalg.pinv(self.A, rcond=1e-10)
        return x - self.cache["A_pinv"] @ residual


def weights_of(objective: str | Mapping[str, float] | None, problem: ForceProblem) -> dict[str, float]:
    """The objective as ``{name: weight >= 0}``; None stands for the problem's measure.

    Raises:
        InvalidInput: unknown names, negative weights, none positive, or motor heat without torques.
    """
    if objective is None:
        objective = problem.measure
    instance_of("problem", problem, ForceProblem)
    if isinstance(objective, str):
        objective = {objective: 1.0}
    if not isinstance(objective, Mapping) or not objective:
        raise InvalidInput(
            f"objective: expected a name or {{name: weight}} of {', '.join(OBJECTIVES)}, got {shown(objective)}"
        )
    weights = {
        one_of("objective", name, OBJECTIVES): number(f"weight of {shown(name)}", weight, at_least=0)
        for name, weight in objective.items()
    }
    if not any(weights.values()):
        raise InvalidInput("objective: expected at least one weight above 0")
    if weights.get("motor_heat") and problem.torques is None:
        raise InvalidInput(
            "objective 'motor_heat': expected a problem with torques=TorqueLimits(...) (see torque_limits)"
        )
    return weights


def columns_of(problem: ForceProblem) -> np.ndarray:
    """Grasp map on x: (rows, k d), friction's scale included."""
    stored = problem._assembled
    if "A" not in stored:
        base, friction = problem.scaled_columns, problem.friction
        scale = friction.scale(problem.mu)
        columns = np.zeros((problem.rows, problem.k, friction.d))
        columns[:, :, :2] = base[:, :, :2] * scale[None, :, :2]
        columns[:, :, -1] = base[:, :, 2]
        if friction.d == 4 and problem.rows == 6:
            normals = problem.contacts.rotations_oc[:, :, 2]
            columns[3:, :, 2] = (normals * scale[:, 2:3]).T / problem.moment_length
        stored["A"] = columns.reshape(problem.rows, -1)
    return stored["A"]


def torque_columns(problem: ForceProblem) -> np.ndarray:
    """Joint torques from x: (n, k d) [N m per newton], friction's scale included."""
    stored = problem._assembled
    if "torque" not in stored:
        rotations, friction = problem.contacts.rotations_oc, problem.friction
        scale = friction.scale(problem.mu)
        J = problem.torques.jacobian
        linear = np.einsum("kxn,kxc->nkc", J[:, :3], rotations)
        columns = np.zeros((J.shape[2], problem.k, friction.d))
        columns[:, :, :2] = linear[:, :, :2] * scale[None, :, :2]
        columns[:, :, -1] = linear[:, :, 2]
        if friction.d == 4:
            columns[:, :, 2] = np.einsum("kxn,kx->nk", J[:, 3:], rotations[:, :, 2]) * scale[:, 2]
        stored["torque"] = columns.reshape(J.shape[2], -1)
    return stored["torque"]


def energy_terms_at(problem: ForceProblem, weights: Mapping[str, float], impact_time: float) -> dict:
    """Per grasp-energy measure of the objective its powers of F_n at t_I [s], as :func:`assemble` takes them."""
    return {m: problem.energy_terms(impact_time, m) for m in MEASURES if weights.get(m)}


def feasibility(problem: ForceProblem, lo: np.ndarray, hi: np.ndarray) -> Program:
    """The program where only its constraints matter, for F_n in [lo, hi] (k,) [N]."""
    return assemble(problem, {"peak": 1.0}, {}, lo, hi)


def assemble(
    problem: ForceProblem,
    weights: Mapping[str, float],
    terms: Mapping[str, tuple[tuple[float, float], ...]],
    lo: np.ndarray,
    hi: np.ndarray,
) -> Program:
    """The program of a force problem.

    Args:
        problem: contacts, load, friction, limits.
        weights: objective, see :func:`weights_of`.
        terms: per grasp-energy measure in ``weights`` its powers of F_n [N] (:func:`energy_terms_at`).
        lo, hi: range of F_n (k,) [N].
    """
    k, d = problem.k, problem.friction.d
    stored = problem._assembled
    A, load = columns_of(problem), problem.scaled_load
    scale = load_size_of(load, lo)
    powers = [(weights[m] * c * scale**e, e) for m in MEASURES if weights.get(m) for c, e in terms[m]]
    P, q, constant, largest, cache = kept(
        stored["objectives"], tuple(weights.items()), lambda: _quadratic(problem, weights), _OBJECTIVES
    )
    sizes = [c for c, _ in powers]
    peak = weights.get("peak", 0.0) * scale
    if peak:
        sizes.append(peak)
    if P is not None:
        sizes.append(0.5 * largest * scale**2)
    unit = max(sizes) if max(sizes) > 0 else 1.0
    if "rows" not in stored:
        stored["rows"] = _torque_rows(problem)
        rows = stored["rows"][0].reshape(-1, k, d)
        stored["reach"] = np.abs(rows[:, :, -1]) + problem.friction.support(
            rows[:, :, :-1]
        )  # largest |row . x| per newton of F_n
    R, R_lo, R_hi, _ = stored["rows"]
    if len(R):
        # A limit that no admissible forces reach is drawn in to just beyond their reach: huge ones spoil a solver's
        # scaling.
        reach = np.maximum(2.0 * stored["reach"] @ hi, scale)
        R_lo, R_hi = np.maximum(R_lo, np.minimum(-reach, R_hi)), np.minimum(R_hi, np.maximum(reach, R_lo))
    cache["torque limits"] = stored["rows"][1:3]
    return Program(
        friction=problem.friction,
        k=k,
        d=d,
        A=A,
        b=-load / scale,
        lo=lo / scale,
        hi=hi / scale,
        R=R,
        R_lo=R_lo / scale if len(R) else R_lo,
        R_hi=R_hi / scale if len(R) else R_hi,
        powers=tuple((c / unit, e) for c, e in powers),
        P=None if P is None else P * (scale**2 / unit),
        q=q * (scale / unit),
        peak=peak / unit,
        constant=constant / unit,
        force_scale=scale,
        objective_scale=unit,
        cache=cache,
    )


def _quadratic(problem: ForceProblem, weights) -> tuple[np.ndarray | None, np.ndarray, float, float, dict]:
    """P, q and the constant of the quadratic objectives, in newtons and the objectives' units; P's largest diagonal
    entry.

    And an empty cache: solvers keep there what depends on nothing else.
    """
    n = problem.k * problem.friction.d
    P, q, constant = None, np.zeros(n), 0.0
    if weights.get("least_squares"):
        size = np.ones((problem.k, problem.friction.d))
        size[:, :-1] = problem.friction.scale(problem.mu)
        size[:, 2:-1] /= problem.moment_length
        P = np.diag(2 * weights["least_squares"] * size.ravel() ** 2)
    if weights.get("motor_heat"):
        T, bias, weight = torque_columns(problem), problem.torques.bias, weights["motor_heat"]
        heat = 2 * weight * T.T @ T
        P = heat if P is None else P + heat
        q = 2 * weight * bias @ T
        constant = weight * float(bias @ bias)
    largest = 0.0 if P is None else float(np.abs(np.diag(P)).max()) or 1.0
    return P, q, constant, largest, {}


def _torque_rows(problem: ForceProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """R, its bounds in newtons, and the norms [m] the rows were divided by."""
    n = problem.k * problem.friction.d
    if problem.torques is None or not np.any(problem.torques.limited):
        return np.zeros((0, n)), np.zeros(0), np.zeros(0), np.zeros(0)
    limited = problem.torques.limited
    limit, bias = problem.torques.limit[limited], problem.torques.bias[limited]
    rows = torque_columns(problem)[limited]
    norm = np.linalg.norm(rows, axis=1)
    norm[norm <= 1e-12 * max(float(norm.max()), 1e-300)] = 1.0
    return rows / norm[:, None], (-limit - bias) / norm, (limit - bias) / norm, norm
