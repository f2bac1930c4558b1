"""
A squeeze that reacts to slip
=============================

A can is twice as heavy and half as rough as planned; the controller feels how it slips
and squeezes harder.
"""

import matplotlib.pyplot as plt

import pinograsp as pg
from pinograsp.simulation import Disturbance, Sensors

hand, mu, mass = pg.load_hand("panda"), 0.6, 0.25
can = pg.Cylinder(radius=0.03, height=0.12, mass=mass)
conditions = pg.GraspConditions(mu=mu)
found = pg.find_grasps(hand, can, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
controller = plan.grip_controller(latency=0.025, max_normal_force=40.0)
times, commanded = [], []


def step(felt):
    command = controller.step(felt)
    times.append(felt.time)
    commanded.append(controller.forces[:, 2].sum())
    return command


other = Disturbance(mu=mu / 2, mass_factor=2.0, command_delay=0.005)
sensors = Sensors(quantities=("forces", "slips"), noise=0.1, delay=0.02, seed=1)
settings = {"support": "fixed", "hold": 0.6, "time_step": 5e-4}
seen = pg.simulate(
    plan, controller=step, sensors=sensors, disturbance=other, **settings
)
print(plan.status, seen.verdict.reason)

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
pressed = seen.normal_forces.sum(axis=1)
axes.plot(seen.times, pressed, color="0.7", label="simulated")
axes.plot(times, commanded, label="commanded")
axes.axhline(2 * mass * 9.81 / (mu / 2), color="k", linestyle=":", label="least")
axes.set(xlabel="time [s]", ylabel="sum of normal forces [N]")
axes.legend()
figure.savefig("slipping_can.png", dpi=120)
