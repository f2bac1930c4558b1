"""Derivatives of the optimal forces and their cost by load, friction, contact points and normals.

At an optimum without degeneracy the same limits stay active nearby. With z the directions that they leave free (at its
friction cone the force of a contact moves along the cone), x(z) the scaled forces, A x = b the balance and y its
multipliers,

    J' (grad f(x) + A' y) = 0,   A x = b,   J = dx/dz,

is a square system whose derivative gives dx/dtheta (implicit function theorem; Fiacco 1976). The curvature of a cone
adds lambda F along its circle, lambda the friction multiplier. The derivative of the cost needs y alone: by the
envelope theorem it is that of the Lagrangian at constant x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pinograsp.checks import brief, instance_of, read_only
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import Tolerance, objective_size_of
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.solution import ConvexSolution
from pinograsp.forces.solve.conic import ConicMethod, exponents_of
from pinograsp.forces.solve.program import program_at
from pinograsp.spatial import Array, skew

_SINGULAR = 1e-10  # relative to the largest singular value
# Where slack (relative to the largest F_n) and multiplier (relative to the objective's gradient) of a limit are both
# below this, it is not certain whether the limit is active.
_DOUBTFUL = 1e-6
# A contact whose F_n is below this share of the largest is at the apex of its cone: rounding hides the direction of its
# tangential force, which the multipliers tell.
_APEX = 1e-6
_EXACT = Tolerance(residual=1e-8, violation=1e-8, gap=1e-7)  # of the interior-point method's answer, and of Newton's
_POLISH = 6  # Newton steps; two or three are enough


class _Limits(NamedTuple):
    """Active limits of a contact.

    Attributes:
        around: whether it is at its friction cone.
        sides: at which end of its intervals each component is: -1, 0 (neither) or 1.
        end: at which end of its range F_n is: -1, 0 (neither) or 1.
        apex: whether its least F_n is next to nothing, and it is there: nothing of its force is free.
    """

    around: bool
    sides: tuple[int, ...]
    end: int
    apex: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Derivatives at an optimum. Contact frames turn by rotation vectors in world axes: a normal n that becomes n + dn
    by n x dn.

    Attributes:
        unique: whether the cost determines the forces, and the active limits are certain. If the forces are not
            determined (energies do not depend on tangential forces), only ``cost_load`` is meaningful: add a small
            weight of ``least_squares`` to the objective for the others. If a limit is about to become active, the
            derivatives have a jump, and ``cost_load`` lies between those on either side: the cost is convex in the
            load, and ``cost_load`` a subgradient.
        forces_load: contact forces by the load (k, 3, 6).
        forces_mu: contact forces by the friction coefficients (k, 3, k) [N]; zeros if mu is 0.
        forces_points: contact forces by the contact points (k, 3, k, 3) [N/m].
        forces_turns: contact forces by rotations of the contact frames (k, 3, k, 3) [N/rad]; forces are given in the
            frames, which turn.
        cost_load: the objective by the load (6,).
        cost_mu: the objective by the friction coefficients (k,); zeros if mu is 0.
        cost_points: the objective by the contact points (k, 3).
        cost_turns: the objective by rotations of the contact frames (k, 3).
        multipliers: of the balance (6,): the cost of one more newton or newton metre of load; zeros for moments in
            force balance.
    """

    unique: bool
    forces_load: Array
    forces_mu: Array
    forces_points: Array
    forces_turns: Array
    cost_load: Array
    cost_mu: Array
    cost_points: Array
    cost_turns: Array
    multipliers: Array

    __repr__ = brief()


