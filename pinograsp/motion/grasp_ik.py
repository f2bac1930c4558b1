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
from pinograsp.motion.jacobian import contact_jacobian
from pinograsp.spatial import Array

# Damping sets in where the smallest singular value of a sub-manipulator's Jacobian [m] falls below this: one
# hundredth of a phalanx. Away from singularities the inverse is exact.
_NEAR_SINGULAR = 5e-4
_MAX_DAMPING = 5e-4
_BARELY = 2e-3  # [m] the same for closed grasps: joints that move a contact less than this per radian are no help
_SLOWLY = 0.1  # share of the slip that is corrected in one step
_LIMIT_SLACK = 1e-9  # [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FingerMotion:
    """Grasp phase of one finger.

    Attributes:
        q: joint angles (m, n_f) [rad].
        dq: joint rates (m, n_f) [rad/s].
        ddq: joint accelerations (m, n_f) [rad/s^2].
        jacobians: contact Jacobians (m, c, 6, n_f), linear velocity of the contact point first, world axes.
        errors: distance of each contact point from its target (m, c) [m]; of a closed grasp its part along the normal.
        slips: what is left of that distance across the normal (m, c) [m]; zero where ``errors`` holds all of it.
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


# Beside what moves where and when, five options, for the paper's own scheme and for closed grasps.
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
    normals_first: bool = False,
    deeper: Array | None = None,
    posture: Array | None = None,
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
        normals_first: all contacts at once, their motion along the normals before the one across: for fingers that have
            fewer joints than their contacts ask for, or whose joints move together.
        deeper: how much deeper than ``profile`` the points go (m, c) [m], to make up for links that turn as they press.
        posture: of the whole hand (n,), where joints before the palm, of a wrist, are not at 0.
    """
    t = array_of("times", times, (None,))
    if t.size < 3:
        raise InvalidInput(f"times: expected at least 3 samples, got {t.size}")
    dt = float(t[1] - t[0])
    normals = np.array([contact.normal_o for contact in contacts])
    origins = np.array([contact.point_o for contact in contacts])
    chain = _Chain(hand, finger, contacts, points_l, normals if normals_first else None)
    if posture is not None:
        chain.q[:] = posture
    q = np.array(array_of("start", start, (finger.n,)))
    m, c, n = t.size, len(contacts), finger.n
    descent = _descent(profile, which, t, deeper)
    out_q, out_dq = np.empty((m, n)), np.empty((m, n))
    jacobians, errors, slips = np.empty((m, c, 6, n)), np.empty((m, c)), np.zeros((m, c))
    limited: set[int] = set()
    # What is corrected in one step: never faster than the contact's own impact, so that a path that cannot be followed
    # (a singular posture, too few joints) does not drive the joints wild.
    fastest = descent.rate.max(axis=0)[:, None]
    for i in range(m):
        points, J = chain.at(q)
        error = origins + descent.depth[i][:, None] * normals - points
        correction = error / dt * (1.0 if feedback else 0.0)
        if normals_first:
            # Slip that the joints cannot undo is no reason to shake them: it is worked off over some ten samples.
            along_n = np.einsum("cx,cx->c", correction, normals)[:, None] * normals
            correction = along_n + _SLOWLY * (correction - along_n)
        correction *= np.minimum(1.0, fastest / np.maximum(np.linalg.norm(correction, axis=1, keepdims=True), 1e-300))
        dq, stopped = chain.rates(q, J, descent.rate[i][:, None] * normals + correction, dt)
        limited |= stopped
        out_q[i], out_dq[i], jacobians[i], errors[i] = q, dq, J, np.linalg.norm(error, axis=1)
        if normals_first:
            along = np.einsum("cx,cx->c", error, normals)
            errors[i], slips[i] = np.abs(along), np.linalg.norm(error - along[:, None] * normals, axis=1)
        if i == m - 1:
            break
        if not euler:
            _, J = chain.at(q + dq * dt / 2)
            dq, stopped = chain.rates(q, J, descent.middle_rate[i][:, None] * normals + correction, dt)
            limited |= stopped
        q = np.clip(q + dq * dt, chain.lower, chain.upper)
    return FingerMotion(
        q=frozen(out_q),
        dq=frozen(out_dq),
        ddq=frozen(np.array(np.gradient(out_dq, dt, axis=0, edge_order=2))),
        jacobians=frozen(jacobians),
        errors=frozen(errors),
        slips=frozen(slips),
        limited=tuple(finger.actuated[j] for j in sorted(limited)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Descent:
    """How c contact points go in along their normals, at m samples.

    Attributes:
        depth: (m, c) [m].
        rate: (m, c) [m/s].
        middle_rate: rates half-way between the samples (m - 1, c) [m/s].
    """

    depth: Array
    rate: Array
    middle_rate: Array


def _descent(profile: PenetrationProfile, which: Sequence[int], times: Array, deeper: Array | None) -> _Descent:
    """As ``profile`` says, its columns ``which``; where given, deeper by ``deeper`` (m, c) [m]."""
    columns = list(which)
    depth, rate = profile.depth(times)[:, columns], profile.rate(times)[:, columns]
    middle_rate = profile.rate((times[:-1] + times[1:]) / 2)[:, columns]
    if deeper is not None:
        dt = times[1] - times[0]
        depth = depth + deeper
        rate = rate + np.gradient(deeper, dt, axis=0)
        middle_rate = middle_rate + np.diff(deeper, axis=0) / dt
    return _Descent(depth=depth, rate=rate, middle_rate=middle_rate)


class _Chain:
    """One finger's contact points and Jacobians at a configuration, and its damped least-squares rates."""

    def __init__(
        self,
        hand: HandModel,
        finger: Finger,
        contacts: Sequence[Contact],
        points_l: Array,
        normals: Array | None,
    ):
        self.model, self.data = hand.model, hand.model.createData()
        self.dofs = finger.dofs
        self.lower, self.upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
        self.q = np.zeros(hand.n)
        ends = [finger.links.index(contact.link) for contact in contacts]
        self.joints = [finger.joint_ids[end] for end in ends]
        self.points_l, self.normals = points_l, normals
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
        for contact, part in enumerate(self.parts if self.normals is None else [slice(0, len(q))]):
            velocity = velocities[contact] - J[contact][:3, : part.start] @ dq[: part.start]
            free = np.arange(part.start, part.stop)
            while free.size:
                if self.normals is None:
                    step = _damped_least_squares(J[contact][:3, free], velocity)
                else:
                    step = _along_normals_first(J[:, :3, free], velocities, self.normals)
                after = q[free] + step * dt
                beyond = (after < self.lower[free] - _LIMIT_SLACK) | (after > self.upper[free] + _LIMIT_SLACK)
                if not beyond.any():
                    dq[free] = step
                    break
                # A joint at its limit stands still; the others do what they can.
                stopped |= set(free[beyond].tolist())
                free = free[~beyond]
        return dq, stopped


def _along_normals_first(J: Array, velocities: Array, normals: Array) -> Array:
    """Rates (n,) for contact velocities (c, 3): along the normals first, then across with the freedom that is left.

    ``J`` are the contacts' Jacobians (c, 3, n).
    """
    across = velocities - np.einsum("cx,cx->c", velocities, normals)[:, None] * normals
    normal = np.einsum("cx,cxn->cn", normals, J)
    step = _damped_least_squares(normal, np.einsum("cx,cx->c", velocities, normals), _BARELY)
    tangential = J - normals[:, :, None] * normal[:, None, :]
    rows = tangential.reshape(-1, J.shape[2])
    null = np.eye(J.shape[2]) - np.linalg.pinv(normal, rcond=1e-3) @ normal
    free = rows @ null
    left = across.ravel() - rows @ step
    # Damped: freedom that hardly moves a contact is not worth wild joints.
    rates: Array = step + null @ np.linalg.solve(free.T @ free + _BARELY**2 * np.eye(J.shape[2]), free.T @ left)
    return rates


def _damped_least_squares(J: Array, velocity: Array, near: float = _NEAR_SINGULAR) -> Array:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = 0.0
    if sigma[-1] < near:
        damping = (_MAX_DAMPING * near / _NEAR_SINGULAR) ** 2 * (1 - (sigma[-1] / near) ** 2)
    rates: Array = Vt.T @ (sigma / (sigma**2 + damping) * (U.T @ velocity))
    return rates
