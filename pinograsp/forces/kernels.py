r"""All compiled code (extra ``fast``): two solvers for grasp forces, and the checks of their answers.

It is one file because numba's cache on disk notices changes only in the file of the cached function itself.

**Dual Newton.** The balance has m <= 6 rows; every other constraint concerns a single contact. With multipliers y of
A x = b the Lagrangian therefore separates,

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

Powers of F_n are replaced by their quadratic models at the last answer, in several passes (sequential quadratic
programming, whose fixed point solves the prox of phi exactly). Where the objective has no quadratic weight in some
direction, a proximal weight is added that pulls towards the last answer and falls from pass to pass (Rockafellar 1976).
The passes end when the duality gap of the original objective is closed. Answers are certified like those of any other
method; problems that this method does not finish go to the interior-point method.

**Interior points** take every :class:`~pinograsp.forces.program.Program` whose objective couples no two contacts:
polyhedral and second-order friction cones, bounds on F_n, powers of F_n (Eqs. 9 and 11), quadratic terms and torque
rows. The iterates stay inside the cones and bounds; balance and torque rows hold in the limit. With B = [A; R],
multipliers l = [y; w] and per contact the Hessian H_i of the objective and of the barriers, a Newton step solves

    [ H  B' ] [dx]   [ -stationarity + centring ]
    [ B  -E ] [dl] = [ -rows                    ],     H block diagonal with blocks (d, d), E = diag(0, s/w),

by the Schur complement B H^-1 B' + E: six unknowns and one for each torque row, whatever the number of contacts, so the
cost of a step grows linearly with it. A torque row that only one contact enters joins that contact's block H_i. Steps
are Mehrotra's predictor and corrector (1992), second-order cones scaled by Nesterov and Todd's point (1997; formulas as
in Vandenberghe 2010). In infeasible programs the multipliers grow along a Farkas certificate, and are tested as one
while they grow.
"""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinograsp.forces.jit import Flags, jit
from pinograsp.spatial import Array, BoolArray, IntArray

_Scalar = TypeVar("_Scalar", bound=np.generic)
_ConeVector: TypeAlias = tuple[float, float, float, float]

FLAGS: Flags = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy"}
NEWTON: Flags = {**FLAGS, "fastmath": {"contract", "arcp", "nsz", "reassoc"}}  # sums over contacts are vectorised
UNLOCKED: Flags = {**FLAGS, "nogil": True}
CONVERGED, STALLED, INFEASIBLE = 0, 1, 2
# Dual Newton.
_PASSES = 40
_NEWTON_STEPS = 100
_STRONG = 0.03  # objectives of order one with at least this curvature need no proximal weight
_FIRST_WEIGHT, _SHRINK, _LEAST_WEIGHT = 0.1, 0.1, 1e-3  # proximal weights, from pass to pass
_ROUGHLY, _BALANCED = 1e-2, 1e-11  # residual of the balance, relative to the load: in early passes, in the last one
_NEWTON_GAP = 1e-9
# Compliance of the balance constraint where the load cannot be held, against a weight of one on squared forces: first
# value, factor per pass, least value; number of passes.
_GIVE, _STIFFEN, _LEAST_GIVE, _GIVES = 1e-3, 0.1, 1e-7, 20
# Forces are the closest where what they leave of the balance is this near to its proven least value, relative to the
# load: without and with torque limits.
_CLOSEST, _CLOSEST_WITHIN = 1e-8, 1e-6
_BOX_STEPS = 60
# Interior points.
_STEPS = 60
_INTERIOR_GAP = 1e-8  # relative gap at which the search ends
_CLOSED = 1e-7  # relative gap at which it may end once rounding stops its progress
_ROWS = 1e-9  # residual of balance and torque rows, relative to the load
_TO_BOUNDARY, _TO_CONE = 0.999, 0.98  # share of the way to the boundary of polyhedral and of second-order cones
_START = 0.6  # first F_n, relative to the load over the root of the number of contacts
_CENTRE = 0.3  # first product of slack and multiplier, relative to the objective per contact
_LEAST_CENTRE = 1e-3  # least centring, relative to the mean product: products far apart would cost the last digits
_GROWN = 30.0  # multipliers larger than this, relative to the objective, are tested as a certificate
_PROVEN = 1e-9  # margin of a certificate, relative to the load
_SHARP = 1e-9  # relative to the load or the largest F_n: answers that miss a limit by more go to the general methods


# -- dual Newton ------------------------------------------------------------------------------------------------------
#
# Vectors over all contacts are stored by component, v[j, i] for component j of contact i: the innermost loops run over
# contacts that are neighbours in memory, without branches where speed depends on it.


@jit(**NEWTON)
def _forces_at(
    S: Array, t: float, V: Array, w: Array, lo: Array, hi: Array, radii: Array, n_round: int, x: Array, norm: Array
) -> None:
    """x (d, k), the minimiser of every contact's part of the Lagrangian at slopes S + t V (d, k); norm (k,) of its
    round part.

    The normal force is the root of an increasing function that is the minimum of several straight lines, one for each
    set of components at their friction limit: so it is the largest of their roots.
    """
    d, k = S.shape
    e = d - 1
    if n_round == d - 1:  # a cone or a soft finger
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
        return
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
def _slopes(A: Array, y: Array, out: Array) -> None:
    """out (d k,) = A' y with A (m, d k)."""
    a, b, c = y[0], y[1], y[2]
    if y.shape[0] == 6:
        d, e, f = y[3], y[4], y[5]
        for l in range(A.shape[1]):
            out[l] = a * A[0, l] + b * A[1, l] + c * A[2, l] + d * A[3, l] + e * A[4, l] + f * A[5, l]
    else:
        for l in range(A.shape[1]):
            out[l] = a * A[0, l] + b * A[1, l] + c * A[2, l]


@jit(**NEWTON)
def _directions(
    A: Array,
    S: Array,
    x: Array,
    norm: Array,
    w: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    D: Array,
    weights: Array,
) -> None:
    """D (m, terms k) and weights (terms k,) such that D diag(weights) D' is a generalised Hessian of the negative dual.

    Per contact: the ray along which a saturated force moves with F_n, and the directions that are free of F_n.
    """
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
def _newton_direction(D: Array, weights: Array, give: float, residual: Array, H: Array, step: Array) -> None:
    """step (m,) with (D diag(weights) D' + give + a small regularisation) step = residual; H (m, m) is scratch."""
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
    _factor(H)
    _solve(H, step)


@jit(**NEWTON)
def _least_along(V: Array, b: Array, y: Array, lo: Array, hi: Array, radii: Array, n_round: int) -> float:
    """The least y . (A x - b) of all admissible x, with V = A' y (d, k)."""
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
def _proves(V: Array, b: Array, y: Array, lo: Array, hi: Array, radii: Array, n_round: int) -> bool:
    """Whether y is a Farkas certificate: y . (A x - b) > 0 for all admissible x, with V = A' y (d, k). If so its
    largest entry becomes 1.
    """
    size = np.abs(y).max()
    if not _least_along(V, b, y, lo, hi, radii, n_round) > _PROVEN * size:
        return False
    y /= size
    return True


@jit(**NEWTON)
def _ascend(
    A: Array,
    b: Array,
    q: Array,
    w: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    give: float,
    x: Array,
    y: Array,
    tolerance: float,
    most: int,
    work: Array,
) -> tuple[int, int]:
    """Maximise the dual for quadratic weights w > 0 (d, k) from y (m,) in at most ``most`` steps; (code, Newton steps).

    With ``give`` > 0 the balance may be missed at a cost of |A x - b|^2 / (2 give). INFEASIBLE: y becomes a ray along
    which the dual grows without bound. work: scratch, see :func:`newton_scratch`.
    """
    m, (d, k) = A.shape[0], q.shape
    n, terms = d * k, k * (5 if n_round == 3 else d)
    residual, step, H, S = work[:m], work[6 : 6 + m], work[12 : 12 + m * m].reshape((m, m)), work[48 : 48 + n]
    V, norm, weights = work[48 + n : 48 + 2 * n], work[48 + 2 * n :][:k], work[48 + 2 * n + k :][:terms]
    D = work[48 + 2 * n + k + terms :][: m * terms].reshape((m, terms))
    S2, V2, flat, costs = S.reshape((d, k)), V.reshape((d, k)), x.reshape(n), q.reshape(n)
    _slopes(A, y, S)
    for l in range(n):
        S[l] += costs[l]
    _forces_at(S2, 0.0, S2, w, lo, hi, radii, n_round, x, norm)
    for it in range(most):
        size = 0.0
        for r in range(m):
            t = -b[r] - give * y[r]
            for l in range(n):
                t += A[r, l] * flat[l]
            residual[r] = t
            size = max(size, abs(t))
        if size <= tolerance:
            return CONVERGED, it
        _directions(A, S2, x, norm, w, lo, hi, radii, n_round, D, weights)
        _newton_direction(D, weights, give, residual, H, step)
        start, fixed, pull = 0.0, 0.0, 0.0
        for r in range(m):
            start += residual[r] * step[r]
            fixed += (b[r] + give * y[r]) * step[r]
            pull += give * step[r] * step[r]
        if not start > 0.0:
            return STALLED, it
        if it % 8 == 7 and give == 0.0:  # slow: does y itself diverge?
            _slopes(A, y, V)
            if _proves(V2, b, y, lo, hi, radii, n_round):
                return INFEASIBLE, it
        _slopes(A, step, V)
        # The derivative along the step falls from `start`: find its root (regula falsi, Illinois).
        below, above, at_below, at_above, t, side = 0.0, -1.0, start, 0.0, 1.0, 0
        for search in range(40):
            _forces_at(S2, t, V2, w, lo, hi, radii, n_round, x, norm)
            along = -fixed - t * pull
            for l in range(n):
                along += V[l] * flat[l]
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
            if search == 1 and give == 0.0 and _proves(V2, b, step, lo, hi, radii, n_round):
                for r in range(m):
                    y[r] = step[r]
                return INFEASIBLE, it
            t *= 4.0
            if t > 1e14:
                return STALLED, it
        for r in range(m):
            y[r] += t * step[r]
        for l in range(n):
            S[l] += t * V[l]
    return STALLED, most


