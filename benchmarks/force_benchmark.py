"""A public benchmark of solvers on contact-force problems: what they say against what is right, and their time.

    python benchmarks/force_benchmark.py [--seed 0] [--share 1.0] [--solver mine=module:function]
                                         [--socp-solver mine=module:function]

``--solver`` adds a function of a ``pinograsp.forces.QuadraticProgram`` (``--socp-solver``: of a ``ConicProgram``) that
returns x, or x with multipliers, as ``pinograsp.forces.register_solver`` describes. Writes force_benchmark.csv beside
this file, a row for each solver and set.

Sets, made from the seed; the optimum is of least squares where nothing else is said:

- cloutier-yang: in the design of Cloutier and Yang, with grasps made here: 3 grasps (three fingers on a ball, four on a
  box, five on a cylinder) with hard fingers, the same in 4-edge pyramids, and soft fingers, each under 18 loads: forces
  and moments along both senses of three axes, and six mixed ones; half of what the pyramids hold.
- random-3, -5, -15: random contacts on cylinders and balls, with pyramids and with cones; loads that pyramids hold.
- degenerate: contacts that coincide, contacts on a line, some or all without friction, no load.
- barely-feasible, barely-infeasible: loads off the largest one by 1e-3 to 1e-6 of it (nearer than the 1e-7 to which
  that is known nobody is right or wrong).
- paper: the case study's grasp with loads about the published one.
- torque-limits: joint torques limited, and least squares or motor heat (its Hessian is singular).
- peak: the least largest normal force (a linear program).
- energy: the grasp energy, powers of F_n, on cones: power cones.

A problem is a quadratic program (``to_qp``) or one over cones (``to_socp``). Solvers of others get these matrices,
dimensionless, ready before the clock starts (sparse for those that take nothing else). QP solvers run through
qpsolvers, whose stacking of sparse rows takes most of a millisecond; Clarabel and SCS ("direct"), and on cones ECOS,
run by their own interfaces. Each runs with its defaults ("default") and with tight tolerances ("tight": those that
this package passes), for one second at most where it has a limit.

This package runs as a ``ForceSolver`` that was made before; its answer has its certificate and its own balance
correction, which are in its time. "core newton" and "core interior" are its compiled methods: where another one answers
for them they count as having failed. "daqp steps": its Newton steps over DAQP.

"said": the share of problems that hold which the solver calls solved. "right at e": the share of all problems on which
its word and its forces are right: balance (over the load) and limits (over the largest force) missed by at most e, the
objective within e of the proven optimum, as this package's certificate measures them on the solver's own x, nothing
corrected. Of a problem that does not hold a "no" is right, and so is an answer that misses balance and limits by at
most e. The optimum is the best lower bound that anyone's multipliers prove; problems where it is not proven to e are
left out at e ("open"). A refusal, an exception or a wrong word is a failure: a solver that takes only some problems of
a set loses the others.

Times are processor time, the least of three calls, so that others on the machine hardly count. "mean": the shifted
geometric mean (shift 0.1 ms), a failure at 1e-6 counting as one second. "median" and "p99" are of all calls. "whole":
median with everything made from the ``ForceProblem``: matrices, or the ``ForceSolver``."""

from __future__ import annotations

import os

# Read when the libraries load.
os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMEXPR")})

import argparse
import importlib
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import clarabel
import forces
import numpy as np
import qpsolvers
import scipy.sparse as sp
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.contacts import Contact, ContactSet
from pinograsp.errors import InvalidInput, PinograspError, Status
from pinograsp.forces import register_solver, to_qp, to_socp
from pinograsp.forces.solve.registry import ask_solver
from pinograsp.forces.solve.solvers import TOLERANCES, solve_by_qpsolvers, state_qp
from pinograsp.spatial import tangent_frame

HERE = Path(__file__).resolve().parent
T_I = forces.IMPACT_TIME
TORSION = forces.TORSION
EPS = (1e-3, 1e-6, 1e-9)
SHIFT, LIMIT = 1e-4, 1.0  # of the mean [s]
REPEATS = 3
# Where a solver has a limit of time: as long as counts.
TIME_LIMIT = {
    "clarabel": {"time_limit": LIMIT},
    "highs": {"time_limit": LIMIT},
    "osqp": {"time_limit": LIMIT},
    "scs": {"time_limit_secs": LIMIT},
}
OURS = {"pinograsp": "auto", "core newton": "newton", "core interior": "interior", "daqp steps": "daqp"}
PACKAGES = ("numpy", "scipy", "qpsolvers", "daqp", "clarabel", "osqp", "proxsuite", "piqp", "quadprog", "scs", "ecos")
PACKAGES += ("highspy",)


