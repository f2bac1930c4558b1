"""
PR2 gripper: box
================

A motor moves both fingers of a linkage; four contacts hold a box of 0.3 kg.
"""

import pinograsp as pg

hand = pg.load_hand("pr2_right")
box = pg.Box(size=(0.04, 0.04, 0.1), mass=0.3)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, box, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("pr2_box.png")
