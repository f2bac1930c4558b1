"""Pinocchio and coal as the engine of a simulation: a second opinion that needs only the base install."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import numpy as np
import pinocchio as pin

from pinograsp.simulation.dry_friction import rubbing
from pinograsp.simulation.law import NO_TOUCHES, Displacements, Pressing, Touches, cross
from pinograsp.simulation.overlaps import Collider
from pinograsp.simulation.settings import Servo
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array


class PinocchioEngine:
    """Hand and object, stepped in time. Vectors of joints are in the order of the hand's q; world axes.

    As in :class:`~pinograsp.simulation.mujoco_engine.MujocoEngine`, a step updates the velocities and integrates the
    positions with the new velocities. The servos' damping acts at the end of the step (implicitly), except for motors
    at their limits and in hands with coupled joints.

    Attributes:
        parts: number of parts of the hand: one per Pinocchio joint, 0 being the palm.
        notes: differences from the plan's geometry.
        torques: of the motors over the last step (n,) [N m or N].
        friction: torques of the joints' dry friction over the last step (n,) [N m or N].
        q: joint positions (n,) [rad or m].
        dq: joint velocities (n,) [rad/s or m/s].
    """

    def __init__(
        self, task: Task, *, time_step: float, servo: Servo, mass_factor: float, joint_friction: Array | None = None
    ):
        hand, body = task.hand, task.body
        self.dt, self.servo, self.limit = time_step, servo, task.torque_limit
        self.coupled, self.parts = bool(hand.couplings), int(hand.model.njoints)
        # The first model has the hand's own inertia; in the second, implicit damping adds to it: (M + dt D) a = f.
        self.model, self.damped = hand.model.copy(), hand.model.copy()
        self.model.armature = np.array(servo.rotor, dtype=float)
        self.implicit = np.zeros(hand.n) if self.coupled else time_step * np.array(servo.damping)
        self.damped.armature = self.model.armature + self.implicit
        self.data = self.model.createData()
        self.pushed = pin.StdVec_Force()
        self.pressed: set[int] = set()
        for _ in range(self.parts):
            self.pushed.append(pin.Force.Zero())
        self.collider = Collider(hand, body)
        self.notes = tuple(self.collider.notes)
        self.mass, self.inertia = mass_factor * body.mass, mass_factor * np.array(body.inertia_s)
        self.inverse = np.linalg.inv(self.inertia)
        self.q: Array = np.zeros(hand.n)
        self.dq: Array = np.zeros(hand.n)
        self.torques: Array = np.zeros(hand.n)
        self.friction: Array = np.zeros(hand.n)
        self.most_friction: Array = np.zeros(hand.n) if joint_friction is None else np.array(joint_friction)
        self.rotation: Array = np.array(body.shape_pose[:3, :3])
        self.position: Array = np.array(body.shape_pose[:3, 3])
        self.velocity: Array = np.zeros(3)  # of the centre of mass, world axes
        self.turning: Array = np.zeros(3)  # angular velocity, axes of the object
        self.set_gravity(task.gravity_o)
        self.displacements = Displacements(time_step) if task.carrier else None
        self._mass_matrix: Array = np.zeros((hand.n, hand.n))  # of coupled joints, at the last touches
        self._potential = self._kinetic = 0.0

    def running(self) -> AbstractContextManager[None]:
        """While steps are made; nothing to be done."""
        return nullcontext()

    def place(self, q: Array, dq: Array, object_pose: Array | None = None) -> None:
        """Put the hand's joints at q, dq (n,), and the object at rest at a pose (4, 4)."""
        self.q, self.dq = np.array(q, dtype=float), np.array(dq, dtype=float)
        if object_pose is not None:
            self.rotation, self.position = np.array(object_pose[:3, :3]), np.array(object_pose[:3, 3])
            self.velocity, self.turning = np.zeros(3), np.zeros(3)

    def set_gravity(self, gravity_o: Array) -> None:
        """Gravity from now on (3,) [m/s^2]."""
        self.gravity: Array = np.array(gravity_o, dtype=float)
        self.model.gravity.linear = self.damped.gravity.linear = self.gravity

    def touches(self) -> Touches:
        """Detect collisions at the present state: the points at which the hand overlaps the object."""
        data, w = self.data, self.turning
        self._update_energies()
        if self.displacements is not None:  # the object comes last
            rotations = [placement.rotation for placement in data.oMi] + [self.rotation]
            positions = [placement.translation for placement in data.oMi] + [self.position]
            self.displacements.put(np.array(rotations), np.array(positions))
        overlaps = self.collider.collide(data.oMi, self.q, self.rotation, self.position)
        if not overlaps:
            return NO_TOUCHES
        part = np.array([one.joint for one in overlaps])
        point, normal = np.array([one.point for one in overlaps]), np.array([one.normal for one in overlaps])
        moving = {j: data.oMi[j].act(data.v[j]) for j in set(part.tolist())}  # twists at the world's origin
        linear = np.array([moving[j].linear for j in part])
        angular = np.array([moving[j].angular for j in part])
        turning = np.tile(self.rotation @ w, (len(part), 1))
        velocity = None if self.displacements is None else self.displacements.velocity(part, self.parts, point)
        if velocity is None:
            velocity = linear + cross(angular, point) - self.velocity - cross(turning, point - self.position)
        return Touches(
            part=part,
            geometry=np.array([one.geometry for one in overlaps]),
            point_o=point,
            normal_o=normal,
            depth=np.array([one.depth for one in overlaps]),
            velocity_o=velocity,
            spin=((angular - turning) * normal).sum(axis=1),
        )

    def _update_energies(self) -> None:
        """Energies of hand and object at the present state, and the kinematics of the hand."""
        model, data, v, w = self.model, self.data, self.dq, self.turning
        if self.coupled:  # Pinocchio's energies leave out coupled joints
            # Into the matrix of a Data that was used before, crba adds the motors beyond coupled joints once more.
            upper = np.triu(pin.crba(model, model.createData(), self.q))
            self._mass_matrix = upper + np.triu(upper, 1).T
            kinetic = 0.5 * float(v @ self._mass_matrix @ v)
            pin.forwardKinematics(model, data, self.q, v)
            potential = -sum(
                own.mass * float(self.gravity @ data.oMi[j].act(own.lever)) for j, own in enumerate(model.inertias) if j
            )
        else:
            kinetic = float(pin.computeKineticEnergy(model, data, self.q, v))
            potential = float(pin.computePotentialEnergy(model, data))
        kinetic += 0.5 * (self.mass * float(self.velocity @ self.velocity) + float(w @ self.inertia @ w))
        self._potential, self._kinetic = potential - self.mass * float(self.gravity @ self.position), kinetic

    def step(
        self, q: Array, dq: Array, feed_forward: Array, touches: Touches, pressing: Pressing, wrench_o: Array
    ) -> None:
        """One step with servos, see :meth:`pinograsp.simulation.stepping.Engine.step`."""
        servo, before = self.servo, self.dq
        wanted = servo.stiffness * (q - self.q) + servo.damping * (dq - before) + feed_forward
        torques = np.clip(wanted, -self.limit, self.limit)
        self._push(touches, pressing)
        implicit = np.where(np.abs(wanted) < self.limit, self.implicit, 0.0)
        if self.coupled:
            rest = pin.rnea(self.model, self.data, self.q, before, np.zeros_like(before), self.pushed)
            acceleration = np.linalg.solve(self._mass_matrix, torques - rest)
        else:
            self.damped.armature = self.model.armature + implicit
            acceleration = pin.aba(self.damped, self.data, self.q, before, torques, self.pushed)
        if self.most_friction.any():
            acceleration = acceleration + self._rubbed(before + self.dt * acceleration)
        torques = torques - implicit * acceleration
        self.torques, self.dq = torques, before + self.dt * acceleration
        self.q = self.q + self.dt * self.dq
        self._step_object(touches, pressing, wrench_o)

    def _rubbed(self, dq: Array) -> Array:
        """Accelerations (n,) [rad/s^2 or m/s^2] by the joints' dry friction over a step that would end at dq (n,)."""
        mass = self._mass_matrix
        if not self.coupled:
            upper = np.triu(pin.crba(self.damped, self.data, self.q))
            mass = upper + np.triu(upper, 1).T
        self.friction, acceleration = rubbing(mass, dq, self.dt, self.most_friction, self.friction)
        return acceleration

    def step_prescribed(self, ddq: Array, touches: Touches, pressing: Pressing, wrench_o: Array) -> None:
        """One step of the object alone; the torques are those that accelerate the joints by ddq (n,)."""
        self._push(touches, pressing)
        self.torques = pin.rnea(self.model, self.data, self.q, self.dq, np.array(ddq), self.pushed).copy()
        self._step_object(touches, pressing, wrench_o)

    def _push(self, touches: Touches, pressing: Pressing) -> None:
        """Set the contact forces on the joints, in the joints' frames."""
        for j in self.pressed:
            self.pushed[j].setZero()
        self.pressed = set(touches.part.tolist()) - {0}
        if touches.part.size:
            about_origin = cross(touches.point_o, pressing.force_o) + pressing.moment_o
            for j in self.pressed:
                own = touches.part == j
                on_hand = pin.Force(-pressing.force_o[own].sum(axis=0), -about_origin[own].sum(axis=0))
                self.pushed[j] = self.data.oMi[j].actInv(on_hand)

    def _step_object(self, touches: Touches, pressing: Pressing, wrench_o: Array) -> None:
        force, moment = wrench_o[:3] + self.mass * self.gravity, wrench_o[3:]
        if touches.part.size:
            force = force + pressing.force_o.sum(axis=0)
            moment = moment + (cross(touches.point_o - self.position, pressing.force_o) + pressing.moment_o).sum(axis=0)
        w, R = self.turning, self.rotation
        self.velocity = self.velocity + self.dt / self.mass * force
        self.turning = w + self.dt * (self.inverse @ (R.T @ moment - pin.skew(w) @ self.inertia @ w))
        self.position = self.position + self.dt * self.velocity
        self.rotation = R @ pin.exp3(self.dt * self.turning)

    @property
    def object_pose(self) -> Array:
        """Pose oMs (4, 4) of the object's shape, at its centre of mass."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.position
        return pose

    @property
    def object_twist(self) -> Array:
        """Velocity of the object's centre of mass and angular velocity (6,), world axes [m/s, rad/s]."""
        return np.concatenate([self.velocity, self.rotation @ self.turning])

    def potential_energy(self) -> float:
        """In gravity [J], at the state of the last :meth:`touches`."""
        return self._potential

    def kinetic_energy(self) -> float:
        """[J], at the state of the last :meth:`touches`."""
        return self._kinetic
