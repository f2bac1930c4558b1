"""
Baxter gripper: can
===================

Two parallel jaws on a can of 0.2 kg: soft fingers, that also resist twisting.
"""

import pinograsp as pg

hand = pg.load_hand("baxter_right")
can = pg.Cylinder(radius=0.02, height=0.1, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, can, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("baxter_can.png")
