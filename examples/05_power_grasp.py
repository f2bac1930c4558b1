"""A power grasp: the fingers wrap round a bottle, every phalanx and the palm may touch."""

import pinograsp as pg

hand, bottle = pg.load_hand("humanoid"), pg.Cylinder(radius=0.025, height=0.2, mass=0.5)
conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.2))
found = pg.find_grasps(hand, bottle, conditions, wrap=True, count=8, seed=0)
closure = max((grasp.closure for grasp in found.grasps), key=lambda one: len(one.touches))
print(closure.describe())

plan = pg.plan_grasp_on(closure.hand, closure, conditions)
print(
    plan.status,
    f"{plan.problem.k} contacts, {1e3 * plan.forces.work:.3f} mJ, peak torque {plan.motion.peak_torque:.3f} N m",
)
for name, force in zip(plan.contacts.names, plan.forces.normal_forces):
    print(f"{name:>12}: {force:.3f} N")
