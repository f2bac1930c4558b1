"""The least-cost contact forces at one impact time: solve, certify, or prove that there are none."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import brief, frozen, instance_of, one_of, read_only, record_of
from pinograsp.errors import Status
from pinograsp.forces.active_set import solve_dense
from pinograsp.forces.conic import HUGE, solve_conic
from pinograsp.forces.infeasibility import Infeasibility, forces_of, prove
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import (
    BALANCE,
    GAP,
    NEAR,
    VIOLATION,
    Program,
    assemble,
    energy_terms_at,
    gap_size,
    weights_of,
)
from pinograsp.forces.solution import ForceSolution
from pinograsp.forces.solvers import SOLVERS, compiled_solvers

_USEFUL = 1e-3  # of the load: what misses its limits by more is no answer at all
_COMPILED = ("interior", "newton")
FORCE_SOLVERS = ("auto", *_COMPILED, *SOLVERS)
# Up to here a dense active-set method is faster on pyramids than a sparse interior-point method (benchmarks/forces.py).
_DENSE_UP_TO = 20


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: see record_of
class Certificate:
    """Why an answer can be trusted: computed from the answer by this package, not reported by the solver.

    Attributes:
        primal: objective at the forces.
        dual: proven lower bound of the objective of *any* admissible forces.
        balance_force, balance_moment: norm of the net force [N] and moment [N m] left (the moment counts in wrench
            balance only).
        limit_violation: largest violation of friction, of the bounds on F_n or of a torque limit (there: the change of
            contact forces that would mend it) [N].
        at_friction, at_least, at_most: (k,) bool, active limits by contact.
        at_torque: joints at their torque limit.
        size: what ``relative_gap`` is relative to: the objective, or 1 % of what forces like the load cost where it
            vanishes.
    """

    primal: float
    dual: float
    balance_force: float
    balance_moment: float
    limit_violation: float
    at_friction: np.ndarray
    at_least: np.ndarray
    at_most: np.ndarray
    at_torque: tuple[str, ...]
    size: float

    __repr__ = brief()

    @property
    def gap(self) -> float:
        """primal - dual, in the objective's unit."""
        return self.primal - self.dual

    @property
    def relative_gap(self) -> float:
        """Gap relative to ``size`` [-]."""
        return self.gap / self.size

    def active(self, names) -> tuple[str, ...]:
        """The active constraints in words, for contacts called ``names``."""
        words = [
            f"{name}: {what}"
            for what, mask in (
                ("friction limit", self.at_friction),
                ("least normal force", self.at_least),
                ("largest normal force", self.at_most),
            )
            for name, meets in zip(names, mask)
            if meets
        ]
        return (*words, *(f"{joint}: torque limit" for joint in self.at_torque))


def optimize_forces(
    problem: ForceProblem,
    impact_time: float,
    *,
    objective: str | Mapping[str, float] | None = None,
    solver: str = "auto",
) -> ForceSolution:
    """The contact forces of least cost for an impact at t_I (method of Eqs. 12-16 with the forces as variables).

    Balance, friction model and safety factor, caps, torque limits and deceleration shape are the problem's own.

    Args:
        problem: contacts, load, friction, limits.
        impact_time: t_I [s]; it sets the range of F_n (Eqs. 13) and the energy.
        objective: one of ``"impulse"`` [N s], ``"work"`` [J] (grasp energy, Eqs. 11 and 9), ``"least_squares"`` (sum of
            squared contact forces [N^2]; torsional moments over the moment length), ``"peak"`` (largest F_n [N]),
            ``"motor_heat"`` (sum of squared joint torques [N^2 m^2]; needs ``problem.torques``); or weights
            ``{name: weight}`` of a sum of them. Default: ``problem.measure``. All convex, solved to optimality.
        solver: ``"auto"``: after :func:`warm_up` a compiled method: Newton on the dual (``"newton"``; cones, soft
            fingers and 4-edge pyramids without torque limits) or interior points (``"interior"``; all but peak and
            coupled motor heat); else DAQP up to 20 contacts, and Clarabel. Or a name of :data:`FORCE_SOLVERS`. A
            backend that cannot take the problem or whose answer fails its certificate hands over to DAQP and Clarabel;
            the record says which one ran.

    Returns:
        A record with status ``OK`` and its certificate; ``INFEASIBLE`` with a checked proof in ``infeasibility``; or
        ``INACCURATE`` where neither could be certified.

    Raises:
        InvalidInput: an impact time not below t_F, an unknown objective or solver.
    """
    started = time.perf_counter()
    if not isinstance(problem, ForceProblem):
        instance_of("problem", problem, ForceProblem)
    try:  # checked before, when it was prepared
        key = (impact_time, tuple(objective.items()) if isinstance(objective, Mapping) else objective, solver)
        ready = problem._prepared.get(key)
    except TypeError:  # no such thing can be a key
        ready = key = None
    if ready is None:
        impact_time = problem.checked_impact_time(impact_time)
        weights = weights_of(objective, problem)
        one_of("solver", solver, FORCE_SOLVERS)
        compiled = sys.modules.get("pinograsp.forces.compiled")
        if compiled is not None and key is not None:
            ready = compiled.prepare(problem, weights, impact_time, solver, key)
    if ready is not None:
        found = _compiled(problem, ready, started)
        if found is not None:
            return found
        impact_time, weights = ready.impact_time, ready.weights
    terms = energy_terms_at(problem, weights, impact_time)
    program = assemble(problem, weights, terms, *problem.normal_force_range(impact_time))
    x, status, certificate, proof, solver = solve_certified(problem, program, solver)
    return record(problem, program, impact_time, x, status, certificate, proof, solver, weights, started)


