"""Deceleration shapes: their antiderivatives, the profile and the energies that follow from them."""

from __future__ import annotations

import math
import pickle
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import quad
from scipy.interpolate import PPoly

from pinograsp.contacts import MEASURES, DecelerationShape, MarhefkaOrin, PenetrationProfile
from pinograsp.contacts.deceleration import CONSTANT
from pinograsp.errors import InvalidInput

SAMPLES = (0.0, 0.4, 2.0, 1.0, 1.2, 0.0)
FALLING = 1 - Polynomial([0, 1])
# Each shape with alpha written out again, and with the places where alpha is not smooth.
CASES = {
    "constant": (CONSTANT, lambda u: np.ones_like(u), ()),
    "rising": (DecelerationShape.linear(0, 3), lambda u: u, ()),
    "falling": (DecelerationShape.linear(2, 0), lambda u: 1 - u, ()),
    "linear": (DecelerationShape.linear(0.5, 2), lambda u: 0.25 + 0.75 * u, ()),
    "hump": (DecelerationShape.polynomial([0, 5, -5]), lambda u: 4 * u * (1 - u), ()),
    "double hump": (DecelerationShape.polynomial([0, 0, 1, -2, 1]), lambda u: 16 * u**2 * (1 - u) ** 2, ()),
    "touching zero": (DecelerationShape.polynomial([0.25, -1, 1]), lambda u: (1 - 2 * u) ** 2, ()),
    "samples": (
        DecelerationShape.from_samples(SAMPLES),
        lambda u: np.interp(u, np.linspace(0, 1, 6), SAMPLES) / 2,
        (0.2, 0.4, 0.6, 0.8),
    ),
    "late": (DecelerationShape.from_samples([0, 0, 1]), lambda u: np.maximum(2 * u - 1, 0), (0.5,)),
    "early": (DecelerationShape.from_samples([1, 0, 0]), lambda u: np.maximum(1 - 2 * u, 0), (0.5,)),
    "jump": (
        DecelerationShape(name="jump", alpha=PPoly([[4.0, 1.0]], [0.0, 0.3, 1.0])),
        lambda u: np.where(u < 0.3, 1.0, 0.25),
        (0.3,),
    ),
}
every_shape = pytest.mark.parametrize("case", CASES)
RHOS = (0.7, 1.0, 1.5, 2.2)
A, TAU, T_F = 0.4, 0.12, 1.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def integral(function, knots):
    """Gauss-Legendre between ``knots``: exact for the piecewise polynomials of this file."""
    return sum((b - a) / 2 * WEIGHTS @ function((a + b) / 2 + (b - a) / 2 * NODES) for a, b in pairwise(knots))


def motion(alpha, knots, t, tau=TAU):
    """Depth [m] and rate [m/s] at t after the impact, from ddelta' = -A alpha and rest at tau, by quadrature."""
    times = tau * np.array([0, *knots, 1])
    later = [t, *times[times > t]]
    rate = integral(lambda x: A * alpha(x / tau), later)
    # The depth is the integral of the rate: by parts, the deceleration at x counts min(x, t) times.
    depth = t * rate + integral(lambda x: x * A * alpha(x / tau), [*times[times < t], t])
    return depth, rate


def by_definition(law, case, integrand, tau=TAU):
    """Integral over time of integrand(rate, (rho + 1)(lambda rate + K) depth^rho); smooth at the impact: t = b w^6."""
    _, alpha, knots = CASES[case]
    times = tau * np.array([0, *knots, 1])

    def of(w, a, b):
        power = 6 if a == 0 else 1
        depth, rate = motion(alpha, knots, a + (b - a) * w**power, tau)
        force = (law.exponent + 1) * (law.damping * rate + law.stiffness) * max(depth, 0.0) ** law.exponent
        return integrand(rate, force) * (b - a) * power * w ** (power - 1)

    return sum(
        quad(of, 0, 1, args=(a, b), epsabs=0, epsrel=1e-12, limit=200, full_output=1)[0] for a, b in pairwise(times)
    )


