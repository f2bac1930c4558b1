"""Time to optimise contact forces: this package beside CVXPY and SciPy's SLSQP, problem by problem in one process.

    python benchmarks/forces.py [--quick]

Writes forces.csv and forces.png beside this file. Seeded random grasps: contacts uniform on a cylinder's side or a
sphere, mu uniform in 0.4 to 0.8; loads are random mixtures of two that 4-edge pyramids hold, each of random direction
(force and moment) at 20 to 90 % of the way from its least to its largest multiple that they hold. So every friction
model holds every load; grasps that hold no multiple are redrawn.

All methods solve one grasp before the next, in random order, and each first repeats another grasp untimed. No two timed
calls share a load or a ForceProblem. Three times per grasp:

- new: everything is new, and made inside the clock from contact points, frames and load.
- prepared: the grasp has been solved with another load; the problem with the new load is made outside the clock. This
  package keeps the matrices that do not depend on the load with the contacts, the others keep theirs as arrays, and
  CVXPY's parameters other than the load stay set.
- replaced: as prepared, with ``dataclasses.replace(problem, load=...)`` (the load's array, for the others) inside.

What stands for "without this package", all in newtons with moments over the mean arm and objectives of order one:

- cvxpy: parametrised (DPP: grasp map, load, bounds, friction and torque limits are parameters), canonicalised and
  solved before the clock starts. Clarabel at CVXPY's settings; powers as power cones, faster here than CVXPY's default.
- slsqp: SciPy with all gradients at its usual settings, from even normal forces; slsqp_tight: the same with ftol 1e-12.
- plain_qp: for least squares on pyramids, quadprog through qpsolvers on hand-stacked matrices.

"auto" runs after ``pinograsp.warm_up()`` where numba (extra ``fast``) is installed; without it "auto" does what the row
"daqp" says up to 20 contacts and "clarabel" above. "answered_by": which solver gave the answers (this package only).
"success" is the method's own word; an exception is a failure. "correct" is measured: objective within 1e-6 of the
certified optimum, balance, friction, bounds and torque limits met to 1e-6 of the load (of the limit for torques).
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMEXPR"):  # read when the libraries load
    os.environ[f"{_name}_NUM_THREADS"] = "1"

import argparse
import gc
import time
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import cvxpy as cp
import numpy as np
import qpsolvers
from matplotlib.figure import Figure
from results import header, write_rows
from scipy.optimize import Bounds, linprog, minimize
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import ExtraMissing

HERE = Path(__file__).resolve().parent
SEED = 20
IMPACT_TIME = 0.9
TORSION = 4e-3  # of the soft finger [m]
TOLERANCE = 1e-6  # of a correct answer
SOLVERS = ("auto", "daqp", "clarabel", "quadprog", "piqp", "proxqp", "osqp")
OBJECTIVES = ("work", "least_squares")
# Name, friction model, torque limits.
FRICTIONS = (
    ("pyramid", pg.Friction(), False),
    ("cone", pg.Friction(model="cone"), False),
    ("soft", pg.Friction(model="soft", torsion=TORSION), False),
    ("pyramid+torques", pg.Friction(), True),
)
GRASPS = {3: 40, 5: 40, 10: 30, 20: 8, 50: 4}
GRASPS_QUICK = {3: 15, 5: 15, 10: 10, 20: 4, 50: 3}
MOST_FOR_ALL = 10  # contacts up to which every friction model runs; beyond, the first two
WARM_UP = 2  # grasps before the clock starts
LEAST = 2  # grasps that every method gets whatever the budget


# -- problems ----------------------------------------------------------------------------------------------------------


MODES = ("new", "prepared", "replaced")


@dataclass(frozen=True)
class Case:
    """One grasp: ``base`` has geometry and limits, ``loads`` (3, 6) a load for each of MODES; then a user's arrays."""

    base: pg.ForceProblem
    loads: np.ndarray
    points: np.ndarray  # (k, 3), from the centre of mass
    rotations: np.ndarray
    lo: np.ndarray
    hi: np.ndarray


@dataclass(frozen=True)
class Arrays:
    """The problem as matrices: x is (k, d) forces in contact axes (f_x, f_y[, torsion / arm], F_n) [N], flattened."""

    k: int
    d: int
    G: np.ndarray  # (6, k d), moments over the arm
    load: np.ndarray  # (6,)
    lo: np.ndarray
    hi: np.ndarray
    mu: np.ndarray
    spin: np.ndarray  # (k,) largest torsional moment over the arm per newton, [-]
    T: np.ndarray  # (n, k d) joint torques over their limits
    arm: float  # moments are divided by it [m]


