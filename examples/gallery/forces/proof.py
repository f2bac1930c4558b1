"""
Proof of an optimum
===================

Branch and bound over the impact time: no forces in any interval cost less than its
lower bound, and the gap closes.
"""

import pinograsp as pg
from pinograsp.viz.figures import search_over_time

plan = pg.load_case("paper", {"forces.search": "convex"}).plan()
print(plan.status, f"proven: at least {plan.forces.certificate.lower_bound:.4f} N s")

search_over_time(plan).savefig("proof.png", dpi=110)