def profile(shape, tau=TAU):
    return PenetrationProfile(acceleration=[A, 2 * A], impact_time=T_F - tau, final_time=T_F, shape=shape)


def beta(a, b):
    return math.gamma(a) * math.gamma(b) / math.gamma(a + b)


# -- the shape ---------------------------------------------------------------------------------------------------------


@every_shape
def test_shape_is_alpha_and_its_antiderivatives(case):
    shape, alpha, knots = CASES[case]
    u = np.linspace(0, 1, 1001)
    assert np.allclose(shape.acceleration(u), alpha(u), rtol=0, atol=1e-14)
    assert shape.acceleration(u).max() == pytest.approx(1, rel=1e-14)
    expected = np.array([motion(alpha, knots, x, tau=1.0) for x in u]) / A
    assert np.allclose(shape.depth(u), expected[:, 0], rtol=0, atol=1e-15)
    assert np.allclose(shape.rate(u), expected[:, 1], rtol=0, atol=1e-15)
    assert shape.speed_factor == pytest.approx(expected[0, 1], rel=1e-14)
    assert shape.depth_factor == pytest.approx(expected[-1, 0], rel=1e-14)
    # Near the impact the depth keeps its relative accuracy: depth^rho is formed from it.
    assert shape.depth(1e-9) == pytest.approx(1e-9 * shape.speed_factor, rel=1e-8)


@every_shape
def test_shape_is_held_outside_the_grasp_phase(case):
    shape = CASES[case][0]
    for function in (shape.acceleration, shape.rate, shape.depth):
        assert np.array_equal(function([[-1.0, 2.0], [-np.inf, np.inf]]), np.tile(function([0.0, 1.0]), (2, 1)))
        assert np.shape(function(0.5)) == ()
    assert shape.rate(1.0) == 0 and shape.rate(0.0) == shape.speed_factor
    assert shape.depth(0.0) == 0 and shape.depth(1.0) == shape.depth_factor


@pytest.mark.parametrize(
    ("case", "speed", "depth"),
    [("constant", 1, 1 / 2), ("rising", 1 / 2, 1 / 3), ("falling", 1 / 2, 1 / 6), ("hump", 2 / 3, 1 / 3)],
)
def test_known_factors(case, speed, depth):
    shape = CASES[case][0]
    assert shape.speed_factor == pytest.approx(speed, rel=1e-15)
    assert shape.depth_factor == pytest.approx(depth, rel=1e-15)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: DecelerationShape.polynomial([1]), "polynomial of degree 0"),
        (lambda: DecelerationShape.polynomial([7.0, 0.0, 0.0]), "polynomial of degree 2"),
        (lambda: DecelerationShape.from_samples([1, 1]), "2 samples"),
        (lambda: DecelerationShape.from_samples([3.3] * 8), "8 samples"),
        (lambda: DecelerationShape.linear(0.2, 0.2), "linear 1:1"),
        (lambda: DecelerationShape.constant(), "constant"),
    ],
)
def test_constant_by_any_road(make, name):
    shape, u = make(), np.linspace(-0.1, 1.1, 200)
    assert shape.name == name
    assert (shape.speed_factor, shape.depth_factor) == pytest.approx((1, 0.5), rel=1e-15)
    for function in ("acceleration", "rate", "depth"):
        assert np.allclose(getattr(shape, function)(u), getattr(CONSTANT, function)(u), rtol=0, atol=1e-15)
    for rho in RHOS:
        assert shape.impulse_factor(rho) == CONSTANT.impulse_factor(rho)
        assert shape.work_factor(rho) == CONSTANT.work_factor(rho)


