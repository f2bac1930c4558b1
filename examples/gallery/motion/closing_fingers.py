"""
Closing fingers
===============

The angles of all joints that move, finger by finger.
"""

import pinograsp as pg
from pinograsp.viz.figures import joint_angles

hand = pg.load_hand("allegro_right")
ball = pg.Sphere(radius=0.035, mass=0.2)
conditions = pg.GraspConditions(mu=0.6)
found = pg.find_grasps(hand, ball, conditions, count=16, seed=1)
plan = pg.plan_best(found, conditions)
print(plan.status)

joint_angles(plan).savefig("closing_fingers.png", dpi=110)
