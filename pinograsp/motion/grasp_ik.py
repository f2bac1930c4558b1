"""Grasp phase: joint trajectories that press every contact point along its normal (Eqs. 17, 18).

Joint rates come from damped least squares, one sub-manipulator after the other: the second's target velocity is
reduced by what the joints before it already cause (Eq. 17b). The forward Euler step of Eq. (18) drifts off the path;
here a midpoint step is taken and the remaining position error is fed back, which keeps it bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, frozen
from pinograsp.contacts import Contact, PenetrationProfile
from pinograsp.errors import InvalidInput
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.approach import JointPath
from pinograsp.spatial import Array, BoolArray, IntArray, skew

# Damping sets in where the smallest singular value of a sub-manipulator's Jacobian [m] falls below this: one
# hundredth of a phalanx. Away from singularities the inverse is exact.
_NEAR_SINGULAR = 5e-4
_MAX_DAMPING = 5e-4
# Where it is surely above this, ten times as much, nothing is damped and normal equations lose no digits that count.
_REGULAR = 5e-3
_LIMIT_SLACK = 1e-9  # [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FingerMotion(JointPath):
    """Grasp phase of one finger's n_f joints.

    Attributes:
        jacobians: contact Jacobians (m, c, 6, n_f), linear velocity of the contact point first, world axes.
        errors: distance of each contact point from its target (m, c) [m]; of a closed grasp what its surface misses of
            its depth.
        slips: how far contact points of a closed grasp move along the surface (m, c) [m]; zero where ``errors``
            holds all of it.
        limited: names of joints that were stopped by their limits.
        surfaces: whether it is the links' surfaces that miss their depths, although the contact points keep to their
            paths.
    """

    jacobians: Array
    errors: Array
    slips: Array
    limited: tuple[str, ...]
    surfaces: bool = False

    __repr__ = brief()


class ContactPath:
    """Where c contact points of a finger are to be at m times, how fast they are there and half-way to the next ones.

    Args:
        contacts: the finger's, base to tip; their points move along their inward normals.
        profile: penetration; column ``which[i]`` belongs to contact i.
        which: their numbers (c,).
        times: samples (m,) [s] from t_I to t_F, evenly spaced.
    """

    def __init__(
        self, contacts: Sequence[Contact], profile: PenetrationProfile, which: Sequence[int], times: ArrayLike
    ):
        t = array_of("times", times, (None,))
        if t.size < 3:
            raise InvalidInput(f"times: expected at least 3 samples, got {t.size}")
        self.contacts, self.step = contacts, float(t[1] - t[0])
        normals = np.array([contact.normal_o for contact in contacts])
        origins = np.array([contact.point_o for contact in contacts])
        depth, rate, middle = (
            of[:, list(which), None] for of in (profile.depth(t), profile.rate(t), profile.rate((t[:-1] + t[1:]) / 2))
        )
        self.points, self.velocities, self.middle = origins + depth * normals, rate * normals, middle * normals
        # What is corrected in one step: never faster than the contact's own impact, so that a path that cannot be
        # followed (a singular posture, too few joints) does not drive the joints wild.
        self.fastest = rate.max(axis=0)


def press_points(
    hand: HandModel,
    finger: Finger,
    path: ContactPath,
    starts: Array,
    points_l: Array,
    *,
    feedback: bool = True,
    euler: bool = False,
) -> list[FingerMotion]:
    """Move a finger's contact points along their path, from s postures at once.

    Args:
        hand: the hand.
        finger: its finger that moves.
        path: of its contact points.
        starts: joint angles at impact (s, n_f) [rad].
        points_l: the contacts' points (s, c, 3) in the joints' frames [m].
        feedback: correct the position error (closed loop).
        euler: the plain forward step of Eq. (18). ``feedback=False, euler=True`` is the paper's scheme, kept to show
            its drift.
    """
    chain, dt, q = _Chain(hand, finger, path.contacts, points_l), path.step, np.array(starts)
    s, m, c, n = len(q), len(path.points), len(path.contacts), finger.n
    out_q, out_dq = np.empty((s, m, n)), np.empty((s, m, n))
    jacobians, errors = np.empty((s, m, c, 6, n)), np.empty((s, m, c))
    limited = np.zeros((s, n), dtype=bool)
    for i in range(m):
        points, J = chain.at(q)
        error = path.points[i] - points
        correction = error / dt * (1.0 if feedback else 0.0)
        size = np.sqrt((correction * correction).sum(axis=2, keepdims=True))
        correction *= np.minimum(1.0, path.fastest / np.maximum(size, 1e-300))
        dq, stopped = chain.rates(q, J, path.velocities[i] + correction, dt)
        limited |= stopped
        out_q[:, i], out_dq[:, i], jacobians[:, i] = q, dq, J
        errors[:, i] = np.sqrt((error * error).sum(axis=2))
        if i == m - 1:
            break
        if not euler:
            _, J = chain.at(q + dq * dt / 2)
            dq, stopped = chain.rates(q, J, path.middle[i] + correction, dt)
            limited |= stopped
        q = np.clip(q + dq * dt, chain.lower, chain.upper)
    ddq = np.gradient(out_dq, dt, axis=1, edge_order=2)
    return [
        FingerMotion(
            q=frozen(out_q[j]),
            dq=frozen(out_dq[j]),
            ddq=frozen(ddq[j]),
            jacobians=frozen(jacobians[j]),
            errors=frozen(errors[j]),
            slips=frozen(np.zeros((m, c))),
            limited=tuple(name for name, met in zip(finger.actuated, limited[j]) if met),
        )
        for j in range(s)
    ]


class _Chain:
    """One finger's contact points and Jacobians at s configurations, and its damped least-squares rates."""

    def __init__(self, hand: HandModel, finger: Finger, contacts: Sequence[Contact], points_l: Array):
        self.model, self.data = hand.model, hand.model.createData()
        self.dofs = finger.dofs
        self.lower, self.upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
        self.q = np.array(hand.resting)
        ends = [finger.links.index(contact.link) for contact in contacts]
        self.joints = [finger.joint_ids[end] for end in ends]
        self.points_l = points_l
        self.parts = [slice(a, b) for a, b in zip([0, *(e + 1 for e in ends[:-1])], [e + 1 for e in ends])]

    def at(self, q: Array) -> tuple[Array, Array]:
        """Contact points (s, c, 3) and Jacobians (s, c, 6, n_f) at q (s, n_f), linear first, world axes."""
        model, data, joints = self.model, self.data, self.joints
        points = np.empty(self.points_l.shape)
        J = np.empty((*points.shape[:2], 6, model.nv))
        for i, (angles, points_l) in enumerate(zip(q, self.points_l)):
            self.q[self.dofs] = angles
            pin.computeJointJacobians(model, data, self.q)
            for c, joint in enumerate(joints):
                points[i, c] = data.oMi[joint].act(points_l[c])
                J[i, c] = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, model.nv)
        own = J[:, :, :, self.dofs]
        # Pinocchio's are of the point of the link that is at the origin.
        own[:, :, :3] -= skew(points) @ own[:, :, 3:]
        return points, own

    def rates(self, q: Array, J: Array, velocities: Array, dt: float) -> tuple[Array, BoolArray]:
        """Joint rates (s, n_f) for contact-point velocities (s, c, 3) (Eqs. 17a, 17b), and which joints limits stop."""
        dq = np.zeros(q.shape)
        stopped = np.zeros(q.shape, dtype=bool)
        for contact, part in enumerate(self.parts):
            rows = J[:, contact, :3]
            velocity = velocities[:, contact]
            if part.start:
                velocity = velocity - (rows[:, :, : part.start] @ dq[:, : part.start, None])[:, :, 0]
            if part.stop == part.start:
                continue
            dq[:, part] = _damped_least_squares(rows[:, :, part], velocity)
            for i in np.flatnonzero(self._beyond(q[:, part] + dq[:, part] * dt, part).any(axis=1)):
                dq[i, part], stopped[i, part] = self._within(q[i], rows[i], velocity[i], part, dt)
        return dq, stopped

    def _beyond(self, q: Array, which: slice | IntArray) -> BoolArray:
        beyond: BoolArray = (q < self.lower[which] - _LIMIT_SLACK) | (q > self.upper[which] + _LIMIT_SLACK)
        return beyond

    def _within(self, q: Array, rows: Array, velocity: Array, part: slice, dt: float) -> tuple[Array, BoolArray]:
        """Rates of one posture's joints that stay within their limits: a joint at its limit stands still, the others do
        what they can; which stand still.
        """
        dq, stopped = np.zeros(len(q)), np.zeros(len(q), dtype=bool)
        free = np.arange(part.start, part.stop)
        while free.size:
            step = _damped_least_squares(rows[None, :, free], velocity[None])[0]
            beyond = self._beyond(q[free] + step * dt, free)
            if not beyond.any():
                dq[free] = step
                break
            stopped[free[beyond]] = True
            free = free[~beyond]
        return dq[part], stopped[part]


def _damped_least_squares(J: Array, velocity: Array) -> Array:
    """Rates (s, n) for velocities (s, 3) of points with the Jacobians (s, 3, n), damped near singular postures."""
    if J.shape[2] >= 3:
        # J^T (J J^T)^-1 v, where nothing is damped: the least singular value is above sqrt(det) / (trace / 2).
        square = J @ J.transpose(0, 2, 1)
        half = 0.5 * np.trace(square, axis1=1, axis2=2)
        if (np.linalg.det(square) > (_REGULAR * half) ** 2).all():
            regular: Array = (J.transpose(0, 2, 1) @ np.linalg.solve(square, velocity[:, :, None]))[:, :, 0]
            return regular
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    least = sigma[:, -1:]
    damping = np.where(least < _NEAR_SINGULAR, _MAX_DAMPING**2 * (1 - (least / _NEAR_SINGULAR) ** 2), 0.0)
    along = (U.transpose(0, 2, 1) @ velocity[:, :, None])[:, :, 0]
    rates: Array = (Vt.transpose(0, 2, 1) @ (sigma / (sigma**2 + damping) * along)[:, :, None])[:, :, 0]
    return rates