def force_sensitivity(solution: ConvexSolution) -> Sensitivity:
    """Compute the derivatives of an answer of :func:`optimize_forces`, at constant moment length.

    Raises:
        InvalidInput: no certified optimum; torque limits, pyramids of more than 4 edges, or the objective ``peak``.
    """
    instance_of("solution", solution, ConvexSolution)
    problem, friction = solution.problem, solution.problem.friction
    if solution.status is not Status.OK or not solution.weights or solution.impact_time is None:
        raise InvalidInput(
            f"sensitivity: expected a certified optimum of optimize_forces, got status '{solution.status}'"
        )
    if problem.torques is not None or solution.weights.get("peak") or not friction.separates:
        raise InvalidInput("sensitivity: expected no torque limits, no 'peak', and a cone, soft fingers or 4 edges")
    k, d, rows, e = problem.k, friction.d, problem.rows, friction.d - 1
    optimum = _Optimum(solution, solution.impact_time)
    A, P, x, y, J, inverse = optimum.A, optimum.P, optimum.x, optimum.y, optimum.J, optimum.inverse
    n, force, unit = J.shape[1], optimum.program.force_scale, optimum.program.objective_scale

    widths = np.ones((k, d))
    widths[:, :-1] = friction.scale(problem.mu)
    arm = np.append(np.ones(3), np.full(3, 1 / problem.moment_length))[:rows]
    columns, diagonal = A.reshape(rows, k, d), np.diag(P).reshape(k, d)
    z = x.reshape(k, d)
    offsets = problem.contacts.points_o - problem.contacts.com_o

    def change(dA: Array, i: int, of_load: Array | None = None, dP: Array | None = None) -> tuple[Array, float]:
        """dx (k d,) [N] and the cost's derivative for changes of contact i's columns by dA (rows, d), of the load [N],
        and of P's diagonal by dP (d,).
        """
        right, own = np.zeros(n + rows), slice(i * d, i * d + d)
        slope = dA.T @ y
        cost = float(slope @ z[i])
        if dP is not None:
            slope = slope + dP * z[i]
            cost += 0.5 * float(dP @ z[i] ** 2)
        right[:n], right[n:] = J[own].T @ slope, dA @ z[i]
        if of_load is not None:
            right[n:] += of_load / force
            cost += float(of_load @ y) / force
        return -force * (J @ (inverse @ right)[:n]), unit * cost

    def in_newtons(dx: Array) -> Array:
        changes: Array = (dx.reshape(k, d) * widths)[:, [0, 1, e]]
        return changes

    none = np.zeros((rows, d))
    by_load, cost_load = np.zeros((k, 3, 6)), np.zeros(6)
    for r in range(rows):
        dx, cost_load[r] = change(none, 0, of_load=np.eye(rows)[r] * arm[r])
        by_load[:, :, r] = in_newtons(dx)
    by_mu, by_points, by_turns = np.zeros((k, 3, k)), np.zeros((k, 3, k, 3)), np.zeros((k, 3, k, 3))
    cost_mu, cost_points, cost_turns = np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3))
    for i in range(k):
        if problem.mu[i] > 0:
            dA, dP = none.copy(), np.zeros(d)
            dA[:, :2], dP[:2] = columns[:, i, :2] / problem.mu[i], 2 * diagonal[i, :2] / problem.mu[i]
            dx, cost_mu[i] = change(dA, i, dP=dP)
            by_mu[:, :, i] = in_newtons(dx)
            by_mu[i, :2, i] += force * z[i, :2] * widths[i, :2] / problem.mu[i]
        for c in range(3):
            turn = skew(np.eye(3)[c])
            dA = none.copy()
            if rows == 6:
                dA[3:] = turn @ columns[:3, i] / problem.moment_length
            dx, cost_points[i, c] = change(dA, i)
            by_points[:, :, i, c] = in_newtons(dx)
            dA = none.copy()
            dA[:3] = turn @ columns[:3, i]
            if rows == 6:
                dA[3:] = skew(offsets[i]) @ dA[:3] / problem.moment_length
                if d == 4:
                    dA[3:, 2] = turn @ columns[3:, i, 2]
            dx, cost_turns[i, c] = change(dA, i)
            by_turns[:, :, i, c] = in_newtons(dx)
    multipliers = np.zeros(6)
    multipliers[:rows] = y * arm * (unit / force)
    return Sensitivity(
        unique=optimum.unique,
        forces_load=read_only(by_load),
        forces_mu=read_only(by_mu),
        forces_points=read_only(by_points),
        forces_turns=read_only(by_turns),
        cost_load=read_only(cost_load),
        cost_mu=read_only(cost_mu),
        cost_points=read_only(cost_points),
        cost_turns=read_only(cost_turns),
        multipliers=read_only(multipliers),
    )


