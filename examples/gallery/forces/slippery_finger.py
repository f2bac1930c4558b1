"""
A slippery finger
=================

Friction may differ from contact to contact: the wetter the thumb, the harder the
fingers press.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.035, mass=0.2)
conditions = pg.GraspConditions(mu=0.7)
closure = pg.find_grasps(hand, ball, conditions, count=16, seed=1).best.closure
problem = conditions.problem(ball, closure.contacts())
names = list(problem.contacts.names)

friction, forces = np.linspace(0.7, 0.1, 25), []
for mu in friction:
    wet = replace(problem, mu=[mu if name == "thumb" else 0.7 for name in names])
    found = pg.optimize_forces(wet, 0.9, objective="least_squares")
    forces.append(found.normal_forces if found.found else [np.nan] * len(names))

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
axes.plot(friction, forces, label=names)
axes.set(xlabel="friction of the thumb [-]", ylabel="normal force [N]")
axes.invert_xaxis()
axes.legend()
figure.savefig("slippery_finger.png", dpi=120)
