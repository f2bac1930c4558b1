"""Recordings for Rerun, read back by its own reader."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.viz.rerun_file import write_rerun
from pinograsp.viz.scene import make_scene


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan()


def read_columns(path):
    """By entity and component: times (f,) [s] and values (f, ...); and the names of the entities that stay."""
    chunk = pytest.importorskip("rerun.chunk")
    columns, static = {}, set()
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        if part.is_static:
            static.add(str(part.entity_path))
            continue
        times = batch.column("time").cast("int64").to_numpy() * 1e-9
        for name in batch.schema.names:
            if ":" in name:
                values = np.array(batch.column(name).to_pylist(), dtype=float)
                columns[str(part.entity_path), name.partition(":")[2]] = times, values.squeeze(1)
    return columns, static


def turn(pose, points):
    """Points (..., 3) of a frame at position and quaternion w, x, y, z (7,)."""
    w, v = pose[3], pose[4:]
    return points + 2 * np.cross(v, np.cross(v, points) + w * points) + pose[:3]


def test_a_recording_has_motion_arrows_and_time_series(plan, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    simulation = pg.simulate(plan, hold=0.1)
    path = plan.save_rerun(tmp_path / "grasp.rrd", simulation=simulation)
    columns, static = read_columns(path)
    scene = make_scene(plan, simulation)
    close = dict(rtol=1e-5, atol=1e-6)  # Rerun keeps poses and arrows in single numbers
    for k, name in enumerate(scene.contacts):
        times, force = columns[f"/normal/{name}", "scalars"]
        np.testing.assert_allclose(times, scene.times, atol=1e-8)
        np.testing.assert_allclose(force, scene.normal[:, k])
        _, vectors = columns[f"/world/forces/{name}", "vectors"]
        np.testing.assert_allclose(vectors, scene.force_scale * scene.forces_o[:, k], **close)
        _, origins = columns[f"/world/forces/{name}", "origins"]
        np.testing.assert_allclose(origins[-1], plan.contacts.points_o[k], **close)
    moved = [i for joints in scene.fingers.values() for i in joints]
    assert moved
    for i in moved:
        _, torques = columns[f"/torques/{scene.joints[i]}", "scalars"]
        np.testing.assert_allclose(torques, scene.torques[:, i])
    object_name = "/world/object"
    _, places = columns[object_name, "translation"]
    np.testing.assert_allclose(places, np.tile(plan.body.pose[:3, 3], (len(scene.times), 1)), **close)
    for i, pose in enumerate(scene.link_poses[-1]):
        _, place = columns[f"/world/hand/{i}", "translation"]
        _, quaternion = columns[f"/world/hand/{i}", "quaternion"]
        x, y, z, w = quaternion[-1]
        corner = np.array([[0.01, 0.02, 0.03]])
        found = turn(np.array([*place[-1], w, x, y, z]), corner)
        np.testing.assert_allclose(found, turn(pose, corner), **close)
    assert any(name.startswith("/world/hand/") for name in static) and "/summary" in static
    _, drifted = columns["/world/simulation/object", "translation"]
    np.testing.assert_allclose(drifted, scene.simulated.object_poses[:, :3], **close)


def test_arrows_turn_with_the_palm_that_carries_them(plan, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    scene = make_scene(plan)
    half = 0.5 * np.linspace(0.0, 1.0, len(scene.times))  # of the angle about x [rad]
    zeros = np.zeros_like(half)
    carried = np.column_stack([half, zeros, zeros, np.cos(half), np.sin(half), zeros, zeros])
    columns, _ = read_columns(write_rerun(replace(scene, carried=carried), tmp_path / "carry.rrd"))
    for k, name in enumerate(scene.contacts):
        start, _ = scene.arrows(-1)[k]
        still = np.array([0, 0, 0, *carried[-1, 3:]])  # directions turn, and do not move
        along = scene.force_scale * scene.forces_o[-1, k]
        for part, expected in (("origins", turn(carried[-1], start)), ("vectors", turn(still, along))):
            np.testing.assert_allclose(columns[f"/world/forces/{name}", part][1][-1], expected, rtol=1e-5, atol=1e-6)


def test_recordings_say_what_they_expect(plan, tmp_path, monkeypatch):
    with pytest.raises(InvalidInput, match=r"\.rrd"):
        plan.save_rerun(tmp_path / "grasp.html")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ExtraMissing, match=r"pip install 'pinograsp\[rerun\]'"):
        plan.save_rerun(tmp_path / "grasp.rrd")