class _Optimum:
    """An optimum with its multipliers and active limits, exact to rounding; dimensionless as its ``program``.

    The recorded forces may be off by the tolerances of a certificate, which is enough to hide an active limit. So an
    interior-point method solves the program again: its forces and multipliers together show the active limits (either
    the slack of a limit or its multiplier goes to zero), and Newton's method then finishes with these limits. What it
    finds counts if it is admissible and its multipliers prove it; else the interior-point method's answer stays, whose
    multipliers are a derivative of the cost in any case.

    Attributes:
        A: balance (rows, k d).
        P: quadratic objective (k d, k d).
        x: scaled forces (k d,).
        y: balance multipliers (rows,).
        J: directions that the active limits leave free (k d, n).
        inverse: inverse of the square system (see the module).
        unique: whether the system is regular and the active limits are certain.
    """

    def __init__(self, solution: ConvexSolution, impact_time: float):
        problem = solution.problem
        self.friction, k, d = problem.friction, problem.k, problem.friction.d
        self.program = program = program_at(problem, matrices_of(problem, solution.weights), impact_time)
        found = ConicMethod(program.matrices, exponents_of(program)).solve(program)
        if found is None or not self._proves(found.x, found.y):
            raise InvalidInput(
                "sensitivity: the multipliers of this optimum could not be computed; the problem is nearly infeasible"
            )
        self.A, self.P = program.A, np.zeros((k * d, k * d)) if program.P is None else program.P
        self.x, self.y = found.x.copy(), found.y
        # Without friction there are no tangential forces.
        self.none = np.append(self.friction.scale(problem.mu), np.ones((k, 1)), axis=1) == 0
        self.x[self.none.ravel()] = 0.0
        self.certain = True
        limits = [self._limits_of(i) for i in range(k)]
        for _ in range(_POLISH):
            self._settle(limits)
            residual = self._linearise(limits)
            if np.abs(residual).max() <= 1e-13:
                break
            step = self.inverse @ residual
            n = self.J.shape[1]
            self.x, self.y = self.x - self.J @ step[:n], self.y - step[n:]
        self._settle(limits)
        exact = bool(np.abs(self._linearise(limits)).max() <= 1e-8) and self._proves(self.x, self.y)
        if not exact:
            self.x, self.y = found.x, found.y
            self._linearise(limits)
        self.certain &= exact and [self._limits_of(i) for i in range(k)] == limits
        self.unique = self.certain and self.regular

    def _proves(self, x: Array, y: Array) -> bool:
        """Whether x is admissible, and y proves it optimal."""
        program, value = self.program, self.program.value(x)
        violation, _, residual = program.violations(x)
        return bool(
            _EXACT.accepts(
                residual_norm=float(np.linalg.norm(residual)),
                load_size=1.0,
                violation=violation,
                force_size=max(1.0, self._largest(x)),
                gap=value - program.lower_bound(x, y, np.zeros(0)),
                objective_size=objective_size_of(value + program.constant, program.constant),
            )
        )

    def _largest(self, x: Array) -> float:
        return float(x[self.friction.d - 1 :: self.friction.d].max())

    def _pull(self) -> tuple[Array, float]:
        """Gradient of the Lagrangian without the limits' part (k d,), and the objective's size in it."""
        heavy = self.program.q + self.P @ self.x
        heavy[self.friction.d - 1 :: self.friction.d] += self.program.slope(self._normal)[0]
        return heavy + self.A.T @ self.y, float(np.abs(heavy).max())

    @property
    def _normal(self) -> Array:
        normal: Array = np.maximum(self.x[self.friction.d - 1 :: self.friction.d], 1e-3 * self.program.lo)
        return normal

    def _limits_of(self, i: int) -> _Limits:
        d, round_ = self.friction.d, self.friction.round_dimensions
        pull, size = self._pull()
        g, x, unit = pull[i * d : (i + 1) * d] / size, self.x[i * d : (i + 1) * d], self._largest(self.x)
        lo, hi, F = self.program.lo[i], self.program.hi[i], x[-1]

        def active(slack: float, multiplier: float) -> bool:
            slack /= unit
            self.certain &= max(slack, multiplier) > _DOUBTFUL
            return multiplier > slack

        if max(F, lo) <= _APEX * unit:
            self.certain &= lo == hi or bool(g[-1] - self.friction.support(-g[:-1]) > _DOUBTFUL)
            return _Limits(False, (0,) * (d - 1 - round_), -1, apex=True)
        ray, length, around = np.append(np.zeros(d - 1), 1.0), float(np.linalg.norm(x[:round_])), False
        if round_ and length > 0 and not self.none[i, 0]:
            out = x[:round_] / length
            around = active(F - length, float(-g[:round_] @ out))
            if around:
                ray[:round_] = out
        sides = []
        for j in range(round_, d - 1):
            side = int(np.sign(x[j])) if not self.none[i, j] else 0
            reach = self.friction.radii[j]
            sides.append(side if side and active(F - abs(x[j]) / reach, -g[j] * side) else 0)
            ray[j] = sides[-1] * reach
        along = float(g @ ray)
        if lo == hi or active(F - lo, along):
            return _Limits(around, tuple(sides), -1)
        return _Limits(around, tuple(sides), 1 if active(hi - F, -along) else 0)

    def _settle(self, limits: Sequence[_Limits]) -> None:
        """Move x onto its active limits."""
        d, round_ = self.friction.d, self.friction.round_dimensions
        pull, _ = self._pull()
        for i, (around, sides, end, apex) in enumerate(limits):
            z = self.x[i * d : (i + 1) * d]
            if apex:
                z[:-1] = self.program.lo[i] * self.friction.support_point(-pull[i * d : (i + 1) * d - 1])
            if end:
                z[-1] = self.program.lo[i] if end < 0 else self.program.hi[i]
            if around:
                z[:round_] *= z[-1] / np.linalg.norm(z[:round_])
            for j, side in enumerate(sides, round_):
                if side:
                    z[j] = side * self.friction.radii[j] * z[-1]

    def _linearise(self, limits: Sequence[_Limits]) -> Array:
        """Set J, the inverse of the system and whether it is regular; return the residual (n + rows,) of the optimality
        conditions.
        """
        d, round_ = self.friction.d, self.friction.round_dimensions
        pull, _ = self._pull()
        columns: list[Array] = []
        bend: list[float] = []
        for i, (around, sides, end, apex) in enumerate(limits):
            if apex:
                continue
            own = slice(i * d, i * d + d)
            z, g, free = self.x[own], pull[own], np.eye(d)
            ray, directions = free[-1].copy(), []
            if around:
                out = z[:round_] / np.linalg.norm(z[:round_])
                ray[:round_] = out
                for tangent in np.linalg.svd(out[None])[2][1:]:
                    # lambda F: the cone is curved.
                    directions.append(
                        (np.append(tangent, np.zeros(d - round_)) * z[-1], float(-g[:round_] @ out * z[-1]))
                    )
            else:
                directions += [(free[j], 0.0) for j in range(round_) if not self.none[i, j]]
            for j, side in enumerate(sides, round_):
                if side:
                    ray[j] = side * self.friction.radii[j]
                elif not self.none[i, j]:
                    directions.append((free[j], 0.0))
            if not end:
                directions.append((ray, 0.0))
            for direction, bending in directions:
                column = np.zeros(len(self.x))
                column[own] = direction
                columns.append(column)
                bend.append(bending)
        self.J, rows = np.array(columns).reshape(-1, len(self.x)).T, len(self.A)
        self.bend, C, n = np.array(bend), self.A @ self.J, len(columns)
        curvature = np.zeros(len(self.x))
        curvature[d - 1 :: d] = self.program.slope(self._normal)[1]
        system = np.zeros((n + rows, n + rows))
        system[:n, :n] = self.J.T @ (self.P + np.diag(curvature)) @ self.J + np.diag(self.bend)
        system[:n, n:], system[n:, :n] = C.T, C
        sizes = np.linalg.svd(system, compute_uv=False)
        self.regular = bool(sizes[-1] > _SINGULAR * sizes[0])
        self.inverse = np.linalg.pinv(system, rcond=_SINGULAR)
        return np.append(self.J.T @ pull, self.A @ self.x - self.program.b)
