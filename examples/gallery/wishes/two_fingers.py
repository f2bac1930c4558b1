"""
Thumb and index finger
======================

Only the fingers that you name touch the ball; the others stay open.
"""

import pinograsp as pg

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.025, mass=0.05)
conditions = pg.GraspConditions(mu=0.7)
wishes = pg.Wishes(fingers=("thumb", "index"))
found = pg.find_grasps(hand, ball, conditions, wishes=wishes, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status, *plan.contacts.names)

plan.picture("two_fingers.png")
