"""Random objects, loads and friction in every hand of the catalogue: does what the planner says come true in
simulation?

    python benchmarks/random_cases.py [--count 100] [--seed 0] [--hands NAME ...] [--kinds feasible infeasible]

The hands take turns. Drawn are a cylinder, a box or a sphere of its size (see grasps.py; 0.6 to 1.1 of it), friction
from 0.4 to 0.9, and the direction of gravity.

- feasible with reserve: a mass of 0.3 to 3 times that of the object at 300 kg/m^3; the hand searches a grasp of 16
  samples and plans it, as the package chooses, with its default reserve. Simulated as planned, and once more with a
  mass (up to 20 % more or less), a friction (down to 0.8) and a push (up to half of the weight, in any direction) that
  are drawn from what the reserve says it bears.
- infeasible by 10 % or more: motors bear at most 0.2 N m or 8 N, soft fingers with 5 mm of torsional friction, no
  reserve; the planner's own largest load is 0.5 to 0.9 of the object's weight. The hand does the best it can: it is
  planned for 0.98 of the largest load, and simulated with the real one. Where a link without a contact is nearer than
  5 mm the object may come to rest on it within what counts as held, which the planner does not speak of: these are
  counted by themselves, and so are plans with a remark (warnings, or a motion that cannot follow the forces).

Draws without a placement or without feasible forces, and of the first kind those without a plan that is ok, are drawn
again, at most 40 times; how often is told. ``--count`` of both kinds. Writes random_cases.csv beside this file as the
cases come; what is there already, for the same seed and hands, is not run again."""

from __future__ import annotations

import argparse
import csv
import functools
import time
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
from grasps import DENSITY, objects, width
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.contacts.clearance import HandPart
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import NoGrasp, PinograspError, Status
from pinograsp.forces import load_factor
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.planner import plan_best
from pinograsp.simulation import Disturbance, Push
from pinograsp.spatial import rotation_rpy
from pinograsp.synthesis import find_grasps

HERE = Path(__file__).resolve().parent
COLUMNS = (
    "case",
    "kind",
    "hand",
    "object",
    "size",
    "mu",
    "contacts",
    "mass_g",
    "margin",
    "near_mm",
    "status",
    "remark",
    "verdict",
    "expected",
    "disturbed",
    "disturbance",
    "drift_mm",
    "turn_deg",
    "force_error",
    "unplanned",
    "saturated",
    "reason",
    "tries",
    "seconds",
)
LIMITS = {"turning": 0.2, "sliding": 8.0}
SETTINGS = {"support": "fixed", "time_step": 5e-4}  # of simulations
IMPACT = 0.9
NEAR = 5e-3  # [m] what an object may move and still count as held
_ANY_DEPTH = 0.02  # [m] what is called infeasible must be so for friction and motors, not for a limit of the plan's own
SAMPLES, PLACEMENTS, MOST_TRIES = 16, 3, 40
MASSES = (0.3, 3.0)
KINDS = ("feasible", "infeasible")


@functools.lru_cache(maxsize=8)
def loaded(name: str):
    hand = pg.load_hand(name, hulls=True)
    slides = np.array([hand.is_prismatic(hand.model.getJointId(joint)) for joint in hand.joint_names])
    limit = np.where(slides, LIMITS["sliding"], LIMITS["turning"])
    return hand, width(hand), np.minimum(limit, hand.effort_or_infinity)


def draw(rng, name: str) -> dict:
    """One draw: what the hand is to hold; without a mass."""
    shape, size, mu = str(rng.choice(["cylinder", "box", "sphere"])), rng.uniform(0.6, 1.1), rng.uniform(0.4, 0.9)
    turn = rotation_rpy(*rng.uniform(-np.pi, np.pi, 3))
    return {
        "hand": name,
        "object": shape,
        "size": size,
        "mu": mu,
        "gravity": turn @ [0.0, 0.0, -9.81],
        "seed": int(rng.integers(2**31)),
    }


def attempt(kind: str, name: str, rng) -> dict | None:
    """A case of a kind for a hand, planned and simulated; None where the draw gives none."""
    case = draw(rng, name)
    hand, w, limit = loaded(case["hand"])
    body = objects(case["size"] * w)[case["object"]]
    if kind == "feasible":
        heavy = replace(body, mass=body.mass * float(np.exp(rng.uniform(*np.log(MASSES)))), density=None)
        return with_reserve(case, hand, heavy, rng)
    body, target = replace(body, density=DENSITY, mass=None), rng.uniform(0.5, 0.9)
    asked = without_reserve(case, limit)
    search = find_grasps(hand, body, asked, count=6, seed=case["seed"], jobs=1, progress=False)
    for placement in search.grasps[:PLACEMENTS]:
        found = too_heavy(case, target, placement, body, asked)
        if found is not None:
            return found
    return None


