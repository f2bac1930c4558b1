"""A hundred thousand force problems at once: this package on one and all cores, beside loops of DAQP and Clarabel.

    python benchmarks/batch.py [--count 100000] [--quick]

Different problems (seeded grasps of forces.py under random mixtures of their loads), all of one number of contacts,
whose contacts, friction and limits are ready as arrays. Times per problem, medians of three runs after compiling; the
loops solve every 500th, with hand-stacked matrices that are ready before the clock starts. "general": problems that
were left to the general methods. Writes batch.csv beside this file."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import forces as single
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg

HERE = Path(__file__).resolve().parent
CONTACTS = (3, 5, 10, 20)
MODELS = {"cone": pg.Friction(model="cone"), "pyramid": pg.Friction()}
OBJECTIVES = ("least_squares", "work")
GRASPS, EVERY, REPEATS = 50, 500, 3


def problems(k: int, count: int) -> tuple[list, np.ndarray, np.ndarray]:
    """Grasps, which of them each problem is of, and loads (count, 6) that all of them hold."""
    rng = np.random.default_rng([single.SEED, k])
    cases = [single.grasp(rng, k) for _ in range(GRASPS)]
    which = rng.integers(0, GRASPS, count)
    loads = np.array([case.loads for case in cases])
    one, other = rng.integers(0, loads.shape[1], (2, count))
    share = rng.random((count, 1))
    return cases, which, share * loads[which, one] + (1 - share) * loads[which, other]


def batch_of(cases, which, loads, friction) -> pg.ForceBatch:
    def each(values):
        return np.array([values(case) for case in cases])[which]

    return pg.ForceBatch(
        points=each(lambda c: c.points),
        rotations=each(lambda c: c.rotations),
        loads=loads,
        mu=each(lambda c: c.base.mu),
        low=each(lambda c: c.lo),
        high=each(lambda c: c.hi),
        moment_lengths=each(lambda c: c.base.moment_length),
        friction=friction,
        energies={"work": np.array(cases[0].base.energy_terms(single.IMPACT_TIME, "work"))},
    )


def looped(method, cases, which, loads, friction) -> float:
    """Median microseconds per problem of a method of forces.py."""
    known = [
        method.fresh(replace(case, base=replace(case.base, friction=friction, torques=None)), case.loads[0])
        for case in cases
    ]
    spent = []
    for i in range(0, len(loads), EVERY):
        started = time.perf_counter()
        method.solve(method.again(known[which[i]], loads[i]))
        spent.append(time.perf_counter() - started)
    return 1e6 * float(np.median(spent))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--quick", action="store_true", help="5,000 problems, nothing written")
    options = parser.parse_args()
    count, rows = 5_000 if options.quick else options.count, []
    for k in tqdm(CONTACTS, unit="size"):
        cases, which, loads = problems(k, count)
        for name, friction in MODELS.items():
            batch = batch_of(cases, which, loads, friction)
            for objective in OBJECTIVES:
                row = {"contacts": k, "friction": name, "objective": objective, "problems": count}
                for threads, column in ((None, "all_cores"), (1, "one_core")):
                    pg.solve_batch(batch, objective=objective, threads=threads)
                    found = [pg.solve_batch(batch, objective=objective, threads=threads) for _ in range(REPEATS)]
                    row[f"{column}_us"] = f"{1e6 * np.median([one.elapsed for one in found]) / count:.2f}"
                    row[f"{column}_s"] = f"{np.median([one.elapsed for one in found]):.2f}"
                row |= {"ok": int(found[-1].ok.sum()), "general": found[-1].general}
                if objective == "least_squares":
                    row["clarabel_loop_us"] = (
                        f"{looped(single.ClarabelNative(name), cases, which, loads, friction):.0f}"
                    )
                    if name == "pyramid":
                        row["daqp_loop_us"] = f"{looped(single.DaqpNative(), cases, which, loads, friction):.0f}"
                rows.append(row)
    print(table(rows))
    if not options.quick:
        write_rows(
            HERE / "batch.csv",
            header(("numpy", "clarabel", "daqp")),
            rows,
        )


if __name__ == "__main__":
    main()
