"""Time to optimise contact forces: this package beside CVXPY and SciPy's SLSQP, on the same problems in one process.

    python benchmarks/forces.py [--quick]

Writes forces.csv and forces.png beside this file, after each number of contacts. Seeded random grasps: contacts uniform
on a cylinder's side or a sphere, mu uniform in 0.4 to 0.8; loads are random mixtures of two that 4-edge pyramids hold,
each of random direction (force and moment) at 20 to 90 % of the way from its least to its largest multiple that they
hold. So every friction model holds every load; grasps that hold no multiple are redrawn.

Every call is timed by itself, in three modes:

- prepared, the main figure: a known grasp under a new load, as in a loop that holds an object. The grasp was solved
  before under another load, here by the same ``ForceSolver``; for the others scaling the load's array is inside the
  clock. In each of several rounds every method, in random order, solves problems of all grasps of the group in one
  block, the loads of a grasp in a row; no problem comes twice.
- interleaved: some of these calls again, but all methods in random order on one problem before the next. Each call
  finds the processor's caches full of other methods' data, as in a program that mostly does other things.
- new: everything is new, and made inside the clock from contact points, frames and load. In blocks, a call per grasp.

A few untimed calls precede each block.

What stands for "without this package", all in newtons with moments over the mean arm and objectives of order one:

- cvxpy: parametrised (DPP: grasp map, load, bounds, friction and torque limits are parameters), canonicalised and
  solved before the clock starts. The load is set inside the clock, in "new" all parameters. Clarabel at CVXPY's
  settings; powers as power cones, faster here than CVXPY's default.
- slsqp: SciPy's SLSQP at its usual settings from even normal forces, given functions only: it takes finite differences.
  This is what one gets without writing gradients.
- slsqp_gradients: the same with all gradients by hand; slsqp_tight: with gradients and ftol 1e-12.
- clarabel_native, daqp_native: for least squares on cones and pyramids, the solvers' own interfaces on hand-stacked
  matrices that are ready before the clock starts; the load alone is set inside it. Clarabel's solver is made anew for
  each load, with its default settings; DAQP is called as ``daqp.solve``.
- plain_qp: for least squares on pyramids, quadprog through qpsolvers on hand-stacked matrices.

"online" is ``OnlineForces.step`` from scratch, where its objective is the same (least squares, no torsion, no torque
limits). Without the compiled core "auto" does what the row "daqp" says up to 20 contacts and "clarabel" above. The
other solvers of this package are asked for by name; "answered_by" says which one gave the answers. "interior" and
"newton" have rows only where they give most of them. "success" is the method's own word; an exception is a failure.
"correct" is measured: objective within 1e-6 of the certified optimum, balance, friction, bounds and torque limits met
to 1e-6 of the load (of the limit for torques)."""

from __future__ import annotations

import os

# Read when the libraries load.
os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMEXPR")})

import argparse
import gc
import time
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import clarabel
import cvxpy as cp
import daqp
import numpy as np
import qpsolvers
from matplotlib.figure import Figure
from results import header, table, write_rows
from scipy.optimize import Bounds, linprog, minimize
from scipy.sparse import csc_matrix, eye as identity
from tqdm import tqdm

import pinograsp as pg

HERE = Path(__file__).resolve().parent
SEED = 20
IMPACT_TIME = 0.9
TORSION = 4e-3  # of the soft finger [m]
TOLERANCE = 1e-6  # of a correct answer
COMPILED = ("interior", "newton")
PACKAGES = ("numpy", "scipy", "daqp", "clarabel", "qpsolvers", "quadprog", "piqp", "proxsuite", "osqp", "cvxpy")
QP_SOLVERS = ("auto", *COMPILED, "daqp", "clarabel", "quadprog", "piqp", "proxqp", "osqp")
OTHERS = ("cvxpy", "slsqp", "slsqp_gradients", "slsqp_tight", "clarabel_native", "daqp_native")
OBJECTIVES = ("work", "least_squares")
# Name, friction model, torque limits.
FRICTIONS = (
    ("pyramid", pg.Friction(), False),
    ("cone", pg.Friction(model="cone"), False),
    ("soft", pg.Friction(model="soft", torsion=TORSION), False),
    ("pyramid+torques", pg.Friction(), True),
)
GRASPS = {3: 40, 5: 40, 10: 40, 15: 40, 20: 40, 50: 40}  # 200 solves of a method in a block
GRASPS_QUICK = {3: 8, 5: 8, 10: 6, 15: 6, 20: 3, 50: 2}
MODES = ("prepared", "interleaved", "new")
ROUNDS, LOADS = 4, 5  # loads per grasp and round
INTERLEAVED = 40  # problems
BUDGET, BUDGET_QUICK = 4.0, 0.05  # seconds per method, mode and group
LEAST = 3  # calls that every method gets whatever the budget
MOST_QUICK = 20  # contacts of a quick run, unless more are asked for
MOST_FOR_ALL = 10  # contacts up to which every friction model runs; beyond, the first two
WARM_UP = 5  # untimed calls before a block


