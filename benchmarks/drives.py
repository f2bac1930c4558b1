"""Drives that make 0.7 to 1.3 times what they are told, late, on contacts 1/5 to 20 times as stiff: which plans hold.

    python benchmarks/drives.py --seed 7 [--hands NAME ...] [--trials 10]

Each hand takes a box (50 x 50 x 120 mm, 300 g), a ball (70 mm, 180 g) and a can (60 x 120 mm, 350 g) from one search,
and plans them with the default reserve, with ``drive=0.3`` besides, and with ``drive=0.3, softer=5, stiffer=20``; no
contact may be pressed with more than 2.5 times the largest force of the default reserve's plan. Each plan that is
``ok`` is simulated with MuJoCo: all drives at 0.7, all at 1.3, then each at its own, drawn evenly; commands that arrive
66 ms late; the stiffness of the contacts drawn evenly in its logarithm; friction at 0.8 of the plan's, shaken with
2 m/s^2 at 2 Hz. Servos and support are the simulation's own: from the touch on nothing but the hand holds the object.
Friction is 0.6. Writes drives.csv beside this file: plans, plans that are ok, trials, those that held, those whose
largest force stayed under the cap from the touch to the end, the squeeze over that of the default reserve, and the
time of a plan; half a minute to two minutes for a hand and an object.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.simulation import Disturbance

SETTINGS = {"hold": 0.5, "sample": 2e-3}
HERE = Path(__file__).resolve().parent
MU, SHARE, DELAY, CAP = 0.6, 0.3, 0.066, 2.5
RESERVES = {
    "default": pg.Reserve(),
    "drive=0.3": pg.Reserve(drive=SHARE),
    "drive=0.3, softer=5, stiffer=20": pg.Reserve(drive=SHARE, softer=5.0, stiffer=20.0),
}
BODIES = {
    "box": pg.Box(size=(0.05, 0.05, 0.12), mass=0.3),
    "ball": pg.Sphere(radius=0.035, mass=0.18),
    "can": pg.Cylinder(radius=0.03, height=0.12, mass=0.35),
}


def draw_trials(rng: np.random.Generator, n: int, count: int) -> list[Disturbance]:
    """Differences from the plan of a hand with ``n`` joints."""
    gains = [np.full(n, 1 - SHARE), np.full(n, 1 + SHARE)]
    gains += [rng.uniform(1 - SHARE, 1 + SHARE, n) for _ in range(count - len(gains))]
    stiffness = np.exp(rng.uniform(np.log(0.2), np.log(20.0), len(gains)))
    other = {"shake": (2.0, 0.0, 0.0), "shake_frequency": 2.0, "mu": 0.8 * MU, "command_delay": DELAY}
    return [Disturbance(drive_gain=one, stiffness=float(k), **other) for one, k in zip(gains, stiffness)]


def find_excess(plan: pg.GraspPlan, seen: pg.Simulation, cap: float) -> float:
    """The largest force of a part of the hand over its contacts' caps [-]."""
    links = plan.contacts.links
    count = [1 if part in plan.contacts.names else max(1, links.count(part)) for part in seen.parts]
    return float((seen.normal_forces.max(axis=0) / np.array(count)).max() / cap)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--hands", nargs="+", default=["allegro_right", "psyonic_right", "panda", "g1_right"])
    parser.add_argument("--trials", type=int, default=10)
    args = parser.parse_args()
    rng, rows = np.random.default_rng(args.seed), list[dict[str, object]]()
    first = header(
        ["pin", "mujoco-core", "numpy", "clarabel", "pinograsp"], f"seed {args.seed}", f"{args.trials} trials"
    )
    work = [(hand, name) for hand in args.hands for name in BODIES]
    for hand_name, name in tqdm(work):
        hand, conditions = pg.load_hand(hand_name), pg.GraspConditions(mu=MU)
        found = pg.find_grasps(hand, BODIES[name], conditions, count=16, seed=args.seed, progress=False)
        trials, default, cap = draw_trials(rng, hand.n, args.trials), np.nan, None
        for text, reserve in RESERVES.items():
            started = time.perf_counter()
            row: dict[str, object] = {"hand": hand_name, "object": name, "reserve": text, "ok": False}
            try:
                plan = pg.plan_best(found, replace(conditions, reserve=reserve, max_normal_force=cap))
            except PinograspError as error:
                rows.append({**row, "refused": str(error).splitlines()[0]})
                continue
            took, squeeze = time.perf_counter() - started, float(plan.forces.normal_forces.sum())
            if cap is None:
                default, cap = squeeze, CAP * float(plan.forces.normal_forces.max())
            row |= {"ok": plan.status is pg.Status.OK, "plan_s": round(took, 2), "price": squeeze / default}
            seen = [pg.simulate(plan, disturbance=one, **SETTINGS) for one in trials if row["ok"]]
            held = sum(one.verdict.held for one in seen)
            kept = sum(find_excess(plan, one, cap) <= 1.0 for one in seen)
            rows.append({**row, "cap": cap, "trials": len(seen), "held": held, "under_cap": kept})
        write_rows(HERE / "drives.csv", first, rows)
    print(first)
    print(table([_summarize(text, [row for row in rows if row["reserve"] == text]) for text in RESERVES]))


def _summarize(text: str, rows: list[dict[str, object]]) -> dict[str, object]:
    good = [row for row in rows if row["ok"]]
    trials, held = (sum(int(str(row[name])) for row in good) for name in ("trials", "held"))
    return {
        "reserve": text,
        "plans": len(rows),
        "ok": len(good),
        "trials": trials,
        "held": held,
        "under cap": sum(int(str(row["under_cap"])) for row in good),
        "share": f"{100 * held / max(trials, 1):.0f} %",
        "squeeze": f"{np.median([float(str(row['price'])) for row in good]):.2f}" if good else "",
        "plan [s]": f"{np.median([float(str(row['plan_s'])) for row in good]):.1f}" if good else "",
    }


if __name__ == "__main__":
    main()
