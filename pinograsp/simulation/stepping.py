"""A plan simulated step by step: the commands, the object's support until it is let go, and the loop over time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of
from pinograsp.errors import SimulationDiverged
from pinograsp.simulation.law import ContactForces, Pressing, Touches
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.sample import Sample, sum_by_part
from pinograsp.simulation.schedule import Course, Schedule
from pinograsp.simulation.sensing import ControlLoop
from pinograsp.simulation.table import Table
from pinograsp.simulation.task import Task
from pinograsp.simulation.verdict import GONE
from pinograsp.spatial import Array, cross

_SUPPORT = 200.0  # [rad/s] natural frequency of the object on its support
_FASTEST = 1e3  # [m/s, rad/s] faster than any hand: the simulation has diverged


class _Fixture:
    """What holds the object until t_F; its force and its stiffness then fade together."""

    def __init__(self, task: Task, pose: Array, mass_factor: float, duration: float):
        self.task, self.pose, self.duration = task, pose, duration
        mass = mass_factor * task.body.mass
        inertia = float(np.linalg.eigvalsh(mass_factor * task.body.inertia_b)[0])
        inertias: Array = np.repeat(np.array([mass, inertia]), 3)
        self.spring, self.damper = inertias * _SUPPORT**2, 2 * inertias * _SUPPORT
        self.weight = np.concatenate([mass * task.gravity_o, np.zeros(3)])
        self.carried: Array | None = None

    def wrench(self, since: float, engine: MujocoEngine, touches: Touches, pressing: Pressing) -> Array:
        """On the object (6,) [N, N m], at a time after t_F [s]."""
        if since >= self.duration:
            return np.zeros(6)
        pose = engine.object_pose
        if self.carried is None:  # at t_F: what keeps the object in equilibrium
            moments = cross(touches.point_o - pose[:3, 3], pressing.force_o) + pressing.moment_o
            pressed = np.concatenate([pressing.force_o.sum(axis=0), moments.sum(axis=0)])
            self.carried = -(pressed + self.weight + self.task.load)
        moved = np.concatenate([pose[:3, 3] - self.pose[:3, 3], pin.log3(pose[:3, :3] @ self.pose[:3, :3].T)])
        full: Array = self.carried - self.spring * moved - self.damper * engine.object_twist
        return (1 - since / self.duration) * full


class Trial:
    """One simulation of a task.

    Attributes:
        samples: what was recorded.
        complete: index of the sample at t_F.
        gone: whether the object was so far away that the simulation ended early.
    """

    def __init__(self, task: Task, engine: MujocoEngine, law: ContactForces, schedule: Schedule):
        self.task, self.engine, self.law, self.schedule = task, engine, law, schedule
        self.options, self.course = schedule.options, Course(task, schedule)
        disturbance = self.options.disturbance
        self.pose = np.array(task.body.shape_pose)
        self.pose[:3, 3] += disturbance.object_offset
        self.pose[:3, :3] = pin.exp3(np.array(disturbance.object_turn)) @ self.pose[:3, :3]
        self.fixture = _Fixture(task, self.pose, disturbance.mass_factor, self.options.letting_go)
        self.table: Table | None = None
        if self.options.support == "table":
            mass, mu = disturbance.mass_factor * task.body.mass, float(task.mu.mean())
            self.table = Table(task.body, self.pose, task.gravity_o, mass, mu, schedule.time_step)
        self.moved = disturbance.accelerates
        self.loop: ControlLoop | None = None
        if self.options.controller is not None:
            self.loop = ControlLoop(task, self.options.controller, self.options.sensors, disturbance)
        self.samples: list[Sample] = []
        self.complete, self.gone = 0, False
        self.joint_work = self.load_work = 0.0

    def run(self) -> None:
        """From t = 0 to the end of the hold, or until the object is gone."""
        engine, steps = self.engine, self.course.steps
        start = self.options.disturbance.start_error
        error = np.zeros(self.task.hand.n) if start is None else array_of("start error", start, (self.task.hand.n,))
        engine.place(self.course.q[0] + error, self.course.dq[0], self.pose)
        pending: Sample | None = None
        kinetic = start_energy = 0.0
        for i in range(steps + 2):  # the last one completes the sample before it
            self._settle(i)
            touches = self.law.drop_shallower(engine.touches())
            # Velocities are half a step behind positions: energies take the mean of two.
            before, kinetic = kinetic, engine.kinetic_energy()
            if i == 0:
                start_energy = engine.potential_energy() + kinetic
            if pending is not None:
                pending.energies["mechanical"] += 0.5 * (before + kinetic) - start_energy
                self.samples.append(pending)
                # By the pose of the sample, not the present one: the verdict is read from the samples.
                self.gone = self._is_gone(pending)
                if i > steps or self.gone:
                    return
            pending = self._step(i, touches)

    def _is_gone(self, sample: Sample) -> bool:
        """Whether the object is far from where it is to stay."""
        q, poses = np.array([self.course.q[0], sample.q]), np.array([self.pose, sample.object_pose])
        there = self.task.as_carried(q, poses)[1, :3, 3]
        return bool(np.linalg.norm(there - self.pose[:3, 3]) > GONE)

    def _is_fixed(self, i: int) -> bool:
        """Whether the object is fixed at a step."""
        return not self.options.release or i < self.course.free

    def _settle(self, i: int) -> None:
        """Before a step: place hand and object where they are fixed, and shake the hand."""
        course, engine, prescribed = self.course, self.engine, self.schedule.is_prescribed
        still = self._is_fixed(i) or i == course.free  # it is let go from rest
        now = course.row(i)
        if still or prescribed:
            q, dq = (course.q[now], course.dq[now]) if prescribed else (engine.q, engine.dq)
            engine.place(q, dq, self.pose if still else None)
        if self.moved and self.options.release and i >= course.complete:
            since = self.schedule.time_step * i - self.task.final_time
            engine.set_gravity(self.task.gravity_o - self.options.disturbance.acceleration(since))

    def _step(self, i: int, touches: Touches) -> Sample | None:
        """One step; returns a sample of the state before it where one is due, without its kinetic energy."""
        engine, course, law, dt = self.engine, self.course, self.law, self.schedule.time_step
        potential = engine.potential_energy()
        pose = engine.object_pose
        pressing = law.press(touches, dt, pose)
        speeds, object_speed = engine.dq, engine.object_twist
        wrench, fixed, now = self._wrench(i, touches, pressing), self._is_fixed(i), course.row(i)
        due = i % self.schedule.every == 0 or i in (course.steps, course.complete)
        if i == course.complete:
            self.complete = len(self.samples)
        if i == course.stiff:
            engine.stiffen(course.q[now])
        q = engine.q if due else speeds
        if self.schedule.is_prescribed:
            engine.step_prescribed(course.ddq[now], touches, pressing, wrench)
            after = course.dq[course.row(i + 1)]
        else:
            commands = course.row_commands(now)
            if self.loop is not None:
                self.loop.tick(dt * i, engine, law, touches, pressing)
                if (command := self.loop.command(dt * i)) is not None:
                    commands = course.follow(now, command, engine.moved)
            engine.step(*commands[:3], touches, pressing, wrench, commands[3])
            after = engine.dq
        object_after = engine.object_twist
        if not np.abs(after).max(initial=0.0) < _FASTEST or not np.isfinite(object_after).all():
            raise SimulationDiverged(dt * i, dt)
        self._account(dt, speeds, wrench, object_speed, fixed)
        sample = None
        if due:
            own = {"joint_work": self.joint_work, "load_work": self.load_work, "mechanical": potential}
            of_contacts = {name: getattr(law, name) for name in ("elastic", "damped", "slipped", "normal_work")}
            sample = Sample(
                time=dt * i,
                q=q,
                dq=speeds,
                torques=engine.torques,
                object_pose=pose,
                slips=law.slip.copy(),
                energies=own | of_contacts,
                **sum_by_part(touches, pressing, engine.parts),
            )
        self._account(dt, after, wrench, object_after, fixed)
        return sample

    def _wrench(self, i: int, touches: Touches, pressing: Pressing) -> Array:
        """Load, disturbances and support on the object (6,) [N, N m]; zero while it is fixed."""
        if self._is_fixed(i):
            return np.zeros(6)
        since = self.schedule.time_step * i - self.task.final_time
        disturbed = self.options.disturbance.wrench(since - self.options.letting_go)
        return self.task.load + disturbed + self._support(since, touches, pressing)

    def _support(self, since: float, touches: Touches, pressing: Pressing) -> Array:
        """On the object (6,) [N, N m], at a time after t_F [s]."""
        options, engine = self.options, self.engine
        if options.support == "none" or since >= options.letting_go:
            return np.zeros(6)
        if self.table is None:
            return self.fixture.wrench(since, engine, touches, pressing)
        share = 1.0 - max(0.0, since) / max(options.letting_go, self.schedule.time_step)
        return share * self.table.wrench(engine.object_pose, engine.object_twist)

    def _account(self, dt: float, speeds: Array, wrench: Array, object_speed: Array, fixed: bool) -> None:
        """Add half a step's work of motors, less the joints' dry friction, and of the load."""
        self.joint_work += 0.5 * dt * float((self.engine.torques + self.engine.friction) @ speeds)
        self.load_work += 0.0 if fixed else 0.5 * dt * float(wrench @ object_speed)
