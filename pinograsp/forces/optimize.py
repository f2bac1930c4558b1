"""The least-cost contact forces at one impact time: solve, certify, or prove that there are none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import ConvexSolution
from pinograsp.forces.solver import ForceSolver


def optimize_forces(
    problem: ForceProblem,
    impact_time: float,
    *,
    objective: str | Mapping[str, float] | None = None,
    backend: str = "auto",
) -> ConvexSolution:
    """The contact forces of least cost for an impact at t_I (method of Eqs. 12-16 with the forces as variables).

    For several loads use :class:`~pinograsp.forces.ForceSolver`, which prepares once. Balance, friction model and
    safety factor, caps, torque limits and deceleration shape are those of the problem.

    Args:
        problem: contacts, load, friction, limits.
        impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
        objective: one of ``"impulse"`` [N s], ``"work"`` [J] (grasp energy, Eqs. 11 and 9), ``"least_squares"`` (sum of
            squared contact forces [N^2]; torsional moments over the moment length), ``"peak"`` (largest F_n [N]),
            ``"motor_heat"`` (sum of squared joint torques [N^2 m^2]; needs ``problem.torques``); or weights
            ``{name: weight}`` of a sum of them. Default: ``problem.measure``. All are convex and solved to optimality.
        backend: a name of :data:`BACKENDS`. ``"auto"``: with the core installed one of its methods, either
            Newton on the dual (``"newton"``; cones, soft fingers and 4-edge pyramids without torque limits) or interior
            points (``"interior"``; all but peak and coupled motor heat); else DAQP up to 20 contacts, Clarabel above.
            Where a backend cannot take the problem, or its answer fails the certificate, DAQP and Clarabel follow; the
            record says which one answered.

    Returns:
        A record with status ``OK`` and its certificate; ``INFEASIBLE`` with a checked proof in ``infeasibility``; or
        ``INACCURATE`` where neither could be certified.

    Raises:
        InvalidInput: an impact time not below t_F, an unknown objective or backend.
        ExtraMissing: a compiled backend was asked for, and the core is not installed.
    """
    started = perf_counter()
    found = ForceSolver(problem, impact_time, objective=objective, backend=backend).solve()
    return replace(found, elapsed=perf_counter() - started)


def warm_up() -> None:
    """Nothing: the core is compiled when it is installed. It stays for programs that still call it, until 0.3."""