def scaled(load: np.ndarray, arm: float) -> np.ndarray:
    return np.concatenate([load[:3], load[3:] / arm])


def arrays_of(case: Case, load: np.ndarray) -> Arrays:
    """What a user would compute from points, frames and load."""
    base, R, arm = case.base, case.rotations, case.base.moment_length
    k, d = len(R), base.friction.d
    G = np.zeros((6, k, d))
    G[:3, :, :2], G[:3, :, -1] = R[:, :, :2].transpose(1, 0, 2), R[:, :, 2].T
    moments = np.cross(case.points[:, None, :], R.transpose(0, 2, 1)) / arm  # (k, column, xyz)
    G[3:, :, :2], G[3:, :, -1] = moments[:, :2].transpose(2, 0, 1), moments[:, 2].T
    if d == 4:
        G[3:, :, 2] = R[:, :, 2].T
    T = np.zeros((0, k * d))
    if base.torques is not None:
        J = base.torques.jacobian
        linear = np.einsum("kxn,kxc->nkc", J[:, :3], R) / base.torques.limit[:, None, None]
        T = linear.reshape(-1, 3 * k)  # torque limits come with d = 3 here
    spin = np.full(k, base.friction.torsion / arm)
    return Arrays(k, d, G.reshape(6, -1), scaled(load, arm), case.lo, case.hi, base.mu, spin, T, arm)


def largest_loads(G, load, lo, hi, mu) -> tuple[float, float] | None:
    """Least and largest multiple of the load that 4-edge pyramids hold, by linear programming; None: no multiple."""
    k = len(mu)
    tangential = np.zeros((4 * k, 3 * k + 1))
    for i in range(k):
        for row, (axis, sign) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1))):
            tangential[4 * i + row, 3 * i + axis], tangential[4 * i + row, 3 * i + 2] = sign, -mu[i] / np.sqrt(2)
    bounds = [b for i in range(k) for b in ((None, None), (None, None), (lo[i], hi[i]))] + [(0, None)]
    ends = []
    for sign in (1.0, -1.0):
        cost = np.zeros(3 * k + 1)
        cost[-1] = sign
        found = linprog(cost, tangential, np.zeros(4 * k), np.column_stack([G, load]), np.zeros(6), bounds)
        if found.status != 0:
            return None
        ends.append(float(found.x[-1]))
    return ends[0], ends[1]


def unit(rng, n: int = 3) -> np.ndarray:
    v = rng.normal(size=n)
    return v / np.linalg.norm(v)


def grasp(rng, k: int) -> Case:
    """A random grasp on a cylinder or a sphere with loads that 4-edge pyramids hold; joint torques limited."""
    while True:
        size = rng.uniform(0.015, 0.04)
        if rng.random() < 0.5:
            body = pg.Cylinder(radius=size, height=0.15, mass=0.3)
            angle = rng.uniform(0, 2 * np.pi, k)
            points = np.column_stack([size * np.cos(angle), size * np.sin(angle), rng.uniform(-2, 2, k) * size])
            points[:, 2] = np.clip(points[:, 2], -0.07, 0.07)
        else:
            body = pg.Sphere(radius=size, mass=0.3)
            points = size * np.array([unit(rng) for _ in range(k)])
        contacts = pg.contacts_at(None, body, points)
        base = pg.ForceProblem.holding(body, contacts, mu=rng.uniform(0.4, 0.8, k))
        lo, hi = base.normal_force_range(IMPACT_TIME)
        case = Case(base, np.zeros((0, 6)), contacts.points_o - contacts.com_o, contacts.rotations_oc, lo, hi)
        ends = [held_load(rng, case, size) for _ in range(2)]
        if any(load is None for load in ends):
            continue
        limits = torque_limits(rng, base, ends)
        if limits is None:
            continue
        share = rng.random((len(MODES), 1))  # what holds two loads holds their mixtures: all limits are convex
        return replace(case, base=replace(base, torques=limits), loads=share * ends[0] + (1 - share) * ends[1])


