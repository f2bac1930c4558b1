"""A power grasp: the fingers wrap round a bottle, every phalanx and the palm may touch."""

import pinograsp as pg
from pinograsp.planner import plan_best

hand, bottle = pg.load_hand("humanoid"), pg.Cylinder(radius=0.025, height=0.2, mass=0.5)
conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.2))
found = pg.find_grasps(hand, bottle, conditions, wrap=True, count=32, seed=0)
plan = plan_best(found, conditions)  # of the best one that the motion can carry out
print(found.explain())
print(
    plan.status,
    f"{plan.problem.k} contacts, {1e3 * plan.forces.work:.3f} mJ, peak torque {plan.motion.peak_torque:.3f} N m",
)
for name, force in zip(plan.contacts.names, plan.forces.normal_forces):
    print(f"{name:>12}: {force:.3f} N")
