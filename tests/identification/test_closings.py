"""Closings on a stop: peaks, lags and contact laws of fingers that are simulated otherwise; predictions between them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from closing_finger import close_on_stop, write_log
from hypothesis import given, strategies as st

from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.identification import identify_closings, read_log

UNITS = {"position": "count", "force": "count"}


def read(tmp_path, columns, name="log.csv"):
    return read_log(write_log(tmp_path / name, columns), units=UNITS)


def table_of(peaks: dict[tuple[float, float], float], scatter: float = 0.05) -> ClosingTable:
    speeds, limits = zip(*peaks)
    values = tuple(peaks.values())
    return ClosingTable(
        speeds=speeds,
        limits=limits,
        peaks=values,
        low=tuple(value * (1 - scatter) for value in values),
        high=tuple(value * (1 + scatter) for value in values),
        trials=(20,) * len(values),
    )


@pytest.mark.parametrize("seed", [1, 20261128])
def test_peaks_lag_speed_and_contact_law_come_back(tmp_path, seed):
    rng = np.random.default_rng(seed)
    lag, exponent = rng.uniform(0.05, 0.2), rng.uniform(1.2, 2.2)
    stiffness = rng.uniform(200, 600) / 20**exponent
    logs = {}
    for speed, limit in itertools.product((40.0, 160.0), (80.0, 200.0, 400.0)):
        columns = close_on_stop(rng, speed=speed, limit=limit, lag=lag, exponent=exponent, stiffness=stiffness)
        logs[speed, limit] = columns
    found = identify_closings(
        [read(tmp_path, columns, f"{i}.csv") for i, columns in enumerate(logs.values())], seed=seed
    )
    assert found.table.trials == (8,) * 6 and not found.remarks
    assert list(found.peaks) == list(logs)
    for (speed, limit), peaks in found.peaks.items():
        # The largest value of the register between two openings is what the log itself has.
        assert peaks.max() == logs[speed, limit]["force"].max()
        assert peaks.min() > limit
    assert found.sensor_lag.value == pytest.approx(lag, rel=0.05)
    assert found.free_speeds == pytest.approx({40.0: 40.0, 160.0: 160.0}, rel=0.03)
    # Start and exponent trade off against each other; what a count more makes does not.
    for force in np.quantile(found.contact.forces, [0.3, 0.5, 0.7]):
        slope = exponent * stiffness ** (1 / exponent) * force ** (1 - 1 / exponent)
        assert found.contact.slope(force).value == pytest.approx(slope, rel=0.2)
        softer, stiffer = found.contact.reserve_factors(force)
        told = found.contact.slope(force)
        assert softer >= 1.0 and stiffer >= 1.0
        assert softer * stiffer == pytest.approx((told.high / told.low) ** found.contact.fits[0, 2])
    middle = found.contact.reserve_factors(float(np.median(found.contact.forces)))
    assert found.contact.find_ratios() == pytest.approx((1 / middle[0], middle[1]))
    assert found.contact.error < 0.2  # half a count is up to a tenth of the force


def test_noise_makes_no_closings_and_hides_none(tmp_path):
    rng = np.random.default_rng(3)
    columns = close_on_stop(rng, speed=100.0, limit=300.0, noise=3.0, trials=12)
    assert identify_closings([read(tmp_path, columns)]).table.trials == (12,)


def test_forces_in_newtons_by_slope_and_offset(tmp_path):
    log = read(tmp_path, close_on_stop(np.random.default_rng(1), speed=100.0, limit=300.0))
    counts, newtons = identify_closings([log]).table, identify_closings([log], newtons=(0.01, 0.2)).table
    assert (counts.unit, newtons.unit) == ("count", "N")
    assert newtons.peaks == pytest.approx([0.01 * peak + 0.2 for peak in counts.peaks])
    with pytest.raises(InvalidInput, match="slope > 0"):
        identify_closings([log], newtons=(-1, 0))


def test_what_logs_cannot_tell_is_named_and_nothing_else(tmp_path):
    rng = np.random.default_rng(5)
    logs = [
        read(tmp_path, close_on_stop(rng, speed=speed, limit=limit), f"{speed}-{limit}.csv")
        for speed in (50.0, 200.0)
        for limit in (60.0, 150.0, 500.0)
    ]
    unknown = " ".join(identify_closings(logs, newtons=(0.01, 0)).unknown)
    assert "depth" in unknown and "latency" in unknown
    assert "contact law" not in unknown and "lag" not in unknown and "one speed" not in unknown
    alone = identify_closings(logs[:1])
    unknown = " ".join(alone.unknown)
    assert "newtons" in unknown and "contact law" in unknown and "one speed" in unknown and alone.contact is None


def test_logs_without_a_contact_or_without_commands_are_refused(tmp_path):
    columns = close_on_stop(np.random.default_rng(1), speed=100.0, limit=300.0)
    flat = {**columns, "force": np.zeros_like(columns["force"])}
    with pytest.raises(InvalidInput, match="closings on a stop"):
        identify_closings([read(tmp_path, flat)])
    bare = {name: values for name, values in columns.items() if name != "limit"}
    with pytest.raises(InvalidInput, match="expected limit"):
        identify_closings([read(tmp_path, bare)])


@given(st.floats(1, 1000), st.floats(1, 2000), st.floats(0, 1), st.floats(0, 1), st.floats(1, 8), st.floats(1, 8))
def test_predictions_lie_between_what_was_tried_and_err_least_in_the_middle(base, rise, a, b, wide, faster):
    peaks = {(10.0, 100.0): base, (10.0, 200.0): base + rise, (10.0 * (1 + faster), 100.0): base * wide}
    peaks[10.0 * (1 + faster), 200.0] = max(base * wide, base + rise) + 1
    table = table_of(peaks)
    speed, limit = 10 * (1 + faster) ** a, 100 + 100 * b
    told = table.predict(speed, limit)
    assert min(peaks.values()) * (1 - 1e-9) <= told.value <= max(peaks.values()) * (1 + 1e-9)
    assert told.low <= told.value <= told.high
    middle = table.predict(10 * (1 + faster) ** 0.5, 100.0).value
    low, high = base, base * wide
    worst = (high - low) / (high + low)
    assert abs(middle - low) / low <= worst + 1e-9 and abs(middle - high) / high <= worst + 1e-9


def test_touch_is_the_fastest_that_keeps_the_cap_and_commands_make_forces():
    table = table_of({(25, 100): 1.0, (25, 500): 3.0, (50, 100): 1.2, (50, 500): 5.0, (250, 100): 4.0, (250, 500): 7.0})
    assert table.find_touch(2.0)[:2] == (50, 100)
    assert table.find_touch(4.5)[:2] == (250, 100)
    with pytest.raises(InvalidInput, match=r"gentlest .* speed 25 and limit 100, came to 1 in the median and 1\.05"):
        table.find_touch(1.0)
    command = table.find_command(2.0)
    assert command[:2] == (25, 300) and command.peak.value == pytest.approx(2.0)
    command = table.find_command(4.0)  # at 394.7, and registers take whole numbers
    assert command[:2] == (50, 395) and 4.0 <= command.peak.value < 4.02
    amperes = table_of({(25, 0.1): 1.0, (25, 0.5): 3.0})
    assert amperes.find_command(1.3)[:2] == (25, pytest.approx(0.16))
    for force in (0.5, 8.0):
        with pytest.raises(InvalidInput, match="expected 1 to 7 N"):
            table.find_command(force)
    for speed, limit in ((10, 100), (300, 100), (50, 50), (50, 600)):
        with pytest.raises(InvalidInput, match="within what was tried"):
            table.predict(speed, limit)


@pytest.mark.parametrize(
    "changed",
    [{"speeds": (1.0, 0.0)}, {"peaks": (1.0,)}, {"low": (9.0, 9.0)}, {"limits": (1.0, float("nan"))}, {"unit": "kg"}],
)
def test_tables_that_are_none_are_refused(changed):
    good = {
        "speeds": (1.0, 2.0),
        "limits": (1.0, 1.0),
        "peaks": (1.0, 2.0),
        "low": (1.0, 2.0),
        "high": (1.0, 2.0),
        "trials": (1, 1),
    }
    assert ClosingTable(**good).trials == (1, 1)
    with pytest.raises(InvalidInput):
        ClosingTable(**{**good, **changed})