def test_linear_by_any_road():
    u = np.linspace(0, 1, 50)
    linear = DecelerationShape.linear(1, 4)
    for shape in (DecelerationShape.polynomial([1, 3]), DecelerationShape.from_samples([1, 2.5, 4])):
        assert np.allclose(shape.depth(u), linear.depth(u), rtol=0, atol=1e-15)
        assert shape.impulse_factor(0.7) == pytest.approx(linear.impulse_factor(0.7), rel=1e-13)
        assert shape.work_factor(0.7) == pytest.approx(linear.work_factor(0.7), rel=1e-13)


def test_samples_of_a_polynomial_converge_to_it():
    hump = CASES["double hump"][0]
    u = np.linspace(0, 1, 77)

    def errors(n):
        shape = DecelerationShape.from_samples(hump.acceleration(np.linspace(0, 1, n)))
        return np.array(
            [
                np.abs(shape.acceleration(u) - hump.acceleration(u)).max(),
                np.abs(shape.depth(u) - hump.depth(u)).max(),
                abs(shape.impulse_factor(1.5) / hump.impulse_factor(1.5) - 1),
                abs(shape.work_factor(1.5) / hump.work_factor(1.5) - 1),
            ]
        )

    coarse, fine = errors(21), errors(201)
    assert np.all(fine < coarse / 50)  # second order: a hundredfold, but for where the places u fall
    assert np.all(fine < 5e-4)


def test_extreme_numbers_stay_in_range():
    assert DecelerationShape.from_samples([1e308, 1e308, 0]).speed_factor == 0.75
    assert DecelerationShape.polynomial([1e308, 1e308]).speed_factor == 0.75
    assert DecelerationShape.linear(1e-320, 0).name == "linear 1:0"


def test_shape_cannot_be_changed_through_its_source():
    source = PPoly(np.array([[1.0], [1.0]]), np.array([0.0, 1.0]), extrapolate="periodic")
    shape = DecelerationShape(name="mine", alpha=source)
    source.c[:] = 0
    assert shape.acceleration(1.0) == 1 and shape.acceleration(0.0) == 0.5


def test_shape_survives_pickling():
    shape = CASES["samples"][0]
    copy = pickle.loads(pickle.dumps(shape))
    assert copy.name == "6 samples" and copy.impulse_factor(1.5) == shape.impulse_factor(1.5)


# -- the factors of the energies ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("rho", [0.05, 0.3, *RHOS, 4.0, 20.0])
@pytest.mark.parametrize("power", [0, 1, 2, 3])
def test_factors_of_a_falling_power_are_beta_functions(power, rho):
    """alpha = (1 - u)^(n - 2) gives sigma = 1 - (1 - u)^n, whose integrals are known; n = 2 is the constant."""
    shape, n = DecelerationShape.polynomial((FALLING**power).coef), power + 2
    assert shape.impulse_factor(rho) == pytest.approx((rho + 1) * beta(1 / n, rho + 1) / n, rel=1e-12, abs=0)
    assert shape.work_factor(rho) == pytest.approx((rho + 1) * n * beta(2 - 1 / n, rho + 1), rel=1e-12, abs=0)


def test_factors_at_rho_one_are_rational():
    """sigma = (3 u - u^3) / 2 while the deceleration rises from zero."""
    rising = CASES["rising"][0]
    assert rising.impulse_factor(1) == pytest.approx(5 / 4, rel=1e-13)
    assert rising.work_factor(1) == pytest.approx(33 / 32, rel=1e-13)


def test_factors_are_computed_once():
    shape = DecelerationShape.polynomial([0, 1, 0, -1])
    assert shape.impulse_factor(1.5) is shape.impulse_factor(1.5)
    assert shape.work_factor(1.5) is shape.work_factor(1.5)


