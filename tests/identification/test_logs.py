"""Logs: read with their columns and units, and refused where they cannot be what they say."""

from __future__ import annotations

import gzip

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from closing_finger import close_on_stop, write_log

from pinograsp.errors import InvalidInput
from pinograsp.identification import read_log

COUNTS = {"position": "count", "force": "count"}


@pytest.fixture(scope="module")
def columns():
    return close_on_stop(np.random.default_rng(1), speed=200.0, limit=300.0, trials=3)


def test_csv_packed_or_not_and_parquet_are_the_same(tmp_path, columns):
    plain = write_log(tmp_path / "a.csv", columns)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(plain.read_bytes()))
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    logs = [read_log(tmp_path / f"a.{suffix}", units=COUNTS) for suffix in ("csv", "csv.gz", "parquet")]
    for log in logs:
        for name, values in columns.items():
            np.testing.assert_array_equal(getattr(log, name), values)


def test_units_are_converted_and_columns_named(tmp_path, columns):
    table = {"t [ms]": 1e3 * columns["time"], "Angle": columns["position"] / 10 + 0.01, "F": columns["force"] + 0.5}
    log = read_log(
        write_log(tmp_path / "a.csv", table),
        columns={"time": "t [ms]", "position": "Angle", "force": "F", "speed": "250"},
        units={"time": "ms", "position": "deg", "force": "mN"},
    )
    np.testing.assert_allclose(log.time, columns["time"])
    np.testing.assert_allclose(log.position, np.radians(table["Angle"]))
    np.testing.assert_allclose(log.force, 1e-3 * table["F"])
    assert (log.speed == 250).all() and log.limit is None
    assert dict(log.units) == {"position": "rad", "force": "N"}


def change(columns, name, where, value):
    values = columns[name].astype(object).copy()
    values[where] = value
    return {**columns, name: values}


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda c: change(c, "force", 7, "nan"), r"column 'force', got 'nan' in sample 8, 1 such"),
        (lambda c: change(c, "force", 7, ""), r"finite numbers in column 'force'"),
        (lambda c: change(c, "time", 9, 0.0), r"time that rises"),
        (lambda c: {**c, "time": 1e6 * c["time"]}, r"another unit"),
        (lambda c: {k: v for k, v in c.items() if k != "position"}, r"column 'position'"),
        (lambda c: {k: v[:1] for k, v in c.items()}, r"2 to \d+ samples, got 1"),
    ],
)
def test_wrong_logs_are_refused_with_what_came(tmp_path, columns, make, told):
    path = write_log(tmp_path / "a.csv", make(columns))
    with pytest.raises(InvalidInput, match=told):
        read_log(path, units=COUNTS)


@pytest.mark.parametrize(
    ("units", "told"),
    [
        (None, "unit of position"),
        ({"position": "count"}, "unit of force: expected one of count, N"),
        ({"position": "count", "force": "N"}, "whole numbers alone"),
        ({"position": "rad", "force": "count"}, "which no hand has"),
        ({"position": "count", "force": "kN"}, "unit of force"),
        ({"position": "count", "force": "count", "mass": "kg"}, "units"),
    ],
)
def test_units_must_be_told_and_are_not_believed_against_the_numbers(tmp_path, columns, units, told):
    with pytest.raises(InvalidInput, match=told):
        read_log(write_log(tmp_path / "a.csv", columns), units=units)


def test_misspelt_columns_are_told_with_the_nearest(tmp_path, columns):
    with pytest.raises(InvalidInput, match="did you mean 'force'"):
        read_log(write_log(tmp_path / "a.csv", columns), columns={"force": "forc"}, units=COUNTS)
    with pytest.raises(InvalidInput, match="columns"):
        read_log(write_log(tmp_path / "b.csv", columns), columns={"forse": "force"}, units=COUNTS)


@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe", b"time,position\n1\n", b"a" * 100])
@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet"])
def test_what_is_no_table_is_refused(tmp_path, content, suffix):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InvalidInput):
        read_log(path, units=COUNTS)
    with pytest.raises(InvalidInput):
        read_log(tmp_path / f"none.{suffix}", units=COUNTS)
