"""MuJoCo as the engine of a simulation: multibody dynamics, collision and integration."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.simulation.dry_friction import stop_joints
from pinograsp.simulation.geometry import object_shape
from pinograsp.simulation.law import NO_TOUCHES, Displacements, Pressing, Touches, dot
from pinograsp.simulation.overlaps import Collider
from pinograsp.simulation.scene import build
from pinograsp.simulation.settings import Servo
from pinograsp.simulation.surface import MeshSurface
from pinograsp.simulation.task import Task
from pinograsp.spatial import Array, IntArray, cross

_UNMOVED = np.eye(4)


class _Follower(NamedTuple):
    """A coupled joint: q[dof] = factor * q of the joint that it follows + offset.

    Attributes:
        dof: its index in MuJoCo's vectors.
        followed: index of the joint that it follows, in the order of the hand's q.
        factor: [-].
        offset: [rad or m].
    """

    dof: int
    followed: int
    factor: float
    offset: float


class MujocoEngine:
    """Hand and object, stepped in time. Vectors of joints are in the order of the hand's q; world axes.

    Attributes:
        parts: number of parts of the hand: one per Pinocchio joint, 0 being the palm.
        notes: differences from the plan's geometry.
        torques: of the motors over the last step (n,) [N m or N].
        friction: torques of the joints' dry friction over the last step (n,) [N m or N].
    """

    def __init__(
        self, task: Task, *, time_step: float, servo: Servo, mass_factor: float, joint_friction: Array | None = None
    ):
        hand = task.hand
        flat = len(set(task.links)) < len(task.links)
        self.model, notes = build(
            hand,
            task.body,
            time_step=time_step,
            gravity_o=task.gravity_o,
            servo=servo.while_closing(),
            mass_factor=mass_factor,
            flat=flat,
        )
        self.notes, self.parts = tuple(notes), int(hand.model.njoints)
        self.data, self.dt = mujoco.MjData(self.model), time_step
        self.servo, self.stiff = servo.while_closing(), servo
        self.moved: Array = np.zeros(hand.n)  # where the joints are held, from the commands
        self.limit = task.torque_limit
        self.torques: Array = np.zeros(hand.n)
        self.closed: Array | None = None  # where joints that press with an effort have come to (n,)
        self.friction: Array = np.zeros(hand.n)
        self.most_friction: Array = np.zeros(hand.n) if joint_friction is None else np.array(joint_friction)
        self.rubs = bool(self.most_friction.any())
        self.servoed: Array = np.where(servo.stiffness > 0, 1.0, 0.0)
        self.gain: Array = np.where(servo.stiffness > 0, self.servo.stiffness, 1.0)
        model = self.model
        finite = np.isfinite(task.torque_limit)
        model.actuator_forcelimited[:] = finite
        model.actuator_forcerange[:] = np.where(finite, task.torque_limit, 0.0)[:, None] * [-1, 1]
        self.displacements = Displacements(time_step) if task.carrier else None
        self.dofs = np.array([model.joint(name).dofadr[0] for name in hand.joint_names])
        self.followers = [
            _Follower(int(model.joint(name).dofadr[0]), hand.joint_names.index(c.followed), c.factor, c.offset)
            for name, c in hand.couplings.items()
        ]
        self.object = model.body("object").id
        # MuJoCo's geometry is convex: overlaps with an object that is not come from coal.
        shape = object_shape(task.body, [])
        self.collider = Collider(hand, shape) if isinstance(shape, MeshSurface) else None
        self.object_q, self.object_v = model.jnt_qposadr[model.body_jntadr[self.object]], model.body_dofadr[self.object]
        # Pinocchio's joint of each of MuJoCo's bodies; -1: the object.
        self.part_of_body = np.array(
            [0, *(int(model.body(i).name.split()[1]) if i != self.object else -1 for i in range(1, model.nbody))]
        )
        self.body_of_part = np.zeros(self.parts, dtype=int)
        for body, part in enumerate(self.part_of_body):
            if part > 0:
                self.body_of_part[part] = body

    def place(self, q: Array, dq: Array, object_pose: Array | None = None) -> None:
        """Put the hand's joints at q, dq (n,), and the object at rest at a pose (4, 4)."""
        data = self.data
        # Each joint of the hand has one position and one velocity, and the object comes last: the indices agree.
        data.qpos[self.dofs], data.qvel[self.dofs] = q, dq
        for one in self.followers:
            data.qpos[one.dof] = one.factor * q[one.followed] + one.offset
            data.qvel[one.dof] = one.factor * dq[one.followed]
        if object_pose is not None:
            i, v = self.object_q, self.object_v
            data.qpos[i : i + 3] = object_pose[:3, 3]
            data.qpos[i + 3 : i + 7] = pin.Quaternion(np.array(object_pose[:3, :3])).coeffs()[[3, 0, 1, 2]]
            data.qvel[v : v + 6] = 0.0

    def stiffen(self, q: Array) -> None:
        """Hold joints whose servos were softer while the hand closed where they are, commanded to q (n,)."""
        if self.stiff.closing is None:
            return
        self.moved = np.where(self.servo.stiffness < self.stiff.stiffness, self.q - q, 0.0)
        self.servo, self.gain, model = self.stiff, self.stiff.stiffness, self.model
        model.actuator_gainprm[:, 0] = self.gain
        model.actuator_biasprm[:, 1:3] = -np.column_stack([self.gain, self.servo.damping])

    def set_gravity(self, gravity_o: Array) -> None:
        """Gravity from now on (3,) [m/s^2]."""
        self.model.opt.gravity[:] = gravity_o

    def touches(self) -> Touches:
        """Detect collisions at the present state: the points at which the hand overlaps the object."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        if self.displacements is not None:
            self.displacements.put(data.xmat.reshape(-1, 3, 3).copy(), data.xpos.copy())
        if self.collider is not None:
            return self._touches_of_surface(self.collider)
        if not data.ncon:
            return NO_TOUCHES
        contact = data.contact
        overlapping = (contact.dist < 0).nonzero()[0]
        if not overlapping.size:
            return NO_TOUCHES
        first, second = contact.geom.take(overlapping, 0).T
        swapped = model.geom_bodyid.take(first) == self.object
        geometry = np.where(swapped, second, first)
        # From the first geom to the second.
        normal = contact.frame.take(overlapping, 0)[:, :3] * np.where(swapped, -1.0, 1.0)[:, None]
        depth = -contact.dist.take(overlapping)
        # MuJoCo's point lies half-way between the surfaces.
        point = contact.pos.take(overlapping, 0) - 0.5 * depth[:, None] * normal
        return self._describe_touches(model.geom_bodyid.take(geometry), geometry, point, normal, depth)

    def _touches_of_surface(self, collider: Collider) -> Touches:
        """The points at which the hand overlaps an object that is not convex."""
        data, body = self.data, self.body_of_part.take(collider.joints)
        rotations, rotation = data.xmat.take(body, 0).reshape(-1, 3, 3), data.xmat[self.object].reshape(3, 3)
        found = collider.collide(rotations, data.xpos.take(body, 0), rotation, data.xpos[self.object])
        if not found.depths.size:
            return NO_TOUCHES
        return self._describe_touches(body.take(found.geometry), *found)

    def _describe_touches(
        self, body: IntArray, geometry: IntArray, point: Array, normal: Array, depth: Array
    ) -> Touches:
        """Touches of MuJoCo's bodies, with their velocities relative to the object."""
        data = self.data
        mine, other = data.cvel.take(body, 0), data.cvel[self.object]
        velocity = None if self.displacements is None else self.displacements.velocity(body, self.object, point)
        if velocity is None:
            centre = data.subtree_com.take(self.model.body_rootid.take(body), 0)
            velocity = mine[:, 3:] + cross(mine[:, :3], point - centre)
            velocity -= other[3:] + cross(other[:3], point - data.subtree_com[self.object])
        spin = dot(mine[:, :3] - other[:3], normal)
        return Touches(self.part_of_body.take(body), geometry, point, normal, depth, velocity, spin)

    def step(
        self,
        q: Array,
        dq: Array,
        feed_forward: Array,
        touches: Touches,
        pressing: Pressing,
        wrench_o: Array,
        limits: Array | None = None,
    ) -> None:
        """One step with servos.

        Args:
            q: positions that the motors hold (n,) [rad or m].
            dq: their velocities (n,) [rad/s or m/s].
            feed_forward: torques added to the servos' (n,) [N m or N].
            touches: of the last :meth:`touches`.
            pressing: the contact forces there.
            wrench_o: on the object (6,) [N, N m].
            limits: the least and the most that motors make, besides damping (2, n) [N m or N]; None: the drives' alone.
        """
        data, servo = self.data, self.servo
        data.ctrl[:] = self.servoed * (q + self.moved) + (servo.damping * dq + feed_forward) / self.gain
        if limits is not None:
            self._press_with_effort(dq, *limits)
        self._press(touches, pressing, wrench_o)
        before = self.dq
        mujoco.mj_step2(self.model, data)
        torques: Array = data.actuator_force.copy()
        free = np.abs(torques) < self.limit if not self.followers else np.zeros(len(torques), dtype=bool)
        if self.rubs:
            self._rub(np.where(free, self.dt * servo.damping, 0.0))
        # Damping acts at the end of the step, except for motors at their limits and in hands with coupled joints.
        torques -= free * servo.damping * (self.dq - before)
        self.torques = torques

    def _press_with_effort(self, dq: Array, least: Array, most: Array) -> None:
        """Keep what motors press with (n,) within limits; their gears let nothing push them back from where they came.

        A limit takes their damping, but of one that is pushed back, or faster than its command dq (n,).
        """
        q, way, ctrl = self.q, np.isfinite(most) * 1.0 - np.isfinite(least), self.data.ctrl
        closed = q if self.closed is None else self.closed
        self.closed = np.where(way > 0, np.maximum(closed, q), np.where(way < 0, np.minimum(closed, q), q))
        told = np.clip(way * self.dq, 0.0, np.maximum(way * dq, 0.0))
        free = self.servoed * q + self.servo.damping / self.gain * way * told
        ctrl[:] = free + np.clip(ctrl - free, least / self.gain, most / self.gain) + self.closed - q

    def _rub(self, implicit: Array) -> None:
        """Change the end of a step by the joints' dry friction.

        MuJoCo's own friction of joints is soft, light fingers would creep.
        """
        data, joints = self.data, len(self.dofs)
        every = np.zeros((self.model.nv, joints))  # velocities of all joints by those of the independent ones
        every[self.dofs, np.arange(joints)] = 1.0
        for one in self.followers:
            every[one.dof, one.followed] = one.factor
        mass = every.T @ self._full_mass() @ every + np.diag(implicit)
        self.friction, acceleration = stop_joints(mass, self.dq, self.dt, self.most_friction, self.friction)
        change = self.dt * (every @ acceleration)
        data.qvel += change
        moved = np.append(self.dofs, [one.dof for one in self.followers]).astype(int)
        data.qpos[moved] += self.dt * change[moved]

    def step_prescribed(self, ddq: Array, touches: Touches, pressing: Pressing, wrench_o: Array) -> None:
        """One step of the object alone; the torques are those that accelerate the joints by ddq (n,)."""
        data, servo = self.data, self.servo
        data.ctrl[:] = self.servoed * self.q + servo.damping * self.dq / self.gain  # the motors exert no torque
        self._press(touches, pressing, wrench_o)
        mujoco.mj_step2(self.model, data)
        acceleration = data.qacc.copy()
        acceleration[self.dofs] = ddq
        for one in self.followers:
            acceleration[one.dof] = one.factor * ddq[one.followed]
        torques: Array = self._full_mass() @ acceleration + data.qfrc_bias - self._from_contacts()
        self.torques = torques[self.dofs].copy()
        for one in self.followers:
            self.torques[one.followed] += one.factor * torques[one.dof]

    def _full_mass(self) -> Array:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full

    def _from_contacts(self) -> Array:
        """Generalised forces of the wrenches applied to the bodies (nv,)."""
        data = self.data
        forces: Array = data.qfrc_smooth - data.qfrc_passive - data.qfrc_actuator - data.qfrc_applied + data.qfrc_bias
        return forces

    def _press(self, touches: Touches, pressing: Pressing, wrench_o: Array) -> None:
        """Apply the contact forces and a wrench (6,) on the object."""
        data = self.data
        applied = data.xfrc_applied
        applied[:] = 0.0
        if touches.part.size:
            # On the hand's bodies the opposite of that on the object.
            body = np.concatenate([self.body_of_part.take(touches.part), np.full(touches.part.size, self.object)])
            force = np.concatenate([-pressing.force_o, pressing.force_o])
            moment = np.concatenate([-pressing.moment_o, pressing.moment_o])
            moment += cross(np.concatenate([touches.point_o] * 2) - data.xipos.take(body, 0), force)
            np.add.at(applied, body, np.concatenate([force, moment], axis=1))
        applied[self.object] += wrench_o
        if self.followers:
            self._carry_to_leaders(touches, pressing)

    def _carry_to_leaders(self, touches: Touches, pressing: Pressing) -> None:
        """Move the forces on coupled joints to the joints that they follow: MuJoCo's soft couplings would yield."""
        data = self.data
        load = -data.qfrc_bias
        for part, force, moment, point in zip(touches.part, pressing.force_o, pressing.moment_o, touches.point_o):
            if part:
                mujoco.mj_applyFT(self.model, data, -force, -moment, point, self.body_of_part[part], load)
        data.qfrc_applied[:] = 0.0
        for one in self.followers:
            data.qfrc_applied[one.dof] = -load[one.dof]
            data.qfrc_applied[self.dofs[one.followed]] += one.factor * load[one.dof]

    @property
    def q(self) -> Array:
        """Joint positions (n,) [rad, m]."""
        q: Array = self.data.qpos.take(self.dofs)
        return q

    @property
    def dq(self) -> Array:
        """Joint rates (n,) [rad/s, m/s]."""
        dq: Array = self.data.qvel.take(self.dofs)
        return dq

    @property
    def object_pose(self) -> Array:
        """Pose oMs (4, 4) of the object's shape, at its centre of mass."""
        pose: Array = _UNMOVED.copy()
        i = self.object_q
        pose[:3, 3] = self.data.qpos[i : i + 3]
        mujoco.mju_quat2Mat(turned := np.empty(9), self.data.qpos[i + 3 : i + 7])
        pose[:3, :3] = turned.reshape(3, 3)
        return pose

    @property
    def object_twist(self) -> Array:
        """Velocity of the object's centre of mass and angular velocity (6,), world axes [m/s, rad/s]."""
        twist: Array = self.data.qvel[self.object_v : self.object_v + 6].copy()
        mujoco.mju_rotVecQuat(twist[3:], twist[3:].copy(), self.data.qpos[self.object_q + 3 : self.object_q + 7])
        return twist

    def potential_energy(self) -> float:
        """In gravity [J], at the state of the last :meth:`touches`."""
        return float(self.data.energy[0])

    def kinetic_energy(self) -> float:
        """[J], at the state of the last :meth:`touches`."""
        return float(self.data.energy[1])