def held_load(rng, case: Case, size: float) -> np.ndarray | None:
    """A load (6,) of random direction that the grasp holds, or None."""
    direction = np.concatenate([unit(rng), rng.uniform(0, 0.5) * size * unit(rng)])
    a = arrays_of(case, direction)
    ends = largest_loads(a.G, a.load, a.lo, a.hi, a.mu)
    if ends is None or ends[1] < 0.1 or ends[1] - ends[0] < 0.1 * ends[1]:
        return None
    return direction * (ends[0] + rng.uniform(0.2, 0.9) * (ends[1] - ends[0]))


def torque_limits(rng, base: pg.ForceProblem, loads) -> pg.TorqueLimits | None:
    """Fingers of three joints, one per contact; the limits let the forces of least peak pass, not the cheapest ones."""
    k = base.k
    jacobian = np.zeros((k, 6, 3 * k))
    for i in range(k):
        jacobian[i, :3, 3 * i : 3 * i + 3] = rng.uniform(-0.08, 0.08, (3, 3))
        jacobian[i, 3:, 3 * i : 3 * i + 3] = np.array([unit(rng) for _ in range(3)]).T
    torque = np.zeros(3 * k)
    for load in loads:
        even = pg.optimize_forces(replace(base, load=load), IMPACT_TIME, objective="peak", solver="clarabel")
        if not even.found:
            return None
        world = np.einsum("kij,kj->ki", base.contacts.rotations_oc, even.forces_c)
        torque = np.maximum(torque, np.abs(np.einsum("kxn,kx->n", jacobian[:, :3], world)))
    return pg.TorqueLimits(jacobian=jacobian, bias=np.zeros(3 * k), limit=1.05 * torque + 0.05 * torque.max())


# -- methods -----------------------------------------------------------------------------------------------------------


class OnArrays:
    """What the methods on matrices share: their inputs."""

    def fresh(self, case: Case, load: np.ndarray) -> Arrays:
        """Inputs from points, frames and load."""
        return arrays_of(case, load)

    def again(self, known: Arrays, load: np.ndarray) -> Arrays:
        """Inputs of the same grasp under another load."""
        return replace(known, load=scaled(load, known.arm))

    def answer(self, found) -> tuple[bool, np.ndarray | None]:
        """Whether the method calls it solved, and x (k, d)."""
        return found


class Ours:
    """The package's public function."""

    def __init__(self, objective: str, solver: str):
        self.objective, self.solver = objective, solver

    def fresh(self, case: Case, load: np.ndarray) -> pg.ForceProblem:
        # The ContactSet is new as well: it keeps what was computed from it.
        return replace(case.base, load=load, contacts=replace(case.base.contacts))

    def again(self, known: pg.ForceProblem, load: np.ndarray) -> pg.ForceProblem:
        return replace(known, load=load)

    def solve(self, problem):
        return pg.optimize_forces(problem, IMPACT_TIME, objective=self.objective, solver=self.solver)

    def answer(self, found) -> tuple[bool, np.ndarray | None]:
        """Whether the method calls it solved, and x (k, d) in the units of :class:`Arrays`."""
        if not found.found:
            return False, None
        arm, d = found.problem.moment_length, found.problem.friction.d
        x = np.column_stack([found.forces_c[:, :2], found.torsion / arm, found.forces_c[:, 2]])
        return found.status is pg.Status.OK, x if d == 4 else x[:, [0, 1, 3]]


