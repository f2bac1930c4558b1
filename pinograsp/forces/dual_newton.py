r"""Semismooth Newton on the six-dimensional dual: a solver made for grasp forces, compiled (extra ``fast``).

The balance has m <= 6 rows, everything else concerns one contact at a time. With multipliers y of A x = b the Lagrangian
therefore separates,

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
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pinograsp.forces.program import Program

_PASSES = 40
_LEAST_WEIGHT = 3e-3  # below, nearly linear objectives (the impulse) cost Newton more steps than they save passes
_WEIGHT = 0.1  # first proximal weight, against an objective of order one
_SHRINK = 0.3  # from pass to pass: smaller steps the Newton method hardly, larger ones cost passes
_GAP = 1e-7
_BALANCED = 1e-12  # residual of the balance, of the load
_FLAGS = {"cache": True, "fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy"}


@njit(**_FLAGS)
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


@njit(**_FLAGS)
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


@njit(**_FLAGS)
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


@njit(**_FLAGS)
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


@njit(**_FLAGS)
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


@njit(**_FLAGS)
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


@njit(**_FLAGS)
def solve(y, AT, b, q, p, lo, hi, coefs, exps, radii, n_round, weight, x):
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
        if gap <= _GAP * max(size, 1e-12):
            return total
        weight = max(weight * _SHRINK, _LEAST_WEIGHT)
    return total


@njit(**_FLAGS)
def check(y, AT, b, q, p, lo, hi, coefs, exps, radii, n_round, x, gauge, residual):
    """What certifies x with the multipliers y: largest violation, objective and its proven lower bound.

    Fills ``gauge`` (k,) and the balance's ``residual`` (m,). The same checks as :mod:`pinograsp.forces.program`'s, written
    for compiling; the tests compare the two.
    """
    k, d, m = AT.shape
    e = d - 1
    for r in range(m):
        residual[r] = -b[r]
    violation, value = 0.0, 0.0
    gap, _ = _gap(y, AT, q, p, lo, hi, coefs, exps, radii, n_round, x)
    for i in range(k):
        F = x[i, e]
        round_ = 0.0
        for j in range(n_round):
            round_ += x[i, j] * x[i, j]
        largest = np.sqrt(round_)
        for j in range(n_round, e):
            largest = max(largest, abs(x[i, j]) / radii[j])
        gauge[i] = largest
        violation = max(violation, max(largest - F, max(lo[i] - F, F - hi[i])))
        for j in range(d):
            value += (q[i, j] + 0.5 * p[i, j] * x[i, j]) * x[i, j]
            for r in range(m):
                residual[r] += AT[i, j, r] * x[i, j]
        for a in range(coefs.shape[0]):
            exponent = 1.0 + exps[0] * exps[1 + a]
            value += coefs[a] / exponent * F**exponent
    # The gap took sum y . A x from x; the balance's residual says how far that is from y . b.
    slack = 0.0
    for r in range(m):
        slack += y[r] * residual[r]
    return violation, value, value - gap + slack


class Structured:
    """What the compiled solver needs of a program that does not change with load and impact time."""

    def __init__(self, program: Program):
        k, d = program.k, program.d
        self.AT = np.ascontiguousarray(program.A.reshape(-1, k, d).transpose(1, 2, 0))
        self.n_round = program.friction.round_dimensions
        self.radii = np.ones(d - 1)
        if program.friction.model == "pyramid":
            self.radii[:2] = np.sqrt(0.5)


def _derivative(powers) -> tuple[np.ndarray, np.ndarray]:
    """phi' as ``solve`` takes it: the energies' exponents are 1, 1 + 1 / rho and 1 + 2 / rho."""
    steps = [exponent - 1.0 for _, exponent in powers if exponent > 1.0]
    root = min(steps, default=1.0)
    exps, coefs = np.empty(len(powers) + 1), np.empty(len(powers))
    exps[0] = root
    for a, (coefficient, exponent) in enumerate(powers):
        coefs[a] = coefficient * exponent
        exps[1 + a] = round((exponent - 1.0) / root)
    return coefs, exps


def applies(program: Program) -> bool:
    """Whether the program separates over contacts in the way this solver needs."""
    known = program.cache.get("separates")
    if known is None:
        friction, P = program.friction, program.P
        known = not program.peak and not len(program.R) and (friction.model != "pyramid" or friction.edges == 4)
        if known and P is not None:
            weights = np.diag(P).reshape(program.k, program.d)[:, : friction.round_dimensions]
            known = np.count_nonzero(P - np.diag(np.diag(P))) == 0
            known = known and (weights.shape[1] == 0 or bool(np.all(np.ptp(weights, axis=1) <= 1e-12 * weights.max())))
        program.cache["separates"] = known
    return known


def solve_structured(program: Program) -> tuple | None:
    """x (k d,), balance multipliers y (rows,), no torque multipliers, and the checks; None where it does not converge.

    The checks are the largest violation, gauges (k,), balance residual (rows,), objective and proven bound.
    """
    fixed = program.cache.get("structured")
    if fixed is None:
        fixed = program.cache["structured"] = Structured(program)
    k, d = program.k, program.d
    x = np.zeros((k, d))
    x[:, -1] = np.minimum(np.maximum(min(1.0, 2.0 / k), program.lo), program.hi)
    y = np.zeros(len(program.b))
    p, weight = np.zeros((k, d)), _WEIGHT
    if program.P is not None:
        p = program.P.diagonal().reshape(k, d)
        weight = 0.0 if p.min() > 1e-6 * p.max() else _WEIGHT
    data = (fixed.AT, program.b, program.q.reshape(k, d), p, program.lo, program.hi,
            *_derivative(program.powers), fixed.radii, fixed.n_round)  # fmt: skip
    if solve(y, *data, weight, x) < 0:
        return None
    gauge, residual = np.empty(k), np.empty(len(y))
    violation, value, bound = check(y, *data, x, gauge, residual)
    if not math.isfinite(value + bound + violation):
        return None
    return x.ravel(), y, np.zeros(0), (violation, gauge, residual, value, bound)


def compile_now() -> None:
    """Compile (or load from the cache) every function for the types that are used."""
    AT, k, d, m = np.zeros((1, 3, 6)), 1, 3, 6
    AT[0, :, :3] = np.eye(3)
    y, x = np.zeros(m), np.ones((k, d))
    data = (AT, np.zeros(m), np.zeros((k, d)), np.ones((k, d)), np.zeros(k), np.ones(k), np.ones(1), np.ones(2),
            np.ones(d - 1), 2)  # fmt: skip
    solve(y, *data, 0.0, x)
    check(y, *data, x, np.zeros(k), np.zeros(m))
