"""
Talos gripper: ball
===================

Three fingertips, one motor: a ball of 0.15 kg.
"""

import pinograsp as pg

hand = pg.load_hand("talos_right")
ball = pg.Sphere(radius=0.03, mass=0.15)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("talos_ball.png")