@jit(**NEWTON)
def _gap(
    A: Array,
    b: Array,
    q: Array,
    P: Array,
    coefs: Array,
    exps: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    x: Array,
    y: Array,
    slopes: Array,
) -> tuple[float, float]:
    """The objective at x, and its lower bound from y and the tangents at x; slopes (d k,) is scratch."""
    d, k = q.shape
    e, value, bound = d - 1, 0.0, 0.0
    for r in range(b.shape[0]):
        bound -= b[r] * y[r]
    _slopes(A, y, slopes)
    for i in range(k):
        s, t = 0.0, 0.0
        for j in range(d):
            heavy = P[j, i] * x[j, i]
            c = q[j, i] + heavy + slopes[j * k + i]
            value += (q[j, i] + 0.5 * heavy) * x[j, i]
            bound -= 0.5 * heavy * x[j, i]
            if j < n_round:
                t += c * c
            elif j < e:
                s -= radii[j] * abs(c)
            else:
                s += c
        s -= np.sqrt(t)
        if coefs.shape[0] > 0:
            t, first, _ = phi(x[e, i], coefs, exps)
            value += t
            bound += t - first * x[e, i]
            s += first
        bound += min(lo[i] * s, hi[i] * s)
    return value, bound


@jit(**NEWTON)
def dual_newton(
    A: Array,
    b: Array,
    q: Array,
    P: Array,
    coefs: Array,
    exps: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    x: Array,
    y: Array,
    work: Array,
) -> tuple[int, int]:
    """Minimise over the cones from y (m,), zeros if nothing is known; x (d, k) is start and result, y the multipliers.

    A (m, d k); q and P (d, k), P being the diagonal; the powers as in :func:`interior_point`; lo < hi (k,); radii (d -
    1,) of components without a cone. work: :func:`newton_scratch`. Returns (code, Newton steps). INFEASIBLE: y is a
    ray.
    """
    d, k = q.shape
    e, n, steps, least = d - 1, d * k, 0, np.inf
    w, shifted, rest = work[:n].reshape((d, k)), work[n : 2 * n].reshape((d, k)), work[2 * n :]
    for j in range(d):
        for i in range(k):
            least = min(least, P[j, i])
    strong = least >= _STRONG
    once = strong and coefs.shape[0] == 0
    weight = 0.0 if strong else _FIRST_WEIGHT
    for _stage in range(_PASSES):
        last = weight < 2 * _LEAST_WEIGHT
        for j in range(d):
            for i in range(k):
                w[j, i], shifted[j, i] = P[j, i] + weight, q[j, i] - weight * x[j, i]
        for i in range(k if coefs.shape[0] > 0 else 0):
            F = x[e, i]
            _, first, second = phi(F, coefs, exps)
            w[e, i] += second
            shifted[e, i] += first - second * F
        tolerance = _BALANCED if last else _ROUGHLY
        code, used = _ascend(A, b, shifted, w, lo, hi, radii, n_round, 0.0, x, y, tolerance, _NEWTON_STEPS, rest)
        steps += used
        if code != CONVERGED or once:
            return code, steps
        if last:
            value, bound = _gap(A, b, q, P, coefs, exps, lo, hi, radii, n_round, x, y, rest[48:])
            if value - bound <= _NEWTON_GAP * max(abs(value), 1e-12):
                return CONVERGED, steps
        weight = 0.0 if strong else max(weight * _SHRINK, _LEAST_WEIGHT)
    return STALLED, steps


@jit(**NEWTON)
def newton_scratch(d: int, k: int) -> int:
    """Length of the scratch array of :func:`dual_newton`."""
    return 48 + 4 * d * k + k + 7 * 5 * k


# -- interior points --------------------------------------------------------------------------------------------------
#
# Vectors over all contacts are stored by component, v[j k + i] for component j of contact i, matrices in the same
# order, so that the innermost loops run over contacts next to each other in memory.


@jit(**FLAGS)
def phi(F: float, coefs: Array, exps: Array) -> tuple[float, float, float]:
    """phi, phi' and phi'' at F > 0; see :func:`interior_point` for the powers."""
    value, first, second = 0.0, 0.0, 0.0
    if coefs.shape[0] > 0:
        # The exponents are 1 + j / rho (Eqs. 9 and 11), so one power serves all of them.
        root = F ** exps[0]
        for a in range(coefs.shape[0]):
            power, exponent = coefs[a], exps[0] * exps[1 + a]
            for _ in range(int(exps[1 + a])):
                power *= root
            value += power / (1.0 + exponent)
            first += power
            second += exponent * power
    return value * F, first, second / F


@jit(**FLAGS)
def _factor(H: Array) -> None:
    """Cholesky factor U'U of H (n, n) in its upper triangle, in place, inverse pivots on the diagonal; small pivots are
    raised to a floor.
    """
    n = H.shape[0]
    largest = 0.0
    for r in range(n):
        largest = max(largest, H[r, r])
    floor = 1e-15 * largest + 1e-300
    for r in range(n):
        scale = 1.0 / np.sqrt(max(H[r, r], floor))
        H[r, r] = scale
        for c in range(r + 1, n):
            H[r, c] *= scale
        for i in range(r + 1, n):
            t = H[r, i]
            for c in range(i, n):
                H[i, c] -= t * H[r, c]


@jit(**FLAGS)
def _solve(U: Array, v: Array) -> None:
    """v <- (U'U)^-1 v with U from :func:`_factor`."""
    n = v.shape[0]
    for r in range(n):
        t = v[r] * U[r, r]
        v[r] = t
        for c in range(r + 1, n):
            v[c] -= t * U[r, c]
    for r in range(n - 1, -1, -1):
        t = v[r]
        for c in range(r + 1, n):
            t -= U[r, c] * v[c]
        v[r] = t * U[r, r]


@jit(**FLAGS)
def _factor_contacts(H: Array) -> None:
    """:func:`_factor` for every contact's block of H (d, d, k); d is 3 or 4."""
    d, _, k = H.shape
    for i in range(k):
        a, b, c = H[0, 0, i], H[1, 1, i], H[2, 2, i]
        floor = 1e-15 * max(max(a, b), c) + 1e-300
        a = 1.0 / np.sqrt(max(a, floor))
        ab, ac = H[0, 1, i] * a, H[0, 2, i] * a
        b = 1.0 / np.sqrt(max(b - ab * ab, floor))
        bc = (H[1, 2, i] - ab * ac) * b
        c = 1.0 / np.sqrt(max(c - ac * ac - bc * bc, floor))
        H[0, 0, i], H[1, 1, i], H[2, 2, i], H[0, 1, i], H[0, 2, i], H[1, 2, i] = a, b, c, ab, ac, bc
        if d == 4:
            ae = H[0, 3, i] * a
            be = (H[1, 3, i] - ab * ae) * b
            ce = (H[2, 3, i] - ac * ae - bc * be) * c
            rest = H[3, 3, i] - ae * ae - be * be - ce * ce
            H[0, 3, i], H[1, 3, i], H[2, 3, i] = ae, be, ce
            H[3, 3, i] = 1.0 / np.sqrt(max(rest, max(floor, 1e-15 * H[3, 3, i])))


@jit(**FLAGS)
def _half_solve(U: Array, rows: Array, out: Array) -> None:
    """out[h] = U'^-1 rows[h] for the contacts' factors U and every row (n, d k)."""
    d, _, k = U.shape
    for i in range(k):
        a, b, c = U[0, 0, i], U[1, 1, i], U[2, 2, i]
        ab, ac, bc = U[0, 1, i], U[0, 2, i], U[1, 2, i]
        for h in range(rows.shape[0]):
            s = rows[h, i] * a
            t = (rows[h, k + i] - ab * s) * b
            u = (rows[h, 2 * k + i] - ac * s - bc * t) * c
            out[h, i], out[h, k + i], out[h, 2 * k + i] = s, t, u
            if d == 4:
                rest = rows[h, 3 * k + i] - U[0, 3, i] * s - U[1, 3, i] * t - U[2, 3, i] * u
                out[h, 3 * k + i] = rest * U[3, 3, i]


@jit(**FLAGS)
def _back_solve(U: Array, v: Array) -> None:
    """v <- U^-1 v for the contacts' factors U; v (1, d k)."""
    d, _, k = U.shape
    for i in range(k):
        s, t, u = v[0, i], v[0, k + i], v[0, 2 * k + i]
        if d == 4:
            w = v[0, 3 * k + i] * U[3, 3, i]
            v[0, 3 * k + i] = w
            s, t, u = s - U[0, 3, i] * w, t - U[1, 3, i] * w, u - U[2, 3, i] * w
        u *= U[2, 2, i]
        t = (t - U[1, 2, i] * u) * U[1, 1, i]
        v[0, i], v[0, k + i], v[0, 2 * k + i] = (s - U[0, 1, i] * t - U[0, 2, i] * u) * U[0, 0, i], t, u


@jit(**FLAGS)
def _add_products(A: Array, v: Array, out: Array) -> None:
    """out += A v; the number of rows is a multiple of three."""
    for r in range(0, A.shape[0], 3):
        a, b, c = 0.0, 0.0, 0.0
        for l in range(A.shape[1]):
            t = v[0, l]
            a, b, c = a + A[r, l] * t, b + A[r + 1, l] * t, c + A[r + 2, l] * t
        out[r], out[r + 1], out[r + 2] = out[r] + a, out[r + 1] + b, out[r + 2] + c


@jit(**FLAGS)
def _add_combination(A: Array, y: Array, sign: float, out: Array) -> None:
    """out += sign A' y; the number of rows is a multiple of three."""
    for r in range(0, A.shape[0], 3):
        a, b, c = sign * y[r], sign * y[r + 1], sign * y[r + 2]
        for l in range(A.shape[1]):
            out[0, l] += A[r, l] * a + A[r + 1, l] * b + A[r + 2, l] * c


