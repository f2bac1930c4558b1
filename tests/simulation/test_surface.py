"""Objects that are not convex: overlaps with their own triangles, by closed forms and by the convex way."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from swinging_shape import CENTRE, SHAPES, engine, pose, width

import pinograsp as pg
from pinograsp.objects import Box, Mesh
from pinograsp.planner import plan_best
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.pinocchio_engine import PinocchioEngine

ENGINES = pytest.mark.parametrize("kind", [MujocoEngine, PinocchioEngine])
RADIUS = 0.01
# Of coal's depths [m]: of convex pairs too they come to within about the tolerance of its iteration, 1 um, of the width.
ACCURACY = {"box": 1e-9, "hull": 1e-9, "cylinder": 5e-6}
# Outlines, counter-clockwise, and their triangles: a channel 24 mm wide and 36 mm deep with walls of 8 mm, and a
# corner of two walls as thick.
CHANNEL = 1e-3 * np.array([[0, 0], [40, 0], [40, 44], [32, 44], [32, 8], [8, 8], [8, 44], [0, 44]])
OF_CHANNEL = [(0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4), (0, 5, 6), (0, 6, 7)]
CORNER = 1e-3 * np.array([[0, 0], [60, 0], [60, 8], [8, 8], [8, 60], [0, 60]])
OF_CORNER = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


def prism(outline, triangles, *, height: float = 0.08) -> tuple[Mesh, np.ndarray]:
    """A prism about z = 0, and where the outline's origin is in its frame (3,)."""
    k = len(outline)
    ends = [np.column_stack([outline, np.full(k, z)]) for z in (-0.5 * height, 0.5 * height)]
    faces = [(c, b, a) for a, b, c in triangles] + [(a + k, b + k, c + k) for a, b, c in triangles]
    for i in range(k):
        j = (i + 1) % k
        faces += [(i, j, j + k), (i, j + k, i + k)]
    made = Mesh(vertices=np.vstack(ends), faces=np.array(faces), mass=0.1)
    return made, -made.com_b


def touching(made, where_b):
    """Touches with the hand's shape at a place (2,) of the outline; its axes are the world's."""
    made.place(np.zeros(1), np.zeros(1), pose(np.eye(3), CENTRE - where_b))
    return made.touches()


@ENGINES
def test_a_peg_in_a_channel_touches_nothing_until_it_reaches_a_wall(kind):
    body, origin = prism(CHANNEL, OF_CHANNEL)
    made = engine(kind, coal.Capsule(RADIUS, 0.03), body)
    assert any("own triangles" in note for note in made.notes)
    for x in (0.0181, 0.02, 0.0219):
        assert touching(made, origin + [x, 0.03, 0.0]).part.size == 0
    for depth in (1e-6, 3e-5, 4e-4, 1e-3):
        seen = touching(made, origin + [0.018 - depth, 0.03, 0.0])
        assert set(seen.part) == {1}
        np.testing.assert_allclose(seen.depth, depth, atol=1e-9)
        np.testing.assert_allclose(seen.normal_o, np.tile([-1.0, 0, 0], (seen.depth.size, 1)), atol=1e-6)
        # On the wall, along the capsule's straight part.
        at = seen.point_o - CENTRE + [0.018 - depth, 0.03, 0.0]
        np.testing.assert_allclose(at[:, :2], np.tile([0.008, 0.03], (len(at), 1)), atol=1e-7)
        np.testing.assert_allclose(np.sort(at[:, 2]), [-0.015, 0.015], atol=1e-7)


def test_the_other_wall_of_a_tight_channel_does_not_hide_the_one_that_is_touched():
    body, origin = prism(CHANNEL, OF_CHANNEL)
    for radius in (0.0119, 0.01198):  # of 12 mm
        made = engine(PinocchioEngine, coal.Sphere(radius), body)
        for depth in (1e-5, 5e-5, 1.5e-4):
            seen = touching(made, origin + [0.008 + radius - depth, 0.03, 0.0])
            np.testing.assert_allclose(seen.depth, [depth], atol=1e-9)
            np.testing.assert_allclose(seen.normal_o, [[-1.0, 0, 0]], atol=1e-6)


@ENGINES
@pytest.mark.parametrize("a, b", [(1e-4, -5e-5), (1e-4, 0.0), (1e-4, 1e-6), (1e-4, 9.9e-5), (2e-5, 3e-4), (5e-4, 5e-4)])
def test_a_ball_in_a_corner_is_pushed_out_of_both_walls(kind, a, b):
    body, origin = prism(CORNER, OF_CORNER)
    made = engine(kind, coal.Sphere(RADIUS), body)
    shift = np.array([max(a, 0), max(b, 0), 0.0])
    seen = touching(made, origin + [0.008 + RADIUS - a, 0.008 + RADIUS - b, 0.0])
    np.testing.assert_allclose(seen.depth, [np.linalg.norm(shift)], atol=1e-9)
    np.testing.assert_allclose(seen.normal_o, [-shift / np.linalg.norm(shift)], atol=1e-5)


