"""When no forces hold the load: the proof (a Farkas certificate, checked), and what it means in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp.checks import brief, instance_of, read_only
from pinograsp.errors import Status
from pinograsp.forces.conic import limit_rows, solve, solve_linear
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import VIOLATION, Program, feasibility

# A proof counts where its margin exceeds this share of the load: a thousand times the rounding of its closed form.
PROVEN = 1e-11
_SHARP = 1e-7  # between an extreme multiple and its proven bound
_NEWTON = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Infeasibility:
    """Proof that no admissible forces balance the load at one impact time, and the forces that come closest.

    Attributes:
        margin: whatever the forces, at least this much of the net wrench (and of torque beyond its limits) is left [N],
            measured along ``direction``. Checked in closed form; positive.
        direction: wrench (6,) of the certificate, unit in the balance rows [-]: moments over the moment length.
        joint_weights: (n,) part of the certificate on the joint torques [1/m]; zero where torque limits play no part.
            With r the net wrench in the balance rows (moments over the moment length) and tau the joint torques of
            *any* admissible forces, direction . r + joint_weights . tau - |joint_weights| . limit >= margin, though
            balance and limits ask for at most 0.
        closest_c: closest admissible forces (k, 3) [N]; closest_torsion (k,) [N m].
        net_wrench: what they leave (6,) [N, N m].
        at_least, at_most, at_friction: (k,) bool, limits that the closest forces meet, by contact.
        at_torque: names of the joints whose torque limit takes part.
        crossed: (k,) bool, contacts whose bounds on F_n exclude each other.
    """

    margin: float
    direction: np.ndarray
    joint_weights: np.ndarray
    closest_c: np.ndarray
    closest_torsion: np.ndarray
    net_wrench: np.ndarray
    at_least: np.ndarray
    at_most: np.ndarray
    at_friction: np.ndarray
    at_torque: tuple[str, ...]
    crossed: np.ndarray

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closest:
    """Phase one: the admissible x with the least net wrench and torque excess, dimensionless.

    Attributes:
        x: (k d,).
        left: norm of the net wrench, or the limits' largest violation if that is more.
        y, w: the dual (rows,), (m,), a Farkas certificate where ``proven`` > 0.
        proven: lower bound of what is left for all admissible x, in closed form from y and w.
    """

    x: np.ndarray
    left: float
    y: np.ndarray
    w: np.ndarray
    proven: float

    __repr__ = brief()


def closest(program: Program) -> Closest | None:
    """min |(r, s)| with r = A x - b and s the excess of R x over its limits, over the friction cones: always feasible.

    The norm itself, not its square: the dual then stays sharp down to the limit of feasibility. None where the solver
    returns nothing finite.
    """
    n, rows, m = program.k * program.d, len(program.b), len(program.R)
    fixed, fixed_b, linear, linear_b, second, sizes = limit_rows(program)
    extra = rows + m + 1  # r, s and the norm t

    def wide(block, at=None, value=None):
        side = sp.csc_matrix((block.shape[0], extra))
        if value is not None:
            side = sp.lil_matrix(side)
            side[:, at : at + value.shape[1]] = value
        return sp.hstack([block, side])

    one = sp.identity(m)
    norm = sp.lil_matrix((extra, n + extra))
    norm[0, n + extra - 1] = -1.0
    norm[1:, n : n + extra - 1] = -sp.identity(extra - 1)
    parts = [wide(sp.csc_matrix(program.A), 0, -sp.identity(rows)), wide(fixed), wide(linear)]
    if m:
        R = sp.csc_matrix(program.R)
        parts += [wide(R, rows, -one), wide(-R, rows, one)]
    A = sp.vstack([*parts, norm, wide(second)], format="csc")
    b = np.concatenate([program.b, fixed_b, linear_b, program.R_hi, -program.R_lo, np.zeros(extra + second.shape[0])])
    q = np.zeros(n + extra)
    q[-1] = 1.0
    cones = [clarabel.ZeroConeT(rows + len(fixed_b)), clarabel.NonnegativeConeT(len(linear_b) + 2 * m)]
    cones.append(clarabel.SecondOrderConeT(extra))
    found = solve(sp.csc_matrix((len(q),) * 2), q, A, b, cones + [clarabel.SecondOrderConeT(size) for size in sizes])
    z, dual = np.array(found.x), np.array(found.z)
    if not (np.isfinite(z).all() and np.isfinite(dual).all()):
        return None
    x, y = z[:n], dual[:rows]
    at = rows + len(fixed_b) + len(linear_b)
    w = dual[at : at + m] - dual[at + m : at + 2 * m]
    # In theory of length one wherever forces cannot hold the load; near that limit the solver leaves it short.
    size = max(1e-6, float(np.sqrt(y @ y + w @ w)))
    y, w = y / size, w / size
    left = float(np.linalg.norm(program.A @ x - program.b))
    return Closest(x=x, left=max(left, program.violations(x)[0]), y=y, w=w, proven=program.excluded(y, w))


def prove(problem: ForceProblem, program: Program) -> Infeasibility | None:
    """The proof of infeasibility, or None where there is none (the program is feasible, or too close to tell)."""
    crossed = program.lo > program.hi
    if np.any(crossed):
        zeros = np.zeros((problem.k, 3))
        gap = float((program.lo - program.hi).max()) * program.force_scale
        return _record(problem, program, gap, np.zeros(len(program.b)), np.zeros(len(program.R)), zeros, crossed)
    found = closest(program)
    if found is None or found.proven <= PROVEN:
        return None
    return _record(problem, program, found.proven * program.force_scale, found.y, found.w, found.x, crossed)


def forces_of(problem: ForceProblem, x: np.ndarray, force_scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Contact forces (k, 3) [N] and torsional moments (k,) [N m] from a program's x."""
    k, d = problem.k, problem.friction.d
    if "widths" not in problem._assembled:
        widths = np.ones((k, 3))
        widths[:, :2] = problem.friction.scale(problem.mu)[:, :2]
        problem._assembled["widths"] = widths
    z = x.reshape(k, d) * force_scale
    if d == 3:
        return z * problem._assembled["widths"], np.zeros(k)
    torsion = z[:, 2] * problem.friction.scale(problem.mu)[:, 2]
    return z[:, [0, 1, 3]] * problem._assembled["widths"], torsion


