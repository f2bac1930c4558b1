"""The dual Newton method for grasp forces: powers of F_n, objectives without curvature, and loads that cannot be held.

Powers of F_n are replaced by their quadratic models at the last answer, in several passes (sequential quadratic
programming, whose fixed point solves the prox of phi exactly). Where the objective has no quadratic weight in some
direction, a proximal weight is added that pulls towards the last answer and falls from pass to pass (Rockafellar 1976).
The passes end when the duality gap of the original objective is closed. Answers are certified like those of any other
method; problems that this method does not finish go to the interior-point method.
"""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.dual import ascend, ascent_scratch, least_along
from pinograsp.forces.kernels.flags import NEWTON, NEWTON_COUNTED, PIECE
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    INFEASIBLE,
    PROVEN,
    STALLED,
    Balance,
    Cones,
    Costs,
    Quadratic,
)
from pinograsp.forces.kernels.powers import phi
from pinograsp.forces.kernels.rows import judge, slopes_of
from pinograsp.spatial import Array

BALANCED = 1e-11  # residual of the balance, relative to the load, in the last pass
# Compliance of the balance constraint where the load cannot be held, against a weight of one on squared forces: first
# value, factor per pass, least value; number of passes.
GIVE, STIFFEN, LEAST_GIVE, GIVES = 1e-3, 0.1, 1e-7, 20
_ROUGHLY = 1e-2  # residual of the balance, relative to the load, in early passes
_PASSES = 40
_NEWTON_STEPS = np.int64(100)  # no literal: for another type of integer everything would be compiled once more
_STRONG = 0.03  # objectives of order one with at least this curvature need no proximal weight
_FIRST_WEIGHT, _SHRINK, _LEAST_WEIGHT = 0.1, 0.1, 1e-3  # proximal weights, from pass to pass
_NEWTON_GAP = 1e-9
_CLOSEST = 1e-8  # forces are the closest where what they leave is this near to its least value, relative to the load


@jit(**NEWTON)
def newton_scratch(d: int, k: int) -> int:
    """Length of the scratch array of :func:`dual_newton` and :func:`closest`: two arrays (d, k), then that of their
    ascents.
    """
    return 2 * d * k + ascent_scratch(d, k)


@jit(**NEWTON)
def gap_of(balance: Balance, costs: Costs, cones: Cones, x: Array, y: Array, slopes: Array) -> tuple[float, float]:
    """The objective at x, and its lower bound from y and the tangents at x; slopes (d k,) is scratch."""
    A, b, _ = balance
    P, q, (coefs, exps) = costs
    lo, hi, radii, n_round = cones
    d, k = q.shape
    e, value, bound = d - 1, 0.0, 0.0
    for r in range(b.shape[0]):
        bound -= b[r] * y[r]
    slopes_of(A, y, slopes)
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


@jit(**PIECE)
def _model(costs: Costs, weight: float, x: Array, model: Quadratic) -> None:
    """The quadratic model of the objective at x (d, k), with a proximal weight."""
    P, q, (coefs, exps) = costs
    w, shifted = model
    d, k = x.shape
    e = d - 1
    for j in range(d):
        for i in range(k):
            w[j, i], shifted[j, i] = P[j, i] + weight, q[j, i] - weight * x[j, i]
    for i in range(k if coefs.shape[0] > 0 else 0):
        F = x[e, i]
        _, first, second = phi(F, coefs, exps)
        w[e, i] += second
        shifted[e, i] += first - second * F


@jit(**NEWTON)
def dual_newton(balance: Balance, costs: Costs, cones: Cones, x: Array, y: Array, work: Array) -> tuple[int, int]:
    """Minimise over the cones from y (m,), zeros if nothing is known; x (d, k) is start and result, y the multipliers.

    lo < hi. work: :func:`newton_scratch`. Returns (code, Newton steps). INFEASIBLE: y is a ray.
    """
    P = costs.P
    d, k = P.shape
    n, steps, least = d * k, 0, np.inf
    model, rest = Quadratic(work[:n].reshape((d, k)), work[n : 2 * n].reshape((d, k))), work[2 * n :]
    for j in range(d):
        for i in range(k):
            least = min(least, P[j, i])
    strong = least >= _STRONG
    once = strong and costs.powers.coefs.shape[0] == 0
    weight = 0.0 if strong else _FIRST_WEIGHT
    for _stage in range(_PASSES):
        last = weight < 2 * _LEAST_WEIGHT
        _model(costs, weight, x, model)
        tolerance = BALANCED if last else _ROUGHLY
        code, used = ascend(balance, model, cones, x, y, tolerance, _NEWTON_STEPS, rest)
        steps += used
        if code != CONVERGED or once:
            return code, steps
        if last:
            value, bound = gap_of(balance, costs, cones, x, y, work)
            if value - bound <= _NEWTON_GAP * max(abs(value), 1e-12):
                return CONVERGED, steps
        weight = 0.0 if strong else max(weight * _SHRINK, _LEAST_WEIGHT)
    return STALLED, steps


@jit(**NEWTON_COUNTED)
def closest(
    balance: Balance, quadratic: Quadratic, cones: Cones, x: Array, y: Array, most: int, work: Array
) -> tuple[int, int]:
    """The least |A x - b| of all admissible x (d, k): INFEASIBLE where it is proven, else STALLED; and Newton steps.

    Proximal passes: the weight w of the forces pulls towards the last answer, so it has no influence on the result, and
    the balance gets stiffer from pass to pass. At the end the multipliers prove that no forces leave less.
    y (m,), q (d, k) and ``work`` (:func:`newton_scratch`) are scratch.
    """
    A, b, _ = balance
    w, q = quadratic
    d, k = x.shape
    n = d * k
    flat, slopes, best, rest = x.reshape(n), work[:n], work[n : 2 * n], work[2 * n :]
    steps, give, nearest = 0, GIVE, np.inf
    y[:], q[:] = 0.0, 0.0
    for _stage in range(GIVES):
        _, used = ascend(Balance(A, b, give), quadratic, cones, x, y, 1e-9, most, rest)
        steps += used
        off, _ = judge(balance, cones, x)
        slopes_of(A, y, slopes)
        least = least_along(slopes.reshape((d, k)), b, y, cones) / max(np.sqrt((y * y).sum()), 1e-300)
        if off - least <= _CLOSEST * max(off, 1.0):
            return INFEASIBLE if least > PROVEN else STALLED, steps
        if off < nearest:
            nearest, best[:] = off, flat
        if steps > GIVES // 2 * most:
            break
        stiffer = max(give * STIFFEN, LEAST_GIVE)
        y *= give / stiffer
        give = stiffer
        q[:] = -w * x
    flat[:] = best
    return STALLED, steps
