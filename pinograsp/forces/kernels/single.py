"""One force problem: solve it, check the answer, and write out what its record holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.bounds import bound_of
from pinograsp.forces.kernels.flags import COUNTED, PIECE
from pinograsp.forces.kernels.interior import interior_point
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    STALLED,
    Answers,
    Balance,
    Cones,
    Costs,
    Grasp,
    Objective,
    Problem,
    Ranges,
)
from pinograsp.forces.kernels.newton import dual_newton, newton_scratch
from pinograsp.forces.kernels.packing import Results, unpack_grasp, unpack_results, unpack_stage
from pinograsp.forces.kernels.powers import powers_of
from pinograsp.spatial import Array, BoolArray, IntArray

_SHARP = 1e-9  # relative to the load or the largest F_n: answers that miss a limit by more go to the general methods


class Outcome(NamedTuple):
    """Of one load, dimensionless but for the last two: what forces [N] and the objective were divided by."""

    code: int
    newton: bool
    violation: float
    most: float
    value: float
    bound: float
    constant: float
    force: float
    moment: float
    scale: float
    unit: float


@jit(**PIECE)
def _by_newton(problem: Problem, x: Array, y: Array) -> int:
    """x (k, d) and y by the dual Newton method; its code."""
    (lo, hi, _, _), (P, q, powers), (k, d), m = problem.ranges, problem.objective, x.shape, problem.b.shape[0]
    z, work = np.zeros((d, k)), np.empty(newton_scratch(d, k) + 2 * d * k)
    heavy, costs = work[-2 * d * k : -d * k].reshape((d, k)), work[-d * k :].reshape((d, k))
    for i in range(k):
        z[d - 1, i] = min(max(2.0 / k, lo[i]), hi[i])
        for j in range(d):
            heavy[j, i], costs[j, i] = P[i, j, j], q[i, j]
    y[:] = 0.0
    cones = Cones(lo, hi, problem.friction.radii, problem.friction.n_round)
    balance = Balance(problem.rows.A[:m], problem.b, 0.0)
    code, _ = dual_newton(balance, Costs(heavy, costs, powers), cones, z, y, work)
    for i in range(k):
        for j in range(d):
            x[i, j] = z[j, i]
    return code


@jit(**PIECE)
def _restore_balance(B: Array, b: Array, correction: Array, x: Array, residual: Array) -> None:
    """The residual of the balance, after a correction of x where rounding left one."""
    k, d = x.shape
    for again in range(2):
        for r in range(b.shape[0]):
            t = -b[r]
            for i in range(k):
                for j in range(d):
                    t += B[i, j, r] * x[i, j]
            residual[r] = t
        if again or (residual * residual).sum() <= 1e-26:
            break
        for i in range(k):
            for j in range(d):
                for r in range(b.shape[0]):
                    x[i, j] -= correction[i * d + j, r] * residual[r]


@jit(**PIECE)
def _violation(problem: Problem, x: Array, gauge: Array) -> tuple[float, float]:
    """The largest violation of friction, bounds and torque rows, and the largest F_n or 1; fills gauge (k,)."""
    lo, hi, R_lo, R_hi = problem.ranges
    B, touched, counts = problem.rows.B, problem.rows.touched, problem.rows.counts
    C, n_round, m, (k, d) = problem.friction.facets, problem.friction.n_round, problem.b.shape[0], x.shape
    e, torque, violation, most = d - 1, np.zeros(R_lo.shape[0]), 0.0, 1.0
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
    for r in range(torque.shape[0]):
        violation = max(violation, max(torque[r] - R_hi[r], R_lo[r] - torque[r]))
    return violation, most


@jit(**COUNTED)
def answer(newton: bool, problem: Problem, correction: Array, found: Answers) -> tuple[int, float, float, float, bool]:
    """Solve and check: (CONVERGED, STALLED or INFEASIBLE, violation, value, bound, whether by Newton's method).

    ``newton``: try the dual Newton method first; correction (k d, m) is the pseudoinverse of the balance. Fills
    ``found``.
    """
    x, y, gauge, residual = found
    code = CONVERGED
    if newton:
        code = _by_newton(problem, x, y)
        if code == STALLED:
            newton = False
    if not newton:
        code, _ = interior_point(problem, 0.0, x, y)
    _restore_balance(problem.rows.B, problem.b, correction, x, residual)
    violation, most = _violation(problem, x, gauge)
    if violation > _SHARP * most:
        code = STALLED
    bound, value = bound_of(problem, x, y, np.empty(x.shape[1]))
    return code, violation, value, bound, newton


@jit(**PIECE)
def _write_forces(grasp: Grasp, x: Array, scale: float, load: Array, results: Results) -> None:
    """Forces and torsion from x (k, d), and what they and the load leave over."""
    widths, G, normals = grasp.widths, grasp.grasp_matrix, grasp.normals
    wrench, forces, torsion = results.wrench, results.forces, results.torsion
    k, d = x.shape
    for r in range(6):
        wrench[r] = load[r]
    for i in range(k):
        forces[i, 0], forces[i, 1], forces[i, 2] = (
            x[i, 0] * scale * widths[i, 0],
            x[i, 1] * scale * widths[i, 1],
            x[i, d - 1] * scale,
        )
        torsion[i] = 0.0
        if d == 4:
            torsion[i] = x[i, 2] * scale * widths[i, 2]
            for c in range(3):
                wrench[3 + c] += torsion[i] * normals[i, c]
        for r in range(6):
            for j in range(3):
                wrench[r] += G[r, 3 * i + j] * forces[i, j]


@jit(**PIECE)
def _write_active(problem: Problem, near: float, x: Array, gauge: Array, results: Results) -> None:
    """Which limits x (k, d) is at."""
    lo, hi, R_lo, R_hi = problem.ranges
    at_friction, at_least, at_most, at_torque = (
        results.at_friction,
        results.at_least,
        results.at_most,
        results.at_torque,
    )
    B, m, (k, d) = problem.rows.B, problem.b.shape[0], x.shape
    for i in range(k):
        F = x[i, d - 1]
        at_friction[i] = gauge[i] >= F * (1.0 - near)
        at_least[i] = lo[i] * (1.0 + near) >= F
        at_most[i] = hi[i] * (1.0 - near) <= F
    for r in range(R_lo.shape[0]):
        t = 0.0
        for i in range(k):
            for j in range(d):
                t += B[i, j, m + r] * x[i, j]
        at_torque[r] = t >= R_hi[r] - near or t <= R_lo[r] + near


@jit(**COUNTED)
def solve_one(whole: IntArray, numbers: Array, packed: Array, load: Array, out: Array, active: BoolArray) -> Outcome:
    """One force problem, from its load (6,) [N, N m] to everything that its record holds.

    whole, numbers: the grasp, and packed: limits and energy, as :mod:`pinograsp.forces.kernels.packing` packs them;
    fills out and active, see its ``Results``. The code is CONVERGED or STALLED.
    """
    grasp = unpack_grasp(whole, numbers)
    (k, d, all_rows), m = grasp.rows.B.shape, grasp.correction.shape[1]
    stage, results = unpack_stage(packed, k), unpack_results(out, active, k)
    constant, largest, arm, near = grasp.scalars
    least, greatest, terms = stage.least, stage.greatest, stage.terms
    failed = Outcome(STALLED, False, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
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
    objective = Objective(grasp.P * (scale * scale / unit), grasp.q * (scale / unit), powers_of(terms, scale, unit))
    ranges = Ranges(lo, hi, grasp.R_lo / scale, grasp.R_hi / scale)
    problem = Problem(grasp.rows, grasp.limits, grasp.friction, ranges, objective, b)
    found = Answers(np.empty((k, d)), np.empty(all_rows), np.empty(k), np.empty(m))
    code, violation, value, bound, newton = answer(stage.newton, problem, grasp.correction, found)
    if code != CONVERGED:
        return failed
    x, residual, most = found.x, found.residual, 0.0
    for i in range(k):
        most = max(most, x[i, d - 1])
    _write_forces(grasp, x, scale, load, results)
    _write_active(problem, near, x, found.gauge, results)
    force, moment = 0.0, 0.0
    for r in range(m):
        if r < 3:
            force += residual[r] * residual[r]
        else:
            moment += residual[r] * residual[r]
    constant /= unit
    return Outcome(code, newton, violation, most, value, bound, constant, np.sqrt(force), np.sqrt(moment), scale, unit)
