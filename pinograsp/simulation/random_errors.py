"""Random errors of a study: their sizes, and those drawn for one trial."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from pinograsp.checks import array_of, brief, floats_of, instance_of, number
from pinograsp.errors import InvalidInput
from pinograsp.plan import PoseError
from pinograsp.simulation.settings import Disturbance, Push
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array

TOGETHER = "together"
_ARM = 0.03  # [m] motion of a sliding joint that compares with one radian of a turning joint, as for the servos
_LEAST = 0.01  # smallest factor of the mass, and of the servos' gains
_STANDARD_GRAVITY = 9.81  # [m/s^2]

# Errors that may be given as several numbers, and what is expected of those that are ranges.
_SEVERAL = ("position", "rotation", "friction", "stiffness")
_RANGES = {"friction": "0 <= lowest mu <= highest", "stiffness": "0 < lowest factor <= highest"}
# Errors in the order of their random numbers. All together had theirs at the place after the first six.
_FIRST = ("position", "rotation", "friction", "mass", "posture", "push")


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Sizes of the random errors, which are drawn independently of each other; zero switches an error off.

    Attributes:
        position: standard deviation of the object's position along world x, y, z: one number or (3,) [m].
        rotation: standard deviation of the object's rotation vector: one number or (3,) [rad].
        friction: relative standard deviation of mu, the same factor for all contacts [-]; or a pair of bounds between
            which mu is uniform.
        mass: relative standard deviation of the object's mass [-]; the mass is at least a hundredth of the planned one.
        posture: standard deviation of the joints' positions at t = 0 [rad]; for sliding joints 30 mm per radian. The
            servos correct it during the approach. Set it to zero with ``mode="prescribed"``.
        push: largest force on the object's centre of mass, as a share of its weight at 9.81 m/s^2 [-]. Size and
            direction are uniform; start and duration are the defaults of :class:`~pinograsp.simulation.Push`.
        stiffness: a pair of bounds of the factor on the contacts' K, its logarithm uniform; 0: as planned.
        joint_offset: standard deviation of the offsets of the joints' encoders [rad]; for sliding joints 30 mm per
            radian.
        joint_friction: largest dry friction of the joints [N m]; for sliding joints of a force 30 mm from its axis.
            Each is uniform from 0.
        pose: the object is displaced and turned by exactly this error, in a random direction: along its table and about
            the table's normal, if the plan has one; None: no such error.
        servo_gain: relative standard deviation of the servos' gains, the same factor for all joints [-]; it is at least
            a hundredth.
    """

    position: float | tuple[float, ...] = 2e-3
    rotation: float | tuple[float, ...] = math.radians(2)
    friction: float | tuple[float, float] = 0.1
    mass: float = 0.1
    posture: float = math.radians(1)
    push: float = 0.2
    stiffness: float | tuple[float, float] = 0.0
    joint_offset: float = 0.0
    joint_friction: float = 0.0
    servo_gain: float = 0.0
    pose: PoseError | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        kept: float | tuple[float, ...]
        instance_of("error of pose", self.pose, PoseError, type(None))
        for name in (field.name for field in fields(self) if field.name != "pose"):
            value = getattr(self, name)
            several = name in _SEVERAL and not isinstance(value, Real)
            if several and floats_of(f"error of {name}", value).ndim:
                values = array_of(f"error of {name}", value, (2 if name in _RANGES else 3,))
                kept = tuple(values.tolist())
                if values.min() < 0 or (name in _RANGES and values[0] > values[1]):
                    raise InvalidInput(f"error of {name}: expected {_RANGES.get(name, 'values >= 0')}, got {kept}")
                if name == "stiffness":
                    for factor in kept:
                        Disturbance(stiffness=factor)  # refuses what no simulation takes
            else:
                kept = number(f"error of {name}", value, at_least=0)
                if name == "stiffness" and kept:
                    raise InvalidInput(f"error of stiffness: expected a pair of factors, or 0, got {kept:g}")
            object.__setattr__(self, name, kept)

    @classmethod
    def of_pose(cls, pose: PoseError) -> Errors:
        """Errors of the object's pose alone."""
        return cls(position=0.0, rotation=0.0, friction=0.0, mass=0.0, posture=0.0, push=0.0, pose=pose)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the errors that are switched on."""
        return tuple(
            name for name, value in asdict(self).items() if np.any(value) or (name == "friction" and np.ndim(value))
        )

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, with those of the contacts' and the drives' errors that are switched on."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
            if name in _FIRST or name in self.kinds
        }


class DrawnErrors(NamedTuple):
    """The random errors of one trial: as plain values by error, as a disturbance, and the factor of mu."""

    values: dict[str, Any]
    disturbance: Disturbance
    mu_factor: float


def draw_errors(task: Task, errors: Errors, seed: int, name: str, trial: int) -> DrawnErrors:
    """The errors of a trial, ``name`` alone or ``"together"``."""
    every = [field.name for field in fields(Errors)]
    # Each error has its own random numbers: other errors, or more trials, change none of them.
    together = len(_FIRST)
    place = together if name == TOGETHER else every.index(name) + (name not in _FIRST)
    drawn: dict[str, Any] = {}
    given: dict[str, Any] = {}
    mu_factor = 1.0
    for kind in errors.kinds if name == TOGETHER else (name,):
        # The same as spawning the seed for every error, then for every trial, then for every kind.
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place, trial, every.index(kind))))
        value = _draw(kind, getattr(errors, kind), rng, task)
        drawn[kind] = np.asarray(value).tolist()
        if kind == "friction" and not isinstance(errors.friction, tuple):
            mu_factor = float(value)
        elif kind == "pose":
            given["object_offset"] = given.get("object_offset", 0.0) + value[:3]
            given["object_turn"] = given.get("object_turn", 0.0) + value[3:]
        elif kind == "push":
            given["pushes"] = (Push(wrench_o=np.concatenate([value, np.zeros(3)])),)
        else:
            given[_FIELDS.get(kind, kind)] = value
    return DrawnErrors(drawn, Disturbance(**given), mu_factor)


# Fields of a disturbance that are not named as the errors.
_FIELDS = {
    "position": "object_offset",
    "rotation": "object_turn",
    "friction": "mu",
    "mass": "mass_factor",
    "posture": "start_error",
}


def _draw(kind: str, size: Any, rng: np.random.Generator, task: Task) -> Any:
    """One random error of a kind, a number or an array."""
    if kind == "pose":
        return _draw_pose(size, rng, task)
    if kind in ("position", "rotation"):
        return rng.normal(size=3) * size
    if kind == "friction":
        return rng.uniform(*size) if isinstance(size, tuple) else max(0.0, 1.0 + size * rng.normal())
    if kind in ("mass", "servo_gain"):
        return max(_LEAST, 1.0 + size * rng.normal())
    if kind == "stiffness":
        return float(np.clip(np.exp(rng.uniform(*np.log(size))), *size))
    if kind == "push":
        direction = rng.normal(size=3)
        most = size * task.body.mass * _STANDARD_GRAVITY
        return rng.uniform(0.0, most) * direction / np.linalg.norm(direction)
    slides = task.hand.slides
    if kind == "joint_friction":
        return rng.uniform(size=task.hand.n) * size / np.where(slides, _ARM, 1.0)
    return rng.normal(size=task.hand.n) * size * np.where(slides, _ARM, 1.0)


def _draw_pose(size: PoseError, rng: np.random.Generator, task: Task) -> Array:
    """Displacement and rotation vector (6,) [m, rad] of an object that is displaced and turned."""
    way, axis = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
    if task.support == "table":
        up = -task.gravity_o / np.linalg.norm(task.gravity_o)
        way, axis = way - (way @ up) * up, np.copysign(1.0, axis @ up) * up
        way /= np.linalg.norm(way)
    return np.concatenate([size.distance * way, size.angle * axis])


def word_size(name: str, value: float | tuple[float, ...] | PoseError) -> str:
    """The size of an error in words."""
    if isinstance(value, PoseError):
        return f"{1e3 * value.distance:.3g} mm and {math.degrees(value.angle):.3g} deg, in any direction"
    if name == "friction" and isinstance(value, tuple):
        return f"mu from {value[0]:g} to {value[1]:g}"
    if name == "stiffness" and isinstance(value, tuple):
        return f"{value[0]:g} to {value[1]:g} times the contacts' K"
    if name == "joint_friction":
        return f"up to {value:g} N m"
    degrees = (180 / math.pi, "deg")
    units = {"position": (1e3, "mm"), "rotation": degrees, "posture": degrees, "joint_offset": degrees}
    factor, unit = units.get(name, (100, "%"))
    shown = ", ".join(f"{factor * one:.4g}" for one in np.atleast_1d(value))
    return f"up to {shown} % of the weight" if name == "push" else f"std {shown} {unit}"
