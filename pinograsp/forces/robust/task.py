"""What is done with a held object: the loads that come with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of, number, one_of
from pinograsp.errors import InvalidInput
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, cross

TaskName: TypeAlias = Literal["screw", "pour", "insert", "pull", "shake", "loads"]
Vector: TypeAlias = tuple[float, float, float]
# An icosahedron contains the ball that touches its faces; its vertices are that much further out than the ball's
# radius: sqrt(15 - 6 sqrt(5)) = 1.2584. An octahedron would go 1.73 times as far, a cube too.
CIRCUMSCRIBED = float(np.sqrt(15 - 6 * np.sqrt(5)))
_UNITS = {"screw": "N m", "pour": "deg", "insert": "N", "pull": "N", "shake": "m/s^2"}
_STEP, _AROUND = np.radians(40.0), 8  # largest between tilts, and directions of each: their hull contains all between
_Z: Vector = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Loads on a held object besides its weight, for :class:`~pinograsp.forces.Reserve`.

    :meth:`screw`, :meth:`pour`, :meth:`insert`, :meth:`pull`, :meth:`shake` and :meth:`of_loads` make them.

    Attributes:
        name: the method that made it.
        size: torque [N m], tilt [rad], force [N] or acceleration [m/s^2]; 0 for ``"loads"``.
        direction: axis or direction in the object's own frame, a unit vector; zeros: any direction.
        at: point at which a force acts, in the object's own frame [m]; None: the centre of mass.
        wrenches: for ``"loads"``: wrenches about the centre of mass, linear first, world axes [N, N m].

    Example:
        >>> import pinograsp as pg
        >>> tasks = (pg.Task.screw(torque=0.02), pg.Task.shake(acceleration=2.0))
        >>> conditions = pg.GraspConditions(mu=0.6, reserve=pg.Reserve(tasks=tasks))
        >>> print(*(f"{task.name} {task.size}" for task in conditions.reserve.tasks), sep=", ")
        screw 0.02, shake 2.0

    See Also:
        :class:`~pinograsp.forces.Reserve`, which has the tasks.
    """

    name: TaskName
    size: float = 0.0
    direction: Vector = (0.0, 0.0, 0.0)
    at: Vector | None = None
    wrenches: tuple[tuple[float, ...], ...] = ()

    __repr__ = brief()

    def __post_init__(self) -> None:
        one_of("task", self.name, (*_UNITS, "loads"))

        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("size", number(f"task {self.name}", self.size, at_least=0, unit=_UNITS.get(self.name, "")))
        if self.name == "pour" and self.size > np.pi:
            raise InvalidInput(f"task pour: expected a tilt of at most pi rad, got {self.size:g}")
        direction = array_of(f"task {self.name}: direction", self.direction, (3,))
        if self.name in ("screw", "insert", "pull"):
            if not direction.any():
                raise InvalidInput(f"task {self.name}: expected a direction, got 0, 0, 0")
            direction = direction / np.linalg.norm(direction)
        put("direction", tuple(direction.tolist()))
        if self.at is not None:
            put("at", tuple(array_of(f"task {self.name}: at", self.at, (3,)).tolist()))
        if self.name == "loads":
            put("wrenches", tuple(map(tuple, array_of("task loads", self.wrenches, (None, 6)).tolist())))

    @classmethod
    def screw(cls, *, torque: float, axis: ArrayLike = _Z) -> Task:
        """Turn the object with a torque [N m] about an axis (3,) of its own frame, in either direction."""
        return cls(name="screw", size=torque, direction=_vector("axis", axis))

    @classmethod
    def pour(cls, *, tilt: float) -> Task:
        """Tilt hand and object by up to an angle [rad], in any direction."""
        return cls(name="pour", size=tilt)

    @classmethod
    def insert(cls, *, force: float, direction: ArrayLike = (0.0, 0.0, -1.0), at: ArrayLike | None = None) -> Task:
        """Press the object with a force [N] along a direction (3,) of its own frame against something that presses back
        at the point ``at`` (3,) of its frame [m]; None: in line with the centre of mass.
        """
        place = None if at is None else _vector("at", at)
        return cls(name="insert", size=force, direction=_vector("direction", direction), at=place)

    @classmethod
    def pull(cls, *, force: float, direction: ArrayLike = _Z, at: ArrayLike | None = None) -> Task:
        """Pull at the object with a force [N] along a direction (3,) of its own frame, at the point ``at`` (3,) of its
        frame [m]; None: in line with the centre of mass.
        """
        place = None if at is None else _vector("at", at)
        return cls(name="pull", size=force, direction=_vector("direction", direction), at=place)

    @classmethod
    def shake(cls, *, acceleration: float) -> Task:
        """Accelerate hand and object by up to this value [m/s^2] in any direction."""
        return cls(name="shake", size=acceleration)

    @classmethod
    def of_loads(cls, loads: LoadSet) -> Task:
        """Return a task of any loads besides the weight."""
        if instance_of("loads", loads, LoadSet).ball:
            raise InvalidInput("task loads: expected a set without a ball of disturbances: the reserve has one")
        return cls(name="loads", wrenches=tuple(map(tuple, loads.loads.tolist())))

    def find_loads(self, body: Body, mass: float, gravity_o: Array) -> Array:
        """Return the loads (t, 6) on a body of another mass [kg], weight included, about its centre of mass, world
        axes.

        Their hull contains all tilts and accelerations [N, N m].
        """
        weight_o = mass * gravity_o
        loads: Array
        if self.name == "shake":
            loads = self._shake(body, mass, weight_o)
        else:
            make: Callable[[Body, Array], Array] = getattr(self, f"_{self.name}")
            loads = make(body, weight_o)
        return loads

    def describe(self) -> str:
        """Describe it in words, with its numbers."""
        if self.name == "loads":
            return f"{len(self.wrenches)} given loads"
        size = np.degrees(self.size) if self.name == "pour" else self.size
        return f"{self.name} with {size:.3g} {_UNITS[self.name]}"

    def _screw(self, body: Body, weight_o: Array) -> Array:
        torque = self.size * self._direction_o(body)
        return np.array([[*weight_o, *torque], [*weight_o, *-torque]])

    def _pour(self, body: Body, weight_o: Array) -> Array:
        size = float(np.linalg.norm(weight_o))
        if size == 0:
            return np.zeros((1, 6))
        down = weight_o / size
        aside = np.eye(3)[int(np.argmin(np.abs(down)))]
        first = cross(down, aside)
        first /= np.linalg.norm(first)
        turns = np.arange(_AROUND) * 2 * np.pi / _AROUND
        ring = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), cross(down, first))
        steps = max(1, int(np.ceil(self.size / _STEP)))
        half = self.size / steps / 2
        # Tangents of the arc meet halfway between its steps; rings about it are within polygons of so many corners.
        angles = [*(half * (2 * np.arange(steps) + 1)), self.size]
        radii = [*np.full(steps, 1.0 / np.cos(half)), 1.0]
        ring /= np.cos(np.pi / _AROUND)
        forces = np.concatenate([r * (np.cos(at) * down + np.sin(at) * ring) for at, r in zip(angles, radii)])
        return np.column_stack([size * forces, np.zeros((len(forces), 3))])

    def _insert(self, body: Body, weight_o: Array) -> Array:
        return self._force(body, weight_o, -1.0)

    def _pull(self, body: Body, weight_o: Array) -> Array:
        return self._force(body, weight_o, 1.0)

    def _shake(self, body: Body, mass: float, weight_o: Array) -> Array:
        size = float(np.linalg.norm(weight_o))
        first = weight_o / size if size else np.array([0.0, 0.0, -1.0])
        pushes = CIRCUMSCRIBED * self.size * mass * icosahedron(first, body.shape_pose[:3, :3])
        loads: Array = np.column_stack([weight_o + pushes, np.zeros((12, 3))])
        return loads

    def _loads(self, body: Body, weight_o: Array) -> Array:
        loads: Array = np.concatenate([weight_o, np.zeros(3)]) + np.array(self.wrenches).reshape(-1, 6)
        return loads

    def _force(self, body: Body, weight_o: Array, sign: float) -> Array:
        force = sign * self.size * self._direction_o(body)
        arm = np.zeros(3) if self.at is None else np.array(body.pose)[:3, :3] @ (np.array(self.at) - body.com_b)
        return np.array([[*(weight_o + force), *cross(arm, force)]])

    def _direction_o(self, body: Body) -> Array:
        direction: Array = np.array(body.pose)[:3, :3] @ np.array(self.direction)
        return direction


def _vector(name: str, value: ArrayLike) -> Vector:
    x, y, z = array_of(f"task: {name}", value, (3,)).tolist()
    return x, y, z


def icosahedron(first: Array, axes: Array) -> Array:
    """Unit vectors (12, 3): ``first`` (3,), its opposite, and two rings of five around it.

    The rings are turned with that column of ``axes`` (3, 3) which is most across ``first``.
    """
    across = axes[:, np.argmin(np.abs(first @ axes))]
    across = across - first * (first @ across)
    across /= np.linalg.norm(across)
    third, height = np.cross(first, across), 1 / np.sqrt(5)
    turns = np.pi / 5 * np.arange(10)
    ring = np.sqrt(1 - height**2) * (np.outer(np.cos(turns), across) + np.outer(np.sin(turns), third))
    ring += np.outer(height * (-1.0) ** np.arange(10), first)
    return np.concatenate([[first, -first], ring])
