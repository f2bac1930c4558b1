"""Infeasible loads: the proof, a checked Farkas certificate, and the multiple of the load that can be held."""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.checks import brief, read_only
from pinograsp.forces.certificate import TOLERANCE, Infeasibility
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.answers import forces_of
from pinograsp.forces.solve.conic import limit_rows, solve, solve_linear, sparse, stack_blocks
from pinograsp.forces.solve.program import Program
from pinograsp.spatial import Array, BoolArray

_SHARP = 1e-7  # largest difference between an extreme multiple and its proven bound, relative
_NEWTON = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closest:
    """Phase one: the admissible x with the least residual and torque excess, dimensionless.

    Attributes:
        x: scaled forces (k d,).
        left: norm of the residual, or the limits' largest violation if that is more.
        y: balance multipliers (rows,); with w a Farkas certificate where ``proven`` > 0.
        w: torque multipliers (m,).
        proven: lower bound of ``left`` for all admissible x, in closed form from y and w.
    """

    x: Array
    left: float
    y: Array
    w: Array
    proven: float

    __repr__ = brief()


def closest(program: Program) -> Closest | None:
    """min |(r, s)| with r = A x - b and s the excess of R x over its limits, over the friction cones: always feasible.

    The norm is minimised, not its square: the dual then stays sharp down to the limit of feasibility. None where the
    solver's answer is not finite.
    """
    n, rows, m = program.k * program.d, len(program.b), len(program.R)
    fixed, fixed_b, linear, linear_b, second, sizes = limit_rows(program)
    extra = rows + m + 1  # r, s and the norm t
    norm = np.zeros((extra, extra))
    norm[0, -1] = -1.0
    norm[1:, :-1] = -np.eye(extra - 1)
    one = np.eye(extra)[rows:-1]
    A = stack_blocks(
        [
            [program.A, -np.eye(rows, extra)],
            [fixed, None],
            [linear, None],
            [program.R, -one],
            [-program.R, one],
            [None, norm],
            [second, None],
        ],
        (n, extra),
    )
    b = np.concatenate([program.b, fixed_b, linear_b, program.R_hi, -program.R_lo, np.zeros(extra + len(second))])
    q = np.zeros(n + extra)
    q[-1] = 1.0
    cones = [clarabel.ZeroConeT(rows + len(fixed_b)), clarabel.NonnegativeConeT(len(linear_b) + 2 * m)]
    cones += [clarabel.SecondOrderConeT(size) for size in (extra, *sizes)]
    found = solve(sp.csc_matrix((len(q),) * 2), q, sparse(A), b, cones)
    z, dual = np.array(found.x), np.array(found.z)
    if not (np.isfinite(z).all() and np.isfinite(dual).all()):
        return None
    x, y = z[:n], dual[:rows]
    at = rows + len(fixed_b) + len(linear_b)
    w = dual[at : at + m] - dual[at + m : at + 2 * m]
    # In theory (y, w) has length one wherever forces cannot hold the load; near that limit the solver's is shorter.
    size = max(1e-6, float(np.sqrt(y @ y + w @ w)))
    y, w = y / size, w / size
    left = float(np.linalg.norm(program.A @ x - program.b))
    return Closest(x=x, left=max(left, program.violations(x)[0]), y=y, w=w, proven=program.farkas_bound(y, w))


def prove(problem: ForceProblem, program: Program) -> Infeasibility | None:
    """The proof of infeasibility, or None where there is none (the program is feasible, or too close to tell)."""
    crossed = program.lo > program.hi
    if np.any(crossed):
        zeros = np.zeros((problem.k, 3))
        gap = float((program.lo - program.hi).max()) * program.force_scale
        return _record(problem, program, gap, np.zeros(len(program.b)), np.zeros(len(program.R)), zeros, crossed)
    found = closest(program)
    if found is None or found.proven <= TOLERANCE.proof:
        return None
    return _record(problem, program, found.proven * program.force_scale, found.y, found.w, found.x, crossed)


