"""A force problem written for other solvers, and their answers judged."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

from pinograsp.checks import instance_of, read_only
from pinograsp.errors import Status
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solution import ConvexSolution, solution_of
from pinograsp.forces.solve.active_set import DenseMethod
from pinograsp.forces.solve.answers import ProgramAnswer, certify_answer
from pinograsp.forces.solve.conic import ConicMethod, exponents_of
from pinograsp.forces.solve.program import Objective, Program, program_at, weights_of
from pinograsp.forces.solve.solver_order import ProgramOutcome
from pinograsp.forces.solve.standard_form import NORMAL, Column, ForceQP, ForceSOCP, ScaledForces
from pinograsp.spatial import Array


def to_qp(problem: ForceProblem, impact_time: float, *, objective: Objective | None = None) -> ForceQP:
    """Return the force program at t_I [s] as a quadratic program (for pyramids); see :class:`ForceQP`.

    It includes caps, torque limits, underactuation and every objective of ``optimize_forces`` except grasp energies.
    Grasp energies are sums of powers of F_n (Eqs. 9 and 11), which are quadratic only for a contact law of exponent 1.
    P is singular unless the objective is "least_squares"; some solvers need it definite.

    Args:
        problem: contacts, load, friction, limits.
        impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
        objective: as for :func:`~pinograsp.forces.optimize_forces`.

    Raises:
        InvalidInput: cones and soft fingers, an objective that is not quadratic, or an argument that
            ``optimize_forces`` rejects, too.
    """
    program, about = _program_of(problem, impact_time, objective)
    qp, torque_rows = DenseMethod(program.matrices, "").quadratic(program)
    matrices: dict[str, Any] = {name: read_only(matrix) for name, matrix in vars(qp).items()}
    return ForceQP(**matrices, **vars(about), torque_rows=read_only(torque_rows))


def to_socp(problem: ForceProblem, impact_time: float, *, objective: Objective | None = None) -> ForceSOCP:
    """Return the force program at t_I [s] over cones, for all friction models and objectives; see :class:`ForceSOCP`.

    Friction cones become second-order cones, grasp energies (Eqs. 9 and 11) become power cones. Arguments and errors
    are those of :func:`to_qp`, which rejects more.
    """
    program, about = _program_of(problem, impact_time, objective)
    method = ConicMethod(program.matrices, exponents_of(program))
    force, columns = program.force_scale, list(about.columns)
    for power in method.exponents:
        unit = f"N^{power:.4g}"
        columns += [Column(name, f"f_n^{power:.4g}", unit, force**power) for name in _names(problem)]
    known: dict[str, Any] = vars(about) | {"columns": tuple(columns)}
    socp = method.standard_form(program)
    socp = replace(socp, q=read_only(socp.q), b=read_only(socp.b))
    return ForceSOCP(**vars(socp), **known, torque_rows=(method.torque_at, len(program.R)))


def _program_of(problem: ForceProblem, impact_time: float, objective: Objective | None) -> tuple[Program, ScaledForces]:
    """The program, and what its unknowns mean: x of each contact, and the largest F_n where it counts."""
    instance_of("problem", problem, ForceProblem)
    impact_time, weights = problem.checked_impact_time(impact_time), weights_of(objective, problem)
    program = program_at(problem, matrices_of(problem, weights), impact_time)
    force, columns = program.force_scale, []
    for name, widths in zip(_names(problem), problem.friction.scale(problem.mu) * force):
        columns += [Column(name, axis, "N", float(width)) for axis, width in zip(("f_x", "f_y"), widths)]
        columns += [Column(name, "m_n", "N m", float(width)) for width in widths[2:]]
        columns.append(Column(name, NORMAL, "N", force))
    if program.peak:
        columns.append(Column("", "max f_n", "N", force))
    return program, ScaledForces(
        columns=tuple(columns),
        impact_time=impact_time,
        weights=weights,
        force_scale=force,
        objective_scale=program.objective_scale,
        constant=program.constant * program.objective_scale,
        judge=partial(_judge, problem, program, impact_time),
    )


def _names(problem: ForceProblem) -> list[str]:
    return [contact.finger or f"contact {i + 1}" for i, contact in enumerate(problem.contacts.contacts)]


def _judge(
    problem: ForceProblem,
    program: Program,
    impact_time: float,
    x: Array,
    y: Array | None,
    w: Array | None,
    settle: bool,
) -> ConvexSolution:
    """The record of anyone's x; without y and w the lower bound is proven with multipliers of this package's own."""
    started, x = perf_counter(), x[: program.k * program.d]
    if y is None or w is None:
        own = ConicMethod(program.matrices, exponents_of(program)).solve(program)
        answer = ProgramAnswer.alone(x) if own is None else own._replace(x=x)
    else:
        answer = ProgramAnswer(x, y, w)
    found = certify_answer(problem, program, answer, settle=settle)
    status = Status.OK if found.certificate.is_optimal() else Status.INACCURATE
    outcome = ProgramOutcome(status=status, solver="", forces=found)
    return solution_of(
        problem, outcome, impact_time=impact_time, weights=dict(program.matrices.weights), started=started
    )
