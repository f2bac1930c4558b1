"""Hertz's contact stiffness from materials and curvatures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import quad

from pinograsp.contacts import hertz
from pinograsp.errors import InvalidInput
from pinograsp.objects import Cylinder, Ellipsoid

MATERIALS = {"young": (2.0e5, 3.0e9), "poisson": (0.48, 0.35)}  # a silicone fingertip on a plastic cup
MODULUS = 1 / ((1 - 0.48**2) / 2.0e5 + (1 - 0.35**2) / 3.0e9)
PLANE = (0.0, 0.0)


def stiffness(*curvatures, angle=0.0, **materials):
    return hertz(**{**MATERIALS, **materials}, curvatures=curvatures, angle=angle).stiffness


def test_spheres_and_planes_are_the_closed_form():
    for r1, r2 in ((0.01, 0.03), (0.005, 0.005)):
        assert stiffness((1 / r1, 1 / r1), (1 / r2, 1 / r2)) == pytest.approx(
            4 / 3 * MODULUS * np.sqrt(r1 * r2 / (r1 + r2)), rel=1e-14
        )
    assert stiffness((100, 100), PLANE) == pytest.approx(4 / 3 * MODULUS * 0.1, rel=1e-14)
    # A ball in a hollow: R = 1 / (1/0.01 - 1/0.012).
    assert stiffness((100, 100), (-1 / 0.012,) * 2) == pytest.approx(4 / 3 * MODULUS * np.sqrt(0.06), rel=1e-13)


def test_crossed_equal_cylinders_are_a_sphere_on_a_plane():
    assert stiffness((0, 50), (0, 50), angle=np.pi / 2) == pytest.approx(stiffness((50, 50), PLANE), rel=1e-14)


def test_cylinders_crossed_at_an_angle_are_an_ellipsoid_on_a_plane():
    # Two unit curvatures across axes at 60 degrees: the sum of their forms has eigenvalues 1 -+ cos 60.
    assert stiffness((0, 1), (0, 1), angle=np.pi / 3) == pytest.approx(stiffness((0.5, 1.5), PLANE), rel=1e-14)


def test_the_law_is_that_of_the_contact():
    law = hertz(**MATERIALS, curvatures=[(100, 100), PLANE], damping=3.0)
    assert (law.exponent, law.damping) == (1.5, 3.0)
    assert law.normal_force(1e-3) == pytest.approx(4 / 3 * MODULUS * np.sqrt(0.01) * 1e-3**1.5)


# T. A. Harris, Rolling Bearing Analysis, Table 6.1: (B - A) / (B + A) and the dimensionless approach delta*, for
# delta = delta* (3 Q / (2 S E*))^(2/3) S / 2 with the curvature sum S = 2 (A + B).
HARRIS = [
    (0.0, 1.0),
    (0.1075, 0.9974),
    (0.3204, 0.9761),
    (0.4795, 0.9429),
    (0.5916, 0.9077),
    (0.6716, 0.8733),
    (0.7332, 0.8394),
    (0.7948, 0.7961),
    (0.83495, 0.7602),
    (0.87366, 0.7169),
    (0.90999, 0.6636),
    (0.93657, 0.6112),
    (0.95738, 0.5551),
    (0.97290, 0.4960),
    (0.983797, 0.4352),
]


@pytest.mark.parametrize("difference, approach", HARRIS)
def test_elliptic_contacts_are_the_published_table(difference, approach):
    total = 240.0
    slow, fast = total * (1 - difference) / 2, total * (1 + difference) / 2
    load = 7.0
    published = approach * (3 * load / (2 * total * MODULUS)) ** (2 / 3) * total / 2
    found = (load / stiffness((slow, fast), PLANE)) ** (2 / 3)
    assert found == pytest.approx(published, rel=1e-3)  # the table has three to four digits


@pytest.mark.parametrize("a, b", [(1.0, 0.999), (1.0, 0.5), (1.0, 0.1), (1.0, 0.01)])
def test_elliptic_contacts_solve_the_integral_equation(a, b):
    """Boussinesq's half-space under Hertz's pressure, summed numerically, sinks as delta - A x^2 - B y^2."""
    x_nodes, x_weights = np.polynomial.legendre.leggauss(40)
    v, weights = (x_nodes + 1) / 2, x_weights / 2

    def sink(x, y):  # times pi E* / p0
        def ray(phi):
            # The pressure along a ray is sqrt(c0 + c1 s + c2 s^2), zero at its end: s = end (1 - v^2) makes it smooth.
            along = np.cos(phi) / a, np.sin(phi) / b
            c0, c1 = 1 - (x / a) ** 2 - (y / b) ** 2, -2 * (x / a * along[0] + y / b * along[1])
            c2 = -(along[0] ** 2 + along[1] ** 2)
            end = (-c1 - np.sqrt(c1**2 - 4 * c0 * c2)) / (2 * c2)
            s = end * (1 - v**2)
            return np.sum(weights * 2 * v * end * np.sqrt(np.maximum(c0 + c1 * s + c2 * s**2, 0.0)))

        points = [0.0, np.pi / 2, np.pi, 3 * np.pi / 2, 2 * np.pi]
        return sum(quad(ray, low, high, epsabs=1e-11, epsrel=1e-11)[0] for low, high in pairwise(points))

    depth = sink(0, 0)
    slow, fast = (depth - sink(a / 2, 0)) / (a / 2) ** 2, (depth - sink(0, b / 2)) / (b / 2) ** 2
    assert depth - sink(a / 3, b / 4) == pytest.approx(slow * (a / 3) ** 2 + fast * (b / 4) ** 2, rel=1e-7)
    scale = 1 / (np.pi * MODULUS)  # at p0 = 1 Pa
    expected = 2 / 3 * np.pi * a * b / (scale * depth) ** 1.5
    assert stiffness((2 * scale * slow, 2 * scale * fast), PLANE) == pytest.approx(expected, rel=1e-7)


curvature = st.floats(1.0, 1e3)


@pytest.mark.slow
@given(curvature, curvature, curvature, curvature, st.floats(0, np.pi), st.floats(0.01, 100))
def test_scaling_and_symmetry(a, b, c, d, angle, scale):
    first, second = sorted((a, b)), sorted((c, d))
    found = stiffness(first, second, angle=angle)
    assert stiffness(second, first, angle=angle) == pytest.approx(found, rel=1e-12)  # the materials only meet in E*
    assert stiffness(first, second, angle=-angle) == pytest.approx(found, rel=1e-9)
    scaled = stiffness([scale * k for k in first], [scale * k for k in second], angle=angle)
    assert scaled == pytest.approx(found / np.sqrt(scale), rel=1e-9)
    stiffer = stiffness(first, second, angle=angle, young=(4.0e5, 6.0e9))
    assert stiffer == pytest.approx(2 * found, rel=1e-12)
    # The circular contact of the same mean curvature is the softest (Harris's delta* is at most 1).
    assert found >= 4 / 3 * MODULUS * np.sqrt(2 / (sum(first) + sum(second))) * (1 - 1e-12)


def test_very_slim_contacts_grow_stiffer_slowly():
    found = [stiffness((1.0, ratio), PLANE) for ratio in (1, 1 + 1e-14, 1 + 1e-6, 1e2, 1e4, 1e6, 1e8)]
    assert np.all(np.diff(found) <= 0) and found[0] == pytest.approx(found[2], rel=1e-6) and found[-1] > 0.1 * found[0]


def test_the_curvatures_of_two_shapes_give_their_contact():
    fingertip = Ellipsoid(semi_axes=[0.012, 0.007, 0.008], density=1160)
    cup = Cylinder(radius=0.03, height=0.1, mass=0.2)
    (k1,), (t1,) = fingertip.curvature([[0, 0.007, 0]])
    (k2,), (t2,) = cup.curvature([[0, -0.03, 0]])
    angle = np.arccos(np.clip(t1 @ t2, -1, 1))
    # The fingertip's long axis is across the cup's: 1/R1 = b/a^2 + 1/r, 1/R2 = b/c^2.
    across, along = 0.007 / 0.012**2 + 1 / 0.03, 0.007 / 0.008**2
    assert stiffness(k1, k2, angle=angle) == pytest.approx(stiffness(sorted((across, along)), PLANE), rel=1e-12)


@pytest.mark.parametrize(
    "curvatures, angle, match",
    [
        ([(0, 100), PLANE], 0.0, "line"),
        ([(0, 100), (0, 50)], 0.0, "line"),
        ([PLANE, PLANE], 0.3, "area"),
        ([(100, 100), (-100, -100)], 0.0, "area"),
        ([(50, 100), (-80, 0)], 0.0, "hollow"),
        ([(0, 1 / 0.03), (0, 1 / 0.03)], np.pi, "line"),
    ],
)
def test_contacts_that_are_not_points_are_refused(curvatures, angle, match):
    with pytest.raises(InvalidInput, match=match) as caught:
        stiffness(*curvatures, angle=angle)
    assert "curvature in both directions" in str(caught.value) and "crown" in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"young": (0.0, 1e9)},
        {"young": 1e9},
        {"young": (np.nan, 1e9)},
        {"poisson": (0.3, 0.6)},
        {"poisson": (-1.0, 0.3)},
        {"curvatures": [1, 2, 3, 4]},
        {"angle": np.inf},
        {"damping": -1.0},
    ],
)
def test_bad_input_is_refused(change):
    with pytest.raises(InvalidInput, match="expected"):
        hertz(**{**MATERIALS, "curvatures": [(100, 100), PLANE], **change})
