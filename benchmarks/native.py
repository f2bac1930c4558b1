"""The core beside Clarabel and DAQP, through the public Python interface, nothing warmed up by the caller.

    python benchmarks/native.py [--contacts 3 15 50] [--blocks 40]

Least squares on exact cones and pyramids: seeded grasps of forces.py, a new load at every call, cold starts. Methods
take turns in blocks of 50 calls, so that all meet the same machine; a ratio is that of a block to the core's block
before it, and the median of these is given. "step": ``OnlineForces.step`` without a hand, after ``reset()``, which is
in the time. "optimize_forces": with its full record, of ``problem.with_load(load)``, which is in the time, too; "same
load": of the problem itself. Clarabel and DAQP: their own interfaces on matrices that are ready, the load alone is set.
"multipliers": the QP at fixed normal forces in the box, of the paper's grasp (3 rows, which balance), and of the
seeded grasps under loads that nothing balances (6 rows). Writes native.csv beside this file."""

from __future__ import annotations

import argparse
import gc
import time
from dataclasses import replace
from pathlib import Path

import daqp
import forces
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.forces import MultiplierQP

HERE = Path(__file__).resolve().parent
GRASPS, AT_ONCE = 8, 50


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--contacts", type=int, nargs="+", default=[3, 15, 50])
    parser.add_argument("--blocks", type=int, default=40)
    options = parser.parse_args()
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
