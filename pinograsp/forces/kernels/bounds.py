"""Lower bounds of the objective, and proofs that a load cannot be held, from multipliers of the rows."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import COUNTED, FLAGS
from pinograsp.forces.kernels.layouts import Friction, Objective, Powers, Problem
from pinograsp.forces.kernels.powers import phi
from pinograsp.spatial import Array


@jit(**FLAGS)
def support(g: Array, friction: Friction) -> float:
    """max of g . u over U (:class:`~pinograsp.contacts.Friction`)."""
    vertices, n_round = friction.vertices, friction.n_round
    total = 0.0 if n_round > 0 else -np.inf
    for j in range(n_round):
        total += g[j] * g[j]
    total = np.sqrt(total) if n_round > 0 else total
    for v in range(vertices.shape[0] if n_round == 0 else 0):
        total = max(total, vertices[v, 0] * g[0] + vertices[v, 1] * g[1])
    for j in range(max(n_round, 2), g.shape[0] - 1):
        total += abs(g[j])
    return total


@jit(**FLAGS)
def bound_of(problem: Problem, x: Array, y: Array, g: Array) -> tuple[float, float]:
    """Lower bound of the objective from y and tangents near x (``Program.lower_bound``, compiled), and the objective at
    x.

    g (d,) is scratch.
    """
    B, touched, counts = problem.rows.B, problem.rows.touched, problem.rows.counts
    P, q, (coefs, exps) = problem.objective
    lo, hi, R_lo, R_hi = problem.ranges
    friction, b = problem.friction, problem.b
    k, d, _n = B.shape
    m, e, total, value = b.shape[0], d - 1, 0.0, 0.0
    for r in range(m):
        total -= y[r] * b[r]
    for r in range(R_lo.shape[0]):
        total -= max(y[m + r] * R_hi[r], y[m + r] * R_lo[r])
    for i in range(k):
        for j in range(d):
            t = 0.0
            for c in range(d):
                t += P[i, j, c] * x[i, c]
            total -= 0.5 * t * x[i, j]
            value += (q[i, j] + 0.5 * t) * x[i, j]
            t += q[i, j]
            for h in range(counts[i, 1]):
                t += B[i, j, touched[i, h]] * y[touched[i, h]]
            g[j] = t
        s = g[e] - support(g, friction)
        if coefs.shape[0] > 0:
            F = max(x[i, e], 1e-300)
            t, first, second = phi(F, coefs, exps)
            value += t
            if second > 0.0:
                # A tangent of phi nearer to its minimiser proves more where F lies between its bounds.
                F = min(max(F - (s + first) / second, max(lo[i], 0.5 * F)), hi[i])
                t, first, second = phi(F, coefs, exps)
            s += first
            total += t - first * F
        total += min(lo[i] * s, hi[i] * s)
    return total, value


@jit(**COUNTED)
def excluded(problem: Problem, y: Array, g: Array) -> float:
    """Farkas bound of multipliers y = [balance; torque rows] (``Program.excluded``, compiled). g (d,) is scratch."""
    k, d, _n = problem.rows.B.shape
    x, none = np.zeros((k, d)), np.zeros(0)
    nothing = Objective(np.zeros((k, d, d)), x, Powers(none, none))
    free = Problem(problem.rows, problem.limits, problem.friction, problem.ranges, nothing, problem.b)
    return bound_of(free, x, y, g)[0]
