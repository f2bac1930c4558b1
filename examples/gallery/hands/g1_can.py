"""
Unitree G1: can
===============

Thumb and fingers of the humanoid's hand hold a can of 0.3 kg.
"""

import pinograsp as pg

hand = pg.load_hand("g1_right")
can = pg.Cylinder(radius=0.03, height=0.12, mass=0.3)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, can, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("g1_can.png")
