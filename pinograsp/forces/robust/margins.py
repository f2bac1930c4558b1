"""Margins of a given grasp: how much more load it holds, and how near its contacts are to slipping.

With the normal forces fixed (as commanded to the hand) only friction reacts to a change of the load; or the contacts
give way as equal springs, too: see :mod:`pinograsp.forces.robust.optimum`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, at_least_zero, brief, instance_of, number, one_of, read_only
from pinograsp.contacts.inscribed_ball import InscribedBall, inscribed_ball
from pinograsp.errors import InvalidInput
from pinograsp.forces.certificate import TOLERANCE
from pinograsp.forces.infeasibility import extreme_multiple, holds, measure_miss
from pinograsp.forces.matrices import elastic_reaction
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.forces import Reaction
from pinograsp.forces.solution import ForceSolution
from pinograsp.forces.solve.conic import cone_rows, solve_linear
from pinograsp.forces.solve.program import Program, feasibility
from pinograsp.spatial import Array, IntArray
from pinograsp.words import lines_of

# Relative to the load: optimal forces keep friction limits to a tenth of it, and the balance to a hundredth.
_HELD = 10 * TOLERANCE.violation
# Relative to the load: optimal forces lie *on* their friction limits, so margins near zero are common.
_NEGLIGIBLE = 1e-5
_ANY = 1e4  # times the load: more than any grasp withstands, where it withstands anything
_ROUGH = 2e-2  # accuracy of a ball of wrenches whose support points are programs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspMargins:
    """Margins of one set of contact forces.

    Attributes:
        friction_used: share of its friction limit that each contact uses (k,) [-]; above 1 it slips. Infinite if there
            is tangential force without friction. The safety factor plays *no* part: the limit is mu itself.
        least_mu: friction coefficient that each contact's force needs (k,) [-].
        slip_distance: least change of its force that makes a contact slip (k,) [N]; negative: it slips.
        load_factor: largest multiple of the load held with these normal forces, friction reacting within the torque
            limits [-]; infinite without load; 0 if not even the load itself is held.
        disturbance: largest wrench in *any* direction that may be added to the load, friction reacting [N, moments over
            the moment length], bounded from both sides, with the weakest direction (with springs: bounded from below
            only; the optimum is the interior-point method's). Torque limits are not part of this and of the next two
            values.
        disturbance_force: the same for pure forces through the centre of mass [N].
        disturbance_moment: the same for pure moments [N m]; None in force balance.
    """

    friction_used: Array
    least_mu: Array
    slip_distance: Array
    load_factor: float
    disturbance: InscribedBall
    disturbance_force: float
    disturbance_moment: float | None

    __repr__ = brief()

    def __str__(self) -> str:
        moment = "" if self.disturbance_moment is None else f", or {self.disturbance_moment:.3g} N m about any axis"
        used = ", ".join(f"{100 * one:.0f} %" for one in self.friction_used.tolist())
        return lines_of(
            f"holds {self.load_factor:.3g} times the load; besides it {self.disturbance_force:.3g} N in any direction"
            f"{moment}",
            f"friction used: {used}",
            f"least distance to slipping {float(self.slip_distance.min()):.3g} N",
        )


def grasp_margins(solution: ForceSolution, *, tolerance: float = 1e-6, reaction: Reaction = "friction") -> GraspMargins:
    """Compute the margins of the forces of a solution, within its problem's friction model at full mu (safety factor 1)
    and full torque limits.

    Args:
        solution: forces that hold the load.
        tolerance: relative accuracy of ``disturbance`` [-].
        reaction: of the contacts to additional loads: ``"friction"`` alone, or ``"elastic"``, as for
            :func:`~pinograsp.forces.optimize_robust`.

    Raises:
        InvalidInput: a solution without forces, or another reaction.

    Example:
        >>> import pinograsp as pg
        >>> friction = pg.Friction(model="cone", safety=1.5)
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6, friction=friction)
        >>> margins = pg.grasp_margins(pg.optimize_forces(problem, 0.9))
        >>> print(f"holds {margins.load_factor:.2f} times the load")
        holds 1.50 times the load

    See Also:
        :func:`~pinograsp.forces.diagnose`, :func:`~pinograsp.forces.force_closure`.
    """
    instance_of("solution", solution, ForceSolution)
    tolerance = number("tolerance", tolerance, above=0)
    one_of("reaction", reaction, get_args(Reaction))
    if not solution.found:
        raise InvalidInput(f"margins: expected a solution with forces, got status '{solution.status}'")
    problem = _drop_safety(solution.problem)
    friction, F = problem.friction, solution.normal_forces
    scale = friction.scale(problem.mu)
    tangential = np.linalg.norm(solution.forces_c[:, :2], axis=1)
    local = np.column_stack([solution.forces_c[:, :2], solution.torsion])[:, : friction.d - 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        used = friction.gauge(np.where(scale > 0, local / np.where(scale > 0, scale, 1.0), 0.0)) / F
        least_mu = np.where(tangential > 0, tangential / F, 0.0)
    used = np.where(np.any((scale == 0) & (np.abs(local) > 1e-12), axis=1), np.inf, np.where(F > 0, used, 0.0))
    # Distance to the exact cone's surface: |f_t| = mu F_n is a plane in the (|f_t|, F_n) half-plane.
    slip = (problem.mu * F - tangential) / np.hypot(1.0, problem.mu)
    program = _at(problem, F)
    springs = elastic_reaction(problem) if reaction == "elastic" else np.zeros((problem.k, problem.rows))
    factor = 0.0
    if holds(program, _HELD):
        factor = 1.0 + _find_reach(program, program.b, springs) if np.any(program.b) else np.inf
    program = _at(replace(problem, torques=None), F)
    ball = (
        _disturbances(program, tolerance)
        if reaction == "friction"
        else _section(program, np.arange(problem.rows), springs)
    )
    force = _section(program, np.arange(3), springs).lower if problem.rows == 6 else ball.lower
    moment = _section(program, np.arange(3, 6), springs).lower if problem.rows == 6 else None
    unit = program.force_scale
    return GraspMargins(
        friction_used=read_only(used),
        least_mu=read_only(least_mu),
        slip_distance=read_only(slip),
        load_factor=factor,
        disturbance=replace(ball, lower=ball.lower * unit, upper=ball.upper * unit),
        disturbance_force=force * unit,
        disturbance_moment=None if moment is None else moment * unit * problem.moment_length,
    )


def load_factor(
    problem: ForceProblem, *, normal_forces: ArrayLike | None = None, impact_time: float | None = None
) -> float:
    """Find the largest multiple of the load that can be held [-]: 1 is just the load, 0 if not even that can be held.

    Args:
        problem: contacts, load, friction, limits.
        normal_forces: F_n (k,) [N], fixed: friction alone reacts.
        impact_time: t_I [s]; the forces are free within their limits there. Either this or ``normal_forces``.

    Raises:
        InvalidInput: no load; both or neither of ``normal_forces`` and ``impact_time``.
    """
    instance_of("problem", problem, ForceProblem)
    return 1.0 + disturbance_margin(problem, problem.load, normal_forces=normal_forces, impact_time=impact_time)


def disturbance_margin(
    problem: ForceProblem,
    direction: ArrayLike,
    *,
    normal_forces: ArrayLike | None = None,
    impact_time: float | None = None,
    reaction: Reaction = "friction",
) -> float:
    """Find the largest s [-] for which the load plus s times ``direction`` can be held; -1 if not even the load can.

    Args:
        problem: contacts, load, friction, limits.
        direction: of the disturbance (6,) [N, N m].
        normal_forces: F_n (k,) [N] under the load; the contacts react to the addition.
        impact_time: t_I [s]; the forces are free within their limits there. Either this or ``normal_forces``.
        reaction: with ``normal_forces``: ``"friction"`` alone, or ``"elastic"``, as for
            :func:`~pinograsp.forces.optimize_robust`.

    Raises:
        InvalidInput: a direction that is zero; both or neither of ``normal_forces`` and ``impact_time``.
    """
    (margin,) = disturbance_margins(
        problem,
        array_of("direction", direction, (6,))[None],
        normal_forces=normal_forces,
        impact_time=impact_time,
        reaction=reaction,
    )
    return float(margin)


def disturbance_margins(
    problem: ForceProblem,
    directions: ArrayLike,
    *,
    normal_forces: ArrayLike | None = None,
    impact_time: float | None = None,
    reaction: Reaction = "friction",
) -> Array:
    """Compute :func:`disturbance_margin` (m,) in several directions (m, 6); the load is checked once."""
    instance_of("problem", problem, ForceProblem)
    scaled = problem.scale_wrenches(array_of("directions", directions, (None, 6)))
    if not np.all(np.any(scaled, axis=1)):
        raise InvalidInput("direction: expected a wrench that is not zero in the balance rows")
    if (normal_forces is None) == (impact_time is None):
        raise InvalidInput("margin: expected normal_forces (fixed) or impact_time (forces free), one of them")
    one_of("reaction", reaction, get_args(Reaction))
    if impact_time is None:
        normal = at_least_zero("normal forces", array_of("normal forces", normal_forces, (problem.k,)))
        springs = elastic_reaction(problem) if reaction == "elastic" else np.zeros((problem.k, problem.rows))
        program = _at(problem, normal)
    else:
        springs = np.zeros((problem.k, problem.rows))
        program = feasibility(problem, *problem.normal_force_range(problem.checked_impact_time(impact_time)))
    if np.any(program.lo > program.hi) or not holds(program, _HELD):
        return np.full(len(scaled), -1.0)
    return np.array([_find_reach(program, -one / program.force_scale, springs) for one in scaled])


def _find_reach(program: Program, column: Array, springs: Array) -> float:
    """Largest s >= 0 with forces that balance b + s column, at the program's F_n where that is fixed; it is held at
    s = 0.

    ``springs`` (k, rows): change of F_n per unit of a wrench that is added to the load.
    """
    if not np.any(springs):
        return extreme_multiple(program, column, -1) or 0.0
    n, size = program.k * program.d, float(np.linalg.norm(column))
    column = column / size
    free, added, changes = _sprung(program, -column[:, None], springs)
    # Columns: x, s and what it lacks to more than any margin that matters.
    total = np.zeros((1, n + 2))
    total[0, n:] = 1.0
    equal = np.vstack([np.hstack([added, np.zeros((len(added), 1))]), total])
    q = np.zeros(n + 2)
    q[n] = -1.0
    found = solve_linear(
        free, equal, np.concatenate([program.b, program.lo, [_ANY]]), q, least=np.eye(2, n + 2, n), torques=True
    )
    if found is None:
        return 0.0
    x, s = found[0][:n], float(found[0][n])
    x[program.d - 1 :: program.d] = program.lo + s * changes[:, 0]
    here = replace(free, b=program.b + s * column)
    if not s > 0 or measure_miss(here, here.remove_residual(x, here.A @ x - here.b)) > _HELD:
        return 0.0
    return np.inf if s > _ANY * (1 - 1e-3) else s / size


def _sprung(program: Program, pick: Array, springs: Array) -> tuple[Program, Array, Array]:
    """The program with F_n as on springs under wrenches ``pick`` (rows, m) w that are added to the load.

    Returns the program with F_n free, the rows (rows + k, k d + m) on (x, w) that are (b, F_n as it was), and the
    changes of F_n per w (k, m).
    """
    changes = springs @ pick
    select = cone_rows(program.matrices).select
    free = replace(program, lo=np.zeros(program.k), hi=np.full(program.k, _ANY))
    return free, np.block([[program.A, pick], [select, -changes]]), changes


def _drop_safety(problem: ForceProblem) -> ForceProblem:
    """The problem at full mu and full torque limits, whatever the drives can choose under a disturbance."""
    friction, torques = problem.friction, problem.torques
    if torques is not None and (torques.headroom or torques.underactuation):
        torques = replace(torques, headroom=0.0, underactuation=None)
    if friction.safety == 1.0 and torques is problem.torques:
        return problem
    return replace(problem, friction=replace(friction, safety=1.0), torques=torques)


def _at(problem: ForceProblem, normal: Array) -> Program:
    """The program with F_n fixed at ``normal``."""
    return feasibility(problem, normal, normal)


def _disturbances(program: Program, tolerance: float) -> InscribedBall:
    """Largest ball in the set of disturbances {b - A x} that friction holds at the program's F_n."""
    columns = program.A.reshape(len(program.b), program.k, program.d)
    F = program.lo
    centre = program.b - columns[:, :, -1] @ F

    def support_point(y: Array) -> Array:
        u = program.friction.support_point(np.einsum("r,rkc->kc", y, columns[:, :, :-1]))
        point: Array = np.einsum("rkc,kc->r", columns[:, :, :-1], u * F[:, None]) + centre
        return point

    return inscribed_ball(support_point, len(program.b), tolerance=tolerance, floor=_NEGLIGIBLE)


