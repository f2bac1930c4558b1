"""
Romeo: ball
===========

One motor closes all fingers on a ball of 0.08 kg.
"""

import pinograsp as pg

hand = pg.load_hand("romeo_right")
ball = pg.Sphere(radius=0.028, mass=0.08)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("romeo_ball.png")
