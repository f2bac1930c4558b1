r"""Everything that is compiled (extra ``fast``): two solvers made for grasp forces and the checks of their answers.

In one file, because numba's cache on disk notices changes of a function's own file only.

**Dual Newton.** The balance has m <= 6 rows, everything else concerns one contact at a time. With multipliers y of
A x = b the Lagrangian therefore separates,

    D(y) = -b . y + sum_i min_{x_i} [ phi(F_i) + 1/2 x_i' p_i x_i + (q_i + A_i' y) . x_i ],   u_i in F_i U,  lo <= F_i <= hi,

and the dual is concave in m unknowns. Each inner problem has a closed form up to one monotone scalar equation: with
c = q + A' y, a tangential component (or a round pair of them) is u = -c_t / w clipped to F r, w its quadratic weight, so
F solves

    phi'(F) + p_n F + c_n - sum_t r max(0, |c_t| - w r F) = 0,   clipped to [lo, hi].

The gradient of D is A x(y) - b. A generalised Hessian follows by differentiating x(y): per contact (v v') / g'(F) along the
edge or ray v that a saturated force moves on, 1 / w for what is not saturated, and F / |c_t| (I - c c') around a cone
(Qi and Sun 1993; the same idea as in SSNAL, Li, Sun and Toh 2018). The cost of a step grows linearly with the contacts.
The line search is exact: the directional derivative is monotone. Where the objective has no quadratic weight in some
direction a proximal one is added that pulls towards the last answer, and falls from pass to pass until the duality gap is
closed (Rockafellar 1976). Answers are certified like any other's.

**Interior points** take every :class:`~pinograsp.forces.program.Program` whose objective couples no two contacts:
polyhedral and second-order friction cones, bounds on F_n, powers of F_n (Eqs. 9 and 11), quadratic terms and torque rows. The iterates stay
inside the cones and bounds, so that these need no slack variables; balance and torque rows are met in the limit. With
B = [A; R], multipliers l = [y; w] and per contact the Hessian H_i of the objective and of the barriers, a Newton step solves

    [ H  B' ] [dx]   [ -stationarity + centring ]
    [ B  -E ] [dl] = [ -rows                    ],     H block diagonal with blocks (d, d), E = diag(0, s/w),

by the Schur complement B H^-1 B' + E: six unknowns and one for each torque row, whatever the number of contacts, so the
cost of a step grows linearly with them. A contact enters only the rows that it touches (the balance, its finger's joints).
Steps are Mehrotra's predictor and corrector (1992), second-order cones scaled by Nesterov and Todd's point (1997; formulas as
in Vandenberghe 2010). In infeasible programs the multipliers grow along a Farkas certificate, which is tested as they grow.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FLAGS = {"cache": True, "fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy"}
CONVERGED, STALLED, INFEASIBLE = 0, 1, 2
# Dual Newton.
_PASSES = 40
_LEAST_WEIGHT = 3e-3  # below, nearly linear objectives (the impulse) cost Newton more steps than they save passes
_FIRST_WEIGHT = 0.1  # first proximal weight, against an objective of order one
_SHRINK = 0.3  # from pass to pass: smaller steps the Newton method hardly, larger ones cost passes
_NEWTON_GAP = 1e-7
_BALANCED = 1e-12  # residual of the balance, of the load
# Interior points.
_STEPS = 60
_INTERIOR_GAP = 1e-9  # of the objective, where the certificate ends the search
_CLOSED = 1e-7  # where it may end because rounding stops its progress
_ROWS = 1e-9  # residual of balance and torque rows, of the load
_TO_BOUNDARY = 0.995
_CENTRE = 0.3  # first product of slack and multiplier, of the objective, times the contacts
_GROWN = 30.0  # multipliers beyond this share of the objective's size are tried as a certificate
_PROVEN = 1e-9  # margin of a certificate, of the load
_SHARP = 1e-9  # of the load or the largest F_n: answers that miss a limit by more are left to the general methods


# -- dual Newton ------------------------------------------------------------------------------------------------------


@njit(**FLAGS)
def _inner(c, F, lo, hi, coefs, exps, w, radii, n_round, x):
    """Minimiser x (d,) over one contact's cone for linear costs c (d,); returns g'(F), or 0 where F is at a bound.

    F is the starting guess.
    """
    e = c.shape[0] - 1
    round_ = 0.0
    for j in range(n_round):
        round_ += c[j] * c[j]
    round_ = np.sqrt(round_)
    low, high = lo, hi
    F = min(max(F, lo), hi)
    slope = 0.0
    inside = False
    for it in range(60):
        g = c[e] + w[e] * F
        slope = w[e]
        if coefs.shape[0] > 0:
            # The exponents are 1 + j / rho (Eqs. 9 and 11), so one power serves all of them.
            root = F**exps[0]
            for a in range(coefs.shape[0]):
                power = coefs[a]
                for _ in range(int(exps[1 + a])):
                    power *= root
                g += power
                slope += exps[1 + a] * exps[0] * power / F
        if n_round > 0 and round_ > w[0] * F:
            g -= round_ - w[0] * F
            slope += w[0]
        for j in range(n_round, e):
            r = radii[j]
            over = abs(c[j]) - w[j] * r * F
            if over > 0:
                g -= r * over
                slope += w[j] * r * r
        if g > 0:
            high = F
        else:
            low = F
        if (g >= 0 and F <= lo) or (g <= 0 and F >= hi):
            inside = False
            break
        inside = True
        step = g / slope if slope > 0 else np.inf
        new = F - step
        if not (new > low and new < high):
            if new <= lo and low == lo and it < 3:
                new = lo
            elif new >= hi and high == hi and it < 3:
                new = hi
            else:
                new = 0.5 * (low + high)
        if abs(new - F) <= 1e-12 * abs(F):
            F = new
            break
        F = new
    x[e] = F
    if n_round > 0:
        shrink = 1.0 / w[0] if round_ <= w[0] * F else F / round_
        for j in range(n_round):
            x[j] = -c[j] * shrink
    for j in range(n_round, e):
        reach = radii[j] * F
        x[j] = min(max(-c[j] / w[j], -reach), reach)
    return slope if inside else 0.0


@njit(**FLAGS)
def _evaluate(y, AT, b, q, lo, hi, coefs, exps, w, radii, n_round, c, x, slopes, residual):
    """x(y), costs c and the residual A x - b; all outputs are preallocated."""
    k, d, m = AT.shape
    for r in range(m):
        residual[r] = -b[r]
    for i in range(k):
        for j in range(d):
            total = q[i, j]
            for r in range(m):
                total += AT[i, j, r] * y[r]
            c[i, j] = total
        slopes[i] = _inner(c[i], x[i, d - 1], lo[i], hi[i], coefs, exps, w[i], radii, n_round, x[i])
        for j in range(d):
            for r in range(m):
                residual[r] += AT[i, j, r] * x[i, j]


@njit(**FLAGS)
def _hessian(AT, c, x, slopes, w, radii, n_round, H, v):
    """Generalised Hessian (m, m) of -D."""
    k, d, m = AT.shape
    e = d - 1
    H[:] = 0.0
    for i in range(k):
        F = x[i, e]
        for r in range(m):
            v[r] = AT[i, e, r]
        if n_round > 0:
            length = 0.0
            for j in range(n_round):
                length += c[i, j] * c[i, j]
            length = np.sqrt(length)
            saturated = length > w[i, 0] * F
            around = F / length if saturated else 1.0 / w[i, 0]
            for j in range(n_round):
                for r in range(m):
                    t = AT[i, j, r] * around
                    for s in range(r + 1):
                        H[r, s] += t * AT[i, j, s]
            if saturated:
                # Less the radial part: along it the force stays on the cone.
                for r in range(m):
                    radial = 0.0
                    for j in range(n_round):
                        radial += AT[i, j, r] * c[i, j] / length
                    v[r] -= radial
                for r in range(m):
                    t = (AT[i, e, r] - v[r]) * around
                    for s in range(r + 1):
                        H[r, s] -= t * (AT[i, e, s] - v[s])
        for j in range(n_round, e):
            if abs(c[i, j]) > w[i, j] * radii[j] * F:
                sign = radii[j] if c[i, j] > 0 else -radii[j]
                for r in range(m):
                    v[r] -= sign * AT[i, j, r]
            else:
                for r in range(m):
                    t = AT[i, j, r] / w[i, j]
                    for s in range(r + 1):
                        H[r, s] += t * AT[i, j, s]
        if slopes[i] > 0:
            for r in range(m):
                t = v[r] / slopes[i]
                for s in range(r + 1):
                    H[r, s] += t * v[s]


@njit(**FLAGS)
def _solve_spd(H, g, step):
    """Cholesky of the lower triangle of H (in place, pivots floored) and step = H^-1 g."""
    m = g.shape[0]
    largest = 0.0
    for r in range(m):
        largest = max(largest, H[r, r])
    floor = 1e-14 * largest + 1e-300
    for r in range(m):
        pivot = H[r, r] + floor
        for s in range(r):
            pivot -= H[r, s] * H[r, s]
        pivot = np.sqrt(max(pivot, floor))
        H[r, r] = pivot
        for i in range(r + 1, m):
            t = H[i, r]
            for s in range(r):
                t -= H[i, s] * H[r, s]
            H[i, r] = t / pivot
    for r in range(m):
        t = g[r]
        for s in range(r):
            t -= H[r, s] * step[s]
        step[r] = t / H[r, r]
    for r in range(m - 1, -1, -1):
        t = step[r]
        for s in range(r + 1, m):
            t -= H[s, r] * step[s]
        step[r] = t / H[r, r]


@njit(**FLAGS)
def _newton(y, AT, b, q, lo, hi, coefs, exps, w, radii, n_round, x, tolerance, steps):
    """Maximise D from y (in place); returns the number of evaluations, negative where it does not converge."""
    k, d, m = AT.shape
    c, slopes = np.empty((k, d)), np.empty(k)
    residual, trial = np.empty(m), np.empty(m)
    H, step, v = np.empty((m, m)), np.empty(m), np.empty(m)
    _evaluate(y, AT, b, q, lo, hi, coefs, exps, w, radii, n_round, c, x, slopes, residual)
    evaluations = 1
    for it in range(steps):
        size = 0.0
        for r in range(m):
            size = max(size, abs(residual[r]))
        if size <= tolerance:
            return evaluations
        _hessian(AT, c, x, slopes, w, radii, n_round, H, v)
        _solve_spd(H, residual, step)
        start = 0.0
        for r in range(m):
            start += residual[r] * step[r]
        if not start > 0:
            return -evaluations
        # The derivative along the step, residual(y + t step) . step, falls from `start`: find its root.
        below, above, at_below, at_above = 0.0, np.inf, start, 0.0
        t = 1.0
        for search in range(40):
            for r in range(m):
                trial[r] = y[r] + t * step[r]
            _evaluate(trial, AT, b, q, lo, hi, coefs, exps, w, radii, n_round, c, x, slopes, residual)
            evaluations += 1
            along = 0.0
            for r in range(m):
                along += residual[r] * step[r]
            if abs(along) <= 0.1 * start:
                break
            if along > 0:
                below, at_below = t, along
            else:
                above, at_above = t, along
            if above == np.inf:
                t *= 4.0 if search < 3 else 16.0
                if t > 1e12:
                    return -evaluations  # D grows without end: infeasible
            else:
                t = below + (above - below) * min(max(at_below / (at_below - at_above), 0.1), 0.9)
                if above - below <= 1e-15 * above:
                    break
        for r in range(m):
            y[r] = trial[r]
    return -evaluations


@njit(**FLAGS)
def _gap(y, AT, q, p, lo, hi, coefs, exps, radii, n_round, x):
    """Duality gap of x and y in the problem without proximal weights, and the size of the objective."""
    k, d, m = AT.shape
    e = d - 1
    gap, value = 0.0, 0.0
    g = np.empty(d)
    for i in range(k):
        F = x[i, e]
        for j in range(d):
            total = q[i, j] + p[i, j] * x[i, j]
            value += (q[i, j] + 0.5 * p[i, j] * x[i, j]) * x[i, j]
            for r in range(m):
                total += AT[i, j, r] * y[r]
            g[j] = total
        for a in range(coefs.shape[0]):
            power = coefs[a] * F ** (exps[0] * exps[1 + a])
            g[e] += power
            value += power * F / (1.0 + exps[0] * exps[1 + a])
        s = g[e]
        round_ = 0.0
        for j in range(n_round):
            round_ += g[j] * g[j]
            gap += g[j] * x[i, j]
        s -= np.sqrt(round_)
        for j in range(n_round, e):
            s -= radii[j] * abs(g[j])
            gap += g[j] * x[i, j]
        gap += g[e] * F - min(lo[i] * s, hi[i] * s)
    return gap, abs(value)


@njit(**FLAGS)
def dual_newton(y, AT, b, q, p, lo, hi, coefs, exps, radii, n_round, weight, x):
    """Proximal passes until the duality gap closes; y and x are start and result. Evaluations, negative on failure.

    Shapes: y (m,), AT (k, d, m), b (m,), q and p (k, d), lo and hi (k,), radii (d - 1,), x (k, d). phi' is the sum of
    coefs[a] F^(exps[0] exps[1 + a]) with coefs (a,) and exps (1 + a,), the latter whole numbers from the second on.
    ``weight`` 0: the objective is strongly convex by itself.
    """
    k, d, m = AT.shape
    w, shifted = np.empty((k, d)), np.empty((k, d))
    total = 0
    for stage in range(_PASSES if weight > 0 else 1):
        for i in range(k):
            for j in range(d):
                w[i, j] = p[i, j] + weight
                shifted[i, j] = q[i, j] - weight * x[i, j]
        used = _newton(y, AT, b, shifted, lo, hi, coefs, exps, w, radii, n_round, x, _BALANCED, 60)
        total += abs(used)
        if used < 0:
            return -total
        gap, size = _gap(y, AT, q, p, lo, hi, coefs, exps, radii, n_round, x)
        if gap <= _NEWTON_GAP * max(size, 1e-12):
            return total
        weight = max(weight * _SHRINK, _LEAST_WEIGHT)
    return total


# -- interior points --------------------------------------------------------------------------------------------------


@njit(**FLAGS)
def phi(F, coefs, exps):
    """phi, phi' and phi'' at F > 0; see :func:`interior_point` for the powers."""
    value, first, second = 0.0, 0.0, 0.0
    if coefs.shape[0] > 0:
        root = F ** exps[0]
        for a in range(coefs.shape[0]):
            power, exponent = coefs[a], exps[0] * exps[1 + a]
            for _ in range(int(exps[1 + a])):
                power *= root
            value += power / (1.0 + exponent)
            first += power
            second += exponent * power
    return value * F, first, second / F


