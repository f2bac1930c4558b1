"""From a solver's answer to forces with their certificate, whose numbers are all computed here, none by the solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pinograsp.checks import frozen
from pinograsp.forces.certificate import TOLERANCE, Certificate, objective_size_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.program import Program
from pinograsp.spatial import Array


class Checks(NamedTuple):
    """Every check of an answer x, dimensionless as its program.

    Attributes:
        violation: largest violation of friction, of the bounds on F_n and of the torque limits.
        gauge: least F_n that friction needs (k,).
        residual: of the balance, A x - b (rows,).
        objective: at x, without the constant.
        lower_bound: proven lower bound of the objective, without the constant.
    """

    violation: float
    gauge: Array
    residual: Array
    objective: float
    lower_bound: float


class ProgramAnswer(NamedTuple):
    """A solver's answer to a program, not yet checked.

    Attributes:
        x: scaled forces (k d,).
        y: balance multipliers (rows,); empty where the solver gives none.
        w: torque multipliers (m,).
        checks: of x, where the solver computes them in the same way as :func:`certify_answer`, else None.
    """

    x: Array
    y: Array
    w: Array
    checks: Checks | None = None

    @classmethod
    def alone(cls, x: Array) -> ProgramAnswer:
        """x without multipliers."""
        return cls(x, np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CertifiedForces:
    """Forces of a program with their certificate.

    Attributes:
        forces_c: contact forces (k, 3) [N].
        torsion: moments about the contact normals (k,) [N m].
        certificate: in the problem's units.
    """

    forces_c: Array
    torsion: Array
    certificate: Certificate


def certify_answer(
    problem: ForceProblem, program: Program, answer: ProgramAnswer, *, settle: bool = True
) -> CertifiedForces:
    """The forces of an answer, the balance's residual removed by the least correction, and their certificate.

    Without multipliers the lower bound is the objective's least conceivable value. ``settle`` False: forces as they
    are.
    """
    x, checks = (answer.x, answer.checks) if answer.checks is not None else _check(program, answer, settle)
    # No objective is negative; rounding may raise a sharp bound above the value.
    lower_bound = min(max(checks.lower_bound, -program.constant), checks.objective)
    F, unit, force = x[program.d - 1 :: program.d], program.objective_scale, program.force_scale
    forces, torsion = forces_of(problem, x, force)
    certificate = Certificate(
        objective=(checks.objective + program.constant) * unit,
        lower_bound=(lower_bound + program.constant) * unit,
        residual=frozen(problem.residual(forces, torsion if program.d == 4 else None)),
        residual_norm=float(np.sqrt(checks.residual @ checks.residual)) * force,
        violation=checks.violation * force,
        load_size=force,
        force_size=max(1.0, float(F.max())) * force,
        objective_size=_objective_size(program, checks.objective) * unit,
        at_friction=frozen(checks.gauge >= F * (1 - TOLERANCE.active)),
        at_least=frozen(program.lo * (1 + TOLERANCE.active) >= F),
        at_most=frozen(program.hi * (1 - TOLERANCE.active) <= F),
        at_torque=_at_torque(problem, program, x),
    )
    return CertifiedForces(forces_c=frozen(forces), torsion=frozen(torsion), certificate=certificate)


def forces_of(problem: ForceProblem, x: Array, force_scale: float) -> tuple[Array, Array]:
    """Contact forces (k, 3) [N] and torsional moments (k,) [N m] from a program's x."""
    friction = problem.friction
    z = x.reshape(problem.k, friction.d) * force_scale
    widths = friction.scale(problem.mu)
    forces = z[:, [0, 1, -1]]
    forces[:, :2] *= widths[:, :2]
    return forces, z[:, 2] * widths[:, 2] if friction.d == 4 else np.zeros(problem.k)


def _check(program: Program, answer: ProgramAnswer, settle: bool) -> tuple[Array, Checks]:
    """x with the balance's residual removed, unless it is not to be, and its checks."""
    x = answer.x
    violation, gauge, residual = program.violations(x)
    if settle and residual @ residual > 1e-26:
        x = program.remove_residual(x, residual)
        violation, gauge, residual = program.violations(x)
    objective = program.value(x)
    if not len(answer.y):
        return x, Checks(violation, gauge, residual, objective, -program.constant)
    bound = program.lower_bound(x, answer.y, answer.w, refine=False)
    if objective - max(bound, -program.constant) > 0.2 * TOLERANCE.gap * _objective_size(program, objective):
        bound = max(bound, program.lower_bound(x, answer.y, answer.w))
    return x, Checks(violation, gauge, residual, objective, bound)


def _objective_size(program: Program, objective: float) -> float:
    return objective_size_of(objective + program.constant, program.constant)


def _at_torque(problem: ForceProblem, program: Program, x: Array) -> tuple[str, ...]:
    """Joints at their torque limit."""
    if problem.torques is None or not len(program.R):
        return ()
    torque = program.R @ x
    meets = (torque >= program.R_hi - TOLERANCE.active) | (torque <= program.R_lo + TOLERANCE.active)
    return tuple(joint for joint, meet in zip(problem.torques.limited_joints, meets) if meet)
