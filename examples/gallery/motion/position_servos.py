"""
Position servos
===============

Servos press because their references lie inside the object; how hard depends on the
contacts, which may be softer or stiffer than assumed.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.035, mass=0.1)
conditions = pg.GraspConditions(mu=0.7)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

gains = np.geomspace(1.0, 50.0, 13)
bands = [plan.force_band(gain, factors=[0.2, 1.0, 5.0]) for gain in gains]
figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
for i, name in enumerate(plan.contacts.names):
    lowest, highest = [b.lowest[i] for b in bands], [b.highest[i] for b in bands]
    axes.fill_between(gains, lowest, highest, alpha=0.3, color=f"C{i}", label=name)
    axes.axhline(plan.forces.normal_forces[i], color=f"C{i}", linestyle=":")
axes.set(xlabel="gain of the servos [N m/rad]", ylabel="normal force [N]", xscale="log")
axes.set_title("contacts of 1/5 to 5 times the stiffness; dotted: planned")
axes.legend(loc="upper left")
figure.savefig("position_servos.png", dpi=120)
