"""A mug held by its handle, in simulation."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.planner import plan_best

WITHIN = np.array([[0.046, -0.02, -0.04], [0.08, 0.02, 0.04]])


def mug():
    """A beaker with a flat ring as its handle, along x."""

    def without(outer, inner):
        return trimesh.boolean.difference([outer, inner], engine="manifold")

    wall = trimesh.creation.cylinder(radius=0.04, height=0.09, sections=48)
    room = trimesh.creation.cylinder(radius=0.036, height=0.09, sections=48)
    room.apply_translation([0.0, 0.0, 0.006])
    ring = without(trimesh.creation.box([0.06, 0.012, 0.06]), trimesh.creation.box([0.044, 0.02, 0.044]))
    ring.apply_translation([0.045, 0.0, 0.0])
    core = trimesh.creation.cylinder(radius=0.038, height=0.2, sections=48)
    return trimesh.boolean.union([without(wall, room), without(ring, core)], engine="manifold")


@pytest.mark.slow
def test_a_mug_is_held_by_its_handle(tmp_path):
    """The jaws go round the bar of the handle, whose ring is open, and touch the beaker nowhere."""
    mug().export(tmp_path / "mug.stl")
    body = pg.Mesh.load(tmp_path / "mug.stl", mass=0.1)
    conditions = pg.GraspConditions(mu=0.7)
    found = pg.find_grasps(
        pg.load_hand("panda"),
        body,
        conditions,
        wishes=pg.Wishes(within=WITHIN),
        count=8,
        seed=4,
        jobs=1,
        progress=False,
    )
    plan = plan_best(found, conditions)
    at = plan.contacts.points_o
    assert ((at >= WITHIN[0]) & (at <= WITHIN[1])).all()
    # Beside the centre of mass: what holds the mug's moment is more than a point on each side.
    assert np.abs(at[:, 0] - body.com_o[0]).min() > 0.03
    seen = pg.simulate(plan)
    assert seen.verdict.held and seen.verdict.turn < 2.0
    assert seen.verdict.force_error < 0.15