@njit(**FLAGS)
def _factor(H):
    """Cholesky factor U'U of H (n, n) in its upper triangle, in place, inverse pivots on the diagonal; pivots are floored."""
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
            if t != 0.0:
                for c in range(i, n):
                    H[i, c] -= t * H[r, c]


@njit(**FLAGS)
def _half_solve(U, v):
    """v <- U'^-1 v."""
    n = v.shape[0]
    for r in range(n):
        t = v[r] * U[r, r]
        v[r] = t
        for c in range(r + 1, n):
            v[c] -= t * U[r, c]


@njit(**FLAGS)
def _back_solve(U, v):
    """v <- U^-1 v."""
    for r in range(v.shape[0] - 1, -1, -1):
        t = v[r]
        for c in range(r + 1, v.shape[0]):
            t -= U[r, c] * v[c]
        v[r] = t * U[r, r]


@njit(**FLAGS)
def _to_cone(u, du, F, dF, n):
    """Largest step up to 1e3 that keeps (u, F) + t (du, dF) in the cone |u| <= F; u is the first n components."""
    a, b, c = dF * dF, F * dF, F * F
    for j in range(n):
        a -= du[j] * du[j]
        b -= u[j] * du[j]
        c -= u[j] * u[j]
    # Least positive root of a t^2 + 2 b t + c, c > 0.
    root = b * b - a * c
    if root < 0.0 or (b >= 0.0 and a >= 0.0):
        step = 1e3
    else:
        step = c / (-b + np.sqrt(root)) if -b + np.sqrt(root) > 0.0 else 1e3
    return step if dF >= 0.0 else min(step, -F / dF)


