"""Areas that convex shapes have in common when they touch, as the compiled core finds them."""

import coal
import numpy as np
import pytest

from pinograsp import core
from pinograsp.contacts.compiled import support_shape

LEAN = 0.01  # [rad]


def pose_of(placed):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = placed
    return pose


def areas_of(one, placed_one, other, placed_other):
    """What two of coal's shapes, placed (R, p), have in common where they touch: corners, leanings, and the point."""
    scene = core.load().Scene(0, np.eye(4), pose_of(placed_other))
    scene.add_part(-1, pose_of(placed_one), 0, *support_shape(one), np.zeros((0, 3, 3)))
    scene.add_solid(*support_shape(other))
    found = scene.touch(np.zeros((1, 0)), np.eye(4)[None], tolerance=1e-5, lean=LEAN, gravity=np.zeros(3))
    assert len(found.gap) == 1 and abs(found.gap[0]) < 1e-9
    count = found.counts[0]
    return found.corners.reshape(4, 3)[:count], found.leaning[:count], found.points


def corners_of(*placed):
    return areas_of(*placed)[0]


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def below(height):
    return np.eye(3), np.array([0.0, 0.0, -height / 2])


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.7, 1.2])
def test_a_small_plate_on_a_large_one_has_its_own_corners(angle):
    found = corners_of(coal.Box(0.02, 0.01, 0.004), (turned(angle), below(0.004)[1]), coal.Box(0.1, 0.1, 0.02), above())
    expected = np.array([[x, y] for x in (-0.01, 0.01) for y in (-0.005, 0.005)]) @ turned(angle)[:2, :2].T
    assert len(found) == 4
    for corner in expected:
        assert np.linalg.norm(found[:, :2] - corner, axis=1).min() < 4e-4


def above():
    return np.eye(3), np.array([0.0, 0.0, 0.01])


def test_plates_that_overlap_have_the_overlap():
    shifted = np.eye(3), np.array([0.03, 0.02, 0.01])
    found = corners_of(coal.Box(0.04, 0.04, 0.004), below(0.004), coal.Box(0.04, 0.04, 0.02), shifted)
    expected = np.array([[x, y] for x in (0.01, 0.02) for y in (0.0, 0.02)])
    assert len(found) == 4
    for corner in expected:
        assert np.linalg.norm(found[:, :2] - corner, axis=1).min() < 4e-4


def test_crossed_plates_have_the_square_in_the_middle():
    found = corners_of(
        coal.Box(0.1, 0.02, 0.004), below(0.004), coal.Box(0.1, 0.02, 0.02), (turned(np.pi / 2), np.array([0, 0, 0.01]))
    )
    assert len(found) == 4 and np.allclose(np.abs(found[:, :2]), 0.01, atol=4e-4)


def test_a_ball_touches_at_a_point_and_a_lying_capsule_along_a_line():
    ball = corners_of(coal.Sphere(0.012), (np.eye(3), np.array([0, 0, -0.012])), coal.Box(0.1, 0.1, 0.02), above())
    assert ball.shape == (1, 3) and np.abs(ball).max() < 4e-4
    lying = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    line = corners_of(coal.Capsule(0.01, 0.04), (lying, np.array([0, 0, -0.01])), coal.Box(0.1, 0.1, 0.02), above())
    assert len(line) == 2 and np.allclose(np.sort(line[:, 0]), [-0.02, 0.02], atol=4e-4)


def test_the_end_of_a_cylinder_is_an_area_and_its_side_a_line():
    end = corners_of(coal.Cylinder(0.01, 0.03), below(0.03), coal.Box(0.1, 0.1, 0.02), above())
    assert len(end) == 4 and np.allclose(np.linalg.norm(end[:, :2], axis=1), 0.01, atol=4e-4)
    lying = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    side = corners_of(coal.Cylinder(0.01, 0.03), (lying, np.array([0, 0, -0.01])), coal.Box(0.1, 0.1, 0.02), above())
    # A circle of 48 corners has flats of 1.3 mm.
    assert np.allclose(np.abs(side[:, 0]), 0.015, atol=4e-4) and np.abs(side[:, 1]).max() < 1.2e-3


def test_edges_that_cross_leave_the_point():
    c = np.sqrt(0.5)
    along_x, along_y = np.array([[1, 0, 0], [0, c, -c], [0, c, c]]), np.array([[c, 0, c], [0, 1, 0], [-c, 0, c]])
    half = 0.02 * np.sqrt(2)
    cube = coal.Box(0.04, 0.04, 0.04)
    found, _, point = areas_of(cube, (along_x, np.array([0, 0, -half])), cube, (along_y, np.array([0, 0, half])))
    assert found.shape == (1, 3) and np.abs(found).max() < 4e-4 and np.abs(point).max() < 1e-6


def test_a_tilt_beyond_what_pressing_closes_leaves_an_edge():
    tilt = np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    found = corners_of(coal.Box(0.04, 0.04, 0.004), (tilt, -tilt @ [0, 0.02, 0.002]), coal.Box(0.1, 0.1, 0.02), above())
    assert len(found) == 2 and np.allclose(np.sort(found[:, 0]), [-0.02, 0.02], atol=4e-4)


def test_faces_that_lean_a_little_are_apart_by_what_they_lean():
    angle = 0.006
    tilt = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    found, leaning, _ = areas_of(
        coal.Box(0.04, 0.04, 0.004), (tilt, -tilt @ [0, 0.02, 0.002]), coal.Box(0.1, 0.1, 0.02), above()
    )
    assert len(found) == 4
    far = found[:, 1] < -0.03
    assert far.sum() == 2 and np.allclose(leaning[far], 0.04 * angle, rtol=0.05)
    assert np.allclose(leaning[~far], 0.0, atol=1e-6)


def test_unknown_shapes_have_no_points():
    assert support_shape(coal.Cone(0.01, 0.02)).points.size == 0
