"""Trajectories from files: tables, and messages as ROS, ROS 2 and MoveIt print them."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import array_of, number, one_line, one_of, path_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.handover.trajectory import FIELDS, GAINS, MESSAGE, SUFFIXES, JointTrajectory
from pinograsp.hands.elements import read_bytes
from pinograsp.plain import plain_json, plain_yaml
from pinograsp.spatial import Array

_LARGEST = 2**24  # [bytes] of a file: texts grow when they are taken apart
_MOST = 1_000_000  # lines of a table, and values of a message
_LONGEST = 1_000_000  # characters of a table's names
_DEEPEST = 20  # mappings and lists within each other; a DisplayTrajectory has 7
_ECHOED = "..."  # what ros2 topic echo writes for what it leaves out


def read_csv(path: str | Path) -> JointTrajectory:
    """Read the trajectory in a table that :meth:`JointTrajectory.to_csv` wrote.

    Raises:
        InvalidInput: not a regular file, more than 16 MiB, or not such a table.
    """
    path = path_of("path", path)
    return make_trajectory(path, *read_table(path))


def read_table(path: Path) -> tuple[list[str], Array]:
    """The names in a table's first line (n,), and the finite numbers below (m, n).

    Raises:
        InvalidInput: not a regular file, more than 16 MiB, or not such a table.
    """
    content = _content(path)
    try:
        lines = io.StringIO(content.decode("utf-8-sig"), newline="")
        names = next(filter(None, csv.reader(_limit_lines(lines))), None)
        if names is None:
            raise ValueError("got no line")
        first = next((line for line in lines if line.strip()), None)
        values = np.zeros((0, len(names)))
        if first is not None:
            rows = itertools.islice(itertools.chain([first], lines), _MOST + 1)
            values = np.loadtxt(rows, delimiter=",", quotechar='"', comments=None, ndmin=2)
        if values.shape[1] != len(names):
            raise ValueError(f"got {len(names)} names and {values.shape[1]} numbers")
        if len(values) > _MOST:
            raise ValueError(f"got more than {_MOST} lines")
        if not np.isfinite(values).all():
            raise ValueError("got numbers that are not finite")
    except (ValueError, csv.Error) as error:
        raise InvalidInput(
            f"{_quote_path(path)}: expected a line of names, then lines of as many numbers each, with commas between: "
            f"{one_line(error)}"
        ) from error
    return names, values


def make_trajectory(path: Path, header: list[str], values: Array) -> JointTrajectory:
    """The trajectory of a table's names (n,) and numbers (m, n), as :meth:`JointTrajectory.to_csv` orders them."""
    gains = [name for name in GAINS if any(column.endswith(f"/{name}") for column in header)]
    kinds = [*FIELDS, *gains]
    n = (len(header) - 1) // len(kinds)
    names = [name.rpartition("/")[0] for name in header[1 : n + 1]]
    if not values.size or header != ["time", *(f"{name}/{kind}" for kind in kinds for name in names)]:
        raise InvalidInput(
            f"{_quote_path(path)}: expected columns time, JOINT/{', JOINT/'.join(FIELDS)}, got "
            f"{', '.join(name[:60] for name in header[:9])}..."
        )
    q, dq, ddq, effort, *rest = np.split(values[:, 1:], len(kinds), axis=1)
    own = tuple(name.removeprefix("'") for name in names)
    kept = {name: one[0] for name, one in zip(gains, rest)}
    return JointTrajectory(names=own, times=values[:, 0], q=q, dq=dq, ddq=ddq, effort=effort, **kept)


def read_ros2(path: str | Path) -> JointTrajectory:
    """Read the trajectory in a message from :meth:`JointTrajectory.to_ros2` or from other tools.

    A ``trajectory_msgs/JointTrajectory`` of ROS 2 or ROS 1 (``secs``, ``nsecs``), by itself or wherever it is in
    another message: MoveIt's ``RobotTrajectory`` and ``DisplayTrajectory``, a ``FollowJointTrajectory`` goal; in YAML,
    as from ``ros2 topic echo`` and ``rostopic echo`` (lines ``---`` are allowed), or JSON. The file must hold exactly
    one trajectory. Empty velocities, accelerations and efforts are 0.

    Raises:
        InvalidInput: not a regular file, more than 16 MiB or a million values, not JSON or YAML (by suffix), no
            trajectory or several, a trajectory that was cut off or moves a base.
    """
    path = path_of("path", path)
    suffix = one_of("suffix of a ROS 2 message", path.suffix.lower(), SUFFIXES)
    content, told = _content(path), _quote_path(path)
    try:
        if suffix == ".json":
            documents = [plain_json(content, _DEEPEST, _MOST)]
        else:
            documents = plain_yaml(content, _DEEPEST, _MOST)
    except ValueError as error:
        raise InvalidInput(f"{told}: expected plain values as {suffix[1:]}: {one_line(error)}") from error
    found = [one for document in documents for one in _messages(document)]
    if bases := [one for one in found if _moves_a_base(one)]:
        raise InvalidInput(
            f"{told}: expected joints of an arm alone, got a multi_dof_joint_trajectory of "
            f"{shorten(bases[0]['joint_names'])}: a moving base is not supported"
        )
    full = [one for one in found if one["joint_names"] or one["points"]]
    if len(full) != 1:
        raise InvalidInput(f"{told}: {_instead(documents, len(found), len(full))}")
    try:
        return _trajectory(full[0])
    except InvalidInput as error:
        raise InvalidInput(f"{told}: {error}") from error


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, _LARGEST)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InvalidInput(f"{_quote_path(path)} cannot be read: {why}") from error


