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
from pinograsp.motion.chains import points_at
from pinograsp.motion.jacobian import contact_jacobian
from pinograsp.spatial import Array

# Damping sets in where the smallest singular value of a sub-manipulator's Jacobian [m] falls below this: one
# hundredth of a phalanx. Away from singularities the inverse is exact.
_NEAR_SINGULAR = 5e-4
_MAX_DAMPING = 5e-4
_LIMIT_SLACK = 1e-9  # [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FingerMotion:
    """Grasp phase of one finger.

    Attributes:
        q: joint angles (m, n_f) [rad].
        dq: joint rates (m, n_f) [rad/s].
        ddq: joint accelerations (m, n_f) [rad/s^2].
        jacobians: contact Jacobians (m, c, 6, n_f), linear velocity of the contact point first, world axes.
        errors: distance of each contact point from its target (m, c) [m]; of a closed grasp what its surface misses of
            its depth.
        slips: how far contact points of a closed grasp move across their normals (m, c) [m]; zero where ``errors``
            holds all of it.
        limited: names of joints that were stopped by their limits.
        surfaces: whether it is the links' surfaces that miss their depths, although the contact points keep to their
            paths.
    """

    q: Array
    dq: Array
    ddq: Array
    jacobians: Array
    errors: Array
    slips: Array
    limited: tuple[str, ...]
    surfaces: bool = False

    __repr__ = brief()


# Beside what moves where and when, two options, for the paper's own scheme.
def press(
    hand: HandModel,
    finger: Finger,
    contacts: Sequence[Contact],
    start: ArrayLike,
    points_l: Array,
    profile: PenetrationProfile,
    which: Sequence[int],
    times: ArrayLike,
    *,
    feedback: bool = True,
    euler: bool = False,
) -> FingerMotion:
    """Move a finger's contact points along their inward normals by ``profile``.

    Args:
        hand: the hand.
        finger: its finger that moves.
        contacts: the finger's contacts, base to tip.
        start: joint angles (n_f,) at impact [rad].
        points_l: the contacts' points (c, 3) in the joints' frames [m].
        profile: penetration; column ``which[i]`` belongs to contact i.
        times: samples (m,) [s] from t_I to t_F, evenly spaced.
        feedback: correct the position error (closed loop).
        euler: the plain forward step of Eq. (18). ``feedback=False, euler=True`` is the paper's scheme, kept to show
            its drift.
    """
    t = array_of("times", times, (None,))
    if t.size < 3:
        raise InvalidInput(f"times: expected at least 3 samples, got {t.size}")
    dt = float(t[1] - t[0])
    normals = np.array([contact.normal_o for contact in contacts])
    origins = np.array([contact.point_o for contact in contacts])
    chain = _Chain(hand, finger, contacts, points_l)
    q = np.array(array_of("start", start, (finger.n,)))
    m, c, n = t.size, len(contacts), finger.n
    columns = list(which)
    depth, rate, middle = profile.depth(t), profile.rate(t), profile.rate((t[:-1] + t[1:]) / 2)
    depth, rate, middle = depth[:, columns], rate[:, columns], middle[:, columns]
    out_q, out_dq = np.empty((m, n)), np.empty((m, n))
    jacobians, errors = np.empty((m, c, 6, n)), np.empty((m, c))
    limited: set[int] = set()
    # What is corrected in one step: never faster than the contact's own impact, so that a path that cannot be followed
    # (a singular posture, too few joints) does not drive the joints wild.
    fastest = rate.max(axis=0)[:, None]
    for i in range(m):
        points, J = chain.at(q)
        error = origins + depth[i][:, None] * normals - points
        correction = error / dt * (1.0 if feedback else 0.0)
        correction *= np.minimum(1.0, fastest / np.maximum(np.linalg.norm(correction, axis=1, keepdims=True), 1e-300))
        dq, stopped = chain.rates(q, J, rate[i][:, None] * normals + correction, dt)
        limited |= stopped
        out_q[i], out_dq[i], jacobians[i], errors[i] = q, dq, J, np.linalg.norm(error, axis=1)
        if i == m - 1:
            break
        if not euler:
            _, J = chain.at(q + dq * dt / 2)
            dq, stopped = chain.rates(q, J, middle[i][:, None] * normals + correction, dt)
            limited |= stopped
        q = np.clip(q + dq * dt, chain.lower, chain.upper)
    return FingerMotion(
        q=frozen(out_q),
        dq=frozen(out_dq),
        ddq=frozen(np.array(np.gradient(out_dq, dt, axis=0, edge_order=2))),
        jacobians=frozen(jacobians),
        errors=frozen(errors),
        slips=frozen(np.zeros((m, c))),
        limited=tuple(finger.actuated[j] for j in sorted(limited)),
    )


