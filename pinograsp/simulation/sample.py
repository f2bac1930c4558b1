"""Records of a simulation: samples at single instants, and the history that they form."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pinograsp.checks import brief
from pinograsp.simulation.law import Pressing, Touches
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Energies:
    """Energies up to an instant [J].

    Attributes:
        joint_work: put in by the motors, less what the joints' dry friction takes.
        load_work: put in by the load.
        mechanical: change of the kinetic and potential energy since the start.
        elastic: stored in the contacts' springs.
        damped: lost in the contacts' damping.
        slipped: lost in slip.
        normal_work: integral of F_n over the depth.
    """

    joint_work: float
    load_work: float
    mechanical: float
    elastic: float
    damped: float
    slipped: float
    normal_work: float


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
        energies: put in, stored and lost.
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
    energies: Energies

    __repr__ = brief("time", "normal_forces", "depths", "energies")

    def with_kinetic(self, energy: float) -> Sample:
        """The same sample with the kinetic energy [J] added, which is known only a step later."""
        return replace(self, energies=replace(self.energies, mechanical=self.energies.mechanical + energy))


class PartSums(NamedTuple):
    """Forces and depths by part of the hand, as in :class:`Sample`."""

    forces_o: Array
    normal_forces: Array
    tangential_forces: Array
    depths: Array


def by_part(touches: Touches, pressing: Pressing, parts: int) -> PartSums:
    """Forces and depths of the touching points, by part of the hand."""
    force, across = np.zeros((parts, 3)), np.zeros((parts, 3))
    normal, depth = np.zeros(parts), np.zeros(parts)
    np.add.at(force, touches.part, pressing.force_o)
    np.add.at(normal, touches.part, pressing.normal)
    np.add.at(across, touches.part, pressing.force_o - pressing.normal[:, None] * touches.normal_o)
    np.maximum.at(depth, touches.part, touches.depth)
    return PartSums(
        forces_o=force,
        normal_forces=normal,
        tangential_forces=np.linalg.norm(across, axis=1),
        depths=depth,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """The samples of a simulation, as :class:`~pinograsp.plan.Simulation` has them; the poses are the shape's."""

    complete: int
    times: Array
    q: Array
    dq: Array
    torques: Array
    object_poses: Array
    parts: tuple[str, ...]
    forces_o: Array
    normal_forces: Array
    tangential_forces: Array
    depths: Array
    slips: Array
    planned_forces: Array
    energies: dict[str, Array]

    __repr__ = brief("times", "parts", "planned_forces")
