"""
By the handle
=============

The jaws close round the flat handle of a beaker, a part that is given as a box.
"""

import tempfile
from pathlib import Path

from trimesh.boolean import difference, union
from trimesh.creation import box, cylinder

import pinograsp as pg

wall, room = cylinder(0.04, 0.09, sections=48), cylinder(0.036, 0.09, sections=48)
room.apply_translation([0, 0, 0.006])
ring = difference([box([0.06, 0.012, 0.06]), box([0.044, 0.02, 0.044])])
ring.apply_translation([0.045, 0, 0])
core = cylinder(0.038, 0.2, sections=48)
beaker = union([difference([wall, room]), difference([ring, core])])
with tempfile.TemporaryDirectory() as folder:
    beaker.export(Path(folder) / "beaker.stl")
    body = pg.Mesh.load(Path(folder) / "beaker.stl", mass=0.1)

hand = pg.load_hand("panda")
conditions = pg.GraspConditions(mu=0.7)
wishes = pg.Wishes(within=[[0.046, -0.02, -0.04], [0.08, 0.02, 0.04]])
found = pg.find_grasps(hand, body, conditions, wishes=wishes, count=8, seed=4)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{plan.forces.normal_forces.sum():.1f} N in all")

plan.picture("by_the_handle.png")
