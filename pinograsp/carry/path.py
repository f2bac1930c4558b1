"""The way of an arm: joint positions as a smooth function of a path parameter, or of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicSpline, PPoly

from pinograsp.checks import array_of, brief, instance_of, items_of, mapping_of, one_of, path_of, read_only, rebuild
from pinograsp.errors import InvalidInput
from pinograsp.handover import JointTrajectory, read_ros2
from pinograsp.handover.reading import make_trajectory, read_table
from pinograsp.spatial import Array

_JUMP = 1e-6  # of a slope, over the largest, that is one
_SHORTEST, _FARTHEST = 1e-6, 1e6  # [s], [s, rad or m] of any arm's way
_STEEPEST = 1e30  # coefficient of a spline: products of a few still fit into a float
_APART = 1e-9  # [rad or m] waypoints this close are one


class PathPoint(NamedTuple):
    """Joint positions at m values of the path parameter s, and their derivatives by s, each (m, n)."""

    q: Array
    slope: Array
    bend: Array
    twist: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPath:
    """Joint positions along s from 0 to 1: the cubic spline through waypoints, twice differentiable.

    Attributes:
        joints: their names (n,).
        s: of the waypoints (w,), increasing from 0 to 1.
        q: waypoints (w, n) [rad or m].
        times: of the waypoints (w,) [s], if the path is a trajectory; None: only its shape is known.
        spline: the curve; None: the cubic spline through the waypoints.
    """

    joints: tuple[str, ...]
    s: Array
    q: Array
    times: Array | None = None
    spline: PPoly | None = None

    __repr__ = brief("joints", "s")

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("joints", items_of("joints of the path", self.joints, str))
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise InvalidInput(f"joints of the path: expected different names, got {list(self.joints)}")
        put("s", array_of("parameters of the path", self.s, (None,)))
        put("q", _check_near(array_of("waypoints", self.q, (len(self.s), len(self.joints)))))
        if len(self.s) < 2 or self.s[0] != 0 or self.s[-1] != 1 or np.any(np.diff(self.s) <= 0):
            raise InvalidInput("parameters of the path: expected two or more that increase from 0 to 1")
        if self.times is not None:
            put("times", array_of("times of the path", self.times, self.s.shape))
            if np.any(np.diff(self.times) <= 0):
                raise InvalidInput("times of the path: expected each later than the one before")
            if not _SHORTEST <= self.times[-1] - self.times[0] <= _FARTHEST:
                raise InvalidInput(
                    f"times of the path: expected {_SHORTEST:g} to {_FARTHEST:g} s in all, got "
                    f"{self.times[-1] - self.times[0]:g}"
                )
        # With two waypoints or three there is no more to a cubic spline than a line or a parabola.
        put("spline", _cubic(self.s, self.q) if self.spline is None else self.spline)

    def __reduce__(self) -> tuple[object, ...]:
        return rebuild(self)

    @classmethod
    def along(cls, joints: Sequence[str], spline: PPoly | BSpline) -> ArmPath:
        """Return the path of a SciPy spline, over its whole range: positions of the joints (n,) [rad or m].

        Raises:
            InvalidInput: not a spline, one of other sizes, or one whose slope jumps.
        """
        instance_of("spline", spline, PPoly, BSpline)
        if np.ndim(spline.c) != (2 if isinstance(spline, BSpline) else 3):
            raise InvalidInput(
                f"spline: expected one of {len(joints)} joints' positions, got coefficients {spline.c.shape}"
            )
        piecewise = _split_spline(spline) if isinstance(spline, BSpline) else spline
        # Pieces of a B-spline begin before its range.
        begin, end = piecewise.x[[0, -1]]
        if isinstance(spline, BSpline):
            begin, end = spline.t[spline.k], spline.t[-spline.k - 1]
        kept = (piecewise.x[:-1] < end) & (piecewise.x[1:] > begin)
        knots = np.append(piecewise.x[:-1][kept], piecewise.x[1:][kept][-1])
        length = end - begin
        powers = length ** np.arange(len(piecewise.c))[::-1].astype(float)
        unit = PPoly(piecewise.c[:, kept] * powers[:, None, None], (knots - begin) / length)
        slopes = unit.derivative()
        left = np.asarray(slopes(np.nextafter(unit.x[1:-1], 0.0)))
        jump = np.abs(left - np.asarray(slopes(unit.x[1:-1]))).max(initial=0.0)
        if jump > _JUMP * max(float(np.abs(slopes(unit.x)).max()), 1e-12):
            raise InvalidInput(f"spline: expected one whose slope is continuous, got a jump of {jump:.3g}: smooth it")
        return cls(joints=tuple(joints), s=unit.x, q=np.asarray(unit(unit.x)), spline=unit)

    @classmethod
    def through(cls, waypoints: Mapping[str, ArrayLike]) -> ArmPath:
        """Return the path through two or more waypoints, ``{joint: its positions there (w,)}`` [rad or m].

        The parameter is the distance travelled in joint space from one waypoint to the next, divided by the whole
        distance.

        Raises:
            InvalidInput: fewer than two waypoints, two in a row that are the same, unequal numbers.
        """
        waypoints = mapping_of("waypoints", waypoints, "{joint: positions}")
        if not waypoints:
            raise InvalidInput("waypoints: expected {joint: positions}, got none")
        columns = [array_of(f"waypoints of '{joint}'", own, (None,)) for joint, own in waypoints.items()]
        if len({len(column) for column in columns}) > 1 or len(columns[0]) < 2:
            sizes = {joint: len(column) for joint, column in zip(waypoints, columns)}
            raise InvalidInput(f"waypoints: expected as many of each joint, two or more, got {sizes}")
        q = _check_near(np.column_stack(columns))
        apart = np.linalg.norm(np.diff(q, axis=0), axis=1)
        if np.any(apart < _APART):
            raise InvalidInput(
                f"waypoints: expected each to differ from the one before, numbers {np.argmin(apart)} and "
                f"{np.argmin(apart) + 1} are the same"
            )
        travelled = np.concatenate([[0.0], np.cumsum(apart)])
        return cls(joints=tuple(waypoints), s=travelled / travelled[-1], q=q)

    @classmethod
    def of(cls, trajectory: JointTrajectory) -> ArmPath:
        """Return the path of a timed trajectory, such as one from :func:`~pinograsp.handover.read_csv` or
        ``read_ros2``.

        Its speeds at both ends are those of the trajectory.
        """
        instance_of("trajectory", trajectory, JointTrajectory)
        times = np.array(trajectory.times)
        if len(times) < 2:
            raise InvalidInput("trajectory: expected two samples or more, got 1")
        s = (times - times[0]) / (times[-1] - times[0])
        ends = np.array(trajectory.dq[[0, -1]]) * (times[-1] - times[0])
        return _time_path(tuple(trajectory.names), s, np.array(trajectory.q), times - times[0], ends)

    @property
    def duration(self) -> float | None:
        """Of the trajectory [s]."""
        return None if self.times is None else float(self.times[-1])

    @classmethod
    def read(cls, file: str | Path) -> ArmPath:
        """Read the path in a file.

        ``.csv``: a line of names, then one for each waypoint [rad or m]; with a column ``time`` [s] it is a trajectory,
        at rest at both ends. Or a table of :meth:`~pinograsp.handover.JointTrajectory.to_csv`. ``.yaml``, ``.yml``,
        ``.json``: a trajectory of ROS or MoveIt, as :func:`~pinograsp.handover.read_ros2` reads it.

        Raises:
            InvalidInput: another suffix, or a file that holds none of these, is too large, or is not a regular file.
        """
        file = path_of("path", file)
        if one_of("suffix of a path", file.suffix.lower(), (".csv", ".yaml", ".yml", ".json")) != ".csv":
            return cls.of(read_ros2(file))
        header, values = read_table(file)
        if any(name.endswith("/position") for name in header):
            return cls.of(make_trajectory(file, header, values))
        columns = dict(zip((name.strip() for name in header), values.T))
        if len(columns) < len(header):
            raise InvalidInput(f"'{file}': expected each joint once, got {', '.join(header[:9])[:300]}")
        times = columns.pop("time", None)
        if times is None:
            return cls.through(columns)
        if not columns or len(times) < 2 or np.any(np.diff(times) <= 0):
            raise InvalidInput(
                f"'{file}': expected the positions of joints in two lines or more, each later than the one before"
            )
        since = times - times[0]
        q = np.column_stack(list(columns.values()))
        return _time_path(tuple(columns), since / since[-1], q, since, np.zeros((2, q.shape[1])))

    def only(self, joints: Sequence[str]) -> ArmPath:
        """Return the path of some of its joints."""
        which = [self.joints.index(joint) for joint in joints]
        assert self.spline is not None
        part = PPoly(self.spline.c[:, :, which], self.spline.x)
        return ArmPath(joints=tuple(joints), s=self.s, q=self.q[:, which], times=self.times, spline=part)

    def at(self, s: ArrayLike) -> PathPoint:
        """Compute positions and derivatives at parameters (m,)."""
        assert self.spline is not None
        values = array_of("path parameters", s, (None,))
        return PathPoint(*(read_only(self.spline(values, order)) for order in (0, 1, 2, 3)))


def _split_spline(spline: BSpline) -> PPoly:
    """The polynomials of a spline of several joints."""
    each = [PPoly.from_spline((spline.t, column, spline.k)) for column in spline.c.T]
    return PPoly(np.stack([one.c for one in each], axis=2), each[0].x)


def _time_path(joints: tuple[str, ...], s: Array, q: Array, times: Array, ends: Array) -> ArmPath:
    """The path of a trajectory with slopes (2, n) at its ends."""
    return ArmPath(joints=joints, s=s, q=q, times=times, spline=_cubic(s, _check_near(q), ((1, ends[0]), (1, ends[1]))))


def _cubic(s: Array, q: Array, ends: str | tuple[tuple[int, Array], tuple[int, Array]] = "not-a-knot") -> PPoly:
    """The cubic spline through waypoints."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            if len(s) == 3 and ends == "not-a-knot":  # for that parabola SciPy wakes all of BLAS's threads
                (before, after), (first, last) = np.diff(s), np.diff(q, axis=0) / np.diff(s)[:, None]
                bend = (last - first) / (s[2] - s[0])
                ends = (1, first - bend * before), (1, last + bend * after)
            spline = CubicSpline(s, q, bc_type=ends)
        except ValueError:  # numbers beyond all use
            spline = None
    if spline is None or not np.abs(spline.c).max() <= _STEEPEST:
        raise InvalidInput(
            f"waypoints: expected them farther apart in time than {np.diff(s).min():.3g} of the whole: no smooth path "
            "goes through them"
        )
    return PPoly(spline.c, spline.x)


def _check_near(q: Array) -> Array:
    """Positions (w, n), if they are those of an arm."""
    if q.size and np.abs(q).max() > _FARTHEST:
        raise InvalidInput(f"waypoints: expected positions up to {_FARTHEST:g} rad or m, got {np.abs(q).max():g}")
    return q