# -- problems ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """One grasp: geometry and limits, loads (the first for the solution before, and for "new"), and a user's arrays."""

    base: pg.ForceProblem
    loads: np.ndarray  # (1 + ROUNDS * LOADS, 6)
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
    lo: np.ndarray
    hi: np.ndarray
    mu: np.ndarray
    spin: np.ndarray  # (k,) largest torsional moment over the arm per newton, [-]
    T: np.ndarray  # (n, k d) joint torques over their limits
    arm: float  # moments are divided by it [m]


def scaled(load: np.ndarray, arm: float) -> np.ndarray:
    """The load (6,) with moments over the arm [N]."""
    return np.concatenate([load[:3], load[3:] / arm])


def arrays_of(case: Case) -> Arrays:
    """What a user would compute from points and frames."""
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
    return Arrays(k, d, G.reshape(6, -1), case.lo, case.hi, base.mu, spin, T, arm)


def pyramid_rows(mu: np.ndarray, d: int = 3) -> np.ndarray:
    """The pyramids as rows C x <= 0 (4 k, k d)."""
    k = len(mu)
    rows = np.zeros((k, 4, k, d))
    for i in range(k):
        rows[i, :, i, -1] = -mu[i] / np.sqrt(2)
        rows[i, [0, 1], i, 0] = rows[i, [2, 3], i, 1] = 1.0, -1.0
    return rows.reshape(4 * k, k * d)


def largest_loads(G, load, lo, hi, mu) -> tuple[float, float] | None:
    """Least and largest multiple of the load that 4-edge pyramids hold, by linear programming; None: no multiple."""
    k = len(mu)
    tangential = np.column_stack([pyramid_rows(mu), np.zeros(4 * k)])
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
        base = pg.ForceProblem.holding(
            body, contacts, mu=rng.uniform(0.4, 0.8, k), friction=pg.Friction(), max_depth=5e-3
        )
        lo, hi = base.normal_force_range(IMPACT_TIME)
        case = Case(base, np.zeros((0, 6)), contacts.points_o - contacts.com_o, contacts.rotations_oc, lo, hi)
        ends = [held_load(rng, case, size) for _ in range(2)]
        if any(load is None for load in ends):
            continue
        limits = torque_limits(rng, base, ends)
        if limits is None:
            continue
        share = rng.random((1 + ROUNDS * LOADS, 1))  # what holds two loads holds their mixtures: all limits are convex
        return replace(case, base=replace(base, torques=limits), loads=share * ends[0] + (1 - share) * ends[1])


def held_load(rng, case: Case, size: float) -> np.ndarray | None:
    """A load (6,) of random direction that the grasp holds, or None."""
    direction = np.concatenate([unit(rng), rng.uniform(0, 0.5) * size * unit(rng)])
    a = arrays_of(case)
    ends = largest_loads(a.G, scaled(direction, a.arm), a.lo, a.hi, a.mu)
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
    """What the methods on matrices share: their inputs are the arrays and the scaled load."""

    def fresh(self, case: Case, load: np.ndarray) -> tuple[Arrays, np.ndarray]:
        """Inputs from points, frames and load."""
        arrays = arrays_of(case)
        return arrays, scaled(load, arrays.arm)

    def again(self, known: tuple, load: np.ndarray) -> tuple:
        """Inputs of the same grasp under another load."""
        return known[0], scaled(load, known[0].arm)

    def answer(self, found) -> tuple[bool, np.ndarray | None]:
        """Whether the method calls it solved, and x (k, d)."""
        return found


