"""The compiled path (extra ``fast``): scale, solve, check and record one force problem in a single compiled call.

What changes neither with the load nor with the impact time is kept in a :class:`Template`, what does not change with
the load in :class:`Prepared`. The checks are those of :mod:`pinograsp.forces.program`, written for compiling; the tests
compare the two. What this path cannot take or certify goes to the general one.
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
    many,
    online,
    online_memory,
    powers_of,
    whole,
)
from pinograsp.forces.problem import ForceProblem, kept
from pinograsp.forces.program import Program, energy_terms_at

_KEPT = 16  # impact times and objectives kept per problem


class Template:
    """A program's matrices as the compiled solvers take them (see :func:`pinograsp.forces.kernels.interior_point`).

    Attributes:
        rows: the balance's, torque rows of several contacts, torque rows of one. order: of the torque rows in the
            program.
        P (k, d, d), q (k, d), constant, R_lo, R_hi: in newtons and the objective's unit. largest: diagonal entry of P.
        separates: whether the Newton method applies.
        packed: sizes and numbers of :func:`pinograsp.forces.kernels.whole`, once :meth:`pack` has made them.
    """

    def __init__(self, program: Program):
        k, d, friction, m = program.k, program.d, program.friction, len(program.b)
        weight, force = program.objective_scale, program.force_scale
        enters = np.abs(program.R.reshape(-1, k, d)).max(axis=2) > 0
        alone = enters.sum(axis=1) <= 1
        self.order = np.concatenate([np.flatnonzero(~alone), np.flatnonzero(alone)])
        rows = np.vstack([program.A, program.R[self.order]])
        self.rows = np.ascontiguousarray(rows.reshape(-1, k, d).transpose(1, 2, 0))
        self.schur = m + int(np.count_nonzero(~alone))
        enters = np.vstack([np.ones((m, k), dtype=bool), enters[self.order]])
        self.touched = np.zeros((k, len(rows)), dtype=np.int64)
        self.counts = np.empty((k, 2), dtype=np.int64)
        for i, entered in enumerate(enters.T):
            at = np.flatnonzero(entered)
            self.touched[i, : len(at)] = at
            self.counts[i] = np.count_nonzero(at < self.schur), len(at)
        self.R_lo, self.R_hi = (limit[self.order] for limit in program.cache["torque limits"])
        self.facets = np.hstack([-friction.facets, np.ones((len(friction.facets), 1))])
        self.n_round = friction.round_dimensions
        self.vertices = np.array(friction.vertices) if friction.polyhedral else np.zeros((0, 2))
        self.radii = friction.radii
        self.components = self._by_component(program)
        self.P, coupled = np.zeros((k, d, d)), False
        if program.P is not None:
            P = (program.P * (weight / force**2)).reshape(k, d, k, d)
            at = np.arange(k)
            self.P = np.ascontiguousarray(P[at, :, at, :])
            coupled = np.count_nonzero(P) > np.count_nonzero(self.P)
        self.q = program.q.reshape(k, d) * (weight / force)
        self.constant = program.constant * weight
        diagonal = np.einsum("kjj->kj", self.P)
        self.largest = float(diagonal.max())
        self.applies = not coupled and not program.peak
        self.separates = self.applies and not len(program.R) and friction.separates
        if self.separates and program.P is not None:
            own = diagonal[:, : self.n_round]
            self.separates = np.count_nonzero(self.P) <= np.count_nonzero(diagonal) and (
                own.shape[1] == 0 or bool(np.all(np.ptp(own, axis=1) <= 1e-12 * own.max()))
            )
        self.correction = np.linalg.pinv(program.A, rcond=1e-10)  # of a residual of the balance
        self.packed: tuple[np.ndarray, np.ndarray] | None = None

    def pack(self, problem: ForceProblem) -> tuple[np.ndarray, np.ndarray]:
        """Sizes and numbers of :func:`pinograsp.forces.kernels.whole`; ``problem`` shares these matrices."""
        if self.packed is None:
            A, limits, used, own = self.components
            k, d, all_rows = self.rows.shape
            m, widths = self.correction.shape[1], np.ones((k, d))
            widths[:, :-1] = problem.friction.scale(problem.mu)
            sizes = (
                (k, d, m, all_rows, self.schur, self.n_round, len(A), len(self.facets), len(limits)),
                (len(self.vertices),),
                used,
                own,
                self.touched,
                self.counts,
            )
            numbers = (
                (self.constant, self.largest, problem.moment_length, TOLERANCE.active),
                A,
                limits,
                self.rows,
                self.P,
                self.q,
                self.facets,
                self.vertices,
                self.radii,
                self.R_lo,
                self.R_hi,
                self.correction,
                widths,
                problem.contacts.G,
                problem.contacts.rotations_oc[:, :, 2],
                problem.pyramid,
            )
            self.packed = _joined(sizes, np.int64), _joined(numbers, float)
        return self.packed

    def _by_component(self, program: Program) -> tuple[np.ndarray, ...]:
        """A, G, used and own of :func:`pinograsp.forces.kernels.interior_point`: neighbours in memory are contacts."""
        k, d, n = program.k, program.d, self.schur
        A = np.zeros((n + -n % 3, d * k))
        A[:n] = self.rows[:, :, :n].transpose(2, 1, 0).reshape(n, -1)
        alone = self.counts[:, 1] - self.counts[:, 0]
        facets = np.repeat(self.facets[:, :, None], k, axis=2)
        limits = np.concatenate([facets, np.zeros((1 + alone.max(), d, k))])
        limits[len(facets), -1] = 1.0
        own = np.full((alone.max(), k), -1)
        for i in range(k):
            own[: alone[i], i] = at = self.touched[i, self.counts[i, 0] : self.counts[i, 1]]
            limits[len(facets) + 1 : len(facets) + 1 + alone[i], :, i] = self.rows[i][:, at].T
        return A, limits, np.any(limits != 0.0, axis=2).astype(np.int64), own

    def choice(self, solver: str) -> str:
        """The compiled solver for a request, or "" where none applies."""
        if self.separates and solver in ("auto", "newton"):
            return "newton"
        return "interior" if self.applies and solver in ("auto", "interior") else ""


def _joined(parts, kind) -> np.ndarray:
    """All entries in one array (n,)."""
    return np.concatenate([np.asarray(part, dtype=kind).ravel() for part in parts])


def template_of(program: Program) -> Template:
    """The program's template; kept with what its problem shares."""
    found = program.cache.get("template")
    if found is None:
        found = program.cache["template"] = Template(program)
    return found


