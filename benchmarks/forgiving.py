"""How far an object may be from where a plan has it: plans carried out on misplaced objects, in simulation.

    python benchmarks/forgiving.py --seed 7 [--hands NAME ...] [--objects box ...] [--errors 12] [--json out.json]

Hands of the catalogue, or files (with ``--root`` for one of these), and the objects of ``grasps.py``, planned as
standing on a table (``table=True``). Each plan that is ok is carried out with the object displaced and turned: on a
table, where it stands freely, in a random direction of its plane and about its normal; fixed until t_F, in any
direction; and held by nothing but the hand from the touch on.
``soft`` are the simulation's own servos, which forgive while the hand closes and then hold the joints where they are;
``stiff`` has the gains that hold from the start. ``none`` of the errors is the plan as it is. ``inside``: errors up to
the tolerance that the plan tells (the share is uniform), ``twice``: of twice that. Counts of what was held, with 95 %
intervals over all pairs. Writes forgiving.csv beside this file.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from grasps import MU, SHAPES, name_of, thing, width
from joblib import Parallel, delayed
from results import header, table, write_rows
from scipy.stats import binomtest
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Servo

HERE = Path(__file__).resolve().parent
# Support, displacement [m] and turn [deg]; the first has no error, and is tried once.
KINDS = {
    "none": ("table", 0.0, 0.0),
    "table_5mm_5deg": ("table", 0.005, 5.0),
    "table_10mm_10deg": ("table", 0.01, 10.0),
    "table_20mm_10deg": ("table", 0.02, 10.0),
    "fixed_5mm": ("fixed", 0.005, 0.0),
    "air_5mm": ("none", 0.005, 0.0),
    "inside": ("table", 0.0, 0.0),
    "twice": ("table", 0.0, 0.0),
}
TOLD = {"inside": 1.0, "twice": 2.0}  # of the told tolerance
SERVOS = ("stiff", "soft")
HOLD, STEP = 0.6, 5e-4


def draw(support: str, away: float, turn: float, rng: np.random.Generator) -> Disturbance:
    """An error of that size, in a random direction: in the table's plane, where the object stands on one."""
    if support == "table":
        angle, side = rng.uniform(0.0, 2 * np.pi), rng.choice([-1.0, 1.0])
        offset, axis = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, side])
    else:
        offset, axis = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
    return Disturbance(object_offset=away * offset, object_turn=np.radians(turn) * axis)


def is_held(plan: pg.GraspPlan, support: str, servo: Servo | None, disturbance: Disturbance) -> bool:
    settings = {"support": support, "servo": servo, "hold": HOLD, "time_step": STEP}
    try:
        return bool(pg.simulate(plan, disturbance=disturbance, **settings).verdict.held)
    except PinograspError:  # diverged
        return False


def row(source: str, root: str | None, shape: str, errors: int, kinds: list[str], servos: list[str], seed: int) -> dict:
    """Of one hand and one object, how many of its errors were forgiven: ``held/tried``."""
    found: dict = dict.fromkeys(("hand", "object", "mass_g", "status", "fingers", "told_mm", "seconds"), "")
    name = name_of(source)
    found |= {"hand": name, "object": shape}
    found |= {f"{kind}_{servo}": "" for kind in kinds for servo in servos} | {"why": ""}
    hand = pg.load_hand(source, root=root)
    body, conditions = thing(shape, width(hand)), pg.GraspConditions(mu=MU, table=True)
    found["mass_g"], started = f"{1e3 * body.mass:.0f}", time.perf_counter()
    try:
        search = pg.find_grasps(hand, body, conditions, count=16, seed=seed, jobs=1, progress=False)
        plan = plan_best(search, conditions, progress=False)
    except PinograspError as error:
        return found | {"status": type(error).__name__, "why": " ".join(str(error).split())[:200]}
    found |= {"status": str(plan.status), "seconds": f"{time.perf_counter() - started:.1f}"}
    found["fingers"] = len({touch.finger for touch in plan.closure.touches if touch.finger in set(plan.layout.fingers)})
    if plan.status != "ok":
        return found
    told = plan.with_tolerance().tolerance
    found["told_mm"] = f"{1e3 * told.distance:.1f}"
    place = [*name.encode(), SHAPES.index(shape)]
    for kind in kinds:
        support, away, turn = KINDS[kind]
        rng = np.random.default_rng([seed, *place, list(KINDS).index(kind)])
        if kind in TOLD:
            shares = rng.uniform(size=errors) if kind == "inside" else np.ones(errors)
            sizes = TOLD[kind] * shares * told.distance
            drawn = [
                draw(support, size, np.degrees(size / told.asked_distance * told.asked_angle), rng) for size in sizes
            ]
        else:
            drawn = [draw(support, away, turn, rng) for _ in range(errors if away else 1)]
        for servo in servos:
            own = Servo.of(hand) if servo == "stiff" else None
            held = sum(is_held(plan, support, own, one) for one in drawn)
            found[f"{kind}_{servo}"] = f"{held}/{len(drawn)}"
    return found


def totals(rows: list[dict], kinds: list[str], servos: list[str]) -> Iterator[dict]:
    """Of all pairs together, kind by kind."""
    for kind in kinds:
        one: dict = {"errors": kind}
        for servo in servos:
            cells = [own[f"{kind}_{servo}"].split("/") for own in rows if own[f"{kind}_{servo}"]]
            held, tried = (sum(int(cell[i]) for cell in cells) for i in range(2))
            low, high = binomtest(held, max(tried, 1)).proportion_ci(0.95, method="wilson")
            share = f"{100 * held / max(tried, 1):.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"
            one |= {servo: f"{held} of {tried}", f"{servo} kept": share}
        yield one


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--hands", nargs="+", default=list(CATALOGUE), help="names of the catalogue, or files")
    parser.add_argument("--root", help="link where the hand begins, of files with an arm")
    parser.add_argument("--objects", nargs="+", default=list(SHAPES), choices=SHAPES)
    parser.add_argument("--errors", type=int, default=12, help="of each kind")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--servos", nargs="+", default=list(SERVOS), choices=SERVOS)
    parser.add_argument("--jobs", type=int, default=-1, help="pairs at the same time; -1: all cores")
    parser.add_argument("--json", type=Path, help="the rows and the totals, besides")
    parser.add_argument("--out", type=Path, default=HERE / "forgiving.csv")
    options = parser.parse_args()
    pairs = [(hand, shape) for hand in options.hands for shape in options.objects]
    given = options.errors, options.kinds, options.servos, options.seed
    work = (delayed(row)(hand, options.root, shape, *given) for hand, shape in pairs)
    rows: list[dict] = []
    first = header(
        ("numpy", "pin", "coal", "mujoco-core"), f"{options.errors} errors of a kind", f"seed {options.seed}"
    )
    for one in tqdm(Parallel(options.jobs, return_as="generator")(work), total=len(pairs), unit="pair"):
        rows.append(one)
        write_rows(options.out, first, rows)
    every = list(totals(rows, options.kinds, options.servos))
    planned = sum(one["status"] == "ok" for one in rows)
    print(f"{planned} of {len(rows)} plans ok\n\n{table(every)}")
    if options.json:
        options.json.write_text(json.dumps({"about": first, "rows": rows, "totals": every}, indent=1))


if __name__ == "__main__":
    main()
