"""Random objects, loads and friction in every hand of the catalogue: does what the planner says come true in
simulation?

    python benchmarks/random_cases.py [--count 100] [--seed 0] [--hands NAME ...]

The hands take turns (convex hulls of their meshes, as the engine takes them). Drawn are a cylinder, a box or a sphere
of its size (see grasps.py; 0.6 to 1.1 of it), friction from 0.4 to 0.9, and the direction of gravity; motors bear
at most 0.2 N m or 8 N. The hand is placed and closed; exact friction cones with torsional friction of 5 mm. Then the
object's mass is drawn so that the planner's own largest load stands in a random ratio to its weight:

- feasible by 10 % or more: from 1.1 to 2.5. The plan has the larger friction safety of 1.5 and 1.3 that is feasible,
  because contacts roll by some tenths of a millimetre as they press, which the planner's forces do not know.
- infeasible by 10 % or more: from 0.5 to 0.9. The hand does the best it can: it is planned for 0.98 of the largest
  load, and simulated with the real one, motors at their limits. Where a link without a contact is nearer than 5 mm the
  object may come to rest on it within what counts as held, which the planner does not speak of: these are counted by
  themselves.

Plans with a remark (cautions, or a motion that cannot follow the forces) are counted by themselves: there the planner
says that its promise does not cover them. Only draws without a placement, without feasible forces, or with a motion
beyond a joint limit are drawn again, at most 40 times.

Each is simulated (1 s of hold) and held or lost. ``--count`` of both kinds. Writes random_cases.csv beside this file as
the cases come; what is there already, for the same seed and hands, is not run again."""

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
from results import header, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.contacts.clearance import HandPart
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import PinograspError, Status
from pinograsp.forces import load_factor
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.referee import Disturbance
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
    "safety",
    "near_mm",
    "status",
    "remark",
    "verdict",
    "expected",
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
IMPACT = 0.9
SAFETIES = (1.5, 1.3)
NEAR = 5e-3  # [m] what an object may move and still count as held
_ANY_DEPTH = 0.02  # [m] what is called infeasible must be so for friction and motors, not for a limit of the plan's own
PLACEMENTS, MOST_TRIES = 3, 40


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


def conditions(case: dict, safety: float, limit) -> pg.GraspConditions:
    return pg.GraspConditions(
        mu=case["mu"],
        friction=pg.Friction(model="soft", torsion=5e-3, safety=safety),
        gravity_o=case["gravity"],
        max_depth=5e-3,
        impact_time_range=(IMPACT, IMPACT + 1e-4),
        torque_limit=limit,
        reserve=None,
    )


def attempt(kind: str, name: str, rng) -> dict | None:
    """A case of a kind for a hand, planned and simulated; None where the draw gives none."""
    case = draw(rng, name)
    target = rng.uniform(1.1, 2.5) if kind == "feasible" else rng.uniform(0.5, 0.9)
    hand, w, limit = loaded(case["hand"])
    body = objects(case["size"] * w)[case["object"]]
    body = replace(body, density=DENSITY, mass=None)
    asked = conditions(case, 1.0, limit)
    search = find_grasps(hand, body, asked, count=6, seed=case["seed"], jobs=1, progress=False)
    if not search.grasps:
        return None
    for placement in search.grasps[:PLACEMENTS]:
        found = attempt_at(case, kind, target, placement, body, limit)
        if found is not None:
            return found
    return None


