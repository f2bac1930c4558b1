"""
To turn it
==========

The squeeze also withstands what is done with the object: here a screw of 0.03 N m.
"""

import pinograsp as pg

hand = pg.load_hand("allegro_right")
knob = pg.Cylinder(radius=0.03, height=0.06, mass=0.1)
reserve = pg.Reserve(tasks=(pg.Task.screw(torque=0.03, axis=(0, 0, 1)),))
conditions = pg.GraspConditions(mu=0.6, reserve=reserve)
found = pg.find_grasps(hand, knob, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("turned.png")