@njit(**FLAGS)
def _scaling(u, F, z, bar):
    """Nesterov and Todd's scaling of (u, F) and its multiplier z: fills bar (n + 1,), the head last, and returns eta."""
    n = bar.shape[0] - 1
    ss, zz, sz = F * F, z[n] * z[n], F * z[n]
    for j in range(n):
        ss -= u[j] * u[j]
        zz -= z[j] * z[j]
        sz += u[j] * z[j]
    ss, zz = np.sqrt(max(ss, 1e-300)), np.sqrt(max(zz, 1e-300))
    gamma = np.sqrt(0.5 * (1.0 + sz / (ss * zz)))
    for j in range(n):
        bar[j] = (u[j] / ss - z[j] / zz) / (2.0 * gamma)
    bar[n] = (F / ss + z[n] / zz) / (2.0 * gamma)
    return np.sqrt(ss / zz)


@njit(**FLAGS)
def _scaled(bar, eta, v, out, inverse):
    """out = W v, or W^-1 v; vectors (n + 1,) with the head last."""
    n = bar.shape[0] - 1
    sign = -1.0 if inverse else 1.0
    along = 0.0
    for j in range(n):
        along += bar[j] * v[j]
    factor = sign * v[n] + along / (1.0 + bar[n])
    scale = 1.0 / eta if inverse else eta
    for j in range(n):
        out[j] = scale * (v[j] + factor * bar[j])
    out[n] = scale * (bar[n] * v[n] + sign * along)


