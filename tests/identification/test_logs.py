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
        ({"position": "rad", "force": "count"}, "too much for a hand"),
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


def test_lists_in_parquet_are_columns(tmp_path, columns):
    """As LeRobot writes states of several joints."""
    rows = [[float(x), float(f)] for x, f in zip(columns["position"], columns["force"])]
    table = {"timestamp": columns["time"], "observation.state": rows}
    pyarrow.parquet.write_table(pyarrow.table(table), tmp_path / "a.parquet")
    named = {"time": "timestamp", "position": "observation.state[0]", "force": "observation.state[1]"}
    log = read_log(tmp_path / "a.parquet", columns=named, units=COUNTS)
    np.testing.assert_array_equal(log.force, columns["force"])


@pytest.mark.parametrize("kind", ["SQLITE3", "MCAP", "ROS 1"])
def test_bags_of_joint_states(tmp_path, columns, kind):
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ROS 1" else Stores.ROS2_HUMBLE)
    full = ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/JointState")
    types = {name.rpartition("/")[2]: store.types[name] for name in full}
    place = tmp_path / ("a.bag" if kind == "ROS 1" else "bag")
    if kind == "ROS 1":
        writer, encode = rosbag1.Writer(place), store.serialize_ros1
    else:
        plugin = rosbag2.StoragePlugin[kind]
        writer, encode = rosbag2.Writer(place, version=9, storage_plugin=plugin), store.serialize_cdr
    with writer:
        topic = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for i, (x, f) in enumerate(zip(columns["position"], columns["force"])):
            nanoseconds = 7_000_000_000 + i * 5_000_000
            stamp = types["Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
            more = {"seq": i} if kind == "ROS 1" else {}
            state = types["JointState"](
                header=types["Header"](stamp=stamp, frame_id="", **more),
                name=["finger"],
                position=np.array([x]),
                velocity=np.zeros(0),
                effort=np.array([f]),
            )
            writer.write(topic, nanoseconds, encode(state, "sensor_msgs/msg/JointState"))
    log = read_log(place, columns={"position": "finger/position", "force": "finger/effort"}, units=COUNTS)
    np.testing.assert_array_equal(log.position, columns["position"])
    np.testing.assert_array_equal(log.force, columns["force"])
    np.testing.assert_allclose(log.time, 0.005 * np.arange(len(log.time)), atol=1e-9)
    if kind == "MCAP":  # a file alone, as recorders leave it that were stopped
        alone = next(place.glob("*.mcap")).rename(tmp_path / "alone.mcap")
        place = alone
        log = read_log(alone, columns={"position": "finger/position", "force": "finger/effort"}, units=COUNTS)
        np.testing.assert_array_equal(log.position, columns["position"])
    with pytest.raises(InvalidInput, match="did you mean 'finger/effort'"):
        read_log(place, columns={"position": "finger/position", "force": "finger/efort"}, units=COUNTS)


def test_folders_that_are_no_bags_are_refused(tmp_path):
    for place in (tmp_path, tmp_path / "none.bag"):
        with pytest.raises(InvalidInput, match="bag of ROS"):
            read_log(place, units=COUNTS)
