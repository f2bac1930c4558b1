"""Sweeps of thousands of plans on one process and on two.

    python benchmarks/sweep.py [--repeats 3] [--quick]

The paper's case under seeded friction and mass: "grid" with the hybrid search, "convex" with the certified one, both
with one posture and steps of 10 ms, so that plans are short and what a sweep adds to them weighs most; "paper" as it
comes, with all postures and steps of 1 ms; "forces": contact forces alone. Per repeat the sweep runs on one and on two
warm processes, one after the other; the ratio is taken within the repeat, and the medians are written. "loop" is
load_case(...).plan().summary() of a hundred of the same plans in a bare loop, "ideal" how much faster two warm
processes do half of them each. "cold" is the first sweep, the start of two processes included. NumPy's own threads are
off. Writes sweep.csv beside this file."""

from __future__ import annotations

import os

os.environ |= {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}  # before NumPy: processes, not threads, are compared

import argparse
import contextlib
import tempfile
import time
from pathlib import Path

import joblib
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

from pinograsp.cases import load_case
from pinograsp.errors import NoGrasp
from pinograsp.sweep import load_sweep, sweep

HERE = Path(__file__).resolve().parent
LIGHT = {"motion.samples": 1, "motion.time_step": 0.01}
DRAWS = {"seed": 0, "friction.mu": {"uniform": [0.5, 1.0]}, "object.mass": {"uniform": [0.5, 1.1]}}
# What is swept, its fixed inputs, and how many rows.
SWEEPS = {
    "grid": ("plan", {"forces.search": "hybrid", **LIGHT}, 2000),
    "convex": ("plan", {"forces.search": "convex", **LIGHT}, 500),
    "paper": ("plan", {"forces.search": "convex"}, 60),
    "forces": ("forces", {"impact_time": 0.9, "forces.balance": "wrench", "friction.model": "cone"}, 20_000),
}
BARE = 100  # plans of a bare loop


def timed(spec: dict, jobs: int) -> float:
    """Seconds of a sweep into a new folder."""
    with tempfile.TemporaryDirectory() as folder:
        done = sweep(spec, Path(folder) / "out", jobs=jobs, progress=False)
        assert done.done == done.rows and not done.interrupted
        return done.elapsed


def bare(fixed: dict, inputs: list[dict]) -> float:
    """Seconds of plans in a loop, as one would write it without a sweep."""
    started = time.perf_counter()
    for one in inputs:
        with contextlib.suppress(NoGrasp):  # it takes its time as well
            load_case("paper", {**fixed, **one}).plan(progress=False).summary()
    return time.perf_counter() - started


def twice(fixed: dict, inputs: list[dict]) -> float:
    """Seconds of the same on two processes, half each."""
    started = time.perf_counter()
    joblib.Parallel(n_jobs=2)(joblib.delayed(bare)(fixed, half) for half in (inputs[::2], inputs[1::2]))
    return time.perf_counter() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=SWEEPS, action="append")
    parser.add_argument("--quick", action="store_true", help="a tenth of the rows, once, nothing written")
    options = parser.parse_args()
    rows, repeats = [], 1 if options.quick else options.repeats
    for name in tqdm(options.only or SWEEPS, unit="sweep"):
        what, fixed, count = SWEEPS[name]
        count = count // 10 if options.quick else count
        spec = {"case": "paper", "what": what, "set": fixed, "samples": {"count": count, **DRAWS}}
        few = {**spec, "samples": {**spec["samples"], "count": 20}}
        cold = timed(few, 2)
        timed(few, 1)
        found, loops = [], []
        loaded = load_sweep(spec)
        inputs = [loaded.row(i) for i in range(min(count, BARE))]
        for _ in range(repeats):
            found.append((timed(spec, 1), timed(spec, 2)))
            if what == "plan":
                bare(fixed, inputs[:1])
                twice(fixed, inputs[:2])
                loops.append((bare(fixed, inputs), twice(fixed, inputs)))
        one, two = np.array(found).T
        row = {
            "sweep": name,
            "rows": count,
            "one_process_s": f"{np.median(one):.1f}",
            "two_processes_s": f"{np.median(two):.1f}",
            "speed_up": f"{np.median(one / two):.2f}",
            "least": f"{(one / two).min():.2f}",
            "most": f"{(one / two).max():.2f}",
            "one_process_ms_per_row": f"{1e3 * np.median(one) / count:.2f}",
            "cold_20_rows_s": f"{cold:.1f}",
            "loop_ms_per_row": "",
            "ideal_speed_up": "",
        }
        if loops:
            alone, both = np.array(loops).T
            row |= {
                "loop_ms_per_row": f"{1e3 * np.median(alone) / len(inputs):.2f}",
                "ideal_speed_up": f"{np.median(alone / both):.2f}",
            }
        rows.append(row)
    print(table(rows))
    if not options.quick:
        load = f"load {os.getloadavg()[0]:.1f} at the end"
        write_rows(HERE / "sweep.csv", header(("numpy", "pin", "joblib", "pyarrow"), load), rows)


if __name__ == "__main__":
    main()
