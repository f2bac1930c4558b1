"""Contact frames, the grasp map, the contact law, the profile and both energies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import POINTS
from hypothesis import given, strategies as st
from scipy.integrate import quad

from pinograsp.contacts import MarhefkaOrin, PenetrationProfile, contacts_at
from pinograsp.errors import InvalidInput
from pinograsp.objects import Cylinder, Sphere
from pinograsp.spatial import pose_of, rotation_rpy

BALL = Sphere(radius=0.05, mass=1.0, pose=pose_of([0.0, 0.0, 0.1]))


def on_ball(seed, k):
    v = np.random.default_rng(seed).normal(size=(k, 3))
    return BALL.com_o + 0.05 * v / np.linalg.norm(v, axis=1)[:, None]


# -- frames and grasp map ----------------------------------------------------------------------------------------------


def test_paper_contacts_point_to_the_axis(contacts):
    for contact, point in zip(contacts, POINTS.values()):
        radial = -np.array([point[0], point[1], 0])
        assert np.allclose(contact.normal_o, radial / np.linalg.norm(radial))
        assert np.allclose(contact.rotation_oc[:, 0], [0, 0, 1])  # x against gravity
        assert np.array_equal(contact.point_o, point)
        assert -0.16e-3 < contact.distance < 0
    assert contacts.names == ("thumb", "index", "middle")
    assert contacts[0].link == "thumb_distal" and contacts[0].length == pytest.approx(34.80e-3)


def test_grasp_map_sums_forces_and_moments():
    """Eqs. (6), (7): each contact force turned to the world, moments about the centre of mass."""
    contacts = contacts_at(None, BALL, on_ball(0, 5))
    f = np.random.default_rng(1).normal(size=(5, 3))
    force, moment = np.zeros(3), np.zeros(3)
    for contact, f_c in zip(contacts, f):
        h = contact.rotation_oc @ f_c
        force, moment = force + h, moment + np.cross(contact.point_o - BALL.com_o, h)
    assert np.allclose(contacts.G @ f.ravel(), np.concatenate([force, moment]), atol=1e-14)
    assert contacts.G.shape == (6, 15)


@given(st.integers(0, 1000))
def test_grasp_map_moves_with_the_object(seed):
    rng = np.random.default_rng(seed)
    R, t = rotation_rpy(0, 0, rng.uniform(-3, 3)), rng.normal(size=3)  # about gravity: frames turn along
    points = on_ball(seed, 4)
    moved = Sphere(radius=0.05, mass=1.0, pose=pose_of(R @ BALL.com_o + t, R))
    G, G2 = contacts_at(None, BALL, points).G, contacts_at(None, moved, points @ R.T + t).G
    turn = np.block([[R, np.zeros((3, 3))], [np.zeros((3, 3)), R]])
    assert np.abs(turn @ G - G2).max() < 1e-9


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ({"thumb": [0, 0, 0.2]}, {}, "more than the tolerance"),
        ({"thumb": [-2.6, -9.6, 61.5]}, {}, "are the units right"),
        ({"thmb": POINTS["thumb"]}, {}, "did you mean 'thumb'"),
        ({"thumb": [1, 2]}, {}, "shape"),
        ({"thumb": [np.nan, 0, 0]}, {}, "finite"),
        ({}, {}, "at least one"),
        ([POINTS["thumb"]], {}, "expected {finger: point}"),
        ({"thumb": [POINTS["thumb"]] * 2}, {}, "say which links touch"),
        ({"thumb": POINTS["thumb"]}, {"links": {"thumb": ["index_distal"]}}, "link of finger"),
        ({"thumb": [POINTS["thumb"]] * 2}, {"links": {"thumb": ["thumb_distal", "thumb_proximal"]}}, "base to tip"),
        ({"thumb": POINTS["thumb"]}, {"links": {"thumb": ["thumb_distal", "thumb_proximal"]}}, "expected 1 links"),
        ({"thumb": POINTS["thumb"]}, {"lengths": {"thumb": [-1.0]}}, "contact length"),
        ({"thumb": POINTS["thumb"]}, {"lengths": {"thumb": [0.01, 0.02]}}, "expected 1 contact lengths"),
        ({"thumb": POINTS["thumb"]}, {"lengths": {"index": [0.01]}}, "named in lengths"),
    ],
)
def test_bad_contacts_are_refused(hand, cylinder, points, options, message):
    with pytest.raises(InvalidInput, match=message):
        contacts_at(hand, cylinder, points, **options)


def test_several_contacts_per_finger_are_named_by_link(hand):
    wide = Cylinder(radius=0.03, height=0.2, mass=1.0)
    ring = [[0.03 * math.cos(a), 0.03 * math.sin(a), 0.0] for a in (0.0, 0.5, 1.0)]
    contacts = contacts_at(hand, wide, {"index": ring})
    assert [c.link for c in contacts] == ["index_proximal", "index_intermediate", "index_distal"]
    assert contacts.names[0] == "index/index_proximal"
    assert [c.length for c in contacts] == [None, None, pytest.approx(21.36e-3)]


# -- contact law and profile -------------------------------------------------------------------------------------------

settings = st.fixed_dictionaries(
    {
        "A": st.floats(0.01, 2.0),
        "tau": st.floats(0.02, 0.3),
        "K": st.floats(1e3, 1e6),
        "damping": st.floats(0, 1e4),
        "rho": st.floats(0.3, 4.0),
    }
)


def test_contact_law_is_equation_4():
    law = MarhefkaOrin(stiffness=3e4, damping=70, exponent=1.7)
    delta, rate = 2e-3, 0.05
    assert law.normal_force(delta, rate) == pytest.approx((70 * delta**1.7) * rate + 3e4 * delta**1.7, rel=1e-14)
    assert law.normal_force(-1e-3, 0.1) == 0
    assert law.depth(law.normal_force(delta)) == pytest.approx(delta, rel=1e-13)


def test_stiffness_reading_gives_the_published_pair():
    """K = 5e4 N/m^1.5 is the only reading of "50 N/mm" that puts 9.873 N at about 3.3 mm."""
    assert 1e3 * MarhefkaOrin().depth(9.873) == pytest.approx(3.39, abs=0.005)


def profile(v):
    return PenetrationProfile(acceleration=[v["A"]], impact_time=1.0 - v["tau"], final_time=1.0)


@given(settings)
def test_profile_integrates_the_constant_deceleration(v):
    """Eqs. (20)-(24): at rest at t_F, zero depth at t_I, derivative of the depth is the rate. A misprinted sign fails."""
    p = profile(v)
    t = np.linspace(p.impact_time, 1.0, 2001)
    assert p.depth(t)[0, 0] == pytest.approx(0, abs=1e-15) and p.rate(t)[-1, 0] == 0
    assert p.rate(t)[0, 0] == pytest.approx(v["A"] * v["tau"], rel=1e-9) == pytest.approx(p.impact_speed[0], rel=1e-9)
    assert p.depth(t)[-1, 0] == pytest.approx(v["A"] * v["tau"] ** 2 / 2, rel=1e-9)
    assert np.allclose(np.gradient(p.rate(t)[:, 0], t)[1:-1], -v["A"], rtol=1e-6)
    summed = quad(lambda s: float(p.rate(s)[0]), p.impact_time, 1.0)[0]
    assert summed == pytest.approx(p.final_depth[0], rel=1e-9)
    assert p.depth(0.0)[0] == 0 and p.rate(0.0)[0] == 0 and p.depth(2.0)[0] == p.final_depth[0]


@given(settings)
def test_final_force_is_equation_26(v):
    law, p = MarhefkaOrin(stiffness=v["K"], damping=v["damping"], exponent=v["rho"]), profile(v)
    assert law.normal_force(p.depth(1.0), p.rate(1.0))[0] == pytest.approx(
        v["K"] * (v["A"] / 2 * v["tau"] ** 2) ** v["rho"], rel=1e-9
    )


def quadrature(v, integrand):
    """Integrate over w in [0, 1] with s = tau (1 - w^2): smooth at the impact, where delta^rho is not."""
    A, tau, rho = v["A"], v["tau"], v["rho"]

    def of(w):
        s = tau * (1 - w * w)
        delta = A / 2 * (tau - s) * (tau + s)
        return integrand(delta, A * s, (rho + 1) * (v["damping"] * A * s + v["K"]) * delta**rho) * 2 * tau * w

    return quad(of, 0, 1, epsabs=0, epsrel=1e-12, limit=400)[0]


@given(settings)
def test_impulse_is_equation_11_over_time(v):
    law = MarhefkaOrin(stiffness=v["K"], damping=v["damping"], exponent=v["rho"])
    closed = law.impulse(profile(v).final_depth[0], v["tau"])
    assert closed == pytest.approx(quadrature(v, lambda d, r, g: g), rel=1e-10)


@given(settings)
def test_work_is_equation_9_over_depth(v):
    law = MarhefkaOrin(stiffness=v["K"], damping=v["damping"], exponent=v["rho"])
    closed = law.work(profile(v).final_depth[0], v["tau"])
    assert closed == pytest.approx(quadrature(v, lambda d, r, g: g * r), rel=1e-10)


def test_work_integrand_is_the_derivative_of_force_times_depth():
    """Eqs. (8)-(10) at frozen rate: d(F delta)/d(delta) = (rho + 1)(lambda ddelta + K) delta^rho."""
    law, rate, delta, h = MarhefkaOrin(), 0.05, 2e-3, 1e-8
    numerical = ((delta + h) * law.normal_force(delta + h, rate) - (delta - h) * law.normal_force(delta - h, rate)) / (
        2 * h
    )
    assert numerical == pytest.approx(2.5 * (100 * rate + 5e4) * delta**1.5, rel=1e-7)


def test_impulse_constant_at_rho_three_halves():
    law = MarhefkaOrin(stiffness=1.0, damping=0.0, exponent=1.5)
    assert law.impulse(1.0, 1.0) == pytest.approx(1.47262, abs=1e-5)


@given(settings, st.floats(0.1, 10))
def test_energies_are_convex_in_the_force(v, factor):
    law = MarhefkaOrin(stiffness=v["K"], damping=v["damping"], exponent=v["rho"])
    F = np.array([1.0, (1 + factor) / 2, factor])
    for energy in (law.impulse, law.work):
        low, mid, high = energy(law.depth(F), v["tau"])
        assert mid <= (low + high) / 2 * (1 + 1e-9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: MarhefkaOrin(stiffness=0),
        lambda: MarhefkaOrin(damping=-1),
        lambda: MarhefkaOrin(exponent=0),
        lambda: MarhefkaOrin(stiffness=float("nan")),
        lambda: PenetrationProfile(acceleration=[-1.0], impact_time=0.9, final_time=1.0),
        lambda: PenetrationProfile(acceleration=[1.0], impact_time=1.0, final_time=1.0),
    ],
)
def test_bad_laws_are_refused(make):
    with pytest.raises(InvalidInput, match="expected"):
        make()
