"""Bags of ROS 1 and ROS 2 as tables: the joint states in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import one_line, shorten
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.spatial import Array

_TYPE = "sensor_msgs/msg/JointState"
_USUAL = "/joint_states"


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag: a folder, as ROS 2 has them (SQLite or MCAP), or a file of ROS 1."""
    return path.is_dir() or path.suffix in (".bag", ".mcap", ".db3")


def read_bag(path: Path) -> dict[str, Array]:
    """``time`` [s] from the first message on, and ``JOINT/position``, ``/velocity`` and ``/effort`` of joint states.

    Of several topics ``/joint_states`` is read. Joints that a message does not have keep what they had before.

    Raises:
        InvalidInput: no bag, or none with one topic of joint states.
        ExtraMissing: rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ExtraMissing("bags need rosbags: pip install 'pinograsp[logs]'") from None
    if path.suffix in (".mcap", ".db3") and path.parent.joinpath("metadata.yaml").is_file():
        path = path.parent
    times: list[float] = []
    columns: dict[str, list[float]] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            found = [one for one in bag.connections if one.msgtype == _TYPE]
            topics = sorted({one.topic for one in found})
            topic = topics[0] if len(topics) == 1 else _USUAL
            if topic not in topics:
                got = shorten(", ".join(topics)) if topics else "none"
                raise InvalidInput(f"log {path}: expected one topic of joint states, or {_USUAL}, got {got}")
            for connection, stamp, raw in bag.messages([one for one in found if one.topic == topic]):
                message: Any = bag.deserialize(raw, connection.msgtype)
                said = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                times.append(said or 1e-9 * stamp)
                for kind in ("position", "velocity", "effort"):
                    for name, value in zip(message.name, getattr(message, kind)):
                        columns.setdefault(f"{name}/{kind}", [np.nan] * (len(times) - 1)).append(float(value))
                for values in columns.values():
                    values += [values[-1]] * (len(times) - len(values))
    except (AnyReaderError, OSError, ValueError, KeyError) as error:
        raise InvalidInput(f"log {path}: expected a bag of ROS, got {one_line(error)}") from None
    if not times:
        raise InvalidInput(f"log {path}: expected joint states, got none")
    return {"time": np.array(times) - times[0], **{name: np.array(values) for name, values in columns.items()}}