# -- problems ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """One problem of a set."""

    set: str
    problem: pg.ForceProblem
    objective: str = "least_squares"

    @property
    def kind(self) -> str:
        """What it is: "qp", "cones", or "power cones"."""
        if self.objective in ("work", "impulse"):
            return "power cones"
        return "qp" if self.problem.friction.polyhedral else "cones"


def set_of(points, normals) -> ContactSet:
    """Contacts at points (k, 3) about the centre of mass with inward normals (k, 3)."""
    gravity = np.array([0.0, 0.0, -9.81])
    contacts = tuple(
        Contact(
            finger=f"finger {i + 1}",
            link="",
            point_o=np.array(point, dtype=float),
            rotation_oc=tangent_frame(np.array(normal, dtype=float), gravity),
            length=None,
            distance=0.0,
        )
        for i, (point, normal) in enumerate(zip(points, normals))
    )
    return ContactSet(contacts=contacts, com_o=np.zeros(3))


def round_contacts(angles, radius: float, heights) -> ContactSet:
    """On a cylinder's side (heights any) or a ball's equator (zero)."""
    outward = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    return set_of(radius * outward + np.outer(heights, [0, 0, 1]), -outward)


def held(problem: pg.ForceProblem, direction: np.ndarray) -> float | None:
    """The largest multiple of a direction (6,) that is held; None where a little of it is not."""
    little = 1e-2 * direction
    factor = pg.forces.load_factor(problem.with_load(little), impact_time=T_I)
    return 1e-2 * factor if factor > 1.0 and np.isfinite(factor) else None


def cloutier_yang(rng, share: float):
    box = np.array([[0.02, 0.01, 0], [0.02, -0.01, 0.005], [-0.02, 0.008, 0], [-0.02, -0.012, -0.005]])
    grasps = [
        round_contacts(np.deg2rad([0, 120, 240]), 0.03, np.zeros(3)),
        set_of(box, np.array([[-1.0, 0, 0]] * 2 + [[1.0, 0, 0]] * 2)),
        round_contacts(np.deg2rad([0, 150, 170, 190, 210]), 0.025, [0, 0.03, 0.01, -0.01, -0.03]),
    ]
    axes = np.vstack([np.eye(6), -np.eye(6)])
    mixed = rng.normal(size=(6, 6))
    loads = np.vstack([axes, mixed / np.linalg.norm(mixed, axis=1)[:, None]])
    loads[:, 3:] *= 0.02  # moments at an arm [m]
    for contacts in grasps:
        base = pg.ForceProblem(contacts=contacts, load=np.zeros(6), mu=0.6, friction=pg.Friction(), max_depth=5e-3)
        for load in some(loads, share):
            largest = held(base, load)
            if largest is None:
                continue
            problem = base.with_load(0.5 * largest * load)
            yield Task("cloutier-yang, pyramid", problem)
            yield Task("cloutier-yang, hard", replace(problem, friction=pg.Friction(model="cone")))
            yield Task("cloutier-yang, soft", replace(problem, friction=pg.Friction(model="soft", torsion=TORSION)))


def some(items, share: float):
    """The first of the items, at least one."""
    return items[: max(1, round(share * len(items)))]


def random_grasps(rng, share: float):
    for k, count in ((3, 40), (5, 40), (15, 20)):
        for _ in range(max(1, round(share * count))):
            case = forces.grasp(rng, k)
            problem = replace(case.base.with_load(case.loads[0]), torques=None)
            yield Task(f"random-{k}, pyramid", problem)
            yield Task(f"random-{k}, cone", replace(problem, friction=pg.Friction(model="cone")))


