"""Every hand of the catalogue on a cylinder, a box and a sphere of its size: placed, closed, planned, certified.

    python benchmarks/hands.py [--samples 32] [--hands NAME ...]

Objects are scaled to the hand: w is the largest distance between two fingertips (of one finger: to the palm) when the
hand is open; the cylinder has radius 0.18 w and height 0.9 w, the box edges 0.3 w, 0.3 w and 0.8 w, the sphere radius
0.2 w; 300 kg/m^3, friction 0.7, exact cones with torsional friction of 5 mm. Fists that never open that wide, and hands
for which no placement holds that object, get smaller ones of the same shape: SIZES, the first that is held. Placements
are seeded; torques stay within the effort limits of the joints that have one. Writes hands.csv beside this file after
every hand, and prints the table of the README.

Known limitations: coupled jaws press both sides equally far, which forces of unequal size ask not to: their motion is
then ``not_tracked``; the seed and the number of samples decide which placement is best."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from results import header, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.contacts import fingertips, open_and_closed
from pinograsp.errors import NoGrasp, PinograspError
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.synthesis import find_grasps

HERE = Path(__file__).resolve().parent
CONDITIONS = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="soft", torsion=5e-3))
DENSITY = 300.0
SIZES = (1.0, 0.7, 0.5, 0.35)


def width(hand: pg.HandModel) -> float:
    """Largest distance between fingertips of the open hand [m]; of one finger, from the palm."""
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, (hand.lower + hand.upper) / 2)
    pose = np.eye(4)
    pose[:3, 3] = fingertips(hand, data).mean(axis=0)
    opened, _ = open_and_closed(hand, pg.Sphere(radius=1e-3, mass=1e-3, pose=pose))
    pin.forwardKinematics(hand.model, data, opened)
    tips = fingertips(hand, data)
    return max(float(np.linalg.norm(a - b)) for a in tips for b in tips)


def objects(w: float) -> dict:
    return {
        "cylinder": pg.Cylinder(radius=0.18 * w, height=0.9 * w, density=DENSITY),
        "box": pg.Box(size=(0.3 * w, 0.3 * w, 0.8 * w), density=DENSITY),
        "sphere": pg.Sphere(radius=0.2 * w, density=DENSITY),
    }


def row(name: str, hand, w: float, shape: str, size: float, samples: int, jobs: int) -> dict:
    """What came of one hand and one object."""
    started, body = time.perf_counter(), objects(size * w)[shape]
    found = {
        "hand": name,
        "object": shape,
        "width_mm": f"{1e3 * w:.1f}",
        "size": size,
        "mass_g": f"{1e3 * body.mass:.1f}",
    }
    try:
        search = find_grasps(hand, body, CONDITIONS, count=samples, seed=0, jobs=jobs, progress=False)
        found |= {"tried": search.tried, "hold": len(search.grasps)}
        best = search.best
        plan = pg.plan_grasp_on(best.closure.hand, best.closure, CONDITIONS)
    except (NoGrasp, PinograspError) as error:
        return found | {
            "status": type(error).__name__,
            "seconds": f"{time.perf_counter() - started:.1f}",
            "why": str(error).splitlines()[0][:160],
        }
    bears = pg.grasp_margins(plan.solution).load_factor
    certificate, limits = plan.forces.certificate, hand.effort
    share = np.abs(plan.motion.torques[-1])[limits > 0] / limits[limits > 0]
    return found | {
        "status": str(plan.status),
        "forces": str(plan.forces.status),
        "contacts": plan.problem.k,
        "links": len({contact.link for contact in plan.problem.contacts}),
        "energy_Ns": f"{certificate.objective:.4g}",
        "gap": f"{certificate.relative_gap:.1e}",
        "residual_N": f"{plan.forces.residual_force:.1e}",
        "residual_Nm": f"{plan.forces.residual_moment:.1e}",
        "load_factor": f"{best.load_factor:.2f}",
        "squeeze_bears": "" if bears is None or np.isinf(bears) else f"{bears:.3f}",
        "effort_used": f"{share.max():.3f}" if share.size else "no limits",
        "seconds": f"{time.perf_counter() - started:.1f}",
        "why": "; ".join(plan.motion.notes[-1:])[:160] if str(plan.status) != "ok" else "",
    }


def table(rows: list[dict]) -> str:
    """Hands down, objects across: contacts, multiples of the load that the planned squeeze and that other forces there
    would bear, and what the motion says.
    """
    lines = ["| hand | cylinder | box | sphere |", "| --- | --- | --- | --- |"]
    for name in dict.fromkeys(one["hand"] for one in rows):
        cells = []
        for shape in ("cylinder", "box", "sphere"):
            one = next((r for r in rows if r["hand"] == name and r["object"] == shape), None)
            if one is None:
                cells.append("")
            elif one.get("forces") == "ok":
                motion = "" if one["status"] == "ok" else f", {one['status']}"
                size = "" if one["size"] == 1 else f" at {one['size']:g} of the size"
                bears = one["squeeze_bears"] and f"{float(one['squeeze_bears']):.2f}"
                cells.append(
                    f"{one['contacts']} contacts, {bears or 'any'}, {float(one['load_factor']):.0f}{size}{motion}"
                )
            else:
                cells.append(f"none: {one['status']}")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=32, help="placements to try for each object")
    parser.add_argument("--hands", nargs="+", default=list(CATALOGUE), help="only these")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: all cores")
    parser.add_argument("--out", type=Path, default=HERE / "hands.csv")
    options = parser.parse_args()
    columns = (
        "hand",
        "object",
        "width_mm",
        "size",
        "mass_g",
        "tried",
        "hold",
        "status",
        "forces",
        "contacts",
        "links",
        "energy_Ns",
        "gap",
        "residual_N",
        "residual_Nm",
        "load_factor",
        "squeeze_bears",
        "effort_used",
        "seconds",
        "why",
    )
    rows = []
    for name in tqdm(options.hands, unit="hand"):
        hand = pg.load_hand(name)
        w = width(hand)
        for shape in objects(w):
            for size in SIZES:
                found = row(name, hand, w, shape, size, options.samples, options.jobs)
                if found.get("forces") == "ok":
                    break
            rows.append({column: found.get(column, "") for column in columns})
        first_line = header(("numpy", "pin", "coal", "daqp"), f"{options.samples} samples a case", "seed 0")
        write_rows(options.out, first_line, rows)
    print(table(rows))


if __name__ == "__main__":
    main()