@jit(**FLAGS)
def _gram(T: Array, S: Array) -> None:
    """S = T T', its upper triangle, in blocks of three rows and columns."""
    for r in range(0, T.shape[0], 3):
        for c in range(r, T.shape[0], 3):
            a0, a1, a2, b0, b1, b2, c0, c1, c2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for l in range(T.shape[1]):
                a, b, g = T[r, l], T[r + 1, l], T[r + 2, l]
                s, t, u = T[c, l], T[c + 1, l], T[c + 2, l]
                a0, a1, a2 = a0 + a * s, a1 + a * t, a2 + a * u
                b0, b1, b2 = b0 + b * s, b1 + b * t, b2 + b * u
                c0, c1, c2 = c0 + g * s, c1 + g * t, c2 + g * u
            S[r, c], S[r, c + 1], S[r, c + 2] = a0, a1, a2
            S[r + 1, c], S[r + 1, c + 1], S[r + 1, c + 2] = b0, b1, b2
            S[r + 2, c], S[r + 2, c + 1], S[r + 2, c + 2] = c0, c1, c2


# Limits with slacks: least <= G x <= most with coefficients G (limits of a contact, d, k): facets, which have no upper
# side, F_n, torque rows of one contact. Torque rows of several contacts, ``shared``, follow as rows of their own.


@jit(**FLAGS)
def _limits_along(G: Array, used: IntArray, shared: Array, v: Array, out: Array) -> None:
    """out = G v. ``used`` (limits of a contact, d): whether a component enters."""
    _, d, k = G.shape
    e = (d - 1) * k
    for a in range(G.shape[0]):
        for i in range(k):
            out[a * k + i] = G[a, d - 1, i] * v[0, e + i]
        for j in range(d - 1):
            if used[a, j]:
                for i in range(k):
                    out[a * k + i] += G[a, j, i] * v[0, j * k + i]
    out[G.shape[0] * k :] = 0.0
    _add_products(shared, v, out[G.shape[0] * k :])


@jit(**FLAGS)
def _add_limits(G: Array, used: IntArray, v: Array, out: Array) -> None:
    """out += G' v, without the torque rows of several contacts."""
    _, d, k = G.shape
    for a in range(G.shape[0]):
        for j in range(d):
            if used[a, j]:
                for i in range(k):
                    out[0, j * k + i] += G[a, j, i] * v[a * k + i]


@jit(**FLAGS)
def _add_weighted_limits(G: Array, used: IntArray, w: Array, H: Array) -> None:
    """H += G' diag(w) G, without the torque rows of several contacts."""
    _, d, k = G.shape
    for a in range(G.shape[0]):
        for j in range(d):
            for c in range(j, d):
                if used[a, j] and used[a, c]:
                    for i in range(k):
                        H[j, c, i] += G[a, j, i] * G[a, c, i] * w[a * k + i]


@jit(**FLAGS)
def _both_sides(v: Array, sign: float, one_sided: int, out: Array) -> None:
    """Per limit the entry of its lower side plus ``sign`` times that of its upper side, which facets do not have."""
    other = out.shape[0] - one_sided
    for l in range(one_sided):
        out[l] = v[l]
    for l in range(one_sided, out.shape[0]):
        out[l] = v[l] + sign * v[l + other]


# Vectors of second-order cones are tuples (u, u, u or 0, head).


@jit(**FLAGS)
def _in_cone(v: Array, i: int, k: int, n_round: int) -> _ConeVector:
    """Contact i's components of v (1, d k) that a second-order cone bounds."""
    return v[0, i], v[0, k + i], v[0, 2 * k + i] if n_round == 3 else 0.0, v[0, v.shape[1] - k + i]


@jit(**FLAGS)
def _row(v: Array, i: int) -> _ConeVector:
    """Row i of v (k, 4)."""
    return v[i, 0], v[i, 1], v[i, 2], v[i, 3]


@jit(**FLAGS)
def _to_cone(v: _ConeVector, dv: _ConeVector, step: float) -> float:
    """The largest step up to ``step`` that keeps v + step dv in the cone."""
    a = dv[3] * dv[3] - dv[0] * dv[0] - dv[1] * dv[1] - dv[2] * dv[2]
    b = v[3] * dv[3] - v[0] * dv[0] - v[1] * dv[1] - v[2] * dv[2]
    c = v[3] * v[3] - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
    if v[3] + step * dv[3] > 0.0 and c + step * (2.0 * b + step * a) > 0.0:
        return step
    # Least positive root of a t^2 + 2 b t + c, c > 0.
    root = b * b - a * c
    if root >= 0.0 and (b < 0.0 or a < 0.0):
        root = np.sqrt(root) - b
        if root > 0.0:
            step = min(step, c / root)
    return min(step, -v[3] / dv[3]) if dv[3] < 0.0 else step


@jit(**FLAGS)
def _scaling(s: _ConeVector, z: _ConeVector) -> tuple[_ConeVector, float]:
    """Nesterov and Todd's scaling (vector, size) of a cone's vector and its multiplier."""
    ss = np.sqrt(max(s[3] * s[3] - s[0] * s[0] - s[1] * s[1] - s[2] * s[2], 1e-300))
    zz = np.sqrt(max(z[3] * z[3] - z[0] * z[0] - z[1] * z[1] - z[2] * z[2], 1e-300))
    sz = s[0] * z[0] + s[1] * z[1] + s[2] * z[2] + s[3] * z[3]
    half = 0.5 / np.sqrt(0.5 * (1.0 + sz / (ss * zz)))
    a, b = half / ss, half / zz
    return (a * s[0] - b * z[0], a * s[1] - b * z[1], a * s[2] - b * z[2], a * s[3] + b * z[3]), np.sqrt(ss / zz)


@jit(**FLAGS)
def _scaled(bar: _ConeVector, scale: float, v: _ConeVector, sign: float) -> _ConeVector:
    """W v for sign 1, W^-1 v for sign -1 and the inverse scale."""
    along = bar[0] * v[0] + bar[1] * v[1] + bar[2] * v[2]
    t = sign * v[3] + along / (1.0 + bar[3])
    head = scale * (bar[3] * v[3] + sign * along)
    return scale * (v[0] + t * bar[0]), scale * (v[1] + t * bar[1]), scale * (v[2] + t * bar[2]), head


@jit(**FLAGS)
def _scale_cones(x: Array, zc: Array, n_round: int, bar: Array, eta: Array, H: Array) -> float:
    """Scalings of all cones and their Hessians, added to H; returns the sum of the complementarity."""
    d, _, k = H.shape
    comp = 0.0
    for i in range(k):
        s, z = _in_cone(x, i, k, n_round), _row(zc, i)
        w, size = _scaling(s, z)
        bar[i, 0], bar[i, 1], bar[i, 2], bar[i, 3], eta[i] = w[0], w[1], w[2], w[3], size
        comp += s[0] * z[0] + s[1] * z[1] + s[2] * z[2] + s[3] * z[3]
        scale = 1.0 / (size * size)
        t = 2.0 * scale
        for a in range(n_round):
            for c in range(a, n_round):
                H[a, c, i] += t * w[a] * w[c]
            H[a, a, i] += scale
            H[a, d - 1, i] -= t * w[a] * w[3]
        H[d - 1, d - 1, i] += t * w[3] * w[3] - scale
    return comp


@jit(**FLAGS)
def _step_cones(
    x: Array,
    dx: Array,
    zc: Array,
    dzc: Array,
    n_round: int,
    bar: Array,
    eta: Array,
    centring: Array,
    corrector: bool,
    alpha: float,
) -> float:
    """Steps of the cones' multipliers for the step dx; returns the largest step up to alpha. The predictor leaves its
    Jordan products in ``centring``.
    """
    k = eta.shape[0]
    for i in range(k):
        w, v, z = _row(bar, i), _in_cone(dx, i, k, n_round), _row(zc, i)
        scale = 1.0 / eta[i]
        ds = _scaled(w, scale, v, -1.0)
        back = _scaled(w, scale, ds, -1.0)
        c = _row(centring, i)  # zero in the predictor
        dz = (c[0] - z[0] - back[0], c[1] - z[1] - back[1], c[2] - z[2] - back[2], c[3] - z[3] - back[3])
        if not corrector:
            t = _scaled(w, eta[i], dz, 1.0)
            for j in range(3):
                centring[i, j] = ds[3] * t[j] + t[3] * ds[j]
            centring[i, 3] = ds[0] * t[0] + ds[1] * t[1] + ds[2] * t[2] + ds[3] * t[3]
        dzc[i, 0], dzc[i, 1], dzc[i, 2], dzc[i, 3] = dz
        alpha = _to_cone(z, dz, _to_cone(_in_cone(x, i, k, n_round), v, alpha))
    return alpha


@jit(**FLAGS)
def _centre_cones(zc: Array, bar: Array, eta: Array, centre: float, centring: Array) -> None:
    r"""Jordan products p in ``centring`` become W^-1 (lambda \ (centre e - p)), lambda = W z."""
    for i in range(eta.shape[0]):
        w, p = _row(bar, i), _row(centring, i)
        v = _scaled(w, eta[i], _row(zc, i), 1.0)
        det = v[3] * v[3] - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
        t = v[3] * (centre - p[3]) + v[0] * p[0] + v[1] * p[1] + v[2] * p[2]
        t /= max(det, 1e-300)
        c = ((-p[0] - t * v[0]) / v[3], (-p[1] - t * v[1]) / v[3], (-p[2] - t * v[2]) / v[3], t)
        c = _scaled(w, 1.0 / eta[i], c, -1.0)
        centring[i, 0], centring[i, 1], centring[i, 2], centring[i, 3] = c


@jit(**FLAGS)
def _to_boundary(v: Array, dv: Array, alpha: float) -> float:
    """The largest step up to alpha that keeps v + alpha dv at least 0."""
    for l in range(v.shape[0]):
        if v[l] + alpha * dv[l] < 0.0:
            alpha = -v[l] / dv[l]
    return alpha


