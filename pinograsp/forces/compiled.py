"""The compiled path (extra ``fast``): scale, solve, check and record one force problem in a single compiled call.

Data that depend neither on the load nor on the impact time are in a :class:`~pinograsp.forces.template.Template`, data
that do not depend on the load in :class:`Prepared`. The checks are those of :mod:`pinograsp.forces.program`, written so
that numba can compile them; the tests compare the two. Problems that this path cannot certify go to the general one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pinograsp.checks import frozen, record_of
from pinograsp.forces.answers import Answer, Checks
from pinograsp.forces.certificate import TOLERANCE, Certificate, objective_size_of
from pinograsp.forces.kernels.boxes import box_least_squares, box_memory
from pinograsp.forces.kernels.bulk import solve_many
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    Answers,
    Bulk,
    BulkModel,
    BulkResults,
    Friction,
    Grasp,
    Limits,
    Objective,
    Problem,
    Ranges,
    Rows,
    Scalars,
    TickSettings,
)
from pinograsp.forces.kernels.memory import pack_chains, tick_memory
from pinograsp.forces.kernels.packing import Stage, pack_grasp, pack_stage, results_in, room_for_results
from pinograsp.forces.kernels.powers import powers_of
from pinograsp.forces.kernels.single import answer, solve_one
from pinograsp.forces.kernels.tick import online
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import EnergyTerms, Program
from pinograsp.forces.template import Template
from pinograsp.spatial import Array


def problem_of(program: Program, fixed: Template) -> Problem:
    """A program as the interior-point method takes it; ``fixed``: its matrices."""
    weight, force = program.objective_scale, program.force_scale
    return Problem(
        rows=fixed.rows,
        limits=fixed.limits,
        friction=fixed.friction,
        ranges=Ranges(program.lo, program.hi, program.R_lo[fixed.order], program.R_hi[fixed.order]),
        objective=Objective(
            fixed.P * (force**2 / weight),
            fixed.q * (force / weight),
            powers_of(np.array(program.powers).reshape(-1, 2), 1.0, 1.0),
        ),
        b=program.b,
    )


def solve_program(program: Program, fixed: Template, name: str) -> Answer | None:
    """The answer of a compiled method with its checks; None where it finds none. ``fixed``: the program's matrices."""
    if np.any(program.hi - program.lo <= 1e-9 * program.hi):
        return None
    k, d, m = program.k, program.d, len(program.b)
    found = Answers(np.empty((k, d)), np.empty(fixed.rows.B.shape[2]), np.empty(k), np.empty(m))
    code, violation, value, bound, _ = answer(
        name == "newton", problem_of(program, fixed), fixed.matrices.correction, found
    )
    if code != CONVERGED or not math.isfinite(value + bound + violation):
        return None
    w = np.zeros(len(program.R))
    w[fixed.order] = found.y[m:]
    return Answer(found.x.ravel(), found.y[:m], w, Checks(violation, found.gauge, found.residual, value, bound))


class CompiledForces(NamedTuple):
    """Certified forces of one compiled call.

    Attributes:
        backend: ``"newton"`` or ``"interior"``.
        certificate: of the forces.
        forces_c: contact forces (k, 3) [N].
        torsion: moments about the contact normals (k,) [N m].
    """

    backend: str
    certificate: Certificate
    forces_c: Array
    torsion: Array


