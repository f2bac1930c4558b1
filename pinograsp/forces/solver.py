"""Least-cost contact forces for one load after another: prepare once, solve many times."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import frozen, instance_of, record_of
from pinograsp.errors import Status
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import ConvexSolution, solution_of
from pinograsp.forces.solve.compiled import PreparedForces
from pinograsp.forces.solve.program import Objective, assemble, energy_terms_at, weights_of
from pinograsp.forces.solve.solver_order import SolverName, SolverOrder, check_solver

_NONE_C, _NONE = frozen(np.zeros((0, 3))), frozen(np.zeros(0))


class ForceSolver:
    """The forces of least cost at one impact time, for one load after another.

    Everything that does not depend on the load is prepared once and kept with the solver; answers do not depend on
    previous ones.

    Attributes:
        problem: contacts, friction and limits; its load is the default one.
        impact_time: t_I [s].
        weights: the objective, ``{name: weight}``.
        solvers: names of the methods, in the order in which they are tried.
        prepared: everything except the load, in the core; None if the core does not support these problems.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> solver = pg.ForceSolver(problem, 0.9)
        >>> for share in (1.0, 2.0):
        ...     print(solver.solve(share * problem.load).normal_forces.round(1))
        [1.1 1.1 1.1]
        [2.2 2.2 2.2]

    See Also:
        :func:`~pinograsp.forces.optimize_forces`, :class:`~pinograsp.motion.OnlineForces`,
        :func:`~pinograsp.forces.solve_batch`.
    """

    def __init__(
        self,
        problem: ForceProblem,
        impact_time: float,
        *,
        objective: Objective | None = None,
        solver: SolverName = "auto",
    ):
        """Prepare everything that does not depend on the load.

        Args:
            problem: contacts, load, friction, limits.
            impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
            objective: as for :func:`~pinograsp.forces.optimize_forces`.
            solver: as for :func:`~pinograsp.forces.optimize_forces`.

        Raises:
            InvalidInput: an impact time not below t_F, an unknown objective or solver.
            ExtraMissing: you asked for a compiled solver, and the core is not installed.
        """
        self.problem = instance_of("problem", problem, ForceProblem)
        self.impact_time = problem.checked_impact_time(impact_time)
        self.weights = weights_of(objective, problem)
        check_solver(solver)
        self._matrices = matrices_of(problem, self.weights)
        self._order = SolverOrder(self._matrices, solver)
        self.solvers = self._order.order
        self._terms = energy_terms_at(problem, self.weights, self.impact_time)
        self._bounds = problem.normal_force_range(self.impact_time)
        self.prepared = self._order.prepare(problem, self._terms, self._bounds)

    def solve(self, load: ArrayLike | None = None) -> ConvexSolution:
        """The forces for a load (6,), linear first, about the centre of mass, world axes [N, N m].

        Args:
            load: default: the problem's.

        Returns:
            A record with status ``OK`` and its certificate; ``INFEASIBLE`` with a checked proof in
            ``infeasibility``; or ``INACCURATE`` if neither could be certified.

        Raises:
            InvalidInput: a load that is not six finite numbers.
        """
        started = time.perf_counter()
        problem = self.problem if load is None else self.problem.with_load(load)
        found = certify_by_core(self.prepared, problem, self.weights, self.impact_time, started)
        if found is not None:
            return found
        program = assemble(self._matrices, problem.scaled_load, self._terms, *self._bounds)
        outcome = self._order.solve(problem, program, tried=self.prepared is not None)
        return solution_of(problem, outcome, impact_time=self.impact_time, weights=self.weights.copy(), started=started)


def certify_by_core(
    prepared: PreparedForces | None,
    problem: ForceProblem,
    weights: Mapping[str, float],
    impact_time: float,
    started: float,
) -> ConvexSolution | None:
    """The core's certified forces, or its proof that there are none; None where it has neither.

    ``prepared``: for this problem under any load.
    """
    if prepared is None:
        return None
    found = prepared.forces(problem.load)
    proof = prepared.prove(problem.load) if found is None else None
    values: dict[str, object]
    if proof is not None:
        values = {
            "status": Status.INFEASIBLE,
            "solver": prepared.method,
            "impact_time": None,
            "forces_c": _NONE_C,
            "torsion": _NONE,
            "certificate": None,
            "infeasibility": proof,
        }
    elif found is not None:
        values = {
            "status": Status.OK,
            "solver": found.solver,
            "impact_time": impact_time,
            "forces_c": found.forces_c,
            "torsion": found.torsion,
            "certificate": found.certificate,
        }
    else:
        return None
    values |= {
        "problem": problem,
        "search": "convex",
        "weights": dict(weights),
        "elapsed": time.perf_counter() - started,
    }
    return record_of(ConvexSolution, values)
