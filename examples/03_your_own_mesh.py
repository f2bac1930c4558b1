"""An object of your own as a mesh: made here by trimesh, read like any STL, OBJ, GLB or PLY file."""

import tempfile
from pathlib import Path

import trimesh

import pinograsp as pg

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "knob.stl"
    shape = trimesh.creation.revolve([(0, -30), (18, -30), (24, -12), (24, 12), (14, 30), (0, 30)], sections=48)  # [mm]
    shape.export(path)
    knob = pg.Mesh.load(path, scale=1e-3, density=900.0)
print(f"{1e3 * knob.mass:.0f} g, largest radius {1e3 * knob.bounding_radius:.1f} mm")

conditions = pg.GraspConditions(mu=0.8, friction=pg.Friction(model="cone", safety=1.1))
found = pg.find_grasps(pg.load_hand("g1_right"), knob, conditions, count=16, seed=0)
print(found.best.closure.describe())
plan = pg.plan_grasp_on(found.best.closure.hand, found.best.closure, conditions)
print(plan.status, plan.forces.normal_forces, f"{1e3 * plan.forces.work:.3f} mJ")
