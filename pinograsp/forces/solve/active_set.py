"""Newton's method over a dense QP solver: sequential quadratic programming for programs of few contacts.

Each step minimises the second-order model of the objective at the last iterate, so the grasp energy, a sum of powers of
F_n, is minimised exactly and not once linearised. Balance, limits and polyhedral friction are exact in every step; a
second-order cone |u| <= F is replaced by the half-space v . u <= F through the last direction v = u / |u| within a
square around it, and its curvature, lambda (I - v v') / |u|, joins the Hessian: the steps converge quadratically. A
small proximal weight makes every Hessian positive definite (tangential forces cost nothing); it pulls towards the last
iterate, so it leaves no bias in the limit.
"""

from __future__ import annotations

import numpy as np

from pinograsp.contacts import Friction
from pinograsp.contacts.compliance import MEASURES
from pinograsp.errors import InvalidInput
from pinograsp.forces.matrices import Matrices
from pinograsp.forces.solve.answers import ProgramAnswer
from pinograsp.forces.solve.program import Program
from pinograsp.forces.solve.solvers import quadratic, solve_rows
from pinograsp.forces.solve.standard_form import QuadraticProgram
from pinograsp.spatial import Array, IntArray

_PROXIMAL = 1e-5  # against an objective of order one; below 1e-9 dense active-set solvers lose the Hessian
_DEFINITE = 1e-6  # least eigenvalue of a Hessian that needs no proximal weight
_STEPS = 60
_CONE_STEPS = 25  # where these are not enough, the interior-point method is the better choice
_WITHIN = 0.8  # the square is wider than the disc by 1 / 0.8: it never coincides with a half-space that is active
_PATIENCE = 5  # steps before the first look at the gap
_SETTLED = 1e-6  # step in x, relative: the next error is about its square


class DenseMethod:
    """Newton's method over a dense QP solver, for the programs that share these matrices.

    Attributes:
        solver: name of the QP solver, see :func:`~pinograsp.forces.solve.solvers.qp_solvers`.
    """

    def __init__(self, matrices: Matrices, solver: str):
        """Stack the constraint rows, and those bounds that do not depend on the load: zeros and infinities."""
        self.solver = solver
        k, d, n, peak = matrices.k, matrices.d, matrices.k * matrices.d, matrices.peak > 0
        self._size, self._inside = n + peak, matrices.friction.round_dimensions
        facets = _facets(matrices.friction, k)
        top = np.zeros((k if peak else 0, self._size))
        if peak:
            top[np.arange(k), np.arange(d - 1, n, d)] = 1.0
            top[:, n] = -1.0
        linear = np.vstack([facets, matrices.R, matrices.A])
        self._C = np.zeros((len(linear) + len(top), self._size))
        self._C[: len(facets), :n] = facets
        self._C[len(facets) : len(facets) + len(top)] = top
        self._C[len(facets) + len(top) :, :n] = linear[len(facets) :]
        self._lower = np.full(self._size + len(self._C), -np.inf)
        self._upper = np.full(self._size + len(self._C), np.inf)
        self._upper[self._size : self._size + len(facets) + len(top)] = 0.0
        self._least_curvature = 0.0  # of P in newtons
        if matrices.P is not None and not peak:
            self._least_curvature = float(np.linalg.eigvalsh(matrices.P)[0])

    def solve(self, program: Program) -> ProgramAnswer | None:
        """The solver's answer; None where it finds no solution.

        On cones the answer need not have converged: like every answer it is certified by the caller.
        """
        k, d, n = program.k, program.d, program.k * program.d
        size, C, equalities = self._size, self._C, len(program.b)
        lower, upper, rows = self._limits(program)
        normal = slice(d - 1, n, d)
        definite = self._least_curvature * program.force_scale**2 / program.objective_scale > _DEFINITE
        proximal = 0.0 if definite else _PROXIMAL
        curved = any(exponent != 1 for _, exponent in program.powers)
        H = np.zeros((size, size))
        linear = self._linear(program)
        x = np.zeros(size)
        F = np.clip(np.full(k, min(1.0, 2.0 / k)), program.lo, program.hi)
        x[normal] = F
        x[n:] = F.max()
        cones = _Cones(program, C, self._inside) if self._inside else None
        best, value = None, float("inf")
        for count in range(_STEPS if cones is None else _CONE_STEPS):
            f = linear - proximal * x
            H[:] = 0.0
            if program.P is not None:
                H[:n, :n] = program.P
            H.flat[:: size + 1] += proximal
            if program.powers:
                first, second = program.slope(F)
                f[normal] += first - second * F
                H.flat[(size + 1) * (d - 1) : (size + 1) * n : (size + 1) * d] += second
            if cones is not None:
                C = cones.bend(H, x)
            found = solve_rows(self.solver, H, f, C, lower, upper, equalities)
            if found is None:
                return best
            new, lam = found
            step = float(np.abs(new - x).max())
            best = ProgramAnswer.alone(new[:n]) if lam is None else ProgramAnswer(new[:n], lam[-equalities:], lam[rows])
            done = step <= _SETTLED * max(1.0, float(np.abs(new).max()))
            if done or (cones is None and not curved and not proximal):
                break
            if count >= _PATIENCE and _close(program, best):
                break
            if cones is not None:
                if lam is None:
                    raise InvalidInput(
                        f"solver '{self.solver}': friction cones take several QPs, each made with the last one's "
                        "multipliers: expected y and z (see SolverAnswer), got x alone; return them, register the "
                        "solver with takes='socp', or use pyramids"
                    )
                cones.learn(lam[size:])
            elif curved:
                new, value = _descend(program, x, new, value)
            x = new
            F = np.minimum(np.maximum(x[normal], program.lo), program.hi)
        return best

    def quadratic(self, program: Program) -> tuple[QuadraticProgram, IntArray]:
        """The program itself as one QP, and the rows of its G that are each torque's upper and lower limit (t, 2), -1
        where there is none.

        Raises:
            InvalidInput: friction or an objective that is not quadratic.
        """
        if not program.friction.polyhedral:
            raise InvalidInput(
                f"friction model '{program.friction.model}': a quadratic program has linear limits alone: take "
                "to_socp(...), or Friction(model='pyramid', edges=...)"
            )
        d, n = program.d, program.k * program.d
        H, f = np.zeros((self._size, self._size)), self._linear(program)
        if program.P is not None:
            H[:n, :n] = program.P
        normal = np.arange(d - 1, n, d)
        for coefficient, exponent in program.powers:
            if exponent == 1:
                f[normal] += coefficient
            elif exponent == 2:
                H[normal, normal] += 2 * coefficient
            else:
                names = ", ".join(f"'{name}'" for name in MEASURES if program.matrices.weights.get(name))
                raise InvalidInput(
                    f"objective {names}: its power F_n^{exponent:.4g} is not quadratic: take to_socp(...), an "
                    "objective without a grasp energy ('least_squares', 'peak', 'motor_heat'), or a contact law of "
                    "exponent 1"
                )
        lower, upper, rows = self._limits(program)
        qp, high, low = quadratic(H, f, self._C, lower, upper, len(program.b))
        at, torques = rows.start - self._size, len(program.R)
        places = np.full((len(high), 2), -1)
        places[high, 0] = np.arange(high.sum())
        places[low, 1] = high.sum() + np.arange(low.sum())
        return qp, places[at : at + torques]

    def _limits(self, program: Program) -> tuple[Array, Array, slice]:
        """Lower and upper bounds of (x, C x), and where the torque rows are among them."""
        size, C, equalities = self._size, self._C, len(program.b)
        lower, upper = self._lower.copy(), self._upper.copy()
        normal = slice(program.d - 1, program.k * program.d, program.d)
        lower[normal], upper[normal] = program.lo, program.hi
        lower[-equalities:] = upper[-equalities:] = program.b
        rows = slice(size + len(C) - equalities - len(program.R), size + len(C) - equalities)
        lower[rows], upper[rows] = program.R_lo, program.R_hi
        return lower, upper, rows

    def _linear(self, program: Program) -> Array:
        linear = np.full(self._size, program.peak)
        linear[: program.k * program.d] = program.q
        return linear