def _record(problem, program, margin, y, w, x, crossed) -> Infeasibility:
    near = 1e-5
    z = np.asarray(x).reshape(program.k, -1)
    F = z[:, -1]
    if np.any(crossed):
        forces, torsion, friction = np.zeros((program.k, 3)), np.zeros(program.k), np.zeros(program.k, dtype=bool)
        at_least = at_most = crossed
    else:
        forces, torsion = forces_of(problem, z.ravel(), program.force_scale)
        c = y @ program.A + w @ program.R
        s = program.reduced(c)
        pulls = program.friction.support(c.reshape(program.k, program.d)[:, :-1])
        # A contact matters where the certificate pushes its force against the limit.
        at_least = (s > near) & (program.lo + near * (1 + program.lo) >= F)
        at_most = (s < -near) & (program.hi - near * (1 + program.hi) <= F)
        friction = (pulls > near) & (program.friction.gauge(z[:, :-1]) >= F * (1 - 1e-3)) & (F > 0)
    joints, weights = (), np.zeros(0 if problem.torques is None else len(problem.torques.limit))
    if problem.torques is not None:
        joints = problem.torques.limited_joints
        if len(w):
            weights[problem.torques.limited] = w / problem._assembled["rows"][3]
    wrench = np.zeros(6)
    wrench[: problem.rows] = y
    return Infeasibility(
        margin=margin,
        direction=read_only(wrench),
        joint_weights=read_only(weights),
        closest_c=read_only(forces),
        closest_torsion=read_only(torsion),
        net_wrench=read_only(problem.residual(forces, torsion)),
        at_least=read_only(at_least),
        at_most=read_only(at_most),
        at_friction=read_only(friction),
        at_torque=tuple(joint for joint, weight in zip(joints, w) if abs(weight) > 1e-5),
        crossed=read_only(crossed),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """What stands between a load and a grasp, at one impact time.

    Attributes:
        status: ``OK`` where the load can be held, else ``INFEASIBLE`` (or ``INACCURATE``: too close to tell).
        impact_time: t_I [s].
        proof: the certificate, None where the load can be held.
        load_factors: least and largest multiple of the load that can be held (None: none was found).
        smallest_mu: friction coefficients (k,) that would just do, all scaled alike; None: none was found.
        text: all of it in words.
    """

    status: Status
    impact_time: float
    proof: Infeasibility | None
    load_factors: tuple[float, float] | None
    smallest_mu: np.ndarray | None
    text: str

    __repr__ = brief()

    def __str__(self) -> str:
        return self.text


_LARGEST_FRICTION = 10.0  # beyond any pair of materials: what does not hold then does not hold by friction


def diagnose(problem: ForceProblem, impact_time: float) -> Diagnosis:
    """Why a load cannot be held at one impact time [s] (or how far it is from that).

    Says which direction is missing and by how much, the largest load factor, the least friction coefficient, and which
    contacts and limits bind.
    """
    impact_time = instance_of("problem", problem, ForceProblem).checked_impact_time(impact_time)
    program = feasibility(problem, *problem.normal_force_range(impact_time))
    proof = prove(problem, program)
    held = proof is None and holds(program)
    factors = None if np.any(program.lo > program.hi) else load_factors(program)
    mu = _smallest_mu(problem, impact_time)
    status = Status.OK if held else Status.INFEASIBLE if proof else Status.INACCURATE
    return Diagnosis(
        status=status,
        impact_time=impact_time,
        proof=proof,
        load_factors=factors,
        smallest_mu=mu,
        text=_words(problem, impact_time, status, proof, factors, mu),
    )


def load_factors(program: Program) -> tuple[float, float] | None:
    """Least and largest s >= 0 for which s times the load can be held; infinity for an absent load; None where none is
    found.
    """
    if not np.any(program.b):
        return (0.0, np.inf) if holds(program) else None
    ends = [extreme_multiple(replace(program, b=0 * program.b), program.b, sign) for sign in (1, -1)]
    return None if None in ends else (min(ends), max(ends))


def holds(program: Program, tolerance: float = 1e-8) -> bool:
    """Whether some admissible forces balance the load, up to a share ``tolerance`` of the load or the largest F_n."""
    found = closest(program) if np.all(program.lo <= program.hi) else None
    return found is not None and found.left <= tolerance * _size(program, found.x)


def extreme_multiple(program: Program, column: np.ndarray, sign: int) -> float | None:
    """Least (sign 1) or largest (sign -1) s >= 0 with A x = b + s column for an admissible x; None where none is found.

    Where the forces of the interior-point method are admissible and its dual proves that no s goes further, that is it.
    Else phase one is solved at the proven bound, where its dual proves a nearer one: Newton's method, from outside.
    """
    n, size = program.k * program.d, float(np.linalg.norm(column))
    column = column / size
    equal = sp.hstack([sp.csc_matrix(program.A), sp.csc_matrix(-column[:, None])])
    positive = sp.csc_matrix(([1.0], ([0], [n])), shape=(1, n + 1))
    q = np.zeros(n + 1)
    q[n] = sign
    bound, value = _bound(program, column, sign, sign * column, np.zeros(len(program.R))), None
    found = solve_linear(program, equal, program.b, q, least=positive, torques=True)
    if found is not None:
        z, y, w = found
        bound = sign * max(sign * bound, sign * _bound(program, column, sign, y, w))
        here = replace(program, b=program.b + max(0.0, z[n]) * column)
        if missed(here, here.settled(z[:n], here.A @ z[:n] - here.b)) <= VIOLATION:
            value = max(0.0, float(z[n]))
            if abs(bound - value) <= _SHARP * max(1.0, bound):
                return value / size
    for _ in range(_NEWTON):
        here = closest(replace(program, b=program.b + bound * column))
        if here is None:
            break
        if here.left <= VIOLATION * _size(program, here.x):
            return bound / size
        if here.proven > PROVEN and here.y @ column * sign <= 0:
            return None  # the proof holds on both sides of the bound
        nearer = _bound(program, column, sign, here.y, here.w)
        if sign * (nearer - bound) <= 0:
            break
        bound = nearer
    return None if value is None else value / size


def _bound(program: Program, column: np.ndarray, sign: int, y: np.ndarray, w: np.ndarray) -> float:
    """No s >= 0 beyond this has admissible forces, for any multipliers: sign s >= y . (A x - b), where y . column =
    sign.

    Multipliers that say nothing of this give the farthest bound there is: 0 for the least s, infinity for the largest.
    """
    along = float(y @ column) * sign
    if not along > 0:
        return 0.0 if sign > 0 else np.inf
    return max(0.0, sign * program.excluded(y / along, w / along))


def missed(program: Program, x: np.ndarray) -> float:
    """By how much x misses balance or limits, over the load or the largest F_n, whichever is more."""
    violation, _, residual = program.violations(x)
    return max(violation, float(np.linalg.norm(residual))) / _size(program, x)


def _size(program: Program, x: np.ndarray) -> float:
    return max(1.0, float(x[program.d - 1 :: program.d].max()))


def _smallest_mu(problem: ForceProblem, impact_time: float) -> np.ndarray | None:
    """Bisection on a common factor of all mu: the set of forces grows with it."""
    base = problem.mu if np.any(problem.mu > 0) else np.ones(problem.k)

    bounds = problem.normal_force_range(impact_time)

    def enough(largest: float) -> bool:
        return holds(feasibility(replace(problem, mu=base * (largest / base.max())), *bounds))

    lo, hi = 0.0, _LARGEST_FRICTION
    if np.any(np.greater(*bounds)) or not enough(hi):
        return None
    if enough(lo):
        return np.zeros(problem.k)
    while hi - lo > 1e-5 * hi:
        middle = (lo + hi) / 2 if lo > 0 else hi / 4
        if middle < 1e-6:
            break
        lo, hi = (lo, middle) if enough(middle) else (middle, hi)
    return read_only(base * (hi / base.max()))


def _words(problem, impact_time, status, proof, factors, mu) -> str:
    names = problem.contacts.names
    lines = []
    if status is Status.OK:
        lines.append(f"the load can be held at t_I = {impact_time:.6g} s")
    elif proof is None:
        lines.append(f"at t_I = {impact_time:.6g} s the load is too close to the limit to tell whether it can be held")
    elif np.any(proof.crossed):
        who = ", ".join(name for name, bad in zip(names, proof.crossed) if bad)
        low, high = problem.normal_force_range(impact_time)
        lines.append(
            f"no normal force is admissible at {who}: the least deceleration already gives {low.max():.4g} N, the cap "
            f"allows {high.min():.4g} N; raise the cap, or lower acceleration_range or the duration"
        )
    else:
        lines.append(
            f"no admissible forces hold the load at t_I = {impact_time:.6g} s: at least {proof.margin:.4g} N of net "
            f"wrench is left along {_wrench_words(problem, proof.direction)} (proven)"
        )
        for what, mask in (
            ("friction limit", proof.at_friction),
            ("least normal force (least deceleration, Eq. 13c)", proof.at_least),
        ):
            who = [name for name, meets in zip(names, mask) if meets]
            if who:
                lines.append(f"  at the {what}: {', '.join(who)}")
        for reason in dict.fromkeys(problem.binding_bound(impact_time, int(i)) for i in np.flatnonzero(proof.at_most)):
            who = [
                n for i, n in enumerate(names) if proof.at_most[i] and problem.binding_bound(impact_time, i) == reason
            ]
            lines.append(f"  at the largest normal force, set by {reason}: {', '.join(who)}")
        if proof.at_torque:
            lines.append(f"  at the torque limit: {', '.join(proof.at_torque)}")
    if factors is None:
        lines.append("  no multiple of this load was found that can be held")
    elif np.isfinite(factors[1]):
        text = f"  the largest load that could be held is {factors[1]:.4g} times this one"
        lines.append(text + (f", the least {factors[0]:.4g} times" if factors[0] > 1e-6 else ""))
    if mu is None:
        lines.append(f"  no friction coefficient up to {_LARGEST_FRICTION:g} was found that would do")
    elif np.ptp(mu) <= 1e-12 * max(mu.max(), 1.0):
        lines.append(
            f"  the smallest friction coefficient that would do is {mu.max():.4g} (given: {problem.mu.max():.4g})"
        )
    else:
        lines.append(f"  the friction coefficients that would just do are {np.round(mu, 4).tolist()}")
    return "\n".join(lines)


def _wrench_words(problem: ForceProblem, direction: np.ndarray) -> str:
    """A unit wrench of the balance rows in words: its force and moment parts."""
    force, moment = direction[:3], direction[3:]
    parts = []
    if np.linalg.norm(force) > 1e-6:
        parts.append(f"force ({', '.join(f'{v:+.3f}' for v in force)})")
    if problem.rows == 6 and np.linalg.norm(moment) > 1e-6:
        parts.append(f"moment about the centre of mass ({', '.join(f'{v:+.3f}' for v in moment)})")
    return " and ".join(parts) or "no direction"
