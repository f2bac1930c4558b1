"""The forces of one tick where joints have limits: the interior-point method with rows for the joints."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import not_finite
from pinograsp.forces.kernels.bounds import excluded
from pinograsp.forces.kernels.flags import COUNTED, PIECE
from pinograsp.forces.kernels.interior import interior_point
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    INFEASIBLE,
    STALLED,
    Cones,
    Friction,
    Hand,
    Limits,
    Objective,
    Powers,
    Problem,
    Ranges,
    Rows,
    Tick,
    TickInputs,
    TorqueRows,
)
from pinograsp.forces.kernels.memory import torque_rows_in
from pinograsp.forces.kernels.newton import GIVE, GIVES, LEAST_GIVE, STIFFEN
from pinograsp.forces.kernels.rows import judge
from pinograsp.spatial import Array, IntArray

# Forces are the closest where what they leave of the balance is this near to its proven least value, relative to the
# load.
_CLOSEST_WITHIN = 1e-6
TRACE = 1e-6  # of the load, by which a coupling may be missed: programs without any room are hard to solve


@jit(**PIECE)
def _torques_by_force(inputs: TickInputs, widths: Array, row_of: IntArray, rows: int, hand: Hand) -> Array:
    """Torque rows (rows, d, k) [N m]."""
    com, points, rotations, (jacobian, _, links) = inputs.com, inputs.points, inputs.rotations, hand
    d, k = widths.shape
    R = np.zeros((rows, d, k))
    for p in range(links.shape[0]):
        i, r = links[p, 0], row_of[links[p, 2]]
        J, turn = jacobian[6 * links[p, 1] :][:6], rotations[i]
        for j in range(d if r >= 0 else 0):
            c = 2 if j == d - 1 else j
            u, v, z = widths[j, i] * turn[0, c], widths[j, i] * turn[1, c], widths[j, i] * turn[2, c]
            if j == 2 and d == 4:  # a moment about the normal
                R[r, j, i] += J[3] * u + J[4] * v + J[5] * z
                continue
            f, g, h = points[i, 0] + com[0], points[i, 1] + com[1], points[i, 2] + com[2]
            R[r, j, i] += J[0] * u + J[1] * v + J[2] * z
            R[r, j, i] += J[3] * (g * z - h * v) + J[4] * (h * u - f * z) + J[5] * (f * v - g * u)
    return R


@jit(**PIECE)
def _add_couplings(R: Array, inputs: TickInputs, widths: Array, pair_of: IntArray, hand: Hand) -> None:
    """Rows of the couplings in R (rows, d, k) [N m]: less what friction bears, and with it."""
    com, points, (jacobian, _, links), E = inputs.com, inputs.points, hand, inputs.couplings
    d, k = widths.shape
    n = E.shape[1]
    every = _torques_by_force(inputs, widths, np.arange(n), n, hand)
    for c in range(E.shape[0]):
        low, high = pair_of[c, 0], pair_of[c, 1]
        if low < 0:
            continue
        arms = np.zeros((k, 3))
        for p in range(links.shape[0]):
            i, share, J = links[p, 0], E[c, links[p, 2]], jacobian[6 * links[p, 1] :][:6]
            f, g, h = points[i, 0] + com[0], points[i, 1] + com[1], points[i, 2] + com[2]
            arms[i, 0] += share * (J[0] + J[4] * h - J[5] * g)
            arms[i, 1] += share * (J[1] + J[5] * f - J[3] * h)
            arms[i, 2] += share * (J[2] + J[3] * g - J[4] * f)
        for i in range(k):
            for j in range(d):
                own = 0.0
                for joint in range(n):
                    own += E[c, joint] * every[joint, j, i]
                R[low, j, i], R[high, j, i] = own, own
            arm = inputs.borne[0] * np.sqrt((arms[i] * arms[i]).sum())
            R[low, d - 1, i] -= arm
            R[high, d - 1, i] += arm


@jit(**PIECE)
def _to_unit(R: Array, r: int) -> float:
    """Brings a row of R to length one; what it was."""
    size: float = max(np.sqrt((R[r] * R[r]).sum()), 1e-12)
    R[r] /= size
    return size


@jit(**PIECE)
def _ranges_of(R: Array, tick: Tick, torques: TorqueRows, scale: float, gravity: Array) -> Ranges:
    """|gravity + J'f| <= limit over ``scale``, and either side of the couplings; the rows of R are brought to length
    one.
    """
    lo, hi, limit, rows = tick.room.cones.lo, tick.room.cones.hi, tick.inputs.torque_limit, R.shape[0]
    R_lo, R_hi = np.empty(rows), np.empty(rows)
    for j in range(len(limit)):
        r = torques.row_of[j]
        if r >= 0:
            size = _to_unit(R, r)
            R_lo[r], R_hi[r] = (-limit[j] - gravity[j]) / (size * scale), (limit[j] - gravity[j]) / (size * scale)
    E, coupled = tick.inputs.couplings, tick.inputs.coupled
    for c in range(E.shape[0]):
        value = coupled[c]
        for j in range(E.shape[1]):
            value -= E[c, j] * gravity[j]
        for side in range(2):
            r = torques.pair_of[c, side]
            if r < 0:
                continue
            bound, reach = value / (_to_unit(R, r) * scale), 1.0
            for i in range(R.shape[2]):
                for j in range(R.shape[1]):
                    reach += 2.0 * abs(R[r, j, i]) * hi[i]
            reach += abs(bound)
            R_lo[r], R_hi[r] = (bound - reach, bound + TRACE) if side == 0 else (bound - TRACE, bound + reach)
    return Ranges(lo, np.maximum(hi, lo + 1e-9), R_lo, R_hi)


@jit(**PIECE)
def _rows_and_limits(A: Array, R: Array, torques: TorqueRows, cones: Cones) -> tuple[Rows, Limits]:
    """Balance A (m, d k), torque rows R (rows, d, k), facets and F_n in the layout of the interior-point method."""
    radii, n_round, own, shared = cones.radii, cones.n_round, torques.own, torques.shared
    m, (rows, d, k), alone = A.shape[0], R.shape, own.shape[0]
    e, facets, both = d - 1, 2 * (d - 1 - n_round), m + shared
    flat, B, G = np.zeros((both + -both % 3, d * k)), np.empty((k, d, m + rows)), np.zeros((facets + 1 + alone, d, k))
    flat[:m] = A
    for i in range(k):
        for j in range(d):
            for r in range(shared):
                flat[m + r, j * k + i] = R[r, j, i]
            for r in range(m):
                B[i, j, r] = A[r, j * k + i]
            for r in range(rows):
                B[i, j, m + r] = R[r, j, i]
            for a in range(alone):
                if own[a, i] >= 0:
                    G[facets + 1 + a, j, i] = B[i, j, own[a, i]]
        for a in range(facets):
            G[a, n_round + a // 2, i] = (-1.0 if a % 2 else 1.0) / radii[n_round + a // 2]
            G[a, e, i] = 1.0
        G[facets, e, i] = 1.0
    return Rows(flat, B, torques.touched, torques.counts, both), Limits(G, torques.used, own)


@jit(**PIECE)
def _problem_within(tick: Tick, scale: float, hand: Hand, torques: TorqueRows) -> Problem:
    """The tick's problem with torque rows. Its facets are left out: they count only in the check of an answer."""
    room, rows = tick.room, torques.touched.shape[1] - tick.settings.rows
    w, radii, n_round = room.quadratic.w, room.cones.radii, room.cones.n_round
    d, k = w.shape
    R = _torques_by_force(tick.inputs, room.widths, torques.row_of, rows, hand)
    if tick.inputs.couplings.shape[0] > 0:
        _add_couplings(R, tick.inputs, room.widths, torques.pair_of, hand)
    ranges = _ranges_of(R, tick, torques, scale, hand.gravity)
    every, limits = _rows_and_limits(room.balance.A, R, torques, room.cones)
    vertices = np.empty((0 if n_round else 4, 2))
    for a in range(len(vertices)):
        vertices[a] = (radii[0] if a % 2 else -radii[0], radii[1] if a // 2 else -radii[1])
    P, q = np.zeros((k, d, d)), np.zeros((k, d))
    for i in range(k):
        for j in range(d):
            P[i, j, j] = w[j, i]
    objective = Objective(P, q, Powers(np.empty(0), np.ones(1)))
    friction = Friction(np.empty((0, d)), vertices, radii, n_round)
    return Problem(every, limits, friction, ranges, objective, room.balance.b)


@jit(**PIECE)
def _closest_within(problem: Problem, tick: Tick, z: Array, y: Array) -> tuple[int, int]:
    """The forces z (k, d) that leave the least of the balance within the torque limits: INFEASIBLE where that is
    proven, STALLED where it is not, CONVERGED where there are none at all; and steps.

    Proximal passes, as in :func:`~pinograsp.forces.kernels.newton.closest`; x is scratch.
    """
    q, w, x, m, steps, proven = problem.objective.q, tick.room.quadratic.w, tick.room.x, problem.b.shape[0], 0, False
    give, nearest, best, scratch = GIVE, np.inf, np.zeros(z.shape), np.empty(z.shape[1])
    for _ in range(GIVES // 2):
        done, used = interior_point(problem, give, z, y)
        steps += used
        if done != CONVERGED or not_finite(z):
            break
        x[:] = z.T
        off, _ = judge(tick.room.balance, tick.room.cones, x)
        if off < nearest:
            nearest, best[:] = off, z
        y /= max(np.sqrt((y[:m] * y[:m]).sum()), 1e-300)
        least = excluded(problem, y, scratch)
        proven = nearest - least <= _CLOSEST_WITHIN * max(nearest, 1.0)
        if proven:
            break
        give = max(give * STIFFEN, LEAST_GIVE)
        q[:] = -w.T * z
    if nearest == np.inf:
        return CONVERGED, steps
    z[:] = best
    return INFEASIBLE if proven else STALLED, steps


@jit(**PIECE)
def _into_cones(z: Array, cones: Cones, x: Array) -> None:
    """x (d, k) = z (k, d), what rounding has outside of the cones and bounds brought back."""
    lo, hi, radii, n_round = cones
    d, k = x.shape
    e = d - 1
    for i in range(k):
        F = min(max(z[i, e], lo[i]), hi[i])
        t = 0.0
        for j in range(n_round):
            t += z[i, j] * z[i, j]
        shrink = min(1.0, F / max(np.sqrt(t), 1e-300))
        for j in range(e):
            x[j, i] = z[i, j] * shrink if j < n_round else min(max(z[i, j], -radii[j] * F), radii[j] * F)
        x[e, i] = F


@jit(**COUNTED)
def within_torques(tick: Tick, scale: float, hand: Hand, chains: IntArray) -> tuple[int, int]:
    """Interior points with |gravity + J'f| <= limit (n,); the room's x (d, k) is the result: (code, steps). Where the
    load cannot be held within the limits x becomes the closest forces; where no forces keep the limits x is unchanged.
    """
    problem = _problem_within(tick, scale, hand, torque_rows_in(chains, tick.settings))
    x, balance, cones = tick.room.x, tick.room.balance, tick.room.cones
    z, y = np.empty(problem.objective.q.shape), np.zeros(problem.rows.B.shape[2])
    code, steps = interior_point(problem, 0.0, z, y)
    if code != CONVERGED:
        nearest, used = _closest_within(problem, tick, z, y)
        steps += used
        if nearest == CONVERGED:
            return code, steps
        code = nearest
    elif not_finite(z):
        return STALLED, steps
    _into_cones(z, cones, x)
    off, _ = judge(balance, cones, x)
    return STALLED if code == CONVERGED and off > 1e-9 else code, steps
