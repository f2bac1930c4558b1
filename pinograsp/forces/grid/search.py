"""The three grid searches: the paper's grid, the grid followed by the QP, the hybrid."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

from pinograsp.checks import instance_of, one_of
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.grid.cells import GridSpec, brute_force
from pinograsp.forces.grid.pruned import hybrid_search, pruned_search
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import GridSolution
from pinograsp.forces.solve.multipliers import refine_multipliers
from pinograsp.forces.solve.solvers import QPSolverName, check_qp_solver

GridSearch: TypeAlias = Literal["hybrid", "paper", "paper+qp"]
GridMethod: TypeAlias = Literal["pruned", "brute"]
SEARCHES: tuple[GridSearch, ...] = get_args(GridSearch)
METHODS: tuple[GridMethod, ...] = get_args(GridMethod)


def grid_search(
    problem: ForceProblem,
    grid: GridSpec | None = None,
    *,
    search: GridSearch = "hybrid",
    method: GridMethod = "pruned",
    solver: QPSolverName = "daqp",
    progress: bool | None = None,
) -> GridSolution:
    """Least-energy contact forces on a grid.

    Args:
        problem: contacts, load, friction, limits.
        grid: the grid; default: the case study's ranges, A in steps of 0.005 m/s^2, k in steps of 0.1.
        search: ``"hybrid"`` (default): grid over (t_I, A), the QP over (k1, k2) deciding each cell.
            ``"paper"``: the paper's grid over (t_I, A, k1, k2) with its net-force limit (steps 1-14).
            ``"paper+qp"``: the same, then the QP over (k1, k2) at the normal forces found.
        method: how the paper's grid is searched, ``"pruned"`` (exact, fast) or ``"brute"`` (every point); the result is
            the same.
        solver: QP solver, one of :func:`~pinograsp.forces.solve.solvers.qp_solvers`.
        progress: progress bar on stderr: None (long searches on a terminal), True or False.

    Returns:
        A record with its :class:`~pinograsp.errors.Status`; for an infeasible grid too, without an exception. Ctrl-C
        ends the search with status ``INTERRUPTED`` and the best point so far.

    Raises:
        InvalidInput: an unknown search, method or solver.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6, friction=pg.Friction())
        >>> found = pg.grid_search(problem)
        >>> print(found.status, found.normal_forces.round(2))
        ok [1.55 1.55 1.55]

    See Also:
        :class:`~pinograsp.forces.GridSpec`; :func:`~pinograsp.forces.optimize_grasp` needs no grid.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("grid", grid, GridSpec, type(None))
    instance_of("progress", progress, bool, type(None))
    one_of("search", search, SEARCHES)
    check_qp_solver(solver)
    one_of("method", method, METHODS)
    bounded = problem.min_normal_force is not None or problem.max_normal_force is not None
    if not problem.friction.is_paper or bounded or problem.torques is not None:
        raise InvalidInput(
            "grid search: expected the paper's friction pyramid, no least or largest F_n and no torque limits; for "
            "these use optimize_forces or optimize_grasp (search='convex')"
        )
    grid = GridSpec() if grid is None else grid
    if search == "hybrid":
        return hybrid_search(problem, grid, solver=solver, progress=progress)
    if method == "brute":
        found = brute_force(problem, grid, progress=progress)
    else:
        found = pruned_search(problem, grid, solver=solver, progress=progress)
    return refine_search(found, solver) if search == "paper+qp" and found.found else found


def refine_search(solution: GridSolution, solver: QPSolverName = "daqp") -> GridSolution:
    """``solution`` with its multipliers replaced by the QP's; status ``UNBALANCED`` where its F_n admit no balance."""
    started = time.perf_counter()
    refinement = refine_multipliers(solution.problem, solution.normal_forces, solver=solver)
    bound, solves = refinement.certificate.lower_bound, solution.grid.qp_solves + 1
    return replace(
        solution,
        status=refinement.status if solution.status is Status.OK else solution.status,
        search="paper+qp",
        solver=solver,
        forces_c=refinement.forces_c,
        grid=replace(solution.grid, residual_bound=bound, qp_solves=solves),
        elapsed=solution.elapsed + time.perf_counter() - started,
    )
