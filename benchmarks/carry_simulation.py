"""Whether what is planned to be carried is carried: arm, hand and a free object in MuJoCo along random paths.

    python benchmarks/carry_simulation.py --seed N [--paths 100] [--jobs 2]

Jaws of a Panda on boxes, and an Allegro on a Panda's arm on spheres and boxes; masses, friction, sizes and waypoints
are drawn, until the carry plan is ``ok``, not ``doubtful``. Each path is planned with a reserve of 10 % and simulated:
held? (And the first of the doubtful ones, for comparison.) And without a reserve and with accelerations that jump, ten
percent faster than the certified limit: ruled out by proof? And lost, when the hand squeezes as planned at each place
of the path? Joints have no limits there, so that it is the grasp that is too weak.
Writes carry_simulation.csv beside this file.
"""

from __future__ import annotations

import argparse
import os
import secrets
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from arms import JOINTS, robot
from joblib import Parallel, delayed
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.carry import ArmPath, CarryPlan, plan_carry, simulate_carry
from pinograsp.carry.simulation import LETTING_GO, build_simulation_task, choose_servo
from pinograsp.errors import CarryInfeasible, PinograspError, SimulationDiverged, Status
from pinograsp.handover import JointTrajectory
from pinograsp.planner import plan_best

HERE = Path(__file__).resolve().parent
SETTINGS = {"time_step": 1e-3, "sample": 5e-3, "hold": 0.3}  # [s] of the simulations
INTERVALS = 200
FASTER = 1.1
MOST_DRAWN = 20
ANY = 100.0  # times the limits of joints: none
HANDS = ("panda", "panda + allegro_right")


def random_path(arm, rng) -> ArmPath:
    """Waypoints in the inner third of the joints' ranges."""
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    middle, half = (arm.upper + arm.lower)[moving] / 2, (arm.upper - arm.lower)[moving] / 2
    while True:
        way = middle + half * rng.uniform(-0.35, 0.35, (rng.integers(3, 6), len(moving)))
        path = ArmPath.through(dict(zip(JOINTS, way.T)))
        if (np.abs(path.at(np.linspace(0, 1, 200)).q - middle) <= half).all():
            return path


def grasp_of(name: str, rng):
    """A grasp of something by the hand alone."""
    mu, mass = float(rng.uniform(0.4, 0.9)), float(rng.uniform(0.05, 0.4))
    conditions = pg.GraspConditions(mu=mu)
    if name == "panda":
        hand, at = pg.load_hand("panda"), np.eye(4)
        at[:3, 3] = [0.0, 0.0, 0.1034 + rng.uniform(-0.005, 0.005)]
        pose = hand.frame_placements(hand.resting, [hand.palm])[0] @ at
        box = pg.Box(size=[rng.uniform(0.03, 0.08), rng.uniform(0.02, 0.06), rng.uniform(0.03, 0.07)], mass=mass)
        return pg.plan_grasp_on(hand, box.placed(pose), conditions)
    shape = pg.Sphere(radius=float(rng.uniform(0.03, 0.04)), mass=mass)
    if rng.random() < 0.5:
        shape = pg.Box(size=[0.05, 0.05, 0.1], mass=mass)
    search = pg.find_grasps(
        pg.load_hand("allegro_right"), shape, conditions, count=8, seed=int(rng.integers(2**31)), jobs=1, progress=False
    )
    return plan_best(search, conditions)


def trial(name: str, seed: int) -> dict[str, object]:
    """One path: as planned, and too fast."""
    rng = np.random.default_rng(seed)
    row: dict[str, object] = {"hand": name, "seed": seed, "plan": "ok"}
    row |= dict.fromkeys(("held", "why", "drift", "proven", "lost", "doubtful", "doubtful_held"), "")
    path = random_path(robot(name), rng)
    try:
        for drawn in range(1, MOST_DRAWN + 1):
            row["grasps_drawn"] = drawn
            grasp = grasp_of(name, rng)
            if grasp.status is not Status.OK:
                continue
            plan = plan_carry(robot(name), grasp, path, intervals=INTERVALS)
            if plan.status is Status.OK:
                break
            if not row["doubtful"]:
                row |= {"doubtful": "; ".join(plan.cautions), "doubtful_held": simulated(plan)["held"]}
        else:
            return row | {"plan": "none that is ok"}
    except CarryInfeasible:
        return row | {"plan": "infeasible"}
    except PinograspError as error:
        return row | {"plan": f"{type(error).__name__}"}
    row |= {"duration_s": plan.duration, "fastest_s": plan.fastest, "binds": plan.shares()[0][0]}
    return row | simulated(plan) | too_fast(name, grasp, path, plan)


