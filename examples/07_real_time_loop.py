"""A control loop: forces and torques for a load that changes every millisecond, a finger that is lost, a load too
large.
"""

import time

import numpy as np

import pinograsp as pg

plan = pg.load_case("paper", {"forces.search": "convex", "friction.model": "cone"}).plan()
load, q = np.array(plan.problem.load), plan.motion.q[-1]
# Prepared once, before the loop.
online = pg.OnlineForces(plan.problem, hand=plan.hand, q=q, max_rate=200.0, ramp=0.05)

spent = []
for tick in range(1000):
    shaken = load * (1 + 0.2 * np.sin(2 * np.pi * tick / 250))
    begun = time.perf_counter()
    forces, torques, status = online.step(shaken, q=q)
    spent.append(time.perf_counter() - begun)
    if tick % 250 in (0, 62, 187) and tick < 250:
        print(
            f"{tick:4d} ms: {status}, normal forces {forces[:, 2].round(2)} N, largest torque "
            f"{np.abs(torques).max():.3f} N m"
        )
print(f"a step takes {1e6 * np.median(spent):.0f} us, at worst {1e6 * max(spent):.0f} us")

for _ in range(100):
    forces, torques, status = online.step(3 * load, q=q)
print(f"three times the load: {status}, residual {np.linalg.norm(online.residual[:3]):.2f} N")
online.engage("middle", False)
for _ in range(100):
    forces, torques, status = online.step(0.3 * load, q=q)
print(f"without the middle finger, a third of the load: {status}, {forces[:, 2].round(2)} N")
