"""
Allegro: power grasp
====================

Phalanges and palm of the left hand wrap a cylinder of 0.4 kg.
"""

import pinograsp as pg

hand = pg.load_hand("allegro_left")
cylinder = pg.Cylinder(radius=0.035, height=0.16, mass=0.4)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, cylinder, conditions, count=16, seed=3, wrap=True)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("allegro_power.png")
