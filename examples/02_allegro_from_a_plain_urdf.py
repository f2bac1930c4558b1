"""An Allegro hand from its plain URDF, no side file: where it can hold a ball, and the plan."""

import pinograsp as pg
from pinograsp.hands.catalogue import file_of

hand = pg.load_hand(file_of("allegro_right"))  # any path to a .urdf, .xacro or MJCF .xml
print(hand.describe())

ball = pg.Sphere(radius=0.03, mass=0.2)
conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.2))
found = pg.find_grasps(hand, ball, conditions, count=12, seed=0)
best = found.best
print(f"{len(found.grasps)} of {found.tried} samples hold; the best {best.load_factor:.1f} times the load")

plan = pg.plan_grasp_on(best.closure.hand, best.closure, conditions)
print(plan.status, plan.contacts.names, plan.forces.normal_forces.round(3), "N")
print(f"peak torque {plan.motion.peak_torque:.3f} N m")
for warning in plan.cautions:
    print("warning:", warning)
