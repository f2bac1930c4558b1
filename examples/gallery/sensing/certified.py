"""
Certified grasps
================

A table of postures becomes a table of newtons: which of them hold, and why the others
do not.
"""

import numpy as np

import pinograsp as pg
from pinograsp.viz.certified import certified_picture

hand, rng = pg.load_hand("allegro_right"), np.random.default_rng(0)
names = {status.code: status.value for status in pg.Status}
conditions = pg.GraspConditions(mu=0.6)
things = {
    "ball": pg.Sphere(radius=0.035, mass=0.1),
    "can": pg.Cylinder(radius=0.03, height=0.12, mass=0.2),
    "box": pg.Box(size=(0.05, 0.05, 0.1), mass=0.2),
}
table = {"reason": [], "object": [], "normal_forces_N": []}
for name, body in things.items():
    found = pg.find_grasps(hand, body, conditions, count=8, seed=2)
    closures = [one.closure for one in found.grasps]
    root = [np.linalg.inv(one.object.pose) @ one.hand.pose for one in closures]
    q = np.repeat([one.q for one in closures], 30, axis=0)
    q += rng.normal(0, 0.02, q.shape)
    told = pg.certify(hand, body, q, conditions, roots=np.repeat(root, 30, axis=0))
    print(name, f"{told.held.sum()} of {len(told)} hold")
    table["reason"] += [names[code] for code in told.reason]
    table["object"] += [name] * len(told)
    table["normal_forces_N"] += told.normal_forces.tolist()

certified_picture(table, "certified.png")