@njit(**FLAGS)
def support(g, n_round, vertices):
    """max of g . u over U (:class:`~pinograsp.contacts.Friction`); vertices (e, 2) of the polygon, (0, 2) without one."""
    e = g.shape[0] - 1
    first, total = n_round, 0.0
    if n_round > 0:
        for j in range(n_round):
            total += g[j] * g[j]
        total = np.sqrt(total)
    else:
        first = 2
        total = -np.inf
        for v in range(vertices.shape[0]):
            total = max(total, vertices[v, 0] * g[0] + vertices[v, 1] * g[1])
    for j in range(first, e):
        total += abs(g[j])
    return total


@njit(**FLAGS)
def _rows_at_their_limits(y, b, R_lo, R_hi):
    """What balance and torque rows add to any bound that the multipliers y prove."""
    m = b.shape[0]
    total = 0.0
    for r in range(m):
        total -= y[r] * b[r]
    for r in range(R_lo.shape[0]):
        total -= max(y[m + r] * R_hi[r], y[m + r] * R_lo[r])
    return total


@njit(**FLAGS)
def excluded(y, B, touched, counts, b, lo, hi, n_round, vertices, R_lo, R_hi, g):
    """Farkas bound of the multipliers y = [balance; torque rows], ``Program.excluded`` compiled. g (d,) is scratch."""
    k, d, n = B.shape
    total = _rows_at_their_limits(y, b, R_lo, R_hi)
    for i in range(k):
        for j in range(d):
            t = 0.0
            for h in range(counts[i, 1]):
                t += B[i, j, touched[i, h]] * y[touched[i, h]]
            g[j] = t
        s = g[d - 1] - support(g, n_round, vertices)
        total += min(lo[i] * s, hi[i] * s)
    return total


@njit(**FLAGS)
def bound_of(y, x, B, touched, counts, b, P, q, coefs, exps, lo, hi, n_round, vertices, R_lo, R_hi, g):
    """Lower bound of the objective that y proves with tangents near x, ``Program.lower_bound`` compiled. g (d,) is scratch."""
    k, d, n = B.shape
    e = d - 1
    total = _rows_at_their_limits(y, b, R_lo, R_hi)
    for i in range(k):
        for j in range(d):
            t = 0.0
            for c in range(d):
                t += P[i, j, c] * x[i, c]
            total -= 0.5 * t * x[i, j]
            t += q[i, j]
            for h in range(counts[i, 1]):
                t += B[i, j, touched[i, h]] * y[touched[i, h]]
            g[j] = t
        s = g[e] - support(g, n_round, vertices)
        if coefs.shape[0] > 0:
            F = min(max(x[i, e], lo[i]), hi[i])
            t, first, second = phi(F, coefs, exps)
            if second > 0.0:
                # A tangent of phi nearer to its minimiser proves more where F lies between its bounds.
                F = min(max(F - (s + first) / second, max(lo[i], 0.5 * F)), hi[i])
                t, first, second = phi(F, coefs, exps)
            s += first
            total += t - first * F
        total += min(lo[i] * s, hi[i] * s)
    return total


