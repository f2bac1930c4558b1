"""Calibration of taxels: known curves come back, saturation and hysteresis are seen, presses that were left out are told."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp.errors import InvalidInput
from pinograsp.identification import find_lag, identify_taxel

CURVES = {
    "resistive, falls": (lambda f: 5000 / (1 + f), 1.0, -1),
    "magnetic, rises": (lambda f: -300 + 800 * np.sqrt(f), 10.0, 1),
    "capacitive, straight": (lambda f: 100 + 40 * f, 25.0, 1),
}


def press(curve, most, *, count=8, samples=150, noise=0.0, hysteresis=0.0, seed=0):
    """Counts and forces of presses from rest and back; while it falls the taxel shows more, by a share of the largest."""
    rng, phase = np.random.default_rng(seed), np.linspace(0, 2 * np.pi, samples)
    up = np.clip(0.6 - 0.8 * np.cos(phase), 0, None)  # at rest between the presses
    forces = np.concatenate([most * up / up.max() * rng.uniform(0.9, 1.0) for _ in range(count)])
    falls = np.gradient(forces) < 0
    shown = curve(forces + hysteresis * most * falls * (forces > 0) * (1 - forces / most))
    return shown + noise * rng.standard_normal(len(shown)), forces


@pytest.mark.parametrize("name", CURVES)
def test_a_known_curve_comes_back(name):
    curve, most, sign = CURVES[name]
    raw, forces = press(curve, most)
    found = identify_taxel(raw, forces)
    assert np.sign(found.counts[-1] - found.counts[0]) == sign
    for force in np.linspace(0.05, 0.85, 9) * most:
        assert found.measure(curve(force)).forces == pytest.approx(force, abs=0.02 * most)
    assert found.noise.max() < 0.02 * most and found.hysteresis < 0.01 * most
    assert found.measure(curve(0.0)).forces == 0 and found.measure(curve(1.2 * most)).beyond
    assert found.measure([-1e6, 1e6, np.nan]).dead.all()


@pytest.mark.parametrize("seed", range(3))
def test_presses_that_were_left_out_are_within_the_noise_that_is_told(seed):
    curve, most, _ = CURVES["resistive, falls"]
    found = identify_taxel(*press(curve, most, noise=40.0, seed=seed))
    raw, forces = press(curve, most, noise=40.0, seed=100 + seed)
    told = found.measure(raw)
    pressed = (forces > 0.05 * most) & ~told.beyond
    off = (told.forces - forces)[pressed] / told.noise[pressed]
    assert np.mean(np.abs(off) < 2) > 0.9 and 0.7 < np.sqrt(np.mean(off**2)) < 1.3


def test_hysteresis_is_found():
    curve, most, _ = CURVES["capacitive, straight"]
    for share in (0.0, 0.05, 0.15):
        found = identify_taxel(*press(curve, most, hysteresis=share))
        # Largest as the fall begins; knots see it over the width of a step.
        assert found.hysteresis == pytest.approx(share * most, abs=(0.35 * share + 0.01) * most)
        assert found.noise.max() >= 0.3 * found.hysteresis


@pytest.mark.parametrize("lag", [-7, 0, 4])
def test_a_lag_is_found_and_taken_out(lag):
    curve, most, _ = CURVES["magnetic, rises"]
    for end in (np.inf, 1200.0):  # saturated at 3.5 N
        raw, forces = press(lambda f, end=end: np.minimum(curve(f), end), most, noise=8.0, seed=5)
        late = np.roll(forces, lag)
        assert find_lag(raw, late, most=10) == lag
        apart, aligned = (identify_taxel(raw, late, lag=one) for one in (0, lag))
        assert aligned.hysteresis < 0.03 * most
        assert lag == 0 or apart.hysteresis > 3 * aligned.hysteresis
    with pytest.raises(InvalidInput, match="most"):
        find_lag(raw[:30], late[:30], most=10)


def test_a_saturated_taxel_tells_the_least_that_presses():
    curve, most, _ = CURVES["resistive, falls"]
    raw, forces = press(lambda f: np.maximum(curve(f), 3400), most, noise=10.0)  # from 0.47 N on
    found = identify_taxel(raw, forces)
    assert 0.35 < found.forces[-1] < 0.5
    told = found.measure(raw)
    assert told.beyond[forces > 0.5].all() and not told.beyond[forces < 0.3].any()
    # Dead a little beyond the end, other than a taxel that was not yet at its end.
    assert found.measure(3300).dead and not found.measure(3390).dead
    assert not identify_taxel(*press(curve, most)).measure(2200).dead
    assert identify_taxel(raw, forces, valid=(0, 9000)).valid == (0, 9000)


@pytest.mark.parametrize(
    ("raw", "forces", "said"),
    [
        (np.arange(10.0), np.arange(9.0), "as many samples"),
        (np.arange(100.0), 5 + np.arange(100.0), "begin at rest"),
        (np.arange(100.0), np.zeros(100), "begin at rest"),
        (np.random.default_rng(0).random(600), press(lambda f: f, 1.0)[1][:600], "follow the force"),
        (np.full(600, 7.0), press(lambda f: f, 1.0)[1][:600], "follow the force"),
    ],
)
def test_what_cannot_be_used_is_refused(raw, forces, said):
    with pytest.raises(InvalidInput, match=said):
        identify_taxel(raw, forces)
