"""The normal forces of least cost that hold every load of a set, as one convex program.

The hand commands the normal forces once; the contacts react to each load. So F_n is common to all loads, and each load
has tangential forces of its own. With the ``"friction"`` reaction F_n does not change; with the ``"elastic"`` one
it is that under the problem's own load, and changes with a load as contacts on equal springs would
(:func:`~pinograsp.forces.matrices.elastic_reaction`): two jaws withstand a push along their own line so.

- for every vertex of a polytope of loads (a list, a box, a range of masses) there are tangential forces; all loads in
  the convex hull are then held, since the friction limits are convex for fixed F_n. This is exact.
- for a ball of disturbances the tangential forces are affine in the disturbance w, u = u_0 + L w with A_t L = -1:
  d . u <= F for all |w| <= r is d . u_0 + r |L' d| <= F. This is sufficient; it needs polyhedral friction (for a cone
  its inscribed 16-sided pyramid).

For friction coefficients within a range the least is the worst case, since every friction limit grows with mu.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from pinograsp.checks import array_of, instance_of, one_of
from pinograsp.contacts import Friction
from pinograsp.contacts.compliance import MEASURES
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import TOLERANCE
from pinograsp.forces.matrices import elastic_reaction, matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.forces import Reaction, RobustForces, SqueezeScenario
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.forces.robust.program import ReactedLoads, RobustProgram
from pinograsp.forces.solve.program import Objective, Program, assemble, energy_terms_at, weights_of
from pinograsp.spatial import Array

_EDGES_FOR_BALLS = 16
_MOST_ADDED, _ADDED = 12, 64  # rounds in which loads of scenarios are added, and how many at once
_FRICTION_ONLY = (*MEASURES, "peak")  # objectives that depend on the common F_n alone


def optimize_robust(
    problem: ForceProblem,
    load_set: LoadSet,
    impact_time: float,
    *,
    mu_range: tuple[float, float] | None = None,
    objective: Objective | None = None,
    reaction: Reaction = "friction",
) -> RobustForces:
    """Find the least-cost normal forces that hold every load of a set, with the contacts reacting to each.

    Args:
        problem: contacts, friction, limits; only the elastic reaction uses its own load.
        load_set: see :class:`LoadSet`.
        impact_time: t_I [s].
        mu_range: least and largest friction coefficient, for all contacts; default: the problem's mu.
        objective: ``"impulse"``, ``"work"``, ``"peak"`` or weights of them, which depend on F_n alone; default: the
            problem's measure.
        reaction: ``"friction"``: the normal forces do not change; ``"elastic"``: they are those under the problem's own
            load, and change as on equal springs. In both cases friction alone reacts to a ball of disturbances.

    Raises:
        InvalidInput: other objectives, crossed ranges, or a ball of disturbances with soft fingers.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> push = [0.1, 0.1, 0.1, 0, 0, 0]  # [N, N m]
        >>> loads = pg.LoadSet.around(problem.load, mass_range=(0.9, 1.2), box=push)
        >>> squeeze = pg.optimize_robust(problem, loads, 0.9, mu_range=(0.5, 0.7))
        >>> print(squeeze.status, squeeze.normal_forces.round(1))
        ok [1.6 1.6 1.6]

    See Also:
        :class:`~pinograsp.forces.LoadSet`, :func:`~pinograsp.forces.optimize_forces`.
    """
    started = time.perf_counter()
    instance_of("problem", problem, ForceProblem)
    instance_of("load set", load_set, LoadSet)
    impact_time = problem.checked_impact_time(impact_time)
    weights = robust_weights(objective, problem)
    one_of("reaction", reaction, get_args(Reaction))
    if mu_range is not None:
        low, high = array_of("mu range", mu_range, (2,))
        if not 0 <= low <= high:
            raise InvalidInput(f"mu range: expected 0 <= least <= largest, got {low:g} and {high:g}")
        problem = replace(problem, mu=np.full(problem.k, low))
    if load_set.ball and not problem.friction.polyhedral:
        if problem.friction.elliptic:
            raise InvalidInput(
                "a ball of disturbances: expected friction 'pyramid' or 'cone', got "
                f"'{problem.friction.model}'; use a box"
            )
        inscribed = Friction(edges=_EDGES_FOR_BALLS, torsion=problem.friction.torsion, safety=problem.friction.safety)
        problem = replace(problem, friction=inscribed)
    found = robust_at(problem, load_set, impact_time, weights, reaction=reaction)
    return replace(found, elapsed=time.perf_counter() - started)


def robust_weights(objective: Objective | None, problem: ForceProblem) -> dict[str, float]:
    """The objective as ``{name: weight}``, or :class:`InvalidInput` where it does not depend on F_n alone."""
    weights = weights_of(objective, problem)
    other = [name for name, weight in weights.items() if weight and name not in _FRICTION_ONLY]
    if other:
        raise InvalidInput(
            f"robust objective: expected {', '.join(_FRICTION_ONLY)} or a weighted sum of these, got "
            f"{', '.join(other)} (of one load alone: no load set, reserve=None)"
        )
    return weights


class Restrictions(NamedTuple):
    """What normal forces keep to besides the limits of their problem.

    Attributes:
        bounds: least and largest F_n (k,), (k,) [N]; None: the problem's at t_I.
        fixed: rows (p, k) and values (p,) [N] of equations on F_n, at the problem's load; None: none.
        scenarios: of other contact stiffness or other drives, in which all loads are held, too; not with a ball.
    """

    bounds: tuple[Array, Array] | None = None
    fixed: tuple[Array, Array] | None = None
    scenarios: Sequence[SqueezeScenario] = ()


def robust_at(
    problem: ForceProblem,
    load_set: LoadSet,
    impact_time: float,
    weights: dict[str, float],
    *,
    reaction: Reaction = "friction",
    restrictions: Restrictions | None = None,
    proven: bool = True,
) -> RobustForces:
    """:func:`optimize_robust` without its checks of the arguments.

    Args:
        problem: with the least mu; polyhedral friction for a ball.
        load_set: see :class:`LoadSet`.
        impact_time: t_I [s].
        weights: :func:`robust_weights`.
        reaction: as for :func:`optimize_robust`.
        restrictions: what else F_n keep to.
        proven: whether to look for a proof where there are no forces; without one they are ``INACCURATE``.
    """
    bounds, fixed, scenarios = restrictions or Restrictions()
    terms = energy_terms_at(problem, weights, impact_time)
    lo, hi = problem.normal_force_range(impact_time) if bounds is None else bounds
    # In force balance loads may differ by moments alone.
    scaled = np.unique(problem.scale_wrenches(load_set.loads), axis=0)
    matrices, own = matrices_of(problem, weights), None
    # The planned forces, under the problem's own load, keep to the torques that the drives make.
    if matrices.fixed or scenarios:
        scaled = np.vstack([problem.scaled_load, scaled])
        own = 0
    changes = np.zeros((len(scaled), problem.k))
    if reaction == "elastic":
        changes = (scaled - problem.scaled_load) @ elastic_reaction(problem).T
        # No contact pulls: said here as well as by friction, the proven bound is sharp.
        lo = np.maximum(lo, -changes.min(axis=0))
        if problem.max_normal_force is not None:
            hi = np.minimum(hi, problem.max_normal_force - np.maximum(changes.max(axis=0), 0.0))
    largest = scaled[np.argmax(np.linalg.norm(scaled, axis=1))]
    program = assemble(matrices, largest, terms, lo, hi)
    reacted = ReactedLoads(
        reaction=reaction,
        loads=scaled,
        changes=changes,
        fixed=fixed or (np.zeros((0, problem.k)), np.zeros(0)),
        own=own,
    )
    if scenarios:
        reacted = _in_scenarios(problem, reacted, scenarios)
        return _solve_by_rows(problem, program, reacted, load_set, impact_time)
    return RobustProgram(problem, program, reacted, load_set, impact_time).solve(proven)


def _solve_by_rows(
    problem: ForceProblem, program: Program, reacted: ReactedLoads, load_set: LoadSet, impact_time: float
) -> RobustForces:
    """The program of many scenarios from those of their loads that matter: what others lack is looked at, and added.

    The bound of some loads is one of all of them.
    """
    whole = RobustProgram(problem, program, reacted, load_set, impact_time)
    count = whole.first
    taken = np.arange(whole.s) < count
    for _ in range(_MOST_ADDED):
        part = RobustProgram(problem, program, reacted.select(taken), load_set, impact_time)
        found = part.solve(False)
        if found.status is not Status.OK or part.found is None or taken.all():
            return found
        F, u = part.found
        # Those of the same load, as it is planned and in the scenarios that were solved.
        near = np.tile(u[:count], (whole.s // count, 1, 1))
        solved = np.array(near)
        solved[taken] = u
        by_load = solved.reshape(-1, count, *u.shape[1:])
        scenarios = taken.reshape(-1, count).any(axis=1)
        tried = [near, *(np.tile(one, (len(by_load), 1, 1)) for one in by_load[scenarios])]
        unmet = np.where(taken, 0.0, whole.find_unmet(F, tried))
        lacking = unmet > TOLERANCE.violation
        if not lacking.any():
            return found
        worst = np.sort(unmet[lacking])[::-1][: max(_ADDED, count)]
        taken = taken | (lacking & (unmet >= worst[-1]))
    return whole.solve(False)


def _in_scenarios(problem: ForceProblem, reacted: ReactedLoads, scenarios: Sequence[SqueezeScenario]) -> ReactedLoads:
    """The loads, and once more for each scenario."""
    k, width = problem.k, problem.friction.scale(problem.mu)
    count, e = len(reacted.loads), width.shape[1]
    common, across = [np.broadcast_to(np.eye(k), (count, k, k))], [np.zeros((count, k, k * e))]
    changes = [reacted.changes]
    for one in scenarios:
        by_u = np.zeros((k, k, e))
        by_u[:, :, :2] = one.tangential.reshape(k, k, 2) * width[:, :2]
        common.append(np.broadcast_to(one.normal, (count, k, k)))
        across.append(np.broadcast_to(by_u.reshape(k, -1), (count, k, k * e)))
        changes.append(reacted.changes + one.offset)
    return replace(
        reacted,
        loads=np.tile(reacted.loads, (1 + len(scenarios), 1)),
        changes=np.concatenate(changes),
        shares=(np.concatenate(common), np.concatenate(across)),
        first=count,
    )
