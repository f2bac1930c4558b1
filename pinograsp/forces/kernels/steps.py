"""One step of the interior-point method (:mod:`pinograsp.forces.kernels.interior`).

Vectors over all contacts are stored by component, v[0, j k + i] for component j of contact i, matrices in the same
order, so that the innermost loops run over contacts next to each other in memory.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import (
    add_combination,
    add_products,
    back_solve,
    factor,
    factor_contacts,
    gram,
    half_solve,
    solve,
)
from pinograsp.forces.kernels.cones import ConeState, centre_cones, scale_cones, step_cones
from pinograsp.forces.kernels.flags import FLAGS, PIECE
from pinograsp.forces.kernels.layouts import Limits, Problem
from pinograsp.forces.kernels.limits import add_limits, add_weighted_limits, both_sides, limits_along, to_boundary
from pinograsp.forces.kernels.powers import phi
from pinograsp.spatial import Array

_START = 0.6  # first F_n, relative to the load over the root of the number of contacts
_CENTRE = 0.3  # first product of slack and multiplier, relative to the objective per contact
_LEAST_CENTRE = 1e-3  # least centring, relative to the mean product: products far apart would cost the last digits


class Sizes(NamedTuple):
    """Where in a list of all limits those on F_n begin (after the facets), the torque rows of one contact, those of
    several; how many there are, and how far it is from a limit's lower to its upper side.
    """

    facets: int
    torques: int
    several: int
    limits: int
    up: int


class Slacks(NamedTuple):
    """Of all limits, lower sides first: slacks s, multipliers z, their steps, weights w = z / s, ``inverse`` 1 / s,
    ``off`` s less the true slack, products of the predictor's steps, ``target`` of a step. Per limit, both sides
    together: values ``along`` a vector, and weights.
    """

    s: Array
    z: Array
    ds: Array
    dz: Array
    w: Array
    inverse: Array
    off: Array
    product: Array
    target: Array
    along: Array
    weights: Array


class Point(NamedTuple):
    """x by component, v (1, d k), its step, the gradient; the residual of the balance (m,); the multipliers of balance
    and torque rows of several contacts, and their step.
    """

    v: Array
    dx: Array
    grad: Array
    row: Array
    multipliers: Array
    dy: Array


class System(NamedTuple):
    """Hessians H (d, d, k) of the contacts, their factors; T = H^-1/2 A', Schur complement S, its factor."""

    H: Array
    T: Array
    S: Array


class Spare(NamedTuple):
    """The last x (1, d k) and multipliers y of all rows whose gap was measured; d numbers; zeros, as many as
    ``multipliers``.
    """

    x: Array
    y: Array
    scratch: Array
    zeros: Array


class Work(NamedTuple):
    """All that a solve works in, and whether its objective has quadratic terms."""

    quadratic: bool
    sizes: Sizes
    slacks: Slacks
    point: Point
    system: System
    cones: ConeState
    spare: Spare


@jit(**PIECE)
def work_for(problem: Problem) -> Work:
    """Room for a solve: multipliers, ``off`` and x are zero."""
    A, G, m, n_round = problem.rows.A, problem.limits.G, problem.b.shape[0], problem.friction.n_round
    rows, n = A.shape
    groups, d, k = G.shape
    facets = (groups - problem.limits.own.shape[0] - 1) * k
    limits = groups * k + rows - m
    size, cones = 2 * limits - facets, k if n_round > 0 else 0
    sizes = Sizes(facets, facets + k, groups * k, limits, limits - facets)
    slacks = Slacks(
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.zeros(size),
        np.empty(size),
        np.empty(size),
        np.empty(limits),
        np.empty(limits),
    )
    point = Point(np.zeros((1, n)), np.empty((1, n)), np.empty((1, n)), np.empty(m), np.zeros(rows), np.empty(rows))
    system = System(np.empty((d, d, k)), np.empty((rows, n)), np.empty((rows, rows)))
    state = ConeState(
        np.zeros((cones, 4)), np.zeros((cones, 4)), np.zeros((cones, 4)), np.empty((cones, 4)), np.empty(cones)
    )
    spare = Spare(np.empty((1, n)), np.empty(problem.rows.B.shape[2]), np.empty(d), np.zeros(rows))
    return Work(bool(np.any(problem.objective.P != 0.0)), sizes, slacks, point, system, state, spare)


