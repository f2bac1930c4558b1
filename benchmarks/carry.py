"""How long ``plan_carry`` takes, and how near its timings are to their lower bounds.

    python benchmarks/carry.py [--seed 0] [--repeats 20]

A Panda of example-robot-data on a path of its own. Random grasps: contacts with exact friction cones about a sphere in
the hand, without limits of the hand's motors, over intervals and over contacts; and 5 random contacts on the fingers of
an Allegro and of the paper's hand on the same arm, with rows of all their motors: as strong as they are, and so weak
that they bind. Random grasps that cannot hold the sphere are drawn again.

``whole_s`` is all of ``plan_carry`` (at its defaults: ramps of 50 ms, a reserve of a tenth), processor time; of it are
``loads_s`` the loads along the path and the programs' matrices, ``timing_s`` the program of the least time,
``ramp_s`` that of how fast the timing with ramps may be, ``forces_s`` that of the least forces, ``limit_s`` that of the
curve of the fastest. Medians, and of the whole the 99th percentile. ``rounds``, ``gap`` and ``residual`` are those of
the least time; so are ``kept_rows``, rows of motors that bind somewhere. Writes carry.csv beside this file.
"""

from __future__ import annotations

import os

# Read when the libraries load.
os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMEXPR")})

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import arms
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.carry import passing, plan_carry, squeeze
from pinograsp.carry.program import CarryProgram, CarrySolution
from pinograsp.carry.task import CarryTask
from pinograsp.contacts import Contact, ContactSet, Friction
from pinograsp.errors import CarryInfeasible, CarryUndecided
from pinograsp.planner import plan_best
from pinograsp.spatial import tangent_frame

HERE = Path(__file__).resolve().parent
WAY = np.array(
    [
        [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8],
        [0.8, 0.0, 0.3, -1.6, 0.2, 1.9, 1.2],
        [1.4, 0.4, -0.2, -1.2, -0.3, 1.5, 0.4],
        [0.2, -0.3, 0.1, -2.2, 0.1, 2.0, 0.8],
    ]
)
PATH = dict(zip(arms.JOINTS, WAY.T))
RADIUS, MASS, MU, MOST = 0.03, 0.3, 0.6, 20.0  # [m, kg, -, N]
STIFF = 50.0  # contacts over the planned ones': so that normal forces are limited by MOST
INTERVALS, CONTACTS, USUAL = (100, 200, 500, 1000, 2000), (3, 5, 8, 16), (500, 5)
WEAK = 0.35  # [N m] of motors that bind
PARTS = ("timing", "ramp", "forces", "limit")  # the programs of a plan, in order


@dataclass(frozen=True)
class Case:
    """What is carried."""

    robot: pg.HandModel
    grasp: pg.GraspPlan
    torque_limit: np.ndarray

    def plan(self, intervals: int) -> object:
        return plan_carry(self.robot, self.grasp, PATH, intervals=intervals, torque_limit=self.torque_limit)


# -- robots and grasps -------------------------------------------------------------------------------------------------


def panda() -> tuple[pg.HandModel, pg.GraspPlan, np.ndarray]:
    """The arm with its own jaws, a grasp with them, and its motors, those of the jaws without limits."""
    arm, at = arms.panda(WAY[0]), np.eye(4)
    at[2, 3] = 0.1034
    pose = arm.frame_placements(arm.resting, [arm.palm])[0] @ at
    grasp = pg.plan_grasp_on(arm, pg.Box(size=(0.04, 0.04, 0.06), mass=MASS, pose=pose), pg.GraspConditions(mu=MU))
    return arm, grasp, with_motors(arm, np.inf)


def with_motors(robot: pg.HandModel, limit: float | None) -> np.ndarray:
    """Limits of all motors (n,) [N m]; those of the hand's as given."""
    found = robot.effort_or_infinity.copy()
    if limit is not None:
        found[np.concatenate([finger.dofs for finger in robot.fingers])] = limit
    return found


def allegro() -> pg.GraspPlan:
    conditions = pg.GraspConditions(mu=MU)
    ball = pg.Sphere(radius=0.035, mass=MASS)
    search = pg.find_grasps(pg.load_hand("allegro_right"), ball, conditions, count=8, seed=3, jobs=1, progress=False)
    return plan_best(search, conditions)


