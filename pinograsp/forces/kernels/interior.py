"""The interior-point method for every :class:`~pinograsp.forces.program.Program` whose objective couples no two
contacts: polyhedral and second-order friction cones, bounds on F_n, powers of F_n (Eqs. 9 and 11), quadratic terms and
torque rows.

The iterates stay inside the cones and bounds; balance and torque rows hold in the limit. With B = [A; R], multipliers
l = [y; w] and per contact the Hessian H_i of the objective and of the barriers, a Newton step solves

    [ H  B' ] [dx]   [ -stationarity + centring ]
    [ B  -E ] [dl] = [ -rows                    ],     H block diagonal with blocks (d, d), E = diag(0, s/w),

by the Schur complement B H^-1 B' + E: six unknowns and one for each torque row, whatever the number of contacts, so the
cost of a step grows linearly with it. A torque row that only one contact enters joins that contact's block H_i. Steps
(:mod:`~pinograsp.forces.kernels.steps`) are Mehrotra's predictor and corrector (1992). In infeasible programs the
multipliers grow along a Farkas certificate, and are tested as one while they grow.
"""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import add_products
from pinograsp.forces.kernels.bounds import bound_of, excluded
from pinograsp.forces.kernels.flags import COUNTED, FLAGS, PIECE
from pinograsp.forces.kernels.layouts import CONVERGED, INFEASIBLE, PROVEN, STALLED, Limits, Problem
from pinograsp.forces.kernels.limits import both_sides
from pinograsp.forces.kernels.steps import (
    Work,
    advance,
    factorise,
    first_point,
    missed,
    newton_step,
    objective_at,
    predict_and_correct,
    work_for,
)
from pinograsp.spatial import Array

_STEPS = 60
_INTERIOR_GAP = 1e-8  # relative gap at which the search ends
_CLOSED = 1e-7  # relative gap at which it may end once rounding stops its progress
_ROWS = 1e-9  # residual of balance and torque rows, relative to the load
_TO_BOUNDARY, _TO_CONE = 0.999, 0.98  # share of the way to the boundary of polyhedral and of second-order cones
_GROWN = 30.0  # multipliers larger than this, relative to the objective, are tested as a certificate


@jit(**FLAGS)
def _to_contacts(limits: Limits, shared: int, work: Work, x: Array, y: Array) -> None:
    """x (k, d) from its components, and the multipliers of all rows in their order."""
    own, torques, up = limits.own, work.sizes.torques, work.sizes.up
    v, multipliers, z = work.point.v, work.point.multipliers, work.slacks.z
    k, d = x.shape
    for i in range(k):
        for j in range(d):
            x[i, j] = v[0, j * k + i]
        for a in range(own.shape[0]):
            if own[a, i] >= 0:
                at = torques + a * k + i
                y[own[a, i]] = z[at + up] - z[at]
    for r in range(shared):
        y[r] = multipliers[r]


@jit(**PIECE)
def _gap(problem: Problem, give: float, value: float, row: Array, x: Array, y: Array, scratch: Array) -> float:
    """The duality gap at x, whose balance misses ``row``."""
    bound, _ = bound_of(problem, x, y, scratch)
    gap = value - bound
    for r in range(row.shape[0]):
        gap += y[r] * (row[r] + give * y[r])  # the cost of restoring the balance, or of missing it
    return gap


@jit(**PIECE)
def _balance_again(problem: Problem, work: Work) -> None:
    """Remove the residual that rounding leaves in the rows, in the barriers' metric: in it forces at their limits
    hardly move.
    """
    b, v, dx, row, slacks = problem.b, work.point.v, work.point.dx, work.point.row, work.slacks
    target, w, off, along = slacks.target, slacks.w, slacks.off, slacks.along
    for again in range(2):
        for l in range(target.shape[0]):
            target[l] = 0.0 if again else w[l] * off[l]
        both_sides(target, -1.0, work.sizes.facets, along)
        dx[:] = 0.0
        newton_step(problem.limits, work, work.spare.zeros)
        for l in range(v.shape[1]):
            v[0, l] += dx[0, l]
        for r in range(b.shape[0]):
            row[r] = -b[r]
        add_products(problem.rows.A[: b.shape[0]], v, row)