def _record(
    problem: ForceProblem, program: Program, margin: float, y: Array, w: Array, x: Array, crossed: BoolArray
) -> Infeasibility:
    near = 1e-5
    z = x.reshape(program.k, -1)
    F = z[:, -1]
    at_least: BoolArray
    at_most: BoolArray
    if np.any(crossed):
        forces, torsion, friction = np.zeros((program.k, 3)), np.zeros(program.k), np.zeros(program.k, dtype=bool)
        at_least = at_most = crossed
    else:
        forces, torsion = forces_of(problem, z.ravel(), program.force_scale)
        c = y @ program.A + w @ program.R
        s = program.reduce_costs(c)
        pulls = program.friction.support(c.reshape(program.k, program.d)[:, :-1])
        # A contact takes part where the certificate pushes its force against the limit.
        at_least = (s > near) & (program.lo + near * (1 + program.lo) >= F)
        at_most = (s < -near) & (program.hi - near * (1 + program.hi) <= F)
        friction = (pulls > near) & (program.friction.gauge(z[:, :-1]) >= F * (1 - 1e-3)) & (F > 0)
    joints: tuple[str, ...] = ()
    weights = np.zeros(0)
    if problem.torques is not None:
        joints, weights = problem.torques.limited_joints, np.zeros(len(problem.torques.limit))
        if len(w):
            own = len(joints)  # the others are equations of an underactuated hand
            weights[problem.torques.limited] = w[:own] / program.matrices.R_norm[:own]
    wrench = np.zeros(6)
    wrench[: problem.rows] = y
    return Infeasibility(
        margin=margin,
        direction=read_only(wrench),
        joint_weights=read_only(weights),
        closest_c=read_only(forces),
        closest_torsion=read_only(torsion),
        residual=read_only(problem.residual(forces, torsion)),
        at_least=read_only(at_least),
        at_most=read_only(at_most),
        at_friction=read_only(friction),
        at_torque=tuple(joint for joint, weight in zip(joints, w) if abs(weight) > 1e-5),
        crossed=read_only(crossed),
    )


def load_factors(program: Program) -> tuple[float, float] | None:
    """Least and largest s >= 0 for which s times the load can be held; infinity without a load; None where none is
    found.
    """
    if not np.any(program.b):
        return (0.0, np.inf) if holds(program) else None
    none = replace(program, b=0 * program.b)
    least, largest = extreme_multiple(none, program.b, 1), extreme_multiple(none, program.b, -1)
    return None if least is None or largest is None else (min(least, largest), max(least, largest))


def holds(program: Program, tolerance: float = TOLERANCE.violation) -> bool:
    """Whether some admissible forces balance the load, up to a share ``tolerance`` of the load or the largest F_n."""
    found = closest(program) if np.all(program.lo <= program.hi) else None
    return found is not None and found.left <= tolerance * _size(program, found.x)


def extreme_multiple(program: Program, column: Array, sign: int) -> float | None:
    """Least (sign 1) or largest (sign -1) s >= 0 with A x = b + s column for an admissible x; None where none is found.

    Where the forces of the interior-point method are admissible and its dual proves that no s goes further, s is found.
    Else phase one is solved at the proven bound, where its dual proves a tighter one: Newton's method, from outside.
    """
    n, size = program.k * program.d, float(np.linalg.norm(column))
    column = column / size
    equal = np.hstack([program.A, -column[:, None]])
    positive = np.eye(1, n + 1, n)
    q = np.zeros(n + 1)
    q[n] = sign
    bound, value = _find_bound(program, column, sign, sign * column, np.zeros(len(program.R))), None
    found = solve_linear(program, equal, program.b, q, least=positive, torques=True)
    if found is not None:
        z, y, w = found
        bound = sign * max(sign * bound, sign * _find_bound(program, column, sign, y, w))
        here = replace(program, b=program.b + max(0.0, z[n]) * column)
        if measure_miss(here, here.remove_residual(z[:n], here.A @ z[:n] - here.b)) <= TOLERANCE.violation:
            value = max(0.0, float(z[n]))
            if abs(bound - value) <= _SHARP * max(1.0, bound):
                return value / size
    for _ in range(_NEWTON):
        outside = closest(replace(program, b=program.b + bound * column))
        if outside is None:
            break
        if outside.left <= TOLERANCE.violation * _size(program, outside.x):
            return bound / size
        if outside.proven > TOLERANCE.proof and outside.y @ column * sign <= 0:
            return None  # the proof holds on both sides of the bound
        nearer = _find_bound(program, column, sign, outside.y, outside.w)
        if sign * (nearer - bound) <= 0:
            break
        bound = nearer
    return None if value is None else value / size


def _find_bound(program: Program, column: Array, sign: int, y: Array, w: Array) -> float:
    """No s >= 0 beyond this has admissible forces, for any multipliers: sign s >= y . (A x - b), where y . column =
    sign.

    Multipliers that prove nothing here give the trivial bound: 0 for the least s, infinity for the largest.
    """
    along = float(y @ column) * sign
    if not along > 0:
        return 0.0 if sign > 0 else np.inf
    return max(0.0, sign * program.farkas_bound(y / along, w / along))


def measure_miss(program: Program, x: Array) -> float:
    """By how much x misses balance or limits, relative to the load or the largest F_n, whichever is larger."""
    violation, _, residual = program.violations(x)
    return max(violation, float(np.linalg.norm(residual))) / _size(program, x)


def _size(program: Program, x: Array) -> float:
    return max(1.0, float(x[program.d - 1 :: program.d].max()))
