"""The paper's grasp: three fingers of a humanoid hand hold a cylinder of 1.02 kg with the least energy that balances
forces and moments.
"""

import pinograsp as pg

plan = pg.load_case("paper", {"forces.search": "convex", "friction.safety": 1.0}).plan()

print(plan.status, f"t_I = {plan.forces.impact_time:.4f} s")
for contact, force in zip(plan.contacts.names, plan.forces.normal_forces):
    print(f"{contact}: {force:.3f} N")
print(f"{1e3 * plan.forces.work:.2f} mJ, {plan.forces.impulse:.4f} N s; net force {plan.forces.residual_force:.1e} N")
if certificate := plan.forces.certificate:
    print(f"proven: at least {certificate.lower_bound:.4f} N s")
print(f"peak torque {plan.motion.peak_torque:.3f} N m")