class Parametrised(OnArrays):
    """CVXPY, canonicalised once for all grasps of one size."""

    def __init__(self, arrays: Arrays, model: str, objective: str, powers):
        k, d = arrays.k, arrays.d
        self.x = cp.Variable((k, d))
        self.G, self.load = cp.Parameter(arrays.G.shape), cp.Parameter(6)
        self.lo, self.hi, self.mu = cp.Parameter(k), cp.Parameter(k), cp.Parameter(k, nonneg=True)
        self.spin, self.T = cp.Parameter(k, nonneg=True), None
        F, flat = self.x[:, d - 1], cp.vec(self.x, order="C")
        limit = cp.multiply(self.mu, F)
        rows = [self.G @ flat == -self.load, self.lo <= F, self.hi >= F]
        if model == "pyramid":
            for axis in range(2):
                rows += [self.x[:, axis] <= limit / np.sqrt(2), -self.x[:, axis] <= limit / np.sqrt(2)]
        elif model == "cone":
            rows.append(cp.SOC(limit, self.x[:, :2], axis=1))
        else:  # spin holds mu / (torsion / arm), so that the cone's radius is mu F_n
            spin = cp.multiply(self.spin, self.x[:, 2])
            rows.append(cp.SOC(limit, cp.hstack([self.x[:, :2], spin[:, None]]), axis=1))
        if len(arrays.T):
            self.T = cp.Parameter(arrays.T.shape)
            rows += [self.T @ flat <= 1, -self.T @ flat <= 1]
        if objective == "work":
            cost = sum((c / powers[0][0]) * cp.sum(cp.power(F, p, approx=False)) for c, p in powers)
        else:
            cost = cp.sum_squares(self.x)
        self.problem, self.known = cp.Problem(cp.Minimize(cost), rows), None
        assert self.problem.is_dpp()

    def solve(self, arrays: Arrays):
        self.load.value = arrays.load
        if self.known is not arrays.G:
            self.known = self.G.value = arrays.G
            self.mu.value, self.lo.value, self.hi.value = arrays.mu, arrays.lo, arrays.hi
            if arrays.d == 4:
                self.spin.value = arrays.mu / arrays.spin
            if self.T is not None:
                self.T.value = arrays.T
        self.problem.solve(solver=cp.CLARABEL)
        return self.problem.status == cp.OPTIMAL, self.x.value


class Slsqp(OnArrays):
    """SciPy's SLSQP with gradients; forces of all contacts, normal and tangential, as variables."""

    def __init__(self, model: str, objective: str, powers, ftol: float | None = None):
        self.model, self.objective, self.powers = model, objective, powers
        self.options = {} if ftol is None else {"ftol": ftol, "maxiter": 1000}

    def cost(self, x, d):
        if self.objective == "least_squares":
            return x @ x, 2 * x
        F, gradient = x[d - 1 :: d], np.zeros_like(x)
        value = 0.0
        for c, p in self.powers:
            power = c * F ** (p - 1)
            value += power @ F
            gradient[d - 1 :: d] += p * power
        return value, gradient

    def solve(self, a: Arrays):
        k, d, n = a.k, a.d, a.k * a.d
        start = np.zeros((k, d))
        start[:, -1] = np.clip(np.linalg.norm(a.load) / (k * a.mu), a.lo, a.hi)
        start = start.ravel()
        size = self.cost(start, d)[0]

        def cost(x):
            value, gradient = self.cost(x, d)
            return value / size, gradient / size

        rows = [{"type": "eq", "fun": lambda x: a.G @ x + a.load, "jac": lambda x: a.G}]
        normal = np.arange(d - 1, n, d)
        if self.model == "pyramid":
            C, at = np.zeros((4, k, n)), np.arange(k)
            C[:, at, normal] = a.mu / np.sqrt(2)
            for row, (axis, sign) in enumerate(((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))):
                C[row, at, axis + d * at] = sign
            C = C.reshape(-1, n)
            rows.append({"type": "ineq", "fun": lambda x: C @ x, "jac": lambda x: C})
        else:
            # mu F_n - |u|, not its squares: with those it fails on a third of the grasps with three contacts.
            weight = np.ones((k, d))
            weight[:, -1] = 0.0
            if d == 4:
                weight[:, 2] = (a.mu / a.spin) ** 2
            slopes = np.zeros((k, n))
            where = np.repeat(np.arange(k), d), np.arange(n)

            def room(x):
                z = x.reshape(k, d)
                return a.mu * z[:, -1] - np.sqrt((weight * z * z).sum(axis=1))

            def slope(x):
                z = x.reshape(k, d)
                length = np.sqrt((weight * z * z).sum(axis=1))
                part = -weight * z / np.maximum(length, 1e-15)[:, None]
                part[:, -1] = a.mu
                slopes[where] = part.ravel()
                return slopes

            rows.append({"type": "ineq", "fun": room, "jac": slope})
        if len(a.T):
            both = np.vstack([-a.T, a.T])
            rows.append({"type": "ineq", "fun": lambda x: 1 + both @ x, "jac": lambda x: both})
        low, high = np.full(n, -np.inf), np.full(n, np.inf)
        low[normal], high[normal] = a.lo, a.hi
        found = minimize(
            cost, start, jac=True, method="SLSQP", bounds=Bounds(low, high), constraints=rows, options=self.options
        )
        return found.success, found.x.reshape(k, d)


