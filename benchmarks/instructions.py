"""Instructions that a contact-force solve takes: a figure that does not depend on how fast or busy the machine is.

    python benchmarks/instructions.py [--contacts 15 50]

Counted by valgrind's cachegrind (which must be installed; Linux): the same program with few solves and with many, the
difference divided by the number of solves more, everything included that a call from Python costs. Problems as in
forces.py: seeded grasps, least squares, a new load at every call, cold starts. "online" is ``OnlineForces.step`` from
scratch; the others are the solvers' own interfaces on matrices that are ready. Valgrind knows no AVX-512: all run as on
a processor with AVX2. Writes instructions.csv beside this file. Takes about 4 minutes a line."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
METHODS = (("online", "cone"), ("clarabel", "cone"), ("online", "pyramid"), ("daqp", "pyramid"))
GRASPS, FEW, MANY = 5, 20, 1020
SETTINGS = {
    "PINOGRASP_CORE_LEVEL": "v3",
    "PYTHONHASHSEED": "0",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
}


def solves(method: str, model: str, case: dict) -> tuple:
    """A function of the load's number; nothing is imported that the method does not need."""
    if method == "online":
        import pinograsp as pg

        contacts = tuple(
            pg.contacts.Contact(finger=f"c{i}", link="", point_o=p, rotation_oc=R, length=None, distance=0.0)
            for i, (p, R) in enumerate(zip(case["points"], case["rotations"]))
        )
        friction = pg.Friction(model=model)
        made = pg.contacts.ContactSet(contacts=contacts, com_o=np.zeros(3))
        problem = pg.ForceProblem(
            contacts=made, load=case["loads"][0], mu=case["mu"], friction=friction, max_depth=5e-3
        )
        online, loads = pg.OnlineForces(problem, normal_forces=(case["lo"], case["hi"])), np.array(case["loads"])

        def solve(i):
            online.reset()
            online.step(loads[i])

        return solve
    arrays = [case[f"{method}_{i}"] for i in range(int(case[f"{method}_count"]))]
    if method == "daqp":
        import daqp

        H, f, rows, upper, lower, sense = arrays
        n, loads = len(f), case["scaled"]

        def solve(i):
            upper[n : n + 6] = lower[n : n + 6] = -loads[i]
            daqp.solve(H, f, rows, upper, lower, sense)

        return solve
    import clarabel
    from scipy.sparse import csc_matrix

    P, q, rows, h = arrays
    P, rows, loads, k = csc_matrix(P), csc_matrix(rows), case["scaled"], len(q) // 3
    cones = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(2 * k), *[clarabel.SecondOrderConeT(3)] * k]
    settings = clarabel.DefaultSettings()
    settings.verbose = False

    def solve(i):
        h[:6] = -loads[i]
        clarabel.DefaultSolver(P, q, rows, h, cones, settings).solve()

    return solve


def child(method: str, model: str, folder: Path, count: int) -> None:
    """Solves ``count`` problems, the grasps in turn."""
    made = []
    for path in sorted(folder.glob("*.npz")):
        case = {name: np.array(value) for name, value in np.load(path).items()}
        made.append((solves(method, model, case), len(case["loads"])))
    for j in range(count):
        solve, loads = made[j % len(made)]
        solve(j % loads)


def write_cases(folder: Path, contacts: int) -> None:
    from dataclasses import replace

    import forces

    import pinograsp as pg

    rng = np.random.default_rng([forces.SEED, contacts])
    for number in range(GRASPS):
        case = forces.grasp(rng, contacts)
        arrays = forces.arrays_of(replace(case, base=replace(case.base, torques=None)))
        case = replace(case, base=replace(case.base, torques=None, friction=pg.Friction()))
        daqp = forces.DaqpNative().fresh(case, case.loads[0])[2]
        P, q, rows, h, _ = forces.ClarabelNative("cone").fresh(case, case.loads[0])[2]
        saved = {f"daqp_{i}": value for i, value in enumerate(daqp)} | {"daqp_count": len(daqp), "clarabel_count": 4}
        saved |= {f"clarabel_{i}": value for i, value in enumerate((P.toarray(), q, rows.toarray(), h))}
        scaled = np.array([forces.scaled(load, arrays.arm) for load in case.loads])
        np.savez(
            folder / f"{number}.npz",
            points=case.points,
            rotations=case.rotations,
            mu=case.base.mu,
            lo=case.lo,
            hi=case.hi,
            loads=case.loads,
            scaled=scaled,
            **saved,
        )


def counted(arguments: list[str]) -> int:
    """Instructions of a run of this script."""
    command = [sys.executable, str(Path(__file__)), *arguments]
    environment = os.environ | SETTINGS
    tool = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
    told = subprocess.run([*tool, *command], check=True, env=environment, capture_output=True, text=True).stderr
    return int(re.search(r"I\s+refs:\s+([\d,]+)", told).group(1).replace(",", ""))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--contacts", type=int, nargs="+", default=[15, 50])
    parser.add_argument("--child", nargs=4, metavar=("METHOD", "MODEL", "FOLDER", "COUNT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        method, model, folder, count = options.child
        child(method, model, Path(folder), int(count))
        return
    from results import header, table, write_rows
    from tqdm import tqdm

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for contacts in options.contacts:
            write_cases(Path(folder), contacts)
            for method, model in tqdm(METHODS, desc=f"{contacts} contacts", unit="method"):
                few, many = (counted(["--child", method, model, folder, str(count)]) for count in (FEW, MANY))
                rows.append(
                    {
                        "contacts": contacts,
                        "friction": model,
                        "method": method,
                        "instructions": round((many - few) / (MANY - FEW)),
                    }
                )
    print(table(rows))
    write_rows(HERE / "instructions.csv", header(("numpy", "daqp", "clarabel"), "cachegrind", "AVX2"), rows)


if __name__ == "__main__":
    main()
