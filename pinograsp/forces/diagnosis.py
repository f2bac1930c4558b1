"""Why a grasp cannot hold a load, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import brief, instance_of, read_only
from pinograsp.errors import Status
from pinograsp.forces.certificate import Infeasibility
from pinograsp.forces.infeasibility import holds, load_factors, prove
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.relaxation import LARGEST_FRICTION, Setup, find_relaxations
from pinograsp.forces.solve.program import feasibility
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """Why a grasp can or cannot hold a load at one impact time.

    Attributes:
        status: ``OK`` if the load can be held, else ``INFEASIBLE`` (or ``INACCURATE``: too close to decide).
        impact_time: t_I [s].
        proof: that the load cannot be held; None if it can.
        load_factors: least and largest multiple of the load that can be held; None: none was found.
        smallest_mu: least sufficient friction coefficients (k,), those of the problem times a common factor; None: none
            were found.
        text: the diagnosis in words.
    """

    status: Status
    impact_time: float
    proof: Infeasibility | None
    load_factors: tuple[float, float] | None
    smallest_mu: Array | None
    text: str

    __repr__ = brief()

    def __str__(self) -> str:
        return self.text


def diagnose(problem: ForceProblem, impact_time: float) -> Diagnosis:
    """Explain why a load cannot be held at one impact time [s], or how much more could be held.

    The diagnosis states in which direction forces are missing and how many newtons, the largest load factor, the least
    friction coefficient, and which contacts and limits bind.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.01)
        >>> found = pg.diagnose(problem, 0.9)
        >>> print(found.status, f"mu = {found.smallest_mu[0]:.3f} would do")
        infeasible mu = 0.013 would do

    See Also:
        :func:`~pinograsp.forces.optimize_forces`, :func:`~pinograsp.forces.grasp_margins`.
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


def _smallest_mu(problem: ForceProblem, impact_time: float) -> Array | None:
    """Bisection on a common factor of all mu: the set of forces grows with it."""
    base = problem.mu if np.any(problem.mu > 0) else np.ones(problem.k)

    bounds = problem.normal_force_range(impact_time)

    def enough(largest: float) -> bool:
        return holds(feasibility(replace(problem, mu=base * (largest / base.max())), *bounds))

    lo, hi = 0.0, LARGEST_FRICTION
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


def proof_in_words(problem: ForceProblem, impact_time: float) -> str:
    """Which forces are missing at one impact time [s], and which contacts and limits bind."""
    program = feasibility(problem, *problem.normal_force_range(impact_time))
    return "\n".join(_proof_words(problem, impact_time, prove(problem, program)))


def _words(
    problem: ForceProblem,
    impact_time: float,
    status: Status,
    proof: Infeasibility | None,
    factors: tuple[float, float] | None,
    mu: Array | None,
) -> str:
    if status is Status.OK:
        lines = [f"the load can be held at t_I = {impact_time:.6g} s"]
    else:
        lines = _proof_words(problem, impact_time, proof)
    if factors is None:
        lines.append("  no multiple of this load was found that can be held")
    elif np.isfinite(factors[1]):
        text = f"  the largest load that could be held is {factors[1]:.4g} times this one"
        lines.append(text + (f", the least {factors[0]:.4g} times" if factors[0] > 1e-6 else ""))
    if mu is None:
        lines.append(f"  no friction coefficient up to {LARGEST_FRICTION:g} was found that would suffice")
    elif np.ptp(mu) <= 1e-12 * max(mu.max(), 1.0):
        lines.append(
            f"  the smallest friction coefficient that would suffice is {mu.max():.4g} (given: {problem.mu.max():.4g})"
        )
    else:
        lines.append(f"  the friction coefficients that would just suffice are {np.round(mu, 4).tolist()}")
    if status is not Status.OK:
        lines += _limits_that_would_do(problem, impact_time)
    return "\n".join(lines)


def _limits_that_would_do(problem: ForceProblem, impact_time: float) -> list[str]:
    """The limits of torques and normal forces that would do at one impact time, in words."""
    setup = Setup(replace(problem, impact_time_range=(impact_time, impact_time)), None)

    def does(other: Setup) -> bool:
        low, high = other.problem.normal_force_range(impact_time)
        return bool(np.all(low <= high)) and holds(feasibility(other.problem, low, high))

    options = find_relaxations(setup, does, kinds=1) if not does(setup) else ()
    return [f"  would suffice: {'; and '.join(one.words(setup) for one in option)}" for option in options]


def _proof_words(problem: ForceProblem, impact_time: float, proof: Infeasibility | None) -> list[str]:
    """What is missing, and who is at which limit."""
    names = problem.contacts.names
    lines: list[str] = []
    if proof is None:
        lines.append(
            f"at t_I = {impact_time:.6g} s the load is too close to the limit to decide whether it can be held"
        )
    elif np.any(proof.crossed):
        crossed = ", ".join(name for name, empty in zip(names, proof.crossed) if empty)
        low, high = problem.normal_force_range(impact_time)
        lines.append(
            f"no normal force is admissible at {crossed}: at least {low[proof.crossed].max():.4g} N (the least "
            f"deceleration, or min_normal_force), at most {high[proof.crossed].min():.4g} N"
        )
    else:
        lines.append(
            f"no admissible forces hold the load at t_I = {impact_time:.6g} s: {proof.least_left()}, along "
            f"{_wrench_words(problem, proof.direction)} (proven)"
        )
        for what, mask in (
            ("friction limit", proof.at_friction),
            ("least normal force (least deceleration, Eq. 13c, or the contact's own)", proof.at_least),
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
    return lines


def _wrench_words(problem: ForceProblem, direction: Array) -> str:
    """A unit wrench of the balance rows in words: its force and moment parts."""
    force, moment = direction[:3], direction[3:]
    parts = []
    if np.linalg.norm(force) > 1e-6:
        parts.append(f"force ({', '.join(f'{v:+.3f}' for v in force)})")
    if problem.rows == 6 and np.linalg.norm(moment) > 1e-6:
        parts.append(f"moment about the centre of mass ({', '.join(f'{v:+.3f}' for v in moment)})")
    return " and ".join(parts) or "no direction"
