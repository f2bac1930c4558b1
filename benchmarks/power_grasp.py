"""A power grasp with 16 contacts, from hand and object to torques: three phalanges of five fingers and the palm.

    python benchmarks/power_grasp.py [--repeats 5]

The hand is made here from Denavit-Hartenberg rows: four fingers and an opposed thumb, three joints each, whose
phalanges meet a cylinder of 30 mm radius one after the other when the fingers wrap round it. Writes power_grasp.csv
beside this file: seconds for loading, closing, forces and motion (median of the repeats), and what was found.

Known limitations: one grasp. Two joints are missing to move three contact points of a finger in all directions, so the
points move along their normals and slip across them; how far is in the table.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from pathlib import Path

import numpy as np
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.hands.dh import FingerDescription, HandDescription, Link, PhalanxShape

HERE = Path(__file__).resolve().parent
RADIUS, PHALANX, THICKNESS, PALM = 0.03, 0.04, 0.008, 0.006  # object, length, half thickness, half thickness [m]
CONDITIONS = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.1), reserve=None)


def five_fingers() -> HandDescription:
    """Fingers from x > 0, the thumb from x < 0; in the grasp every phalanx touches with its middle."""
    # Distance of a knuckle from the cylinder's axis, so that half a phalanx reaches the point of touch.
    far, high = math.hypot(RADIUS + THICKNESS, PHALANX / 2), RADIUS + PALM
    aside = math.sqrt(far**2 - high**2)
    phalanx = PhalanxShape(a=PHALANX / 2, b=THICKNESS, c=THICKNESS)
    fingers = []
    for name, y in {"index": -0.05, "middle": -0.025, "thumb": 0.0, "ring": 0.025, "little": 0.05}.items():
        side = -1.0 if name == "thumb" else 1.0
        base = np.eye(4)
        base[:3, :3] = np.column_stack([[side, 0, 0], [0, 0, 1], [0, -side, 0]])  # z: + turns towards the cylinder
        base[:3, 3] = [side * aside, y, 0.0]
        links = tuple(
            Link(joint=f"{name}_{part}_joint", link=f"{name}_{part}", a=PHALANX, lower=low, upper=high, phalanx=phalanx)
            for part, low, high in (("proximal", 0.3, 2.6), ("middle", -0.6, 1.8), ("distal", -0.6, 1.8))
        )
        palm = None if name == "thumb" else PhalanxShape(a=aside, b=0.01, c=PALM)
        fingers.append(FingerDescription(name=name, base=base, links=links, metacarpal=palm))
    return HandDescription(name="five_fingers", fingers=tuple(fingers), density=1000.0, effort=1.5, velocity=5.0)


def grasp() -> tuple[pg.GraspPlan, dict[str, float]]:
    """The plan, and seconds of each stage."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        hand = pg.load_hand(five_fingers().write(folder)[1])
    loaded = time.perf_counter()
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # its axis along y
    pose[2, 3] = RADIUS + PALM + 2e-7
    closure = pg.close_hand(hand, pg.Cylinder(radius=RADIUS, height=0.14, mass=0.3, pose=pose), wrap=True)
    closed = time.perf_counter()
    plan = pg.plan_grasp_on(hand, closure, CONDITIONS)
    stages = {
        "loading": loaded - started,
        "closing": closed - loaded,
        "forces": plan.elapsed["forces"],
        "motion": plan.elapsed["motion"],
        "all": time.perf_counter() - started,
    }
    return plan, stages


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=HERE / "power_grasp.csv")
    options = parser.parse_args()
    runs = [grasp() for _ in range(options.repeats)]
    plan = runs[0][0]
    certificate, motion = plan.forces.certificate, plan.motion
    row = {f"{name}_s": f"{np.median([stages[name] for _, stages in runs]):.2f}" for name in runs[0][1]} | {
        "slowest_s": f"{max(stages['all'] for _, stages in runs):.2f}",
        "contacts": plan.problem.k,
        "status": str(plan.status),
        "forces": str(plan.forces.status),
        "energy_Ns": f"{certificate.objective:.4g}",
        "gap": f"{certificate.relative_gap:.1e}",
        "residual_N": f"{plan.forces.residual_force:.1e}",
        "residual_Nm": f"{plan.forces.residual_moment:.1e}",
        "effort_used": f"{(np.abs(motion.torques[-1]) / plan.hand.effort).max():.3f}",
        "normal_error_um": f"{1e6 * motion.tracking_error.max():.2g}",
        "slip_um": f"{1e6 * motion.slip.max():.2g}",
    }
    write_rows(options.out, header(("numpy", "pin", "coal", "daqp", "clarabel"), f"{options.repeats} repeats"), [row])
    print(table([{"what": name, "value": value} for name, value in row.items()]))


if __name__ == "__main__":
    main()