@njit(**FLAGS)
def interior_point(B, touched, counts, n, b, P, q, coefs, exps, lo, hi, C, n_round, vertices, R_lo, R_hi, x, y):
    """Minimise over the cones; x (k, d) and y (m + r,) are the results. (CONVERGED, STALLED or INFEASIBLE, steps).

    Shapes: B (k, d, m + r) the rows: balance (m), torque rows that several contacts enter, torque rows of one contact alone;
    n: how many of them are not of one contact alone; touched (k, m + r): the rows that a contact enters in that order, the
    first counts[i, 0] below n, counts[i, 1] in all; b (m,); P (k, d, d); q (k, d); lo < hi (k,); C (f, d) facets of the
    friction cone, C x_i >= 0; n_round components that a second-order cone bounds; vertices (e, 2) of the polygon; R_lo < R_hi
    (r,). phi' is the sum of coefs[a] F^(exps[0] exps[1 + a]) with coefs (a,) and exps (1 + a,), whole numbers from the
    second on. Infeasible: y is a Farkas certificate.
    """
    k, d, all_rows = B.shape
    m = b.shape[0]
    n_limits, f, e, c1 = all_rows - m, C.shape[0], d - 1, n_round + 1
    H, T = np.empty((k, d, d)), np.empty((k, n, d))
    S, row = np.empty((n, n)), np.empty(all_rows)
    grad, dx, rhs = np.empty((k, d)), np.empty((k, d)), np.empty(d)
    dy = np.empty(n)
    # Slacks s and multipliers z of facets and bounds, products of their predictor's steps.
    s, z, dz, product = np.empty((k, f + 2)), np.empty((k, f + 2)), np.empty((k, f + 2)), np.zeros((k, f + 2))
    # Multipliers of the second-order cones, their centring term, scaling points.
    zc, dzc, centring = np.zeros((k, c1)), np.zeros((k, c1)), np.zeros((k, c1))
    bar, eta = np.empty((k, c1)), np.empty(k)
    v1, v2, v3 = np.empty(c1), np.empty(c1), np.empty(c1)
    # Torque rows: slacks, multipliers, their steps and products, [upper; lower].
    sr, wr, dsr, dwr = np.empty((2, n_limits)), np.empty((2, n_limits)), np.empty((2, n_limits)), np.empty((2, n_limits))
    off_r, product_r = np.empty((2, n_limits)), np.zeros((2, n_limits))
    weight_r, known_r = np.empty(n_limits), np.empty(n_limits)  # dw = weight R dx + known
    y[:] = 0.0
    count = k * (f + 2) + 2 * n_limits + (k if n_round > 0 else 0)
    mu = _CENTRE / k
    for r in range(n_limits):
        row[m + r] = 0.0
    for i in range(k):
        wide = hi[i] - lo[i]
        for j in range(e):
            x[i, j] = 0.0
        x[i, e] = min(max(1.0 / k, lo[i] + 0.1 * min(wide, 1.0 / k)), hi[i] - 0.1 * wide)
        for a in range(f):
            s[i, a] = C[a, e] * x[i, e]
        s[i, f], s[i, f + 1] = x[i, e] - lo[i], hi[i] - x[i, e]
        for a in range(f + 2):
            z[i, a] = mu / s[i, a]
        if n_round > 0:
            zc[i, n_round] = mu / x[i, e]
        for h in range(m, counts[i, 1]):
            row[touched[i, h]] += B[i, e, touched[i, h]] * x[i, e]
    for r in range(n_limits):
        least = 0.1 * min(R_hi[r] - R_lo[r], 1.0)
        sr[0, r], sr[1, r] = max(R_hi[r] - row[m + r], least), max(row[m + r] - R_lo[r], least)
        wr[0, r], wr[1, r] = mu / sr[0, r], mu / sr[1, r]
    tested, short, last = _GROWN, 0, np.inf
    for step in range(_STEPS):
        # Residuals.
        for r in range(m):
            row[r] = -b[r]
        for r in range(n_limits):
            row[m + r] = 0.0
        worst, value, comp = 0.0, 0.0, 0.0
        for i in range(k):
            for h in range(counts[i, 1]):
                r = touched[i, h]
                t = 0.0
                for j in range(d):
                    t += B[i, j, r] * x[i, j]
                row[r] += t
        off = 0.0
        for r in range(m):
            off = max(off, abs(row[r]))
        for r in range(n_limits):
            off_r[0, r], off_r[1, r] = row[m + r] + sr[0, r] - R_hi[r], sr[1, r] - row[m + r] + R_lo[r]
            off = max(off, max(abs(off_r[0, r]), abs(off_r[1, r])))
            comp += sr[0, r] * wr[0, r] + sr[1, r] * wr[1, r]
            weight_r[r] = wr[0, r] / sr[0, r] + wr[1, r] / sr[1, r]
        # Hessians, their factors and the Schur complement.
        for r in range(n):
            for c in range(r, n):
                S[r, c] = 0.0
        for i in range(k):
            F = x[i, e]
            t, first, second = phi(F, coefs, exps)
            value += t
            for j in range(d):
                t = q[i, j]
                for c in range(d):
                    t += P[i, j, c] * x[i, c]
                value += 0.5 * (t + q[i, j]) * x[i, j]
                for h in range(counts[i, 1]):
                    t += B[i, j, touched[i, h]] * y[touched[i, h]]
                grad[i, j] = t
                for c in range(j, d):
                    H[i, j, c] = P[i, j, c]
            grad[i, e] += first
            H[i, e, e] += second
            for a in range(f):
                weight = z[i, a] / s[i, a]
                comp += z[i, a] * s[i, a]
                for j in range(d):
                    t = weight * C[a, j]
                    if t != 0.0:
                        for c in range(j, d):
                            H[i, j, c] += t * C[a, c]
            for a in range(f, f + 2):
                H[i, e, e] += z[i, a] / s[i, a]
                comp += z[i, a] * s[i, a]
            if n_round > 0:
                eta[i] = _scaling(x[i], F, zc[i], bar[i])
                scale = 1.0 / (eta[i] * eta[i])
                for j in range(n_round):
                    comp += x[i, j] * zc[i, j]
                    t = 2.0 * scale * bar[i, j]
                    for c in range(j, n_round):
                        H[i, j, c] += t * bar[i, c]
                    H[i, j, j] += scale
                    H[i, j, e] -= t * bar[i, n_round]
                comp += F * zc[i, n_round]
                H[i, e, e] += scale * (2.0 * bar[i, n_round] * bar[i, n_round] - 1.0)
            for h in range(counts[i, 0], counts[i, 1]):
                r = touched[i, h]
                for j in range(d):
                    t = weight_r[r - m] * B[i, j, r]
                    for c in range(j, d):
                        H[i, j, c] += t * B[i, c, r]
            _factor(H[i])
            for h in range(counts[i, 0]):
                r = touched[i, h]
                for j in range(d):
                    T[i, h, j] = B[i, j, r]
                _half_solve(H[i], T[i, h])
                for g in range(h + 1):
                    t = 0.0
                    for j in range(d):
                        t += T[i, h, j] * T[i, g, j]
                    S[touched[i, g], r] += t
        size = max(abs(value), 1e-6)
        if off <= 1e-7 and comp <= 1e-6 * size:
            gap = value - bound_of(y, x, B, touched, counts, b, P, q, coefs, exps, lo, hi, n_round, vertices, R_lo, R_hi, rhs)
            for r in range(m):
                gap += y[r] * row[r]  # what it costs to mend the balance
            if gap <= _INTERIOR_GAP * size or (gap <= _CLOSED * size and (gap > 0.3 * last or off > _ROWS)):
                # What rounding leaves of the rows is mended in the barriers' metric, which spares what is at its limit.
                for r in range(m, n):
                    S[r, r] += 1.0 / weight_r[r - m]
                _factor(S)
                for r in range(n_limits):
                    known_r[r] = (wr[0, r] * off_r[0, r]) / sr[0, r] - (wr[1, r] * off_r[1, r]) / sr[1, r]
                for _ in range(2):
                    for r in range(n):
                        dy[r] = row[r] if r < m else known_r[r - m] / weight_r[r - m]
                    for i in range(k):
                        dx[i, :] = 0.0
                        for h in range(counts[i, 0], counts[i, 1]):
                            for j in range(d):
                                dx[i, j] -= B[i, j, touched[i, h]] * known_r[touched[i, h] - m]
                        _half_solve(H[i], dx[i])
                        for h in range(counts[i, 0]):
                            for j in range(d):
                                dy[touched[i, h]] += T[i, h, j] * dx[i, j]
                    _half_solve(S, dy)
                    _back_solve(S, dy)
                    for r in range(m):
                        row[r] = -b[r]
                    for i in range(k):
                        for h in range(counts[i, 0]):
                            for j in range(d):
                                dx[i, j] -= T[i, h, j] * dy[touched[i, h]]
                        _back_solve(H[i], dx[i])
                        for j in range(d):
                            x[i, j] += dx[i, j]
                            for r in range(m):
                                row[r] += B[i, j, r] * x[i, j]
                    known_r[:] = 0.0
                return CONVERGED, step
            last = gap
        grown = 0.0
        for r in range(all_rows):
            grown = max(grown, abs(y[r]))
        if not (grown < 1e15 and comp < 1e15):
            return STALLED, step
        if off > _ROWS and (grown > tested * max(size, 1.0) or (short > 1 and grown > 0.0)):
            tested = max(tested, 4.0 * grown / max(size, 1.0))
            for r in range(all_rows):
                row[r] = y[r] / grown
            if excluded(row, B, touched, counts, b, lo, hi, n_round, vertices, R_lo, R_hi, rhs) > _PROVEN:
                y[:] = row
                return INFEASIBLE, step
            for r in range(m):
                row[r] = -b[r]
                for i in range(k):
                    for j in range(d):
                        row[r] += B[i, j, r] * x[i, j]
        for r in range(m, n):
            S[r, r] += 1.0 / weight_r[r - m]
        _factor(S)
        centre = 0.0
        for corrector in range(2):
            for r in range(n_limits):
                known_r[r] = 0.0
                for side in range(2):
                    t = (wr[side, r] * off_r[side, r] + centre - product_r[side, r]) / sr[side, r] - wr[side, r]
                    known_r[r] += t if side == 0 else -t
            for r in range(n):
                dy[r] = row[r] if r < m else known_r[r - m] / weight_r[r - m]
            for i in range(k):
                for j in range(d):
                    dx[i, j] = -grad[i, j]
                for a in range(f):
                    t = (centre - product[i, a]) / s[i, a]
                    for j in range(d):
                        dx[i, j] += C[a, j] * t
                dx[i, e] += (centre - product[i, f]) / s[i, f] - (centre - product[i, f + 1]) / s[i, f + 1]
                if corrector and n_round > 0:
                    for j in range(n_round):
                        dx[i, j] += centring[i, j]
                    dx[i, e] += centring[i, n_round]
                for h in range(counts[i, 0], counts[i, 1]):
                    for j in range(d):
                        dx[i, j] -= B[i, j, touched[i, h]] * known_r[touched[i, h] - m]
                _half_solve(H[i], dx[i])
                for h in range(counts[i, 0]):
                    t = 0.0
                    for j in range(d):
                        t += T[i, h, j] * dx[i, j]
                    dy[touched[i, h]] += t
            _half_solve(S, dy)
            _back_solve(S, dy)
            alpha = 1e3  # largest step inside the cones
            for r in range(m, n):
                dsr[0, r - m] = (known_r[r - m] - dy[r]) / weight_r[r - m]
            for i in range(k):
                for h in range(counts[i, 0]):
                    t = dy[touched[i, h]]
                    for j in range(d):
                        dx[i, j] -= T[i, h, j] * t
                _back_solve(H[i], dx[i])
                for h in range(counts[i, 0], counts[i, 1]):
                    t = 0.0
                    for j in range(d):
                        t -= B[i, j, touched[i, h]] * dx[i, j]
                    dsr[0, touched[i, h] - m] = t
                for a in range(f + 2):
                    if a < f:
                        ds = 0.0
                        for j in range(d):
                            ds += C[a, j] * dx[i, j]
                    else:
                        ds = dx[i, e] if a == f else -dx[i, e]
                    dz[i, a] = (centre - product[i, a] - z[i, a] * ds) / s[i, a] - z[i, a]
                    if ds < 0.0:
                        alpha = min(alpha, -s[i, a] / ds)
                    if dz[i, a] < 0.0:
                        alpha = min(alpha, -z[i, a] / dz[i, a])
                    if not corrector:
                        product[i, a] = ds * dz[i, a]
                if n_round > 0:
                    for j in range(n_round):
                        v1[j] = dx[i, j]
                    v1[n_round] = dx[i, e]
                    _scaled(bar[i], eta[i], v1, v2, True)
                    _scaled(bar[i], eta[i], v2, v3, True)
                    for j in range(c1):
                        dzc[i, j] = (centring[i, j] if corrector else 0.0) - zc[i, j] - v3[j]
                    alpha = min(alpha, _to_cone(x[i], dx[i], x[i, e], dx[i, e], n_round))
                    alpha = min(alpha, _to_cone(zc[i], dzc[i], zc[i, n_round], dzc[i, n_round], n_round))
                    if not corrector:
                        # The Jordan product of both scaled steps.
                        _scaled(bar[i], eta[i], dzc[i], v3, False)
                        t = v2[n_round] * v3[n_round]
                        for j in range(n_round):
                            centring[i, j] = v2[n_round] * v3[j] + v3[n_round] * v2[j]
                            t += v2[j] * v3[j]
                        centring[i, n_round] = t
            for r in range(n_limits):
                dsr[1, r] = -dsr[0, r]  # so far +-R dx; each side has its own residual
                for side in range(2):
                    ds = dsr[side, r] - off_r[side, r]
                    dw = (centre - product_r[side, r] - wr[side, r] * ds) / sr[side, r] - wr[side, r]
                    dsr[side, r], dwr[side, r] = ds, dw
                    if ds < 0.0:
                        alpha = min(alpha, -sr[side, r] / ds)
                    if dw < 0.0:
                        alpha = min(alpha, -wr[side, r] / dw)
                    product_r[side, r] = 0.0 if corrector else ds * dw
            if corrector:
                break
            centre = (1.0 - min(alpha, 1.0)) ** 3 * comp / count
            for i in range(k if n_round > 0 else 0):
                # W^-1 (lambda \ (centre e - product)), lambda = W z.
                _scaled(bar[i], eta[i], zc[i], v1, False)
                det, t = v1[n_round] * v1[n_round], v1[n_round] * (centre - centring[i, n_round])
                for j in range(n_round):
                    det -= v1[j] * v1[j]
                    t += v1[j] * centring[i, j]
                t /= max(det, 1e-300)
                for j in range(n_round):
                    v3[j] = (-centring[i, j] - t * v1[j]) / v1[n_round]
                v3[n_round] = t
                _scaled(bar[i], eta[i], v3, centring[i], True)
        alpha = min(1.0, _TO_BOUNDARY * alpha)
        short = short + 1 if alpha < 1e-3 else 0
        if short > 5:
            return STALLED, step
        for i in range(k):
            for j in range(d):
                x[i, j] += alpha * dx[i, j]
            for a in range(f + 2):
                z[i, a] += alpha * dz[i, a]
                product[i, a] = 0.0
            for a in range(f):
                t = 0.0
                for j in range(d):
                    t += C[a, j] * x[i, j]
                s[i, a] = t
            s[i, f], s[i, f + 1] = x[i, e] - lo[i], hi[i] - x[i, e]
            for j in range(c1):
                zc[i, j] += alpha * dzc[i, j]
        for r in range(m):
            y[r] += alpha * dy[r]
        for r in range(n_limits):
            for side in range(2):
                sr[side, r] += alpha * dsr[side, r]
                wr[side, r] += alpha * dwr[side, r]
            y[m + r] = wr[0, r] - wr[1, r]
    return STALLED, _STEPS


