"""
Forces in their friction cones
==============================

Least forces touch the cone; with a reserve they keep away from it.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinograsp as pg

hand, mu = pg.load_hand("allegro_right"), 0.6
ball = pg.Sphere(radius=0.035, mass=0.2)
search = pg.find_grasps(hand, ball, pg.GraspConditions(mu=mu), count=16, seed=1)

figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
for reserve, style in ((None, "o"), (pg.Reserve(), "^")):
    conditions = pg.GraspConditions(mu=mu, reserve=reserve)
    plan = pg.plan_grasp_on(search.best.closure.hand, search.best.closure, conditions)
    print(plan.status)
    name = "weight alone" if reserve is None else "with a reserve"
    x, y, normal = plan.forces.forces_c.T
    axes.plot(normal, np.hypot(x, y), style, markersize=8, label=name)
most = axes.get_xlim()[1]
axes.fill_between([0, most], [0, mu * most], color="0.9", label="friction cone")
axes.set(xlabel="normal force [N]", ylabel="tangential force [N]", xlim=(0, most))
axes.set_ylim(bottom=0)
axes.legend(loc="upper left")
figure.savefig("friction_cones.png", dpi=120)