def random_grasp(plan: pg.GraspPlan, k: int, rng: np.random.Generator) -> pg.GraspPlan:
    """Contacts at random places about a sphere where a planned grasp holds its object, on the fingers in turn."""
    held, hand = plan.problem, plan.hand
    pose = np.eye(4)
    pose[:3, :3] = hand.frame_placements(np.array(plan.motion.q[-1]), [hand.palm])[0][:3, :3]
    pose[:3, 3] = held.object.com_o
    body = pg.Sphere(radius=RADIUS, mass=MASS, pose=pose)
    angles = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-0.3, 0.3, k)
    outward = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, k)])
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True) @ pose[:3, :3].T
    fingers = [hand.fingers[i % len(hand.fingers)] for i in range(k)]
    contacts = [
        Contact(
            finger=finger.name,
            link=finger.links[-1],
            point_o=pose[:3, 3] + RADIUS * n,
            rotation_oc=tangent_frame(-n),
            length=None,
            distance=0.0,
        )
        for finger, n in zip(fingers, outward)
    ]
    problem = replace(
        held,
        contacts=ContactSet(contacts=tuple(contacts), com_o=pose[:3, 3]),
        object=body,
        load=np.array([0, 0, -9.81 * MASS, 0, 0, 0]),
        mu=MU,
        friction=Friction(model="cone"),
        min_normal_force=None,
        max_normal_force=np.full(k, MOST),
        torques=None,
        moment_length=RADIUS,
        compliance=replace(held.compliance, stiffness=STIFF * held.compliance.stiffness),
    )
    forces = replace(plan.forces, depths=np.zeros((len(plan.forces.depths), k)))
    return replace(plan, body=body, forces=forces, solution=replace(plan.solution, problem=problem))


def held_case(robot: pg.HandModel, plan: pg.GraspPlan, limit: np.ndarray, k: int, rng: np.random.Generator) -> Case:
    """A random grasp that bears the way."""
    while True:
        case = Case(robot, random_grasp(plan, k, rng), limit)
        try:
            case.plan(50)
        except (CarryInfeasible, CarryUndecided):
            continue
        return case


# -- clocks ------------------------------------------------------------------------------------------------------------


class Clocks:
    """Processor time of the parts of a plan."""

    def __init__(self) -> None:
        self.loads = 0.0
        self.solved: list[tuple[CarryProgram, CarrySolution, float]] = []

    def plan(self, case: Case, intervals: int) -> float:
        """Plan, and tell how long it took [s]."""
        constrain, solve = CarryTask.constrain, passing.solve_carry

        def loading(*values):
            start = time.process_time()
            found = constrain(*values)
            self.loads += time.process_time() - start
            return found

        def solving(program: CarryProgram, **options) -> CarrySolution:
            start = time.process_time()
            found = solve(program, **options)
            self.solved.append((program, found, time.process_time() - start))
            return found

        with (
            patch.object(CarryTask, "constrain", loading),
            patch.object(passing, "solve_carry", solving),
            patch.object(squeeze, "solve_carry", solving),
        ):
            start = time.process_time()
            case.plan(intervals)
            return time.process_time() - start


def measured(name: str, case: Case, intervals: int, repeats: int) -> dict[str, object]:
    """One line of the table."""
    Clocks().plan(case, intervals)
    whole, loads, parts = list[float](), list[float](), list[list[float]]()
    for _ in range(repeats):
        clocks = Clocks()
        whole.append(clocks.plan(case, intervals))
        loads.append(clocks.loads)
        parts.append([took for _, _, took in clocks.solved])
    program, found, _ = clocks.solved[0]
    return {
        "case": name,
        "intervals": intervals,
        "contacts": program.k,
        "rows": len(program.R),
        "kept_rows": int(np.abs(found.rows).any(axis=(0, 1)).sum()),
        "whole_s": f"{np.median(whole):.3f}",
        "whole_p99_s": f"{np.percentile(whole, 99):.3f}",
        "loads_s": f"{np.median(loads):.3f}",
        **{f"{part}_s": f"{value:.3f}" for part, value in zip(PARTS, np.median(parts, axis=0))},
        "rounds": found.rounds,
        "gap": f"{found.gap:.1e}",
        "residual": f"{found.residual:.1e}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, help="of the grasps; default: drawn, and printed")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--out", type=Path, default=HERE / "carry.csv")
    options = parser.parse_args()
    seed = int(np.random.SeedSequence().entropy % 2**32) if options.seed is None else options.seed
    print("seed", seed)
    rng = np.random.default_rng(seed)
    arm, grasp, limit = panda()
    random = {k: held_case(arm, grasp, limit, k, rng) for k in CONTACTS}
    count, k = USUAL
    cases = [("random", random[k], intervals) for intervals in INTERVALS]
    cases += [("random", random[other], count) for other in CONTACTS if other != k]
    hands = {
        "allegro": (arms.panda_with("allegro_right", "palm_link", posture=WAY[0]), allegro()),
        "paper's hand": (arms.panda_with("humanoid", "palm", posture=WAY[0]), pg.load_case("paper").plan()),
    }
    for hand, (robot, plan) in hands.items():
        cases.append((hand, held_case(robot, plan, with_motors(robot, None), k, rng), count))
        cases.append((f"{hand}, weak", held_case(robot, plan, with_motors(robot, WEAK), k, rng), count))
    rows = list[dict]()
    for name, case, intervals in tqdm(cases, unit="case"):
        rows.append(measured(name, case, intervals, options.repeats))
    print(table(rows))
    notes = (f"seed {seed}", f"{options.repeats} repeats", "processor time")
    written = options.out.with_suffix(".part")
    write_rows(written, header(("numpy", "scipy", "pin", "clarabel"), *notes), rows)
    written.replace(options.out)


if __name__ == "__main__":
    main()
