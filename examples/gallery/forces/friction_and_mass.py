"""
Sweep over friction and mass
============================

Twenty-five plans, each with the least energy; where the map is grey, nothing holds.
"""

import pinograsp as pg
from pinograsp.viz.figures import sweep_map

settings = {"forces.search": "convex", "friction.model": "cone"}
columns = {"mu": [], "mass_kg": [], "work_J": []}
case = pg.load_case("paper", settings)
hand = case.load_hand()
for mu in (0.4, 0.55, 0.7, 0.85, 1.0):
    for mass in (0.6, 0.75, 0.9, 1.05, 1.2):
        changed = settings | {"friction.mu": mu, "object.mass": mass}
        problem = pg.load_case("paper", changed).make_problem(hand)
        found = pg.optimize_grasp(problem)
        columns["mu"].append(mu)
        columns["mass_kg"].append(mass)
        columns["work_J"].append(found.work if found.found else None)

sweep_map(columns, "work_J", "mu", "mass_kg").savefig("friction_and_mass.png", dpi=120)
