"""How far an object may be from where a plan has it: what is asked, and the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from pinograsp.checks import brief, integer, number
from pinograsp.plan.plain_fields import Plain, plain_fields
from pinograsp.spatial import Array
from pinograsp.words import format_number

_LEAST = 3e-3  # [m] below which a grasp asks for a well-placed object
SMALL = "the object must be well placed: it is held"  # how the warning of that begins
SMALLEST = 0.5  # of the error that is asked about: what is tried first


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseError:
    """The error of an object's pose that is tried: displacement and rotation at once.

    Attributes:
        distance: displacement [m]; in the plane of the table if the object stands on one, else in any direction.
        angle: rotation [rad]; about the table's normal, else about any axis.
        count: number of directions that are tried, evenly spread.

    Raises:
        InvalidInput: a distance that is not above 0, an angle below 0 or above a half turn, fewer than 4 directions.
    """

    distance: float = 5e-3
    angle: float = math.radians(5.0)
    count: int = 12

    __repr__ = brief()

    def __post_init__(self) -> None:
        number("distance", self.distance, above=0, unit="m")
        number("angle", self.angle, at_least=0, at_most=math.pi, unit="rad")
        integer("count", self.count, at_least=4, at_most=10_000)

    def spread(self, up: Array | None) -> tuple[Array, Array]:
        """Displacements (count, 3) [m] and rotation vectors (count, 3) [rad], world axes.

        ``up`` (3,): normal of the table; None: no table, and all directions are tried.
        """
        i = np.arange(self.count)
        sides = np.where(i % 2, -1.0, 1.0)[:, None]
        if up is not None:
            x = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
            x /= np.linalg.norm(x)
            turn = 2 * np.pi * i / self.count
            return (
                self.distance * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(up, x)),
                self.angle * sides * up,
            )
        # Fibonacci's sphere; the axes are those of other places on it.
        height, around = 1.0 - (2 * i + 1) / self.count, np.pi * (3.0 - math.sqrt(5.0)) * i
        wide = np.sqrt(1.0 - height**2)
        ball = np.column_stack([wide * np.cos(around), wide * np.sin(around), height])
        return self.distance * ball, self.angle * sides * np.roll(ball, self.count // 3, axis=0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseTolerance:
    """How far the object may be from its planned place and still be held.

    Errors of increasing size are tried in all directions, by a quick computation of how the fingers push the object
    (see :func:`pinograsp.planner.find_tolerance`).

    Attributes:
        distance: largest displacement that is held in all directions [m]; 0: not even the smallest.
        angle: rotation that belongs to it [rad].
        kept: share of the errors of the requested size that are held [-].
        asked_distance: requested displacement [m].
        asked_angle: requested rotation [rad].
        count: number of directions.
        on_table: whether the object stands on a table, on which it slides and turns; else it stays until it is grasped.
        worst: direction of the displacement of a smallest error that is lost (3,), a unit vector; zero: none is lost.
    """

    distance: float
    angle: float
    kept: float
    asked_distance: float
    asked_angle: float
    count: int
    on_table: bool
    worst: Annotated[Array, "3"]

    __repr__ = brief()

    @property
    def is_small(self) -> bool:
        """Whether it is less than 3 mm."""
        return self.distance < _LEAST

    def describe(self) -> str:
        """In words, as the end of a sentence that says that the grasp holds."""
        if not self.distance:
            least = _size(SMALLEST * self.asked_distance, SMALLEST * self.asked_angle)
            return f"only exactly where you say: an error of {least} in some direction loses it"
        where = "along the table" if self.on_table else "in any direction, if it does not move while the hand closes"
        return f"if it is within {_size(self.distance, self.angle)} of where you say, {where}"

    def summary(self) -> Plain:
        """As plain JSON values."""
        units = {"distance": "distance_m", "angle": "angle_rad"}
        return plain_fields(self, **units, asked_distance="asked_distance_m", asked_angle="asked_angle_rad")


def _size(distance: float, angle: float) -> str:
    return f"{format_number(1e3 * distance, 2)} mm and {format_number(math.degrees(angle), 2)} deg"