def _quote_path(path: Path) -> str:
    return shorten(str(path)[:300])


def _limit_lines(lines: io.StringIO) -> Iterator[str]:
    """The lines that names may take, and no more."""
    left = _LONGEST
    for line in lines:
        left -= len(line)
        if left < 0:
            raise ValueError(f"got names of more than {_LONGEST} characters")
        yield line


# -- messages ----------------------------------------------------------------------------------------------------------


def _messages(document: object) -> list[dict[str, Any]]:
    """All trajectories within a document, in its order."""
    found, left = [], [document]
    while left:
        one = left.pop()
        if isinstance(one, dict) and "joint_names" in one and "points" in one:
            found.append(one)
        elif isinstance(one, dict | list):
            inner = list(one.values() if isinstance(one, dict) else one)
            left += [part for part in reversed(inner) if isinstance(part, dict | list)]
    return found


def _moves_a_base(message: dict[str, Any]) -> bool:
    points = message["points"]
    return isinstance(points, list) and any(isinstance(one, dict) and "transforms" in one for one in points)


def _instead(documents: list[Any], empty: int, full: int) -> str:
    """What there is instead of one trajectory."""
    if full:
        several = sum(one is not None for one in documents)
        where = f" in {several} messages" if several > 1 else ""
        return f"expected one trajectory, got {full}{where}: keep the one that is meant (ros2 topic echo --once)"
    if empty:
        return "expected a trajectory, got one without joints and points: did the planner find none?"
    document = next((one for one in documents if one is not None), None)
    got = f"the keys {', '.join(map(str, document))[:200]}" if isinstance(document, dict) else shorten(document)
    return f"expected a trajectory_msgs/JointTrajectory, with joint_names and points, got {got}"


def _trajectory(message: dict[str, Any]) -> JointTrajectory:
    names, points = (_check_list(key, message[key]) for key in ("joint_names", "points"))
    for name in names:
        if not isinstance(name, str | int) or isinstance(name, bool):
            raise InvalidInput(f"joint_names: expected texts, got {shorten(name)}")
    times = []
    for i, point in enumerate(points):
        if not isinstance(point, dict):
            raise InvalidInput(f"points: expected mappings, got {shorten(point)} as number {i}")
        times.append(_seconds(f"time_from_start of point {i}", point.get("time_from_start")))
    columns = {}
    for key, attribute in MESSAGE.items():
        rows = [_check_list(key, point.get(key) or []) for point in points]
        if key == "positions" and not all(rows):
            raise InvalidInput(f"positions: expected those of every point, got none at {rows.index([])}")
        columns[attribute] = array_of(key, [row or [0.0] * len(names) for row in rows], (len(points), len(names)))
    return JointTrajectory(
        names=tuple(map(str, names)),
        times=array_of("times", times, (None,)),
        q=columns["q"],
        dq=columns["dq"],
        ddq=columns["ddq"],
        effort=columns["effort"],
    )


def _check_list(key: str, value: object) -> list[Any]:
    """A list of a message, all of it."""
    if not isinstance(value, list):
        raise InvalidInput(f"{key}: expected a list, got {shorten(value)}")
    if _ECHOED in value:
        raise InvalidInput(f"{key}: cut off after {value.index(_ECHOED)}: echo it once more with --full-length")
    return value


def _seconds(name: str, value: object) -> float:
    """A duration of ROS 2, of ROS 1, or in seconds [s]."""
    if not isinstance(value, dict):
        return number(name, value, unit="s, or sec and nanosec")
    keys = ("sec", "nanosec") if "sec" in value else ("secs", "nsecs")
    whole, fraction = (number(f"{key} of {name}", value.get(key, 0)) for key in keys)
    if not value.keys() & set(keys):
        raise InvalidInput(f"{name}: expected sec and nanosec, got {shorten(value)}")
    return whole + 1e-9 * fraction
