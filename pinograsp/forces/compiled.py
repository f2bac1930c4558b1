"""The compiled path (extra ``fast``): scale, solve, check and record one force problem in a single compiled call.

Everything that does not change with the load and the impact time is kept in a :class:`Template`. The checks are those of
:mod:`pinograsp.forces.program`, written for compiling; the tests compare the two. What this path cannot take or certify
goes to the general one.
"""

from __future__ import annotations

import math

import numpy as np

from pinograsp.forces.kernels import CONVERGED, answer, powers_of, whole
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import BALANCE, GAP, NEAR, VIOLATION, Program, gap_size

_NO_CAPS = np.zeros(0)
_NEWTON_FROM = 5  # contacts; with fewer, strongly convex objectives included, interior points are as fast and steadier


class Template:
    """A program's matrices as the compiled solvers take them (see :func:`pinograsp.forces.kernels.interior_point`).

    Attributes:
        rows: the balance's, torque rows of several contacts, torque rows of one. order: of the torque rows in the program.
        P (k, d, d), q (k, d), constant, R_lo, R_hi: in newtons and the objective's unit. largest: diagonal entry of P.
        separates: whether the Newton method applies. strong: whether the objective is strongly convex by itself.
        arguments: what :func:`pinograsp.forces.kernels.whole` takes of it, in its order.
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
        self.R_lo, self.R_hi = program.R_lo[self.order] * force, program.R_hi[self.order] * force
        self.facets = np.hstack([-friction.facets, np.ones((len(friction.facets), 1))])
        self.n_round = friction.round_dimensions
        self.vertices = np.array(friction.vertices) if friction.polyhedral else np.zeros((0, 2))
        self.radii = np.ones(d - 1)
        if friction.model == "pyramid":
            self.radii[:2] = np.sqrt(0.5)
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
        self.strong = bool(diagonal.min() > 1e-6 * self.largest)
        self.applies = not coupled and not program.peak
        self.separates = self.applies and not len(program.R) and (friction.model != "pyramid" or friction.edges == 4)
        if self.separates and program.P is not None:
            own = diagonal[:, : self.n_round]
            self.separates = np.count_nonzero(self.P) <= np.count_nonzero(diagonal) and (
                own.shape[1] == 0 or bool(np.all(np.ptp(own, axis=1) <= 1e-12 * own.max()))
            )
        self.correction = np.linalg.pinv(program.A, rcond=1e-10)  # of a residual of the balance
        self.arguments = (
            self.strong, *self.components, self.rows, self.touched, self.counts, self.schur, self.P, self.q, self.constant,
            self.largest, self.facets, self.n_round, self.vertices, self.radii, self.R_lo, self.R_hi, self.correction,
        )  # fmt: skip

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
        return A, limits, np.any(limits != 0.0, axis=2), own

    def choice(self, solver: str) -> str:
        """The compiled solver for a request, or "" where none applies."""
        if solver == "newton" or (solver == "auto" and self.strong and len(self.P) >= _NEWTON_FROM):
            if self.separates:
                return "newton"
        return "interior" if self.applies and solver in ("auto", "interior") else ""


def template_of(program: Program) -> Template:
    """The program's template; kept with what its problem shares."""
    found = program.cache.get("template")
    if found is None:
        found = program.cache["template"] = Template(program)
    return found


def solve_program(program: Program, name: str) -> tuple | None:
    """x (k d,), multipliers y (m,) and w (r,), and the checks of an answer by a compiled solver; None where it has none.

    The checks are the largest violation, gauges (k,), balance residual (m,), objective and proven bound.
    """
    fixed = template_of(program)
    newton = name == "newton"
    if not (fixed.separates if newton else fixed.applies) or np.any(program.hi - program.lo <= 1e-9 * program.hi):
        return None
    k, d, m = program.k, program.d, len(program.b)
    weight, force = program.objective_scale, program.force_scale
    coefs, exps = powers_of(np.array(program.powers).reshape(-1, 2), 1.0, 1.0)
    x, y, gauge, residual = np.empty((k, d)), np.empty(fixed.rows.shape[2]), np.empty(k), np.empty(m)
    code, violation, value, bound = answer(
        newton, fixed.strong, *fixed.components, fixed.rows, fixed.touched, fixed.counts, fixed.schur, program.b, fixed.P * (force**2 / weight),
        fixed.q * (force / weight), coefs, exps, program.lo, program.hi, fixed.facets, fixed.n_round, fixed.vertices,
        fixed.radii, fixed.R_lo / force, fixed.R_hi / force, fixed.correction, x, y, gauge, residual,
    )  # fmt: skip
    if code != CONVERGED or not math.isfinite(value + bound + violation):
        return None
    w = np.empty(len(program.R))
    w[fixed.order] = y[m:]
    return x.ravel(), y[:m], w, (violation, gauge, residual, value, bound)


