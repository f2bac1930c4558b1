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
from pinograsp.forces.kernels import (
    CONVERGED,
    answer,
    box_least_squares,
    box_memory,
    online,
    online_memory,
    powers_of,
    solve_many,
    solve_one,
)
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import EnergyTerms, Program
from pinograsp.forces.template import Template, joined
from pinograsp.spatial import Array


def solve_program(program: Program, fixed: Template, name: str) -> Answer | None:
    """The answer of a compiled method with its checks; None where it finds none. ``fixed``: the program's matrices."""
    newton = name == "newton"
    if np.any(program.hi - program.lo <= 1e-9 * program.hi):
        return None
    k, d, m = program.k, program.d, len(program.b)
    weight, force = program.objective_scale, program.force_scale
    coefs, exps = powers_of(np.array(program.powers).reshape(-1, 2), 1.0, 1.0)
    x, y, gauge, residual = np.empty((k, d)), np.empty(fixed.rows.shape[2]), np.empty(k), np.empty(m)
    code, violation, value, bound, _ = answer(
        newton,
        *fixed.components,
        fixed.rows,
        fixed.touched,
        fixed.counts,
        fixed.schur,
        program.b,
        fixed.P * (force**2 / weight),
        fixed.q * (force / weight),
        coefs,
        exps,
        program.lo,
        program.hi,
        fixed.facets,
        fixed.n_round,
        fixed.vertices,
        fixed.radii,
        program.R_lo[fixed.order],
        program.R_hi[fixed.order],
        fixed.matrices.correction,
        x,
        y,
        gauge,
        residual,
    )
    if code != CONVERGED or not math.isfinite(value + bound + violation):
        return None
    w = np.empty(len(program.R))
    w[fixed.order] = y[m:]
    return Answer(x.ravel(), y[:m], w, Checks(violation, gauge, residual, value, bound))


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
        """Pack all numbers for :func:`pinograsp.forces.kernels.solve_one`; ``terms`` at ``impact_time`` [s]."""
        self._k, weights = problem.k, template.matrices.weights
        names = () if problem.torques is None else problem.torques.limited_joints
        self._joints = tuple(names[row] for row in template.order)
        self._sizes, self._numbers = template.packed(problem)
        low, high, _ = problem.normal_force_limits(impact_time)
        floor, cap = problem.min_normal_force, problem.max_normal_force
        least = np.full(self._k, low) if floor is None else np.maximum(floor, low)
        largest = np.full(self._k, high) if cap is None else np.minimum(cap, high)
        powers = [(weights[m] * c, e) for m, own in terms.items() for c, e in own]
        self._at = joined(((method == "newton",), least, largest, powers), np.float64)

    def forces(self, load: Array) -> CompiledForces | None:
        """Forces for a load (6,), read-only; None where there is no certified answer."""
        k = self._k
        out, active = np.empty(6 + 4 * k), np.empty(3 * k + len(self._joints), np.bool_)
        code, newton, violation, most, value, bound, constant, force, moment, scale, unit = solve_one(
            self._sizes, self._numbers, self._at, load, out, active
        )
        # No objective is negative; rounding may raise a sharp bound above the value.
        lower_bound = min(max(bound, -constant), value)
        out.flags.writeable = active.flags.writeable = False
        end = 6 + 3 * k
        certificate = record_of(
            Certificate,
            {
                "objective": (value + constant) * unit,
                "lower_bound": (lower_bound + constant) * unit,
                "residual": out[:6],
                "residual_norm": math.hypot(force, moment) * scale,
                "violation": max(violation, 0.0) * scale,
                "load_size": scale,
                "force_size": max(1.0, most) * scale,
                "objective_size": objective_size_of(value + constant, constant) * unit,
                "at_friction": active[:k],
                "at_least": active[k : 2 * k],
                "at_most": active[2 * k : 3 * k],
                "at_torque": tuple(self._joints[row] for row in active[3 * k :].nonzero()[0]) if self._joints else (),
            },
        )
        if code != CONVERGED or not math.isfinite(bound) or not certificate.is_optimal():
            return None
        return CompiledForces(
            backend="newton" if newton else "interior",
            certificate=certificate,
            forces_c=out[6:end].reshape(k, 3),
            torsion=out[end : end + k],
        )


def compile_now() -> None:
    """Compile (or load from the cache) every function that the package calls, for the types that it calls them with."""
    k, d, m = 1, 3, 6
    B, touched, counts = np.zeros((k, d, m)), np.arange(m)[None], np.array([[m, m]])
    B[0, :, :3] = np.eye(3)
    components = (
        np.zeros((m, k * d)),
        np.ones((1, d, k)),
        np.ones((1, d), dtype=np.int64),
        np.zeros((0, k), dtype=np.int64),
    )
    P, q, ones, none = np.ones((k, 1, 1)) * np.eye(d), np.zeros((k, d)), np.ones(k), np.zeros(0)
    corners, radii, correction = np.zeros((0, 2)), np.ones(d - 1), np.zeros((k * d, m))
    coefs, exps = powers_of(np.ones((1, 2)), 1.0, 1.0)
    answer(
        False,
        *components,
        B,
        touched,
        counts,
        m,
        np.zeros(m),
        P,
        q,
        coefs,
        exps,
        0.1 * ones,
        ones,
        np.zeros((0, d)),
        2,
        corners,
        radii,
        none,
        none,
        correction,
        np.ones((k, d)),
        np.zeros(m),
        np.zeros(k),
        np.zeros(m),
    )
    sizes = (k, d, m, m, m, 2, m, 0, 1, 0), components[2], touched, counts
    numbers = (
        (0.0, 1.0, 1.0, TOLERANCE.active),
        *components[:2],
        B,
        P,
        q,
        radii,
        correction,
        np.ones(k * d + 18 * k + 3 * k),
    )
    at = (0.0,), 0.1 * ones, ones, (1.0, 1.0)
    solve_one(
        joined(sizes, np.int64),
        joined(numbers, np.float64),
        joined(at, np.float64),
        frozen(np.zeros(6)),
        np.empty(6 + 4 * k),
        np.empty(3 * k, np.bool_),
    )
    tick, settings, _, frames, limits, *_ = online_memory(d, k, 0)
    settings[:] = m, 2, 0, 1, 1, 1, np.inf, 1, 0, 0, 0, k
    frames[:, 3:12], limits[1:] = np.eye(3).ravel(), 1.0
    online(tick, none, none, np.zeros(1, dtype=np.int64))
    memory, settings, *_, H, _ = box_memory(m, 2)
    settings[2], H[:] = 1.0, 1.0
    box_least_squares(memory)
    one, frame = frozen(np.ones((1, k))), frozen(np.eye(3)[None, None])
    solve_many(
        0,
        1,
        frozen(np.ones((1, k, 3))),
        frame,
        frozen(np.ones(1, dtype=np.int64)),
        frozen(np.zeros((1, 6))),
        one,
        0.0,
        one,
        one,
        frozen(np.ones(1)),
        m,
        1.0,
        frozen(np.zeros((1, 0, 2))),
        frozen(radii),
        2,
        np.empty((1, k, 3)),
        np.empty((1, k)),
        np.empty((1, 4)),
        np.zeros(1, dtype=np.int64),
    )