class Ours:
    """The package's public solver."""

    def __init__(self, objective: str, solver: str):
        self.objective, self.solver = objective, solver

    def fresh(self, case: Case, load: np.ndarray) -> tuple[pg.ForceSolver, np.ndarray]:
        # The ContactSet is new as well: its grasp map is computed with it.
        problem = replace(case.base, load=load, contacts=replace(case.base.contacts), moment_length=None)
        return pg.ForceSolver(problem, IMPACT_TIME, objective=self.objective, solver=self.solver), load

    def again(self, known: tuple[pg.ForceSolver, np.ndarray], load: np.ndarray) -> tuple[pg.ForceSolver, np.ndarray]:
        return known[0], load

    def solve(self, inputs: tuple[pg.ForceSolver, np.ndarray]) -> pg.forces.ForceSolution:
        solver, load = inputs
        return solver.solve(load)

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

    def ready(self, arrays: Arrays) -> None:
        """Sets all parameters but the load, where they are not those of the arrays."""
        if self.known is arrays:
            return
        self.known, self.G.value = arrays, arrays.G
        self.mu.value, self.lo.value, self.hi.value = arrays.mu, arrays.lo, arrays.hi
        if arrays.d == 4:
            self.spin.value = arrays.mu / arrays.spin
        if self.T is not None:
            self.T.value = arrays.T

    def solve(self, inputs):
        arrays, self.load.value = inputs
        self.ready(arrays)
        self.problem.solve(solver=cp.CLARABEL)
        return self.problem.status == cp.OPTIMAL, self.x.value


class Slsqp(OnArrays):
    """SciPy's SLSQP with or without gradients; forces of all contacts, normal and tangential, as variables."""

    def __init__(self, model: str, objective: str, powers, gradients: bool = True, ftol: float | None = None):
        self.model, self.objective, self.powers, self.jac = model, objective, powers, gradients or None
        self.options = {} if ftol is None else {"ftol": ftol, "maxiter": 1000}

    def cost(self, x, d):
        if self.objective == "least_squares":
            return x @ x
        F = x[d - 1 :: d]
        return sum(c * (F**p).sum() for c, p in self.powers)

    def cost_and_gradient(self, x, d):
        if self.objective == "least_squares":
            return x @ x, 2 * x
        F, gradient = x[d - 1 :: d], np.zeros_like(x)
        value = 0.0
        for c, p in self.powers:
            power = c * F ** (p - 1)
            value += power @ F
            gradient[d - 1 :: d] += p * power
        return value, gradient

    def solve(self, inputs):
        a, load = inputs
        k, d, n = a.k, a.d, a.k * a.d
        start = np.zeros((k, d))
        start[:, -1] = np.clip(np.linalg.norm(load) / (k * a.mu), a.lo, a.hi)
        start = start.ravel()
        size = self.cost(start, d)

        def cost(x):
            if not self.jac:
                return self.cost(x, d) / size
            value, gradient = self.cost_and_gradient(x, d)
            return value / size, gradient / size

        rows = [{"type": "eq", "fun": lambda x: a.G @ x + load, "jac": lambda x: a.G}]
        normal = np.arange(d - 1, n, d)
        if self.model == "pyramid":
            C = -pyramid_rows(a.mu, d)
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
        if not self.jac:
            rows = [{"type": row["type"], "fun": row["fun"]} for row in rows]
        bounds = Bounds(low, high)
        found = minimize(
            cost, start, jac=self.jac, method="SLSQP", bounds=bounds, constraints=rows, options=self.options
        )
        return found.success, found.x.reshape(k, d)


class PlainQP(OnArrays):
    """Least squares on pyramids, as one dense QP: quadprog through qpsolvers."""

    def fresh(self, case: Case, load: np.ndarray):
        a, load = super().fresh(case, load)
        k, n = a.k, 3 * a.k
        C = np.concatenate([pyramid_rows(a.mu), a.T, -a.T])
        h = np.concatenate([np.zeros(4 * k), np.ones(2 * len(a.T))])
        low, high = np.full(n, -1e3), np.full(n, 1e3)  # quadprog takes no infinity
        low[2::3], high[2::3] = a.lo, a.hi
        return a, load, (2 * np.eye(n), np.zeros(n), C, h), (low, high)

    def again(self, known, load):
        return *super().again(known, load), *known[2:]

    def solve(self, inputs):
        a, load, rows, bounds = inputs
        x = qpsolvers.solve_qp(*rows, a.G, -load, *bounds, solver="quadprog")
        return x is not None, None if x is None else x.reshape(-1, 3)