# -- answers and their checks -----------------------------------------------------------------------------------------


@njit(**FLAGS)
def powers_of(terms, scale, unit):
    """phi' as the solvers take it, from pairs (coefficient, exponent): the exponents are 1, 1 + 1 / rho and 1 + 2 / rho."""
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


@njit(**FLAGS)
def answer(newton, strong, B, touched, counts, n, b, P, q, coefs, exps, lo, hi, C, n_round, vertices, radii, R_lo, R_hi,
           correction, x, y, gauge, residual):  # fmt: skip
    """Solve and check: (CONVERGED, STALLED or INFEASIBLE, violation, value, bound); fills x, y, gauge (k,), residual (m,).

    ``newton`` and ``strong``: which solver, and whether it needs no proximal weight; correction (k d, m) is the pseudoinverse
    of the balance; the rest as in :func:`interior_point`.
    """
    k, d, all_rows = B.shape
    m, e = b.shape[0], d - 1
    code = CONVERGED
    if newton:
        p = np.empty((k, d))
        for i in range(k):
            for j in range(d):
                p[i, j] = P[i, j, j]
                x[i, j] = 0.0
            x[i, e] = min(max(min(1.0, 2.0 / k), lo[i]), hi[i])
        y[:] = 0.0
        weight = 0.0 if strong else _FIRST_WEIGHT
        if dual_newton(y, B, b, q, p, lo, hi, coefs, exps, radii, n_round, weight, x) < 0:
            code = STALLED
    else:
        code, _ = interior_point(
            B, touched, counts, n, b, P, q, coefs, exps, lo, hi, C, n_round, vertices, R_lo, R_hi, x, y
        )
    torque = np.empty(all_rows - m)
    violation, value = 0.0, 0.0
    for again in range(2):
        for r in range(m):
            t = -b[r]
            for i in range(k):
                for j in range(d):
                    t += B[i, j, r] * x[i, j]
            residual[r] = t
        t = 0.0
        for r in range(m):
            t += residual[r] * residual[r]
        if again or t <= 1e-26:
            break
        for i in range(k):
            for j in range(d):
                for r in range(m):
                    x[i, j] -= correction[i * d + j, r] * residual[r]
    torque[:] = 0.0
    for i in range(k):
        F = x[i, e]
        length = 0.0
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
        t, _, _ = phi(max(F, 1e-300), coefs, exps)
        value += t
        for j in range(d):
            t = 0.0
            for c in range(d):
                t += P[i, j, c] * x[i, c]
            value += (q[i, j] + 0.5 * t) * x[i, j]
        for h in range(m, counts[i, 1]):
            for j in range(d):
                torque[touched[i, h] - m] += B[i, j, touched[i, h]] * x[i, j]
    for r in range(all_rows - m):
        violation = max(violation, max(torque[r] - R_hi[r], R_lo[r] - torque[r]))
    most = 1.0
    for i in range(k):
        most = max(most, x[i, e])
    if violation > _SHARP * most:
        code = STALLED
    g = np.empty(d)
    bound = bound_of(y, x, B, touched, counts, b, P, q, coefs, exps, lo, hi, n_round, vertices, R_lo, R_hi, g)
    return code, violation, value, bound


