"""An independent simulation: MuJoCo runs the plan with a free object, pushes the object, and makes it slippery."""

import numpy as np

import pinograsp as pg
from pinograsp.simulation import Disturbance, Push

plan = pg.load_case("paper", {"forces.search": "convex", "friction.model": "cone", "friction.safety": 1.3}).plan()

sideways = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # force [N], moment [N m]
trials = {
    "as planned": Disturbance(),
    "a push of 1 N sideways": Disturbance(pushes=(Push(wrench_o=sideways, start=0.1, duration=0.1),)),
    "5 % heavier": Disturbance(mass_factor=1.05),
    "mu 0.3 instead of 0.7": Disturbance(mu=0.3),
}
for name, disturbance in trials.items():
    verdict = pg.simulate(plan, disturbance=disturbance, hold=0.4).verdict
    print(f"{name:>24}: {'held' if verdict.held else 'lost'}, {verdict.reason}")
