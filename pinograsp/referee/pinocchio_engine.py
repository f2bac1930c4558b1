"""Pinocchio and coal as the engine of a simulation: a second opinion that needs nothing but the base install."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinograsp.referee.law import NO_TOUCHES, Pressing, Touches, cross
from pinograsp.referee.overlaps import Collider


class PinocchioEngine:
    """Hand and object, stepped in time. Vectors of joints are in the order of the hand's q; world axes.

    As in :class:`~pinograsp.referee.mujoco_engine.MujocoEngine`, velocities step first and positions follow with the
    new ones; the servos' damping is that at the end of the step, but for motors at their limits and coupled joints.

    Attributes:
        parts: number of parts of the hand: one per Pinocchio joint, 0 being the palm.
        notes: what differs from the plan's geometry. torques: of the motors over the last step (n,) [N m].
    """

    def __init__(self, task, *, time_step: float, servo, mass_factor: float):
        hand, body = task.hand, task.body
        self.dt, self.servo, self.limit = time_step, servo, task.torque_limit
        self.coupled, self.parts = bool(hand.couplings), hand.model.njoints
        # One with the hand's own inertia; in the other implicit damping counts as inertia: (M + dt D) a = f.
        self.model, self.damped = hand.model.copy(), hand.model.copy()
        self.model.armature = np.array(servo.rotor, dtype=float)
        self.implicit = np.zeros(hand.n) if self.coupled else time_step * np.array(servo.damping)
        self.damped.armature = self.model.armature + self.implicit
        self.data = self.model.createData()
        self.pushed, self.pressed = pin.StdVec_Force(), set()
        for _ in range(self.parts):
            self.pushed.append(pin.Force.Zero())
        self.collider = Collider(hand, body)
        self.notes = tuple(self.collider.notes)
        self.mass, self.inertia = mass_factor * body.mass, mass_factor * np.array(body.inertia_b)
        self.inverse = np.linalg.inv(self.inertia)
        self.q, self.dq, self.torques = np.zeros(hand.n), np.zeros(hand.n), np.zeros(hand.n)
        self.rotation, self.position = np.array(body.pose[:3, :3]), np.array(body.pose[:3, 3])
        # Of the centre of mass, world axes; angular, in the object's axes.
        self.velocity, self.turning = np.zeros(3), np.zeros(3)
        self.set_gravity(task.gravity_o)
        self._mass_matrix, self._energies = None, (0.0, 0.0)

    def place(self, q: np.ndarray, dq: np.ndarray, object_pose=None) -> None:
        """Put the hand's joints at q, dq (n,), and the object at rest at a pose (4, 4)."""
        self.q, self.dq = np.array(q, dtype=float), np.array(dq, dtype=float)
        if object_pose is not None:
            self.rotation, self.position = np.array(object_pose[:3, :3]), np.array(object_pose[:3, 3])
            self.velocity, self.turning = np.zeros(3), np.zeros(3)

    def set_gravity(self, gravity_o) -> None:
        """Gravity from now on (3,) [m/s^2]."""
        self.gravity = np.array(gravity_o, dtype=float)
        self.model.gravity.linear = self.damped.gravity.linear = self.gravity

    def touches(self) -> Touches:
        """Collide at the present state: where the hand is in the object."""
        model, data, v = self.model, self.data, self.dq
        if self.coupled:  # Pinocchio's energies know no coupled joints
            upper = np.triu(pin.crba(model, data, self.q))
            self._mass_matrix = upper + np.triu(upper, 1).T
            kinetic = 0.5 * float(v @ self._mass_matrix @ v)
            pin.forwardKinematics(model, data, self.q, v)
            potential = -sum(
                own.mass * float(self.gravity @ data.oMi[j].act(own.lever)) for j, own in enumerate(model.inertias) if j
            )
        else:
            kinetic = pin.computeKineticEnergy(model, data, self.q, v)
            potential = pin.computePotentialEnergy(model, data)
        w = self.turning
        kinetic += 0.5 * (self.mass * float(self.velocity @ self.velocity) + float(w @ self.inertia @ w))
        self._energies = potential - self.mass * float(self.gravity @ self.position), kinetic
        found = self.collider.collide(data, self.q, self.rotation, self.position)
        if not found:
            return NO_TOUCHES
        part, geometry, point, normal, depth = zip(*found)
        part, point, normal = np.array(part), np.array(point), np.array(normal)
        moving = {j: data.oMi[j].act(data.v[j]) for j in set(part.tolist())}  # at the world's origin
        linear = np.array([moving[j].linear for j in part])
        angular = np.array([moving[j].angular for j in part])
        turning = np.tile(self.rotation @ w, (len(part), 1))
        velocity = linear + cross(angular, point) - self.velocity - cross(turning, point - self.position)
        return Touches(
            part,
            np.array(geometry),
            point,
            normal,
            np.array(depth),
            velocity,
            ((angular - turning) * normal).sum(axis=1),
        )

    def step(self, q, dq, feed_forward, touches: Touches, pressing: Pressing, wrench_o) -> None:
        """One step: motors towards q, dq (n,), torques (n,) on top, contact forces, and a wrench (6,) on the object."""
        servo, before = self.servo, self.dq
        wanted = servo.stiffness * (q - self.q) + servo.damping * (dq - before) + feed_forward
        torques = np.clip(wanted, -self.limit, self.limit)
        self._push(touches, pressing)
        if self.coupled:
            rest = pin.rnea(self.model, self.data, self.q, before, np.zeros_like(before), self.pushed)
            acceleration = np.linalg.solve(self._mass_matrix, torques - rest)
        else:
            implicit = np.where(np.abs(wanted) < self.limit, self.implicit, 0.0)
            self.damped.armature = self.model.armature + implicit
            acceleration = pin.aba(self.damped, self.data, self.q, before, torques, self.pushed)
            torques = torques - implicit * acceleration
        self.torques, self.dq = torques, before + self.dt * acceleration
        self.q = self.q + self.dt * self.dq
        self._step_object(touches, pressing, wrench_o)

    def step_prescribed(self, ddq, touches: Touches, pressing: Pressing, wrench_o) -> None:
        """One step of the object alone; the torques are those that move the joints with ddq (n,)."""
        self._push(touches, pressing)
        self.torques = pin.rnea(self.model, self.data, self.q, self.dq, np.array(ddq), self.pushed).copy()
        self._step_object(touches, pressing, wrench_o)

    def _push(self, touches: Touches, pressing: Pressing) -> None:
        """What the contacts do to the joints, in the joints' frames."""
        for j in self.pressed:
            self.pushed[j].setZero()
        self.pressed = set(touches.part.tolist()) - {0}
        if touches.part.size:
            about_origin = cross(touches.point_o, pressing.force_o) + pressing.moment_o
            for j in self.pressed:
                own = touches.part == j
                on_hand = pin.Force(-pressing.force_o[own].sum(axis=0), -about_origin[own].sum(axis=0))
                self.pushed[j] = self.data.oMi[j].actInv(on_hand)

    def _step_object(self, touches: Touches, pressing: Pressing, wrench_o) -> None:
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
    def object_pose(self) -> np.ndarray:
        """Pose oMb (4, 4) of the object."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.position
        return pose

    @property
    def object_twist(self) -> np.ndarray:
        """Velocity of the object's centre of mass and angular velocity (6,), world axes [m/s, rad/s]."""
        return np.concatenate([self.velocity, self.rotation @ self.turning])

    def potential_energy(self) -> float:
        """In gravity [J], at the state of the last :meth:`touches`."""
        return self._energies[0]

    def kinetic_energy(self) -> float:
        """[J], at the state of the last :meth:`touches`."""
        return self._energies[1]