def attempt_at(case: dict, kind: str, target: float, placement, body, limit) -> dict | None:
    closure = placement.closure
    mass = body.mass * placement.load_factor / target
    real = replace(body, mass=mass, density=None)
    planned_for = real if kind == "feasible" else replace(body, mass=0.98 * target * mass, density=None)
    held = conditions(case, SAFETIES[-1], limit).problem(planned_for, closure.contacts())
    if kind == "feasible" and pg.optimize_forces(held, IMPACT).status is not Status.OK:
        return None
    for safety in SAFETIES if kind == "feasible" else (1.0,):
        try:
            plan = pg.plan_grasp_on(
                closure.hand,
                replace(closure, object=planned_for),
                conditions(case, safety, limit),
                objective="work",
            )
        except PinograspError:
            continue
        break
    else:
        return None
    if plan.status not in (Status.OK, Status.NOT_TRACKED):
        return None
    remarks = [caution for caution in plan.cautions if "up to its limit" not in caution]
    remarks = [str(plan.status)] * (plan.status is not Status.OK) + remarks
    # The planner's word, at the posture that the plan ends in: how many times the real load can be held at all.
    problem = replace(
        plan.problem, friction=replace(plan.problem.friction, safety=1.0), max_depth=_ANY_DEPTH, object=None
    )
    largest = load_factor(problem, impact_time=IMPACT)
    margin = largest * planned_for.mass / real.mass
    if (kind == "feasible") != (margin >= 1.1) or (kind == "infeasible") != (margin <= 0.9):
        return None
    verdict = pg.simulate(
        plan, disturbance=Disturbance(mass_factor=real.mass / planned_for.mass), time_step=5e-4
    ).verdict
    return {
        "kind": kind,
        "hand": case["hand"],
        "object": case["object"],
        "size": f"{case['size']:.2f}",
        "mu": f"{case['mu']:.3f}",
        "mass_g": f"{1e3 * mass:.1f}",
        "contacts": plan.problem.k,
        "margin": f"{margin:.3f}",
        "safety": safety,
        "near_mm": f"{1e3 * resting_place(plan):.1f}",
        "status": str(plan.status),
        "remark": "; ".join(remarks),
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
    lines = ["| the planner says | cases | as it says | with 2 mm and 5 deg |", "| --- | --- | --- | --- |"]
    tried = [row for row in rows if row["near_mm"]]
    for kind, word, where, remark in (
        ("feasible", "held", "", False),
        ("feasible", "held", "", True),
        ("infeasible", "lost", "no link near", False),
        ("infeasible", "lost", "a link near", False),
        ("infeasible", "lost", "", True),
    ):
        own = [row for row in tried if row["kind"] == kind and bool(row["remark"]) == remark]
        if where:
            own = [row for row in own if (float(row["near_mm"]) < 1e3 * NEAR) == (where == "a link near")]
        right, strict = (
            sum(holds(row, *limits) == (kind == "feasible") for row in own) for limits in ((5.0, 10.0), (2.0, 5.0))
        )
        said = f"{kind} by 10 % or more" + (f", {where}" if where else "") + (", with a remark" if remark else "")
        lines.append(f"| {said} | {len(own)} | {right} {word} | {strict} {word} |")
    lines += [
        "",
        "| hand | feasible: held | with a remark: held | infeasible: lost | no case, error |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in dict.fromkeys(row["hand"] for row in rows):
        own = [row for row in rows if row["hand"] == name]
        cells = []
        for kind, remarks in (("feasible", (False,)), ("feasible", (True,)), ("infeasible", (False, True))):
            some = [row for row in own if row["kind"] == kind and row["near_mm"] and bool(row["remark"]) in remarks]
            cells.append(
                f"{sum((row['verdict'] == 'held') == (kind == 'feasible') for row in some)} of {len(some)}"
                if some
                else "-"
            )
        cells.append(str(sum(not row["near_mm"] for row in own)))
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def holds(row: dict, drift: float, turn: float) -> bool:
    """Whether the object stayed within so many millimetres and degrees; 5 and 10 are the verdict's own."""
    return row["verdict"] == "held" and float(row["drift_mm"]) <= drift and float(row["turn_deg"]) <= turn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=100, help="cases of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hands", nargs="+", default=sorted(CATALOGUE), help="only these")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: all cores")
    parser.add_argument("--out", type=Path, default=HERE / "random_cases.csv")
    options = parser.parse_args()
    some = [] if len(options.hands) == len(CATALOGUE) else options.hands
    first_line = header(("numpy", "pin", "coal", "mujoco", "daqp"), f"seed {options.seed}", *some)
    rows = []
    if options.out.exists():
        with options.out.open() as stream:
            if stream.readline().rstrip().partition("seed ")[2] == first_line.partition("seed ")[2]:
                rows = list(csv.DictReader(stream))
    done = {int(row["case"]) for row in rows}
    wanted = [
        (i, ("feasible", "infeasible")[i % 2], options.hands[i // 2 % len(options.hands)])
        for i in range(2 * options.count)
        if i not in done
    ]
    import random_cases  # by its name, so that other processes keep the hands they have loaded

    work = (joblib.delayed(random_cases.run)(options.seed, *one) for one in wanted)
    for found in tqdm(
        joblib.Parallel(n_jobs=options.jobs, return_as="generator")(work), total=len(wanted), unit="case"
    ):
        rows.append({column: found.get(column, "") for column in COLUMNS})
        write_rows(options.out, first_line, sorted(rows, key=lambda one: int(one["case"])))
    print(summary(rows))
    for row in rows:
        if row["expected"] != "yes":
            print({key: value for key, value in row.items() if value})


if __name__ == "__main__":
    main()