def with_reserve(case: dict, hand, body, rng) -> dict | None:
    asked = pg.GraspConditions(mu=case["mu"], gravity_o=case["gravity"])
    try:
        search = find_grasps(hand, body, asked, count=SAMPLES, seed=case["seed"], jobs=1, progress=False)
        plan = plan_best(search, asked, progress=False)
    except NoGrasp:
        return None
    if plan.status is not Status.OK:
        return None
    reserve, weight = pg.Reserve(), body.mass * 9.81
    towards = rng.normal(size=3)
    push = rng.uniform(0, reserve.disturbance) * weight * towards / np.linalg.norm(towards)
    within = Disturbance(
        mass_factor=rng.uniform(1 - reserve.mass, 1 + reserve.mass),
        mu=case["mu"] * rng.uniform(1 - reserve.friction, 1),
        pushes=Push(wrench_o=[*push, 0, 0, 0], start=0.2, duration=0.5),
    )
    verdict, disturbed = (pg.simulate(plan, disturbance=one, **SETTINGS) for one in (Disturbance(), within))
    said = f"mass x {within.mass_factor:.2f}, mu {within.mu:.2f}, push {1e3 * np.linalg.norm(push):.0f} mN"
    return row(case, "feasible", plan, body, verdict.verdict) | {
        "remark": "; ".join(plan.cautions),
        "disturbed": "held" if disturbed.verdict.held else "lost",
        "disturbance": said if disturbed.verdict.held else f"{said}: {disturbed.verdict.reason}",
    }


def without_reserve(case: dict, limit) -> pg.GraspConditions:
    return pg.GraspConditions(
        mu=case["mu"],
        friction=pg.Friction(model="soft", torsion=5e-3, safety=1.0),
        gravity_o=case["gravity"],
        max_depth=5e-3,
        impact_time_range=(IMPACT, IMPACT + 1e-4),
        torque_limit=limit,
        reserve=None,
    )


def too_heavy(case: dict, target: float, placement, body, asked: pg.GraspConditions) -> dict | None:
    closure = placement.closure
    mass = body.mass * placement.load_factor / target
    real = replace(body, mass=mass, density=None)
    planned_for = replace(body, mass=0.98 * target * mass, density=None)
    try:
        plan = pg.plan_grasp_on(
            closure.hand, replace(closure, object=planned_for), asked, pg.PlanOptions(objective="work")
        )
    except PinograspError:
        return None
    if plan.status not in (Status.OK, Status.NOT_TRACKED):
        return None
    remarks = [caution for caution in plan.cautions if "up to its limit" not in caution]
    remarks = [str(plan.status)] * (plan.status is not Status.OK) + remarks
    # The planner's word, at the posture that the plan ends in: how many times the real load can be held at all.
    problem = replace(plan.problem, max_depth=_ANY_DEPTH, object=None)
    margin = load_factor(problem, impact_time=IMPACT) * planned_for.mass / real.mass
    if margin > 0.9:
        return None
    heavier = Disturbance(mass_factor=real.mass / planned_for.mass)
    verdict = pg.simulate(plan, disturbance=heavier, **SETTINGS).verdict
    return row(case, "infeasible", plan, real, verdict) | {"margin": f"{margin:.3f}", "remark": "; ".join(remarks)}


def row(case: dict, kind: str, plan, body, verdict) -> dict:
    return {
        "kind": kind,
        "hand": case["hand"],
        "object": case["object"],
        "size": f"{case['size']:.2f}",
        "mu": f"{case['mu']:.3f}",
        "mass_g": f"{1e3 * body.mass:.1f}",
        "contacts": plan.problem.k,
        "near_mm": f"{1e3 * resting_place(plan):.1f}",
        "status": str(plan.status),
        "verdict": "held" if verdict.held else "lost",
        "expected": "yes" if verdict.held == (kind == "feasible") else "NO",
        "drift_mm": f"{1e3 * verdict.drift:.3f}",
        "turn_deg": f"{verdict.turn:.2f}",
        "force_error": f"{verdict.force_error:.3f}",
        "unplanned": " ".join(verdict.unplanned),
        "saturated": len(verdict.saturated),
        "reason": verdict.reason,
    }


def resting_place(plan) -> float:
    """How far the nearest link that is not to touch is from the object at the end of the grasp [m]."""
    hand, grasp = plan.hand, Penetration(plan.hand, plan.problem.object, plan.problem.contacts)
    distances, planned = grasp.distances, set(grasp.joints)
    distances.put(plan.motion.q[-1])
    parts = [HandPart(hand, one, {}) for one in hand.geometry.geometryObjects if one.parentJoint not in planned]
    return min((distances.rough(part) for part in parts), default=np.inf)