def known_template(problem: ForceProblem, weights) -> Template | None:
    """The template of a problem and objective, if a problem that shares its matrices was solved before."""
    cache = problem._assembled.get(("objective", *weights.items(), "cache"))
    return None if cache is None else cache.get("template")


def forces_at(problem: ForceProblem, template: Template, solver: str, terms, low: float, high: float, depth_per_A: float) -> tuple | None:
    """The compiled path for a problem whose template is known; None where it has no certified answer.

    Args:
        problem, template: from the same matrices. solver: ``"newton"`` or ``"interior"``.
        terms: (coefficient, exponent) pairs of the objective in F_n [N]. low, high: range of F_n [N], caps aside.
        depth_per_A: final depth per deceleration [s^2].

    Returns:
        primal, dual, size (see :class:`~pinograsp.forces.optimize.Certificate`), net force [N], net moment [N m], violation
        [N]; and read-only forces (k, 3) [N], torsion (k,) [N m], multipliers (k, 2), acceleration (k,) [m/s^2], wrench (6,),
        active limits (3, k) at friction, least and largest F_n, and active torque rows (r,) in the template's order.
    """
    k, r = template.q.shape[0], template.R_lo.shape[0]
    fixed = problem._assembled.get("record")
    if fixed is None:
        widths = np.ones((k, problem.friction.d))
        widths[:, :-1] = problem.friction.scale(problem.mu)
        fixed = problem._assembled["record"] = (
            widths, np.array(problem.contacts.G), np.array(problem.contacts.rotations_oc[:, :, 2], order="C"), problem.pyramid,
        )  # fmt: skip
    arrays = (
        np.empty((k, 3)), np.empty(k), np.empty((k, 2)), np.empty(k), np.empty(6), np.empty((3, k), bool), np.empty(r, bool),
    )  # fmt: skip
    caps = problem.max_normal_force
    law = problem.compliance
    numbers = whole(
        solver == "newton", *template.arguments, problem.load.copy(), problem.moment_length, np.array(terms).reshape(-1, 2),
        low, high, _NO_CAPS if caps is None else caps.copy(), *fixed, law.stiffness, law.exponent, depth_per_A, NEAR, *arrays,
    )  # fmt: skip
    code, violation, most, value, bound, constant, force, moment, scale, unit = numbers
    bound = max(bound, -constant)  # no objective is negative
    size = gap_size(value + constant, constant)
    certified = (
        code == CONVERGED
        and math.hypot(force, moment) <= BALANCE
        and violation <= VIOLATION * max(1.0, most)
        and -math.inf < value - bound <= GAP * size
    )
    if not certified:
        return None
    for array in arrays:
        array.setflags(write=False)
    primal, dual = (value + constant) * unit, (min(bound, value) + constant) * unit
    moment *= scale * problem.moment_length
    return (primal, dual, size * unit, force * scale, moment, max(violation, 0.0) * scale), arrays


def compile_now() -> None:
    """Compile (or load from the cache) every function for the types that are used."""
    k, d, m = 1, 3, 6
    B, touched, counts = np.zeros((k, d, m)), np.arange(m)[None], np.array([[m, m]])
    B[0, :, :3] = np.eye(3)
    cone = (np.zeros((0, d)), 2, np.zeros((0, 2)), np.ones(d - 1), np.zeros(0), np.zeros(0), np.zeros((k * d, m)))
    components = np.zeros((m, k * d)), np.ones((1, d, k)), np.ones((1, d), dtype=np.bool_), np.zeros((0, k), dtype=np.int64)
    strong = (False, True, *components, B, touched, counts, m)
    P, q, terms, ones = np.ones((k, 1, 1)) * np.eye(d), np.zeros((k, d)), np.ones((1, 2)), np.ones(k)
    x, y, gauge, residual = np.ones((k, d)), np.zeros(m), np.zeros(k), np.zeros(m)
    coefs, exps = powers_of(terms, 1.0, 1.0)
    answer(*strong, np.zeros(m), P, q, coefs, exps, 0.1 * ones, ones, *cone, x, y, gauge, residual)
    whole(
        *strong, P, q, 0.0, 1.0, *cone, np.zeros(6), 1.0, terms, 0.1, 1.0, ones, np.ones((k, d)), np.zeros((6, 3)),
        np.zeros((k, 3)), ones, 1.0, 1.0, 1.0, NEAR, np.ones((k, 3)), np.ones(k), np.ones((k, 2)), np.ones(k), np.ones(6),
        np.empty((3, k), dtype=np.bool_), np.empty(0, dtype=np.bool_),
    )  # fmt: skip
