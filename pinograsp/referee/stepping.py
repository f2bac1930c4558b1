"""A plan played step by step: the commands, what holds the object until it is let go, and the loop over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from pinograsp.checks import array_of
from pinograsp.errors import SimulationDiverged
from pinograsp.referee.law import ContactLaw, Pressing, Touches
from pinograsp.referee.sample import Energies, Sample, by_part
from pinograsp.referee.settings import Disturbance
from pinograsp.referee.task import Task
from pinograsp.referee.verdict import GONE

_SUPPORT = 200.0  # [rad/s] of the object on the support that lets it go
_FASTEST = 1e3  # [m/s, rad/s] faster than any hand: the simulation has come apart


class Engine(Protocol):
    """Hand and object, stepped in time: :class:`~pinograsp.referee.pinocchio_engine.PinocchioEngine` says how."""

    parts: int
    notes: tuple[str, ...]
    torques: np.ndarray

    @property
    def q(self) -> np.ndarray:
        """Joint positions (n,)."""

    @property
    def dq(self) -> np.ndarray:
        """Joint velocities (n,)."""

    @property
    def object_pose(self) -> np.ndarray:
        """(4, 4)."""

    @property
    def object_twist(self) -> np.ndarray:
        """(6,) [m/s, rad/s]."""

    def place(self, q: np.ndarray, dq: np.ndarray, object_pose: np.ndarray | None = None) -> None:
        """Put the joints at q, dq, and the object at rest at a pose."""

    def set_gravity(self, gravity_o: np.ndarray) -> None:
        """Gravity from now on (3,) [m/s^2]."""

    def touches(self) -> Touches:
        """Where the hand is in the object."""

    def potential_energy(self) -> float:
        """[J]."""

    def kinetic_energy(self) -> float:
        """[J]."""

    def step(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        feed_forward: np.ndarray,
        touches: Touches,
        pressing: Pressing,
        wrench_o: np.ndarray,
    ) -> None:
        """One step with servos."""

    def step_prescribed(self, ddq: np.ndarray, touches: Touches, pressing: Pressing, wrench_o: np.ndarray) -> None:
        """One step with joints that move as commanded."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule:
    """How long, in which steps, and what is not as planned.

    Attributes:
        time_step: [s].
        duration: of the whole simulation [s].
        every: steps between samples.
        release: whether the object is let go at t_F.
        letting_go: how long its support takes to give way [s].
        prescribed: whether joints move as commanded, whatever it takes.
        disturbance: what is not as planned.
    """

    time_step: float
    duration: float
    every: int
    release: bool
    letting_go: float
    prescribed: bool
    disturbance: Disturbance


class _Course:
    """What the joints are commanded at every step; at t_F and after it the last command holds."""

    def __init__(self, task: Task, schedule: Schedule):
        dt = schedule.time_step
        self.steps, self.let_go = round(schedule.duration / dt), round(task.final_time / dt)
        instants = dt * np.arange(min(self.steps, self.let_go + 2) + 1)
        spline, until = CubicHermiteSpline(task.times, task.q, task.dq), np.minimum(instants, task.final_time)
        self.q, self.dq = spline(until), spline(until, 1)
        self.ddq = np.zeros_like(self.q)
        self.torques = np.column_stack([np.interp(instants, task.times, column) for column in task.torques.T])
        held = instants > task.final_time - 0.5 * dt
        self.dq[held], self.torques[held] = 0.0, task.holding_torques
        if schedule.prescribed:  # as the engines step: what a velocity leads to is the next position
            self.dq[1:] = np.diff(self.q, axis=0) / dt
            self.ddq[:-1], self.ddq[-1] = np.diff(self.dq, axis=0) / dt, 0.0

    def at(self, step: int) -> int:
        """The row of a step."""
        return min(step, len(self.q) - 1)


class _Support:
    """What has held the object until t_F: its force and its stiffness fade away together."""

    def __init__(self, task: Task, pose: np.ndarray, mass_factor: float, duration: float):
        self.task, self.pose, self.duration = task, pose, duration
        mass = mass_factor * task.body.mass
        inertia = float(np.linalg.eigvalsh(mass_factor * task.body.inertia_b)[0])
        self.spring = np.repeat([mass, inertia], 3) * _SUPPORT**2
        self.damper = 2 * np.repeat([mass, inertia], 3) * _SUPPORT
        self.weight = np.concatenate([mass * task.gravity_o, np.zeros(3)])
        self.carried: np.ndarray | None = None

    def wrench(self, since: float, engine: Engine, touches: Touches, pressing: Pressing) -> np.ndarray:
        """On the object (6,) [N, N m], so long after t_F [s]."""
        if since >= self.duration:
            return np.zeros(6)
        pose = engine.object_pose
        if self.carried is None:  # at t_F: all that keeps the object where it is
            moments = np.cross(touches.point_o - pose[:3, 3], pressing.force_o) + pressing.moment_o
            pressed = np.concatenate([pressing.force_o.sum(axis=0), moments.sum(axis=0)])
            self.carried = -(pressed + self.weight + self.task.load)
        moved = np.concatenate([pose[:3, 3] - self.pose[:3, 3], pin.log3(pose[:3, :3] @ self.pose[:3, :3].T)])
        return (1 - since / self.duration) * (self.carried - self.spring * moved - self.damper * engine.object_twist)


