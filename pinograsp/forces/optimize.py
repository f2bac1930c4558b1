"""The least-cost contact forces at one impact time: solve, certify, or prove that there are none."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace
from time import perf_counter

from pinograsp.checks import instance_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import ConvexSolution
from pinograsp.forces.solve.program import Objective
from pinograsp.forces.solve.solver_order import SolverName
from pinograsp.forces.solver import ForceSolver, certify_by_core

_MOST = 4  # impact times, objectives and solvers for which a problem's preparations are kept


def optimize_forces(
    problem: ForceProblem,
    impact_time: float,
    *,
    objective: Objective | None = None,
    solver: SolverName = "auto",
) -> ConvexSolution:
    """Find the contact forces of least cost for an impact at t_I (method of Eqs. 12-16 with the forces as variables).

    Everything that does not depend on the load is prepared once and kept with the problem; ``problem.with_load(load)``
    shares it. Balance, friction model and safety factor, caps, torque limits and deceleration shape are those of the
    problem.

    Args:
        problem: contacts, load, friction, limits.
        impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
        objective: one of ``"impulse"`` [N s], ``"work"`` [J] (grasp energy, Eqs. 11 and 9), ``"least_squares"`` (sum of
            squared contact forces [N^2]; torsional moments over the moment length), ``"peak"`` (largest F_n [N]),
            ``"motor_heat"`` (sum of squared joint torques [N^2 m^2]; needs ``problem.torques``); or weights
            ``{name: weight}`` of a sum of them. Default: ``problem.measure``. All are convex and solved to optimality.
        solver: a name of :func:`~pinograsp.forces.available_solvers`: a compiled method, any solver that qpsolvers
            finds, or one of your own (:func:`~pinograsp.forces.register_solver`). QP solvers handle grasp energies and
            friction cones as a sequence of QPs, Clarabel handles both directly. ``"auto"`` uses one of the core's
            methods if the core is installed: either Newton on the dual (``"newton"``; grasp energies and, except for
            soft fingers, least squares, with torque limits or without) or interior points (``"interior"``; also peak
            and motor heat, but not the heat of joints that several contacts load). Otherwise it uses DAQP up to 20
            contacts and Clarabel above. If a solver does not support the problem, or its answer fails the certificate,
            DAQP and Clarabel follow; the record names the one that answered.

    Returns:
        A record with status ``OK`` and its certificate; ``INFEASIBLE`` with a checked proof in ``infeasibility``;
        or ``INACCURATE`` if neither could be certified.

    Raises:
        InvalidInput: an impact time not below t_F, an unknown objective or solver.
        ExtraMissing: you asked for a compiled solver, and the core is not installed.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> found = pg.optimize_forces(problem, 0.9)
        >>> print(found.status, found.normal_forces.round(1), found.certificate.is_optimal())
        ok [1.1 1.1 1.1] True

    See Also:
        :func:`~pinograsp.forces.optimize_grasp` over all impact times; :class:`~pinograsp.forces.ForceSolver` for many
        loads.
    """
    started = perf_counter()
    instance_of("problem", problem, ForceProblem)
    kept = problem.preparations
    key: Hashable = impact_time, tuple(objective.items()) if isinstance(objective, Mapping) else objective, solver
    try:
        known = kept.get(key)
    except TypeError:  # what cannot be looked up is refused below
        known = key = None
    if known is not None:
        prepared, weights, at = known
        found = certify_by_core(prepared, problem, weights, at, started)
        if found is not None:
            return found
    fresh = ForceSolver(problem, impact_time, objective=objective, solver=solver)
    if key is not None and fresh.prepared is not None:
        while len(kept) >= _MOST:
            kept.pop(list(kept)[0], None)  # noqa: RUF015  # another thread may change it meanwhile
        kept[key] = fresh.prepared, fresh.weights, fresh.impact_time
    return replace(fresh.solve(), elapsed=perf_counter() - started)