def simulated(plan: CarryPlan) -> dict[str, object]:
    """Held?"""
    try:
        seen = simulate_carry(plan, **SETTINGS)
    except SimulationDiverged as error:
        return {"held": False, "why": str(error)}
    return {"held": seen.verdict.held, "why": "; ".join(seen.verdict.causes), "drift": seen.verdict.reason}


def too_fast(name: str, grasp, path: ArmPath, plan: CarryPlan) -> dict[str, object]:
    """Ten percent faster than the limit of the grasp alone."""
    arm = robot(name)
    fast, strong = np.full(arm.n, ANY), np.where(arm.effort > 0, ANY * arm.effort, np.inf)
    free = {"reserve": 0.0, "disturbance": 0.0, "speed": fast, "torque_limit": strong, "intervals": INTERVALS}
    try:
        most = plan_carry(robot(name), grasp, path, ramp=0.0, **free)
    except PinograspError as error:
        return {"proven": f"{type(error).__name__}"}
    faster = most.timing.speed_up(FASTER)
    times = np.linspace(0.0, faster.duration, 2000)
    moving, point = faster.at(times), path.at(faster.at(times).s)
    v, a = moving.speed[:, None], moving.acceleration[:, None]
    nothing = np.zeros_like(point.q)
    given = JointTrajectory(
        names=path.joints, times=times, q=point.q, dq=point.slope * v, ddq=point.slope * a, effort=nothing
    )
    try:
        plan_carry(robot(name), grasp, given, timing="given", **free)
        return {"proven": "no"}
    except CarryInfeasible:
        proven = "yes"
    except PinograspError as error:
        proven = type(error).__name__
    # The hand squeezes as planned at each place of the path; arm and object go faster.
    instants = most.instants / FASTER
    s, there = plan.timing.at(plan.instants).s, faster.at(instants).s
    sent = {
        name: np.column_stack([np.interp(there, s, column) for column in getattr(plan, name).T])
        for name in ("commanded_q", "commanded_torques")
    }
    quick = replace(most, timing=faster, times=most.times / FASTER, instants=instants, **sent)
    task = build_simulation_task(quick, LETTING_GO)
    task = replace(task, torque_limit=np.where(np.isin(robot(name).joint_names, JOINTS), np.inf, task.torque_limit))
    try:
        seen = pg.simulate(task, servo=choose_servo(quick), letting_go=LETTING_GO, **SETTINGS)
    except SimulationDiverged as error:
        return {"proven": proven, "fast_drift": str(error)}
    return {"proven": proven, "lost": not seen.verdict.held, "fast_drift": seen.verdict.reason}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=None, help="default: drawn, and printed")
    parser.add_argument("--paths", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--hand", choices=HANDS, default=None, help="default: in turn")
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print(f"seed {seed}")
    # For processes that find the modules beside this file.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    seeds = np.random.SeedSequence(seed).generate_state(options.paths).tolist()
    hands = HANDS if options.hand is None else (options.hand,)
    work = (delayed(trial)(hands[i % len(hands)], one) for i, one in enumerate(seeds))
    rows = list(tqdm(Parallel(n_jobs=options.jobs, return_as="generator")(work), total=options.paths))
    seen = []
    for name in hands:
        own = [row for row in rows if row["hand"] == name]
        planned = [row for row in own if row["held"] != ""]
        fast = [row for row in planned if row["lost"] != ""]
        doubtful = [row for row in own if row["doubtful"]]
        seen.append(
            {
                "hand": name,
                "paths": len(own),
                "plans": ", ".join(f"{count} {plan}" for plan, count in Counter(row["plan"] for row in own).items()),
                "held": f"{sum(bool(row['held']) for row in planned)} of {len(planned)}",
                "too fast: proven": f"{sum(row['proven'] == 'yes' for row in planned)} of {len(planned)}",
                "too fast: lost": f"{sum(bool(row['lost']) for row in fast)} of {len(fast)}",
                "doubtful: held": f"{sum(bool(row['doubtful_held']) for row in doubtful)} of {len(doubtful)}",
            }
        )
    print(table(seen))
    write_rows(
        HERE / "carry_simulation.csv",
        header(["pinograsp", "pin", "mujoco-core"], f"seed {seed}"),
        rows,
    )


if __name__ == "__main__":
    main()
