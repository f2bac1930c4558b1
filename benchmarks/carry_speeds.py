"""How fast may the arm move? A Panda's arm along one path, with the paper's grasp, an Allegro and its own jaws.

    python benchmarks/carry_speeds.py

For each grasp: the fastest with what the hand holds (and its lower bound), the plan with accelerations that change over
50 ms, the same with a squeeze that is commanded once, and the largest acceleration of the object on the way. Limits
less 10 %, disturbances as the grasps' plans bear them. Writes carry_speeds.csv beside this file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from arms import JOINTS, START, robot
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.carry import CarryPlan, plan_carry
from pinograsp.carry.loads import LoadedRobot
from pinograsp.errors import CarryInfeasible
from pinograsp.planner import GraspPlan, plan_best

HERE = Path(__file__).resolve().parent
WAY = dict(zip(JOINTS, np.array([START, [0.8, 0, 0.3, -1.6, 0.2, 1.9, 1.2], [1.4, 0.4, -0.2, -1.2, -0.3, 1.5, 0.4]]).T))


def paper(**changes: object) -> GraspPlan:
    """The paper's grasp, forces and moments in balance."""
    return pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench", **changes}).plan(
        progress=False
    )


def allegro(mass: float, mu: float) -> GraspPlan:
    """An Allegro on a ball."""
    hand, ball, conditions = (
        pg.load_hand("allegro_right"),
        pg.Sphere(radius=0.035, mass=mass),
        pg.GraspConditions(mu=mu),
    )
    return plan_best(pg.find_grasps(hand, ball, conditions, count=16, seed=3, jobs=1, progress=False), conditions)


def jaws(mass: float, mu: float) -> GraspPlan:
    """The arm's own jaws on a box."""
    arm, at = robot("panda"), np.eye(4)
    at[2, 3] = 0.1034
    box = pg.Box(size=(0.04, 0.04, 0.06), mass=mass).placed(arm.frame_placements(arm.resting, [arm.palm])[0] @ at)
    return pg.plan_grasp_on(arm, box, pg.GraspConditions(mu=mu))


def largest_acceleration(plan: CarryPlan) -> float:
    """Of the object's centre of mass [m/s^2]."""
    carried = LoadedRobot.carry(plan.robot, plan.grasp)
    weight = carried.along(plan.path, plan.timing.at(plan.instants).s, plan.gravity_o).wrench.still
    return float(np.linalg.norm(plan.loads[:, :3] + weight[:, :3], axis=1).max() / plan.grasp.body.mass)


def row(name: str, what: str, grasp: GraspPlan) -> dict[str, object]:
    arm = robot(name)
    told: dict[str, object] = {"arm and hand": name, "grasp": what}
    try:
        plan, constant = (plan_carry(arm, grasp, WAY, squeeze=squeeze) for squeeze in ("least", "constant"))
    except CarryInfeasible as error:
        return told | {"plan_s": "not even at rest" if "at rest" in str(error) else str(error)}
    return told | {
        "fastest_s": round(plan.fastest, 4),
        "lower_bound_s": round(plan.lower_bound, 4),
        "plan_s": round(plan.duration, 3),
        "constant_s": round(constant.duration, 3),
        "squeeze_N": f"{plan.squeeze.min():.3g} to {plan.squeeze.max():.3g}",
        "constant_squeeze_N": f"{constant.commanded[0].sum():.3g}",
        "acceleration_m_s2": round(largest_acceleration(plan), 1),
        "binds": "; ".join(f"{what} {100 * share:.0f} %" for what, share in plan.shares()[:2]),
    }


def main() -> None:
    rows = [
        row("panda + humanoid", "the paper's", paper()),
        row("panda + humanoid", "the paper's, mu 0.5", paper(**{"friction.mu": 0.5})),
        row("panda + allegro_right", "ball of 0.15 kg, mu 0.6", allegro(0.15, 0.6)),
        row("panda + allegro_right", "ball of 0.5 kg, mu 0.4", allegro(0.5, 0.4)),
        row("panda", "box of 0.2 kg, mu 0.6", jaws(0.2, 0.6)),
        row("panda", "box of 0.8 kg, mu 0.3", jaws(0.8, 0.3)),
    ]
    print(table(rows))
    write_rows(HERE / "carry_speeds.csv", header(["pinograsp", "pin"]), rows)


if __name__ == "__main__":
    main()