class Online:
    """The loop's class, from scratch at every load."""

    def fresh(self, case: Case, load: np.ndarray):
        problem = replace(case.base, contacts=replace(case.base.contacts), moment_length=None)
        return pg.OnlineForces(problem, normal_forces=(case.lo, case.hi)), load

    def again(self, known, load):
        return known[0], load

    def solve(self, inputs):
        online, load = inputs
        online.reset()
        forces, _, status = online.step(load)
        return status is pg.Status.OK, forces.copy()

    def answer(self, found):
        return found


class ClarabelNative(OnArrays):
    """Least squares by Clarabel's own interface."""

    def __init__(self, model: str):
        self.model, self.settings = model, clarabel.DefaultSettings()
        self.settings.verbose = False

    def fresh(self, case: Case, load: np.ndarray):
        a, load = super().fresh(case, load)
        k, n = a.k, 3 * a.k
        at = np.arange(k)
        bounds = np.zeros((2, k, n))
        bounds[0, at, 3 * at + 2], bounds[1, at, 3 * at + 2] = -1.0, 1.0
        h = [np.zeros(6), -a.lo, a.hi]
        if self.model == "cone":
            limits = np.zeros((k, 3, n))
            limits[at, 0, 3 * at + 2] = -a.mu
            limits[at, 1, 3 * at] = limits[at, 2, 3 * at + 1] = -1.0
            cones = [clarabel.SecondOrderConeT(3)] * k
        else:
            limits = pyramid_rows(a.mu)
            cones = [clarabel.NonnegativeConeT(4 * k)]
        limits = limits.reshape(-1, n)
        rows = csc_matrix(np.concatenate([a.G, bounds.reshape(-1, n), limits]))
        cones = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(2 * k), *cones]
        return (
            a,
            load,
            (2.0 * identity(n, format="csc"), np.zeros(n), rows, np.concatenate([*h, np.zeros(len(limits))]), cones),
        )

    def again(self, known, load):
        return *super().again(known, load), known[2]

    def solve(self, inputs):
        _a, load, (P, q, rows, h, cones) = inputs
        h[:6] = -load
        found = clarabel.DefaultSolver(P, q, rows, h, cones, self.settings).solve()
        return str(found.status) == "Solved", np.array(found.x).reshape(-1, 3)


class DaqpNative(OnArrays):
    """Least squares on pyramids by DAQP's own interface."""

    def fresh(self, case: Case, load: np.ndarray):
        a, load = super().fresh(case, load)
        k, n = a.k, 3 * a.k
        free = np.full(n, 1e30)
        free[2::3] = a.hi
        least = np.full(n, -1e30)
        least[2::3] = a.lo
        rows = np.ascontiguousarray(np.concatenate([a.G, pyramid_rows(a.mu)]))
        upper = np.concatenate([free, np.zeros(6 + 4 * k)])
        lower = np.concatenate([least, np.zeros(6), np.full(4 * k, -1e30)])
        sense = np.zeros(len(upper), dtype=np.intc)
        sense[n : n + 6] = 5  # equalities
        return a, load, (2.0 * np.eye(n), np.zeros(n), rows, upper, lower, sense)

    def again(self, known, load):
        return *super().again(known, load), known[2]

    def solve(self, inputs):
        _a, load, (H, f, rows, upper, lower, sense) = inputs
        n = len(f)
        upper[n : n + 6] = lower[n : n + 6] = -load
        x, _, code, _ = daqp.solve(H, f, rows, upper, lower, sense)
        return code == 1, np.array(x).reshape(-1, 3)


# -- measuring ---------------------------------------------------------------------------------------------------------


def value_of(objective: str, powers, x: np.ndarray) -> float:
    """The objective at x (k, d) in the package's units."""
    if objective == "least_squares":
        return float((x**2).sum())
    return float(sum(c * (np.maximum(x[:, -1], 0) ** p).sum() for c, p in powers))


