"""
From above
==========

The hand comes from above to a box that stands on a table.
"""

import pinograsp as pg

hand = pg.load_hand("allegro_left")
box = pg.Box(size=(0.05, 0.05, 0.09), mass=0.2)
conditions = pg.GraspConditions(mu=0.6, table=True)
wishes = pg.Wishes(approach="above", edges=False)
found = pg.find_grasps(hand, box, conditions, wishes=wishes, count=24, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("from_above.png")
