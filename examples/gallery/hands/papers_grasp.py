"""
The paper's grasp
=================

Three fingers of a humanoid hand hold a cylinder of 1.02 kg with the least energy.
"""

import pinograsp as pg

plan = pg.load_case("paper", {"forces.search": "convex"}).plan()
print(plan.status, f"{1e3 * plan.forces.work:.1f} mJ")

plan.picture("papers_grasp.png")
