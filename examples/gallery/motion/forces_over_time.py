"""
Forces over time
================

Normal forces grow with the depth of the contacts, until they hold the object.
"""

import pinograsp as pg
from pinograsp.viz.figures import contact_forces

hand = pg.load_hand("psyonic_right")
ball = pg.Sphere(radius=0.03, mass=0.1)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

contact_forces(plan).savefig("forces_over_time.png", dpi=110)
