"""Picking at random places: is there a plan, and does it come about in the simulation?

    python benchmarks/pick.py --seed 7 --count 20 [--robots panda ...] [--errors] [--recompute]
        [--reference 3000] [--files FOLDER] [--json]

Robots: a Panda with its jaws, a UR5 with the Panda's jaws, a Panda with an Allegro hand, the right arm of a G1 with its
hand. With ``--files FOLDER``, in which the makers' repositories Universal_Robots_ROS2_Description and
ros2_robotiq_gripper are, a UR5e with a 2F-85 takes the UR5's place. A can, a box, a mug, a bottle or a ball stands on a
table at a random place and is to be put half a metre away, with a box and a wall in the way in every other trial. Each
plan is simulated with a free object and the robot's own servos: done is what was lifted, carried and put down within
10 mm and 10 deg, nothing else touched. With ``--errors`` the object is 5 mm and 5 deg off its place, 10 % heavier, its
friction 0.9 of the planned. With ``--recompute`` plans are not simulated: speeds, accelerations and torques (by RNEA,
with the object) are computed anew at 1 kHz, as shares of their limits, and distances from what stands around (by coal),
less what is to be kept. With ``--reference`` it is told for trials without a plan whether the arm reaches any of the
grasps of so many samples, from 50 postures each. Writes pick.csv beside this file; the last line is JSON with
``--json``. Some 10 s for each trial.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.errors import PinograspError
from pinograsp.hands.catalogue import file_of
from pinograsp.objects.body import Body
from pinograsp.pick import PickMotion, PickPlan, simulate_pick
from pinograsp.pick.plan import read_task
from pinograsp.pick.reach import Reacher
from pinograsp.simulation import Disturbance
from pinograsp.spatial import inverse_of, pose_of

HERE = Path(__file__).resolve().parent
MU = 0.6
ROBOTS = ("panda", "ur5_panda_jaws", "panda_allegro", "g1")


def load_robot(name: str, files: Path | None = None) -> tuple[pg.HandModel, tuple[float, float, float]]:
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
    home = {"shoulder_lift_joint": -1.5, "elbow_joint": 1.6, "wrist_1_joint": -1.6, "wrist_2_joint": -1.57}
    if name == "ur5_panda_jaws" and files is not None:
        ur, robotiq = files / "Universal_Robots_ROS2_Description", files / "ros2_robotiq_gripper/robotiq_description"
        robot = pg.attach(
            ur / "urdf/ur.urdf.xacro",
            robotiq / "urdf/robotiq_2f_85_gripper.urdf.xacro",
            link="tool0",
            posture=home,
            packages={"ur_description": ur, "robotiq_description": robotiq},
            xacro_args={"name": "ur5e", "ur_type": "ur5e"},
        )
        return robot, (0.4, 0.6, 0.0)
    if name == "ur5_panda_jaws":
        file = file_of("panda").parents[2] / "ur_description/urdf/ur5_robot.urdf"
        return pg.attach(file, "panda", link="tool0", posture=home), (0.4, 0.6, 0.0)
    tips = {finger.name: finger.tip for finger in pg.load_hand("g1_right").fingers}
    home = {"right_shoulder_pitch_joint": 0.2, "right_shoulder_roll_joint": -0.3, "right_elbow_joint": -0.6}
    robot = pg.load_hand(file_of("g1_right"), palm="right_hand_palm_link", fingers=tips, posture=home)
    return robot, (0.28, 0.4, -0.1)


def load_objects() -> dict[str, Body]:
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
    parser.add_argument("--recompute", action="store_true")
    parser.add_argument("--reference", type=int, default=0)
    parser.add_argument("--files", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rng, rows = np.random.default_rng(args.seed), list[dict[str, object]]()
    first = header(["pin", "pin-pink", "ompl", "mujoco-core", "pinograsp"], f"seed {args.seed}", f"{args.count} trials")
    robots = {name: load_robot(name, args.files) for name in args.robots}
    objects = load_objects()
    for i in tqdm(range(args.count)):
        name, thing = args.robots[i % len(args.robots)], list(objects)[rng.integers(len(objects))]
        (robot, (near, far, height)), crowded = robots[name], i // len(args.robots) % 2 == 1
        rows.append(_try(rng, robot, objects[thing], near, far, height, crowded=crowded, args=args))
        rows[-1] = {"robot": robot.name, "object": thing, "crowded": crowded, **rows[-1]}
        write_rows(HERE / "pick.csv", first, rows)
    print(first)
    names = [robots[name][0].name for name in args.robots]
    print(table([_summarize(name, [row for row in rows if row["robot"] == name]) for name in names]))
    took = [float(str(row["seconds"])) for row in rows if row["planned"]]
    found = {
        "count": len(rows),
        **({"reachable": sum(bool(row["planned"] or row.get("reachable")) for row in rows)} if args.reference else {}),
        "planned": sum(bool(row["planned"]) for row in rows),
        "done": sum(bool(row["done"]) for row in rows),
        "median_s": float(np.median(took)) if took else None,
        "p95_s": float(np.quantile(took, 0.95)) if took else None,
    }
    print(json.dumps(found) if args.json else found)


def _try(
    rng: np.random.Generator,
    robot: pg.HandModel,
    thing: Body,
    near: float,
    far: float,
    height: float,
    *,
    crowded: bool,
    args: argparse.Namespace,
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
    started, seed = time.perf_counter(), int(rng.integers(1_000_000))
    try:
        plan = pg.plan_pick(
            robot,
            body,
            scene,
            pg.GraspConditions(mu=MU),
            place=pose_of(there + [0, 0, stands], yaw),
            seed=seed,
            progress=False,
        )
    except PinograspError as error:
        took = round(time.perf_counter() - started, 2)
        if args.reference:
            row["reachable"] = _is_reachable(robot, body, scene, pose_of(there + [0, 0, stands], yaw), args.reference)
        return {**row, "seconds": took, "why": str(error).splitlines()[0]}
    row |= {"planned": True, "status": plan.status.value, "seconds": round(time.perf_counter() - started, 2)}
    row |= {f"{stage}_s": round(took, 2) for stage, took in plan.elapsed.items()} | {"takes": round(plan.duration, 2)}
    if args.recompute:
        return row | _recompute(plan)
    other: dict[str, object] = {}
    if args.errors:
        direction = rng.uniform(0.0, 2.0 * np.pi)
        other = {"object_offset": (5e-3 * np.cos(direction), 5e-3 * np.sin(direction), 0.0), "mass_factor": 1.1}
        other |= {"object_turn": (0.0, 0.0, np.radians(5.0) * rng.choice([-1, 1])), "mu": 0.9 * MU}
    seen = simulate_pick(plan, disturbance=Disturbance(**other))
    row |= {"done": seen.done, "why": seen.failed, "moved_mm": round(1e3 * seen.moved, 2)}
    return row | {"off_mm": round(1e3 * seen.off, 2), "off_deg": round(seen.off_angle, 2)}


def _is_reachable(robot: pg.HandModel, body: Body, scene: pg.Scene, place: np.ndarray, count: int) -> bool:
    """Whether the arm reaches any grasp that the hand by itself finds in so many samples."""
    rng = np.random.default_rng(count)
    task = read_task(robot, body, scene, place, None, PickMotion(), pg.GraspConditions(mu=MU, table=True), rng)
    # Where nothing is sound it tries up to four times as many.
    count = max(1, count // 4)
    found = pg.find_grasps(task.hand, body, pg.GraspConditions(mu=MU, table=True), count=count, seed=count)
    reacher = Reacher(task, rng, starts=50)
    return any(reacher.reach(grasp) is not None for grasp in found.grasps if grasp.withstands)


def _recompute(plan: PickPlan) -> dict[str, object]:
    """Largest shares of the arm's limits, and the least that distances have to spare [mm]."""
    robot, arm, motion = plan.robot, plan.robot.arm, PickMotion()
    way = plan.trajectory(rate=1000.0)
    bounds = np.cumsum([phase.duration for phase in plan.phases])
    ddq = np.gradient(way.dq, way.times, axis=0)
    carried = (way.times > bounds[1]) & (way.times <= bounds[2])
    # The object moves with the palm while it is carried.
    body, model = plan.grasp.body, robot.model
    frame = model.frames[robot.frame_id(robot.palm)]
    at_grasp = robot.frame_placements(plan.phases[2].q[0], [robot.palm])[0]
    held = frame.placement * pin.SE3(inverse_of(at_grasp) @ body.shape_pose)
    loaded = model.copy()
    loaded.inertias[frame.parentJoint] += held.act(pin.Inertia(body.mass, np.zeros(3), body.inertia_s))
    torques = np.zeros((len(way.times), robot.n))
    for own, rows in ((model, ~carried), (loaded, carried)):
        data = own.createData()
        for i in np.flatnonzero(rows):
            torques[i] = pin.rnea(own, data, way.q[i], way.dq[i], ddq[i])
    limits = np.where(robot.effort > 0, robot.effort, np.inf), np.where(robot.velocity > 0, robot.velocity, np.inf)
    spare = min(
        _measure_spare(plan, way.q[way.times <= bounds[0]], held=None),
        _measure_spare(plan, way.q[carried], held=held),
    )
    found = {
        "speed": float((np.abs(way.dq) / limits[1])[:, arm].max()),
        "acceleration": float(np.abs(ddq[:, arm]).max() / motion.acceleration),
        "torque": float((np.abs(torques) / limits[0])[:, arm].max()),
    }
    kept = all(share <= 1.0 for share in found.values()) and spare > -1e-5
    return {**{name: round(share, 3) for name, share in found.items()}, "spare_mm": round(1e3 * spare, 3), "done": kept}