class PlainQP(OnArrays):
    """Least squares on pyramids, as one dense QP: quadprog through qpsolvers."""

    def fresh(self, case: Case, load: np.ndarray):
        a = arrays_of(case, load)
        k, n = a.k, 3 * a.k
        C, at = np.zeros((4, k, n)), np.arange(k)
        C[:, at, 3 * at + 2] = -a.mu / np.sqrt(2)
        for row, (axis, sign) in enumerate(((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))):
            C[row, at, axis + 3 * at] = sign
        C = np.concatenate([C.reshape(-1, n), a.T, -a.T])
        h = np.concatenate([np.zeros(4 * k), np.ones(2 * len(a.T))])
        low, high = np.full(n, -1e3), np.full(n, 1e3)  # quadprog takes no infinity
        low[2::3], high[2::3] = a.lo, a.hi
        return a, (2 * np.eye(n), np.zeros(n), C, h), (low, high)

    def again(self, known, load):
        return super().again(known[0], load), *known[1:]

    def solve(self, inputs):
        a, rows, bounds = inputs
        x = qpsolvers.solve_qp(*rows, a.G, -a.load, *bounds, solver="quadprog")
        return x is not None, None if x is None else x.reshape(-1, 3)


# -- measuring ---------------------------------------------------------------------------------------------------------


def value_of(objective: str, powers, x: np.ndarray) -> float:
    """The objective at x (k, d) in the package's units."""
    if objective == "least_squares":
        return float((x**2).sum())
    return float(sum(c * (np.maximum(x[:, -1], 0) ** p).sum() for c, p in powers))


def errors(a: Arrays, model: str, objective: str, powers, optimum: float, x: np.ndarray) -> tuple[float, float, float]:
    """Of an answer: objective beyond or below the optimum (relative), balance (of the load), limits (of the load)."""
    size = np.linalg.norm(a.load)
    F, tangential = x[:, -1], x[:, :2]
    if model == "pyramid":
        slip = np.abs(tangential).max(axis=1) - a.mu * F / np.sqrt(2)
    elif model == "cone":
        slip = np.hypot(*tangential.T) - a.mu * F
    else:
        slip = np.sqrt((tangential**2).sum(axis=1) + (a.mu * x[:, 2] / a.spin) ** 2) - a.mu * F
    torque = np.abs(a.T @ x.ravel()).max() - 1 if len(a.T) else 0.0
    limits = max(0.0, float(max(slip.max(), (a.lo - F).max(), (F - a.hi).max())) / size, float(torque))
    balance = float(np.linalg.norm(a.G @ x.ravel() + a.load) / size)
    return abs(value_of(objective, powers, x) - optimum) / optimum, balance, limits


def certified(case: Case, load: np.ndarray, objective: str) -> float | None:
    """The optimum, between a proven bound and admissible forces that differ by less than a tenth of the tolerance."""
    proofs = []
    for solver in ("clarabel", "auto"):
        ours = Ours(objective, solver)
        found = ours.solve(ours.fresh(case, load))
        if found.status is pg.Status.OK:
            proofs.append(found.certificate)
    if not proofs:
        return None
    primal, dual = min(p.primal for p in proofs), max(p.dual for p in proofs)
    return (primal + dual) / 2 if primal - dual <= 0.1 * TOLERANCE * primal else None


def methods_of(case: Case, friction: pg.Friction, objective: str) -> dict:
    """Every method, ready for problems of the case's size."""
    powers = case.base.energy_terms(IMPACT_TIME, "work")
    methods = {solver: Ours(objective, solver) for solver in SOLVERS}
    methods["cvxpy"] = Parametrised(arrays_of(case, case.loads[0]), friction.model, objective, powers)
    methods["slsqp"] = Slsqp(friction.model, objective, powers)
    methods["slsqp_tight"] = Slsqp(friction.model, objective, powers, ftol=1e-12)
    if friction.model == "pyramid" and objective == "least_squares":
        methods["plain_qp"] = PlainQP()
    return methods


def attempted(method, inputs):
    """The method's answer; None where it raises: then it has failed on this problem, and the others go on."""
    try:
        return method.solve(inputs)
    except Exception:
        return None


