"""
TIAGo Pro gripper: egg
======================

An ellipsoid of 60 g between two jaws.
"""

import pinograsp as pg

hand = pg.load_hand("tiago_pro_right")
egg = pg.Ellipsoid(semi_axes=[0.02, 0.02, 0.027], mass=0.06)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, egg, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("tiago_pro_egg.png")
