"""
Weak motors
===========

Torque limits move the force from finger to finger; below the least limit no forces
exist, which is proven.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("humanoid")
bottle = pg.Cylinder(radius=0.025, height=0.2, mass=0.8)
conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone"))
search = pg.find_grasps(hand, bottle, conditions, wrap=True, count=4, seed=0)
closure = search.best.closure
contacts = closure.contacts()
problem = conditions.problem(bottle, contacts)

limits, work = np.linspace(0.5, 0.2, 31), []
for limit in limits:
    torques = pg.torque_limits(closure.hand, contacts, closure.q, limit=limit)
    found = pg.optimize_forces(replace(problem, torques=torques), 0.9, objective="work")
    work.append(1e3 * found.work if found.found else np.nan)
least = limits[np.isfinite(work)].min()

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
axes.plot(limits, work, "o-", markersize=4)
axes.axvspan(0.2, least, color="0.9")
axes.text(least - 0.004, np.nanmean(work), "no forces, proven", ha="right", rotation=90)
axes.set(xlabel="torque limit of every joint [N m]", ylabel="grasp energy [mJ]")
axes.set_xlim(0.2, 0.5)
figure.savefig("weak_motors.png", dpi=120)