def errors(a: Arrays, load, model: str, objective: str, powers, optimum: float, x) -> tuple[float, float, float]:
    """Of an answer: objective beyond or below the optimum (relative), balance (of the load), limits (of the load)."""
    size = np.linalg.norm(load)
    F, tangential = x[:, -1], x[:, :2]
    if model == "pyramid":
        slip = np.abs(tangential).max(axis=1) - a.mu * F / np.sqrt(2)
    elif model == "cone":
        slip = np.hypot(*tangential.T) - a.mu * F
    else:
        slip = np.sqrt((tangential**2).sum(axis=1) + (a.mu * x[:, 2] / a.spin) ** 2) - a.mu * F
    torque = np.abs(a.T @ x.ravel()).max() - 1 if len(a.T) else 0.0
    limits = max(0.0, float(max(slip.max(), (a.lo - F).max(), (F - a.hi).max())) / size, float(torque))
    balance = float(np.linalg.norm(a.G @ x.ravel() + load) / size)
    return abs(value_of(objective, powers, x) - optimum) / optimum, balance, limits


def certified(case: Case, load: np.ndarray, objective: str) -> float | None:
    """The optimum, between a proven bound and admissible forces that differ by less than a tenth of the tolerance."""
    proofs = []
    for solver in ("clarabel", "auto"):
        found = pg.optimize_forces(case.base.with_load(load), IMPACT_TIME, objective=objective, solver=solver)
        if found.status is pg.Status.OK:
            proofs.append(found.certificate)
    if not proofs:
        return None
    primal, dual = min(p.objective for p in proofs), max(p.lower_bound for p in proofs)
    return (primal + dual) / 2 if primal - dual <= 0.1 * TOLERANCE * primal else None


def methods_of(case: Case, friction: pg.Friction, objective: str) -> dict:
    """Every method, ready for problems of the case's size."""
    powers = case.base.energy_terms(IMPACT_TIME, "work")
    methods = {solver: Ours(objective, solver) for solver in QP_SOLVERS}
    methods["cvxpy"] = Parametrised(arrays_of(case), friction.model, objective, powers)
    methods["slsqp"] = Slsqp(friction.model, objective, powers, gradients=False)
    methods["slsqp_gradients"] = Slsqp(friction.model, objective, powers)
    methods["slsqp_tight"] = Slsqp(friction.model, objective, powers, ftol=1e-12)
    if friction.model == "pyramid" and objective == "least_squares":
        methods["plain_qp"] = PlainQP()
        methods["daqp_native"] = DaqpNative()
    if friction.model in ("pyramid", "cone") and objective == "least_squares":
        methods["clarabel_native"] = ClarabelNative(friction.model)
        if case.base.torques is None:
            methods["online"] = Online()
        else:  # these know no torque limits
            del methods["clarabel_native"]
            methods.pop("daqp_native", None)
    return methods


def timed(method, make, source, load: np.ndarray) -> tuple[float, object]:
    """Seconds to make the inputs and solve, and the answer: None where it raises, which is a failure of this call."""
    clock = time.perf_counter
    started = clock()
    try:
        found = method.solve(make(source, load))
    except Exception:
        found = None
    return clock() - started, found