@jit(**PIECE)
def first_point(problem: Problem, work: Work) -> None:
    """Forces along the normals, within their bounds, with slacks and multipliers of a given product."""
    lo, hi, R_lo, R_hi = problem.ranges
    own, (facets, torques, several, limits, up) = problem.limits.own, work.sizes
    s, z, off, along, v, zc = (
        work.slacks.s,
        work.slacks.z,
        work.slacks.off,
        work.slacks.along,
        work.point.v,
        work.cones.z,
    )
    m, k, shared = problem.b.shape[0], lo.shape[0], problem.rows.shared
    e, mu = v.shape[1] - k, _CENTRE / k
    for i in range(k):
        wide = hi[i] - lo[i]
        v[0, e + i] = min(max(_START / np.sqrt(k), lo[i] + 0.1 * min(wide, 1.0 / k)), hi[i] - 0.1 * wide)
        if zc.shape[0] > 0:
            zc[i, 3] = mu / v[0, e + i]
    limits_along(problem.limits.G, problem.limits.used, problem.rows.A[m:], v, along)
    for l in range(limits):
        least, most = -1.0, 1.0  # of rows of zeros
        if l < facets:
            least = 0.0
        elif l < torques:
            least, most = lo[l - facets], hi[l - facets]
        else:
            at = (own[(l - torques) // k, (l - torques) % k] if l < several else m + l - several) - m
            if at >= 0 and (l < several or at < shared - m):
                least, most = R_lo[at], R_hi[at]
        s[l] = along[l] - least
        if l >= facets:
            s[l + up] = most - along[l]
        if l >= torques:
            for side in (l, l + up):
                off[side] = max(0.1 * min(most - least, 1.0) - s[side], 0.0)
                s[side] += off[side]
    for l in range(s.shape[0]):
        z[l] = mu / s[l]


@jit(**PIECE)
def missed(problem: Problem, give: float, work: Work) -> float:
    """The residual of the balance, in ``row``; returns the largest residual of balance and torque rows."""
    b, row, multipliers, off = problem.b, work.point.row, work.point.multipliers, work.slacks.off
    m, far = b.shape[0], 0.0
    for r in range(m):
        row[r] = -b[r] - give * multipliers[r]
    add_products(problem.rows.A[:m], work.point.v, row)
    for r in range(m):
        far = max(far, abs(row[r]))
    for l in range(work.sizes.torques, off.shape[0]):
        far = max(far, abs(off[l]))
    return far


@jit(**PIECE)
def objective_at(problem: Problem, work: Work) -> float:
    """The objective at x; its gradient and Hessian."""
    P, q, (coefs, exps) = problem.objective
    v, grad, H = work.point.v, work.point.grad, work.system.H
    d, _, k = H.shape
    e, value, quadratic = (d - 1) * k, 0.0, work.quadratic
    for i in range(k):
        t, first, second = phi(v[0, e + i], coefs, exps)
        value += t
        for j in range(d):
            t = 0.0
            for c in range(d if quadratic else 0):
                t += P[i, j, c] * v[0, c * k + i]
            grad[0, j * k + i] = q[i, j] + t
            value += (q[i, j] + 0.5 * t) * v[0, j * k + i]
            for c in range(j, d):
                H[j, c, i] = P[i, j, c]
        grad[0, e + i] += first
        H[d - 1, d - 1, i] += second
    return value


@jit(**PIECE)
def factorise(problem: Problem, give: float, work: Work) -> float:
    """Add the barriers to the Hessian, factor it and the Schur complement; returns the sum of the complementarity."""
    s, z, w, inverse, weights = work.slacks.s, work.slacks.z, work.slacks.w, work.slacks.inverse, work.slacks.weights
    H, T, S = work.system
    m, several, comp = problem.b.shape[0], work.sizes.several, 0.0
    for l in range(s.shape[0]):
        inverse[l] = 1.0 / s[l]
        w[l] = z[l] * inverse[l]
        comp += s[l] * z[l]
    both_sides(w, 1.0, work.sizes.facets, weights)
    add_weighted_limits(problem.limits.G, problem.limits.used, weights, H)
    if problem.friction.n_round > 0:
        comp += scale_cones(work.point.v, problem.friction.n_round, work.cones, H)
    factor_contacts(H)
    half_solve(H, problem.rows.A, T)
    gram(T, S)
    for r in range(S.shape[0]):
        S[r, r] += give if r < m else 1.0 / weights[several + r - m]
    factor(S)
    return comp


@jit(**FLAGS)
def newton_step(limits: Limits, work: Work, multipliers: Array) -> None:
    """Newton steps of x and of the rows' multipliers. dx: on entry the right-hand side without the limits' part, then
    the step of x; dy: the step of the multipliers. ``along``: the limits' part, lower minus upper side.
    """
    H, T, S = work.system
    row, dx, dy = work.point.row, work.point.dx, work.point.dy
    sides, weights, m = work.slacks.along, work.slacks.weights, row.shape[0]
    at = work.sizes.several - m
    add_limits(limits.G, limits.used, sides, dx)
    half_solve(H, dx, dx)
    for r in range(dy.shape[0]):
        dy[r] = row[r] if r < m else (-sides[at + r] - multipliers[r]) / weights[at + r]
    add_products(T, dx, dy)
    solve(S, dy)
    add_combination(T, dy, -1.0, dx)
    back_solve(H, dx)


@jit(**PIECE)
def _steps_of_slacks(sizes: Sizes, slacks: Slacks) -> None:
    """ds and dz for the values ``along`` a step of x."""
    z, ds, dz, w, off, target, along = (
        slacks.z,
        slacks.ds,
        slacks.dz,
        slacks.w,
        slacks.off,
        slacks.target,
        slacks.along,
    )
    limits, up = sizes.limits, sizes.up
    for l in range(limits):
        dz[l] = target[l] - z[l] - w[l] * along[l]
        ds[l] = along[l] - off[l]
    for l in range(limits, z.shape[0]):
        dz[l] = target[l] - z[l] + w[l] * along[l - up]
        ds[l] = -along[l - up] - off[l]


@jit(**PIECE)
def predict_and_correct(problem: Problem, work: Work, comp: float, count: int, share: float) -> float:
    """Mehrotra's step, of x, slacks and multipliers; returns how far one may go, up to 1 / share. ``comp``: the sum of
    the ``count`` products of slacks and multipliers.
    """
    rows, limits, n_round, m = problem.rows, problem.limits, problem.friction.n_round, problem.b.shape[0]
    sizes, slacks, point, cones = work.sizes, work.slacks, work.point, work.cones
    w, inverse, off, product, target = slacks.w, slacks.inverse, slacks.off, slacks.product, slacks.target
    dx, grad, centring, ds, dz = point.dx, point.grad, cones.centring, slacks.ds, slacks.dz
    size, n, k = target.shape[0], dx.shape[1], work.system.H.shape[2]
    add_combination(rows.A, point.multipliers, 1.0, grad)
    centre, alpha, centring[:] = 0.0, 1.0, 0.0
    for corrector in range(2):
        for l in range(size):
            target[l] = w[l] * off[l]
        for l in range(n):
            dx[0, l] = -grad[0, l]
        if corrector:
            for l in range(size):
                target[l] += (centre - product[l]) * inverse[l]
        for i in range(centring.shape[0]):
            for j in range(n_round):
                dx[0, j * k + i] += centring[i, j]
            dx[0, n - k + i] += centring[i, 3]
        both_sides(target, -1.0, sizes.facets, slacks.along)
        newton_step(limits, work, point.multipliers)
        limits_along(limits.G, limits.used, rows.A[m:], dx, slacks.along)
        _steps_of_slacks(sizes, slacks)
        alpha = 1.0 / share if corrector else 1.0
        alpha = to_boundary(slacks.z, dz, to_boundary(slacks.s, ds, alpha))
        if n_round > 0:
            alpha = step_cones(point.v, dx, n_round, cones, corrector > 0, alpha)
        if not corrector:
            for l in range(size):
                product[l] = ds[l] * dz[l]
            centre = max((1.0 - alpha) ** 3, _LEAST_CENTRE) * comp / count
            if n_round > 0:
                centre_cones(cones, centre)
    return alpha


@jit(**PIECE)
def advance(alpha: float, work: Work) -> None:
    """Take the step. Slacks are carried along: computed from x they would lose their digits, and could vanish."""
    s, z, ds, dz, off = work.slacks.s, work.slacks.z, work.slacks.ds, work.slacks.dz, work.slacks.off
    v, dx, multipliers, dy, row = work.point.v, work.point.dx, work.point.multipliers, work.point.dy, work.point.row
    zc, dzc, m, at, up = work.cones.z, work.cones.dz, row.shape[0], work.sizes.several - row.shape[0], work.sizes.up
    for l in range(s.shape[0]):
        s[l] += alpha * ds[l]
        z[l] += alpha * dz[l]
        off[l] *= 1.0 - alpha
    for l in range(v.shape[1]):
        v[0, l] += alpha * dx[0, l]
    for i in range(zc.shape[0]):
        for j in range(4):
            zc[i, j] += alpha * dzc[i, j]
    for r in range(multipliers.shape[0]):
        multipliers[r] = multipliers[r] + alpha * dy[r] if r < m else z[at + r + up] - z[at + r]