class Prepared:
    """Everything of a force problem but its load, at one impact time, for one objective and compiled method."""

    def __init__(self, problem: ForceProblem, template: Template, method: str, impact_time: float, terms: EnergyTerms):
        """Pack all numbers for :func:`~pinograsp.forces.kernels.single.solve_one`; ``terms`` at ``impact_time`` [s]."""
        self._k, weights = problem.k, template.matrices.weights
        names = () if problem.torques is None else problem.torques.limited_joints
        self._joints = tuple(names[row] for row in template.order)
        self._whole, self._numbers = pack_grasp(template.grasp(problem))
        low, high, _ = problem.normal_force_limits(impact_time)
        floor, cap = problem.min_normal_force, problem.max_normal_force
        least = np.full(self._k, low) if floor is None else np.maximum(floor, low)
        largest = np.full(self._k, high) if cap is None else np.minimum(cap, high)
        powers = np.array([(weights[m] * c, e) for m, own in terms.items() for c, e in own])
        self._stage = pack_stage(Stage(method == "newton", least, largest, powers))

    def forces(self, load: Array) -> CompiledForces | None:
        """Forces for a load (6,), read-only; None where there is no certified answer."""
        k = self._k
        out, active = room_for_results(k, len(self._joints))
        code, newton, violation, most, value, bound, constant, force, moment, scale, unit = solve_one(
            self._whole, self._numbers, self._stage, load, out, active
        )
        # No objective is negative; rounding may raise a sharp bound above the value.
        lower_bound = min(max(bound, -constant), value)
        out.flags.writeable = active.flags.writeable = False
        results = results_in(out, active, k)
        certificate = record_of(
            Certificate,
            {
                "objective": (value + constant) * unit,
                "lower_bound": (lower_bound + constant) * unit,
                "residual": results.wrench,
                "residual_norm": math.hypot(force, moment) * scale,
                "violation": max(violation, 0.0) * scale,
                "load_size": scale,
                "force_size": max(1.0, most) * scale,
                "objective_size": objective_size_of(value + constant, constant) * unit,
                "at_friction": results.at_friction,
                "at_least": results.at_least,
                "at_most": results.at_most,
                "at_torque": tuple(self._joints[row] for row in results.at_torque.nonzero()[0]) if self._joints else (),
            },
        )
        if code != CONVERGED or not math.isfinite(bound) or not certificate.is_optimal():
            return None
        return CompiledForces(
            backend="newton" if newton else "interior",
            certificate=certificate,
            forces_c=results.forces,
            torsion=results.torsion,
        )


def compile_now() -> None:
    """Compile (or load from the cache) every function that the package calls, for the types that it calls them with."""
    k, d, m = 1, 3, 6
    one, none, ones = np.ones(k), np.zeros(0), np.ones((k, d))
    rows = Rows(np.zeros((m, k * d)), np.zeros((k, d, m)), np.arange(m)[None], np.array([[m, m]]), m)
    rows.B[0, :, :3] = np.eye(3)
    limits = Limits(np.ones((1, d, k)), np.ones((1, d), dtype=np.int64), np.zeros((0, k), dtype=np.int64))
    friction = Friction(np.zeros((0, d)), np.zeros((0, 2)), np.ones(d - 1), 2)
    objective = Objective(np.eye(d)[None], 0.0 * ones, powers_of(np.ones((1, 2)), 1.0, 1.0))
    problem = Problem(rows, limits, friction, Ranges(0.1 * one, one, none, none), objective, np.zeros(m))
    correction, scalars = np.zeros((k * d, m)), Scalars(0.0, 1.0, 1.0, TOLERANCE.active)
    answer(False, problem, correction, Answers(ones.copy(), np.zeros(m), one.copy(), np.zeros(m)))
    grasp_matrix, normals = np.ones((6, 3 * k)), np.ones((k, 3))
    whole, numbers = pack_grasp(
        Grasp(
            rows,
            limits,
            friction,
            objective.P,
            objective.q,
            none,
            none,
            correction,
            ones,
            grasp_matrix,
            normals,
            scalars,
        )
    )
    stage = pack_stage(Stage(False, 0.1 * one, one, np.ones((1, 2))))
    solve_one(whole, numbers, stage, frozen(np.zeros(6)), *room_for_results(k, 0))
    memory, tick = tick_memory(TickSettings(k, d, 0, m, 2, 0.0, 1.0, 1.0, 1, 1.0, 0))
    tick.inputs.rotations[:], tick.inputs.largest[:] = np.eye(3), 1.0
    online(memory, none, none, pack_chains(np.zeros((0, 3), dtype=np.int64), None))
    memory, box = box_memory(m, 2, 1.0)
    box.H[:] = 1.0
    box_least_squares(memory)
    each = frozen(np.ones((1, k)))
    bulk = Bulk(
        points=frozen(np.ones((1, k, 3))),
        rotations=frozen(np.eye(3)[None, None]),
        counts=frozen(np.ones(1, dtype=np.int64)),
        loads=frozen(np.zeros((1, 6))),
        mu=each,
        low=each,
        high=each,
        arms=frozen(np.ones(1)),
        terms=frozen(np.zeros((1, 0, 2))),
    )
    solve_many(0, 1, bulk, BulkModel(m, 0.0, 1.0, frozen(np.ones(d - 1)), 2), BulkResults.of(1, k))
