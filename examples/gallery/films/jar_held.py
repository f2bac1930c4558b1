"""
Five fingers close on a jar
===========================

Six motors move ten joints of a Psyonic hand.
"""

import pinograsp as pg

hand = pg.load_hand("psyonic_right")
jar = pg.Cylinder(radius=0.028, height=0.11, mass=0.15)
conditions = pg.GraspConditions(mu=0.6)
wishes = pg.Wishes(approach="side", least_fingers=4)
found = pg.find_grasps(hand, jar, conditions, wishes=wishes, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

plan.film("jar_held.gif", seconds=3)