def degenerate(rng, share: float):
    for i in range(max(5, round(share * 40))):
        case = forces.grasp(rng, 4)
        problem = replace(case.base.with_load(case.loads[0]), torques=None)
        own = problem.contacts.contacts
        kind = i % 5
        if kind == 0:  # contacts that coincide
            twice = ContactSet(contacts=own * 2, com_o=problem.contacts.com_o)
            problem = replace(problem, contacts=twice, mu=np.tile(problem.mu, 2), moment_length=None)
        elif kind == 1:  # on a line: no moment about it
            line = set_of([[0.02, 0, 0], [-0.02, 0, 0]] * 2, [[-1.0, 0, 0], [1.0, 0, 0]] * 2)
            problem = pg.ForceProblem(
                contacts=line, load=[0, *rng.uniform(-1, 1, 2), 0, 0, 0], mu=0.6, friction=pg.Friction(), max_depth=5e-3
            )
        elif kind == 2:  # some without friction
            problem = replace(problem, mu=np.where(np.arange(4) < 2, 0.0, problem.mu))
        elif kind == 3:  # none with friction: a ball between six points
            normals = np.vstack([np.eye(3), -np.eye(3)])
            load = [*rng.uniform(-1, 1, 3), 0, 0, 0]
            problem = pg.ForceProblem(
                contacts=set_of(-0.03 * normals, normals), load=load, mu=0.0, friction=pg.Friction(), max_depth=5e-3
            )
        else:
            problem = problem.with_load(np.zeros(6))
        yield Task("degenerate", problem)


def barely(rng, share: float):
    for name, sign in (("barely-feasible", -1.0), ("barely-infeasible", 1.0)):
        for i in range(max(6, round(share * 30))):
            while True:
                case = forces.grasp(rng, int(rng.integers(3, 7)))
                load = case.loads[0]
                problem = replace(case.base.with_load(load), torques=None)
                largest = pg.forces.load_factor(problem, impact_time=T_I)
                if 1.0 < largest < 1e3:
                    break
            off = 10.0 ** -(3 + i % 4)
            yield Task(name, problem.with_load(largest * (1.0 + sign * off) * load))


def paper(rng, share: float):
    problem = pg.load_case("paper", AS_PUBLISHED).plan().problem
    for _ in range(max(2, round(share * 20))):
        own = problem.with_load(problem.load * rng.uniform(0.8, 1.2, 6))
        yield Task("paper", own)
        yield Task("energy, paper", own, "impulse")


