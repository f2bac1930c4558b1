"""
A power grasp
=============

Fingers wrap a cylinder from base to tip, until phalanges and tips press.
"""

import pinograsp as pg

hand = pg.load_hand("allegro_left")
cylinder = pg.Cylinder(radius=0.035, height=0.16, mass=0.4)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, cylinder, conditions, count=16, seed=3, wrap=True)
plan = pg.plan_best(found, conditions)
print(plan.status)

plan.film("wrapped.gif", seconds=3)
