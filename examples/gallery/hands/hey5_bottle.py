"""
TIAGo's Hey5: bottle
====================

Three motors pull tendons: thumb and fingers hold a bottle of 0.2 kg.
"""

import pinograsp as pg

hand = pg.load_hand("hey5")
bottle = pg.Cylinder(radius=0.022, height=0.14, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, bottle, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("hey5_bottle.png")