def test_depths_do_not_jump_where_a_ball_rolls_along_the_facets_of_a_hollow():
    tube = trimesh.creation.annulus(r_min=0.03, r_max=0.04, height=0.1, sections=24)
    body = Mesh(vertices=tube.vertices, faces=tube.faces, mass=0.1)
    made = engine(PinocchioEngine, coal.Sphere(RADIUS), body)
    # Facets at the distance cos(pi / 24) r of the axis; the ball is 0.2 mm in the ones in the middle of which it is.
    reach, step = 0.03 * np.cos(np.pi / 24) - RADIUS + 2e-4, np.radians(0.1)
    depths = []
    for angle in np.arange(0, np.radians(35), step):
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        seen = touching(made, reach * way)
        assert seen.depth.size == 1
        depths.append(seen.depth[0])
    assert np.abs(np.diff(depths)).max() < 1.5 * step * reach * np.sin(np.pi / 24)
    assert max(depths) == pytest.approx(2e-4, abs=1e-9)


@pytest.mark.parametrize("shape", sorted(SHAPES))
@pytest.mark.no_cover
def test_where_a_surface_is_that_of_a_box_so_are_the_overlaps(shape):
    """A bar with a short arm at its far end, against the box that the bar is: flat areas, edges and corners."""
    arm = 1e-3 * np.array([[0, 0], [200, 0], [200, 60], [190, 60], [190, 40], [0, 40]])
    body, origin = prism(arm, [(0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4)], height=0.06)
    bar = Box(size=(0.2, 0.04, 0.06), mass=0.1)
    middle = origin + [0.1, 0.02, 0.0]
    ours, theirs = (engine(PinocchioEngine, SHAPES[shape], one) for one in (body, bar))
    assert ours.collider.surface is not None and theirs.collider.surface is None
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(150):
        # Around the bar's near end, mostly a little inside.
        R = pin.exp3(2 * rng.normal(size=3)) if rng.random() < 0.7 else np.eye(3)
        local = np.array([-0.1, 0.02, 0.03]) * rng.choice([1.0, 0.6], 3) + rng.normal(size=3) * 3e-3
        at = CENTRE - R @ local
        q, way = np.zeros(1), R @ np.array([1.0, -0.5, -0.5])
        for _ in range(400):  # until clear, then back in
            theirs.place(q, q, pose(R, at))
            inside = theirs.touches().depth
            if not inside.size:
                break
            at = at + max(2e-4, 0.5 * inside.max()) * way
        else:
            continue
        for back in (1e-4, 2e-4, 3e-4):
            other_at = at - back * way
            for made, shift in ((theirs, np.zeros(3)), (ours, middle)):
                made.place(q, q, pose(R, other_at - R @ shift))
            mine, other = ours.touches(), theirs.touches()
            if not other.part.size:
                assert mine.depth.max(initial=0.0) < 1e-7
                continue
            compared += 1
            i, k = mine.depth.argmax(), other.depth.argmax()
            # Areas are within half a percent of the depth.
            within = ACCURACY.get(shape, 1e-6) + 5e-3 * other.depth.max() * (mine.part.size > 1 or other.part.size > 1)
            assert mine.depth.max() < other.depth.max() + within
            if shape in ("ellipsoid", "sphere"):
                assert mine.depth.max() == pytest.approx(other.depth.max(), abs=within)
                np.testing.assert_allclose(mine.normal_o[i], other.normal_o[k], atol=1e-3)
            elif mine.part.size == 1:  # the overlap's width along a normal is a closed form, and the least counts
                widths = [
                    n @ CENTRE + width(SHAPES[shape], n) - n @ other_at + np.abs(R.T @ n) @ [0.1, 0.02, 0.03]
                    for n in (mine.normal_o[i], other.normal_o[k])
                ]
                assert mine.depth[0] == pytest.approx(widths[0], abs=ACCURACY.get(shape, 1e-6))
                assert mine.depth[0] < widths[1] + within
            # On a face, not an edge. Which corners of a round face stand for it hangs on rounding.
            if shape != "cylinder" and np.abs(R.T @ other.normal_o[k]).max() > 0.9999:
                assert mine.part.size == other.part.size
                assert mine.depth.sum() == pytest.approx(other.depth.sum(), abs=1e-7)
    assert compared > 100


@pytest.fixture(scope="module")
def beaker_plan():
    beaker = trimesh.creation.annulus(r_min=0.052, r_max=0.06, height=0.06, sections=48)
    body = Mesh(vertices=beaker.vertices, faces=beaker.faces, density=300.0)
    conditions = pg.GraspConditions(mu=0.6)
    return plan_best(pg.find_grasps(pg.load_hand("panda"), body, conditions, count=16, seed=5, jobs=1), conditions)


@pytest.mark.slow
@ENGINES
@pytest.mark.no_cover
def test_a_beaker_too_wide_for_the_jaws_is_held_by_its_wall(kind, beaker_plan):
    """One jaw inside, one outside; in the hull there is no inside."""
    plan = beaker_plan
    name = "mujoco" if kind is MujocoEngine else "pinocchio"
    seen = pg.simulate(plan, hold=0.2, time_step=5e-4, engine=name)
    assert seen.verdict.held
    assert seen.verdict.force_error < 0.3
    assert seen.normal_forces[seen.times < plan.forces.impact_time - 5e-3].max() < 0.2
