"""The normal forces of least cost that hold every load of a set, as one convex program.

The hand commands the normal forces once; friction reacts to each load. So F_n is common to all loads, and each load has
tangential forces of its own:

- for every vertex of a polytope of loads (a list, a box, a range of masses) there are tangential forces; all loads in
  the convex hull are then held, since the friction limits are convex for fixed F_n. This is exact.
- for a ball of disturbances the tangential forces are affine in the disturbance w, u = u_0 + L w with A_t L = -1:
  d . u <= F for all |w| <= r is d . u_0 + r |L' d| <= F. This is sufficient; it needs polyhedral friction (for a cone
  its inscribed 16-sided pyramid).

For friction coefficients within a range the least is the worst case, since every friction limit grows with mu.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from pinograsp.checks import array_of, brief, frozen, instance_of, read_only
from pinograsp.contacts import Friction
from pinograsp.contacts.compliance import MEASURES
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.answers import Answer, Checks, certify
from pinograsp.forces.backends import Outcome
from pinograsp.forces.certificate import TOLERANCE, Certificate, Infeasibility, objective_size_of
from pinograsp.forces.conic import Cone, Triplets, cone_rows, solve, sparse
from pinograsp.forces.infeasibility import prove
from pinograsp.forces.load_set import LoadSet
from pinograsp.forces.matrices import matrices_of
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import Program, assemble, energy_terms_at, feasibility, weights_of
from pinograsp.forces.solution import ForceSolution, solution_of
from pinograsp.forces.solvers import compiled_installed
from pinograsp.spatial import Array

_EDGES_FOR_BALLS = 16
_FRICTION_ONLY = (*MEASURES, "peak")  # objectives that depend on the common F_n alone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustForces:
    """Normal forces that hold every load of a set, and friction's reactions.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` or ``INACCURATE``.
        problem: as solved (least mu; polyhedral friction for a ball).
        load_set: the loads that are held.
        impact_time: t_I [s].
        normal_forces: F_n (k,) [N], common to all loads; empty without a solution.
        balanced: the loads of ``forces_c``, as scaled wrenches in the balance rows (s, rows) [N].
        forces_c: contact forces for each load (s, k, 3) [N].
        torsion: moments about the contact normals for each load (s, k) [N m].
        response: change of the scaled tangential forces per unit of disturbance (k, d - 1, rows), or None without a
            ball.
        certificate: residual and limits under the worst of the loads; the lower bound holds for all normal forces that
            hold the set (for a ball: among affine reactions, by the solver's dual). None without a solution.
        infeasibility: proof that a single load of the set cannot be held, or None.
        weights: the objective, ``{name: weight}``.
        tried: number of impact times that were tried; more than 1: a search took this one.
        elapsed: computing time [s].
    """

    status: Status
    problem: ForceProblem
    load_set: LoadSet
    impact_time: float
    normal_forces: Array
    balanced: Array
    forces_c: Array
    torsion: Array
    response: Array | None
    certificate: Certificate | None
    infeasibility: Infeasibility | None
    weights: dict[str, float]
    elapsed: float
    tried: int = 1

    __repr__ = brief()

    def under(self, load: ArrayLike | None = None) -> ForceSolution:
        """The forces under one load of the set (6,) [N, N m]: the common normal forces, and friction's reaction to that
        load.

        The reaction is a weighted mean of the reactions to the set's loads, plus the response to the rest. Default: the
        problem's own load where it is in the set, else the mean of the set's loads. The certificate is that of the
        squeeze, under the worst of the loads.

        Raises:
            InvalidInput: there are no normal forces, or the load is not in the set.
        """
        started, problem = time.perf_counter(), self.problem
        if not len(self.normal_forces):
            raise InvalidInput(f"robust forces: expected a solution with forces, got status '{self.status}'")
        given = problem.load if load is None else array_of("load", load, (6,))
        size = float(np.linalg.norm(self.balanced, axis=1).max())
        held = self.load_set.ball + 1e-7 * size
        shares, rest = self._shares(given)
        if load is None and np.linalg.norm(rest) > held:
            given = self.load_set.loads.mean(axis=0)
            shares, rest = self._shares(given)
        if np.linalg.norm(rest) > held:
            raise InvalidInput(
                f"load: expected one of the set that these forces hold, got {given.tolist()}: "
                f"{np.linalg.norm(rest):.4g} N (moments over the moment length) away from its loads, where a ball of "
                f"{self.load_set.ball:g} N is held"
            )
        problem, friction = problem.with_load(given), problem.friction
        u = np.zeros((problem.k, friction.d - 1))
        widths, mean = friction.scale(problem.mu), np.einsum("s,skc->kc", shares, self.forces_c)
        rough = widths[:, 0] > 0
        u[rough, :2] = mean[rough, :2] / widths[rough, :2]
        u[:, 2:] = (shares @ self.torsion)[:, None] / widths[:, 2:]
        if self.response is not None:
            u += self.response @ rest
        program = feasibility(problem, self.normal_forces, self.normal_forces)
        x = np.column_stack([u, self.normal_forces]).ravel() / program.force_scale
        violation, gauge, residual = program.violations(x)
        y, w = np.zeros(len(program.b)), np.zeros(len(program.R))
        bound = program.lower_bound(x, y, w)
        checks = Checks(violation, gauge, residual, program.value(x), bound)
        forces = certify(problem, program, Answer(x, y, w, checks))
        outcome = Outcome(status=self.status, backend="clarabel", forces=forces)
        found = solution_of(problem, outcome, impact_time=self.impact_time, weights=self.weights, started=started)
        return replace(found, search="robust", certificate=self.certificate)

    def _shares(self, load: Array) -> tuple[Array, Array]:
        """Weights (s,) of the set's loads whose mean is nearest to ``load`` (6,), and the rest of it (rows,) [N]."""
        scaled = _scaled(self.problem, load)
        size = float(np.abs(self.balanced).max()) or 1.0
        shares, _ = nnls(
            np.vstack([self.balanced.T / size, np.full(len(self.balanced), 1e4)]), np.append(scaled / size, 1e4)
        )
        shares /= shares.sum()
        return shares, scaled - shares @ self.balanced

    def explain(self) -> str:
        """The outcome in words."""
        loads = f"{len(self.balanced)} loads" + (
            f" and a ball of {self.load_set.ball:g} N" if self.load_set.ball else ""
        )
        if self.status is Status.OK:
            return f"normal forces {np.round(self.normal_forces, 4).tolist()} N hold all of {loads}"
        if self.infeasibility is not None:
            return (
                f"no forces hold all of {loads}: one of them cannot be held even alone, with a residual of at least "
                f"{self.infeasibility.margin:.4g} N; diagnose() that load"
            )
        if self.status is Status.INFEASIBLE:
            return (
                f"no common normal forces hold all of {loads}; no single load is proven to be infeasible: "
                f"{self.status.remedy}"
            )
        return f"neither forces for {loads} nor a proof that there are none: {self.status.remedy}"


def optimize_robust(
    problem: ForceProblem,
    load_set: LoadSet,
    impact_time: float,
    *,
    mu_range: tuple[float, float] | None = None,
    objective: str | Mapping[str, float] | None = None,
) -> RobustForces:
    """The least-cost normal forces that hold every load of a set, friction reacting to each.

    Args:
        problem: contacts, friction, limits; its own load is not used.
        load_set: see :class:`LoadSet`.
        impact_time: t_I [s].
        mu_range: least and largest friction coefficient, for all contacts; default: the problem's mu.
        objective: ``"impulse"``, ``"work"``, ``"peak"`` or weights of them, which depend on F_n alone; default: the
            problem's measure.

    Raises:
        InvalidInput: other objectives, crossed ranges, or a ball of disturbances with soft fingers.
    """
    started = time.perf_counter()
    instance_of("problem", problem, ForceProblem)
    instance_of("load set", load_set, LoadSet)
    impact_time = problem.checked_impact_time(impact_time)
    weights = robust_weights(objective, problem)
    if mu_range is not None:
        low, high = array_of("mu range", mu_range, (2,))
        if not 0 <= low <= high:
            raise InvalidInput(f"mu range: expected 0 <= least <= largest, got {low:g} and {high:g}")
        problem = replace(problem, mu=np.full(problem.k, low))
    if load_set.ball and not problem.friction.polyhedral:
        if problem.friction.model == "soft":
            raise InvalidInput("a ball of disturbances: expected friction 'pyramid' or 'cone', got 'soft'; use a box")
        inscribed = Friction(edges=_EDGES_FOR_BALLS, torsion=problem.friction.torsion, safety=problem.friction.safety)
        problem = replace(problem, friction=inscribed)
    found = robust_at(problem, load_set, impact_time, weights)
    return replace(found, elapsed=time.perf_counter() - started)


def robust_weights(objective: str | Mapping[str, float] | None, problem: ForceProblem) -> dict[str, float]:
    """The objective as ``{name: weight}``, or :class:`InvalidInput` where it does not depend on F_n alone."""
    weights = weights_of(objective, problem)
    other = [name for name, weight in weights.items() if weight and name not in _FRICTION_ONLY]
    if other:
        raise InvalidInput(
            f"robust objective: expected {', '.join(_FRICTION_ONLY)} or a sum of them, got {', '.join(other)} (of one "
            "load alone: no load set, reserve=None)"
        )
    return weights


def robust_at(
    problem: ForceProblem,
    load_set: LoadSet,
    impact_time: float,
    weights: dict[str, float],
    *,
    bounds: tuple[Array, Array] | None = None,
    proven: bool = True,
) -> RobustForces:
    """:func:`optimize_robust` without its checks of the arguments.

    Args:
        problem: with the least mu; polyhedral friction for a ball.
        load_set: see :class:`LoadSet`.
        impact_time: t_I [s].
        weights: :func:`robust_weights`.
        bounds: least and largest F_n (k,), (k,) [N]; None: the problem's at t_I.
        proven: whether to look for a proof where there are no forces; without one they are ``INACCURATE``.
    """
    terms = energy_terms_at(problem, weights, impact_time)
    lo, hi = problem.normal_force_range(impact_time) if bounds is None else bounds
    scaled = _scaled(problem, load_set.loads)
    largest = scaled[np.argmax(np.linalg.norm(scaled, axis=1))]
    program = assemble(matrices_of(problem, weights), largest, terms, lo, hi)
    targets = np.unique(-scaled / program.force_scale, axis=0)  # in force balance loads may differ by moments alone
    return _Robust(problem, program, targets, load_set, impact_time).solved(proven)


def _scaled(problem: ForceProblem, wrenches: Array) -> Array:
    """Wrenches (..., 6) in the balance rows (..., rows), moments divided by the moment length [N]."""
    return np.concatenate([wrenches[..., :3], wrenches[..., 3:] / problem.moment_length], axis=-1)[..., : problem.rows]


class _Robust:
    """Columns: F (k), u per load (s, k, d - 1), L (k, d - 1, rows) with a ball, one t per power and contact, peak."""

    def __init__(self, problem: ForceProblem, program: Program, targets: Array, load_set: LoadSet, impact_time: float):
        self.problem, self.program, self.targets, self.t = problem, program, targets, impact_time
        self.load_set = load_set
        self.k, self.e, self.s = program.k, program.d - 1, len(targets)
        self.rows = len(program.b)
        self.radius = load_set.ball / program.force_scale
        self.per_load = self.k * self.e
        self.L = self.k + self.s * self.per_load
        self.curved = [(c, p) for c, p in program.powers if p != 1]
        self.extra = self.L + (self.per_load * self.rows if self.radius else 0)
        self.peak = self.extra + self.k * len(self.curved)
        self.size = self.peak + (program.peak > 0)

    def solved(self, prove_it: bool) -> RobustForces:
        started = time.perf_counter()
        if np.any(self.program.lo > self.program.hi):
            return self.record(Status.INFEASIBLE, None, -np.inf, started)
        A, b, cones = self.constraints()
        q = np.zeros(self.size)
        for c, p in self.program.powers:
            if p == 1:
                q[: self.k] += c
        for j, (c, _) in enumerate(self.curved):
            q[self.extra + j * self.k : self.extra + (j + 1) * self.k] = c
        q[self.peak :] = self.program.peak
        found = solve(sp.csc_matrix((self.size, self.size)), q, A, b, cones)
        z = np.array(found.x)
        if np.isfinite(z).all() and "Infeasible" not in str(found.status):
            bound = float(found.obj_val_dual) if self.radius else self.lower_bound(z, np.array(found.z))
            tried = self.record(Status.OK, z, bound, started)
            if tried.status is Status.OK:
                return tried
        if not prove_it:
            return self.record(Status.INACCURATE, None, -np.inf, started)
        if self.radius:
            # The solver's ray, checked: where A' ray = 0 > b . ray no x has A x + s = b with s in the cones.
            ray = np.array(found.z)
            along = float(b @ ray)
            proven = (
                str(found.status) == "PrimalInfeasible" and along < 0 and bool(np.abs(A.T @ ray).max() <= -1e-7 * along)
            )
        else:
            proven = self.proven_infeasible(A, b, cones)
        return self.record(Status.INFEASIBLE if proven else Status.INACCURATE, None, -np.inf, started)

    def proven_infeasible(self, A: sp.csc_matrix, b: Array, cones: Sequence[Cone]) -> bool:
        """Phase one over all loads: the least residuals and torque excesses give a certificate, which is checked in
        closed form.
        """
        m, per_load = len(self.program.R), self.facets + 2 * len(self.program.R)
        slack = np.zeros((A.shape[0], self.equalities + self.s * m))
        slack[np.arange(self.equalities), np.arange(self.equalities)] = -1.0
        for s in range(self.s):
            rows = self.torque_at + s * per_load + self.facets + np.arange(m)
            columns = self.equalities + s * m + np.arange(m)
            slack[rows, columns] = -1.0
            slack[rows + m, columns] = 1.0
        P = sp.diags(np.concatenate([np.zeros(self.size), np.ones(slack.shape[1])]), format="csc")
        found = solve(P, np.zeros(P.shape[0]), sp.hstack([A, sparse(slack)], format="csc"), b, cones)
        z = np.array(found.x)[self.size :]
        size = float(np.abs(z).max())
        if not np.isfinite(size) or size <= 1e-9:
            return False
        y = z[: self.equalities].reshape(self.s, self.rows) / size
        w = z[self.equalities :].reshape(self.s, m) / size
        slopes, total = self.shared(y, w)
        return total + self.program.least(slopes) > TOLERANCE.proof

    def constraints(self) -> tuple[sp.csc_matrix, Array, list[Cone]]:
        """Rows A, right-hand side b and cones of A x + s = b."""
        p, k, s = self.program, self.k, self.s
        _, facets, second, sizes = cone_rows(p.matrices)
        rows = Triplets(self.k, self.per_load)
        rows.of_every_load(p.A, s)
        b = [self.targets.ravel()]
        if self.radius:
            tangential = p.A.reshape(self.rows, k, p.d)[:, :, :-1].reshape(self.rows, -1)
            # A_t L = -1. Column order of L: (contact, component, row), so this is a Kronecker product.
            response = np.asarray(np.kron(tangential, np.eye(self.rows)), dtype=float)
            rows.add((response, self.L))
            b.append(-np.eye(self.rows).ravel())
        self.equalities = rows.height
        rows.add((np.concatenate([-np.eye(k), np.eye(k)]), 0))
        b += [-p.lo, p.hi]
        self.torque_at, self.facets = rows.height, len(facets)
        linear, limits = np.concatenate([facets, p.R, -p.R]), np.concatenate([np.zeros(len(facets)), p.R_hi, -p.R_lo])
        if not self.radius:
            rows.of_every_load(linear, s)
            b.append(np.tile(limits, s))
        if p.peak > 0:
            rows.add((np.eye(k), 0), (-np.ones((k, 1)), self.peak))
            b.append(np.zeros(k))
        inequalities = rows.height - self.equalities
        rows.of_every_load(second, s)
        b.append(np.zeros(s * len(second)))
        sizes = sizes * s
        if self.radius:
            sizes = sizes + self.ball_rows(rows, b, linear, limits)
        for j in range(len(self.curved)):
            power, force = np.zeros((3 * k, k)), np.zeros((3 * k, k))
            power[::3] = force[2::3] = -np.eye(k)
            rows.add((force, 0), (power, self.extra + j * k))
            b.append(np.tile([0.0, 1.0, 0.0], k))
        cones: list[Cone] = [clarabel.ZeroConeT(self.equalities), clarabel.NonnegativeConeT(inequalities)]
        cones += [clarabel.SecondOrderConeT(size) for size in sizes]
        cones += [clarabel.PowerConeT(1 / power) for _, power in self.curved for _ in range(k)]
        return rows.matrix(self.size), np.concatenate(b), cones

    def ball_rows(self, rows: Triplets, b: list[Array], linear: Array, limits: Array) -> list[int]:
        """Append every facet and torque row of every load with its response to the ball as a second-order cone; the
        cones' sizes.
        """
        p = self.program
        across = linear.reshape(len(linear), self.k, p.d)[:, :, :-1].reshape(len(linear), self.per_load)
        along = linear.reshape(len(linear), self.k, p.d)[:, :, -1]
        for s in range(self.s):
            for own, reach, limit in zip(along, across, limits):
                # limit - row . x >= radius |L' row|
                first = np.zeros((self.rows + 1, self.k + self.per_load))
                first[0] = np.concatenate([own, reach])
                swing = np.zeros((self.rows + 1, self.extra - self.L))
                swing[1:] = -self.radius * np.kron(reach[None], np.eye(self.rows))
                rows.add((first[:, : self.k], 0), (first[:, self.k :], self.k + s * self.per_load), (swing, self.L))
                b.append(np.concatenate([[limit], np.zeros(self.rows)]))
        return [self.rows + 1] * (self.s * len(linear))

    def multipliers(self, dual: Array) -> tuple[Array, Array]:
        """Balance (s, rows) and torque (s, m) multipliers of a solution without a ball."""
        m = len(self.program.R)
        y = dual[: self.s * self.rows].reshape(self.s, self.rows)
        per_load = dual[self.torque_at : self.torque_at + self.s * (self.facets + 2 * m)].reshape(
            self.s, self.facets + 2 * m
        )
        torque = per_load[:, self.facets :]
        return y, torque[:, :m] - torque[:, m:]

    def shared(self, y: Array, w: Array) -> tuple[Array, float]:
        """The sum over all loads of their duals' slopes in F_n (k,), which is common to them, and of the constants."""
        p = self.program
        c = (y @ p.A + w @ p.R).reshape(self.s, self.k, p.d)
        slopes: Array = (c[:, :, -1] - p.friction.support(c[:, :, :-1])).sum(axis=0)
        at_limits = float(np.maximum(w * p.R_hi, w * p.R_lo).sum())
        return slopes, -float(np.vdot(y, self.targets)) - at_limits

    def lower_bound(self, z: Array, dual: Array) -> float:
        """Proven bound of the objective: as in :mod:`pinograsp.forces.program`, with F_n shared by all loads."""
        p = self.program
        s, total = self.shared(*self.multipliers(dual))
        return total + p.separable(s, np.clip(z[: self.k], p.lo, p.hi))

    def record(self, status: Status, z: Array | None, bound: float, started: float) -> RobustForces:
        p, problem = self.program, self.problem
        forces, torsion, normal = np.zeros((0, self.k, 3)), np.zeros((0, self.k)), np.zeros(0)
        response: Array | None = None
        proof: Infeasibility | None = None
        certificate: Certificate | None = None
        if z is not None:
            F = z[: self.k]
            u = self.settled(z[self.k : self.L].reshape(self.s, self.k, self.e), F)
            x = np.concatenate([u, np.broadcast_to(F[None, :, None], (self.s, self.k, 1))], axis=2)
            if self.radius:
                response = z[self.L : self.extra].reshape(self.k, self.e, self.rows)
            certificate = self.certificate(x.reshape(self.s, -1), bound, response)
            if not certificate.is_optimal():
                status = Status.INACCURATE
            scale = problem.friction.scale(problem.mu) * p.force_scale
            forces = np.concatenate(
                [u[:, :, :2] * scale[:, :2], np.broadcast_to(F[None, :, None] * p.force_scale, (self.s, self.k, 1))],
                axis=2,
            )
            torsion = u[:, :, 2] * scale[:, 2] if self.e == 3 else np.zeros((self.s, self.k))
            normal = F * p.force_scale
        elif status is Status.INFEASIBLE:
            for single in self.suspects():
                proof = prove(single, feasibility(single, p.lo * p.force_scale, p.hi * p.force_scale))
                if proof is not None:
                    break
        return RobustForces(
            status=status,
            problem=problem,
            load_set=self.load_set,
            impact_time=self.t,
            normal_forces=read_only(normal),
            balanced=read_only(-self.targets * p.force_scale),
            forces_c=read_only(forces),
            torsion=read_only(torsion),
            response=None if response is None else read_only(response),
            certificate=certificate,
            infeasibility=proof,
            weights=p.matrices.weights,
            elapsed=time.perf_counter() - started,
        )

    def settled(self, u: Array, F: Array) -> Array:
        """u (s, k, d - 1) with the balance residuals removed by the least changes of the tangential forces."""
        columns = self.program.A.reshape(self.rows, self.k, -1)
        tangential = columns[:, :, :-1].reshape(self.rows, -1)
        residual = u.reshape(self.s, -1) @ tangential.T + columns[:, :, -1] @ F - self.targets
        settled: Array = u - (residual @ np.linalg.pinv(tangential, rcond=1e-10).T).reshape(u.shape)
        return settled

    def certificate(self, x: Array, bound: float, response: Array | None) -> Certificate:
        """The certificate for all loads, x (s, k d); ``response`` to the ball where there is one."""
        p, unit, force = self.program, self.program.objective_scale, self.program.force_scale
        F, objective = x[0, p.d - 1 :: p.d], p.value(x[0])
        residuals = x @ p.A.T - self.targets
        norms = np.linalg.norm(residuals, axis=1)
        worst, residual = int(np.argmax(norms)), np.zeros(6)
        residual[: self.rows] = residuals[worst] * force
        residual[3:] *= self.problem.moment_length
        u = x.reshape(self.s, self.k, p.d)[:, :, :-1]
        gauge = p.friction.gauge(u).max(axis=0)
        torque = x @ p.R.T
        violation = max(0.0, float(np.maximum(np.maximum(gauge, p.lo) - F, F - p.hi).max()))
        if len(p.R):
            violation = max(violation, float(np.maximum(torque - p.R_hi, p.R_lo - torque).max()))
        if response is not None:
            violation = max(violation, self.ball_violation(u, F, response))
        meets = np.zeros(0, dtype=bool)
        joints: tuple[str, ...] = ()
        if self.problem.torques is not None:
            joints = self.problem.torques.limited_joints
            meets = np.any((torque >= p.R_hi - TOLERANCE.active) | (torque <= p.R_lo + TOLERANCE.active), axis=0)
        return Certificate(
            objective=objective * unit,
            lower_bound=min(bound, objective) * unit,
            residual=frozen(residual),
            residual_norm=float(norms[worst]) * force,
            violation=violation * force,
            load_size=force,
            force_size=max(1.0, float(F.max())) * force,
            objective_size=objective_size_of(objective, 0.0) * unit,
            at_friction=frozen(gauge >= F * (1 - TOLERANCE.active)),
            at_least=frozen(p.lo * (1 + TOLERANCE.active) >= F),
            at_most=frozen(p.hi * (1 - TOLERANCE.active) <= F),
            at_torque=tuple(joint for joint, meet in zip(joints, meets) if meet),
        )

    def suspects(self) -> list[ForceProblem]:
        """The loads one by one; where numba is installed only those that cannot be held alone, if it finds any."""
        singles = [replace(self.problem, load=wrench) for wrench in self.load_set.loads]
        low, high = self.problem.normal_force_range(self.t)
        if not compiled_installed() or np.any(low > high):
            return singles
        from pinograsp.forces.batch import ForceBatch, solve_batch

        free = [replace(single, torques=None) for single in singles]
        held = solve_batch(ForceBatch.of(free, self.t), objective="work").ok
        scale = self.program.force_scale
        same = np.allclose(low, scale * self.program.lo) and np.allclose(high, scale * self.program.hi)
        if held.all() and (self.problem.torques is not None or not same):
            return singles  # torque limits, or bounds of other impact times, may exclude them
        return [single for single, ok in zip(singles, held) if not ok]

    def ball_violation(self, u: Array, F: Array, response: Array) -> float:
        """Largest excess over friction and torque limits under the worst disturbance, and the error of A_t L = -1."""
        p = self.program
        D = p.friction.facets
        reach = self.radius * np.linalg.norm(np.einsum("fe,ker->kfr", D, response), axis=2)
        worst = float((np.einsum("ske,fe->skf", u, D) + reach - F[None, :, None]).max())
        tangential = p.A.reshape(self.rows, self.k, p.d)[:, :, :-1]
        left = np.abs(np.einsum("ake,ker->ar", tangential, response) + np.eye(self.rows)).max() * self.radius
        if len(p.R):
            across = p.R.reshape(len(p.R), self.k, p.d)
            swing = self.radius * np.linalg.norm(np.einsum("mke,ker->mr", across[:, :, :-1], response), axis=1)
            torque = np.einsum("ske,mke->sm", u, across[:, :, :-1]) + across[:, :, -1] @ F
            worst = max(worst, float((torque + swing - p.R_hi).max()), float((p.R_lo - torque + swing).max()))
        return max(worst, float(left), 0.0)
