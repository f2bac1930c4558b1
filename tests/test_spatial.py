"""Frames and rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from pinograsp.spatial import cross, multiply_rows, rotation_rpy, skew, tangent_frame

directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@given(directions)
def test_tangent_frame_is_right_handed_with_x_up(normal):
    R = tangent_frame(normal)
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-12 and np.linalg.det(R) > 0
    assert np.allclose(R[:, 2], np.array(normal) / np.linalg.norm(normal))
    if np.linalg.norm(np.cross(R[:, 2], [0, 0, 1])) > 1e-3:
        assert R[2, 0] > 0 and abs(R[2, 1]) < 1e-12  # x climbs, y is level


def test_tangent_frame_where_the_normal_is_vertical():
    assert np.allclose(tangent_frame([0, 0, -1.0])[:, 0], [1, 0, 0])
    assert np.allclose(tangent_frame([1.0, 0, 0], gravity_o=[-9.81, 0, 0])[:, 0], [0, 1, 0])
    assert np.allclose(tangent_frame([1.0, 0, 0], gravity_o=[0, 0, 0])[:, 0], [0, 0, 1])


@given(directions, directions)
def test_skew_is_the_cross_product(a, b):
    assert np.allclose(skew(np.array(a)) @ b, np.cross(a, b))


@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_rpy_is_the_fixed_axis_convention(rpy):
    assert np.allclose(rotation_rpy(*rpy), Rotation.from_euler("xyz", rpy).as_matrix())


def test_rows_times_a_matrix():
    rng = np.random.default_rng(0)
    rows, matrix = rng.normal(size=(3, 500, 6)), rng.normal(size=(6, 4))
    np.testing.assert_allclose(multiply_rows(rows, matrix), np.einsum("abi,ij->abj", rows, matrix), atol=1e-13)


@pytest.mark.parametrize("shape", [(3,), (4, 3), (2000, 3), (5, 1, 3)])
def test_cross_products_are_numpys(shape):
    rng = np.random.default_rng(5)
    a, b = (
        rng.normal(size=shape),
        rng.normal(size=(3 if len(shape) == 3 else 1, 3))[0 if len(shape) < 3 else slice(None)],
    )
    assert np.array_equal(cross(a, b), np.cross(a, b))