class Trial:
    """One run of an engine through a task.

    Attributes:
        samples: what was recorded.
        complete: the sample at t_F.
        gone: whether the object was so far away that the simulation ended early.
    """

    def __init__(self, task: Task, engine: Engine, law: ContactLaw, schedule: Schedule):
        self.task, self.engine, self.law, self.schedule = task, engine, law, schedule
        self.course, disturbance = _Course(task, schedule), schedule.disturbance
        self.pose = np.array(task.body.pose)
        self.pose[:3, 3] += disturbance.object_offset
        self.pose[:3, :3] = pin.exp3(np.array(disturbance.object_turn)) @ self.pose[:3, :3]
        self.support = _Support(task, self.pose, disturbance.mass_factor, schedule.letting_go)
        self.shaken = bool(np.any(disturbance.shake))
        self.samples: list[Sample] = []
        self.complete, self.gone = 0, False
        self.joint_work = self.load_work = 0.0

    def run(self) -> None:
        """From t = 0 to the end of the hold, or until the object is gone."""
        engine, steps = self.engine, self.course.steps
        start = self.schedule.disturbance.start_error
        error = 0.0 if start is None else array_of("start error", start, (self.task.hand.n,))
        engine.place(self.course.q[0] + error, self.course.dq[0], self.pose)
        pending: Sample | None = None
        base = kinetic = None
        for i in range(steps + 2):  # the last is for what the sample before it lacks
            self._settle(i)
            touches = self.law.counted(engine.touches())
            # Velocities are half a step behind positions: energies take the mean of two.
            before, kinetic = kinetic, engine.kinetic_energy()
            base = engine.potential_energy() + kinetic if base is None else base
            if pending is not None:
                self.samples.append(pending.with_kinetic(0.5 * (before + kinetic) - base))
                # Of the sample, not of now: the verdict must see that it is gone.
                self.gone = bool(np.linalg.norm(pending.object_pose[:3, 3] - self.pose[:3, 3]) > GONE)
                if i > steps or self.gone:
                    return
            pending = self._step(i, touches)

    def _is_fixed(self, i: int) -> bool:
        """Whether the object is held at that step."""
        return not self.schedule.release or i < self.course.let_go

    def _settle(self, i: int) -> None:
        """Put hand and object where they are held, and shake the hand, before a step."""
        course, engine, prescribed = self.course, self.engine, self.schedule.prescribed
        still = self._is_fixed(i) or i == course.let_go  # it is let go from where it was, at rest
        now = course.at(i)
        if still or prescribed:
            q, dq = (course.q[now], course.dq[now]) if prescribed else (engine.q, engine.dq)
            engine.place(q, dq, self.pose if still else None)
        if self.shaken and not self._is_fixed(i):
            disturbance = self.schedule.disturbance
            since = self.schedule.time_step * i - self.task.final_time
            swing = disturbance.shake * np.sin(2 * np.pi * disturbance.shake_frequency * since)
            engine.set_gravity(self.task.gravity_o - swing)

    def _step(self, i: int, touches: Touches) -> Sample | None:
        """One step; a sample of the state before it where one is due, without its kinetic energy."""
        engine, course, law, dt = self.engine, self.course, self.law, self.schedule.time_step
        potential = engine.potential_energy()
        pressing = law.press(touches, dt)
        speeds, object_speed = engine.dq, engine.object_twist
        wrench, fixed, now = self._wrench(i, touches, pressing), self._is_fixed(i), course.at(i)
        due = i % self.schedule.every == 0 or i in (course.steps, course.let_go)
        if i == course.let_go:
            self.complete = len(self.samples)
        q, pose = (engine.q, engine.object_pose) if due else (speeds, self.pose)
        if self.schedule.prescribed:
            engine.step_prescribed(course.ddq[now], touches, pressing, wrench)
            after = course.dq[course.at(i + 1)]
        else:
            engine.step(course.q[now], course.dq[now], course.torques[now], touches, pressing, wrench)
            after = engine.dq
        if not np.abs(after).max(initial=0.0) < _FASTEST or not np.isfinite(engine.object_twist).all():
            raise SimulationDiverged(dt * i, dt)
        self._account(dt, speeds, wrench, object_speed, fixed)
        sample = None
        if due:
            energies = Energies(
                joint_work=self.joint_work,
                load_work=self.load_work,
                mechanical=potential,
                elastic=law.elastic,
                damped=law.damped,
                slipped=law.slipped,
                normal_work=law.normal_work,
            )
            sample = Sample(
                time=dt * i,
                q=q,
                dq=speeds,
                torques=engine.torques,
                object_pose=pose,
                slips=law.slip.copy(),
                energies=energies,
                **by_part(touches, pressing, engine.parts),
            )
        self._account(dt, after, wrench, engine.object_twist, fixed)
        return sample

    def _wrench(self, i: int, touches: Touches, pressing: Pressing) -> np.ndarray:
        """Load, disturbances and support on the object (6,) [N, N m]; nothing while it is held."""
        if self._is_fixed(i):
            return np.zeros(6)
        since = self.schedule.time_step * i - self.task.final_time
        disturbed = self.schedule.disturbance.wrench(since - self.schedule.letting_go)
        return self.task.load + disturbed + self.support.wrench(since, self.engine, touches, pressing)

    def _account(
        self, dt: float, speeds: np.ndarray, wrench: np.ndarray, object_speed: np.ndarray, fixed: bool
    ) -> None:
        """Half a step's work of motors and load."""
        self.joint_work += 0.5 * dt * float(self.engine.torques @ speeds)
        self.load_work += 0.0 if fixed else 0.5 * dt * float(wrench @ object_speed)
