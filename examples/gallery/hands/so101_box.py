"""
SO-101: box
===========

A jaw against a fixed palm, a box of 40 g.
"""

import pinograsp as pg

hand = pg.load_hand("so101")
box = pg.Box(size=(0.025, 0.025, 0.07), mass=0.04)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, box, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("so101_box.png")
