"""What holds every load of a set: common normal forces, and the contacts' reaction to each load."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from pinograsp.checks import array_of, brief
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.certificate import Certificate, Infeasibility
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.forces.solution import ConvexSolution, solution_of
from pinograsp.forces.solve.answers import Checks, ProgramAnswer, certify_answer
from pinograsp.forces.solve.program import feasibility
from pinograsp.forces.solve.solver_order import ProgramOutcome
from pinograsp.spatial import Array

Reaction = Literal["friction", "elastic"]

_SAME = 1e-12  # share of the largest load by which loads that are the same may differ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SqueezeScenario:
    """Normal forces of a squeeze with contacts or drives other than assumed, to first order.

    F = ``normal`` @ F_n + ``tangential`` @ t + ``offset``, from the forces planned under the problem's own load.

    Attributes:
        normal: (k, k), by the planned normal forces [-].
        tangential: (k, 2k), by the planned tangential forces, two for each contact [-].
        offset: (k,) [N].
    """

    normal: Array
    tangential: Array
    offset: Array

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustForces:
    """Normal forces that hold every load of a set, and friction's reactions.

    Attributes:
        status: ``OK``, ``INFEASIBLE`` or ``INACCURATE``.
        problem: as solved (least mu; polyhedral friction for a ball).
        load_set: the loads that are held.
        impact_time: t_I [s].
        reaction: whether contacts react by friction alone or as springs, too.
        normal_forces: F_n (k,) [N], common to all loads; with springs: under the problem's own load. Empty without a
            solution.
        balanced: the loads of ``forces_c``, as scaled wrenches in the balance rows (s, rows) [N].
        forces_c: contact forces for each load (s, k, 3) [N].
        torsion: moments about the contact normals for each load (s, k) [N m].
        response: change of the scaled tangential forces per unit of disturbance (k, d - 1, rows), or None without a
            ball.
        certificate: residual and limits under the worst of the loads; the lower bound holds for all normal forces that
            hold the set (for a ball: among affine reactions, by the solver's dual). None without a solution.
        infeasibility: proof that a single load of the set cannot be held, or None.
        weights: the objective, ``{name: weight}``.
        tried: number of impact times that were tried; more than 1: a search chose this one.
        elapsed: computing time [s].
    """

    status: Status
    problem: ForceProblem
    load_set: LoadSet
    impact_time: float
    reaction: Reaction
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

    def __str__(self) -> str:
        return self.explain()

    def under(self, load: ArrayLike | None = None) -> ConvexSolution:
        """Return the forces under one load of the set (6,) [N, N m]: the contacts' reaction to it with the common
        squeeze.

        The reaction is a weighted mean of the reactions to the set's loads, plus the response to the rest. Default: the
        problem's own load if it is in the set, else the mean of the set's loads. The certificate is that of the
        squeeze, under the worst of the loads.

        Raises:
            InvalidInput: no normal forces exist, or the load is not in the set.
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
        normal = self.normal_forces if self.reaction == "friction" else mean[:, 2]
        program = feasibility(problem, normal, normal)
        x = np.column_stack([u, normal]).ravel() / program.force_scale
        violation, gauge, residual = program.violations(x)
        y, w = np.zeros(len(program.b)), np.zeros(len(program.R))
        bound = program.lower_bound(x, y, w)
        checks = Checks(violation, gauge, residual, program.value(x), bound)
        forces = certify_answer(problem, program, ProgramAnswer(x, y, w, checks))
        outcome = ProgramOutcome(status=self.status, solver="clarabel", forces=forces)
        found = solution_of(problem, outcome, impact_time=self.impact_time, weights=self.weights, started=started)
        return replace(found, search="robust", certificate=self.certificate)

    def _shares(self, load: Array) -> tuple[Array, Array]:
        """Weights (s,) of the set's loads whose mean is nearest to ``load`` (6,), and the rest of it (rows,) [N]."""
        scaled = self.problem.scale_wrenches(load)
        size = float(np.abs(self.balanced).max()) or 1.0
        same = np.abs(self.balanced - scaled).max(axis=1) <= _SAME * size
        if same.any():
            shares = (np.arange(len(same)) == np.argmax(same)).astype(float)
            return shares, scaled - shares @ self.balanced
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
                f"no common normal forces hold all of {loads} (proven), though no single load is proven to be "
                "infeasible: make the set smaller, or diagnose() its loads"
            )
        return f"neither forces for {loads} nor a proof that there are none: {self.status.remedy}"
