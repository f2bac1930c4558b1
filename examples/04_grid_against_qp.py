"""The paper's grid search, the same grid with a QP over the friction multipliers, and the certified convex optimum."""

import time

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED

case = pg.load_case("paper", AS_PUBLISHED | {"forces.measure": "work"})  # forces alone in balance
problem = case.make_problem(case.load_hand())
print(f"{'search':>10} {'work [mJ]':>10} {'net force [N]':>14} {'time [ms]':>10}")
for search in ("paper", "paper+qp", "hybrid"):
    begun = time.perf_counter()
    found = pg.grid_search(problem, search=search, progress=False)
    spent = time.perf_counter() - begun
    print(f"{search:>10} {1e3 * found.work:10.3f} {found.residual_force:14.2e} {1e3 * spent:10.1f}")
begun = time.perf_counter()
best = pg.optimize_grasp(problem)
spent = time.perf_counter() - begun
print(f"{'convex':>10} {1e3 * best.work:10.3f} {best.residual_force:14.2e} {1e3 * spent:10.1f}")
if best.certificate:
    print(f"proven to be within {best.certificate.relative_gap:.0e} of the least")
