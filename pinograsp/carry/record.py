"""What carrying an object along an arm's path takes, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from pinograsp.carry.path import ArmPath
from pinograsp.carry.timing import Timing
from pinograsp.checks import brief
from pinograsp.errors import Status
from pinograsp.handover import JointTrajectory
from pinograsp.handover.quintic import interpolate
from pinograsp.handover.sampling import sample_times
from pinograsp.hands import HandModel
from pinograsp.motion.torques import drives_limit
from pinograsp.plan import Motion
from pinograsp.planner import GraspPlan
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryRecord:
    """The timing of a path with the contact forces and joint torques along it; N intervals, k contacts, n joints.

    Loads, forces and torques are those at the middles of the intervals. Vectors on the object are in axes that turn
    with the palm, those of the world where the grasp was planned.

    Attributes:
        robot: arm and hand.
        grasp: the grasp that is carried.
        path: the arm's path.
        gravity_o: (3,) [m/s^2].
        timing: of the path.
        closing: motion in which the grasp's hand closes to the first squeeze, as in the grasp's plan.
        contacts: names of the contacts (k,).
        s: path parameter at the ends of the intervals (N + 1,), from 0 to 1.
        times: times at these ends (N + 1,) [s].
        speed: of the path parameter at these ends (N + 1,) [1/s].
        instants: times of the middles (N,) [s].
        limit: largest speed of the path parameter at each middle by itself (N,) [1/s].
        q: positions at the middles (N, n) [rad or m].
        dq: speeds (N, n) [rad/s or m/s].
        ddq: accelerations (N, n) [rad/s^2 or m/s^2].
        torques: of all joints (N, n) [N m or N].
        loads: wrench on the object that the forces balance (N, 6), about its centre of mass, linear first [N, N m].
        forces_o: on the object (N, k, 3) [N].
        normal_forces: (N, k) [N].
        commanded: commanded normal forces (N, k) [N]; they equal the normal forces unless these are commanded once, or
            change slowly, and the contacts react to the loads.
        commanded_q: commanded positions of the joints (N, n) [rad or m]: fingers closed further than in the grasp if
            contacts have to be deeper.
        commanded_torques: feed-forward that goes with them (N, n) [N m or N].
        torsion: moments about the normals (N, k) [N m].
        friction_use: used share of the friction on which the plan relies (N, k) [-].
        binding: the limit that binds in each interval (N,), in words.
        reserve: share of friction, caps, torques and speeds that is kept free [-].
        fastest: duration of the fastest timing, whose accelerations jump [s]; None: the timing was given.
        lower_bound: no timing of the N intervals within these limits is faster [s]; None: the timing was given.
        factor: possible speed over that of this timing, with a squeeze that follows the loads [-].
        disturbance: additional disturbance that the squeeze withstands along the path: a force in any direction [N], or
            a moment [N m].
        residual: largest error of the balance, over the largest load [-].
        elapsed: computing time by stage [s].
        notes: remarks for the caller.
        cautions: why the plan is doubtful although its forces balance the loads; empty without doubts.
    """

    robot: HandModel
    grasp: GraspPlan
    path: ArmPath
    gravity_o: Array
    timing: Timing
    closing: Motion
    contacts: tuple[str, ...]
    s: Array
    times: Array
    speed: Array
    instants: Array
    limit: Array
    q: Array
    dq: Array
    ddq: Array
    torques: Array
    loads: Array
    forces_o: Array
    normal_forces: Array
    commanded: Array
    commanded_q: Array
    commanded_torques: Array
    torsion: Array
    friction_use: Array
    binding: tuple[str, ...]
    reserve: float
    fastest: float | None
    lower_bound: float | None
    factor: float
    disturbance: tuple[float, float]
    residual: float
    elapsed: dict[str, float]
    notes: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()

    __repr__ = brief("status", "robot", "duration", "fastest", "lower_bound", "residual", "elapsed")

    def __str__(self) -> str:
        return self.describe()

    @property
    def status(self) -> Status:
        """``OK``; ``DOUBTFUL`` with warnings."""
        return Status.DOUBTFUL if self.cautions else Status.OK

    @property
    def duration(self) -> float:
        """Duration of the plan [s]."""
        return self.timing.duration

    @property
    def gap(self) -> float | None:
        """Relative gap between the fastest timing and its lower bound [-]; None: the timing was given."""
        if self.fastest is None or self.lower_bound is None:
            return None
        return (self.fastest - self.lower_bound) / self.fastest

    @property
    def squeeze(self) -> Array:
        """Sums of the normal forces (N,) [N]."""
        return np.asarray(self.normal_forces.sum(axis=1))

    @property
    def closing_stiffness(self) -> dict[str, float] | None:
        """Gains of the fingers' servos while the hand closes, ``{joint: N m/rad or N/m}``, see
        :class:`~pinograsp.plan.Motion`; None: those that they have anyway.
        """
        if (soft := self.closing.closing_stiffness) is None:
            return None
        hand = self.grasp.require_hand()
        return {hand.joint_names[i]: float(soft[i]) for finger in hand.fingers for i in finger.dofs}

    @property
    def torque_limits(self) -> Array:
        """Largest torques that the robot's joints and drives can produce (n,) [N m or N], infinity if unknown."""
        return drives_limit(self.robot)

    def describe(self) -> str:
        """Describe duration, squeeze and the limits that bind, as readable text."""
        peak = int(self.squeeze.argmax())
        kept = f"within the limits ({100 * self.reserve:g} % of them kept free)"
        if self.fastest is None:
            timed = f"along the trajectory of {self.duration:.4g} s, or up to {self.factor:.3g} times as fast, {kept}"
        else:
            timed = (
                f"in {self.duration:.4g} s ({self.fastest:.4g} s with accelerations that jump; no timing of this path "
                f"takes less than {self.lower_bound:.4g} s {kept})"
            )
        lines = [
            f"{self.robot.name} carries it {timed}",
            f"  squeeze {self.squeeze.min():.3g} to {self.squeeze[peak]:.3g} N (sum of normal forces), most at "
            f"{self.instants[peak]:.3g} s; it also withstands {self.disturbance[0]:.3g} N in any direction",
            "  limits that bind along the path:",
        ]
        for what, first, last in self.stretches():
            lines.append(f"    {self.times[first]:.3g} to {self.times[last + 1]:.3g} s: {what}")
        lines += [f"  warning: {one}" for one in self.cautions]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def shares(self) -> list[tuple[str, float]]:
        """The limits that bind, and their shares of the time, the largest first [-]."""
        took = np.diff(self.times) / self.times[-1]
        found: dict[str, float] = {}
        for what, share in zip(self.binding, took.tolist()):
            found[what] = found.get(what, 0.0) + share
        return sorted(found.items(), key=lambda one: -one[1])

    def summary(self) -> dict[str, Any]:
        """The plan's figures as plain JSON values, units in the names."""
        return {
            "robot": self.robot.name,
            "duration_s": self.duration,
            "fastest_s": self.fastest,
            "lower_bound_s": self.lower_bound,
            "relative_gap": self.gap,
            "speed_factor": self.factor,
            "reserve": self.reserve,
            "disturbance_N": self.disturbance[0],
            "disturbance_Nm": self.disturbance[1],
            "squeeze_N": [float(self.squeeze.min()), float(self.squeeze.max())],
            "normal_forces_N": dict(zip(self.contacts, self.normal_forces.max(axis=0).tolist())),
            "friction_use": float(self.friction_use.max()),
            "binds": dict(self.shares()),
            "residual": self.residual,
            "elapsed_s": dict(self.elapsed),
            "status": str(self.status),
            "cautions": list(self.cautions),
            "notes": list(self.notes),
        }

    def trajectory(self, *, rate: float = 1000.0) -> JointTrajectory:
        """Return the commands of the joints of arm and fingers at a rate [Hz], a trajectory with ``to_csv``,
        ``to_ros2``, ...

        It begins in the grasp, at the start of the path.

        Raises:
            InvalidInput: a rate that is not above 0, or millions of samples.
        """
        times = sample_times(self.duration, rate)
        moving = self.timing.at(times)
        point, v, a = self.path.at(moving.s), moving.speed[:, None], moving.acceleration[:, None]
        # Before the first sample and after the last the squeeze stays.
        step = times[1]
        instants = np.concatenate([[-step], self.instants, [self.duration + step]])
        ends = np.concatenate([self.commanded_q[:1], self.commanded_q, self.commanded_q[-1:]])
        fingers = PchipInterpolator(instants, ends)
        q, dq, ddq = (np.array(fingers(times, order)) for order in (0, 1, 2))
        arm = [self.robot.joint_names.index(joint) for joint in self.path.joints]
        q[:, arm], dq[:, arm], ddq[:, arm] = point.q, point.slope * v, point.slope * a + point.bend * v**2
        return JointTrajectory(
            names=self.robot.joint_names,
            times=times,
            q=q,
            dq=dq,
            ddq=ddq,
            effort=interpolate(times, self.instants, self.commanded_torques),
            joints=tuple(self.robot.model.names)[1:],
            couplings=self.robot.couplings,
            begin=0.0,
            impact_time=0.0,
            final_time=self.duration,
            notes=self.notes,
        )

    def stretches(self) -> list[tuple[str, int, int]]:
        """The limits that bind, with the first and last interval of each stretch."""
        found: list[tuple[str, int, int]] = []
        for i, what in enumerate(self.binding):
            if found and found[-1][0] == what:
                found[-1] = (what, found[-1][1], i)
            else:
                found.append((what, i, i))
        return found
