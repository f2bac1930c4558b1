"""
Panda gripper: box
==================

From above: flat jaws touch a box of 0.2 kg at the corners of their pads.
"""

import pinograsp as pg

hand = pg.load_hand("panda")
box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
wishes = pg.Wishes(approach="above")
found = pg.find_grasps(hand, box, conditions, wishes=wishes, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("panda_box.png")