def _section(program: Program, rows: IntArray, springs: Array) -> InscribedBall:
    """Largest ball of disturbances in some rows, the others being zero: lower bound within 1e-3; 0 where not held."""
    n, count = program.k * program.d, len(program.b)
    pick = np.zeros((count, len(rows)))
    pick[rows, range(len(rows))] = 1.0
    free, equal, changes = program, np.hstack([program.A, pick]), np.zeros((program.k, len(rows)))
    right = program.b
    if np.any(springs):
        free, equal, changes = _sprung(program, pick, springs)
        right = np.concatenate([program.b, program.lo])
    held = True

    def support_point(y: Array) -> Array:
        nonlocal held
        found = solve_linear(free, equal, right, np.concatenate([np.zeros(n), -y]))
        if found is not None:
            x, wrench = found[0][:n], found[0][n:]
            x[program.d - 1 :: program.d] = program.lo + changes @ wrench
            here = replace(free, b=program.b - pick @ wrench)
            if measure_miss(here, here.remove_residual(x, here.A @ x - here.b)) <= _HELD:
                return wrench
        held = False
        return np.zeros(len(rows))

    ball = inscribed_ball(support_point, len(rows), tolerance=1e-3 if len(rows) < 6 else _ROUGH, floor=_NEGLIGIBLE)
    return ball if held else replace(ball, lower=0.0, upper=0.0, converged=False)
