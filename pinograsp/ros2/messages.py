"""What messages of sensors say, as arrays of the controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pinograsp.checks import array_of
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, cross


class JointReader:
    """Reads ``sensor_msgs/JointState``, by the joints' names.

    Args:
        names: of the hand's joints, in the order that is wanted (n,).
    """

    def __init__(self, names: Sequence[str]):
        self.names = tuple(names)
        self._told: list[str] = []
        self._places: list[int] = []

    def read(self, field: str, message: Any) -> Array | None:
        """A field of the message (n,), ``position`` or ``effort``; None: it is empty, or about other joints.

        Raises:
            InvalidInput: joints of the hand that are missing, another size, numbers that are not finite.
        """
        if message.name != self._told:
            missing = [name for name in self.names if name not in message.name]
            if 0 < len(missing) < len(self.names):
                raise InvalidInput(f"name: expected all joints of the hand, got none named {', '.join(missing)}")
            self._places = [] if missing else [message.name.index(name) for name in self.names]
            self._told = list(message.name)
        values = getattr(message, field)
        if not self._places or len(values) == 0:
            return None
        if len(values) != len(self._told):
            raise InvalidInput(f"{field}: expected one for each of {len(self._told)} names, got {len(values)}")
        return array_of(field, np.array(values, dtype=float)[self._places], (len(self.names),))


def read_numbers(message: Any, shape: tuple[int, ...]) -> Array:
    """The numbers of a ``std_msgs/Float64MultiArray``, row by row; its layout is not looked at.

    Raises:
        InvalidInput: another count than that of ``shape``, numbers that are not finite.
    """
    values, count = np.array(message.data, dtype=float), int(np.prod(shape))
    if values.size != count:
        raise InvalidInput(f"data: expected {count} numbers ({'x'.join(map(str, shape))}), got {values.size}")
    return array_of("data", values.reshape(shape), shape)


def read_vector(vector: Any) -> Array:
    """A ``geometry_msgs/Vector3`` (3,); :class:`InvalidInput` where a number is not finite."""
    return array_of("vector", [vector.x, vector.y, vector.z], (3,))


def read_wrench(message: Any, sensor_pose: Array, com_o: Array) -> Array:
    """A ``geometry_msgs/WrenchStamped`` in world axes about the centre of mass (6,) [N, N m], linear first.

    Args:
        message: in the sensor's axes, about its origin.
        sensor_pose: of the sensor in the plan's world (4, 4).
        com_o: the object's centre of mass (3,) [m].

    Raises:
        InvalidInput: numbers that are not finite.
    """
    rotation = sensor_pose[:3, :3]
    force = rotation @ read_vector(message.wrench.force)
    moment = rotation @ read_vector(message.wrench.torque)
    return np.concatenate([force, moment + cross(sensor_pose[:3, 3] - com_o, force)])


class Told:
    """What is wrong with messages: told once for each topic and field, counted ever after.

    Attributes:
        counts: messages that were left out, by topic.
    """

    def __init__(self, warn: Any):
        self.warn = warn
        self.counts: dict[str, int] = {}
        self._known: set[tuple[str, str]] = set()

    def leave_out(self, topic: str, error: object) -> None:
        """A message was of no use."""
        what = (topic, str(error).partition(":")[0])
        if what not in self._known:
            self._known.add(what)
            self.warn(f"{topic}: {error}; such messages are left out, without further warnings")
        self.counts[topic] = self.counts.get(topic, 0) + 1
