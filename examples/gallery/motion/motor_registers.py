"""
What the motors are sent
========================

A plan in the register units of the motors, whose data sheet comes with the package.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand = pg.load_hand("allegro_right", drives="leap")
ball = pg.Sphere(radius=0.03, mass=0.1)
conditions = pg.GraspConditions(mu=0.7)
found = pg.find_grasps(hand, ball, conditions, count=8, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "registers.csv"
    plan.to_csv(file, command="torque", units="register")
    table = np.genfromtxt(file, delimiter=",", names=True, deletechars="")

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
for joint in hand.joint_names[:4]:
    axes.plot(table["time"], table[f"{joint}/effort"], label=joint)
axes.legend()
axes.set(xlabel="time [s]", ylabel="current register [units]")
figure.savefig("motor_registers.png", dpi=120)
