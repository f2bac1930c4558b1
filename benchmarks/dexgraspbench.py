"""Grasps of DexGraspBench as commanded: does the second verdict agree with the benchmark's own evaluation?

    python benchmarks/dexgraspbench.py CHECKOUT --outcomes outcomes.csv [--grasps output/example_shadow/graspdata]

CHECKOUT: JYChen18/DexGraspBench with the meshes of its hand, which you fetch. ``outcomes.csv`` has the lines ``file,1``
or ``file,0`` of your own run of its evaluation (succeeded or not), files relative to the folder of grasps. Prints how
many verdicts agree, what is missed, what is too much, and grasps a second.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import time
from pathlib import Path

import numpy as np

import pinograsp as pg
from pinograsp.certification import PROTOCOLS
from pinograsp.sweep import DataSet, certify_files


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--outcomes", type=Path, required=True)
    parser.add_argument("--grasps", type=Path, default=Path("output/example_shadow/graspdata"))
    parser.add_argument("--hand", type=Path, default=Path("assets/hand/shadow/right_hand.xml"))
    parser.add_argument("--convention", help="of files whose joints do not tell the hand: allegro_mjcf, leap_mjcf")
    parser.add_argument("--jobs", type=int, default=-1)
    args = parser.parse_args()
    with args.outcomes.open(newline="", encoding="utf-8") as lines:
        rows = [row[:2] for row in csv.reader(lines)]
    outcomes = {file: outcome == "1" for file, outcome in rows if outcome in ("0", "1")}
    folder, protocol = args.checkout / args.grasps, PROTOCOLS["dexgraspbench"]
    data = DataSet(
        files=[folder / file for file in outcomes],
        hand=pg.load_hand(args.checkout / args.hand),
        objects=args.checkout,
        mass=protocol.mass,
        convention=args.convention,
    )
    with tempfile.TemporaryDirectory() as out:
        started = time.perf_counter()
        done = certify_files(data, Path(out) / "rows", protocol.conditions(), protocol=protocol, jobs=args.jobs)
        elapsed, table = time.perf_counter() - started, done.table()
    succeeded = np.array([outcomes[os.path.relpath(file, folder)] for file in table["file"].to_pylist()])
    print(
        f"{len(succeeded)} grasps, {succeeded.sum()} succeed in the benchmark; {len(succeeded) / elapsed:.0f} a second"
    )
    for name in ("held_as_commanded", "possible"):
        told = np.array([bool(one) for one in table[name].to_pylist()])
        print(
            f"{name}: {told.sum()}; agrees on {(told == succeeded).sum()} ({(told == succeeded).mean():.1%}), misses "
            f"{(succeeded & ~told).sum()} of {succeeded.sum()}, too many {(told & ~succeeded).sum()} of "
            f"{(~succeeded).sum()}"
        )
    for file, fault in done.faults.items():
        print(f"not used: {file}: {fault}")


if __name__ == "__main__":
    main()
