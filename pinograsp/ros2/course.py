"""What is sent over time: a plan's trajectory first, where it is played, then what the controller says."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.handover import joint_trajectory
from pinograsp.planner import GraspPlan
from pinograsp.reflex import Felt, GripController
from pinograsp.spatial import Array


class Sent(NamedTuple):
    """What the joints are sent at a tick.

    Attributes:
        positions: the plan's, or references that make the torques with the servos' stiffness (n,) [rad or m].
        efforts: (n,) [N m or N].
    """

    positions: Array
    efforts: Array


class Approach:
    """The plan's trajectory from a posture on, at the rate of the ticks, to the end of its motion.

    Args:
        plan: that is played.
        rate: of the ticks [Hz].
        start: where the hand is (n,) [rad or m].
        stiffness: of the position servos (n,) [N m/rad or N/m]; None: positions are the plan's.

    Raises:
        InvalidInput: a start outside the joints' limits.
    """

    def __init__(self, plan: GraspPlan, rate: float, start: Array, stiffness: Array | None):
        trajectory = joint_trajectory(plan, rate=rate, start=start)
        self.rate, self.duration, self.notes = rate, float(trajectory.times[-1]), trajectory.notes
        self._positions = trajectory.q if stiffness is None else trajectory.q + trajectory.effort / stiffness
        self._efforts = trajectory.effort

    def at(self, since: float) -> Sent:
        """What is sent at a time since its beginning [s]; at its end, and after it, the last sample."""
        row = min(round(since * self.rate), len(self._positions) - 1)
        return Sent(self._positions[row], self._efforts[row])


class Hold:
    """The controller's commands; from efforts that were measured before, over to them.

    A node that takes over a held object cannot know what the drives were sent last. What they make tells: the first
    command makes the same, and the difference fades.

    Args:
        plan: whose grasp is held.
        controller: of the plan.
        fading: how long it takes to go over [s].
        servos: whether references are commanded, by the servos' stiffness that the controller was told; else torques.
    """

    def __init__(self, plan: GraspPlan, controller: GripController, fading: float, servos: bool):
        self.controller, self.fading, self.servos = controller, fading, servos
        self._planned = np.array(plan.motion.q[-1])
        self._extra: Array | None = None
        self._measured: Array | None = None
        self._begun = 0.0

    def begin(self, time: float, efforts: Array | None) -> None:
        """From ``efforts`` that are measured (n,) [N m or N]; None: from the controller's own."""
        self._begun, self._measured, self._extra = time, efforts, None
        self.controller.reset()

    def at(self, felt: Felt) -> Sent:
        """What is sent at a tick."""
        torques = np.array(self.controller.step(felt).torques)
        if self._measured is not None:
            self._extra, self._measured = self._measured - torques, None
        if self._extra is not None:
            share = 1.0 - (felt.time - self._begun) / self.fading if self.fading > 0 else 0.0
            torques += max(share, 0.0) * self._extra
            if share <= 0.0:
                self._extra = None
        return Sent(self.controller.loop.place_servos(torques).copy() if self.servos else self._planned, torques)