@njit(**FLAGS)
def whole(newton, strong, B, touched, counts, n, P0, q0, constant, largest, C, n_round, vertices, radii, R_lo0, R_hi0,
          correction, load, arm, terms, low, high, caps, widths, G, normals, half, stiffness, exponent, depth_per_A, near,
          forces, torsion, multipliers, acceleration, wrench, active, active_rows):  # fmt: skip
    """One force problem from its load (6,) [N, N m] to everything its record holds.

    Arguments as in :func:`answer`, in newtons; then arm [m], powers of the objective (a, 2), bounds of F_n [N], caps (k,) or
    (0,), widths (k, 3 or 4) newtons and N m per unit of x, G (6, 3 k), normals (k, 3), half the pyramid's width per newton
    (k,), contact law and final depth per deceleration. Fills forces (k, 3), torsion (k,), multipliers (k, 2), acceleration
    (k,), wrench (6,), active (3, k) at friction, least and largest F_n, active_rows (r,).
    ``near``: a limit met to this share is active.
    Returns, dimensionless, (CONVERGED or what went wrong, violation, largest F_n, objective, bound, its constant, net force,
    net moment) and what forces [N] and the objective were divided by.
    """
    k, d, all_rows = B.shape
    m, e = correction.shape[1], d - 1
    failed = (STALLED, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    scale = 0.0
    b = np.empty(m)
    for r in range(m):
        b[r] = -load[r] if r < 3 else -load[r] / arm
        scale += b[r] * b[r]
    scale = np.sqrt(scale)
    if scale == 0.0:
        scale = low
    lo, hi = np.empty(k), np.empty(k)
    for i in range(k):
        lo[i], hi[i] = low / scale, high / scale
        if caps.shape[0] > 0:
            hi[i] = min(caps[i] / scale, hi[i])
        if not hi[i] - lo[i] > 1e-9 * hi[i]:
            return failed
    for r in range(m):
        b[r] /= scale
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
    code, violation, value, bound = answer(
        newton, strong, B, touched, counts, n, b, P, q, coefs, exps, lo, hi, C, n_round, vertices, radii, R_lo, R_hi,
        correction, x, y, gauge, residual,
    )  # fmt: skip
    if code != CONVERGED:
        return failed
    most = 0.0
    for i in range(k):
        most = max(most, x[i, e])
    for r in range(6):
        wrench[r] = load[r]
    for i in range(k):
        F = x[i, e]
        active[0, i] = gauge[i] >= F * (1.0 - near)
        active[1, i] = lo[i] * (1.0 + near) >= F
        active[2, i] = hi[i] * (1.0 - near) <= F
        forces[i, 0], forces[i, 1], forces[i, 2] = x[i, 0] * scale * widths[i, 0], x[i, 1] * scale * widths[i, 1], F * scale
        torsion[i] = 0.0
        if d == 4:
            torsion[i] = x[i, 2] * scale * widths[i, 2]
            for c in range(3):
                wrench[3 + c] += torsion[i] * normals[i, c]
        for j in range(2):
            reach = half[i] * forces[i, 2]
            multipliers[i, j] = forces[i, j] / reach if reach > 0.0 else 0.0
        acceleration[i] = (max(forces[i, 2], 0.0) / stiffness) ** (1.0 / exponent) / depth_per_A
        for r in range(6):
            for j in range(3):
                wrench[r] += G[r, 3 * i + j] * forces[i, j]
    for r in range(all_rows - m):
        t = 0.0
        for i in range(k):
            for j in range(d):
                t += B[i, j, m + r] * x[i, j]
        active_rows[r] = t >= R_hi[r] - near or t <= R_lo[r] + near
    force, moment = 0.0, 0.0
    for r in range(m):
        if r < 3:
            force += residual[r] * residual[r]
        else:
            moment += residual[r] * residual[r]
    return code, violation, most, value, bound, constant, np.sqrt(force), np.sqrt(moment), scale, unit
