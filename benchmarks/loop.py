"""A controller's tick in C++ and from Python: the paper's grasp, Pinocchio's Jacobians given.

    python benchmarks/loop.py [--ticks 1000000]

The same grasp, loads and settings: "C++" is loop.cpp with the header that ``plan.to_core`` writes, compiled here for
this machine, the posture another at every tick; "Python" is ``OnlineForces.step(load)``, "Python, posture" is
``step(load, q=q)`` with Pinocchio in it. Every tick is timed by itself, warm, without torque limits; microseconds.
Writes loop.csv beside this file."""

from __future__ import annotations

import argparse
import gc
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.core import get_include

HERE = Path(__file__).resolve().parent
POSTURES, MOVES = 200, 0.02  # [rad] about the plan's
FLAGS = ("-std=c++17", "-O3", "-DNDEBUG", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")


def in_cpp(plan, postures, ticks: int) -> dict:
    """A row: the program is made in a folder of its own."""
    model = plan.hand.model.copy()
    model.gravity.linear = np.array(plan.gravity_o)
    data = model.createData()
    numbers = []
    for q in postures:
        J = pin.computeJointJacobians(model, data, q)
        numbers.append(np.concatenate([J.T.ravel(), pin.computeGeneralizedGravity(model, data, q)]))
    with tempfile.TemporaryDirectory() as folder:
        plan.to_core(Path(folder) / "grasp.hpp", max_rate=1e4)
        np.array(numbers).tofile(Path(folder) / "postures.bin")
        command = ["c++", *FLAGS, f"-I{get_include()}", f"-I{folder}", str(HERE / "loop.cpp"), "-o", "loop"]
        subprocess.run(command, cwd=folder, check=True)
        told = subprocess.run(["./loop", str(ticks)], cwd=folder, check=True, capture_output=True, text=True).stdout
    median, p99, p999, worst, held, steps = told.split()
    return {
        "loop": "C++",
        "ticks": ticks,
        "median_us": median,
        "p99_us": p99,
        "p99_9_us": p999,
        "worst_us": worst,
        "held": held,
        "newton_steps_mean": steps,
    }


def in_python(plan, postures, ticks: int, *, moving: bool) -> dict:
    """A row."""
    online = pg.OnlineForces(plan.problem, hand=plan.hand, q=plan.motion.q[-1], max_rate=1e4)
    at = np.arange(ticks)
    share = 1.0 + 0.2 * np.sin(0.01 * at) + 0.1 * np.sin(0.0237 * at)
    spent, held, steps, clock = np.empty(ticks), 0, 0, time.perf_counter
    for start in tqdm(range(0, ticks, 10_000), desc="Python", unit="10^4 ticks", leave=False):
        loads = share[start : start + 10_000, None] * plan.problem.load
        gc.collect()
        gc.disable()
        for i, load in enumerate(loads):
            q = postures[i % POSTURES] if moving else None
            before = clock()
            status = online.step(load, q=q)[2]
            spent[start + i] = clock() - before
            held += status is pg.Status.OK
            steps += online.steps
        gc.enable()
    median, p99, p999, worst = 1e6 * np.percentile(spent, [50, 99, 99.9, 100])
    return {
        "loop": "Python, posture" if moving else "Python",
        "ticks": ticks,
        "median_us": f"{median:.3f}",
        "p99_us": f"{p99:.3f}",
        "p99_9_us": f"{p999:.3f}",
        "worst_us": f"{worst:.3f}",
        "held": held,
        "newton_steps_mean": f"{steps / ticks:.3f}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--ticks", type=int, default=1_000_000)
    options = parser.parse_args()
    plan = pg.load_case("paper", {"forces.search": "convex", "friction.model": "cone"}).plan()
    rng = np.random.default_rng(0)
    postures = plan.motion.q[-1] + MOVES * rng.uniform(-1, 1, (POSTURES, plan.hand.n))
    rows = [
        in_cpp(plan, postures, options.ticks),
        *(in_python(plan, postures, options.ticks, moving=moving) for moving in (False, True)),
    ]
    print(table(rows))
    write_rows(HERE / "loop.csv", header(("numpy", "pin"), "seed 0"), rows)


if __name__ == "__main__":
    main()
