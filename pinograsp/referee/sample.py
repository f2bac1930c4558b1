"""What is recorded of a simulation at an instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import brief
from pinograsp.referee.law import Pressing, Touches


@dataclass(frozen=True, slots=True, kw_only=True)
class Energies:
    """Energies up to an instant [J].

    Attributes:
        joint_work: put in by the motors.
        load_work: put in by the load.
        mechanical: kinetic and potential energy held, since the start.
        elastic: held by the contacts' springs.
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
    """Hand and object at an instant; p parts of the hand.

    Attributes:
        time: [s].
        q: joint positions (n,) [rad or m].
        dq: joint velocities (n,) [rad/s or m/s].
        torques: of the motors over the step that begins then (n,) [N m or N].
        object_pose: (4, 4).
        forces_o: on the object (p, 3) [N].
        normal_forces: (p,) [N].
        tangential_forces: (p,) [N].
        depths: of the deepest points (p,) [m].
        slips: path slipped (p,) [m].
        energies: put in, held and lost.
    """

    time: float
    q: np.ndarray
    dq: np.ndarray
    torques: np.ndarray
    object_pose: np.ndarray
    forces_o: np.ndarray
    normal_forces: np.ndarray
    tangential_forces: np.ndarray
    depths: np.ndarray
    slips: np.ndarray
    energies: Energies

    __repr__ = brief("time", "normal_forces", "depths", "energies")

    def with_kinetic(self, energy: float) -> Sample:
        """The same with the kinetic energy [J], which is known half a step later."""
        return replace(self, energies=replace(self.energies, mechanical=self.energies.mechanical + energy))


def by_part(touches: Touches, pressing: Pressing, parts: int) -> dict[str, np.ndarray]:
    """Forces and depths of the points that touch, by part of the hand: fields of a :class:`Sample`."""
    force, across, depth = np.zeros((parts, 3)), np.zeros((parts, 3)), np.zeros(parts)
    np.add.at(force, touches.part, pressing.force_o)
    np.add.at(across, touches.part, pressing.force_o - pressing.normal[:, None] * touches.normal_o)
    np.maximum.at(depth, touches.part, touches.depth)
    return {
        "forces_o": force,
        "normal_forces": np.bincount(touches.part, weights=pressing.normal, minlength=parts),
        "tangential_forces": np.linalg.norm(across, axis=1),
        "depths": depth,
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """The samples of a simulation, by the parts of the hand that touch or should: as in ``Simulation``."""

    complete: int
    times: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torques: np.ndarray
    object_poses: np.ndarray
    parts: tuple[str, ...]
    forces_o: np.ndarray
    normal_forces: np.ndarray
    tangential_forces: np.ndarray
    depths: np.ndarray
    slips: np.ndarray
    planned_forces: np.ndarray
    energies: dict[str, np.ndarray]

    __repr__ = brief("times", "parts", "planned_forces")