@pytest.mark.parametrize("rho", RHOS)
@every_shape
def test_energies_are_equations_9_and_11(case, rho):
    shape = CASES[case][0]
    depth = profile(shape).final_depth[0]
    for damping in (0.0, 3e4):  # the latter weighs about as much as the stiffness
        law = MarhefkaOrin(stiffness=2e3, damping=damping, exponent=rho)
        impulse, work = (by_definition(law, case, of) for of in (lambda r, g: g, lambda r, g: g * r))
        assert law.impulse(depth, TAU, shape) == pytest.approx(impulse, rel=1e-10, abs=0)
        assert law.work(depth, TAU, shape) == pytest.approx(work, rel=1e-10, abs=0)


@pytest.mark.parametrize("rho", RHOS)
@pytest.mark.parametrize("damping", [0.0, 100.0])
@every_shape
def test_powers_sum_to_the_energies(case, damping, rho):
    shape, law = CASES[case][0], MarhefkaOrin(stiffness=4e4, damping=damping, exponent=rho)
    F = np.array([0.01, 1.0, 9.873, 200.0])
    for measure in MEASURES:
        energy = getattr(law, measure)
        terms = law.powers(measure, TAU, shape)
        assert len(terms) == (1 if damping == 0 else 2)
        assert all(c > 0 and e >= 1 for c, e in terms)
        assert sum(c * F**e for c, e in terms) == pytest.approx(energy(law.depth(F), TAU, shape), rel=1e-12, abs=0)


def test_energies_are_of_constant_deceleration_unless_told():
    law, F = MarhefkaOrin(), 5.0
    for measure in MEASURES:
        energy = getattr(law, measure)
        assert energy(law.depth(F), TAU) == energy(law.depth(F), TAU, CONSTANT)
        assert law.powers(measure, TAU) == law.powers(measure, TAU, CONSTANT)
    assert law.powers("impulse", TAU)[-1] == pytest.approx((1.47262 * TAU, 1), abs=1e-6)


# -- the profile -------------------------------------------------------------------------------------------------------


@every_shape
def test_profile_follows_the_shape(case):
    shape, alpha, knots = CASES[case]
    p = profile(shape)
    t = np.linspace(p.impact_time, T_F, 4002)[1:-1]
    depth, rate = p.depth(t), p.rate(t)
    h = 1e-6
    assert depth.shape == rate.shape == (4000, 2) and p.depth(0.95).shape == (2,)
    smooth = np.all([np.abs(t - (p.impact_time + TAU * k)) > 2 * h for k in knots], axis=0)
    inside = smooth & (t > p.impact_time + 2 * h) & (t < T_F - 2 * h)
    t = t[inside]
    assert np.allclose((p.depth(t + h) - p.depth(t - h)) / (2 * h), rate[inside], rtol=0, atol=1e-9)
    deceleration = -np.array([A, 2 * A]) * alpha((t - p.impact_time) / TAU)[:, None]
    assert np.allclose((p.rate(t + h) - p.rate(t - h)) / (2 * h), deceleration, rtol=0, atol=1e-7)
    assert np.all(np.diff(depth, axis=0) >= -1e-17) and np.all(np.diff(rate, axis=0) <= 1e-16)


@every_shape
def test_profile_starts_at_the_impact_and_ends_at_rest(case):
    shape = CASES[case][0]
    p = profile(shape)
    assert np.array_equal(p.impact_speed, p.rate(p.impact_time)) and np.all(p.depth(p.impact_time) == 0)
    assert np.allclose(p.impact_speed, shape.speed_factor * p.acceleration * p.duration, rtol=1e-14)
    assert np.allclose(p.final_depth, shape.depth_factor * p.acceleration * p.duration**2, rtol=1e-14)
    for t in (T_F, T_F + 1.0):
        assert np.all(p.rate(t) == 0) and np.array_equal(p.depth(t), p.final_depth)
    assert np.all(p.rate(0.5) == 0) and np.all(p.depth(0.5) == 0)
    law = MarhefkaOrin()
    assert np.allclose(law.normal_force(p.depth(T_F), p.rate(T_F)), law.stiffness * p.final_depth**1.5, rtol=1e-14)