@jit(**PIECE)
def _remember(work: Work, y: Array) -> None:
    """Keep x and y (m + r,)."""
    (x, best, _, _), v = work.spare, work.point.v
    for l in range(v.shape[1]):
        x[0, l] = v[0, l]
    for r in range(y.shape[0]):
        best[r] = y[r]


@jit(**PIECE)
def _recall(work: Work, y: Array) -> None:
    """The x and y that :func:`_remember` kept."""
    (x, best, _, _), v = work.spare, work.point.v
    for l in range(v.shape[1]):
        v[0, l] = x[0, l]
    for r in range(y.shape[0]):
        y[r] = best[r]


@jit(**FLAGS)
def _iterate(problem: Problem, give: float, work: Work, x: Array, y: Array) -> tuple[int, int]:
    """:func:`interior_point` in arrays that are there already."""
    limits, shared, n_round = problem.limits, problem.rows.shared, problem.friction.n_round
    m, k = problem.b.shape[0], x.shape[0]
    row, multipliers, scratch = work.point.row, work.point.multipliers, work.spare.scratch
    count = work.slacks.s.shape[0] + (k if n_round > 0 else 0)
    share = _TO_CONE if n_round > 0 else _TO_BOUNDARY
    tested, short, previous = _GROWN, 0, np.inf
    first_point(problem, work)
    for step in range(_STEPS):
        far = missed(problem, give, work)
        value = objective_at(problem, work)
        scale = max(abs(value), 1e-6)
        for r in range(m):
            scale += give * multipliers[r] * multipliers[r]
        comp = factorise(problem, give, work)
        _to_contacts(limits, shared, work, x, y)
        done = False
        if far <= (1e-7 if give == 0.0 else 1e-9) and comp <= 1e-6 * scale:
            gap = _gap(problem, give, value, row, x, y, scratch)
            done = gap <= scale * _INTERIOR_GAP
            if not done and gap >= 0.3 * previous and min(gap, previous) <= scale * _CLOSED:
                done = True  # rounding stops its progress
                if previous < gap:
                    _recall(work, y)
            _remember(work, y)
            previous = gap
        if done:
            if give == 0.0:
                _balance_again(problem, work)
            _to_contacts(limits, shared, work, x, y)
            for r in range(y.shape[0]):
                y[r] = work.spare.y[r]
            return CONVERGED, step
        grown = 0.0
        for r in range(y.shape[0]):
            grown = max(grown, abs(y[r]))
        if not (grown < 1e15 and comp < 1e15):
            return STALLED, step
        if give == 0.0 and far > _ROWS and (grown > tested * max(scale, 1.0) or (short > 1 and grown > 0.0)):
            tested = max(tested, 4.0 * grown / max(scale, 1.0))
            for r in range(y.shape[0]):
                y[r] /= grown
            if excluded(problem, y, scratch) > PROVEN:
                return INFEASIBLE, step
        alpha = min(1.0, share * predict_and_correct(problem, work, comp, count, share))
        short = short + 1 if alpha < 1e-3 else 0
        if short > 5:
            return STALLED, step
        advance(alpha, work)
    return STALLED, _STEPS


@jit(**COUNTED)
def interior_point(problem: Problem, give: float, x: Array, y: Array) -> tuple[int, int]:
    """Minimise over the cones; x (k, d) and y (m + r,) are the results. (CONVERGED, STALLED or INFEASIBLE, steps).

    With ``give`` > 0 the balance may be missed at a cost of |A x - b|^2 / (2 give). INFEASIBLE: y is a Farkas
    certificate.
    """
    return _iterate(problem, give, work_for(problem), x, y)
