"""Samples of a simulation at single instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinograsp.checks import brief
from pinograsp.simulation.law import Pressing, Touches
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """State of hand and object at one instant; p parts of the hand.

    Attributes:
        time: [s].
        q: joint positions (n,) [rad or m].
        dq: joint velocities (n,) [rad/s or m/s].
        torques: of the motors during the step that begins at this instant (n,) [N m or N].
        object_pose: oMs (4, 4), of the object's shape, at its centre of mass.
        forces_o: on the object (p, 3) [N].
        normal_forces: (p,) [N].
        tangential_forces: (p,) [N].
        depths: of the deepest points (p,) [m].
        slips: path slipped (p,) [m].
        energies: up to this instant by name [J], as :class:`~pinograsp.plan.History` has them.
    """

    time: float
    q: Array
    dq: Array
    torques: Array
    object_pose: Array
    forces_o: Array
    normal_forces: Array
    tangential_forces: Array
    depths: Array
    slips: Array
    energies: dict[str, float]

    __repr__ = brief("time", "normal_forces", "depths", "energies")


def sum_by_part(touches: Touches, pressing: Pressing, parts: int) -> dict[str, Array]:
    """Forces and depths of the touching points by part of the hand, under their names in :class:`Sample`."""
    force, across = np.zeros((parts, 3)), np.zeros((parts, 3))
    normal, depth = np.zeros(parts), np.zeros(parts)
    np.add.at(force, touches.part, pressing.force_o)
    np.add.at(normal, touches.part, pressing.normal)
    np.add.at(across, touches.part, pressing.force_o - pressing.normal[:, None] * touches.normal_o)
    np.maximum.at(depth, touches.part, touches.depth)
    tangential = np.linalg.norm(across, axis=1)
    return {"forces_o": force, "normal_forces": normal, "tangential_forces": tangential, "depths": depth}
