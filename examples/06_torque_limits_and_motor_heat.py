"""Weak motors: the same grasp with torque limits, with the least motor heat, and why it fails where the limits are too
low.
"""

from dataclasses import replace

import numpy as np

import pinograsp as pg
from pinograsp.forces import ObjectiveName, TorqueLimits

hand, bottle = pg.load_hand("humanoid"), pg.Cylinder(radius=0.025, height=0.2, mass=0.8)
conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone"))
closure = pg.find_grasps(hand, bottle, conditions, wrap=True, count=4, seed=0).best.closure
contacts, impact = closure.contacts(), 0.9
problem = conditions.problem(bottle, contacts)


def limits(newton_metres: float) -> TorqueLimits:
    """Every joint limited to so many newton metres, at the posture that touches."""
    return pg.torque_limits(closure.hand, contacts, closure.q, limit=newton_metres)


def show(name: str, problem: pg.ForceProblem, objective: ObjectiveName) -> None:
    found = pg.optimize_forces(problem, impact, objective=objective)
    if not found.found:
        print(f"{name:>18}: {found.status}")
        return
    torque = limits(10.0).torques(np.einsum("kij,kj->ki", contacts.rotations_oc, found.forces_c))
    print(
        f"{name:>18}: work {1e3 * found.work:.3f} mJ, largest torque {np.abs(torque).max():.4f} N m, heat "
        f"{torque @ torque:.5f} (N m)^2"
    )


show("least work", problem, "work")
for limit in (0.4, 0.35, 0.3, 0.25):
    show(f"within {limit:g} N m", replace(problem, torques=limits(limit)), "work")
show("least motor heat", replace(problem, torques=limits(10.0)), "motor_heat")
print(pg.diagnose(replace(problem, torques=limits(0.2)), impact))