def points_along(
    hand: HandModel,
    finger: Finger,
    contacts: Sequence[Contact],
    points_l: Array,
    q: Array,
    posture: Array | None = None,
) -> tuple[Array, Array]:
    """A finger's contact points (m, c, 3) and their Jacobians (m, c, 6, n_f) at its joint positions ``q`` (m, n_f).

    Linear velocity first, world axes. ``points_l`` (c, 3) in the joints' frames; ``posture`` (n,) of the other joints.
    """
    joints = [finger.joint_of(contact.link) for contact in contacts]
    return points_at(hand, finger, joints, points_l, q, hand.resting if posture is None else posture)


class _Chain:
    """One finger's contact points and Jacobians at a configuration, and its damped least-squares rates."""

    def __init__(
        self,
        hand: HandModel,
        finger: Finger,
        contacts: Sequence[Contact],
        points_l: Array,
    ):
        self.model, self.data = hand.model, hand.model.createData()
        self.dofs = finger.dofs
        self.lower, self.upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
        self.q = np.array(hand.resting)
        ends = [finger.links.index(contact.link) for contact in contacts]
        self.joints = [finger.joint_ids[end] for end in ends]
        self.points_l = points_l
        self.parts = [slice(a, b) for a, b in zip([0, *(e + 1 for e in ends[:-1])], [e + 1 for e in ends])]

    def at(self, q: Array) -> tuple[Array, Array]:
        """Contact points (c, 3) and Jacobians (c, 6, n_f), linear first, world axes."""
        self.q[self.dofs] = q
        pin.computeJointJacobians(self.model, self.data, self.q)
        points = [self.data.oMi[j].act(p) for j, p in zip(self.joints, self.points_l)]
        J = [contact_jacobian(self.model, self.data, j, p)[:, self.dofs] for j, p in zip(self.joints, self.points_l)]
        return np.array(points), np.array(J)

    def rates(self, q: Array, J: Array, velocities: Array, dt: float) -> tuple[Array, set[int]]:
        """Joint rates (n_f,) for contact-point velocities (c, 3) (Eqs. 17a, 17b), and the joints stopped at a limit."""
        dq = np.zeros(len(q))
        stopped: set[int] = set()
        for contact, part in enumerate(self.parts):
            velocity = velocities[contact] - J[contact][:3, : part.start] @ dq[: part.start]
            free = np.arange(part.start, part.stop)
            while free.size:
                step = _damped_least_squares(J[contact][:3, free], velocity)
                after = q[free] + step * dt
                beyond = (after < self.lower[free] - _LIMIT_SLACK) | (after > self.upper[free] + _LIMIT_SLACK)
                if not beyond.any():
                    dq[free] = step
                    break
                # A joint at its limit stands still; the others do what they can.
                stopped |= set(free[beyond].tolist())
                free = free[~beyond]
        return dq, stopped


def _damped_least_squares(J: Array, velocity: Array) -> Array:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = 0.0
    if sigma[-1] < _NEAR_SINGULAR:
        damping = _MAX_DAMPING**2 * (1 - (sigma[-1] / _NEAR_SINGULAR) ** 2)
    rates: Array = Vt.T @ (sigma / (sigma**2 + damping) * (U.T @ velocity))
    return rates
