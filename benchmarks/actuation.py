"""Forces on contacts that are softer or stiffer than planned, at several servo gains: predicted and simulated.

    python benchmarks/actuation.py [--hold 1.0]

An Allegro hand holds a ball and a cylinder; joint servos with the plan's torques as feed-forward. Predicted are the
forces (``pinograsp.actuation.force_band``), whether friction holds, and the margin of stability at these forces
(``object_stiffness``); simulated, by MuJoCo with a contact law of its own, are the forces at the end, the object's
turn since it was let go, and the simulation's verdict. Writes actuation.csv beside this file.

Known limitations: one hand; curvatures of fingertips and objects are means, the same at all contacts; simulations call
a grasp lost that is stable, but so softly that the object moves by more than 2 mm or turns by more than 5 deg.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.actuation import CompliantHand, contact_stiffness, force_band, object_stiffness
from pinograsp.motion import preload_slope, torque_limits
from pinograsp.simulation.settings import Servo

HERE = Path(__file__).resolve().parent
GAINS, FACTORS = (0.5, 1.0, 1.5, 2.0, 5.0, 50.0), (0.2, 1.0, 5.0, 20.0)  # [N m/rad], [-]
TIP = 1 / 0.012  # [1/m] of the fingertips
OBJECTS = {
    "ball": (pg.Sphere(radius=0.03, mass=0.2), 1 / 0.03),
    "cylinder": (pg.Cylinder(radius=0.03, height=0.12, mass=0.2), 1 / 0.06),
}
CONDITIONS = pg.GraspConditions(mu=0.7)


def rows(name: str, hold: float) -> Iterator[dict]:
    body, curvature = OBJECTS[name]
    best = pg.find_grasps(pg.load_hand("allegro_right"), body, CONDITIONS, count=12, seed=0).best
    plan = pg.plan_grasp_on(best.closure.hand, best.closure, CONDITIONS)
    hand, solution, q = plan.hand, plan.solution, plan.motion.q[-1]
    contacts, depth = solution.problem.contacts, solution.profile.final_depth
    jacobians = torque_limits(hand, contacts, q, depth=depth, limit=np.inf).jacobian
    for gain in GAINS:
        servos = CompliantHand.at(contacts, jacobians, gains=np.full(hand.n, gain))
        band = force_band(solution, servos, FACTORS)
        for factor, forces, holds in zip(FACTORS, band.forces_c, band.holds):
            law = replace(solution.problem.compliance, stiffness=factor * solution.problem.compliance.stiffness)
            forces_o = np.einsum("kxc,kc->kx", contacts.rotations_oc, forces)
            stiff = contact_stiffness(law, forces[:, 2])
            stiffness = object_stiffness(
                contacts.G,
                stiff,
                servos,
                forces,
                object_curvature=curvature,
                hand_curvature=TIP,
                torsional_stiffness=solution.problem.friction.torsion**2 * stiff.diagonal()[2::3],
                joint_preload=preload_slope(hand, contacts, q, forces_o, depth=depth),
            )
            real = replace(plan, law=replace(plan.law, stiffness=law.stiffness))
            simulation = pg.simulate(real, support="fixed", servo=Servo.of(hand, stiffness=gain), hold=hold)
            last = simulation.times > simulation.times[-1] - 0.1
            names = list(simulation.parts)
            found = simulation.normal_forces[last].mean(axis=0)[[names.index(one) for one in contacts.names]]
            row = {
                "object": name,
                "gain_Nm_rad": gain,
                "factor": factor,
                "planned_N": _listed(solution.normal_forces),
                "predicted_N": _listed(forces[:, 2]),
                "simulated_N": _listed(found),
                "friction_holds": bool(holds),
                "margin_N_m": f"{stiffness.margin:.1f}",
                "stable": stiffness.is_stable(),
                "simulated_turn_deg": f"{simulation.verdict.turn:.1f}",
                "simulated_held": simulation.verdict.held,
            }
            yield row


def _listed(forces: np.ndarray) -> str:
    return " ".join(f"{force:.2f}" for force in forces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hold", type=float, default=1.0, help="seconds")
    parser.add_argument("--out", type=Path, default=HERE / "actuation.csv")
    options = parser.parse_args()
    found = [row for name in tqdm(OBJECTS, unit="object") for row in rows(name, options.hold)]
    print(table(found))
    write_rows(options.out, header(("numpy", "pin", "mujoco-core"), f"{options.hold:g} s held"), found)


if __name__ == "__main__":
    main()
