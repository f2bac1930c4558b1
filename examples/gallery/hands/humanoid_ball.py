"""
The paper's hand: ball
======================

Thumb and fingers of the paper's hand round a ball of 0.3 kg.
"""

import pinograsp as pg

hand = pg.load_hand("humanoid")
ball = pg.Sphere(radius=0.035, mass=0.3)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("humanoid_ball.png")