@jit(**FLAGS)
def support(g: Array, n_round: int, vertices: Array) -> float:
    """max of g . u over U (:class:`~pinograsp.contacts.Friction`); vertices (e, 2) of a polygon, else (0, 2)."""
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
def bound_of(
    y: Array,
    x: Array,
    B: Array,
    touched: IntArray,
    counts: IntArray,
    b: Array,
    P: Array,
    q: Array,
    coefs: Array,
    exps: Array,
    lo: Array,
    hi: Array,
    n_round: int,
    vertices: Array,
    R_lo: Array,
    R_hi: Array,
    g: Array,
) -> tuple[float, float]:
    """Lower bound of the objective from y and tangents near x (``Program.lower_bound``, compiled), and the objective at
    x.

    g (d,) is scratch.
    """
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
        s = g[e] - support(g, n_round, vertices)
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


@jit(**FLAGS)
def _newton_step(
    T: Array,
    H: Array,
    S: Array,
    G: Array,
    used: IntArray,
    sides: Array,
    weights: Array,
    multipliers: Array,
    row: Array,
    dx: Array,
    dy: Array,
) -> None:
    """Newton steps of x and of the rows' multipliers. dx: on entry the right-hand side without the limits' part, then
    the step of x; dy: the step of the multipliers.

    ``sides``: the limits' part, lower minus upper side; row: residual of the balance.
    """
    m, at = row.shape[0], G.shape[0] * G.shape[2] - row.shape[0]
    _add_limits(G, used, sides, dx)
    _half_solve(H, dx, dx)
    for r in range(dy.shape[0]):
        dy[r] = row[r] if r < m else (-sides[at + r] - multipliers[r]) / weights[at + r]
    _add_products(T, dx, dy)
    _solve(S, dy)
    _add_combination(T, dy, -1.0, dx)
    _back_solve(H, dx)


@jit(**FLAGS)
def excluded(
    y: Array,
    B: Array,
    touched: IntArray,
    counts: IntArray,
    b: Array,
    lo: Array,
    hi: Array,
    n_round: int,
    vertices: Array,
    R_lo: Array,
    R_hi: Array,
    g: Array,
) -> float:
    """Farkas bound of multipliers y = [balance; torque rows] (``Program.excluded``, compiled). g (d,) is scratch."""
    k, d, _n = B.shape
    P, x, none = np.zeros((k, d, d)), np.zeros((k, d)), np.zeros(0)
    return bound_of(y, x, B, touched, counts, b, P, x, none, none, lo, hi, n_round, vertices, R_lo, R_hi, g)[0]


