"""Contact points that move downhill on the object's surface, by the derivatives of the optimal cost."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import brief, instance_of, number
from pinograsp.contacts import ContactSet
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.optimize import optimize_forces
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.sensitivity import Sensitivity, force_sensitivity
from pinograsp.forces.solution import ConvexSolution
from pinograsp.forces.solve.program import Objective
from pinograsp.forces.solve.solver_order import SolverName
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, tangent_frame

_STEPS, _SHRINKS, _ROUNDS = 60, 12, 10
_PROBE = 1e-6  # [m] step of the finite differences for the surface's curvature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BetterContacts:
    """Contacts moved on the object's surface.

    Attributes:
        contacts: the moved contacts, without links or posture.
        problem: the problem with these contacts.
        solution: its optimum.
        costs: at the start and after each step.
    """

    contacts: ContactSet
    problem: ForceProblem
    solution: ConvexSolution
    costs: tuple[float, ...]

    __repr__ = brief()


def optimize_contacts(
    problem: ForceProblem,
    object: Body,
    impact_time: float,
    *,
    objective: Objective | None = None,
    reach: float = 0.01,
    tolerance: float = 1e-6,
    solver: SolverName = "auto",
) -> BetterContacts:
    """Move contact points on the surface, each by at most ``reach``, to a local minimum of the certified cost.

    The method is steepest descent with the gradients of :func:`force_sensitivity`, including the curvature of the
    surface. It does not check whether a hand reaches the new contacts (see ``contact_postures``).

    Args:
        problem: contacts and limits.
        object: a shape of :mod:`pinograsp.objects`, on whose surface the contacts are.
        impact_time: t_I [s].
        objective: as for :func:`optimize_forces`.
        reach: largest distance of a contact from its start [m].
        tolerance: the search ends when a step lowers the cost by a smaller share [-].
        solver: as for :func:`optimize_forces`.

    Raises:
        InvalidInput: contacts that do not hold the load at the start, or a problem that :func:`force_sensitivity` does
            not support.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("object", object, Body)
    reach = number("reach", reach, above=0, unit="m")
    tolerance = number("tolerance", tolerance, at_least=0)
    known = replace(problem, moment_length=problem.moment_length)
    solution = optimize_forces(known, impact_time, objective=objective, solver=solver)
    if _cost(solution) == np.inf:
        raise InvalidInput(f"optimize_contacts: expected contacts that hold the load at first, got '{solution.status}'")
    start = np.array(problem.contacts.points_o)
    costs, length = [_cost(solution)], 0.1 * reach
    for _ in range(_STEPS):
        points = np.array(known.contacts.points_o)
        gradient = _on_surface(force_sensitivity(solution), object, points)
        steepest = float(np.abs(gradient).max())
        if steepest == 0:
            break
        better = None
        for _ in range(_SHRINKS):
            tried = _move(known, object, points - length / steepest * gradient, start, reach)
            found = optimize_forces(tried, impact_time, objective=objective, solver=solver)
            if _cost(found) < costs[-1]:
                better = tried, found
                length *= 1.5
                break
            length *= 0.4
        if better is None:
            break
        known, solution = better
        costs.append(_cost(solution))
        if costs[-2] - costs[-1] <= tolerance * costs[-1]:
            break
    return BetterContacts(contacts=known.contacts, problem=known, solution=solution, costs=tuple(costs))


def _cost(solution: ConvexSolution) -> float:
    """The certified cost; infinite where there is none."""
    certificate = solution.certificate
    return float("inf") if certificate is None or solution.status is not Status.OK else certificate.objective


def _on_surface(sensitivity: Sensitivity, body: Body, points: Array) -> Array:
    """Gradient of the cost over tangential moves of the contacts (k, 3), normals following the surface."""
    _, normals, _ = body.project(points)
    gradient = np.zeros_like(points)
    for i, normal in enumerate(normals):
        for tangent in tangent_frame(normal).T[:2]:
            ends = np.array([points[i] + _PROBE * tangent, points[i] - _PROBE * tangent])
            turn = np.cross(normal, np.subtract(*body.project(ends)[1]) / (2 * _PROBE))
            gradient[i] += (sensitivity.cost_points[i] @ tangent + sensitivity.cost_turns[i] @ turn) * tangent
    return gradient


def _move(problem: ForceProblem, body: Body, points: Array, start: Array, reach: float) -> ForceProblem:
    """The problem with its contacts at the surface's points nearest to ``points``, none farther than ``reach`` from its
    start.
    """
    for _ in range(_ROUNDS):  # a point that is moved back within reach leaves the surface slightly
        way = body.project(points)[0] - start
        far = np.linalg.norm(way, axis=1)
        if far.max() <= reach:
            break
        points = start + way * np.minimum(1.0, 0.9999 * reach / np.maximum(far, 1e-300))[:, None]
    surface, normals, _ = body.project(points)
    contacts = tuple(
        replace(
            contact, point_o=point, rotation_oc=tangent_frame(normal, problem.gravity_o), distance=0.0, point_l=None
        )
        for contact, point, normal in zip(problem.contacts, surface, normals)
    )
    return replace(problem, contacts=ContactSet(contacts=contacts, com_o=problem.contacts.com_o))
