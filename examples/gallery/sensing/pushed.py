"""
Pushed until it is lost
=======================

The can is pushed harder and harder from the side while the hand squeezes as planned.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg
from pinograsp.simulation import Disturbance, Push

hand = pg.load_hand("panda")
can = pg.Cylinder(radius=0.025, height=0.1, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, can, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
for force in (1.0, 2.0, 4.0, 8.0):
    push = Push(wrench_o=np.array([0, 0, -force, 0, 0, 0]), start=0.1, duration=0.2)
    seen = pg.simulate(plan, disturbance=Disturbance(pushes=(push,)), hold=0.5)
    moved = seen.object_poses[:, :3, 3] - plan.body.pose[:3, 3]
    word = "held" if seen.verdict.held else "lost"
    depth = 1e3 * np.linalg.norm(moved, axis=1)
    axes.semilogy(seen.times, depth, label=f"{force:g} N: {word}")
axes.set(xlabel="time [s]", ylabel="the can moved [mm]")
axes.set(xlim=(0.9, None), ylim=(0.5, 100))
axes.legend(loc="upper left")
figure.savefig("pushed.png", dpi=120)