@jit(**FLAGS)
def interior_point(
    A: Array,
    G: Array,
    used: IntArray,
    own: IntArray,
    B: Array,
    touched: IntArray,
    counts: IntArray,
    n: int,
    b: Array,
    P: Array,
    q: Array,
    coefs: Array,
    exps: Array,
    lo: Array,
    hi: Array,
    n_round: int,
    vertices: Array,
    R_lo: Array,
    R_hi: Array,
    give: float,
    x: Array,
    y: Array,
) -> tuple[int, int]:
    """Minimise over the cones; x (k, d) and y (m + r,) are the results. (CONVERGED, STALLED or INFEASIBLE, steps).

    Shapes: A (n rounded up to a multiple of three, d k) balance (m) and torque rows that several contacts enter, n in
    all, by component; G (f + 1 + g, d, k) limits: facets of the friction cone, F_n, torque rows of one contact; used (f
    + 1 + g, d): components that enter them; own (g, k): where in B the latter are, -1 for none; B (k, d, m + r) all
    rows; touched (k, m + r): the rows that a contact enters, the first counts[i, 0] below n, counts[i, 1] in all; b
    (m,); P (k, d, d); q (k, d); lo < hi (k,); n_round components that a second-order cone bounds; vertices (e, 2) of
    the polygon; R_lo < R_hi (r,). phi' is the sum of coefs[a] F^(exps[0] exps[1 + a]) with coefs (a,) and exps (1 +
    a,), integers from the second on. With ``give`` > 0 the balance may be missed at a cost of |A x - b|^2 / (2
    give). INFEASIBLE: y is a Farkas certificate.
    """
    k, d, all_rows = B.shape
    m, f, e, rows = b.shape[0], G.shape[0] - own.shape[0] - 1, (d - 1) * k, A.shape[0]
    balance, R = A[:m], A[m:]
    # Where limits on F_n begin, torque rows of one contact, torque rows of several.
    facets, torques, several = f * k, (f + 1) * k, G.shape[0] * k
    limits = several + rows - m
    quadratic = np.any(P != 0.0)
    v, dx, grad = np.zeros((1, d * k)), np.empty((1, d * k)), np.empty((1, d * k))  # v: x by component
    H, T = np.empty((d, d, k)), np.empty((rows, d * k))
    S, row, dy, multipliers, none = np.empty((rows, rows)), np.empty(m), np.empty(rows), np.zeros(rows), np.zeros(rows)
    # Slacks s of all limits, lower sides first, their multipliers z, weights w = z / s; off: s less the true slack;
    # products of the predictor's steps; per limit values and weights.
    size = 2 * limits - facets
    s, z, ds, dz, w, inverse = (
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
    )
    off, product, target = np.zeros(size), np.empty(size), np.empty(size)
    along, weights = np.empty(limits), np.empty(limits)
    # Multipliers of the second-order cones, their centring term, scalings.
    cones = k if n_round > 0 else 0
    zc, dzc, centring = np.zeros((cones, 4)), np.zeros((cones, 4)), np.zeros((cones, 4))
    bar, eta = np.empty((cones, 4)), np.empty(cones)
    scratch, mu, up = np.empty(d), _CENTRE / k, limits - facets  # up: from a limit's lower to its upper side
    for i in range(k):
        wide = hi[i] - lo[i]
        v[0, e + i] = min(max(_START / np.sqrt(k), lo[i] + 0.1 * min(wide, 1.0 / k)), hi[i] - 0.1 * wide)
        if n_round > 0:
            zc[i, 3] = mu / v[0, e + i]
    _limits_along(G, used, R, v, along)
    for l in range(limits):
        least, most = -1.0, 1.0  # of rows of zeros
        if l < facets:
            least = 0.0
        elif l < torques:
            least, most = lo[l - facets], hi[l - facets]
        else:
            at = (own[(l - torques) // k, (l - torques) % k] if l < several else m + l - several) - m
            if at >= 0 and (l < several or at < n - m):
                least, most = R_lo[at], R_hi[at]
        s[l] = along[l] - least
        if l >= facets:
            s[l + up] = most - along[l]
        if l >= torques:
            for side in (l, l + up):
                off[side] = max(0.1 * min(most - least, 1.0) - s[side], 0.0)
                s[side] += off[side]
    for l in range(size):
        z[l] = mu / s[l]
    count = size + cones
    share = _TO_CONE if n_round > 0 else _TO_BOUNDARY
    tested, short, previous, v_before, y_before = _GROWN, 0, np.inf, np.empty_like(v), np.empty_like(y)
    for step in range(_STEPS):
        # Residuals.
        far = 0.0
        for r in range(m):
            row[r] = -b[r] - give * multipliers[r]
        _add_products(balance, v, row)
        for r in range(m):
            far = max(far, abs(row[r]))
        for l in range(torques, size):
            far = max(far, abs(off[l]))
        comp, value = 0.0, 0.0
        for l in range(size):
            inverse[l] = 1.0 / s[l]
            w[l] = z[l] * inverse[l]
            comp += s[l] * z[l]
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
        scale = max(abs(value), 1e-6)
        for r in range(m):
            scale += give * multipliers[r] * multipliers[r]
        # Hessians, their factors and the Schur complement.
        _both_sides(w, 1.0, facets, weights)
        _add_weighted_limits(G, used, weights, H)
        if n_round > 0:
            comp += _scale_cones(v, zc, n_round, bar, eta, H)
        _factor_contacts(H)
        _half_solve(H, A, T)
        _gram(T, S)
        for r in range(rows):
            S[r, r] += give if r < m else 1.0 / weights[several + r - m]
        _factor(S)
        _to_contacts(v, multipliers, z, own, n, torques, up, x, y)
        done = False
        if far <= (1e-7 if give == 0.0 else 1e-9) and comp <= 1e-6 * scale:
            bound, _ = bound_of(
                y, x, B, touched, counts, b, P, q, coefs, exps, lo, hi, n_round, vertices, R_lo, R_hi, scratch
            )
            gap = value - bound
            for r in range(m):
                gap += y[r] * (row[r] + give * y[r])  # the cost of restoring the balance, or of missing it
            done = gap <= scale * _INTERIOR_GAP
            if not done and gap >= 0.3 * previous and min(gap, previous) <= scale * _CLOSED:
                done = True  # rounding stops its progress
                if previous < gap:
                    v[:], y[:] = v_before, y_before
            v_before[:], y_before[:], previous = v, y, gap
        if done:
            # The residual that rounding leaves in the rows is removed in the barriers' metric, in which forces at their
            # limits hardly move.
            for again in range(0 if give > 0.0 else 2):
                for l in range(size):
                    target[l] = 0.0 if again else w[l] * off[l]
                _both_sides(target, -1.0, facets, along)
                dx[:] = 0.0
                _newton_step(T, H, S, G, used, along, weights, none, row, dx, dy)
                for l in range(d * k):
                    v[0, l] += dx[0, l]
                row[:] = -b
                _add_products(balance, v, row)
            _to_contacts(v, multipliers, z, own, n, torques, up, x, y)
            y[:] = y_before
            return CONVERGED, step
        grown = 0.0
        for r in range(all_rows):
            grown = max(grown, abs(y[r]))
        if not (grown < 1e15 and comp < 1e15):
            return STALLED, step
        if give == 0.0 and far > _ROWS and (grown > tested * max(scale, 1.0) or (short > 1 and grown > 0.0)):
            tested = max(tested, 4.0 * grown / max(scale, 1.0))
            for r in range(all_rows):
                y[r] /= grown
            if excluded(y, B, touched, counts, b, lo, hi, n_round, vertices, R_lo, R_hi, scratch) > _PROVEN:
                return INFEASIBLE, step
        # Predictor and corrector.
        _add_combination(A, multipliers, 1.0, grad)
        centre, alpha, centring[:] = 0.0, 1.0, 0.0
        for corrector in range(2):
            for l in range(size):
                target[l] = w[l] * off[l]
            for l in range(d * k):
                dx[0, l] = -grad[0, l]
            if corrector:
                for l in range(size):
                    target[l] += (centre - product[l]) * inverse[l]
            for i in range(cones):
                for j in range(n_round):
                    dx[0, j * k + i] += centring[i, j]
                dx[0, e + i] += centring[i, 3]
            _both_sides(target, -1.0, facets, along)
            _newton_step(T, H, S, G, used, along, weights, multipliers, row, dx, dy)
            _limits_along(G, used, R, dx, along)
            for l in range(limits):
                dz[l] = target[l] - z[l] - w[l] * along[l]
                ds[l] = along[l] - off[l]
            for l in range(limits, size):
                dz[l] = target[l] - z[l] + w[l] * along[l - up]
                ds[l] = -along[l - up] - off[l]
            alpha = 1.0 / share if corrector else 1.0
            alpha = _to_boundary(z, dz, _to_boundary(s, ds, alpha))
            if n_round > 0:
                alpha = _step_cones(v, dx, zc, dzc, n_round, bar, eta, centring, corrector > 0, alpha)
            if not corrector:
                for l in range(size):
                    product[l] = ds[l] * dz[l]
                centre = max((1.0 - alpha) ** 3, _LEAST_CENTRE) * comp / count
                if n_round > 0:
                    _centre_cones(zc, bar, eta, centre, centring)
        alpha = min(1.0, share * alpha)
        short = short + 1 if alpha < 1e-3 else 0
        if short > 5:
            return STALLED, step
        # Slacks are carried along: computed from x they would lose their digits, and could vanish.
        for l in range(size):
            s[l] += alpha * ds[l]
            z[l] += alpha * dz[l]
            off[l] *= 1.0 - alpha
        for l in range(d * k):
            v[0, l] += alpha * dx[0, l]
        for i in range(cones):
            for j in range(4):
                zc[i, j] += alpha * dzc[i, j]
        for r in range(rows):
            multipliers[r] = multipliers[r] + alpha * dy[r] if r < m else z[several + r - m + up] - z[several + r - m]
    return STALLED, _STEPS


@jit(**FLAGS)
def _to_contacts(
    v: Array, multipliers: Array, z: Array, own: IntArray, n: int, torques: int, up: int, x: Array, y: Array
) -> None:
    """x (k, d) from its components v, and the multipliers of all rows in their order."""
    k, d = x.shape
    for i in range(k):
        for j in range(d):
            x[i, j] = v[0, j * k + i]
        for a in range(own.shape[0]):
            if own[a, i] >= 0:
                at = torques + a * k + i
                y[own[a, i]] = z[at + up] - z[at]
    for r in range(n):
        y[r] = multipliers[r]


# -- answers and their checks -----------------------------------------------------------------------------------------


@jit(**FLAGS)
def powers_of(terms: Array, scale: float, unit: float) -> tuple[Array, Array]:
    """phi' in the form of :func:`interior_point`, from pairs (coefficient, exponent): the exponents are 1, 1 + 1 / rho
    and 1 + 2 / rho.
    """
    count = terms.shape[0]
    coefs, exps = np.empty(count), np.empty(count + 1)
    exps[0] = 1.0
    for a in range(count):
        if terms[a, 1] > 1.0:
            exps[0] = min(exps[0], terms[a, 1] - 1.0)
    for a in range(count):
        coefs[a] = terms[a, 0] * terms[a, 1] * scale ** terms[a, 1] / unit
        exps[1 + a] = np.round((terms[a, 1] - 1.0) / exps[0])
    return coefs, exps


@jit(**FLAGS)
def answer(
    newton: bool,
    A: Array,
    G: Array,
    used: IntArray,
    own: IntArray,
    B: Array,
    touched: IntArray,
    counts: IntArray,
    n: int,
    b: Array,
    P: Array,
    q: Array,
    coefs: Array,
    exps: Array,
    lo: Array,
    hi: Array,
    C: Array,
    n_round: int,
    vertices: Array,
    radii: Array,
    R_lo: Array,
    R_hi: Array,
    correction: Array,
    x: Array,
    y: Array,
    gauge: Array,
    residual: Array,
) -> tuple[int, float, float, float, bool]:
    """Solve and check: (CONVERGED, STALLED or INFEASIBLE, violation, value, bound, whether by Newton's method).

    Fills x, y, gauge (k,), residual (m,).

    ``newton``: try the dual Newton method first; correction (k d, m) is the pseudoinverse of the balance; the rest as
    in :func:`interior_point`.
    """
    k, d, all_rows = B.shape
    m, e = b.shape[0], d - 1
    code, g, torque, violation, most = CONVERGED, np.empty(d), np.zeros(all_rows - m), 0.0, 1.0
    if newton:
        z, work = np.zeros((d, k)), np.empty(newton_scratch(d, k) + 2 * d * k)
        heavy, costs = work[-2 * d * k : -d * k].reshape((d, k)), work[-d * k :].reshape((d, k))
        for i in range(k):
            z[e, i] = min(max(2.0 / k, lo[i]), hi[i])
            for j in range(d):
                heavy[j, i], costs[j, i] = P[i, j, j], q[i, j]
        y[:] = 0.0
        code, _ = dual_newton(A[:m], b, costs, heavy, coefs, exps, lo, hi, radii, n_round, z, y, work)
        for i in range(k):
            for j in range(d):
                x[i, j] = z[j, i]
        if code == STALLED:
            newton = False
    if not newton:
        code, _ = interior_point(
            A,
            G,
            used,
            own,
            B,
            touched,
            counts,
            n,
            b,
            P,
            q,
            coefs,
            exps,
            lo,
            hi,
            n_round,
            vertices,
            R_lo,
            R_hi,
            0.0,
            x,
            y,
        )
    for again in range(2):
        for r in range(m):
            t = -b[r]
            for i in range(k):
                for j in range(d):
                    t += B[i, j, r] * x[i, j]
            residual[r] = t
        if again or (residual * residual).sum() <= 1e-26:
            break
        for i in range(k):
            for j in range(d):
                for r in range(m):
                    x[i, j] -= correction[i * d + j, r] * residual[r]
    for i in range(k):
        F = x[i, e]
        most, length = max(most, F), 0.0
        for j in range(n_round):
            length += x[i, j] * x[i, j]
        length = np.sqrt(length)
        for a in range(C.shape[0]):
            t = 0.0
            for j in range(e):
                t -= C[a, j] * x[i, j]
            length = max(length, t)
        gauge[i] = length
        violation = max(violation, max(length - F, max(lo[i] - F, F - hi[i])))
        for h in range(m, counts[i, 1]):
            for j in range(d):
                torque[touched[i, h] - m] += B[i, j, touched[i, h]] * x[i, j]
    for r in range(all_rows - m):
        violation = max(violation, max(torque[r] - R_hi[r], R_lo[r] - torque[r]))
    if violation > _SHARP * most:
        code = STALLED
    bound, value = bound_of(y, x, B, touched, counts, b, P, q, coefs, exps, lo, hi, n_round, vertices, R_lo, R_hi, g)
    return code, violation, value, bound, newton


@jit(**FLAGS)
def _part(packed: NDArray[_Scalar], start: int, shape: tuple[int, ...]) -> tuple[NDArray[_Scalar], int]:
    """The array of this shape that begins at ``start``, and where the next one does."""
    size = 1
    for n in shape:
        size *= n
    return packed[start : start + size].reshape(shape), start + size


@jit(**FLAGS)
def solve_one(
    sizes: IntArray, numbers: Array, at: Array, load: Array, out: Array, active: BoolArray
) -> tuple[int, bool, float, float, float, float, float, float, float, float, float]:
    """One force problem, from its load (6,) [N, N m] to everything that its record holds.

    It has few arguments, because passing an array from Python costs as much time as a contact. sizes, numbers: the
    grasp, as :class:`pinograsp.forces.template.Template` packs it; at: limits and energy, as
    :class:`~pinograsp.forces.compiled.Prepared` packs them. Fills out (6 + 4 k,): residual, contact forces (k, 3),
    torsion (k,); and active (3 k + r,): at friction, least and largest F_n, torque rows. Returns, dimensionless,
    (CONVERGED or STALLED, whether by Newton's method, violation, largest F_n, objective, bound, constant of the
    objective, residual force, residual moment) and what forces [N] and the objective were divided by.
    """
    k, d, m, all_rows, n, n_round = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5]
    padded, facets, limited, corners, e = sizes[6], sizes[7], sizes[8], sizes[9], sizes[1] - 1
    used, i = _part(sizes, 10, (limited, d))
    own, i = _part(sizes, i, (limited - facets - 1, k))
    touched, i = _part(sizes, i, (k, all_rows))
    counts, i = _part(sizes, i, (k, 2))
    constant, largest, arm, near = numbers[0], numbers[1], numbers[2], numbers[3]
    A, i = _part(numbers, 4, (padded, d * k))
    limits, i = _part(numbers, i, (limited, d, k))
    B, i = _part(numbers, i, (k, d, all_rows))
    P0, i = _part(numbers, i, (k, d, d))
    q0, i = _part(numbers, i, (k, d))
    C, i = _part(numbers, i, (facets, d))
    vertices, i = _part(numbers, i, (corners, 2))
    radii, i = _part(numbers, i, (e,))
    R_lo0, i = _part(numbers, i, (all_rows - m,))
    R_hi0, i = _part(numbers, i, (all_rows - m,))
    correction, i = _part(numbers, i, (k * d, m))
    widths, i = _part(numbers, i, (k, d))
    G, i = _part(numbers, i, (6, 3 * k))
    normals, i = _part(numbers, i, (k, 3))
    newton = at[0] != 0.0
    least, i = _part(at, 1, (k,))
    greatest, i = _part(at, i, (k,))
    terms, i = _part(at, i, ((at.shape[0] - i) // 2, 2))
    wrench, i = _part(out, 0, (6,))
    forces, i = _part(out, i, (k, 3))
    torsion, i = _part(out, i, (k,))
    failed = (STALLED, False, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    scale = 0.0
    b = np.empty(m)
    for r in range(m):
        b[r] = -load[r] if r < 3 else -load[r] / arm
        scale += b[r] * b[r]
    scale = np.sqrt(scale)
    if scale == 0.0:
        scale = least.max()
    lo, hi = np.empty(k), np.empty(k)
    for i in range(k):
        lo[i], hi[i] = least[i] / scale, greatest[i] / scale
        if not hi[i] - lo[i] > 1e-9 * hi[i]:
            return failed
    b /= scale
    unit = 0.5 * largest * scale * scale
    for a in range(terms.shape[0]):
        unit = max(unit, terms[a, 0] * scale ** terms[a, 1])
    if unit <= 0.0:
        unit = 1.0
    coefs, exps = powers_of(terms, scale, unit)
    P, q = P0 * (scale * scale / unit), q0 * (scale / unit)
    R_lo, R_hi = R_lo0 / scale, R_hi0 / scale
    constant = constant / unit
    x, y, gauge, residual = np.empty((k, d)), np.empty(all_rows), np.empty(k), np.empty(m)
    code, violation, value, bound, newton = answer(
        newton,
        A,
        limits,
        used,
        own,
        B,
        touched,
        counts,
        n,
        b,
        P,
        q,
        coefs,
        exps,
        lo,
        hi,
        C,
        n_round,
        vertices,
        radii,
        R_lo,
        R_hi,
        correction,
        x,
        y,
        gauge,
        residual,
    )
    if code != CONVERGED:
        return failed
    most = 0.0
    for i in range(k):
        most = max(most, x[i, e])
    for r in range(6):
        wrench[r] = load[r]
    for i in range(k):
        F = x[i, e]
        active[i] = gauge[i] >= F * (1.0 - near)
        active[k + i] = lo[i] * (1.0 + near) >= F
        active[2 * k + i] = hi[i] * (1.0 - near) <= F
        forces[i, 0], forces[i, 1], forces[i, 2] = (
            x[i, 0] * scale * widths[i, 0],
            x[i, 1] * scale * widths[i, 1],
            F * scale,
        )
        torsion[i] = 0.0
        if d == 4:
            torsion[i] = x[i, 2] * scale * widths[i, 2]
            for c in range(3):
                wrench[3 + c] += torsion[i] * normals[i, c]
        for r in range(6):
            for j in range(3):
                wrench[r] += G[r, 3 * i + j] * forces[i, j]
    for r in range(all_rows - m):
        t = 0.0
        for i in range(k):
            for j in range(d):
                t += B[i, j, m + r] * x[i, j]
        active[3 * k + r] = t >= R_hi[r] - near or t <= R_lo[r] + near
    force, moment = 0.0, 0.0
    for r in range(m):
        if r < 3:
            force += residual[r] * residual[r]
        else:
            moment += residual[r] * residual[r]
    return code, newton, violation, most, value, bound, constant, np.sqrt(force), np.sqrt(moment), scale, unit


# -- batches, and one problem tick by tick ----------------------------------------------------------------------------


@jit(**FLAGS)
def _columns(points: Array, rotations: Array, mu: Array, torsion: float, arm: float, A: Array, widths: Array) -> None:
    """Balance A (m, d k) by component from contact points (k, 3) about the centre of mass and frames (k, 3, 3), moments
    over ``arm``; widths (d, k): the unit of each component [N, N m per newton at the friction limit].
    """
    m, k, d = A.shape[0], points.shape[0], widths.shape[0]
    e = d - 1
    for i in range(k):
        widths[0, i], widths[1, i], widths[e, i] = mu[i], mu[i], 1.0
        if d == 4:
            widths[2, i] = torsion
        for j in range(3):
            at = (e if j == 2 else j) * k + i
            size = 1.0 if j == 2 else mu[i]
            u, v, w = size * rotations[i, 0, j], size * rotations[i, 1, j], size * rotations[i, 2, j]
            A[0, at], A[1, at], A[2, at] = u, v, w
            if m == 6:
                x, y, z = points[i, 0] / arm, points[i, 1] / arm, points[i, 2] / arm
                A[3, at], A[4, at], A[5, at] = y * w - z * v, z * u - x * w, x * v - y * u
        if d == 4:
            for r in range(m):
                A[r, 2 * k + i] = rotations[i, r - 3, 2] * torsion / arm if r >= 3 else 0.0


@jit(**FLAGS)
def _judge(A: Array, b: Array, lo: Array, hi: Array, radii: Array, n_round: int, x: Array) -> tuple[float, float]:
    """Norm of A x - b and the largest violation of friction and bounds on F_n."""
    m, (d, k) = A.shape[0], x.shape
    e, violation, off = d - 1, 0.0, 0.0
    for i in range(k):
        F, t = x[e, i], 0.0
        for j in range(n_round):
            t += x[j, i] * x[j, i]
        t = np.sqrt(t)
        for j in range(n_round, e):
            t = max(t, abs(x[j, i]) / radii[j])
        violation = max(violation, max(t - F, max(lo[i] - F, F - hi[i])))
    for r in range(m):
        t = -b[r]
        for i in range(k):
            for j in range(d):
                t += A[r, j * k + i] * x[j, i]
        off += t * t
    return np.sqrt(off), violation


@jit(**FLAGS)
def _solve_part(
    points: Array,
    rotations: Array,
    load: Array,
    mu: Array,
    torsion: float,
    low: Array,
    high: Array,
    arm: float,
    m: int,
    squares: float,
    terms: Array,
    radii: Array,
    n_round: int,
    forces: Array,
    moments: Array,
    answers: Array,
) -> int:
    """One problem of :func:`solve_many`; its code."""
    k, d = points.shape[0], radii.shape[0] + 1
    e, n = d - 1, d * k
    room = np.empty((m + 6) * n + 3 * k + newton_scratch(d, k))
    A, at = room[: m * n].reshape((m, n)), m * n
    widths = room[at : at + n].reshape((d, k))
    P = room[at + n : at + 2 * n].reshape((d, k))
    q = room[at + 2 * n : at + 3 * n].reshape((d, k))
    x = room[at + 3 * n : at + 4 * n].reshape((d, k))
    at += 4 * n
    lo, hi, work = room[at : at + k], room[at + k : at + 2 * k], room[at + 2 * k :]
    b, y, scale = np.empty(m), np.zeros(m), 0.0
    for r in range(m):
        b[r] = -load[r] if r < 3 else -load[r] / arm
        scale += b[r] * b[r]
    scale = np.sqrt(scale)
    if scale == 0.0:
        scale = low[0] if low[0] > 0.0 else 1.0
    _columns(points, rotations, mu, torsion, arm, A, widths)
    unit, heaviest = 0.0, 0.0
    for i in range(k):
        for j in range(d):
            size = widths[j, i] if j < 2 or j == e else widths[j, i] / arm
            P[j, i], q[j, i] = 2.0 * squares * size * size, 0.0
            heaviest = max(heaviest, P[j, i])
        lo[i], hi[i] = low[i] / scale, high[i] / scale
        if not lo[i] <= hi[i]:
            return INFEASIBLE
        x[:, i], x[e, i] = 0.0, min(max(2.0 / k, lo[i]), hi[i])
    unit = 0.5 * heaviest * scale * scale
    for a in range(terms.shape[0]):
        unit = max(unit, terms[a, 0] * scale ** terms[a, 1])
    for i in range(k):
        for j in range(d):
            P[j, i] *= scale * scale / unit
    b /= scale
    coefs, exps = powers_of(terms, scale, unit)
    code, _steps = dual_newton(A, b, q, P, coefs, exps, lo, hi, radii, n_round, x, y, work)
    if code == CONVERGED:
        value, bound = _gap(A, b, q, P, coefs, exps, lo, hi, radii, n_round, x, y, work)
        off, violation = _judge(A, b, lo, hi, radii, n_round, x)
        # A bound from multipliers that are exact to rounding can exceed the value by rounding.
        answers[0], answers[1] = value * unit, min(bound, value) * unit
        answers[2], answers[3] = off * scale, max(violation, 0.0) * scale
        # Negated, so that NaN fails.
        if not (off <= 1e-10 and violation <= 1e-10 and value - bound <= 1e-8 * max(abs(value), 1e-5)):
            code = STALLED
    if code == CONVERGED:
        for i in range(k):
            forces[i, 0], forces[i, 1], forces[i, 2] = x[0, i] * scale * mu[i], x[1, i] * scale * mu[i], x[e, i] * scale
            moments[i] = x[2, i] * scale * torsion if d == 4 else 0.0
    return code


@jit(**UNLOCKED)
def solve_many(
    start: int,
    stop: int,
    points: Array,
    rotations: Array,
    counts: IntArray,
    loads: Array,
    mu: Array,
    torsion: float,
    low: Array,
    high: Array,
    arms: Array,
    m: int,
    squares: float,
    terms: Array,
    radii: Array,
    n_round: int,
    forces: Array,
    moments: Array,
    answers: Array,
    codes: IntArray,
) -> None:
    """Problems ``start`` to ``stop`` of N, without Python's lock: the first counts[p] contacts of each, points about
    the centres of mass, mu divided by the safety factor.

    The objective: ``squares`` times the sum of squared forces, and terms (N, t, 2), powers of F_n. Fills forces (N, k,
    3), moments (N, k), answers (N, 4: objective, bound, residual [N], violation [N]) and codes (N,).
    """
    for p in range(start, stop):
        k = counts[p]
        codes[p] = _solve_part(
            points[p, :k],
            rotations[p, :k],
            loads[p],
            mu[p, :k],
            torsion,
            low[p, :k],
            high[p, :k],
            arms[p],
            m,
            squares,
            terms[p],
            radii,
            n_round,
            forces[p],
            moments[p],
            answers[p],
        )


@jit(**FLAGS)
def _not_finite(values: Array) -> bool:
    for v in values.ravel():
        if not abs(v) < 1e12:
            return True
    return False


@jit(**FLAGS)
def online(memory: Array, jacobian: Array, gravity: Array, chains: IntArray) -> tuple[int, int, float]:
    """One tick of :class:`pinograsp.motion.OnlineForces`: (code, Newton steps, norm of the unbalanced load [N]).

    memory, see :func:`online_memory`; jacobian (6 columns,): of the joints, column by column, world axes, linear
    velocity at the world's origin first; gravity (n,); chains: their length 3 p, then contacts, each with a joint's
    column and degree of freedom (3 p), then, where torques have limits, what :func:`_within_torques` takes. The arrays
    are few and flat, since passing one from Python costs a tenth of a microsecond.

    The objective is the sum of squares of F_n and of tangential forces; a torsional moment counts as the tangential
    force that uses as much friction. CONVERGED: balanced; INFEASIBLE: the closest forces; STALLED: the closest forces
    found within the steps; -1: an input is not finite or a friction coefficient is negative, and nothing has changed.
    """
    settings, n, com, wrench = memory[:12], len(gravity), memory[8:11], memory[12:18]
    k, m, n_round, torsion, arm, safety = (
        int(settings[11]),
        int(settings[0]),
        int(settings[1]),
        settings[2] / settings[4],
        settings[3],
        settings[4],
    )
    frames, limits = memory[18 : 18 + 13 * k].reshape((k, 13)), memory[18 + 13 * k : 18 + 17 * k].reshape((4, k))
    limit, state = memory[18 + 17 * k :][:n], memory[24 + 21 * k + 2 * n :]
    out = memory[18 + 17 * k + n : 24 + 21 * k + 2 * n]
    d, most = 4 if torsion > 0.0 else 3, int(settings[5])
    e, n = d - 1, d * k
    if _not_finite(wrench) or _not_finite(frames) or _not_finite(gravity) or frames[:, 12].min() < 0.0:
        return -1, 0, 0.0
    points, rotations = np.ascontiguousarray(frames[:, :3]), np.ascontiguousarray(frames[:, 3:12]).reshape((k, 3, 3))
    forces, torques = out[: 3 * k].reshape((k, 3)), out[4 * k + 6 :]
    room = state[6:]
    A, at = room[: m * n].reshape((m, n)), m * n
    widths = room[at : at + n].reshape((d, k))
    w = room[at + n : at + 2 * n].reshape((d, k))
    q = room[at + 2 * n : at + 3 * n].reshape((d, k))
    x = room[at + 3 * n : at + 4 * n].reshape((d, k))
    at += 4 * n
    lo, hi, mu = room[at : at + k], room[at + k : at + 2 * k], room[at + 2 * k : at + 3 * k]
    b = room[at + 3 * k :][:m]
    y = room[at + 3 * k + 6 :][:m]
    radii = room[at + 3 * k + 12 :][:e]
    work = room[at + 3 * k + 15 :]
    scale = 1e-9
    for r in range(m):
        b[r] = -wrench[r] if r < 3 else -wrench[r] / arm
        scale = max(scale, abs(b[r]))
    for i in range(k):
        # Contacts are gained and lost gradually, and no force changes by more than its limit per tick.
        limits[2, i] += min(max(limits[3, i] - limits[2, i], -settings[7]), settings[7])
        least, largest, F = limits[0, i] * limits[2, i], limits[1, i] * limits[2, i], forces[i, 2]
        lo[i] = min(max(least, F - settings[6]), largest)
        hi[i] = max(min(largest, F + settings[6]), lo[i])
        mu[i] = frames[i, 12] / safety
        scale = max(scale, lo[i])
    _columns(points, rotations, mu, torsion, arm, A, widths)
    for j in range(e):
        radii[j] = np.sqrt(0.5) if n_round == 0 and j < 2 else 1.0
    for i in range(k):
        lo[i], hi[i] = lo[i] / scale, hi[i] / scale
        for j in range(d):
            # Without friction the tangential components are zero: any weight will do.
            w[j, i], q[j, i] = 1.0 if j == e else max(mu[i] * mu[i], 1e-6), 0.0
    b /= scale
    y[:] = state[:m] / scale
    code, steps = _ascend(A, b, q, w, lo, hi, radii, n_round, 0.0, x, y, _BALANCED, most, work)
    if code == STALLED:  # a second attempt, from zero
        y[:] = 0.0
        code, used = _ascend(A, b, q, w, lo, hi, radii, n_round, 0.0, x, y, _BALANCED, most, work)
        steps += used
    state[:m] = y * scale if code == CONVERGED else 0.0 * y
    if code != CONVERGED:
        code, used = _closest(A, b, w, lo, hi, radii, n_round, x, y, q, most, work)
        steps += used
    off = _write_out(
        x, A, b, lo, hi, radii, n_round, scale, widths, points, rotations, com, wrench, jacobian, gravity, chains, out
    )
    beyond = False
    for j in range(len(limit) if len(chains) > 1 + chains[0] else 0):
        beyond = beyond or abs(torques[j]) > limit[j]
    if beyond:
        # The dual has no closed form for torque rows: the interior-point method takes them.
        code, used = _within_torques(
            A, b, w, lo, hi, radii, n_round, scale, widths, points, rotations, com, jacobian, gravity, limit, chains, x
        )
        steps += used
        off = _write_out(
            x,
            A,
            b,
            lo,
            hi,
            radii,
            n_round,
            scale,
            widths,
            points,
            rotations,
            com,
            wrench,
            jacobian,
            gravity,
            chains,
            out,
        )
        for j in range(len(limit)):
            if code == CONVERGED and abs(torques[j]) > limit[j] * (1.0 + 1e-7):
                code = INFEASIBLE
    return code, steps, off * scale


@jit(**NEWTON)
def _closest(
    A: Array,
    b: Array,
    w: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    x: Array,
    y: Array,
    q: Array,
    most: int,
    work: Array,
) -> tuple[int, int]:
    """The least |A x - b| of all admissible x (d, k): INFEASIBLE where it is proven, else STALLED; and Newton steps.

    Proximal passes: the weight w of the forces pulls towards the last answer, so it has no influence on the result, and
    the balance gets stiffer from pass to pass. At the end the multipliers prove that no forces leave less.
    y (m,), q (d, k) and ``work`` are scratch.
    """
    d, k = x.shape
    n = d * k
    flat, V, best = x.reshape(n), work[48 + n : 48 + 2 * n], work[48 + 2 * n + 36 * k : 48 + 3 * n + 36 * k]
    steps, give, nearest = 0, _GIVE, np.inf
    y[:], q[:] = 0.0, 0.0
    for _stage in range(_GIVES):
        _, used = _ascend(A, b, q, w, lo, hi, radii, n_round, give, x, y, 1e-9, most, work)
        steps += used
        off, _ = _judge(A, b, lo, hi, radii, n_round, x)
        _slopes(A, y, V)
        least = _least_along(V.reshape((d, k)), b, y, lo, hi, radii, n_round) / max(np.sqrt((y * y).sum()), 1e-300)
        if off - least <= _CLOSEST * max(off, 1.0):
            return INFEASIBLE if least > _PROVEN else STALLED, steps
        if off < nearest:
            nearest, best[:] = off, flat
        if steps > _GIVES // 2 * most:
            break
        stiffer = max(give * _STIFFEN, _LEAST_GIVE)
        y *= give / stiffer
        give = stiffer
        q[:] = -w * x
    flat[:] = best
    return STALLED, steps


@jit(**FLAGS)
def _write_out(
    x: Array,
    A: Array,
    b: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    scale: float,
    widths: Array,
    points: Array,
    rotations: Array,
    com: Array,
    wrench: Array,
    jacobian: Array,
    gravity: Array,
    chains: IntArray,
    out: Array,
) -> float:
    """Fills ``out`` of :func:`online` from x (d, k), and returns the norm of its balance residual."""
    d, k = x.shape
    e, last = d - 1, 1 + chains[0]
    forces, moments = out[: 3 * k].reshape((k, 3)), out[3 * k : 4 * k]
    unbalanced, torques = out[4 * k : 4 * k + 6], out[4 * k + 6 :]
    off, _ = _judge(A, b, lo, hi, radii, n_round, x)
    for r in range(6):
        unbalanced[r] = wrench[r]
    for j in range(len(torques)):
        torques[j] = gravity[j]
    p = 1
    for i in range(k):
        forces[i, 0], forces[i, 1], forces[i, 2] = (
            x[0, i] * scale * widths[0, i],
            x[1, i] * scale * widths[1, i],
            x[e, i] * scale,
        )
        moments[i] = x[2, i] * scale * widths[2, i] if d == 4 else 0.0
        R = rotations[i]
        f = (
            R[0, 0] * forces[i, 0] + R[0, 1] * forces[i, 1] + R[0, 2] * forces[i, 2],
            R[1, 0] * forces[i, 0] + R[1, 1] * forces[i, 1] + R[1, 2] * forces[i, 2],
            R[2, 0] * forces[i, 0] + R[2, 1] * forces[i, 1] + R[2, 2] * forces[i, 2],
        )
        turn = (R[0, 2] * moments[i], R[1, 2] * moments[i], R[2, 2] * moments[i])
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            unbalanced[r] += f[r]
            unbalanced[3 + r] += turn[r] + points[i, s] * f[t] - points[i, t] * f[s]
        P = (points[i, 0] + com[0], points[i, 1] + com[1], points[i, 2] + com[2])
        a = (
            turn[0] + P[1] * f[2] - P[2] * f[1],
            turn[1] + P[2] * f[0] - P[0] * f[2],
            turn[2] + P[0] * f[1] - P[1] * f[0],
        )
        while p < last and chains[p] == i:
            J = jacobian[6 * chains[p + 1] :][:6]
            t = J[0] * f[0] + J[1] * f[1] + J[2] * f[2]
            torques[chains[p + 2]] += t + J[3] * a[0] + J[4] * a[1] + J[5] * a[2]
            p += 3
    return off


@jit(**FLAGS)
def _within_torques(
    A: Array,
    b: Array,
    w: Array,
    lo: Array,
    hi: Array,
    radii: Array,
    n_round: int,
    scale: float,
    widths: Array,
    points: Array,
    rotations: Array,
    com: Array,
    jacobian: Array,
    gravity: Array,
    limit: Array,
    chains: IntArray,
    x: Array,
) -> tuple[int, int]:
    """Interior points with |gravity + J'f| <= limit (n,); x (d, k) is the result: (code, steps). Where the load cannot
    be held within the limits x becomes the closest forces; where no forces keep the limits x is unchanged.

    ``chains``, after the chains themselves: the number of torque rows, the number of those that several contacts enter,
    and the largest number that one contact has alone; per degree of freedom its row or -1 (n,); own, touched, counts
    and used of :func:`interior_point`.
    """
    m, (d, k), n = A.shape[0], w.shape, len(limit)
    e, facets, last = d - 1, 2 * (d - 1 - n_round), 1 + chains[0]
    rows, shared, alone = chains[last], chains[last + 1], chains[last + 2]
    row_of, at = _part(chains, last + 3, (n,))
    own, at = _part(chains, at, (alone, k))
    touched, at = _part(chains, at, (k, m + rows))
    counts, at = _part(chains, at, (k, 2))
    used, at = _part(chains, at, (facets + 1 + alone, d))
    R, R_lo, R_hi = np.zeros((rows, d, k)), np.empty(rows), np.empty(rows)
    for p in range(1, last, 3):
        i, r = chains[p], row_of[chains[p + 2]]
        J, turn = jacobian[6 * chains[p + 1] :][:6], rotations[i]
        for j in range(d if r >= 0 else 0):
            c = 2 if j == e else j
            u, v, z = widths[j, i] * turn[0, c], widths[j, i] * turn[1, c], widths[j, i] * turn[2, c]
            if j == 2 and d == 4:  # a moment about the normal
                R[r, j, i] += J[3] * u + J[4] * v + J[5] * z
                continue
            f, g, h = points[i, 0] + com[0], points[i, 1] + com[1], points[i, 2] + com[2]
            R[r, j, i] += J[0] * u + J[1] * v + J[2] * z
            R[r, j, i] += J[3] * (g * z - h * v) + J[4] * (h * u - f * z) + J[5] * (f * v - g * u)
    for j in range(n):
        r = row_of[j]
        if r >= 0:
            size = max(np.sqrt((R[r] * R[r]).sum()), 1e-12)
            R[r] /= size
            R_lo[r], R_hi[r] = (-limit[j] - gravity[j]) / (size * scale), (limit[j] - gravity[j]) / (size * scale)
    both = m + shared
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
    vertices = np.empty((0 if n_round else 4, 2))
    for a in range(len(vertices)):
        vertices[a] = (radii[0] if a % 2 else -radii[0], radii[1] if a // 2 else -radii[1])
    P, q, z, y = np.zeros((k, d, d)), np.zeros((k, d)), np.empty((k, d)), np.zeros(m + rows)
    above = np.maximum(hi, lo + 1e-9)
    for i in range(k):
        for j in range(d):
            P[i, j, j] = w[j, i]
    none, coefs = np.ones(1), np.empty(0)
    code, steps = interior_point(
        flat,
        G,
        used,
        own,
        B,
        touched,
        counts,
        both,
        b,
        P,
        q,
        coefs,
        none,
        lo,
        above,
        n_round,
        vertices,
        R_lo,
        R_hi,
        0.0,
        z,
        y,
    )
    proven = False
    give, nearest, best, scratch = _GIVE, np.inf, np.zeros((k, d)), np.empty(d)
    for _ in range(0 if code == CONVERGED else _GIVES // 2):
        done, used_up = interior_point(
            flat,
            G,
            used,
            own,
            B,
            touched,
            counts,
            both,
            b,
            P,
            q,
            coefs,
            none,
            lo,
            above,
            n_round,
            vertices,
            R_lo,
            R_hi,
            give,
            z,
            y,
        )
        steps += used_up
        if done != CONVERGED or _not_finite(z):
            break
        x[:] = z.T
        off, _ = _judge(A, b, lo, hi, radii, n_round, x)
        if off < nearest:
            nearest, best[:] = off, z
        y /= max(np.sqrt((y[:m] * y[:m]).sum()), 1e-300)
        least = excluded(y, B, touched, counts, b, lo, above, n_round, vertices, R_lo, R_hi, scratch)
        proven = nearest - least <= _CLOSEST_WITHIN * max(nearest, 1.0)
        if proven:
            break
        give = max(give * _STIFFEN, _LEAST_GIVE)
        q[:] = -w.T * z
    if code != CONVERGED:
        if nearest == np.inf:
            return code, steps
        z[:], code = best, INFEASIBLE if proven else STALLED
    elif _not_finite(z):
        return STALLED, steps
    for i in range(k):
        F = min(max(z[i, e], lo[i]), hi[i])
        t = 0.0
        for j in range(n_round):
            t += z[i, j] * z[i, j]
        shrink = min(1.0, F / max(np.sqrt(t), 1e-300))
        for j in range(e):
            x[j, i] = z[i, j] * shrink if j < n_round else min(max(z[i, j], -radii[j] * F), radii[j] * F)
        x[e, i] = F
    off, _ = _judge(A, b, lo, hi, radii, n_round, x)
    return STALLED if code == CONVERGED and off > 1e-9 else code, steps


def online_memory(d: int, k: int, n: int) -> tuple[Array, ...]:
    """The memory of :func:`online` (an array), and its parts, which are views of it.

    settings (12,): rows of the balance, round components, torsion [m], arm [m], safety factor, most steps, change of
    F_n [N] and of shares per tick, centre of mass, contacts. wrench (6,): the load. frames (k, 13): contact point about
    the centre of mass, contact frame by rows, mu. limits (4, k): least and largest F_n, share of them that holds now,
    share that it moves to. limit (n,): of torques. out: forces (3 k), torsional moments (k), unbalanced wrench (6),
    torques (n); on entry the last tick's. state: multipliers of the last tick (6) [N], scratch.
    """
    sizes = 12, 6, 13 * k, 4 * k, n, 4 * k + 6 + n, 6 + 10 * d * k + 3 * k + 15 + newton_scratch(d, k)
    memory = np.zeros(sum(sizes))
    settings, wrench, frames, limits, limit, out, state = np.split(memory, np.cumsum(sizes)[:-1])
    return memory, settings, wrench, frames.reshape(k, 13), limits.reshape(4, k), limit, out, state


# -- multipliers at fixed normal forces --------------------------------------------------------------------------------


@jit(**NEWTON)
def box_least_squares(memory: Array) -> bool:
    """Minimise 1/2 |H k + b|^2 + eps/2 |k|^2 over |k| <= 1, in the arrays of :func:`box_memory`; True: converged.

    By Newton's method on the dual, whose unknowns y (m,) are the residual: k_j = -h_j . y / eps clipped to [-1, 1]
    leaves y - H k - b = 0, the gradient of a strongly convex function.
    """
    m, n, inverse = int(memory[0]), int(memory[1]), 1.0 / memory[2]
    load, row, fixed, at = memory[3:9], memory[9 : 9 + m], memory[9 + m : 9 + 2 * m], 9 + 2 * m
    H, k = memory[at : at + m * n].reshape((m, n)), memory[at + m * n : at + m * n + n]
    work = memory[at + m * n + n :]
    g, d, b, y, S, V = (
        work[:m],
        work[6 : 6 + m],
        work[12 : 12 + m],
        work[18 : 18 + m],
        work[24 : 24 + n],
        work[24 + n : 24 + 2 * n],
    )
    M = work[24 + 2 * n :][: m * m].reshape((m, m))
    largest = 0.0
    for r in range(m):
        b[r], y[r] = fixed[r] + load[r] * row[r], 0.0
        if not abs(b[r]) < 1e12:
            return False
        largest = max(largest, abs(b[r]))
    for j in range(n):
        S[j] = 0.0
    for _ in range(_BOX_STEPS):
        size, start, rest = 0.0, 0.0, 0.0
        for r in range(m):
            g[r] = y[r] - b[r]
            for c in range(r + 1, m):
                M[r, c] = 0.0
            M[r, r] = 1.0
        for j in range(n):
            t = min(max(-S[j] * inverse, -1.0), 1.0)
            k[j] = t
            for r in range(m):
                g[r] -= H[r, j] * t
            if abs(t) < 1.0:
                for r in range(m):
                    for c in range(r, m):
                        M[r, c] += inverse * H[r, j] * H[c, j]
        for r in range(m):
            size = max(size, abs(g[r]))
        if size <= 1e-12 * (1.0 + largest):
            return True
        for r in range(m):
            d[r] = g[r]
        _factor(M)
        _solve(M, d)
        along, square = 0.0, 0.0
        for r in range(m):
            along += (y[r] - b[r]) * d[r]
            square += d[r] * d[r]
            start += g[r] * d[r]
        for j in range(n):
            t = 0.0
            for r in range(m):
                t += H[r, j] * d[r]
            V[j] = t
        # The derivative along -d falls from `start`: its root (regula falsi, Illinois).
        below, above, at_below, at_above, t, side = 0.0, -1.0, start, 0.0, 1.0, 0
        for _search in range(60):
            rest = along - t * square
            for j in range(n):
                rest -= V[j] * min(max(-(S[j] - t * V[j]) * inverse, -1.0), 1.0)
            if abs(rest) <= 0.1 * start:
                break
            if rest < 0.0:
                above, at_above = t, rest
                if side < 0:
                    at_below *= 0.5
                side = -1
            else:
                below, at_below = t, rest
                if side > 0:
                    at_above *= 0.5
                side = 1
            t = 4.0 * t if above < 0.0 else below + at_below * (above - below) / (at_below - at_above)
        for r in range(m):
            y[r] -= t * d[r]
        for j in range(n):
            S[j] -= t * V[j]
    return False


def box_memory(m: int, n: int) -> tuple[Array, ...]:
    """The memory of :func:`box_least_squares` (an array), and its parts, which are views of it.

    sizes (3,): m, n, eps. load (6,), row (m,), fixed (m,): b = fixed + row * load[:m]. H (m, n). k (n,): the result.
    """
    sizes = 3, 6, m, m, m * n, n, 60 + 2 * n
    memory = np.zeros(sum(sizes))
    settings, load, row, fixed, H, k, _ = np.split(memory, np.cumsum(sizes)[:-1])
    settings[:2] = m, n
    return memory, settings, load, row, fixed, H.reshape(m, n), k
