"""Plans beside the grasp that nobody optimised, at the same payload, both tried in simulation; and the case study in
all ways.

    python benchmarks/unoptimized.py [--cases 10]

The un-optimised grasp closes all joints straight on, in the same share of their ways, past the first touch, with the
joints moved as commanded (the paper's MSC.Adams set-up). Its energy is that of the least overclosing with which the
simulated object stays within 0.5 mm after it was let go; where none does, within 5 mm. The optimised one is the
cheapest of the plans with friction safety 1.05, 1.1, 1.2, 1.3, 1.5 and 2 (exact cones, least work, wrench balance) that
does the same, played by servos. Grasp energies by Eq. (9), as simulated, in mJ. Objects and placements: as grasps.py
(seeded), hulls of meshes; the object weighs an eighth of what could be held there. Hands that close with one actuator
have nothing to optimise and are left out. For the paper's hand the ratio is taken for several drift limits and friction
models, since it depends on both. Writes unoptimized_paper.csv and unoptimized.csv and prints the tables of the README.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from grasps import DENSITY, objects, width
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.simulation.naive import naive_grasp
from pinograsp.simulation.task import Task
from pinograsp.synthesis import find_grasps

HERE = Path(__file__).resolve().parent
WITHIN = 5e-4  # [m] of drift
TRIAL = {"time_step": 5e-4, "hold": 0.5}
LOADED = 1 / 8  # of what the placement could hold at most
SAFETIES = (1.05, 1.1, 1.2, 1.3, 1.5, 2.0)
CASES = [
    ("humanoid", "sphere"),
    ("allegro_right", "sphere"),
    ("allegro_right", "cylinder"),
    ("allegro_left", "sphere"),
    ("allegro_left", "cylinder"),
    ("hey5", "sphere"),
    ("hey5", "cylinder"),
    ("g1_left", "cylinder"),
    ("g1_right", "sphere"),
    ("psyonic_left", "sphere"),
]
PAPER = {
    "forces.search": "convex",
    "forces.balance": "wrench",
    "forces.measure": "work",
    "motion.touch": "surface",
    "friction.model": "cone",
}


def optimised(plan_with, within: float) -> tuple[float | None, object]:
    """The cheapest plan that holds within the drift: its safety and its simulation."""
    for safety in SAFETIES:
        try:
            plan = plan_with(safety)
            simulation = pg.simulate(plan, **TRIAL)
        except PinograspError:
            continue
        if simulation.verdict.held and simulation.verdict.drift <= within:
            return safety, (plan, simulation)
    return None, None


def compared(name: str, shape: str, mass: float, plan_with, within: float = WITHIN) -> dict:
    started = time.perf_counter()
    safety, found = optimised(plan_with, within)
    row = {"hand": name, "object": shape, "mass_g": f"{1e3 * mass:.0f}"}
    plan = found[0] if found else plan_with(1.5)
    naive = naive_grasp(Task.of(plan), drift=within, **TRIAL)
    if naive.overclosing is None:
        naive = naive_grasp(Task.of(plan), **TRIAL)
    ours = 1e3 * found[1].grasp_energy if found else None
    theirs = None if naive.overclosing is None else 1e3 * naive.grasp_energy
    return row | {
        "safety": safety or "",
        "planned_mJ": f"{1e3 * plan.forces.work:.3f}" if found else "",
        "optimised_mJ": f"{ours:.3f}" if found else "",
        "optimised_drift_mm": f"{1e3 * found[1].verdict.drift:.3f}" if found else "",
        "unoptimised_mJ": "" if theirs is None else f"{theirs:.3f}",
        "unoptimised_drift_mm": "" if theirs is None else f"{1e3 * naive.simulation.verdict.drift:.3f}",
        "overclosing": "none holds" if theirs is None else f"{naive.overclosing:.4f}",
        "ratio": f"{theirs / ours:.2f}" if found and theirs else "",
        "seconds": f"{time.perf_counter() - started:.0f}",
    }


def paper() -> list[dict]:
    """The paper's hand, for several drift limits and friction models: what is asked for decides the ratio."""
    rows = []
    for friction in (
        {"friction.model": "cone"},
        {"friction.model": "pyramid"},
        {"friction.model": "soft", "friction.torsion_mm": 5.0},
    ):
        for within in (2e-4, WITHIN, 1e-3, 5e-3):

            def planned(safety, friction=friction):
                return pg.load_case("paper", PAPER | friction | {"friction.safety": safety}).plan()

            name = f"humanoid (the paper's), {friction['friction.model']}, {1e3 * within:g} mm"
            rows.append(compared(name, "cylinder", 1.02, planned, within))
    return rows


