"""The core beside Clarabel and DAQP, through the public Python interface, nothing warmed up by the caller.

    python benchmarks/native.py [--contacts 3 15 50] [--blocks 40]
    python benchmarks/native.py --regimes [--contacts 3 5 15 50]

Least squares on exact cones and pyramids: seeded grasps of forces.py, a new load at every call, cold starts. Methods
take turns in blocks of 50 calls, so that all meet the same machine; a ratio is that of a block to the core's block
before it, and the median of these is given. "step": ``OnlineForces.step`` without a hand, after ``reset()``, which is
in the time. "optimize_forces": with its full record, of ``problem.with_load(load)``, which is in the time, too; "same
load": of the problem itself. Clarabel and DAQP: their own interfaces on matrices that are ready, the load alone is set.
"multipliers": the QP at fixed normal forces in the box, of the paper's grasp (3 rows, which balance), and of the
seeded grasps under loads that nothing balances (6 rows). Writes native.csv beside this file.

``--regimes``: where Newton's method alone is not enough, too. Seeded grasps, pyramids of four edges and least squares
where nothing else is said; "torque rows": joint torques limited, three joints for each contact, some of which bind;
"near the limit": 1e-4 below the largest load that is held; "infeasible": half above it. "ours" is ``ForceSolver.solve``
with its whole record, certificate or proof included, prepared under another load of the same grasp; "core" what of it
is the core's call, whose arrays are ready, as those of the others are: their own interfaces, at their default
tolerances. DAQP takes no cones. Processor time in microseconds; the three take turns on each problem, in blocks of five
calls. Writes regimes.csv."""

from __future__ import annotations

import argparse
import gc
import time
from dataclasses import replace
from pathlib import Path

import clarabel
import daqp
import forces
import numpy as np
import scipy.sparse as sp
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.forces import MultiplierQP

HERE = Path(__file__).resolve().parent
GRASPS, AT_ONCE = 8, 50
# Friction, whether torques are limited, objective, multiple of the largest load (None: loads well within).
REGIMES = {
    "basic": (pg.Friction(), False, "least_squares", None),
    "torque rows": (pg.Friction(), True, "least_squares", None),
    "8 edges": (pg.Friction(edges=8), False, "least_squares", None),
    "16 edges": (pg.Friction(edges=16), False, "least_squares", None),
    "second-order cone": (pg.Friction(model="cone"), False, "least_squares", None),
    "peak": (pg.Friction(), False, "peak", None),
    "near the limit": (pg.Friction(), False, "least_squares", 1 - 1e-4),
    "near the limit, torque rows": (pg.Friction(), True, "least_squares", 1 - 1e-4),
    "infeasible": (pg.Friction(), False, "least_squares", 1.5),
    "infeasible, 8 edges": (pg.Friction(edges=8), False, "least_squares", 1.5),
    "infeasible, torque rows": (pg.Friction(), True, "least_squares", 1.5),
}
REGIME_LOADS, REGIME_CALLS = 3, 5  # per grasp, per problem


def methods_of(case, model: str) -> dict:
    """Name -> a function of a load (6,)."""
    friction = pg.Friction(model=model)
    problem = replace(case.base, friction=friction, torques=None)
    online = pg.OnlineForces(problem, normal_forces=(case.lo, case.hi))
    given = replace(case, base=problem)
    others = {"clarabel": forces.ClarabelNative(model)}
    if model == "pyramid":
        others["daqp"] = forces.DaqpNative()

    def step(load):
        online.reset()
        online.step(load)

    def whole(load):
        pg.optimize_forces(problem.with_load(load), forces.IMPACT_TIME, objective="least_squares")

    def same(_):
        pg.optimize_forces(problem, forces.IMPACT_TIME, objective="least_squares")

    found = {"step": step, "optimize_forces": whole, "optimize_forces, same load": same}
    for name, method in others.items():
        known = method.fresh(given, case.loads[0])

        def solve(load, method=method, known=known):
            method.solve(method.again(known, load))

        found[name] = solve
    return found


