"""
Grid, QP and the optimum
========================

The paper's grid search, the same grid with a QP over the friction multipliers, and
the certified optimum, which balances exactly.
"""

import matplotlib.pyplot as plt

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED

case = pg.load_case("paper", AS_PUBLISHED | {"forces.measure": "work"})
problem = case.make_problem(case.load_hand())
best = pg.optimize_grasp(problem)
names, found = ["grid", "grid, then QP", "QP in each cell", "optimum"], []
for search in ("paper", "paper+qp", "hybrid"):
    found.append(pg.grid_search(problem, search=search, progress=False))
found.append(best)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.barh(names, [1e3 * one.work for one in found], color="#2a6f97")
left.axvline(1e3 * best.work, color="0.3", linestyle=":", label="proven least")
left.set(xlabel="grasp energy [mJ]", xlim=(54, 57))
left.legend(loc="lower right")
right.barh(names, [max(one.residual_force, 1e-16) for one in found], color="#c1666b")
right.set(xlabel="net force that is left [N]", xscale="log", yticks=[])
for axes in (left, right):
    axes.invert_yaxis()
figure.savefig("grid_and_qp.png", dpi=130)
