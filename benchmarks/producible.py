"""What it costs to plan the forces that a hand really makes, beside those that any hand could make.

    python benchmarks/producible.py [--repeats 50]

The 16 contacts on 20 joints of ``online.py``, four to a finger on a cylinder, cones, with torque limits. The hand has a
motor at every joint, or one tendon per finger over its last three joints: two equations on the torques of each finger.
Timed in turn, so that both sides meet the same machine: the certified optimum over the impact times
(``optimize_grasp``), and the squeeze that bears the default reserve (``search_reserve``). Writes producible.csv beside
this file.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from online import many_contacts
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.forces import optimize_grasp, search_reserve
from pinograsp.hands import Drive

HERE = Path(__file__).resolve().parent
LIMIT = 3.0  # [N m]


def with_tendons(hand: pg.HandModel) -> pg.HandModel:
    """One tendon over the last three joints of every finger, thinner and thinner pulleys; motors at the others."""
    drives = []
    for finger in hand.fingers:
        names = [hand.joint_names[dof] for dof in finger.dofs]
        drives += [Drive(name=name, joints=(name,), arms=(1.0,)) for name in names[:-3]]
        drives.append(Drive(name=f"{finger.name} tendon", joints=tuple(names[-3:]), arms=(0.010, 0.008, 0.006)))
    return hand.with_drives(drives)


def in_turn(calls: dict, repeats: int) -> dict[str, np.ndarray]:
    """Seconds of each call (repeats,), one after the other in every round."""
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            spent[name].append(time.perf_counter() - started)
    return {name: np.array(times) for name, times in spent.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--out", type=Path, default=HERE / "producible.csv")
    options = parser.parse_args()
    hand, q, problem, _ = many_contacts()
    free, tied = (
        replace(problem, torques=pg.torque_limits(one, problem.contacts, q, limit=LIMIT))
        for one in (hand, with_tendons(hand))
    )
    reserve = pg.Reserve()
    calls = {
        "optimum, any torques": lambda: optimize_grasp(free, progress=False),
        "optimum, tendons": lambda: optimize_grasp(tied, progress=False),
        "reserve, any torques": lambda: search_reserve(free, reserve),
        "reserve, tendons": lambda: search_reserve(tied, reserve),
    }
    spent = in_turn(calls, options.repeats)
    found = []
    for name, times in spent.items():
        base = spent[name.split(",")[0] + ", any torques"]
        found.append(
            {
                "search": name,
                "contacts": problem.k,
                "joints": hand.n,
                "status": str(calls[name]().status),
                "median_ms": f"{1e3 * np.median(times):.2f}",
                "p99_ms": f"{1e3 * np.percentile(times, 99):.2f}",
                "times_the_unrestricted": f"{np.median(times) / np.median(base):.2f}",
            }
        )
    print(table(found))
    write_rows(options.out, header(("numpy", "pin", "daqp", "clarabel"), f"{options.repeats} in turn"), found)


if __name__ == "__main__":
    main()
