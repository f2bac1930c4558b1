"""
A mesh of your own
==================

A knob is turned on trimesh's lathe, and read like any STL, OBJ, GLB or PLY file.
"""

import tempfile
from pathlib import Path

import trimesh

import pinograsp as pg

outline = [(0, -30), (18, -30), (24, -12), (24, 12), (14, 30), (0, 30)]  # [mm]
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "knob.stl"
    trimesh.creation.revolve(outline, sections=48).export(file)
    knob = pg.Mesh.load(file, scale=1e-3, density=900.0)

hand = pg.load_hand("g1_right")
conditions = pg.GraspConditions(mu=0.8)
found = pg.find_grasps(hand, knob, conditions, count=16, seed=0)
plan = pg.plan_best(found, conditions)
print(plan.status, f"{1e3 * knob.mass:.0f} g")

plan.picture("own_mesh.png")
