"""How long one waits for a first grasp, its plan and a simulated second: one process, and as many as there are cores.

    python benchmarks/waits.py --seed 7 [--repeats 5] [--pairs g1_left/cylinder ...]

Objects are those of ``grasps.py``. Every run is a process of its own, which has imported the package and loaded the
hand; runs with ``jobs=1`` and ``jobs=-1`` take turns, each with its own seed. ``search_s`` is ``find_grasps`` with 16
samples, ``plan_s`` is ``plan_best``, ``second_s`` what ``simulate`` takes for a simulated second of the plan;
``command_s`` and ``command_cpu_s`` are ``pinograsp plan paper`` into a new folder, with bytecode, as installed
packages have it; ``imports_cpu_s`` is the processor time of importing numpy, scipy, matplotlib and pinocchio, and
``first_s`` the time of Python's first plan, imports included. Medians and largest values. Writes waits.csv beside this
file.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from results import header, table, write_rows

HERE = Path(__file__).resolve().parent
PAIRS = ("g1_left/cylinder", "allegro_left/mug", "panda/box", "psyonic_left/sphere", "talos_left/cylinder")
IMPORTS = "import numpy, scipy.optimize, scipy.spatial, matplotlib.figure, pinocchio"
FIRST = "import pinograsp as pg; pg.load_case('paper').plan()"
ONE = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
import pinograsp as pg
from grasps import thing, width
name, shape, seed, jobs = sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
hand = pg.load_hand(name)
body, conditions = thing(shape, width(hand)), pg.GraspConditions(mu=0.6)
started = time.perf_counter()
found = pg.find_grasps(hand, body, conditions, count=16, seed=seed, jobs=jobs, progress=False)
between = time.perf_counter()
plan, second = None, float("nan")
try:
    plan = pg.plan_best(found, conditions, progress=False)
    status = str(plan.status)
except pg.PinograspError as error:
    status = type(error).__name__
planned = time.perf_counter()
if plan is not None:
    seen = pg.simulate(plan)
    second = seen.elapsed / seen.times[-1]
print(json.dumps({"search_s": between - started, "plan_s": planned - between, "second_s": second, "status": status}))
"""


def run(pair: str, seed: int, jobs: int) -> dict:
    """One search and its plan, in a process of its own."""
    name, shape = pair.split("/")
    done = subprocess.run(
        [sys.executable, "-c", ONE, str(HERE), name, shape, str(seed), str(jobs)], capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def measure(bytecode: str, *command: str) -> tuple[float, float]:
    """Time and processor time of Python with these arguments [s]; ``bytecode``: the folder where it is kept."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before, started = os.times(), time.perf_counter()
    subprocess.run(
        [sys.executable, *command],
        check=True,
        capture_output=True,
        env=environment | {"PYTHONPYCACHEPREFIX": bytecode},
    )
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - started, used


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--pairs", nargs="+", default=PAIRS)
    options = parser.parse_args()
    rows = []
    for pair in options.pairs:
        found: dict[int, list[dict]] = {1: [], -1: []}
        for i in range(options.repeats):
            for jobs in found:
                found[jobs].append(run(pair, options.seed + i, jobs))
        for jobs, runs in found.items():
            row = {"what": pair, "jobs": jobs}
            for name in ("search_s", "plan_s", "second_s"):
                own = [one[name] for one in runs]
                row |= {name: f"{np.nanmedian(own):.2f}", f"{name[:-2]}_most_s": f"{np.nanmax(own):.2f}"}
            rows.append(row | {"ok": f"{sum(one['status'] == 'ok' for one in runs)} of {len(runs)}"})
    with tempfile.TemporaryDirectory() as folder:
        taken: dict[str, list[tuple[float, float]]] = {"command": [], "imports": [], "first": []}
        for i in range(options.repeats + 1):
            taken["command"].append(
                measure(f"{folder}/bytecode", "-m", "pinograsp.cli", "plan", "paper", "--out", f"{folder}/{i}")
            )
            taken["imports"].append(measure(f"{folder}/bytecode", "-c", IMPORTS))
            taken["first"].append(measure(f"{folder}/bytecode", "-c", FIRST))
    # The first ones compile.
    (wall, cpu), (_, own), (first, _) = (np.median(one[1:], axis=0) for one in taken.values())
    rows.append(
        {
            "what": "plan paper",
            "command_s": f"{wall:.2f}",
            "command_cpu_s": f"{cpu:.2f}",
            "imports_cpu_s": f"{own:.2f}",
            "first_s": f"{first:.2f}",
        }
    )
    notes = f"seed {options.seed}", f"{options.repeats} repeats"
    write_rows(HERE / "waits.csv", header(("numpy", "scipy", "pin", "coal"), *notes), rows)
    print(table(rows))


if __name__ == "__main__":
    main()
