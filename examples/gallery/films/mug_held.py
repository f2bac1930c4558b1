"""
A mug is grasped
================

The fingers close, touch the mug and press; arrows grow with the forces.
"""

from pathlib import Path

import pinograsp as pg

hand = pg.load_hand("allegro_right")
file = Path(pg.__file__).parent / "cases" / "mug.obj"
mug = pg.Mesh.load(file, scale=1e-3, mass=0.3)
conditions = pg.GraspConditions(mu=0.6, table=True)
wishes = pg.Wishes(least_fingers=3, approach="side")
found = pg.find_grasps(hand, mug, conditions, wishes=wishes, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

plan.film("mug_held.gif", seconds=3)