def torque_limits(rng, share: float):
    for i in range(max(2, round(share * 40))):
        case = forces.grasp(rng, (3, 5)[i // 2 % 2])
        objective = ("least_squares", "motor_heat")[i % 2]
        yield Task(f"torque-limits, {objective}", case.base.with_load(case.loads[0]), objective)


def other_objectives(rng, share: float):
    for k in (3, 5, 15):
        for _ in range(max(1, round(share * 10))):
            case = forces.grasp(rng, k)
            problem = replace(case.base.with_load(case.loads[0]), torques=None)
            yield Task("peak", problem, "peak")
            yield Task("energy, cone", replace(problem, friction=pg.Friction(model="cone")), "work")


SETS = (cloutier_yang, random_grasps, degenerate, barely, paper, torque_limits, other_objectives)


# -- solvers -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """A solver's word, its forces as a program's x (k d,) or None, and multipliers where there are any."""

    said: bool
    x: np.ndarray | None = None
    multipliers: dict = field(default_factory=dict)


NO = Answer(False)


class Ours:
    """This package with one of its solvers; what another solver answered is no answer."""

    def __init__(self, solver: str):
        self.solver = solver

    def ready(self, task: Task):
        return pg.ForceSolver(task.problem, T_I, objective=task.objective, solver=self.solver)

    def solve(self, solver):
        return solver.solve()

    def answer(self, task: Task, found) -> Answer:
        if found.status is not Status.OK or self.solver not in ("auto", found.solver):
            return NO
        scales = np.array([c.scale for c in scaled(task).columns])[: task.problem.k * task.problem.friction.d]
        own = np.column_stack([found.forces_c[:, :2], found.torsion, found.forces_c[:, 2]])
        own = own if task.problem.friction.d == 4 else own[:, [0, 1, 3]]
        return Answer(True, np.divide(own.ravel(), scales, out=np.zeros(own.size), where=scales > 0))


class ByQpsolvers:
    """A QP solver through qpsolvers."""

    def __init__(self, name: str, settings: dict):
        self.name, self.settings = name, settings

    def ready(self, task: Task):
        if task.kind != "qp":
            raise InvalidInput("no QP")
        qp = to_qp(task.problem, T_I, objective=task.objective)
        return qp, state_qp(self.name, qp)

    def solve(self, ready):
        return solve_by_qpsolvers(self.name, *ready, **self.settings)

    def answer(self, task: Task, found) -> Answer:
        if not found.found or found.x is None:
            return NO
        own = {} if found.y is None or found.z is None else {"y": np.array(found.y), "z": np.array(found.z)}
        return Answer(True, np.array(found.x), own)


class ClarabelCones:
    """Clarabel's own interface, on cones."""

    def __init__(self, settings: dict):
        self.settings = clarabel.DefaultSettings()
        for name, value in {"verbose": False, **settings}.items():
            setattr(self.settings, name, value)

    def ready(self, task: Task):
        socp = over_cones(task)
        return sp.csc_matrix(sp.triu(socp.P)), socp.q, socp.A, socp.b, socp.cones.clarabel(), self.settings

    def solve(self, ready):
        return clarabel.DefaultSolver(*ready).solve()

    def answer(self, task: Task, found) -> Answer:
        if str(found.status) != "Solved":
            return NO
        return Answer(True, np.array(found.x), {} if task.kind == "qp" else {"z": np.array(found.z)})


class ScsCones:
    """SCS's own interface, on cones."""

    def __init__(self, options: dict):
        import scs

        self.make, self.options = scs.SCS, options

    def ready(self, task: Task):
        socp = over_cones(task)
        return {"P": sp.csc_matrix(sp.triu(socp.P)), "A": socp.A, "b": socp.b, "c": socp.q}, socp.cones.scs()

    def solve(self, ready):
        return self.make(*ready, verbose=False, **self.options).solve()

    def answer(self, task: Task, found) -> Answer:
        if found["info"]["status_val"] != 1:
            return NO
        return Answer(True, found["x"], {} if task.kind == "qp" else {"z": found["y"]})


class EcosCones:
    """ECOS's own interface, on second-order cones; the quadratic objective t >= 1/2 x'P x is one of them."""

    def __init__(self, options: dict):
        import ecos

        self.call, self.options = ecos.solve, options

    def ready(self, task: Task):
        socp = over_cones(task)
        if socp.cones.power:
            raise InvalidInput("power cones")
        n, zero, linear = len(socp.q), socp.cones.zero, socp.cones.nonnegative
        values, vectors = np.linalg.eigh(socp.P.toarray())
        kept = values > 1e-14 * values[-1]
        root = np.sqrt(2.0 * values[kept])[:, None] * vectors[:, kept].T
        top = np.zeros((2, n + 1))
        top[:, -1] = -1.0
        quadratic = np.vstack([top[:1], np.hstack([-root, np.zeros((len(root), 1))]), top[1:]])  # (t + 1, L'x, t - 1)
        A = sp.hstack([socp.A, sp.csc_matrix((len(socp.b), 1))], format="csr")
        G = sp.vstack([A[zero:], sp.csc_matrix(quadratic)], format="csc")
        h = np.concatenate([socp.b[zero:], [1.0], np.zeros(len(root)), [-1.0]])
        dims = {"l": linear, "q": [*socp.cones.second_order, len(quadratic)]}
        return np.append(socp.q, 1.0), G, h, dims, sp.csc_matrix(A[:zero]), socp.b[:zero]

    def solve(self, ready):
        return self.call(*ready, verbose=False, **self.options)

    def answer(self, task: Task, found) -> Answer:
        return Answer(True, found["x"][:-1]) if found["info"]["exitFlag"] == 0 else NO


class Registered:
    """A function that was given on the command line."""

    def __init__(self, name: str, takes: str):
        self.name, self.takes = name, takes

    def ready(self, task: Task):
        if self.takes == "socp":
            return over_cones(task)
        if task.kind != "qp":
            raise InvalidInput("no QP")
        return to_qp(task.problem, T_I, objective=task.objective)

    def solve(self, program):
        return ask_solver(self.name, program)

    def answer(self, task: Task, found) -> Answer:
        if found is None:
            return NO
        parts = {"y": found.y, "z": found.z} if self.takes == "qp" else {"z": found.z}
        known = all(part is not None for part in parts.values()) and (self.takes == "qp") == (task.kind == "qp")
        return Answer(True, found.x, parts if known else {})


def over_cones(task: Task):
    return to_socp(task.problem, T_I, objective=task.objective)


def scaled(task: Task):
    """The program that judges: a quadratic one where there is one."""
    return to_qp(task.problem, T_I, objective=task.objective) if task.kind == "qp" else over_cones(task)


def solvers_for(kind: str, own: list[tuple[str, str]]) -> dict[tuple[str, str], object]:
    """(Name, settings) -> solver, of problems of a kind."""
    found: dict[tuple[str, str], object] = {(name, ""): Ours(solver) for name, solver in OURS.items()}
    found |= {(name, ""): Registered(name, takes) for name, takes in own if takes == "socp" or kind == "qp"}
    there = qpsolvers.available_solvers
    if kind == "qp":
        for name in there:
            limit = TIME_LIMIT.get(name, {})
            found[name, "default"] = ByQpsolvers(name, limit)
            if TOLERANCES.get(name):
                found[name, "tight"] = ByQpsolvers(name, limit | TOLERANCES[name])
    own_interfaces = {"clarabel": ClarabelCones} | ({"scs": ScsCones} if "scs" in there else {})
    for name, make in own_interfaces.items():
        limit, called = TIME_LIMIT[name], f"{name}, direct" if kind == "qp" else name
        found[called, "default"], found[called, "tight"] = make(limit), make(limit | TOLERANCES[name])
    if "ecos" in there and kind == "cones":
        found["ecos", "default"], found["ecos", "tight"] = EcosCones({}), EcosCones(TOLERANCES["ecos"])
    return found


# -- measuring ---------------------------------------------------------------------------------------------------------


@dataclass
class Result:
    """A solver on a task: its answer, time of the solve and of everything [s], and what the certificate measured."""

    answer: Answer
    seconds: float
    whole: float
    refused: bool = False
    residual: float = np.inf
    violation: float = np.inf
    objective: float = np.inf


def spent(call: Callable) -> tuple[float, object]:
    started = time.process_time()
    found = call()
    return time.process_time() - started, found


def measured(solver, task: Task) -> Result:
    """Least times of some calls."""
    best, whole, found = np.inf, np.inf, None
    try:
        for _ in range(REPEATS):
            before, ready = spent(lambda: solver.ready(task))
            seconds, found = spent(lambda ready=ready: solver.solve(ready))
            best, whole = min(best, seconds), min(whole, before + seconds)
            if seconds > 0.2:
                break
    except PinograspError:
        return Result(NO, LIMIT, LIMIT, refused=True)
    except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError, ArithmeticError, RuntimeError):
        return Result(NO, LIMIT, LIMIT, refused=True)
    return Result(solver.answer(task, found), best, whole)


@dataclass
class Judged:
    """A task's results by solver, its best proven lower bound and best objective, and the size that gaps refer to."""

    task: Task
    feasible: bool
    bound: float
    best: float
    size: float
    results: dict

    def right(self, result: Result, eps: float) -> bool | None:
        """Whether the solver is right at eps; None where the optimum is not proven so far."""
        admissible = result.residual <= eps and result.violation <= eps
        if not self.feasible:
            return not result.answer.said or admissible
        if self.best - self.bound > eps * self.size:
            return None
        return result.answer.said and admissible and abs(result.objective - self.bound) <= eps * self.size


def judged(task: Task, solvers: dict) -> Judged | None:
    """All solvers on a task; None where this package neither solves it nor proves that it has no forces."""
    reference = pg.optimize_forces(task.problem, T_I, objective=task.objective, solver="clarabel")
    if reference.status not in (Status.OK, Status.INFEASIBLE):
        return None
    program, results = scaled(task), {key: measured(solver, task) for key, solver in solvers.items()}
    feasible = reference.status is Status.OK
    bound, best, size = -np.inf, np.inf, 1.0
    if feasible:
        bound, best = reference.certificate.lower_bound, reference.certificate.objective
        size = reference.certificate.objective_size
    n = task.problem.k * task.problem.friction.d
    for result in results.values():
        if result.answer.x is None or not np.isfinite(result.answer.x).all():
            continue
        x = np.zeros(len(program.q))
        x[:n] = result.answer.x[:n]
        own = program.solution(x, settle=False).certificate
        bounds = [own.lower_bound]
        multipliers = result.answer.multipliers
        if multipliers and all(np.isfinite(part).all() for part in multipliers.values()):
            bounds.append(program.solution(x, **multipliers, settle=False).certificate.lower_bound)
        result.residual, result.violation = own.residual_norm / own.load_size, own.violation / own.force_size
        result.objective = own.objective
        if feasible:
            bound = max(bound, *bounds)
            if result.residual <= EPS[-1] and result.violation <= EPS[-1]:
                best = min(best, own.objective)
    return Judged(task, feasible, bound, best, size, results)


def row_of(all_judged: list[Judged], key: tuple[str, str]) -> dict:
    """What a solver did on these tasks."""
    own = [(one, one.results[key]) for one in all_judged]
    hold = [result for one, result in own if one.feasible]
    row = {"solver": key[0], "settings": key[1], "problems": len(own)}
    row["said"] = share(sum(result.answer.said for result in hold), len(hold))
    for eps in EPS:
        verdicts = [one.right(result, eps) for one, result in own]
        known = [verdict for verdict in verdicts if verdict is not None]
        row[f"right at {eps:.0e}"] = share(sum(known), len(known))
    row["refused"] = sum(result.refused for _, result in own)
    seconds = np.array([result.seconds for _, result in own if not result.refused])
    penalised = [min(result.seconds, LIMIT) if one.right(result, 1e-6) is not False else LIMIT for one, result in own]
    row["mean_ms"] = f"{1e3 * (np.exp(np.mean(np.log(np.array(penalised) + SHIFT))) - SHIFT):.3f}"
    for name, of in (("median_ms", 50), ("p99_ms", 99)):
        row[name] = f"{1e3 * np.percentile(seconds, of):.3f}" if len(seconds) else ""
    whole = [result.whole for _, result in own if not result.refused]
    row["whole_ms"] = f"{1e3 * np.median(whole):.3f}" if whole else ""
    return row


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else ""


def report(all_judged: list[Judged]) -> tuple[list[dict], str]:
    """Rows of the CSV, and the tables."""
    rows, texts = [], []
    for kind in ("qp", "cones", "power cones"):
        own = [one for one in all_judged if one.task.kind == kind]
        if not own:
            continue
        keys = list(own[0].results)
        names = list(dict.fromkeys(one.task.set for one in own))
        whole = sorted((row_of(own, key) for key in keys), key=lambda row: float(row["mean_ms"]))
        unproven = ", ".join(
            f"{sum(one.feasible and one.best - one.bound > eps * one.size for one in own)} at {eps:.0e}" for eps in EPS
        )
        texts.append(f"### {kind}: {len(own)} problems; open: {unproven}\n\n{table(whole)}")
        by_set = {key: {"solver": " ".join(key).strip()} for key in keys}
        for name in names:
            of = [one for one in own if one.task.set == name]
            for key in keys:
                row = row_of(of, key)
                rows.append({"kind": kind, "set": name, **row})
                by_set[key][name] = row["right at 1e-06"]
        rows += [{"kind": kind, "set": "all", **row} for row in whole]
        order = [by_set[row["solver"], row["settings"]] for row in whole]
        texts.append(f"### {kind}: right at 1e-06, by set\n\n{table(order)}")
    return rows, "\n\n".join(texts)


def added(text: str) -> tuple[str, Callable]:
    """Name and function of mine=module:function."""
    name, _, place = text.partition("=")
    module, _, function = place.partition(":")
    sys.path.append(os.getcwd())  # yours may lie where the command is typed
    try:
        return name, getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise argparse.ArgumentTypeError(f"expected mine=module:function, got {text!r}: {error}") from error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--share", type=float, default=1.0, help="of the problems of each set")
    parser.add_argument("--solver", type=added, action="append", default=[], help="mine=module:function, of a QP")
    parser.add_argument("--socp-solver", type=added, action="append", default=[], help="the same, on cones")
    parser.add_argument("--out", type=Path, default=HERE / "force_benchmark.csv")
    options = parser.parse_args()
    own = []
    for takes, given in (("qp", options.solver), ("socp", options.socp_solver)):
        for name, function in given:
            register_solver(name, function, takes=takes)
            own.append((name, takes))
    warnings.simplefilter("ignore")  # qpsolvers and ECOS remark on accuracy, which is measured here
    tasks = [
        task
        for i, make in enumerate(tqdm(SETS, desc="problems", unit="set"))
        for task in make(np.random.default_rng([options.seed, i]), options.share)
    ]
    solvers = {kind: solvers_for(kind, own) for kind in ("qp", "cones", "power cones")}
    done, undecided = [], 0
    for task in tqdm(tasks, unit="problem"):
        found = judged(task, solvers[task.kind])
        undecided += found is None
        if found is not None:
            done.append(found)
    rows, text = report(done)
    notes = (f"seed {options.seed}", f"share {options.share:g}", f"load average {os.getloadavg()[1]:.1f}")
    first_line = header(PACKAGES, *notes)
    write_rows(options.out, first_line, rows)
    print(first_line, text, f"{undecided} problems left out: neither solved nor proven to have no forces", sep="\n\n")


if __name__ == "__main__":
    main()
