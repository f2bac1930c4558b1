"""
The price of a reserve
======================

The more disturbance the squeeze is to withstand, the harder every finger presses.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.035, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
closure = pg.find_grasps(hand, ball, conditions, count=16, seed=1).best.closure
names = closure.contacts().names

shares, forces = np.linspace(0.0, 1.0, 6), []
for share in shares:
    reserve = pg.Reserve(disturbance=share)
    conditions = pg.GraspConditions(mu=0.6, reserve=reserve)
    plan = pg.plan_grasp_on(closure.hand, closure, conditions)
    print(plan.status)
    forces.append(plan.forces.normal_forces)

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
axes.stackplot(100 * shares, np.transpose(forces), labels=names, alpha=0.85)
axes.set(xlabel="push that is withstood [% of the weight]", ylabel="sum of F_n [N]")
axes.set_xlim(0, 100)
axes.legend(loc="upper left")
figure.savefig("price_of_a_reserve.png", dpi=120)
