"""What supports the object until the hand carries it: a table of which the forces are known, and nothing at all."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from marks import slow_except

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.objects import Box, Capsule, Cylinder, Mesh, Sphere
from pinograsp.simulation import simulate
from pinograsp.simulation.settings import SUPPORTS
from pinograsp.simulation.table import Table

MASS, MU, STEP = 0.3, 0.5, 2.5e-4


def bodies():
    wedge = trimesh.convex.convex_hull([[0, 0, 0], [0.06, 0, 0], [0, 0.05, 0], [0.06, 0.05, 0], [0.02, 0.02, 0.08]])
    lying = np.eye(4)
    lying[:3, :3] = pin.exp3(np.array([np.pi / 2, 0, 0]))
    return {
        "sphere": Sphere(radius=0.03, mass=MASS),
        "standing": Cylinder(radius=0.03, height=0.1, mass=MASS),
        "lying": Cylinder(radius=0.03, height=0.1, mass=MASS, pose=lying),
        "capsule": Capsule(radius=0.02, length=0.06, mass=MASS, pose=lying),
        "box": Box(size=(0.04, 0.05, 0.1), mass=MASS),
        "mesh": Mesh(vertices=wedge.vertices, faces=wedge.faces, mass=MASS),
    }


@pytest.mark.parametrize("name", bodies())
def test_it_bears_the_weight_against_any_gravity(name):
    """At rest its force is the weight; deeper it is more, above it none; it only takes energy, and friction is mu."""
    rng = np.random.default_rng(8)
    body = bodies()[name]
    for _ in range(5):
        turn = np.eye(4)
        turn[:3, :3] = pin.exp3(rng.normal(size=3))
        pose, gravity = turn @ np.array(body.pose), turn[:3, :3] @ [0.0, 0.0, -9.81]
        table = Table(body, pose, gravity, MASS, MU, STEP)
        at_rest = table.wrench(pose, np.zeros(6))
        assert at_rest[:3] == pytest.approx(-MASS * gravity, rel=1e-6, abs=1e-9)
        if name != "mesh":  # its corners do not lie evenly about the centre of mass
            assert at_rest[3:] == pytest.approx(np.zeros(3), abs=1e-3 * MASS * 9.81 * body.bounding_radius)
        lower, higher = pose.copy(), pose.copy()
        lower[:3, 3] += 1e-5 * gravity
        higher[:3, 3] -= 1e-4 * gravity
        assert table.wrench(lower, np.zeros(6))[:3] @ table.up > MASS * 9.81
        assert not table.wrench(higher, np.zeros(6)).any()
        twist = rng.normal(size=6)
        assert (table.wrench(pose, twist) - at_rest) @ twist <= 0
        sliding = np.concatenate([np.cross(table.up, rng.normal(size=3)), np.zeros(3)])
        slowed = table.wrench(pose, sliding)[:3]
        assert np.linalg.norm(slowed + MASS * gravity) == pytest.approx(MU * MASS * 9.81, rel=1e-6)
        assert slowed @ sliding[:3] < 0


def test_what_does_not_stand_is_refused():
    box = bodies()["box"]
    leaning = np.eye(4)
    leaning[:3, :3] = pin.exp3(np.array([0.3, 0.0, 0.0]))
    with pytest.raises(InvalidInput, match="mm beside the points"):
        Table(box, leaning, np.array([0, 0, -9.81]), MASS, MU, STEP)
    with pytest.raises(InvalidInput, match="expected gravity"):
        Table(box, np.eye(4), np.zeros(3), MASS, MU, STEP)


@pytest.fixture(scope="module")
def plan():
    """The Panda on a box that stands between its jaws, closed within less than half a second."""
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 0.11
    body = Box(size=(0.04, 0.03, 0.05), mass=0.1, pose=pose)
    conditions = pg.GraspConditions(mu=0.6, final_time=0.4, impact_time_range=(0.2, 0.35))
    return pg.plan_grasp_on(pg.load_hand("panda"), body, conditions)


@pytest.mark.slow
@pytest.mark.parametrize("support", slow_except(SUPPORTS, SUPPORTS[0]))
def test_a_grasp_holds_whatever_bore_the_object_before(plan, support):
    seen = simulate(plan, support=support, hold=0.25, time_step=5e-4)
    assert seen.verdict.held and seen.verdict.force_error < 0.1
    before = seen.times < plan.forces.impact_time
    assert seen.object_poses[before, :3, 3] == pytest.approx(
        np.tile(plan.problem.object.com_o, (before.sum(), 1)), abs=2e-4
    )
    assert any("until the grasp" in note or "nothing but" in note for note in seen.notes) == (support != "fixed")


@pytest.mark.slow
def test_without_any_support_it_falls_where_nothing_holds_it(plan):
    seen = simulate(plan, support="none", hold=0.4, time_step=5e-4, disturbance=pg.simulation.Disturbance(mu=0.0))
    falling = (seen.times > seen.release) & (seen.times < plan.forces.impact_time + 0.05)
    fallen = plan.problem.object.com_o[2] - seen.object_poses[falling, 2, 3]
    assert fallen == pytest.approx(0.5 * 9.81 * (seen.times[falling] - plan.forces.impact_time) ** 2, abs=2e-4)
    assert not seen.verdict.held


@pytest.mark.slow
def test_a_hit_on_the_way_shows_on_the_table_alone(plan):
    """Jaws that start half closed and off the middle push a box that stands freely, and one that is fixed not."""
    beside = pg.simulation.Disturbance(object_offset=[0, 0.012, 0])
    fixed, table = (
        simulate(plan, support=one, hold=0.4, time_step=5e-4, disturbance=beside) for one in ("fixed", "table")
    )
    start = fixed.object_poses[0, :3, 3]
    assert fixed.object_poses[fixed.complete, :3, 3] == pytest.approx(start, abs=1e-12)
    assert np.linalg.norm(table.object_poses[table.complete, :3, 3] - start) > 5e-3
    assert "it had moved by" in table.verdict.reason and "had moved" not in fixed.verdict.reason


def test_supports_that_cannot_be(plan):
    with pytest.raises(InvalidInput, match="support: expected 'fixed' with release=False"):
        simulate(plan, support="table", release=False)
    with pytest.raises(InvalidInput, match="support"):
        simulate(plan, support="hook")


@pytest.mark.slow
def test_the_command_takes_it(command, plan, tmp_path):
    folder = pg.save_run(plan, tmp_path / "run")
    code, _, _ = command("check", str(folder), "--support", "table", "--hold", "0.2", "--time-step", "1e-3")
    assert code == 0 and "stood on a table" in (folder / "check" / "check.json").read_text()
    assert command("check", str(folder), "--support", "hook", "--hold", "0.2")[0] == 2
