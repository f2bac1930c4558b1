"""A pick as data: its phases, and what joints are sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from pinograsp.carry import CarryPlan
from pinograsp.carry.cautions import OWN
from pinograsp.checks import brief, items_of, one_of
from pinograsp.errors import Status
from pinograsp.handover import JointTrajectory
from pinograsp.handover.sampling import sample_times
from pinograsp.hands import HandModel
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array
from pinograsp.words import lines_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickPhase:
    """A part of the motion, from rest to rest; n joints of arm and hand.

    Attributes:
        name: ``reach``, ``close``, ``carry`` (lift, path and putting down), ``open`` or ``leave``.
        times: (m,) [s], from 0.
        q, dq: (m, n) [rad, rad/s; m where joints slide].
        torques: feed-forward (m, n) [N m or N], with the object's weight while the hand holds it.
    """

    name: str
    times: Array
    q: Array
    dq: Array
    torques: Array

    __repr__ = brief("name", "duration")

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1])

    @classmethod
    def alone(
        cls, name: str, robot: HandModel, motion: tuple[Array, Array, Array, Array], gravity_o: Array
    ) -> PickPhase:
        """Return the phase as a motion (times, q, dq, ddq) of the robot without the object."""
        times, q, dq, ddq = motion
        return cls(name=name, times=times, q=q, dq=dq, torques=inverse_dynamics(robot, q, dq, ddq, gravity_o=gravity_o))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickRecord:
    """A plan of arm and hand from their start to the object, with it to its place, and back.

    Attributes:
        robot: arm and hand; its posture is that of the start.
        body: the object, in its place.
        scene: the obstacles.
        place: target pose (4, 4) of the object's frame; None: it is only lifted.
        grasp: plan of the hand alone: contacts, forces, what it withstands.
        carry: the path with the object.
        phases: the phases, in order.
        tried: number of grasps that were tried with the arm.
        elapsed: computing time by stage [s].
    """

    robot: HandModel
    body: Body
    scene: Scene
    place: Array | None
    grasp: GraspPlan
    carry: CarryPlan
    phases: tuple[PickPhase, ...]
    tried: int = 0
    elapsed: Mapping[str, float] = field(default_factory=dict)

    __repr__ = brief("status", "robot", "grasp", "phases", "elapsed")

    def __str__(self) -> str:
        return self.describe()

    @property
    def status(self) -> Status:
        """``OK``, or the status of the grasp or of the path with the object if one is not."""
        return self.grasp.status if self.grasp.status is not Status.OK else self.carry.status

    @property
    def duration(self) -> float:
        """Of all phases [s]."""
        return sum(phase.duration for phase in self.phases)

    def describe(self) -> str:
        """Describe the phases with their times, and the squeeze, as readable text."""
        squeeze = self.carry.squeeze
        lines = [f"{self.robot.name}: {self.status}; {self.duration:.3g} s"]
        for phase in self.phases:
            more = f", squeezing with {squeeze.min():.3g} to {squeeze.max():.3g} N" if phase.name == "carry" else ""
            lines.append(f"{phase.name}: {phase.duration:.3g} s{more}")
        return lines_of(*lines, *(f"warning: {one}" for one in self.cautions))

    def find_supports(self) -> set[str]:
        """Names of the obstacles on which the object stands, at the start and at the target."""
        return self.scene.find_supports(self.body, () if self.place is None else (self.place,))

    @property
    def cautions(self) -> tuple[str, ...]:
        """Warnings of the grasp and of the path with the object, each once."""
        own = [one for one in self.carry.cautions if not one.startswith(OWN)]  # these are the grasp's
        return tuple(dict.fromkeys((*self.grasp.cautions, *own)))

    def summary(self) -> dict[str, Any]:
        """The plan's figures as plain JSON values, units in the names."""
        squeeze = self.carry.squeeze
        return {
            "robot": self.robot.name,
            "status": self.status.value,
            "duration_s": self.duration,
            "phases_s": {phase.name: phase.duration for phase in self.phases},
            "squeeze_N": [float(squeeze.min()), float(squeeze.max())],
            "contacts": list(self.grasp.contacts.names),
            "tried": self.tried,
            "elapsed_s": dict(self.elapsed),
            "cautions": list(self.cautions),
        }

    def trajectory(self, *, rate: float = 1000.0, joints: Sequence[str] | None = None) -> JointTrajectory:
        """Return the commands of the joints of arm and hand in all phases, a trajectory with ``to_csv``, ``to_ros2``,
        ...

        Args:
            rate: of the samples [Hz].
            joints: of one controller, such as those of the arm alone; None: all.

        Raises:
            InvalidInput: a rate that is not above 0, or millions of samples; a joint that the robot does not have.
        """
        names = self.robot.joint_names if joints is None else items_of("joints", joints, str)
        which = [self.robot.joint_names.index(one_of("joints", name, self.robot.joint_names)) for name in names]
        times = sample_times(self.duration, rate)
        parts, begin = list[tuple[Array, ...]](), 0.0
        for i, phase in enumerate(self.phases):
            last = i == len(self.phases) - 1
            own = times[(times >= begin) & (last | (times < begin + phase.duration))] - begin
            own = np.minimum(own, phase.duration)
            curve = CubicHermiteSpline(phase.times, phase.q, phase.dq)
            torques = np.column_stack([np.interp(own, phase.times, column) for column in phase.torques.T])
            parts.append((curve(own), curve(own, 1), curve(own, 2), torques))
            begin += phase.duration
        q, dq, ddq, torques = (np.concatenate(part) for part in zip(*parts))
        dq[-1] = 0.0
        followers = {name: one for name, one in self.robot.couplings.items() if one.followed in names}
        return JointTrajectory(
            names=names,
            times=times,
            q=q[:, which],
            dq=dq[:, which],
            ddq=ddq[:, which],
            effort=torques[:, which],
            joints=tuple(name for name in self.robot.model.names if name in names or name in followers),
            couplings=followers,
            begin=0.0,
            impact_time=0.0,
            final_time=self.duration,
        )
