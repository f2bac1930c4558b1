"""The least-cost contact forces at one impact time: solve, certify, or prove that there are none."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

from pinograsp.checks import instance_of, one_of, record_of
from pinograsp.errors import Status
from pinograsp.forces.backends import FORCE_SOLVERS, solve_certified
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import assemble, energy_terms_at, weights_of
from pinograsp.forces.solution import ForceSolution, solution_of
from pinograsp.forces.solvers import compiled_solvers


def optimize_forces(
    problem: ForceProblem,
    impact_time: float,
    *,
    objective: str | Mapping[str, float] | None = None,
    solver: str = "auto",
) -> ForceSolution:
    """The contact forces of least cost for an impact at t_I (method of Eqs. 12-16 with the forces as variables).

    Balance, friction model and safety factor, caps, torque limits and deceleration shape are the problem's own.

    Args:
        problem: contacts, load, friction, limits.
        impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
        objective: one of ``"impulse"`` [N s], ``"work"`` [J] (grasp energy, Eqs. 11 and 9), ``"least_squares"`` (sum of
            squared contact forces [N^2]; torsional moments over the moment length), ``"peak"`` (largest F_n [N]),
            ``"motor_heat"`` (sum of squared joint torques [N^2 m^2]; needs ``problem.torques``); or weights
            ``{name: weight}`` of a sum of them. Default: ``problem.measure``. All convex, solved to optimality.
        solver: ``"auto"``: after :func:`warm_up` a compiled method: Newton on the dual (``"newton"``; cones, soft
            fingers and 4-edge pyramids without torque limits) or interior points (``"interior"``; all but peak and
            coupled motor heat); else DAQP up to 20 contacts, and Clarabel. Or a name of :data:`FORCE_SOLVERS`. A
            backend that cannot take the problem or whose answer fails its certificate hands over to DAQP and Clarabel;
            the record says which one ran.

    Returns:
        A record with status ``OK`` and its certificate; ``INFEASIBLE`` with a checked proof in ``infeasibility``; or
        ``INACCURATE`` where neither could be certified.

    Raises:
        InvalidInput: an impact time not below t_F, an unknown objective or solver.
    """
    started = time.perf_counter()
    if not isinstance(problem, ForceProblem):
        instance_of("problem", problem, ForceProblem)
    try:  # checked before, when it was prepared
        key = (impact_time, tuple(objective.items()) if isinstance(objective, Mapping) else objective, solver)
        ready = problem._prepared.get(key)
    except TypeError:  # no such thing can be a key
        ready = key = None
    if ready is None:
        impact_time = problem.checked_impact_time(impact_time)
        weights = weights_of(objective, problem)
        one_of("solver", solver, FORCE_SOLVERS)
        compiled = sys.modules.get("pinograsp.forces.compiled")
        if compiled is not None and key is not None:
            ready = compiled.prepare(problem, weights, impact_time, solver, key)
    if ready is not None:
        found = _compiled(problem, ready, started)
        if found is not None:
            return found
        impact_time, weights = ready.impact_time, ready.weights
    terms = energy_terms_at(problem, weights, impact_time)
    program = assemble(problem, weights, terms, *problem.normal_force_range(impact_time))
    outcome = solve_certified(problem, program, solver)
    return solution_of(problem, outcome, impact_time=impact_time, weights=weights, started=started)


def _compiled(problem, ready, started) -> ForceSolution | None:
    """The compiled path's record; None where it has no certified answer."""
    answer = ready.forces(problem.load)
    if answer is None:
        return None
    return record_of(
        ForceSolution,
        {
            "status": Status.OK,
            "problem": problem,
            "search": "convex",
            "solver": answer.solver,
            "weights": dict(ready.weights),
            "impact_time": ready.impact_time,
            "acceleration": answer.acceleration,
            "multipliers": answer.multipliers,
            "forces_c": answer.forces_c,
            "torsion": answer.torsion,
            "residual": answer.certificate.residual,
            "certificate": answer.certificate,
            "elapsed": time.perf_counter() - started,
        },
    )


def warm_up() -> None:
    """Load and compile the solvers made for grasp forces (extra ``fast``), so that ``solver="auto"`` uses them from now
    on.

    Those of :class:`~pinograsp.motion.OnlineForces` and :func:`~pinograsp.forces.solve_batch` as well: nothing is left
    to compile. It takes a minute or two once per machine (the result is cached on disk; NUMBA_CACHE_DIR says where),
    loading some seconds.

    Raises:
        ExtraMissing: numba is not installed.
    """
    compiled_solvers()
    from pinograsp.forces import compiled

    compiled.compile_now()