def test_profile_is_of_constant_deceleration_unless_told():
    p = PenetrationProfile(acceleration=[A], impact_time=0.9, final_time=T_F)
    t = np.linspace(0.9, T_F, 100)
    assert p.shape is CONSTANT
    assert np.allclose(p.depth(t)[:, 0], A / 2 * (p.duration**2 - (T_F - t) ** 2), rtol=0, atol=1e-17)
    assert np.allclose(p.rate(t)[:, 0], A * (T_F - t), rtol=0, atol=1e-16)


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DecelerationShape.linear(-1, 1), "at the impact: expected a finite number >= 0, got -1"),
        (lambda: DecelerationShape.linear(1, float("nan")), "at the end: expected a finite number >= 0, got nan"),
        (lambda: DecelerationShape.linear("steep", 1), "got 'steep'"),
        (lambda: DecelerationShape.linear(0, 0), "expected a start or an end above 0.*give at least one"),
        (lambda: DecelerationShape.polynomial([]), "expected at least 1 numbers, got 0: give coefficients"),
        (lambda: DecelerationShape.polynomial([1, np.nan]), "expected finite numbers.*give coefficients"),
        (lambda: DecelerationShape.polynomial([[1, 2]]), "expected shape.*give coefficients"),
        (lambda: DecelerationShape.polynomial("u"), "got 'u'.*give coefficients"),
        (lambda: DecelerationShape.polynomial([0, 0]), "got zero everywhere: give at least one positive value"),
        (lambda: DecelerationShape.polynomial([1, -2]), "expected >= 0 on .* got -1 at u = 1: .* add at least 1 "),
        # Negative between its ends only.
        (lambda: DecelerationShape.polynomial([0.2, -1, 1]), "got -0.05 at u = 0.5: .* add at least 0.05"),
        (lambda: DecelerationShape.polynomial([-1]), "got -1 at u = 0"),
        (lambda: DecelerationShape.from_samples([1.0]), "expected at least 2 numbers, got 1: give two or more"),
        (lambda: DecelerationShape.from_samples([1.0, np.inf]), "expected finite numbers.*give two or more"),
        (lambda: DecelerationShape.from_samples([5, 1, -2, 1]), "expected values >= 0, got -2 at index 2.*raise"),
        (lambda: DecelerationShape.from_samples([0, 0, 0]), "got zero everywhere"),
        (lambda: DecelerationShape(name="x", alpha=[1.0]), "expected a real, scalar .*PPoly.*build it with"),
        (lambda: DecelerationShape(name="x", alpha=PPoly([[1.0 + 1j]], [0, 1])), "expected a real, scalar"),
        (lambda: DecelerationShape(name="x", alpha=PPoly([[[1.0, 2.0]]], [0, 1])), "expected a real, scalar"),
        (lambda: DecelerationShape(name="x", alpha=PPoly([[1.0]], [0, 2])), "rising from 0 to 1, got 0 to 2"),
        (lambda: DecelerationShape(name="x", alpha=PPoly([[1.0]], [1, 0])), "rising from 0 to 1, got 1 to 0"),
        (lambda: DecelerationShape(name="x", alpha=PPoly([[np.inf]], [0, 1])), "expected finite coefficients"),
        # Negative at the end of the first of two pieces, where the second already counts.
        (lambda: DecelerationShape(name="x", alpha=PPoly([[-4, 0], [1, 1.0]], [0, 0.5, 1])), "got -1 at u = 0.5"),
        (lambda: CONSTANT.impulse_factor(0), "exponent rho: expected a finite number > 0, got 0"),
        (lambda: CASES["rising"][0].work_factor(-0.5), "exponent rho: expected a finite number > 0, got -0.5"),
        (lambda: profile("linear"), "expected a DecelerationShape, got 'linear': build one with"),
        (lambda: MarhefkaOrin().powers("impuls", TAU), "did you mean 'impulse'"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(InvalidInput, match=message):
        make()