def clocked(method, before: Case, case: Case, turn: bool) -> tuple[list[float], list]:
    """Seconds in each of MODES, and the answers.

    A call on the grasp before comes first, untimed: it brings the method back into the processor's caches.
    """
    attempted(method, method.fresh(before, before.loads[0]))
    clock = time.perf_counter
    seconds, answers = [0.0] * 3, [None] * 3
    started = clock()
    known = method.fresh(case, case.loads[0])
    answers[0] = attempted(method, known)
    seconds[0] = clock() - started
    for mode in (1, 2) if turn else (2, 1):
        inputs = method.again(known, case.loads[mode]) if mode == 1 else None
        started = clock()
        answers[mode] = attempted(method, inputs if mode == 1 else method.again(known, case.loads[mode]))
        seconds[mode] = clock() - started
    return seconds, answers


@dataclass(frozen=True)
class Record:
    """What a method did on one grasp, by MODES: seconds, its own word, solvers that answered, errors (3, 3)."""

    grasp: int
    seconds: list[float]
    told: list[bool]
    answered: list[str]
    errors: np.ndarray


def measure(cases: list[Case], friction: pg.Friction, objective: str, budget: float, bar) -> tuple[dict, int]:
    """Per method its records, and the number of grasps whose optima are certified."""
    powers = cases[0].base.energy_terms(IMPACT_TIME, "work")
    methods = methods_of(cases[0], friction, objective)
    order = np.random.default_rng(SEED)
    for method in methods.values():
        for case in cases[:WARM_UP]:
            attempted(method, method.fresh(case, case.loads[0]))
    records, spent = {name: [] for name in methods}, dict.fromkeys(methods, 0.0)
    certain = 0
    for i, case in enumerate(cases[WARM_UP:], WARM_UP):
        optima = [certified(case, load, objective) for load in case.loads]
        bar.update()
        if None in optima:
            continue
        arrays = [arrays_of(case, load) for load in case.loads]
        certain += 1
        gc.collect()
        for name in order.permutation(list(methods)):
            if spent[name] > budget and len(records[name]) >= LEAST:
                continue
            seconds, answers = clocked(methods[name], cases[i - 1], case, bool(i % 2))
            spent[name] += sum(seconds) * 4 / 3
            told, wrong = [], np.full((3, 3), np.inf)
            for mode, found in enumerate(answers):
                ok, x = (False, None) if found is None else methods[name].answer(found)
                told.append(bool(ok))
                if x is not None and np.isfinite(x).all():
                    wrong[mode] = errors(arrays[mode], friction.model, objective, powers, optima[mode], x)
            answered = []
            if isinstance(methods[name], Ours):
                answered = ["raised" if found is None else found.solver for found in answers]
            records[name].append(Record(i, seconds, told, answered, wrong))
    return records, certain


def rows_of(k: int, friction: str, objective: str, records: dict, certain: int) -> list[dict]:
    """Table rows of one group of grasps."""
    rows = []
    seconds = {name: {r.grasp: r.seconds for r in own} for name, own in records.items()}
    for name, own in records.items():
        if not own:
            continue
        row = {"contacts": k, "friction": friction, "objective": objective, "method": name}
        row |= {"grasps": len(own), "of": certain}
        times = 1e6 * np.array([r.seconds for r in own])
        for mode, column in zip(MODES, times.T):
            row[f"{mode}_median_us"] = f"{np.median(column):.0f}"
            row[f"{mode}_p99_us"] = f"{np.percentile(column, 99):.0f}"
        told = np.array([r.told for r in own])
        wrong = np.array([r.errors for r in own])
        answered = Counter(solver for r in own for solver in r.answered)
        row["success"] = f"{told.mean():.3f}"
        row["correct"] = f"{(told & np.all(wrong <= TOLERANCE, axis=2)).mean():.3f}"
        row["answered_by"] = " ".join(f"{solver}:{n / told.size:.3f}" for solver, n in answered.most_common())
        row["median_objective_error"] = f"{np.median(wrong[:, :, 0]):.1e}"
        for j, what in enumerate(("objective", "balance", "limit")):
            row[f"worst_{what}_error"] = f"{wrong[:, :, j].max():.1e}"
        for other in ("cvxpy", "slsqp", "slsqp_tight"):
            both = sorted(set(seconds[other]) & set(seconds[name]))
            theirs, mine = (np.median([seconds[m][i] for i in both], axis=0) for m in (other, name))
            for mode, ratio in zip(MODES, theirs / mine):
                row[f"{other}_over_this_{mode}"] = f"{ratio:.2f}"
        rows.append(row)
    return rows