def run(seed: int, number: int, kind: str, name: str) -> dict:
    """Draws until there is a case of this kind for this hand."""
    rng, started = np.random.default_rng([seed, number]), time.perf_counter()
    for tries in range(1, MOST_TRIES + 1):
        try:
            found = attempt(kind, name, rng)
        except PinograspError as error:
            found = {
                "kind": kind,
                "hand": name,
                "verdict": type(error).__name__,
                "expected": "NO",
                "reason": str(error).splitlines()[0][:200],
            }
        if found is not None:
            return {"case": number, **found, "tries": tries, "seconds": f"{time.perf_counter() - started:.1f}"}
    seconds = f"{time.perf_counter() - started:.1f}"
    return {
        "case": number,
        "kind": kind,
        "hand": name,
        "verdict": "no case",
        "expected": "",
        "tries": MOST_TRIES,
        "seconds": seconds,
    }


def summary(rows: list[dict]) -> str:
    """The tables of the README: by what the planner says, and by hand."""
    tried = [row for row in rows if row["near_mm"]]
    ours = [row for row in tried if row["kind"] == "feasible"]
    said_rows, hands = [], []

    def say(said: str, own: list[dict], right: str, wider: str) -> None:
        line = {"the planner says": said, "cases": len(own), "as it says": right, "with 2 mm and 5 deg": wider}
        said_rows.append(line)

    for said, own in (
        ("feasible with reserve", ours),
        ("without a warning", [row for row in ours if not row["remark"]]),
    ):
        held, strictly = (sum(holds(row, *limits) for row in own) for limits in ((5.0, 10.0), (2.0, 5.0)))
        say(said, own, f"{held} held", f"{strictly} held")
        shaken = sum(row["disturbed"] == "held" for row in own)
        say(f"{said}, disturbed within the reserve", own, f"{shaken} held", "-")
    for where, remark in (("no link near", False), ("a link near", False), ("with a remark", True)):
        own = [row for row in tried if row["kind"] == "infeasible" and bool(row["remark"]) == remark]
        if not remark:
            own = [row for row in own if (float(row["near_mm"]) < 1e3 * NEAR) == (where == "a link near")]
        lost, strictly = (sum(not holds(row, *limits) for row in own) for limits in ((5.0, 10.0), (2.0, 5.0)))
        say(f"infeasible by 10 % or more, {where}", own, f"{lost} lost", f"{strictly} lost")
    for name in dict.fromkeys(row["hand"] for row in rows):
        own = [row for row in rows if row["hand"] == name]
        mine = [row for row in own if row["near_mm"] and row["kind"] == "feasible"]
        other = [row for row in own if row["near_mm"] and row["kind"] == "infeasible"]
        hands.append(
            {
                "hand": f"`{name}`",
                "with reserve: held": f"{sum(row['verdict'] == 'held' for row in mine)} of {len(mine)}",
                "disturbed: held": f"{sum(row['disturbed'] == 'held' for row in mine)} of {len(mine)}",
                "draws for a plan": sum(int(row["tries"]) for row in mine),
                "infeasible: lost": f"{sum(row['verdict'] == 'lost' for row in other)} of {len(other)}",
                "no case, error": sum(not row["near_mm"] for row in own),
            }
        )
    return f"{table(said_rows)}\n\n{table(hands)}"


def holds(row: dict, drift: float, turn: float) -> bool:
    """Whether the object stayed within so many millimetres and degrees; 5 and 10 are the verdict's own."""
    return row["verdict"] == "held" and float(row["drift_mm"]) <= drift and float(row["turn_deg"]) <= turn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=100, help="cases of each kind")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hands", nargs="+", default=sorted(CATALOGUE), help="only these")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: all cores")
    parser.add_argument("--out", type=Path, default=HERE / "random_cases.csv")
    options = parser.parse_args()
    some = [] if len(options.hands) == len(CATALOGUE) else options.hands
    first_line = header(("numpy", "pin", "coal", "mujoco-core", "daqp"), f"seed {options.seed}", *some)
    rows = []
    if options.out.exists():
        with options.out.open() as stream:
            if stream.readline().rstrip().partition("seed ")[2] == first_line.partition("seed ")[2]:
                rows = list(csv.DictReader(stream))
    done = {int(row["case"]) for row in rows}
    wanted = [
        (i, KINDS[i % 2], options.hands[i // 2 % len(options.hands)])
        for i in range(2 * options.count)
        if i not in done and KINDS[i % 2] in options.kinds
    ]
    import random_cases  # by its name, so that other processes keep the hands they have loaded

    work = (joblib.delayed(random_cases.run)(options.seed, *one) for one in wanted)
    for found in tqdm(
        joblib.Parallel(n_jobs=options.jobs, return_as="generator")(work), total=len(wanted), unit="case"
    ):
        rows.append({column: found.get(column, "") for column in COLUMNS})
        write_rows(options.out, first_line, sorted(rows, key=lambda one: int(one["case"])))
    print(summary(rows))
    if odd := [row for row in rows if row["expected"] != "yes"]:
        print("\n" + table([{key: value for key, value in row.items() if value} for row in odd]))


if __name__ == "__main__":
    main()
