"""Picking at random places: is there a plan, and does it come about in the simulation?

    python benchmarks/pick.py --seed 7 --count 20 [--robots panda ...] [--errors] [--json]

Robots: a Panda with its jaws, a UR5 with the Panda's jaws, a Panda with an Allegro hand, the right arm of a G1 with its
hand. A can, a box, a mug, a bottle or a ball stands on a table at a random place and is to be put half a metre away,
with a box and a wall in the way in every other trial. Each plan is simulated with a free object and the robot's own
servos: done is what was lifted, carried and put down within 10 mm and 10 deg, nothing else touched. With
``--errors`` the object is 5 mm and 5 deg off its place, 10 % heavier, its friction 0.9 of the planned.
Writes pick.csv beside this file; the last line is JSON with ``--json``. Some 5 s for each trial.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.hands.catalogue import file_of
from pinograsp.pick import simulate_pick
from pinograsp.simulation import Disturbance
from pinograsp.spatial import pose_of

HERE = Path(__file__).resolve().parent
MU = 0.6
ROBOTS = ("panda", "ur5_panda_jaws", "panda_allegro", "g1")


def load_robot(name: str) -> tuple[pg.HandModel, tuple[float, float, float]]:
    """A robot, and where objects stand for it: nearest and farthest distance from its axis, height of the table [m]."""
    panda = {"panda_joint2": -0.5, "panda_joint4": -2.0, "panda_joint6": 1.6, "panda_joint7": 0.8}
    if name == "panda":
        return pg.attach(file_of("panda"), "panda", link="panda_link8", remove=["panda_hand"], posture=panda), (
            0.4,
            0.6,
            0.0,
        )
    if name == "panda_allegro":
        at = pose_of((0.0, 0.0, 0.1))
        robot = pg.attach(
            file_of("panda"), "allegro_right", link="panda_link8", at=at, remove=["panda_hand"], posture=panda
        )
        return robot, (0.4, 0.6, 0.0)
    if name == "ur5_panda_jaws":
        home = {"shoulder_lift_joint": -1.5, "elbow_joint": 1.6, "wrist_1_joint": -1.6, "wrist_2_joint": -1.57}
        file = file_of("panda").parents[2] / "ur_description/urdf/ur5_robot.urdf"
        return pg.attach(file, "panda", link="tool0", posture=home), (0.4, 0.6, 0.0)
    tips = {finger.name: finger.tip for finger in pg.load_hand("g1_right").fingers}
    home = {"right_shoulder_pitch_joint": 0.2, "right_shoulder_roll_joint": -0.3, "right_elbow_joint": -0.6}
    robot = pg.load_hand(file_of("g1_right"), palm="right_hand_palm_link", fingers=tips, posture=home)
    return robot, (0.28, 0.4, -0.1)


def load_objects() -> dict[str, pg.objects.body.Body]:
    """Objects with their lowest points at z = 0."""
    mug = pg.Mesh.load(Path(pg.__file__).parent / "cases" / "mug.obj", scale=1e-3, mass=0.25)
    low = float(mug.vertices[:, 2].min())
    return {
        "can": pg.Cylinder(radius=0.03, height=0.12, mass=0.2).placed(pose_of((0, 0, 0.06))),
        "box": pg.Box(size=(0.05, 0.06, 0.12), mass=0.2).placed(pose_of((0, 0, 0.06))),
        "bottle": pg.Cylinder(radius=0.028, height=0.2, mass=0.3).placed(pose_of((0, 0, 0.1))),
        "ball": pg.Sphere(radius=0.033, mass=0.1).placed(pose_of((0, 0, 0.033))),
        "mug": mug.placed(pose_of((0, 0, -low))),
    }


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), choices=ROBOTS)
    parser.add_argument("--errors", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rng, rows = np.random.default_rng(args.seed), list[dict[str, object]]()
    first = header(["pin", "pin-pink", "ompl", "mujoco-core", "pinograsp"], f"seed {args.seed}", f"{args.count} trials")
    robots = {name: load_robot(name) for name in args.robots}
    objects = load_objects()
    for i in tqdm(range(args.count)):
        name, thing = args.robots[i % len(args.robots)], list(objects)[rng.integers(len(objects))]
        (robot, (near, far, height)), crowded = robots[name], i // len(args.robots) % 2 == 1
        rows.append(_try(rng, robot, objects[thing], near, far, height, crowded=crowded, errors=args.errors))
        rows[-1] = {"robot": name, "object": thing, "crowded": crowded, **rows[-1]}
        write_rows(HERE / "pick.csv", first, rows)
    print(first)
    print(table([_summarize(name, [row for row in rows if row["robot"] == name]) for name in args.robots]))
    took = [float(str(row["seconds"])) for row in rows if row["planned"]]
    found = {
        "count": len(rows),
        "planned": sum(bool(row["planned"]) for row in rows),
        "done": sum(bool(row["done"]) for row in rows),
        "median_s": float(np.median(took)) if took else None,
        "p95_s": float(np.quantile(took, 0.95)) if took else None,
    }
    print(json.dumps(found) if args.json else found)


def _try(
    rng: np.random.Generator,
    robot: pg.HandModel,
    thing: pg.objects.body.Body,
    near: float,
    far: float,
    height: float,
    *,
    crowded: bool,
    errors: bool,
) -> dict[str, object]:
    """One trial; the base is where the robot's root is."""
    radius, side = rng.uniform(near, far), -1.0 if near < 0.35 else rng.choice([-1.0, 1.0])
    angle = side * rng.uniform(0.3, 0.9)
    here = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
    # Half a metre away on the other side, or as far as a short arm goes.
    away = 0.5 if near >= 0.35 else 0.2
    turn = -side * 2.0 * np.arcsin(min(1.0, away / (2.0 * radius)))
    there = np.array([radius * np.cos(angle + turn), radius * np.sin(angle + turn), height])
    yaw = pg.spatial.rotation_rpy(0.0, 0.0, rng.uniform(-np.pi, np.pi))
    stands = thing.pose[2, 3]
    body = thing.placed(pose_of(here + [0, 0, stands], yaw))
    scene = pg.Scene.on_table(height, at=(0.5, 0.0), size=(0.8, 1.4))
    if crowded:
        middle = radius * np.array([np.cos(angle + turn / 2.0), np.sin(angle + turn / 2.0)])
        scene = scene.with_box("wall", (0.2, 0.02, 0.15), at=(*middle, height + 0.075))
        scene = scene.with_box("crate", (0.08, 0.08, 0.1), at=(here[0] + 0.14, here[1], height + 0.05))
    row: dict[str, object] = {"planned": False, "done": False}
    started = time.perf_counter()
    try:
        plan = pg.plan_pick(
            robot,
            body,
            scene,
            pg.GraspConditions(mu=MU),
            place=pose_of(there + [0, 0, stands], yaw),
            seed=int(rng.integers(1_000_000)),
            progress=False,
        )
    except PinograspError as error:
        return {**row, "seconds": round(time.perf_counter() - started, 2), "why": str(error).splitlines()[0]}
    row |= {"planned": True, "status": plan.status.value, "seconds": round(time.perf_counter() - started, 2)}
    row |= {f"{stage}_s": round(took, 2) for stage, took in plan.elapsed.items()} | {"takes": round(plan.duration, 2)}
    other: dict[str, object] = {}
    if errors:
        direction = rng.uniform(0.0, 2.0 * np.pi)
        other = {"object_offset": (5e-3 * np.cos(direction), 5e-3 * np.sin(direction), 0.0), "mass_factor": 1.1}
        other |= {"object_turn": (0.0, 0.0, np.radians(5.0) * rng.choice([-1, 1])), "mu": 0.9 * MU}
    seen = simulate_pick(plan, disturbance=Disturbance(**other))
    row |= {"done": seen.done, "why": seen.failed, "moved_mm": round(1e3 * seen.moved, 2)}
    return row | {"off_mm": round(1e3 * seen.off, 2), "off_deg": round(seen.off_angle, 2)}


def _summarize(name: str, rows: list[dict[str, object]]) -> dict[str, object]:
    planned = [row for row in rows if row["planned"]]
    return {
        "robot": name,
        "trials": len(rows),
        "planned": len(planned),
        "done": sum(bool(row["done"]) for row in rows),
        "median [s]": f"{np.median([float(str(row['seconds'])) for row in planned]):.1f}" if planned else "",
    }


if __name__ == "__main__":
    main()