def _compiled(problem, ready, started) -> ForceSolution | None:
    """The compiled path's record; None where it has no certified answer."""
    answer = ready.forces(problem.load)
    if answer is None:
        return None
    newton, (primal, dual, size, force, moment, violation), arrays = answer
    wrench, forces, torsion, multipliers, acceleration, at_friction, at_least, at_most, at_torque = arrays
    certificate = record_of(
        Certificate,
        {
            "primal": primal,
            "dual": dual,
            "balance_force": force,
            "balance_moment": moment,
            "limit_violation": violation,
            "at_friction": at_friction,
            "at_least": at_least,
            "at_most": at_most,
            "at_torque": tuple(ready.joints[row] for row in at_torque.nonzero()[0]) if ready.joints else (),
            "size": size,
        },
    )
    return record_of(
        ForceSolution,
        {
            "status": Status.OK,
            "problem": problem,
            "search": "convex",
            "solver": "newton" if newton else "interior",
            "objective": dict(ready.weights),
            "impact_time": ready.impact_time,
            "acceleration": acceleration,
            "multipliers": multipliers,
            "forces_c": forces,
            "torsion": torsion,
            "net_wrench": wrench,
            "certificate": certificate,
            "rejections": {},
            "elapsed": time.perf_counter() - started,
        },
    )


def warm_up() -> None:
    """Load and compile the solvers made for grasp forces (extra ``fast``), so that ``solver="auto"`` uses them from now
    on.

    Those of :class:`~pinograsp.motion.OnlineForces` and :func:`~pinograsp.forces.solve_batch` as well: nothing is left
    to compile. It takes a minute or two once per machine (the result is cached on disk; NUMBA_CACHE_DIR says where),
    loading some seconds.

    Raises:
        ExtraMissing: numba is not installed.
    """
    compiled_solvers()
    from pinograsp.forces import compiled

    compiled.compile_now()


def _backends(program: Program, solver: str) -> tuple[str, ...]:
    """The backends to ask, in order: the one asked for, then the general ones; every one takes what it can."""
    general = ("daqp", "clarabel") if program.k <= _DENSE_UP_TO else ("clarabel", "daqp")
    if solver == "auto":
        compiled = sys.modules.get("pinograsp.forces.compiled")
        solver = (compiled.template_of(program).choice(solver) if compiled else "") or general[0]
    return tuple(dict.fromkeys((solver, *general)))


def _answer(program: Program, name: str):
    if name == "clarabel":
        return solve_conic(program)
    if name not in _COMPILED:
        return solve_dense(program, name)
    if "pinograsp.forces.compiled" not in sys.modules:
        warm_up()
    from pinograsp.forces.compiled import solve_program

    return solve_program(program, name)


def solve_certified(
    problem: ForceProblem, program: Program, solver: str
) -> tuple[np.ndarray | None, Status, Certificate | None, Infeasibility | None, str]:
    """x, status, certificate or proof, and the solver that gave them; a failed certificate asks the next.

    Where none passes a proof of infeasibility is tried, in the name of the first one asked.
    """
    best = None
    if np.all(program.lo <= program.hi):
        backends = _backends(program, solver)
        for name in backends:
            answer = _answer(program, name)
            if answer is not None and all(np.abs(part).max(initial=0.0) < HUGE for part in answer[:3]):
                checked = _Checked(program, *answer)
                x = checked.x
                if checked.passed:
                    return x, Status.OK, checked.certificate(problem), None, name
                # Kept for the record, unless it is of no use: the one that misses its limits least.
                if checked.violation <= _USEFUL and (best is None or checked.violation < best[1].violation):
                    best = (x, checked, name)
        proof = prove(problem, program)
        if proof is not None:
            return None, Status.INFEASIBLE, None, proof, backends[0]
    else:
        return None, Status.INFEASIBLE, None, prove(problem, program), ""
    if best is None:
        return None, Status.INACCURATE, None, None, solver
    x, checked, name = best
    return x, Status.INACCURATE, checked.certificate(problem), None, name


