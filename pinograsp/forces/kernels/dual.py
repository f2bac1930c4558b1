r"""The dual Newton method for quadratic objectives.

The balance has m <= 6 rows; every other constraint concerns a single contact. With multipliers y of A x = b the
Lagrangian therefore separates,

    D(y) = -b . y + sum_i min_{x_i} [ phi(F_i) + 1/2 x_i' p_i x_i + (q_i + A_i' y) . x_i ],   u_i in F_i U,  lo <= F_i
    <= hi,

and the dual is concave in m unknowns. Where phi is quadratic each inner problem has a closed form: with c = q + A' y, a
tangential component (or a round pair or triple of them) is u = -c_t / w clipped to F r, w its quadratic weight, so F
solves

    phi'(F) + p_n F + c_n - sum_t r max(0, |c_t| - w r F) = 0,   clipped to [lo, hi],

whose left side increases and is the minimum of several straight lines, one for each set of saturated components: F is
the largest of their roots. The gradient of D is A x(y) - b. A generalised Hessian follows by differentiating x(y): per
contact (v v') / slope along the edge or ray v on which a saturated force moves, 1 / w for components that are not
saturated, and F / |c_t| (I - c c') around a cone (Qi and Sun 1993; the same idea as in SSNAL, Li, Sun and Toh 2018).
The cost of a step grows linearly with the number of contacts. The line search is exact, since the directional
derivative is monotone. Where it stays positive along a step, that step is tested as a Farkas certificate: the limit of
the derivative is the margin of the certificate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import factor, solve
from pinograsp.forces.kernels.flags import NEWTON, PIECE
from pinograsp.forces.kernels.layouts import CONVERGED, INFEASIBLE, PROVEN, STALLED, Balance, Cones, Quadratic
from pinograsp.forces.kernels.rows import slopes_of
from pinograsp.spatial import Array

_SEARCHES = 40  # evaluations of one line search


class _Room(NamedTuple):
    """Where :func:`ascend` works: residual and step (m,), Hessian H (m, m), slopes S = q + A' y and their change V
    along the step (d, k), also flat (d k,), norms of the round parts (k,), and the factors D (m, terms k), weights
    (terms k,) of the Hessian.
    """

    residual: Array
    step: Array
    H: Array
    S: Array
    V: Array
    S_flat: Array
    V_flat: Array
    norm: Array
    weights: Array
    D: Array


class _Line(NamedTuple):
    """The derivative of the dual along a step: its value ``start``, and its part -fixed - t pull that is the same for
    all forces.
    """

    start: float
    fixed: float
    pull: float


@jit(**NEWTON)
def ascent_scratch(d: int, k: int) -> int:
    """Length of the scratch array of :func:`ascend`, for m <= 6 rows; parted in :func:`_room_in`."""
    return 48 + 2 * d * k + k + 7 * 5 * k


@jit(**PIECE)
def _room_in(work: Array, m: int, cones: Cones) -> _Room:
    k, d = cones.lo.shape[0], cones.radii.shape[0] + 1
    n, terms, at = d * k, k * (5 if cones.n_round == 3 else d), 48
    S, V = work[at : at + n], work[at + n : at + 2 * n]
    at += 2 * n
    norm, weights = work[at : at + k], work[at + k : at + k + terms]
    at += k + terms
    return _Room(
        work[:m],
        work[6 : 6 + m],
        work[12 : 12 + m * m].reshape((m, m)),
        S.reshape((d, k)),
        V.reshape((d, k)),
        S,
        V,
        norm,
        weights,
        work[at : at + m * terms].reshape((m, terms)),
    )


@jit(**NEWTON)
def _forces_at(S: Array, t: float, V: Array, w: Array, cones: Cones, x: Array, norm: Array) -> None:
    """x (d, k), the minimiser of every contact's part of the Lagrangian at slopes S + t V (d, k); norm (k,) of its
    round part.

    The normal force is the root of an increasing function that is the minimum of several straight lines, one for each
    set of components at their friction limit: so it is the largest of their roots.
    """
    if cones.n_round == S.shape[0] - 1:
        _round_forces_at(S, t, V, w, cones, x, norm)
    else:
        _edged_forces_at(S, t, V, w, cones, x, norm)


@jit(**NEWTON)
def _round_forces_at(S: Array, t: float, V: Array, w: Array, cones: Cones, x: Array, norm: Array) -> None:
    """:func:`_forces_at` for a cone or a soft finger."""
    lo, hi, _, n_round = cones
    d, k = S.shape
    e = d - 1
    for i in range(k):
        a, b, c = S[0, i] + t * V[0, i], S[1, i] + t * V[1, i], S[e, i] + t * V[e, i]
        g = S[2, i] + t * V[2, i] if n_round == 3 else 0.0
        length = np.sqrt(a * a + b * b + g * g)
        F = min(max(max(-c / w[e, i], (length - c) / (w[e, i] + w[0, i])), lo[i]), hi[i])
        shrink = -F / max(max(length, w[0, i] * F), 1e-300)
        x[0, i], x[1, i], norm[i] = shrink * a, shrink * b, length
        if n_round == 3:
            x[2, i] = shrink * g
        x[e, i] = F


@jit(**NEWTON)
def _edged_forces_at(S: Array, t: float, V: Array, w: Array, cones: Cones, x: Array, norm: Array) -> None:
    """:func:`_forces_at` for a pyramid, and for a cone or pyramid with a torsional moment of its own."""
    lo, hi, radii, n_round = cones
    d, k = S.shape
    e = d - 1
    for i in range(k):
        a, b, c, wn = S[0, i] + t * V[0, i], S[1, i] + t * V[1, i], S[e, i] + t * V[e, i], w[e, i]
        if n_round == 2:
            norm[i] = np.sqrt(a * a + b * b)
            pa, va, pb, vb = norm[i], w[0, i], 0.0, 0.0
        else:
            pa, va = radii[0] * abs(a), radii[0] * radii[0] * w[0, i]
            pb, vb = radii[1] * abs(b), radii[1] * radii[1] * w[1, i]
        F = max(max(-c / wn, (pa - c) / (wn + va)), max((pb - c) / (wn + vb), (pa + pb - c) / (wn + va + vb)))
        if e == 3:
            g = S[2, i] + t * V[2, i]
            c, wn = c - radii[2] * abs(g), wn + radii[2] * radii[2] * w[2, i]
            F = max(
                F, max(max(-c / wn, (pa - c) / (wn + va)), max((pb - c) / (wn + vb), (pa + pb - c) / (wn + va + vb)))
            )
        F = min(max(F, lo[i]), hi[i])
        x[e, i] = F
        if e == 3:
            x[2, i] = min(max(-g / w[2, i], -radii[2] * F), radii[2] * F)
        if n_round == 2:
            shrink = -F / max(max(pa, va * F), 1e-300)
            x[0, i], x[1, i] = shrink * a, shrink * b
        else:
            x[0, i] = min(max(-a / w[0, i], -radii[0] * F), radii[0] * F)
            x[1, i] = min(max(-b / w[1, i], -radii[1] * F), radii[1] * F)


@jit(**NEWTON)
def _directions(A: Array, x: Array, w: Array, cones: Cones, room: _Room) -> None:
    """Factors D and weights in ``room`` such that D diag(weights) D' is a generalised Hessian of the negative dual.

    Per contact: the ray along which a saturated force moves with F_n, and the directions that are free of F_n.
    """
    lo, hi, radii, n_round = cones
    S, norm, D, weights = room.S, room.norm, room.D, room.weights
    m, (d, k) = A.shape[0], S.shape
    e = d - 1
    for i in range(k):
        F, slope = x[e, i], w[e, i]
        for r in range(m):
            D[r, i] = A[r, e * k + i]
        if n_round > 0:
            slips = norm[i] > w[0, i] * F
            around = F / norm[i] if slips else 1.0 / w[0, i]
            inverse = 1.0 / norm[i] if norm[i] > 0.0 else 0.0
            a, b = S[0, i] * inverse, S[1, i] * inverse
            if slips:
                slope += w[0, i]
            if n_round == 2:  # around the cone, and towards its axis
                a = 1.0 if inverse == 0.0 else a
                weights[k + i], weights[2 * k + i] = around, 0.0 if slips else around
                for r in range(m):
                    radial = A[r, i] * a + A[r, k + i] * b
                    D[r, k + i], D[r, 2 * k + i] = A[r, k + i] * a - A[r, i] * b, radial
                    D[r, i] -= radial if slips else 0.0
            else:
                c = S[2, i] * inverse
                for j in range(1, 4):
                    weights[j * k + i] = around
                weights[4 * k + i] = -around if slips else 0.0
                for r in range(m):
                    radial = A[r, i] * a + A[r, k + i] * b + A[r, 2 * k + i] * c
                    D[r, k + i], D[r, 2 * k + i], D[r, 3 * k + i], D[r, 4 * k + i] = (
                        A[r, i],
                        A[r, k + i],
                        A[r, 2 * k + i],
                        radial,
                    )
                    D[r, i] -= radial if slips else 0.0
        for j in range(n_round, e):
            slips = abs(S[j, i]) > w[j, i] * radii[j] * F
            weights[(j + 1) * k + i] = 0.0 if slips else 1.0 / w[j, i]
            edge = 0.0
            if slips:
                edge = radii[j] if S[j, i] > 0.0 else -radii[j]
                slope += w[j, i] * radii[j] * radii[j]
            for r in range(m):
                D[r, (j + 1) * k + i] = A[r, j * k + i]
                D[r, i] -= edge * A[r, j * k + i]
        weights[i] = 1.0 / slope if lo[i] < F and hi[i] > F else 0.0


@jit(**NEWTON)
def _newton_direction(give: float, room: _Room) -> None:
    """The step (m,) in ``room``: (D diag(weights) D' + give + a small regularisation) step = residual."""
    D, weights, residual, H, step = room.D, room.weights, room.residual, room.H, room.step
    m, n, trace, largest = D.shape[0], D.shape[1], 0.0, 0.0
    for r in range(m):
        for s in range(r, m):
            t = 0.0
            for l in range(n):
                t += weights[l] * D[r, l] * D[s, l]
            H[r, s] = t
        trace += H[r, r]
        largest = max(largest, abs(residual[r]))
    # Where every contact is at its limits the dual is linear: this keeps the matrix regular.
    lift = give + 1e-14 * trace + 1e-12 + min(1e-2, 1e-3 * largest)
    for r in range(m):
        H[r, r] += lift
        step[r] = residual[r]
    factor(H)
    solve(H, step)


@jit(**NEWTON)
def least_along(V: Array, b: Array, y: Array, cones: Cones) -> float:
    """The least y . (A x - b) of all admissible x, with V = A' y (d, k)."""
    lo, hi, radii, n_round = cones
    e, total = V.shape[0] - 1, 0.0
    for r in range(b.shape[0]):
        total -= b[r] * y[r]
    for i in range(V.shape[1]):
        s, t = V[e, i], 0.0
        for j in range(n_round):
            t += V[j, i] * V[j, i]
        for j in range(n_round, e):
            s -= radii[j] * abs(V[j, i])
        s -= np.sqrt(t)
        total += min(lo[i] * s, hi[i] * s)
    return total


@jit(**NEWTON)
def _proves(V: Array, b: Array, y: Array, cones: Cones) -> bool:
    """Whether y is a Farkas certificate: y . (A x - b) > 0 for all admissible x, with V = A' y (d, k). If so its
    largest entry becomes 1.
    """
    size = 0.0
    for r in range(y.shape[0]):
        size = max(size, abs(y[r]))
    if not least_along(V, b, y, cones) > PROVEN * size:
        return False
    for r in range(y.shape[0]):
        y[r] /= size
    return True


@jit(**PIECE)
def _residual(balance: Balance, x: Array, y: Array, residual: Array) -> float:
    """A x - b - give y in ``residual``, x (d k,); returns its largest entry."""
    A, b, give = balance
    size = 0.0
    for r in range(A.shape[0]):
        t = -b[r] - give * y[r]
        for l in range(A.shape[1]):
            t += A[r, l] * x[l]
        residual[r] = t
        size = max(size, abs(t))
    return size


@jit(**PIECE)
def _line(balance: Balance, y: Array, room: _Room) -> _Line:
    b, give = balance.b, balance.give
    residual, step = room.residual, room.step
    start, fixed, pull = 0.0, 0.0, 0.0
    for r in range(b.shape[0]):
        start += residual[r] * step[r]
        fixed += (b[r] + give * y[r]) * step[r]
        pull += give * step[r] * step[r]
    return _Line(start, fixed, pull)


@jit(**NEWTON)
def _search(
    balance: Balance, w: Array, cones: Cones, line: _Line, x: Array, flat: Array, room: _Room
) -> tuple[int, float]:
    """How far to go along the step: (CONVERGED, that length), the forces there in x and ``flat``, its (d k,) entries.

    The derivative along the step falls from ``line.start``: its root by regula falsi (Illinois). INFEASIBLE: the step
    is a Farkas certificate; STALLED: there is no root.
    """
    S, V, V_flat, norm = room.S, room.V, room.V_flat, room.norm
    start, fixed, pull = line
    below, above, at_below, at_above, t, side = 0.0, -1.0, start, 0.0, 1.0, 0
    for search in range(_SEARCHES):
        _forces_at(S, t, V, w, cones, x, norm)
        along = -fixed - t * pull
        for l in range(V_flat.shape[0]):
            along += V_flat[l] * flat[l]
        if abs(along) <= 0.3 * start:
            break
        if along < 0.0:
            above, at_above = t, along
            if side < 0:
                at_below *= 0.5
            side = -1
        else:
            below, at_below = t, along
            if side > 0:
                at_above *= 0.5
            side = 1
        if above >= 0.0:
            t = below + at_below * (above - below) / (at_below - at_above)
            continue
        # The derivative is still positive: does it stay so?
        if search == 1 and balance.give == 0.0 and _proves(V, balance.b, room.step, cones):
            return INFEASIBLE, t
        t *= 4.0
        if t > 1e14:
            return STALLED, t
    return CONVERGED, t


@jit(**NEWTON)
def ascend(
    balance: Balance,
    quadratic: Quadratic,
    cones: Cones,
    x: Array,
    y: Array,
    tolerance: float,
    most: int,
    work: Array,
) -> tuple[int, int]:
    """Maximise the dual for a quadratic objective from y (m,) in at most ``most`` steps; (code, Newton steps).

    x (d, k): the forces. INFEASIBLE: y becomes a ray along which the dual grows without bound. work:
    :func:`ascent_scratch`.
    """
    A, b, give = balance
    w, q = quadratic
    m, n = A.shape[0], A.shape[1]
    room = _room_in(work, m, cones)
    S, V, step = room.S_flat, room.V_flat, room.step
    flat, costs = x.reshape(n), q.reshape(n)
    slopes_of(A, y, S)
    for l in range(n):
        S[l] += costs[l]
    _forces_at(room.S, 0.0, room.S, w, cones, x, room.norm)
    for it in range(most):
        if _residual(balance, flat, y, room.residual) <= tolerance:
            return CONVERGED, it
        _directions(A, x, w, cones, room)
        _newton_direction(give, room)
        line = _line(balance, y, room)
        if not line.start > 0.0:
            return STALLED, it
        if it % 8 == 7 and give == 0.0:  # slow: does y itself diverge?
            slopes_of(A, y, V)
            if _proves(room.V, b, y, cones):
                return INFEASIBLE, it
        slopes_of(A, step, V)
        code, t = _search(balance, w, cones, line, x, flat, room)
        for r in range(m if code == INFEASIBLE else 0):
            y[r] = step[r]
        if code != CONVERGED:
            return code, it
        for r in range(m):
            y[r] += t * step[r]
        for l in range(n):
            S[l] += t * V[l]
    return STALLED, most