class Group:
    """The grasps of one size, friction model and objective, and what every method did on them.

    ``calls`` by method and mode: {(grasp, load): (seconds, answer)}. ``optima`` by problem, None where not certified.
    """

    def __init__(self, cases: list[Case], friction: pg.Friction, objective: str, budget: float):
        self.cases, self.friction, self.objective, self.budget = cases, friction, objective, budget
        self.rng = np.random.default_rng(SEED)
        self.methods = methods_of(cases[0], friction, objective)
        self.known = {name: [m.fresh(c, c.loads[0]) for c in cases] for name, m in self.methods.items()}
        for name in QP_SOLVERS:
            method = self.methods[name]
            first = [timed(method, method.again, known, known[1])[1] for known in self.known[name]]
            own = sum(isinstance(found, pg.forces.ForceSolution) and found.solver == name for found in first)
            if name in COMPILED and own <= len(cases) / 2:
                del self.methods[name]
        self.calls = {name: {mode: {} for mode in MODES} for name in self.methods}
        at = product(range(len(cases)), range(1 + ROUNDS * LOADS))
        self.optima = {(i, j): certified(cases[i], cases[i].loads[j], objective) for i, j in at}

    def problems(self, loads) -> list[tuple[int, int]]:
        """Certified problems, the loads of a grasp in a row."""
        at = [(i, j) for i in range(len(self.cases)) for j in loads]
        return [problem for problem in at if self.optima[problem] is not None]

    def call(self, name: str, mode: str, problem: tuple[int, int]) -> tuple[float, object]:
        method, (i, j) = self.methods[name], problem
        load, known = self.cases[i].loads[j], self.known[name][i]
        if mode == "new":
            return timed(method, method.fresh, self.cases[i], load)
        if isinstance(method, Parametrised):
            method.ready(known[0])
        return timed(method, method.again, known, load)

    def spent(self, name: str, mode: str) -> float:
        return sum(seconds for seconds, _ in self.calls[name][mode].values())

    def block(self, name: str, mode: str, problems, budget: float) -> None:
        """Times a method on the problems, one after the other, until it has spent the budget in this mode."""
        done, left = self.calls[name][mode], budget - self.spent(name, mode)
        gc.collect()
        warm = 0.0
        for i in range(min(WARM_UP, len(self.cases))):
            if warm < 0.05 * left:
                warm += self.call(name, mode, (i, 0))[0]
        for problem in problems:
            if left <= 0 and len(done) >= LEAST:
                break
            done[problem] = self.call(name, mode, problem)
            left -= done[problem][0]

    def measure(self) -> None:
        """All modes."""
        gc.collect()
        gc.freeze()  # what is there already need not be searched again before each block
        for turn in range(ROUNDS):
            problems = self.problems(range(1 + turn * LOADS, 1 + (turn + 1) * LOADS))
            start = turn * len(problems) // ROUNDS  # so that methods that are stopped early see other grasps
            for name in self.rng.permutation(list(self.methods)):
                self.block(name, "prepared", problems[start:] + problems[:start], self.budget * (turn + 1) / ROUNDS)
        for name in self.rng.permutation(list(self.methods)):
            self.block(name, "new", self.problems([0]), self.budget)
        problems = self.problems(range(1, 1 + LOADS))
        for problem in problems[:: max(1, len(problems) // INTERLEAVED)]:
            for name in self.rng.permutation(list(self.methods)):
                done = self.calls[name]["interleaved"]
                if len(done) < LEAST or self.spent(name, "interleaved") < self.budget:
                    done[problem] = self.call(name, "interleaved", problem)
        gc.unfreeze()

    def judged(self, name: str) -> tuple[np.ndarray, np.ndarray, Counter]:
        """Of all calls of a method: its own word (n,), errors (n, 3), and the solvers that answered."""
        method, powers = self.methods[name], self.cases[0].base.energy_terms(IMPACT_TIME, "work")
        told, wrong, answered = [], [], Counter()
        arrays = [arrays_of(case) for case in self.cases]
        for calls in self.calls[name].values():
            for (i, j), (_, found) in calls.items():
                ok, x = (False, None) if found is None else method.answer(found)
                told.append(bool(ok))
                wrong.append((np.inf,) * 3)
                if x is not None and np.isfinite(x).all():
                    load = scaled(self.cases[i].loads[j], arrays[i].arm)
                    model, optimum = self.friction.model, self.optima[i, j]
                    wrong[-1] = errors(arrays[i], load, model, self.objective, powers, optimum, x)
                if isinstance(method, Ours):
                    answered["raised" if found is None else found.solver or "none"] += 1
        return np.array(told), np.array(wrong), answered

    def rows(self, k: int, friction: str) -> list[dict]:
        """Table rows, one per method."""
        rows = []
        certain = sum(optimum is not None for optimum in self.optima.values())
        for name, own in self.calls.items():
            row = {"contacts": k, "friction": friction, "objective": self.objective, "method": name}
            row |= {"problems": len(self.optima), "certified": certain}
            for mode, calls in own.items():
                times = 1e6 * np.array([seconds for seconds, _ in calls.values()])
                row[f"{mode}_calls"] = len(times)
                row[f"{mode}_median_us"] = f"{np.median(times):.1f}"
                row[f"{mode}_p99_us"] = f"{np.percentile(times, 99):.0f}"
                row[f"{mode}_p99_9_us"] = f"{np.percentile(times, 99.9):.0f}"
            told, wrong, answered = self.judged(name)
            row["success"] = f"{told.mean():.3f}"
            row["correct"] = f"{(told & np.all(wrong <= TOLERANCE, axis=1)).mean():.3f}"
            row["answered_by"] = " ".join(f"{solver}:{n / told.size:.3f}" for solver, n in answered.most_common())
            row["median_objective_error"] = f"{np.median(wrong[:, 0]):.1e}"
            for what, column in zip(("objective", "balance", "limit"), wrong.T):
                row[f"worst_{what}_error"] = f"{column.max():.1e}"
            for other in OTHERS:
                for mode, mine in own.items():
                    if other not in self.calls:
                        row[f"{other}_over_this_{mode}"] = ""
                        continue
                    theirs = self.calls[other][mode]
                    both = np.array([(theirs[at][0], mine[at][0]) for at in mine if at in theirs])
                    row[f"{other}_over_this_{mode}"] = f"{np.divide(*np.median(both, axis=0)):.2f}"
            rows.append(row)
        return rows


# -- output ------------------------------------------------------------------------------------------------------------

# Colours after Okabe and Ito, told apart in every kind of colour vision; the package's named solvers stay in grey.
STYLES = {  # label, colour, line
    "auto": ("pinograsp (auto)", "#0072B2", "-"),
    "cvxpy": ("CVXPY", "#D55E00", "-."),
    "slsqp": ("SLSQP", "#009E73", "-"),
    "slsqp_gradients": ("SLSQP, gradients", "#009E73", "--"),
    "slsqp_tight": ("SLSQP, tight", "#009E73", ":"),
    "plain_qp": ("plain QP", "#000000", ":"),
    "online": ("pinograsp (online, cold)", "#56B4E9", "-"),
    "clarabel_native": ("Clarabel, native", "#CC79A7", "-"),
    "daqp_native": ("DAQP, native", "#E69F00", "-"),
}


def draw(rows: list[dict], path: Path) -> None:
    """One panel per objective and friction model: median time against contacts, labels at the ends of the lines."""
    names = [name for name, *_ in FRICTIONS]
    figure = Figure(figsize=(20, 13), layout="constrained")
    panels = figure.subplots(len(OBJECTIVES), len(names), sharey=True)
    labels = []
    for objective, line in zip(OBJECTIVES, panels):
        for friction, axes in zip(names, line):
            own = [r for r in rows if r["friction"] == friction and r["objective"] == objective]
            if not own:  # not asked for
                axes.set_axis_off()
                continue
            ends = []
            for method in dict.fromkeys(r["method"] for r in own):
                curve = [r for r in own if r["method"] == method]
                x = [r["contacts"] for r in curve]
                y = [float(r["prepared_median_us"]) for r in curve]
                front = method in STYLES
                label, colour, style = STYLES.get(method, (method, "#8A8A8A", "-"))
                width = 3.5 if method == "auto" else 1.8 if front else 0.9
                axes.loglog(x, y, style, color=colour, linewidth=width, zorder=3 if front else 2)
                for a, b, r in zip(x, y, curve):
                    good = float(r["correct"]) >= 0.99
                    axes.plot(
                        a,
                        b,
                        "o",
                        color=colour,
                        markersize=7 if front else 4,
                        zorder=4 if front else 2,
                        markerfacecolor=colour if good else "white",
                    )
                if method == "auto":
                    cold = [float(r["interleaved_median_us"]) for r in curve]
                    axes.loglog(x, cold, "--", color=colour, linewidth=1.5, zorder=3)
                ends.append((y[-1], x[-1], label, colour, front))
            axes.set_title(f"{objective.replace('_', ' ')}, {friction.replace('+', ' + ')}")
            ticks = sorted({r["contacts"] for r in own})
            axes.set_xticks(ticks, [str(t) for t in ticks])
            axes.set_xticks([], minor=True)
            axes.grid(alpha=0.3, which="major")
            axes.set_xlim(ticks[0] * 0.9, ticks[-1] * max(1.3, ticks[-1] / ticks[0]) ** 0.75)  # room for the labels
            labels.append((axes, ends))
            if objective == OBJECTIVES[-1]:
                axes.set_xlabel("contacts")
        line[0].set_ylabel("median time per new load, grasp solved before [us]")
    for axes, ends in labels:
        _label(axes, ends)
    figure.suptitle(
        "Contact forces of least cost: time per new load on a known grasp. "
        "Blue, dashed: the same, interleaved with the other methods (cold caches).\n"
        "Hollow: under 99 % of the answers correct to 1e-6. Grey: pinograsp with a named solver. "
        "SLSQP: finite differences; gradients: written by hand; tight: ftol 1e-12."
    )
    figure.savefig(path, dpi=90)


def _label(axes, ends) -> None:
    """Names at the ends of the lines, moved apart where they would touch."""
    low, high = np.log10(axes.get_ylim())
    gap = (high - low) / 33  # between two labels
    ends = sorted(ends)
    at = [float(np.log10(y)) for y, *_ in ends]
    for _ in range(500):
        at[0] = max(at[0], low + gap)
        for i in range(len(at) - 1):
            lack = gap - (at[i + 1] - at[i])
            if lack > 0:
                at[i], at[i + 1] = at[i] - lack / 2, at[i + 1] + lack / 2
    for (y, x, text, colour, front), height in zip(ends, at):
        axes.annotate(
            text,
            (x, y),
            (x * (axes.get_xlim()[1] / axes.get_xlim()[0]) ** 0.05, 10**height),
            textcoords="data",
            color=colour,
            fontsize=10 if front else 8,
            fontweight="bold" if text.startswith("pinograsp") else "normal",
            verticalalignment="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "alpha": 0.5},
            annotation_clip=False,
        )


def short(rows: list[dict]) -> list[dict]:
    """Rows of "auto" and "online": us, and how many times as long the others take (prepared)."""
    columns = {"contacts": "contacts", "friction": "friction", "objective": "objective", "method": "method"}
    columns |= {"prepared_median_us": "prepared", "prepared_p99_us": "p99", "interleaved_median_us": "interl."}
    columns |= {"new_median_us": "new", "correct": "correct"}
    columns |= {f"{other}_over_this_prepared": f"{other}/" for other in (*OTHERS[:3], *OTHERS[4:])}
    return [{head: r[column] for column, head in columns.items()} for r in rows if r["method"] in ("auto", "online")]


LIMITATIONS = """Known limitations:
- One machine, one process, one thread; random grasps on cylinders and spheres at one impact time.
- Every load can be held: proofs of infeasibility, which this package also gives, are not timed.
- "prepared" is a loop that does nothing else; between other work a call takes what "interleaved" says.
- "slsqp" pays for finite differences: what one gets without writing gradients. What SLSQP can do: slsqp_gradients.
- A method that exceeds its budget in a mode gets no more calls of it (columns ending in calls); ratios use the medians
  over the problems that both got. With few calls the p99 is next to the slowest, and it has the machine's own pauses.
- The optimum that decides "correct" comes from this package: forces and a lower bound, which agree to 1e-7. Problems
  where they do not (problems less certified) are left out.
- CVXPY compiled to C (cvxpygen), or another modelling language, may be faster than CVXPY itself."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer grasps, and a small budget per method")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds per method, mode and group")
    parser.add_argument("--contacts", type=int, nargs="+", choices=GRASPS, help="only these numbers of contacts")
    parser.add_argument("--out", type=Path, default=HERE / "forces.csv", help="table; the figure lies beside it")
    options = parser.parse_args()
    grasps = GRASPS_QUICK if options.quick else GRASPS
    asked = options.contacts or [k for k in grasps if k <= MOST_QUICK or not options.quick]
    grasps = {k: count for k, count in grasps.items() if k in asked}
    of = {k: FRICTIONS if k <= MOST_FOR_ALL else FRICTIONS[:2] for k in grasps}
    warnings.simplefilter("ignore")  # CVXPY and qpsolvers remark on accuracy and conversions; errors are measured here
    gc.disable()
    rows = []
    with tqdm(total=sum(len(of[k]) * len(OBJECTIVES) for k in grasps), unit="group") as bar:
        for k, count in grasps.items():
            rng = np.random.default_rng([SEED, k])
            cases = [grasp(rng, k) for _ in range(count)]
            for (name, friction, torques), objective in product(of[k], OBJECTIVES):
                bar.set_description(f"{k} contacts, {name}, {objective}")
                own = [
                    replace(c, base=replace(c.base, friction=friction, torques=c.base.torques if torques else None))
                    for c in cases
                ]
                group = Group(own, friction, objective, BUDGET_QUICK if options.quick else options.budget)
                group.measure()
                rows += group.rows(k, name)
                bar.update()
            busy = f"load average {os.getloadavg()[1]:.1f}"
            kind = "quick run" if options.quick else "full run"
            first_line = header(PACKAGES, "one thread used", busy, kind)
            write_rows(options.out, first_line, rows)
            draw(rows, options.out.with_suffix(".png"))
    print(first_line, table(short(rows)), LIMITATIONS, sep="\n")


if __name__ == "__main__":
    main()
