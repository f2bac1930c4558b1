"""Many force problems at once, by the dual Newton method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import COUNTED, PIECE, UNLOCKED
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    INFEASIBLE,
    STALLED,
    Balance,
    Bulk,
    BulkModel,
    BulkResults,
    Cones,
    Costs,
)
from pinograsp.forces.kernels.newton import dual_newton, gap_of, newton_scratch
from pinograsp.forces.kernels.powers import powers_of
from pinograsp.forces.kernels.rows import columns, judge
from pinograsp.spatial import Array


class _Room(NamedTuple):
    """Where one problem is solved: balance A (m, d k), b (m,), units of the components, objective and forces (d, k),
    bounds on F_n (k,), scratch of :func:`dual_newton`.
    """

    A: Array
    b: Array
    widths: Array
    P: Array
    q: Array
    x: Array
    lo: Array
    hi: Array
    work: Array


@jit(**PIECE)
def _room_for(m: int, d: int, k: int) -> _Room:
    n = d * k
    room, at = np.empty((m + 4) * n + 2 * k + newton_scratch(d, k)), m * n
    return _Room(
        room[:at].reshape((m, n)),
        np.empty(m),
        room[at : at + n].reshape((d, k)),
        room[at + n : at + 2 * n].reshape((d, k)),
        room[at + 2 * n : at + 3 * n].reshape((d, k)),
        room[at + 3 * n : at + 4 * n].reshape((d, k)),
        room[at + 4 * n : at + 4 * n + k],
        room[at + 4 * n + k : at + 4 * n + 2 * k],
        room[at + 4 * n + 2 * k :],
    )


@jit(**PIECE)
def _scaled_problem(p: int, k: int, bulk: Bulk, model: BulkModel, room: _Room) -> tuple[bool, float, float]:
    """Problem p in ``room``: whether least F_n <= largest, and what forces [N] and the objective are divided by."""
    A, b, widths, P, q, x, lo, hi, _ = room
    m, d, squares, arm, load, terms = model.rows, P.shape[0], model.squares, bulk.arms[p], bulk.loads[p], bulk.terms[p]
    low, high, mu = bulk.low[p], bulk.high[p], bulk.mu[p, :k]
    e, scale = d - 1, 0.0
    for r in range(m):
        b[r] = -load[r] if r < 3 else -load[r] / arm
        scale += b[r] * b[r]
    scale = np.sqrt(scale)
    if scale == 0.0:
        scale = low[0] if low[0] > 0.0 else 1.0
    columns(bulk.points[p, :k], bulk.rotations[p, :k], mu, model.torsion, arm, A, widths)
    heaviest = 0.0
    for i in range(k):
        for j in range(d):
            size = widths[j, i] if j < 2 or j == e else widths[j, i] / arm
            P[j, i], q[j, i] = 2.0 * squares * size * size, 0.0
            heaviest = max(heaviest, P[j, i])
        lo[i], hi[i] = low[i] / scale, high[i] / scale
        if not lo[i] <= hi[i]:
            return False, scale, 1.0
        for j in range(d):
            x[j, i] = 0.0 if j < e else min(max(2.0 / k, lo[i]), hi[i])
    unit = 0.5 * heaviest * scale * scale
    for a in range(terms.shape[0]):
        unit = max(unit, terms[a, 0] * scale ** terms[a, 1])
    for i in range(k):
        for j in range(d):
            P[j, i] *= scale * scale / unit
    for r in range(m):
        b[r] /= scale
    return True, scale, unit


@jit(**COUNTED)
def _solve_part(p: int, bulk: Bulk, model: BulkModel, results: BulkResults) -> int:
    """Problem p; its code."""
    k, d, mu = bulk.counts[p], model.radii.shape[0] + 1, bulk.mu[p]
    e, y = d - 1, np.zeros(model.rows)
    room = _room_for(model.rows, d, k)
    possible, scale, unit = _scaled_problem(p, k, bulk, model, room)
    if not possible:
        return INFEASIBLE
    x, forces, moments = room.x, results.forces[p], results.moments[p]
    balance, cones = Balance(room.A, room.b, 0.0), Cones(room.lo, room.hi, model.radii, model.n_round)
    costs = Costs(room.P, room.q, powers_of(bulk.terms[p], scale, unit))
    code, _steps = dual_newton(balance, costs, cones, x, y, room.work)
    if code == CONVERGED:
        value, bound = gap_of(balance, costs, cones, x, y, room.work)
        off, violation = judge(balance, cones, x)
        # A bound from multipliers that are exact to rounding can exceed the value by rounding.
        results.objective[p], results.lower_bound[p] = value * unit, min(bound, value) * unit
        results.residual[p], results.violation[p] = off * scale, max(violation, 0.0) * scale
        # Negated, so that NaN fails.
        if not (off <= 1e-10 and violation <= 1e-10 and value - bound <= 1e-8 * max(abs(value), 1e-5)):
            code = STALLED
    if code == CONVERGED:
        for i in range(k):
            forces[i, 0], forces[i, 1], forces[i, 2] = x[0, i] * scale * mu[i], x[1, i] * scale * mu[i], x[e, i] * scale
            moments[i] = x[2, i] * scale * model.torsion if d == 4 else 0.0
    return code


@jit(**UNLOCKED)
def solve_many(start: int, stop: int, bulk: Bulk, model: BulkModel, results: BulkResults) -> None:
    """Problems ``start`` to ``stop``, without Python's lock; fills ``results``. The arrays that go in are read-only."""
    # A writable copy, as in single problems: for another kind of array Newton's method would be compiled once more.
    own = BulkModel(model.rows, model.torsion, model.squares, model.radii.copy(), model.n_round)
    for p in range(start, stop):
        results.codes[p] = _solve_part(p, bulk, own, results)