class _Checked:
    """Every check of an answer x with its multipliers y and w, and the lower bound that these prove."""

    def __init__(self, program: Program, x: np.ndarray, y: np.ndarray, w: np.ndarray, known: tuple | None = None):
        if known is not None:
            self.program, self.x = program, x
            self.violation, self.gauge, self.residual, self.value, self.bound = known
            self.judge()
            return
        self.violation, self.gauge, self.residual = program.violations(x)
        if self.residual @ self.residual > 1e-26:
            x = program.settled(x, self.residual)
            self.violation, self.gauge, self.residual = program.violations(x)
        self.program, self.x = program, x
        self.value = program.value(x)
        self.bound = program.lower_bound(x, y, w, refine=False)
        if self.value - self.bound > 0.2 * GAP * self.size():
            self.bound = max(self.bound, program.lower_bound(x, y, w))
        self.judge()

    def judge(self) -> None:
        """Whether all checks pass."""
        self.bound = max(self.bound, -self.program.constant)  # no objective is negative
        largest = self.x[self.program.d - 1 :: self.program.d]
        self.passed = bool(
            self.residual @ self.residual <= BALANCE**2
            and (self.violation <= VIOLATION or self.violation <= VIOLATION * largest.max())
            and self.value - self.bound <= GAP * self.size()
        )

    def size(self) -> float:
        """What the gap is measured against: the objective, where it does not vanish."""
        return gap_size(self.value + self.program.constant, self.program.constant)

    def certificate(self, problem: ForceProblem) -> Certificate:
        """The certificate in the problem's units."""
        near, program = NEAR, self.program
        F = self.x[program.d - 1 :: program.d]
        residual = self.residual * program.force_scale
        at_torque: tuple[str, ...] = ()
        if len(program.R):
            torque = program.R @ self.x
            meets = (torque >= program.R_hi - near) | (torque <= program.R_lo + near)
            at_torque = tuple(joint for joint, meet in zip(problem.torques.limited_joints, meets) if meet)
        force, moment = residual[:3], residual[3:]
        return Certificate(
            primal=(self.value + program.constant) * program.objective_scale,
            # A bound from duals that are exact to rounding can exceed the value by rounding.
            dual=(min(self.bound, self.value) + program.constant) * program.objective_scale,
            balance_force=math.sqrt(force @ force),
            balance_moment=math.sqrt(moment @ moment) * problem.moment_length,
            limit_violation=self.violation * program.force_scale,
            at_friction=self.gauge >= F * (1 - near),
            at_least=program.lo * (1 + near) >= F,
            at_most=program.hi * (1 - near) <= F,
            at_torque=at_torque,
            size=self.size() * program.objective_scale,
        )


def record(
    problem, program, impact_time, x, status, certificate, proof, solver, weights, started, **details
) -> ForceSolution:
    """The :class:`ForceSolution` of a convex answer."""
    if x is None:
        forces, torsion, multipliers, acceleration = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)), np.zeros(0)
        wrench = problem.load if proof is None else proof.net_wrench
        impact = None
    else:
        forces, torsion = forces_of(problem, x, program.force_scale)
        half = problem.pyramid * forces[:, 2]
        if half.min() > 0:
            multipliers = forces[:, :2] / half[:, None]
        else:
            multipliers = np.zeros((problem.k, 2))
            multipliers[half > 0] = forces[half > 0, :2] / half[half > 0, None]
        acceleration = problem.acceleration(np.maximum(forces[:, 2], 0.0), impact_time)
        wrench = problem.residual(forces, torsion if problem.friction.d == 4 else None)
        impact = impact_time
    return ForceSolution(
        status=status,
        problem=problem,
        search="convex",
        solver=solver,
        objective=weights,
        impact_time=impact,
        acceleration=frozen(acceleration),
        multipliers=frozen(multipliers),
        forces_c=frozen(forces),
        torsion=frozen(torsion),
        net_wrench=read_only(wrench),
        certificate=certificate,
        infeasibility=proof,
        elapsed=time.perf_counter() - started,
        **details,
    )