# -- output ------------------------------------------------------------------------------------------------------------

# Okabe and Ito's colours, told apart in every kind of colour vision; the package's named solvers stay in grey.
COLOURS = {
    "auto": "#0072B2",
    "cvxpy": "#D55E00",
    "slsqp": "#009E73",
    "slsqp_tight": "#009E73",
    "plain_qp": "#000000",
}
LABELS = {
    "auto": "pinograsp (auto)",
    "cvxpy": "CVXPY",
    "slsqp": "SLSQP",
    "slsqp_tight": "SLSQP, tight",
    "plain_qp": "plain QP",
}


def draw(rows: list[dict], path: Path) -> None:
    """One panel per objective and friction model: median time against contacts, labels at the ends of the lines."""
    names = [name for name, *_ in FRICTIONS]
    figure = Figure(figsize=(20, 11), layout="constrained")
    panels = figure.subplots(len(OBJECTIVES), len(names), sharey=True)
    for objective, line in zip(OBJECTIVES, panels):
        for friction, axes in zip(names, line):
            own = [r for r in rows if r["friction"] == friction and r["objective"] == objective]
            ends = []
            for method in dict.fromkeys(r["method"] for r in own):
                curve = [r for r in own if r["method"] == method]
                x = [r["contacts"] for r in curve]
                y = [float(r["prepared_median_us"]) for r in curve]
                front = method in COLOURS
                colour = COLOURS.get(method, "#8A8A8A")
                style = {"slsqp_tight": "--", "cvxpy": "-.", "slsqp": "-", "plain_qp": ":"}.get(method, "-")
                width = 3.0 if method == "auto" else 1.8 if front else 0.9
                axes.loglog(x, y, style, color=colour, linewidth=width, zorder=3 if front else 2)
                for a, b, r in zip(x, y, curve):
                    good = float(r["correct"]) >= 0.99
                    axes.plot(a, b, "o", color=colour, markersize=7 if front else 4, zorder=4 if front else 2,
                              markerfacecolor=colour if good else "white")  # fmt: skip
                if method == "auto":
                    new = [float(r["new_median_us"]) for r in curve]
                    axes.loglog(x, new, "--", color=colour, linewidth=1.5, zorder=3)
                ends.append((y[-1], x[-1], LABELS.get(method, method), colour, front))
            axes.set_title(f"{objective.replace('_', ' ')}, {friction.replace('+', ' + ')}")
            ticks = sorted({r["contacts"] for r in own})
            axes.set_xticks(ticks, [str(t) for t in ticks])
            axes.set_xticks([], minor=True)
            axes.grid(alpha=0.3, which="major")
            axes.set_xlim(min(ticks) * 0.9, max(ticks) * (max(ticks) / min(ticks)) ** 0.6)  # room for the labels
            _label(axes, ends)
            if objective == OBJECTIVES[-1]:
                axes.set_xlabel("contacts")
        line[0].set_ylabel("median time per new load, problem prepared [us]")
    figure.suptitle(
        "Contact forces of least cost: time per new load. Blue, dashed: pinograsp with everything new. "
        "Hollow: under 99 % of the answers correct to 1e-6. Grey: pinograsp with a named solver."
    )
    figure.savefig(path, dpi=90)


def _label(axes, ends) -> None:
    """Names at the ends of the lines, moved apart where they would touch."""
    gap = 0.14  # decades between two labels
    ends = sorted(ends)
    at = [float(np.log10(y)) for y, *_ in ends]
    for _ in range(200):
        for i in range(len(at) - 1):
            lack = gap - (at[i + 1] - at[i])
            if lack > 0:
                at[i], at[i + 1] = at[i] - lack / 2, at[i + 1] + lack / 2
    for (y, x, text, colour, front), height in zip(ends, at):
        axes.annotate(
            text,
            (x, y),
            (x * (1 + 0.05 * np.log(axes.get_xlim()[1] / axes.get_xlim()[0])), 10**height),
            textcoords="data",
            color=colour,
            fontsize=10 if front else 8,
            fontweight="bold" if text.startswith("pinograsp") else "normal",
            verticalalignment="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "alpha": 0.5},
            annotation_clip=False,
        )