def multipliers_of(problem, normal) -> dict:
    """The QP over the multipliers at normal forces (k,), and DAQP on the same matrices."""
    ours = MultiplierQP(problem, normal)
    columns = problem.scaled_columns
    H = (columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]).reshape(problem.rows, -1)
    n = H.shape[1]
    P, fixed, scale = H.T @ H + 1e-9 * np.eye(n), columns[:, :, 2] @ normal, np.ones(problem.rows)
    scale[3:] /= problem.moment_length
    none, bound, sense = np.zeros((0, n)), np.ones(n), np.zeros(n, dtype=np.int32)

    def other(load):
        daqp.solve(P, H.T @ (fixed + scale * load[: len(scale)]), none, bound, -bound, sense)

    return {"multipliers": ours.solve, "daqp": other}


def taken(method, loads) -> np.ndarray:
    """Microseconds of each call."""
    spent, clock = np.empty(len(loads)), time.perf_counter
    for i, load in enumerate(loads):
        before = clock()
        method(load)
        spent[i] = clock() - before
    return 1e6 * spent


def compared(name: str, made: list, blocks: int, bar) -> list[dict]:
    """A row for each method."""
    spent: dict[str, list] = {method: [] for method in made[0][0]}
    gc.collect()
    gc.disable()
    for block in range(blocks):
        methods, loads = made[block % len(made)]
        start = AT_ONCE * (block // len(made))
        own = [np.ascontiguousarray(loads[(start + i) % len(loads)]) for i in range(AT_ONCE)]
        for method, solve in methods.items():
            spent[method].append(taken(solve, own))
        bar.update()
    gc.enable()
    first = next(iter(spent))
    base, rows = np.median(spent[first], axis=1), []
    for method, each in spent.items():
        every = np.concatenate(each)
        rows.append(
            {
                "case": name,
                "method": method,
                "calls": len(every),
                "median_us": f"{np.median(every):.2f}",
                "p99_us": f"{np.percentile(every, 99):.2f}",
                f"over_{first}": f"{np.median(np.median(each, axis=1) / base):.2f}",
            }
        )
    return rows


def problems_of(case, friction, limited: bool, multiple: float | None) -> list:
    """Problems of a grasp, each under a load of its own."""
    base = replace(case.base, friction=friction, torques=case.base.torques if limited else None)
    found = []
    for load in case.loads[:REGIME_LOADS]:
        problem = base.with_load(load)
        if multiple is not None:
            largest = pg.forces.load_factor(problem, impact_time=forces.IMPACT_TIME)
            if largest is None or not np.isfinite(largest):
                continue
            problem = base.with_load(multiple * largest * load)
        found.append(problem)
    return found


def solvers_of(problem, objective: str, solver) -> dict:
    """Name -> a function without arguments that solves the problem; ``solver``: of the same grasp and objective."""
    prepared, k = solver.prepared, problem.k
    active = np.empty(3 * k + (0 if problem.torques is None else len(problem.torques.limit)), dtype=bool)
    multipliers, numbers = np.empty(6 + len(active) - 3 * k), np.empty(6 + 4 * k)

    def core():
        if not prepared._prepared.solve(problem.load, numbers, active)[0]:
            prepared._prepared.prove(problem.load, multipliers, numbers, active)

    socp = forces_socp(problem, objective)
    found = {
        "ours": lambda: solver.solve(problem.load),
        "core": core,
        "clarabel": lambda: clarabel.DefaultSolver(*socp).solve(),
    }
    if problem.friction.polyhedral:
        qp = forces_qp(problem, objective)
        found["daqp"] = lambda: daqp.solve(*qp)
    return found


def forces_socp(problem, objective: str) -> tuple:
    """Clarabel's arguments."""
    socp = pg.forces.to_socp(problem, forces.IMPACT_TIME, objective=objective)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    upper = sp.csc_matrix(sp.triu(socp.P))
    return upper, np.array(socp.q), socp.A, np.array(socp.b), socp.cones.clarabel(), settings


def forces_qp(problem, objective: str) -> tuple:
    """DAQP's arguments."""
    qp = pg.forces.to_qp(problem, forces.IMPACT_TIME, objective=objective)
    upper = np.concatenate([qp.ub, qp.h, qp.b])
    lower = np.concatenate([qp.lb, np.full(len(qp.h), -np.inf), qp.b])
    sense = np.zeros(len(upper), dtype=np.intc)
    sense[-len(qp.b) :] = 5  # equations
    rows = np.ascontiguousarray(np.concatenate([qp.G, qp.A]))
    return np.array(qp.P), np.array(qp.q), rows, np.minimum(upper, 1e30), np.maximum(lower, -1e30), sense


def regime(name: str, cases: list) -> dict:
    """A row of the table."""
    friction, limited, objective, multiple = REGIMES[name]
    spent: dict[str, list] = {}
    answered = []
    for case in cases:
        problems = problems_of(case, friction, limited, multiple)
        for problem in problems:
            solver = pg.ForceSolver(problems[0], forces.IMPACT_TIME, objective=objective)
            answered.append(solver.solve(problem.load).status)
            for method, solve in solvers_of(problem, objective, solver).items():
                spent.setdefault(method, []).extend(processor_time(solve) for _ in range(REGIME_CALLS))
    expected = pg.Status.INFEASIBLE if multiple is not None and multiple > 1 else pg.Status.OK
    row = {"regime": name, "contacts": cases[0].base.k, "problems": len(answered)}
    row["right"] = sum(status is expected for status in answered)
    for method in ("ours", "core", "daqp", "clarabel"):
        own = spent.get(method)
        row[f"{method}_median_us"] = f"{np.median(own):.1f}" if own else ""
        row[f"{method}_p99_us"] = f"{np.percentile(own, 99):.0f}" if own else ""
    row["fastest"] = min((method for method in spent if method != "core"), key=lambda method: np.median(spent[method]))
    return row


def processor_time(solve) -> float:
    """Microseconds of this thread's."""
    before = time.thread_time_ns()
    solve()
    return 1e-3 * (time.thread_time_ns() - before)


def regimes(contacts: list[int]) -> None:
    rows = []
    with tqdm(total=len(contacts) * len(REGIMES), unit="regime") as bar:
        for k in contacts:
            rng = np.random.default_rng([forces.SEED, k])
            cases = [forces.grasp(rng, k) for _ in range(GRASPS if k < 50 else GRASPS // 2)]
            for name in REGIMES:
                rows.append(regime(name, cases))
                bar.update()
    print(table(rows))
    write_rows(HERE / "regimes.csv", header(("numpy", "clarabel", "daqp")), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--contacts", type=int, nargs="+")
    parser.add_argument("--blocks", type=int, default=40)
    parser.add_argument("--regimes", action="store_true", help="the table of regimes instead")
    options = parser.parse_args()
    if options.regimes:
        regimes(options.contacts or [3, 5, 15, 50])
        return
    options.contacts = options.contacts or [3, 15, 50]
    rows = []
    with tqdm(total=options.blocks * (2 * len(options.contacts) + 2), unit="block") as bar:
        for k in options.contacts:
            rng = np.random.default_rng([forces.SEED, k])
            cases = [forces.grasp(rng, k) for _ in range(GRASPS)]
            for model in ("cone", "pyramid"):
                made = [(methods_of(case, model), case.loads) for case in cases]
                rows += compared(f"{k} contacts, {model}", made, options.blocks, bar)
        rng = np.random.default_rng([forces.SEED, 3])
        plan = pg.load_case("paper", AS_PUBLISHED).plan()
        loads = plan.problem.load * rng.uniform(0.8, 1.2, (1000, 6))
        made = [(multipliers_of(plan.problem, plan.forces.normal_forces), loads)]
        rows += compared("the paper's 3 contacts", made, options.blocks, bar)
        made = []
        for case in [forces.grasp(rng, 3) for _ in range(GRASPS)]:
            problem = replace(case.base, friction=pg.Friction(), torques=None)
            made.append((multipliers_of(problem, np.full(problem.k, 2.0)), case.loads))
        rows += compared("3 contacts, unbalanced", made, options.blocks, bar)
    ratios = list(dict.fromkeys(name for row in rows for name in row if name.startswith("over_")))
    for name in ratios:
        print(table([row for row in rows if name in row]), end="\n\n")
    write_rows(
        HERE / "native.csv",
        header(("numpy", "clarabel", "daqp")),
        rows,
    )


if __name__ == "__main__":
    main()
