"""Force problems of all friction models, for tests of what solves them."""

import numpy as np
from conftest import make_contacts

from pinograsp.contacts import Friction
from pinograsp.forces import ForceProblem, TorqueLimits

MODELS = {
    "pyramid": Friction(),
    "pyramid, torsion": Friction(torsion=0.004),
    "fine pyramid": Friction(edges=10),
    "cone": Friction(model="cone", safety=1.1),
    "cone, torsion": Friction(model="cone", torsion=0.004),
    "soft": Friction(model="soft", torsion=0.004),
}


def problem_with(model, k, seed, *, limited=False, balance="wrench"):
    """Random contacts on a cylinder under a random load of about half of what they could hold."""
    rng = np.random.default_rng(1000 * seed + k)
    angle = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-0.3, 0.3, k)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(k)])
    points = 0.03 * out + np.column_stack([np.zeros((k, 2)), rng.uniform(-0.03, 0.03, k)])
    load = np.append(rng.normal(size=3), 0.01 * rng.normal(size=3)) * rng.uniform(0.3, 1.0)
    torques = None
    if limited:
        jacobian = np.zeros((k, 6, 2 * k + 2))
        for i in range(k):
            jacobian[i, :3, 2 * i : 2 * i + 2] = rng.uniform(-0.05, 0.05, (3, 2))
        jacobian[:, :3, -2:] = rng.uniform(-0.05, 0.05, (k, 3, 2))
        torques = TorqueLimits(jacobian=jacobian, bias=np.full(2 * k + 2, 0.01), limit=np.full(2 * k + 2, 0.15))
    return ForceProblem(
        contacts=make_contacts(points, -out),
        load=load,
        mu=0.7,
        friction=MODELS[model],
        torques=torques,
        balance=balance,
        max_depth=5e-3,
    )
