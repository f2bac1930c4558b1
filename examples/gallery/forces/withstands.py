"""
What a grasp withstands
=======================

The largest force that may push the object, by direction, while the hand squeezes as
planned.
"""

import pinograsp as pg
from pinograsp.viz.figures import wrench_margin

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.035, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

wrench_margin(plan.with_reach()).savefig("withstands.png", dpi=100)
