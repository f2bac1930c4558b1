"""
Allegro hand: mug
=================

Fingertips hold a mug of 0.3 kg that stands on a table.
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
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("allegro_mug.png")