def _measure_spare(plan: PickPlan, qs: np.ndarray, held: pin.SE3 | None) -> float:
    """The least distance of arm, hand and held object from what stands around, less what each is to keep [m]."""
    robot, scene, body = plan.robot, plan.scene, plan.grasp.body
    geometry, palm = robot.geometry.copy(), robot.model.frames[robot.frame_id(robot.palm)].parentJoint
    geometry.removeAllCollisionPairs()
    own, supports, kept = geometry.ngeoms, plan.find_supports(), list[float]()
    for name, obstacle in scene.obstacles.items():
        at = pin.SE3(obstacle.shape_pose)
        geometry.addGeometryObject(pin.GeometryObject(f"obstacle {name}", 0, at, obstacle.collision_geometry))
    at = pin.SE3(body.shape_pose) if held is None else held
    geometry.addGeometryObject(
        pin.GeometryObject("the object", 0 if held is None else palm, at, body.collision_geometry)
    )
    for j, name in enumerate(scene.obstacles):
        for i in range(own):
            if joint := geometry.geometryObjects[i].parentJoint:
                geometry.addCollisionPair(pin.CollisionPair(i, own + j))
                kept.append(0.0 if joint >= palm and name in supports else scene.clearance)
        if held is not None and name not in supports:
            geometry.addCollisionPair(pin.CollisionPair(own + j, geometry.ngeoms - 1))
            kept.append(scene.clearance)
    if held is None:
        for i in range(own):
            if 0 < geometry.geometryObjects[i].parentJoint < palm:
                geometry.addCollisionPair(pin.CollisionPair(i, geometry.ngeoms - 1))
                kept.append(scene.clearance)
    data, geometry_data, least = robot.model.createData(), geometry.createData(), np.inf
    for q in qs:
        pin.computeDistances(robot.model, data, geometry, geometry_data, q)
        least = min(least, *(one.min_distance - keep for one, keep in zip(geometry_data.distanceResults, kept)))
    return float(least)


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