def catalogue(name: str, shape: str) -> dict:
    hand = pg.load_hand(name, hulls=True)
    body = replace(objects(0.9 * width(hand))[shape], density=DENSITY, mass=None)
    conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone"), reserve=None)
    best = find_grasps(hand, body, conditions, count=16, seed=0, progress=False).best
    body = replace(body, mass=LOADED * best.load_factor * body.mass, density=None)
    closure = replace(best.closure, object=body)

    def plan_with(safety: float):
        friction = pg.Friction(model="cone", safety=safety)
        return pg.plan_grasp_on(
            closure.hand, closure, replace(conditions, friction=friction), pg.PlanOptions(objective="work")
        )

    return compared(name, shape, body.mass, plan_with)


def case_study() -> list[dict]:
    """The paper's case in wrench and in force balance, and by other steps and ways of letting go."""
    rows = []
    plans = {
        balance: pg.load_case(
            "paper", PAPER | {"forces.balance": balance, "friction.model": "pyramid", "friction.safety": 1.1}
        ).plan()
        for balance in ("wrench", "force")
    }
    for balance, what, settings in (
        ("wrench", "10 s", {"hold": 10.0}),
        ("wrench", "half the step", {"time_step": 1.25e-4}),
        ("wrench", "let go at once", {"letting_go": 0.0}),
        ("wrench", "joints as commanded", {"mode": "prescribed"}),
        ("force", "10 s", {"hold": 10.0}),
    ):
        simulation = pg.simulate(plans[balance], **settings)
        v = simulation.verdict
        rows.append(
            {
                "balance": balance,
                "how": what,
                "verdict": "held" if v.held else "lost",
                "drift_mm": f"{1e3 * v.drift:.3f}",
                "tilt_deg": f"{v.tilt:.3f}",
                "turn_deg": f"{v.turn:.3f}",
                "force_error_percent": f"{100 * v.force_error:.2f}",
                "energy_audit": f"{v.energy_error:.1e}",
                "seconds_per_second": f"{simulation.elapsed / simulation.times[-1]:.2f}",
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=len(CASES), help="of the catalogue")
    parser.add_argument("--out", type=Path, default=HERE / "unoptimized.csv")
    options = parser.parse_args()
    print(table(case_study()), flush=True)
    first_line = header(("numpy", "pin", "mujoco-core", "daqp"))
    rows = paper()
    write_rows(options.out.with_stem(f"{options.out.stem}_paper"), first_line, rows)
    ratios = [float(row["ratio"]) for row in rows if row["ratio"]]
    print(f"ratio on the paper's hand: {min(ratios):.2f} to {max(ratios):.2f}", flush=True)
    print(table(rows), flush=True)
    columns, rows = rows[0], []
    for name, shape in tqdm(CASES[: options.cases], unit="case"):
        try:
            rows.append(catalogue(name, shape))
        except PinograspError as error:
            rows.append(
                {**dict.fromkeys(columns, ""), "hand": name, "object": shape, "overclosing": type(error).__name__}
            )
        write_rows(options.out, first_line, rows)
    if rows:
        print(table(rows))


if __name__ == "__main__":
    main()
