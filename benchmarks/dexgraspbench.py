"""DexGraspBench, both ways: do our verdicts agree with its evaluation, and do our plans succeed in it?

    python benchmarks/dexgraspbench.py CHECKOUT agree --outcomes outcomes.csv [--grasps output/example_shadow/graspdata]
    python benchmarks/dexgraspbench.py CHECKOUT plan --hand shadow --seeds 1 2 3
    python benchmarks/dexgraspbench.py CHECKOUT table --hand shadow

CHECKOUT: JYChen18/DexGraspBench with the meshes of its hands, which you fetch. ``agree``: ``outcomes.csv`` has the
lines ``file,1`` or ``file,0`` of your own run of its evaluation, files relative to the folder of grasps. ``plan`` plans
for its five example objects at four scales, and writes the grasps into ``CHECKOUT/output/pinograsp_HAND/graspdata``;
there its own evaluation finds them (``python src/main.py task=eval hand=HAND exp_name=pinograsp``), and ``table``
counts what it said, beside the example grasps of the repository where these were evaluated, too.
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
from pinograsp.errors import PinograspError
from pinograsp.handover import write_dexgraspbench
from pinograsp.objects.lookup import object_in
from pinograsp.sweep import DataSet, certify_files

SCALES = (0.06, 0.08, 0.10, 0.12)
NAME = "pinograsp"


def agree(args: argparse.Namespace) -> None:
    """How many verdicts agree, what is missed, what is too much, and grasps a second."""
    with args.outcomes.open(newline="", encoding="utf-8") as lines:
        rows = [row[:2] for row in csv.reader(lines)]
    outcomes = {file: outcome == "1" for file, outcome in rows if outcome in ("0", "1")}
    folder, protocol = args.checkout / args.grasps, PROTOCOLS["dexgraspbench"]
    data = DataSet(
        files=[folder / file for file in outcomes],
        hand=hand_of(args),
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


def plan(args: argparse.Namespace) -> None:
    """Plan every object at every scale with every seed, and write what came of it."""
    os.chdir(args.checkout)
    hand, protocol = hand_of(args), PROTOCOLS["dexgraspbench"]
    conditions = pg.GraspConditions(mu=protocol.mu, reserve=pg.Reserve(disturbance=args.reserve))
    folder = Path("output") / f"{NAME}_{args.hand}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "plans.csv").open("w", newline="", encoding="utf-8") as lines:
        table = csv.writer(lines)
        table.writerow(["object", "scale", "seed", "status", "seconds", "message"])
        times, good = [], 0
        for seed in args.seeds:
            for path in sorted(Path("assets/example_object").iterdir()):
                for scale in SCALES:
                    body = object_in(Path(), str(path), scale=scale, mass=protocol.mass)
                    started, message = time.perf_counter(), ""
                    try:
                        found = pg.find_grasps(
                            hand, body, conditions, count=args.count, seed=seed, jobs=args.jobs, progress=False
                        )
                        done = pg.plan_best(found, conditions)
                        status = str(done.status)
                    except PinograspError as error:
                        status, message = type(error).__name__, str(error).splitlines()[0]
                    else:
                        write_dexgraspbench(done, folder / "graspdata", str(path), scale=scale, name=str(seed))
                    times.append(time.perf_counter() - started)
                    good += status == "ok"
                    table.writerow([path.name, scale, seed, status, f"{times[-1]:.2f}", message])
                    lines.flush()
    median, slow = np.quantile(times, [0.5, 0.99])
    print(f"{args.hand}: {good} of {len(times)} planned ok; median {median:.1f} s, 99 % {slow:.1f} s")
    print(f"next, in {args.checkout}: python src/main.py task=eval hand={args.hand} exp_name={NAME}")


def table(args: argparse.Namespace) -> None:
    """What the benchmark's evaluation said, of our plans and of the repository's examples."""
    print("| grasps | evaluated | succeed |\n|---|---|---|")
    for title, name in (("planned here", f"{NAME}_{args.hand}"), ("example grasps", f"example_{args.hand}")):
        files = sorted((args.checkout / "output" / name / "evaluation").rglob("*.npy"))
        if not files:
            print(f"| {title} | none | |")
            continue
        held = [bool(np.load(file, allow_pickle=True).item()["succ_flag"]) for file in files]  # the checkout's own
        print(f"| {title} | {len(held)} | {sum(held)} ({np.mean(held):.1%}) |")


def hand_of(args: argparse.Namespace) -> pg.HandModel:
    return pg.load_hand(Path(args.checkout).resolve() / "assets/hand" / args.hand / "right_hand.xml", trusted=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=lambda text: Path(text).resolve())
    commands = parser.add_subparsers(required=True)
    for function in (agree, plan, table):
        one = commands.add_parser(function.__name__, help=function.__doc__)
        one.set_defaults(run=function)
        one.add_argument("--hand", default="shadow", help="shadow, allegro or leap")
        one.add_argument("--jobs", type=int, default=-1)
        if function is agree:
            one.add_argument("--outcomes", type=Path, required=True)
            one.add_argument("--grasps", type=Path, default=Path("output/example_shadow/graspdata"))
            one.add_argument("--convention", help="of files whose joints do not tell the hand: allegro_mjcf, leap_mjcf")
        if function is plan:
            one.add_argument("--seeds", type=int, nargs="+", required=True)
            one.add_argument("--count", type=int, default=16, help="samples of a search")
            one.add_argument("--reserve", type=float, default=1.0, help="pushes, in weights: the evaluation's own")
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