def solve_program(program: Program, name: str) -> Answer | None:
    """The answer of a compiled solver with its checks; None where it has none."""
    fixed = template_of(program)
    newton = name == "newton"
    if not (fixed.separates if newton else fixed.applies) or np.any(program.hi - program.lo <= 1e-9 * program.hi):
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
        fixed.correction,
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
        solver: ``"newton"`` or ``"interior"``.
        certificate: of the forces.
        forces_c: contact forces (k, 3) [N].
        torsion: moments about the contact normals (k,) [N m].
        multipliers: (k1, k2) (k, 2).
        acceleration: A (k,) [m/s^2].
    """

    solver: str
    certificate: Certificate
    forces_c: np.ndarray
    torsion: np.ndarray
    multipliers: np.ndarray
    acceleration: np.ndarray


class Prepared:
    """Everything of a force problem but its load, at one impact time, for one objective and solver.

    Attributes:
        weights: the objective. joints: names of the torque rows, in their order.
    """

    __slots__ = ("at", "impact_time", "joints", "k", "moment_length", "numbers", "parts", "sizes", "weights")

    def __init__(self, problem: ForceProblem, template: Template, solver: str, weights, impact_time: float):
        self.weights, self.impact_time, self.k = weights, impact_time, problem.k
        names = problem.torques.limited_joints if len(template.order) else ()
        self.joints = [names[row] for row in template.order]
        self.sizes, self.numbers = template.pack(problem)
        low, high, _ = problem._range_at(impact_time)
        law, caps = problem.compliance, problem.max_normal_force
        terms = energy_terms_at(problem, weights, impact_time)
        limits = (
            solver == "newton",
            low,
            high,
            law.stiffness,
            law.exponent,
            problem.depth_per_acceleration(impact_time),
        )
        powers = [(weights[m] * c, e) for m, own in terms.items() for c, e in own]
        self.at = _joined((limits, np.full(self.k, np.inf) if caps is None else caps, powers), float)
        self.moment_length = problem.moment_length

    def forces(self, load: np.ndarray) -> CompiledForces | None:
        """Forces for a load (6,), read-only; None where there is no certified answer."""
        k = self.k
        out, active = np.empty(6 + 7 * k), np.empty(3 * k + len(self.joints), np.bool_)
        code, newton, violation, most, value, bound, constant, force, moment, scale, unit = whole(
            self.sizes, self.numbers, self.at, load, out, active
        )
        # No objective is negative; and a bound from multipliers that are exact to rounding can exceed the value by
        # rounding.
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
                "at_torque": tuple(self.joints[row] for row in active[3 * k :].nonzero()[0]) if self.joints else (),
            },
        )
        if code != CONVERGED or not math.isfinite(bound) or not certificate.is_optimal():
            return None
        return CompiledForces(
            solver="newton" if newton else "interior",
            certificate=certificate,
            forces_c=out[6:end].reshape(k, 3),
            torsion=out[end : end + k],
            multipliers=out[end + k : end + 3 * k].reshape(k, 2),
            acceleration=out[end + 3 * k :],
        )


def prepare(problem: ForceProblem, weights, impact_time: float, solver: str, key) -> Prepared | None:
    """What a call needs besides its load, if a problem that shares these matrices was solved before; kept under
    ``key``.
    """
    known = problem._assembled["objectives"].get(tuple(weights.items()))
    template = None if known is None else known[-1].get("template")
    name = "" if template is None else template.choice(solver)
    if not name:
        return None
    return kept(problem._prepared, key, lambda: Prepared(problem, template, name, weights, impact_time), _KEPT)


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
        np.ones(k * d + 18 * k + 3 * k + k),
    )
    at = (0.0, 0.1, 1.0, 1.0, 1.0, 1.0), ones, (1.0, 1.0)
    whole(
        _joined(sizes, np.int64),
        _joined(numbers, float),
        _joined(at, float),
        frozen(np.zeros(6)),
        np.empty(6 + 7 * k),
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
    many(
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
