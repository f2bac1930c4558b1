"""The convex program of :mod:`pinograsp.forces.robust.optimum`, its dual bound, proofs and certificate."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse as sp

from pinograsp import core
from pinograsp.checks import frozen, read_only
from pinograsp.errors import Status
from pinograsp.forces.certificate import TOLERANCE, Certificate, Infeasibility, objective_size_of
from pinograsp.forces.infeasibility import prove
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.forces import Reaction, RobustForces
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.forces.solve.conic import Cone, Triplets, cone_rows, even_rows, solve, sparse
from pinograsp.forces.solve.program import Program, feasibility
from pinograsp.spatial import Array, BoolArray

# Whether the rows of balance are evened, and the solver's steps short: until forces are certified.
_ATTEMPTS = (True, False), (True, True), (False, False), (False, True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReactedLoads:
    """Loads, how the contacts react to them, and what else the normal forces have to keep to.

    Attributes:
        reaction: of the contacts.
        loads: as scaled wrenches (s, rows) [N].
        changes: of the normal forces by each load (s, k) [N].
        shares: of the common F_n (s, k, k), and of the scaled tangential forces of the first load (s, k, k (d - 1)), in
            the normal forces of each load, where contacts are softer or stiffer than planned; None: F_n is common.
        first: number of loads on contacts as stiff as planned, which come first.
        fixed: rows (p, k) and values (p,) [N] of equations on the normal forces.
        own: index of the problem's own load among them, whose forces keep to the equations of an underactuated hand;
            None: there are no such equations.
    """

    reaction: Reaction
    loads: Array
    changes: Array
    fixed: tuple[Array, Array]
    own: int | None = None
    shares: tuple[Array, Array] | None = None
    first: int | None = None

    def select(self, which: BoolArray) -> ReactedLoads:
        """Those of the loads (s,), among them all on contacts as stiff as planned."""
        shares = None if self.shares is None else (self.shares[0][which], self.shares[1][which])
        return replace(self, loads=self.loads[which], changes=self.changes[which], shares=shares)


class RobustProgram:
    """Columns: F (k), u per load (s, k, d - 1), L (k, d - 1, rows) with a ball, one t per power and contact, peak."""

    def __init__(
        self, problem: ForceProblem, program: Program, reacted: ReactedLoads, load_set: LoadSet, impact_time: float
    ):
        self.problem, self.program, self.t = problem, program, impact_time
        self.load_set, self.reacted = load_set, reacted
        self.targets, self.changes = -reacted.loads / program.force_scale, reacted.changes / program.force_scale
        self.fixed, self.values = reacted.fixed[0], reacted.fixed[1] / program.force_scale
        self.k, self.e, self.s = program.k, program.d - 1, len(reacted.loads)
        self.shares, self.first = reacted.shares, self.s if reacted.first is None else reacted.first
        self.rows = len(program.b)
        # Columns of the balance: of the tangential forces (rows, k (d - 1)), and of the normal ones (rows, k).
        columns = program.A.reshape(self.rows, self.k, -1)
        self.across, self.along = columns[:, :, :-1].reshape(self.rows, -1), columns[:, :, -1]
        self.evened = self.weighed = even_rows(self.across)
        self.radius = load_set.ball / program.force_scale
        self.per_load = self.k * self.e
        self.L = self.k + self.s * self.per_load
        # Limits of the torque rows of every load (s, m).
        self.R_lo, self.R_hi = (np.tile(limits, (self.s, 1)) for limits in (program.R_lo, program.R_hi))
        if reacted.own is not None:
            equations = np.arange(len(program.R)) >= len(program.R) - program.matrices.fixed
            others = np.ix_(np.arange(self.s) != reacted.own, equations)
            reach = np.maximum(2.0 * program.matrices.R_reach @ program.hi, 1.0)[equations]
            reach = reach + np.maximum(np.abs(program.R_lo), np.abs(program.R_hi))[equations]
            self.R_lo[others], self.R_hi[others] = -reach, reach
        self.curved = [(c, p) for c, p in program.powers if p != 1]
        self.found: tuple[Array, Array] | None = None  # F_n (k,) and u (s, k, d - 1) of the last record with forces
        self.extra = self.L + (self.per_load * self.rows if self.radius else 0)
        self.peak = self.extra + self.k * len(self.curved)
        self.size = self.peak + (program.peak > 0)

    def solve(self, prove_it: bool) -> RobustForces:
        """The record of the forces, or of the proof that there are none, which is looked for where asked."""
        started = time.perf_counter()
        if np.any(self.program.lo > self.program.hi):
            return self.record(Status.INFEASIBLE, None, -np.inf, started)
        q = np.zeros(self.size)
        for c, p in self.program.powers:
            if p == 1:
                q[: self.k] += c
        for j, (c, _) in enumerate(self.curved):
            q[self.extra + j * self.k : self.extra + (j + 1) * self.k] = c
        q[self.peak :] = self.program.peak
        P = sp.csc_matrix((self.size, self.size))
        for weighed, careful in _ATTEMPTS:
            if not careful:
                A, b, cones = self.constraints(weighed)
            found = solve(P, q, A, b, cones, careful=careful)
            z = np.array(found.x)
            if "Infeasible" in str(found.status):
                break
            if np.isfinite(z).all():
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
            proven = self.proven_infeasible(weighed) or self.proven_infeasible(not weighed)
        return self.record(Status.INFEASIBLE if proven else Status.INACCURATE, None, -np.inf, started)

    def proven_infeasible(self, weighed: bool) -> bool:
        """Phase one over all loads, with rows evened or not: the least residuals and torque excesses give a
        certificate, which is checked in closed form.
        """
        A, b, cones = self.constraints(weighed)
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
        y = z[: self.s * self.rows].reshape(self.s, self.rows) @ self.weighed / size
        w = z[self.equalities :].reshape(self.s, m) / size
        slopes, total = self.sum_slopes(y, w, z[self.fixed_at : self.equalities] / size)
        return total + self.program.least(slopes) > TOLERANCE.proof

    def constraints(self, weighed: bool) -> tuple[sp.csc_matrix, Array, list[Cone]]:
        """Rows A, right-hand side b and cones of A x + s = b, with the rows of balance evened or as they are."""
        self.weighed = self.evened if weighed else np.eye(self.rows)
        p, k, s = self.program, self.k, self.s
        self.select, facets, second, sizes = cone_rows(p.matrices)
        rows = Triplets(self.k, self.per_load)
        rows.of_every_load(self.weighed @ p.A, s, self.shares)
        b = [((self.targets - self.react_to(p.A)) @ self.weighed.T).ravel()]
        if self.radius:
            # A_t L = -1. Column order of L: (contact, component, row), so this is a Kronecker product.
            response = np.asarray(np.kron(self.across, np.eye(self.rows)), dtype=float)
            rows.add((response, self.L))
            b.append(-np.eye(self.rows).ravel())
        self.fixed_at = rows.height
        if len(self.fixed):
            rows.add((self.fixed, 0))
            b.append(self.values)
        self.equalities = rows.height
        rows.add((np.concatenate([-np.eye(k), np.eye(k)]), 0))
        b += [-p.lo, p.hi]
        self.torque_at, self.facets = rows.height, len(facets)
        linear = np.concatenate([facets, p.R, -p.R])
        limits = np.hstack([np.zeros((s, len(facets))), self.R_hi, -self.R_lo])
        if not self.radius:
            rows.of_every_load(linear, s, self.shares)
            b.append((limits - self.react_to(linear)).ravel())
        self.caps_at, caps = rows.height, self.problem.max_normal_force
        if self.first < s and caps is not None:
            rows.of_every_load(self.select, s, self.shares)
            b.append((caps / p.force_scale - self.changes).ravel())
        self.caps_end = rows.height
        if p.peak > 0:
            rows.add((np.eye(k), 0), (-np.ones((k, 1)), self.peak))
            b.append(np.zeros(k))
        inequalities = rows.height - self.equalities
        self.cones_at, self.slipping = rows.height, (facets, second)
        rows.of_every_load(second, s, self.shares)
        b.append(-self.react_to(second).ravel())
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

    def react_to(self, rows: Array) -> Array:
        """What the changes of the normal forces add to rows on x, for every load (s, rows)."""
        found: Array = self.changes @ rows.reshape(len(rows), self.k, self.program.d)[:, :, -1].T
        return found

    def ball_rows(self, rows: Triplets, b: list[Array], linear: Array, limits: Array) -> list[int]:
        """Append every facet and torque row of every load with its response to the ball as a second-order cone; the
        cones' sizes.
        """
        p = self.program
        across = linear.reshape(len(linear), self.k, p.d)[:, :, :-1].reshape(len(linear), self.per_load)
        along = linear.reshape(len(linear), self.k, p.d)[:, :, -1]
        reacting = self.react_to(linear)
        for s in range(self.s):
            for own, reach, limit in zip(along, across, limits[s] - reacting[s]):
                # limit - row . x >= radius |L' row|
                first = np.zeros((self.rows + 1, self.k + self.per_load))
                first[0] = np.concatenate([own, reach])
                swing = np.zeros((self.rows + 1, self.extra - self.L))
                swing[1:] = -self.radius * np.kron(reach[None], np.eye(self.rows))
                rows.add((first[:, : self.k], 0), (first[:, self.k :], self.k + s * self.per_load), (swing, self.L))
                b.append(np.concatenate([[limit], np.zeros(self.rows)]))
        return [self.rows + 1] * (self.s * len(linear))

    def normal(self, F: Array, u: Array) -> Array:
        """The normal forces under every load (s, k), of the common ones (k,) and of the first load's u (k, d - 1)."""
        if self.shares is None:
            return np.asarray(F + self.changes)
        common, across = self.shares
        return np.asarray(common @ F + across @ u.ravel() + self.changes)

    def multipliers(self, dual: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Multipliers of balance (s, rows), torque (s, m), equations (p,), caps (s, k) and friction (s, k) of a
        solution without a ball; the last as far as they count on the normal forces.
        """
        m = len(self.program.R)
        y = dual[: self.s * self.rows].reshape(self.s, self.rows) @ self.weighed
        per_load = dual[self.torque_at : self.torque_at + self.s * (self.facets + 2 * m)].reshape(
            self.s, self.facets + 2 * m
        )
        torque = per_load[:, self.facets :]
        caps = np.zeros((self.s, self.k))
        if self.caps_end > self.caps_at:
            caps = np.maximum(dual[self.caps_at : self.caps_end], 0.0).reshape(self.s, self.k)
        facets, second = (rows.reshape(len(rows), self.k, self.program.d)[:, :, -1] for rows in self.slipping)
        across = dual[self.cones_at : self.cones_at + self.s * len(second)].reshape(self.s, len(second))
        friction = -per_load[:, : self.facets] @ facets - across @ second
        return y, torque[:, :m] - torque[:, m:], dual[self.fixed_at : self.equalities], caps, friction

    def sum_slopes(
        self, y: Array, w: Array, v: Array, caps: Array | None = None, friction: Array | None = None
    ) -> tuple[Array, float]:
        """The sum over all loads of their duals' slopes in F_n (k,), which is common to them, and of the constants.

        In scenarios a load's slope is one in F_n and in the first load's u, and what friction counts on a normal force
        beyond its own share says that this does not pull.
        """
        p, most = self.program, self.problem.max_normal_force
        c = (y @ p.A + w @ p.R).reshape(self.s, self.k, p.d)
        along, across, limited = c[:, :, -1], c[:, :, :-1], 0.0
        if caps is not None and most is not None:
            along = along + caps
            limited = float(caps.sum(axis=0) @ most) / p.force_scale
        slopes: Array = along - p.friction.support(across)
        if self.shares is not None:
            if friction is not None:
                slopes[1:] -= np.maximum(friction - p.friction.support(across), 0.0)[1:]
            first = across[0] + np.einsum("sk,ska->a", slopes[1:], self.shares[1][1:]).reshape(self.k, self.e)
            slopes[0] = along[0] - p.friction.support(first)
        at_limits = float(np.maximum(w * self.R_hi, w * self.R_lo).sum())
        reacting = float(np.vdot(slopes, self.changes)) - limited
        constant = reacting - float(np.vdot(y, self.targets)) - float(v @ self.values) - at_limits
        if self.shares is None:
            return slopes.sum(axis=0) + v @ self.fixed, constant
        return np.einsum("sk,skj->j", slopes, self.shares[0]) + v @ self.fixed, constant

    def lower_bound(self, z: Array, dual: Array) -> float:
        """Proven bound of the objective: as in :mod:`pinograsp.forces.solve.program`, with F_n shared by all loads."""
        p = self.program
        s, total = self.sum_slopes(*self.multipliers(dual))
        return total + p.separable(s, np.clip(z[: self.k], p.lo, p.hi))

    def record(self, status: Status, z: Array | None, bound: float, started: float) -> RobustForces:
        """What came of it: of forces z, certified; without them, perhaps the proof of one load."""
        p, problem = self.program, self.problem
        forces, torsion, normal = np.zeros((0, self.k, 3)), np.zeros((0, self.k)), np.zeros(0)
        response: Array | None = None
        proof: Infeasibility | None = None
        certificate: Certificate | None = None
        if z is not None:
            F = z[: self.k]
            u = self.remove_residuals(z[self.k : self.L].reshape(self.s, self.k, self.e), F)
            x = np.concatenate([u, self.normal(F, u[0])[:, :, None]], axis=2)
            if self.radius:
                response = z[self.L : self.extra].reshape(self.k, self.e, self.rows)
            self.found = F, u
            certificate = self.certificate(F, x.reshape(self.s, -1), bound, response)
            if not certificate.is_optimal():
                status = Status.INACCURATE
            scale = problem.friction.scale(problem.mu) * p.force_scale
            forces = np.concatenate([u[:, :, :2] * scale[:, :2], x[:, :, -1:] * p.force_scale], axis=2)
            torsion = u[:, :, 2] * scale[:, 2] if self.e == 3 else np.zeros((self.s, self.k))
            forces, torsion = forces[: self.first], torsion[: self.first]
            normal = F * p.force_scale
        elif status is Status.INFEASIBLE:
            planned = self.changes[: self.first]
            low, high = p.lo + planned.min(axis=0), p.hi + planned.max(axis=0)
            for single in self.suspects():
                proof = prove(single, feasibility(single, np.maximum(low, 0.0) * p.force_scale, high * p.force_scale))
                if proof is not None:
                    break
        return RobustForces(
            status=status,
            problem=problem,
            load_set=self.load_set,
            impact_time=self.t,
            reaction=self.reacted.reaction,
            normal_forces=read_only(normal),
            balanced=read_only(-self.targets[: self.first] * p.force_scale),
            forces_c=read_only(forces),
            torsion=read_only(torsion),
            response=None if response is None else read_only(response),
            certificate=certificate,
            infeasibility=proof,
            weights=p.matrices.weights,
            elapsed=time.perf_counter() - started,
        )

    def remove_residuals(self, u: Array, F: Array) -> Array:
        """u (s, k, d - 1) with the balance residuals removed by the least changes of the tangential forces."""
        inverse, settled = np.linalg.pinv(self.across, rcond=1e-10).T, u
        # Twice where the normal forces of other loads follow the first one's tangential forces.
        for _ in range(1 if self.shares is None else 2):
            normal = self.normal(F, settled[0])
            residual = settled.reshape(self.s, -1) @ self.across.T + normal @ self.along.T - self.targets
            settled = settled - (residual @ inverse).reshape(u.shape)
        return settled

    def find_unmet(self, F: Array, tried: Sequence[Array]) -> Array:
        """By how much the loads are not met (s,), relative to the largest force, by the best of some tangential forces,
        each (s, k, d - 1) and mended to balance: what is not above the tolerance is proven to be held.
        """
        p, normal, across = self.program, self.normal(F, tried[0][0]), self.across
        wanted = self.targets - normal @ self.along.T
        # The more a contact presses, the more of what is missing it takes.
        weights = np.repeat(np.maximum(normal, 1e-9 * F.max()), self.e, axis=1)
        spread = weights[:, :, None] * across.T
        inverse = spread @ np.linalg.pinv(across @ spread, rcond=1e-10, hermitian=True)
        least, size = np.full(self.s, np.inf), max(1.0, float(F.max()))
        caps = self.problem.max_normal_force
        over = np.zeros(self.s) if caps is None else (normal - caps / p.force_scale).max(axis=1)
        over[: self.first] = 0.0
        for u in tried:
            flat = u.reshape(self.s, -1)
            for _ in range(2):
                flat = flat + np.einsum("sar,sr->sa", inverse, wanted - flat @ across.T)
            mended = flat.reshape(u.shape)
            left = np.abs(wanted - flat @ across.T).max(axis=1)
            torque = np.concatenate([mended, normal[:, :, None]], axis=2).reshape(self.s, -1) @ p.R.T
            beyond = np.maximum(torque - self.R_hi, self.R_lo - torque).max(axis=1, initial=0.0)
            slipping = (p.friction.gauge(mended) - normal).max(axis=1)
            least = np.minimum(least, np.max([left, beyond, slipping, over], axis=0))
        return least / size

    def certificate(self, F: Array, x: Array, bound: float, response: Array | None) -> Certificate:
        """The certificate for all loads, F (k,) and x (s, k d); ``response`` to the ball where there is one."""
        p, unit, force = self.program, self.program.objective_scale, self.program.force_scale
        common = x[0].copy()
        common[p.d - 1 :: p.d] = F
        objective = p.value(common)
        residuals = x @ p.A.T - self.targets
        norms = np.linalg.norm(residuals, axis=1)
        worst, residual = int(np.argmax(norms)), np.zeros(6)
        residual[: self.rows] = residuals[worst] * force
        residual[3:] *= self.problem.moment_length
        u, normal = x.reshape(self.s, self.k, p.d)[:, :, :-1], x[:, p.d - 1 :: p.d]
        slack = (normal - p.friction.gauge(u)).min(axis=0)
        torque = x @ p.R.T
        violation = max(0.0, float(np.maximum(np.maximum(-slack, p.lo - F), F - p.hi).max()))
        if len(p.R):
            violation = max(violation, float(np.maximum(torque - self.R_hi, self.R_lo - torque).max()))
        if len(self.fixed):
            violation = max(violation, float(np.abs(self.fixed @ F - self.values).max()))
        if self.first < self.s and self.problem.max_normal_force is not None:
            violation = max(violation, float((normal - self.problem.max_normal_force / force).max()))
        if response is not None:
            violation = max(violation, self.ball_violation(u, F, response))
        meets = np.zeros(0, dtype=bool)
        joints: tuple[str, ...] = ()
        if self.problem.torques is not None:
            joints = self.problem.torques.limited_joints
            meets = np.any((torque >= self.R_hi - TOLERANCE.active) | (torque <= self.R_lo + TOLERANCE.active), axis=0)
        return Certificate(
            objective=objective * unit,
            lower_bound=min(bound, objective) * unit,
            residual=frozen(residual),
            residual_norm=float(norms[worst]) * force,
            violation=violation * force,
            load_size=force,
            force_size=max(1.0, float(F.max())) * force,
            objective_size=objective_size_of(objective, 0.0) * unit,
            at_friction=frozen(slack <= F * TOLERANCE.active),
            at_least=frozen(p.lo * (1 + TOLERANCE.active) >= F),
            at_most=frozen(p.hi * (1 - TOLERANCE.active) <= F),
            at_torque=tuple(joint for joint, meet in zip(joints, meets) if meet),
        )

    def suspects(self) -> list[ForceProblem]:
        """The loads one by one; where the core is installed only those that cannot be held alone, if it finds any."""
        problem, torques = self.problem, self.problem.torques
        if torques is not None and torques.underactuation is not None:
            problem = replace(problem, torques=replace(torques, underactuation=None))
        singles = [replace(problem, load=wrench) for wrench in self.load_set.loads]
        if problem is not self.problem:
            return [self.problem, *singles]
        low, high = self.problem.normal_force_range(self.t)
        if not core.is_installed() or np.any(low > high):
            return singles
        from pinograsp.forces.solve.batch import ForceBatch, solve_batch

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
        worst = float((np.einsum("ske,fe->skf", u, D) + reach - (F + self.changes)[:, :, None]).max())
        tangential = self.across.reshape(self.rows, self.k, self.e)
        left = np.abs(np.einsum("ake,ker->ar", tangential, response) + np.eye(self.rows)).max() * self.radius
        if len(p.R):
            across = p.R.reshape(len(p.R), self.k, p.d)
            swing = self.radius * np.linalg.norm(np.einsum("mke,ker->mr", across[:, :, :-1], response), axis=1)
            torque = np.einsum("ske,mke->sm", u, across[:, :, :-1]) + (F + self.changes) @ across[:, :, -1].T
            worst = max(worst, float((torque + swing - self.R_hi).max()), float((self.R_lo - torque + swing).max()))
        return max(worst, float(left), 0.0)
