"""
Not by the lid
==============

Parts of an object have names, and nothing touches those that are forbidden.
"""

import pinograsp as pg

hand = pg.load_hand("psyonic_right")
lid = [[-0.04, -0.04, 0.03], [0.04, 0.04, 0.06]]  # its lower and upper corner [m]
jar = pg.Cylinder(radius=0.028, height=0.11, mass=0.15, regions={"lid": lid})
conditions = pg.GraspConditions(mu=0.6)
wishes = pg.Wishes(approach="side", forbidden=("lid",), least_fingers=3)
found = pg.find_grasps(hand, jar, conditions, wishes=wishes, count=24, seed=1)
plan = pg.plan_best(found, conditions)
highest = plan.contacts.points_o[:, 2].max()
print(plan.status, f"highest contact at {1e3 * highest:.0f} mm, lid from 30 mm")

plan.picture("not_by_the_lid.png")
