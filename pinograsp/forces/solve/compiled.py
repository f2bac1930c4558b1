"""The compiled path: scale, solve, check and record one force problem in a single call of the core.

Data that depend neither on the load nor on the impact time are in a
:class:`~pinograsp.forces.solve.template.Template`, data that do not depend on the load in :class:`PreparedForces`. The
checks are those of :mod:`pinograsp.forces.solve.program`; the tests compare the two.
Problems that this path cannot certify go to the general one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pinograsp import core
from pinograsp.checks import frozen, record_of
from pinograsp.forces.certificate import NEGLIGIBLE, TOLERANCE, VANISHING, Certificate, Infeasibility
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.answers import Checks, ProgramAnswer
from pinograsp.forces.solve.program import EnergyTerms, Program
from pinograsp.forces.solve.template import Template
from pinograsp.spatial import Array

_NONE = np.zeros(0, dtype=np.intp)


def arrays_of(program: Program, fixed: Template) -> tuple[Array | float, ...]:
    """A program as the core takes it: b, lo, hi, R_lo, R_hi, P, q, its powers and the weight of the largest F_n;
    ``fixed``: the program's matrices.
    """
    weight, force = program.objective_scale, program.force_scale
    return (
        program.b,
        program.lo,
        program.hi,
        program.R_lo[fixed.order],
        program.R_hi[fixed.order],
        fixed.P * (force**2 / weight),
        fixed.q * (force / weight),
        np.array(program.powers, dtype=float).reshape(-1, 2),
        program.peak,
    )


def solve_program(problem: ForceProblem, program: Program, fixed: Template, name: str) -> ProgramAnswer | None:
    """The answer of a compiled method with its checks; None where it finds none. ``fixed``: the program's matrices."""
    if np.any(program.hi - program.lo <= 1e-9 * program.hi):
        return None
    k, d, m = program.k, program.d, len(program.b)
    code, _, violation, value, bound, x, y, gauge, residual = fixed.grasp(problem).answer(
        name == "newton", *arrays_of(program, fixed)
    )
    if code != core.CONVERGED or not math.isfinite(value + bound + violation):
        return None
    w = np.zeros(len(program.R))
    w[fixed.order] = y[m:]
    return ProgramAnswer(x.reshape(d, k).T.ravel(), y[:m], w, Checks(violation, gauge, residual, value, bound))


class CompiledForces(NamedTuple):
    """Certified forces of one compiled call.

    Attributes:
        solver: ``"newton"`` or ``"interior"``.
        certificate: of the forces.
        forces_c: contact forces (k, 3) [N].
        torsion: moments about the contact normals (k,) [N m].
    """

    solver: str
    certificate: Certificate
    forces_c: Array
    torsion: Array


class PreparedForces:
    """Everything of a force problem but its load, at one impact time, for one objective and compiled method.

    Attributes:
        method: its name.
    """

    def __init__(
        self,
        problem: ForceProblem,
        template: Template,
        method: str,
        terms: EnergyTerms,
        normal_force_range: tuple[Array, Array],
    ):
        """Hand all numbers to the core; ``terms`` and ``normal_force_range`` are those at the impact time."""
        self._k, self.method, weights = problem.k, method, template.matrices.weights
        names = () if problem.torques is None else problem.torques.limited_joints
        self._joints = tuple(names[row] for row in template.order)
        self._limited = (
            np.flatnonzero(problem.torques.limited)[template.order] if problem.torques is not None else _NONE
        )
        self._row_norms = template.matrices.R_norm[template.order]
        self._rows = template.matrices.rows
        powers = np.array([(weights[m] * c, e) for m, own in terms.items() for c, e in own], dtype=float).reshape(-1, 2)
        self._prepared = core.load().Prepared(
            template.grasp(problem),
            method == "newton",
            *normal_force_range,
            powers,
            residual=TOLERANCE.residual,
            violation=TOLERANCE.violation,
            gap=TOLERANCE.gap,
            vanishing=VANISHING,
            negligible=NEGLIGIBLE,
        )
        self._solve = self._prepared.solve
        self._torques = 0 if problem.torques is None else len(problem.torques.limit)

    def forces(self, load: Array) -> CompiledForces | None:
        """Forces for a load (6,), read-only; None where there is no certified answer."""
        k = self._k
        numbers, active = np.empty(6 + 4 * k), np.empty(3 * k + len(self._joints), np.bool_)
        optimal, newton, objective, lower_bound, residual_norm, violation, load_size, force_size, objective_size = (
            self._solve(load, numbers, active)
        )
        if not optimal:
            return None
        numbers.flags.writeable = active.flags.writeable = False
        certificate = record_of(
            Certificate,
            {
                "objective": objective,
                "lower_bound": lower_bound,
                "residual": numbers[:6],
                "residual_norm": residual_norm,
                "violation": violation,
                "load_size": load_size,
                "force_size": force_size,
                "objective_size": objective_size,
                "at_friction": active[:k],
                "at_least": active[k : 2 * k],
                "at_most": active[2 * k : 3 * k],
                "at_torque": tuple(self._joints[row] for row in active[3 * k :].nonzero()[0]) if self._joints else (),
            },
        )
        forces = numbers[6 : 6 + 3 * k].reshape((k, 3))
        return CompiledForces("newton" if newton else "interior", certificate, forces, numbers[6 + 3 * k :])

    def prove(self, load: Array) -> Infeasibility | None:
        """The proof that no forces hold a load (6,), read-only; None where there is none."""
        k, rows = self._k, self._rows
        multipliers, numbers = np.empty(rows + len(self._joints)), np.empty(6 + 4 * k)
        active = np.empty(3 * k + len(self._joints), np.bool_)
        margin = self._prepared.prove(load, multipliers, numbers, active)
        if not margin > 0.0:
            return None
        direction, joints = np.zeros(6), np.zeros(self._torques)
        direction[:rows] = multipliers[:rows]
        joints[self._limited] = multipliers[rows:] / self._row_norms
        for part in (direction, joints, numbers, active):
            part.flags.writeable = False
        return Infeasibility(
            margin=margin,
            direction=direction,
            joint_weights=joints,
            closest_c=numbers[6 : 6 + 3 * k].reshape((k, 3)),
            closest_torsion=numbers[6 + 3 * k :],
            residual=numbers[:6],
            at_friction=active[:k],
            at_least=active[k : 2 * k],
            at_most=active[2 * k : 3 * k],
            at_torque=tuple(self._joints[row] for row in active[3 * k :].nonzero()[0]),
            crossed=frozen(np.zeros(k, np.bool_)),
        )