class _Cones:
    """The half-spaces and curvatures that replace the second-order cones in the next step."""

    def __init__(self, program: Program, C: Array, inside: int):
        self.k, self.d, self.inside = program.k, program.d, inside
        self.C: Array = C.copy()
        self.facets = 2 * inside + 1  # rows of a contact: the square (cube), then the half-space
        self.weight = np.zeros(self.k)
        contacts = np.arange(self.k)
        self.cuts = contacts * self.facets + 2 * inside
        self.columns = contacts[:, None] * self.d + np.arange(inside)
        self.direction = np.zeros((self.k, inside))

    def bend(self, H: Array, x: Array) -> Array:
        """The rows C for the step from ``x``; adds the curvature to H."""
        u = x[self.columns]
        length = np.sqrt(np.einsum("ij,ij->i", u, u))
        known = length > 1e-12
        self.direction[known] = u[known] / length[known, None]
        self.C[self.cuts[:, None], self.columns] = self.direction
        # At the last iterate u lies along v, where the curvature's gradient (I - v v') u vanishes: the linear term
        # needs no change.
        bend = np.where(known, self.weight / np.where(known, length, 1.0), 0.0)
        block = bend[:, None, None] * (np.eye(self.inside) - np.einsum("ki,kj->kij", self.direction, self.direction))
        H[self.columns[:, :, None], self.columns[:, None, :]] += block
        return self.C

    def learn(self, lam: Array) -> None:
        """Weight the curvature by the multipliers of the half-spaces."""
        self.weight = np.maximum(lam[: self.k * self.facets].reshape(self.k, -1).sum(axis=1), 0.0)


def _close(program: Program, answer: ProgramAnswer) -> bool:
    """Whether x is as good as a certificate asks: with nearly linear objectives x drifts between equal optima."""
    if not len(answer.y):
        return False
    value = program.value(answer.x)
    gap = value - program.lower_bound(answer.x, answer.y, answer.w, refine=False)
    return gap <= 1e-7 * abs(value) and program.violations(answer.x)[0] <= 1e-9


def _descend(program: Program, x: Array, new: Array, value: float) -> tuple[Array, float]:
    """The step, halved until the objective does not grow; halved steps stay feasible, as the constraints are convex."""
    n = program.k * program.d
    reached = program.value(new[:n])
    for _ in range(30):
        if reached <= value + 1e-12 * abs(value):
            break
        new = (x + new) / 2
        reached = program.value(new[:n])
    return new, reached


def _facets(friction: Friction, k: int) -> Array:
    """Friction as rows, row . x <= 0: by contact each cone's square and half-space come first, then the facets."""
    inside = friction.round_dimensions
    # Rows |u_j| <= F of the square (cube) around a disc (ball), and one of zeros for the half-space.
    square = np.zeros((2 * inside + 1 if inside else 0, friction.d - 1))
    for j in range(inside):
        square[2 * j, j], square[2 * j + 1, j] = _WITHIN, -_WITHIN
    D = np.vstack([square, friction.facets])
    rows = np.kron(np.eye(k), np.hstack([D, -np.ones((len(D), 1))]))
    first = np.arange(len(rows)) % len(D) < len(square)
    return np.vstack([rows[first], rows[~first]], dtype=float)
