"""
Psyonic Ability hand: ball
==========================

Six motors, ten joints: thumb and three fingers hold a ball of 0.1 kg.
"""

import pinograsp as pg

hand = pg.load_hand("psyonic_right")
ball = pg.Sphere(radius=0.03, mass=0.1)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("psyonic_ball.png")
