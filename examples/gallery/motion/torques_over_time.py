"""
Torques over time
=================

What the thumb's joints do while it comes to the object and squeezes it.
"""

import pinograsp as pg
from pinograsp.viz.figures import joint_torques

plan = pg.load_case("paper", {"forces.search": "convex"}).plan()
print(plan.status, f"peak torque {plan.motion.peak_torque:.2f} N m")

joint_torques(plan, "thumb").savefig("torques_over_time.png", dpi=120)