def table(rows: list[dict]) -> str:
    """The short table: medians in us; "auto" and "plain" are this package with and without the extra ``fast``."""
    head = f"{'contacts':>8} {'friction':<16} {'objective':<14}"
    for name in ("auto", "plain", "cvxpy", "slsqp"):
        head += f" |{name:>7} {'new':>6} {'ok':>5}"
        head += f" {'/auto':>6} {'new':>6}" if name in ("cvxpy", "slsqp") else ""
    lines = [head + f" |{'tight':>7} {'ok':>5} |{'plain_qp':>8}"]
    for group in dict.fromkeys((r["contacts"], r["friction"], r["objective"]) for r in rows):
        of = {r["method"]: r for r in rows if (r["contacts"], r["friction"], r["objective"]) == group}
        of["plain"] = of["daqp" if group[0] <= 20 else "clarabel"]
        line = f"{group[0]:>8} {group[1]:<16} {group[2]:<14}"
        for name in ("auto", "plain", "cvxpy", "slsqp"):
            row = of[name]
            line += f" |{row['prepared_median_us']:>7} {row['new_median_us']:>6} {row['correct']:>5}"
            if name in ("cvxpy", "slsqp"):
                line += "".join(f" {of['auto'][f'{name}_over_this_{mode}']:>6}" for mode in ("prepared", "new"))
        line += f" |{of['slsqp_tight']['prepared_median_us']:>7} {of['slsqp_tight']['correct']:>5} |"
        lines.append(line + f"{of['plain_qp']['prepared_median_us'] if 'plain_qp' in of else '':>8}")
    return "\n".join(lines)


LIMITATIONS = """Known limitations:
- One machine, one process, one thread; random grasps on cylinders and spheres at one impact time.
- Every load can be held: proofs of infeasibility, which this package also gives, are not timed.
- Times are those of a loop that does nothing else; after other work (cold caches) a call can take half as long again.
- The p99 of so few grasps is next to their slowest.
- A method that exceeds its budget in a group gets no more grasps of it (columns grasps, of); ratios use the medians
  over the grasps that both got.
- The optimum that decides "correct" comes from this package: forces and a lower bound, which agree to 1e-7.
- CVXPY compiled to C (cvxpygen), or another modelling language, may be faster than CVXPY itself."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the grasps or less")
    parser.add_argument("--contacts", type=int, nargs="+", help="only these numbers of contacts")
    parser.add_argument("--out", type=Path, default=HERE / "forces.csv", help="table; the figure lies beside it")
    options = parser.parse_args()
    grasps = GRASPS_QUICK if options.quick else GRASPS
    grasps = {k: count for k, count in grasps.items() if not options.contacts or k in options.contacts}
    budget = 1.0 if options.quick else 10.0  # seconds per method and group
    groups = [
        (k, name, friction, torques, objective)
        for k in grasps
        for name, friction, torques in (FRICTIONS if k <= MOST_FOR_ALL else FRICTIONS[:2])
        for objective in OBJECTIVES
    ]
    warnings.simplefilter("ignore")  # CVXPY and qpsolvers remark on accuracy and conversions; errors are measured here
    try:
        pg.warm_up()
    except ExtraMissing as missing:
        print(missing)
    gc.disable()
    rows, cases = [], {}
    with tqdm(total=sum(grasps[k] for k, *_ in groups), unit="grasp", mininterval=1.0) as bar:
        for k, name, friction, torques, objective in groups:
            bar.set_description(f"{k} contacts, {name}, {objective}")
            if k not in cases:
                rng = np.random.default_rng([SEED, k])
                cases[k] = [grasp(rng, k) for _ in range(WARM_UP + grasps[k])]
            own = [
                replace(c, base=replace(c.base, friction=friction, torques=c.base.torques if torques else None))
                for c in cases[k]
            ]
            records, certain = measure(own, friction, objective, budget, bar)
            rows += rows_of(k, name, objective, records, certain)
    packages = ("numpy", "scipy", "daqp", "clarabel", "qpsolvers", "quadprog", "piqp", "proxsuite", "osqp", "cvxpy")
    first_line = header(
        (*packages, "numba"),
        f"one thread used, load average {os.getloadavg()[1]:.1f}",
        "quick run" if options.quick else "full run",
    )
    write_rows(options.out, first_line, rows)
    draw(rows, options.out.with_suffix(".png"))
    print(first_line)
    print(table(rows))
    print(LIMITATIONS)


if __name__ == "__main__":
    main()
