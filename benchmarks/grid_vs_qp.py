"""The three searches side by side on the case study, over grid sizes, and brute force as long as it finishes.

    python benchmarks/grid_vs_qp.py [--budget SECONDS]

Writes grid_vs_qp.csv and grid_vs_qp.png beside this file. Times are medians and 99th percentiles of repeated calls in
this one process; brute force runs once. Memory is the peak of Python and numpy allocations during one extra call.
Known limitations: one machine, one case; brute force is vectorised numpy, not compiled.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from results import header, table, write_rows

from pinograsp.cases import load_case
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.forces import GridSpec, grid_search

HERE = Path(__file__).resolve().parent
# (number of A-values, number of k-values); the net-force limit widens on coarse grids, or nothing passes there.
SIZES = [
    (6, 3, 2.0),
    (8, 4, 1.5),
    (10, 5, 1.0),
    (12, 5, 1.0),
    (16, 7, 0.6),
    (30, 11, 0.3),
    (60, 21, 0.1),
    (199, 21, 0.1),
]
SEARCHES = [
    ("brute", "paper", "brute"),
    ("paper", "paper", "pruned"),
    ("paper+qp", "paper+qp", "pruned"),
    ("hybrid", "hybrid", "pruned"),
]
POINTS_PER_SECOND = 2e7  # rough, only to skip brute-force runs that would exceed the budget


def measure(problem, grid, search, method, repeats):
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        found = grid_search(problem, grid, search=search, method=method, progress=False)
        times.append(time.perf_counter() - started)
    tracemalloc.start()
    if method != "brute":
        grid_search(problem, grid, search=search, method=method, progress=False)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found, np.median(times), np.percentile(times, 99), peak


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--budget", type=float, default=120.0, help="longest brute-force run attempted [s]")
    budget = parser.parse_args().budget
    case = load_case("paper", AS_PUBLISHED)
    problem = case.make_problem(case.load_hand())
    first_line = header(("numpy", "pin", "qpsolvers", "daqp"))
    rows = []
    for n_A, n_k, limit in SIZES:
        grid = GridSpec(
            accelerations=np.linspace(0.01, 1, n_A), multipliers=np.linspace(-1, 1, n_k), residual_limit=limit
        )
        results = {}
        for name, search, method in SEARCHES:
            if method == "brute" and grid.points(problem.k) / POINTS_PER_SECOND > budget:
                continue
            found, median, p99, peak = measure(problem, grid, search, method, 1 if method == "brute" else 11)
            results[name] = (found, median)
            rows.append(
                {
                    "search": name,
                    "A_values": n_A,
                    "k_values": n_k,
                    "residual_limit_N": limit,
                    "points": f"{grid.points(problem.k):.3e}",
                    "status": str(found.status),
                    "median_s": f"{median:.6f}",
                    "p99_s": f"{p99:.6f}",
                    "peak_MB": "" if method == "brute" else f"{peak / 1e6:.1f}",
                    "impulse_Ns": f"{found.impulse:.6f}" if found.found else "",
                    "work_mJ": f"{1e3 * found.work:.4f}" if found.found else "",
                    "residual_N": f"{found.residual_norm:.3e}" if found.found else "",
                    "same_as_brute": "",
                    "brute_over_this": "",
                }
            )
        if "brute" in results:
            brute, pruned = results["brute"][0], results["paper"][0]
            same = brute.status is pruned.status and np.array_equal(brute.acceleration, pruned.acceleration)
            same = same and np.array_equal(brute.multipliers, pruned.multipliers)
            ratio = results["brute"][1] / results["paper"][1]
            row = next(r for r in reversed(rows) if r["search"] == "paper")
            row["same_as_brute"], row["brute_over_this"] = str(bool(same)), f"{ratio:.0f}"
    write_rows(HERE / "grid_vs_qp.csv", first_line, rows)
    figure = Figure(figsize=(10, 4), layout="constrained")
    speed, quality = figure.subplots(1, 2)
    for (name, *_), marker in zip(SEARCHES, "osx^"):
        own = [r for r in rows if r["search"] == name]
        speed.loglog([float(r["points"]) for r in own], [float(r["median_s"]) for r in own], marker + "-", label=name)
        ok = [r for r in own if r["residual_N"]]
        quality.loglog([float(r["points"]) for r in ok], [float(r["residual_N"]) for r in ok], marker + "-", label=name)
    speed.set(xlabel="grid points", ylabel="time [s]")
    quality.set(xlabel="grid points", ylabel="net force left [N]")
    for axes in (speed, quality):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(HERE / "grid_vs_qp.png", dpi=110)
    print(table(rows))


if __name__ == "__main__":
    main()
