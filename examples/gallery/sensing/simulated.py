"""
Simulated
=========

MuJoCo runs a plan with a free object: its forces, and how far the object sinks when it
is let go.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("g1_right")
can = pg.Cylinder(radius=0.03, height=0.12, mass=0.3)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, can, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
seen = pg.simulate(plan, hold=0.5)
print(plan.status, seen.verdict.reason)

figure, (upper, lower) = plt.subplots(2, 1, sharex=True, layout="constrained")
upper.plot(seen.times, seen.normal_forces, label=seen.parts)
upper.set_prop_cycle(None)
for planned in plan.forces.normal_forces:
    upper.axhline(planned, color="0.6", linestyle=":")
upper.set(ylabel="normal force [N]", title="dotted: planned")
upper.legend(loc="lower right")
moved = seen.object_poses[:, :3, 3] - seen.object_poses[0, :3, 3]
lower.plot(seen.times, 1e3 * np.linalg.norm(moved, axis=1))
lower.set(xlabel="time [s]", ylabel="the object moved [mm]", xlim=(0.8, None))
figure.savefig("simulated.png", dpi=120)
