"""Grasp phase: joint trajectories that press every contact point along its normal (Eqs. 17, 18).

Joint rates come from damped least squares, one sub-manipulator after the other: the second's target velocity is
reduced by what the joints before it already cause (Eq. 17b). The forward Euler step of Eq. (18) drifts off the path;
here a midpoint step is taken and the remaining position error is fed back, which keeps it bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of, brief, read_only
from pinograsp.contacts import Contact, PenetrationProfile
from pinograsp.errors import InvalidInput
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.jacobian import contact_jacobian

# Damping sets in where the smallest singular value of a sub-manipulator's Jacobian [m] falls below this: one
# hundredth of a phalanx. Away from singularities the inverse is exact.
_NEAR_SINGULAR = 5e-4
_MAX_DAMPING = 5e-4
_BARELY = 2e-3  # [m] the same for closed grasps: joints that move a contact less than this per radian are no help
_SLOWLY = 0.1
_LIMIT_SLACK = 1e-9  # [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FingerMotion:
    """Grasp phase of one finger.

    Attributes:
        q, dq, ddq: (m, n_f) [rad, rad/s, rad/s^2].
        jacobians: contact Jacobians (m, c, 6, n_f), linear velocity of the contact point first, world axes.
        errors: distance of each contact point from its target (m, c) [m]; of a closed grasp its part along the normal.
        slips: what is left of that distance across the normal (m, c) [m]; zero where ``errors`` holds all of it.
        limited: names of joints that were stopped by their limits.
        surfaces: whether it is the links' surfaces that miss their depths, although the contact points keep to their
            paths.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    jacobians: np.ndarray
    errors: np.ndarray
    slips: np.ndarray
    limited: tuple[str, ...]
    surfaces: bool = False

    __repr__ = brief()


def press(
    hand: HandModel,
    finger: Finger,
    contacts: list[Contact],
    start: np.ndarray,
    points_l: np.ndarray,
    profile: PenetrationProfile,
    which: list[int],
    times: np.ndarray,
    *,
    feedback: bool = True,
    euler: bool = False,
    normals_first: bool = False,
    deeper: np.ndarray | None = None,
) -> FingerMotion:
    """Move a finger's contact points along their inward normals by ``profile``.

    Args:
        hand, finger: the finger that moves.
        contacts: its contacts, base to tip.
        points_l: their points (c, 3) in the joints' frames [m].
        start: joint angles (n_f,) at impact [rad].
        profile: penetration; column ``which[i]`` belongs to contact i.
        times: samples (m,) [s] from t_I to t_F, evenly spaced.
        feedback: correct the position error (closed loop).
        euler: the plain forward step of Eq. (18). ``feedback=False, euler=True`` is the paper's scheme, kept to show
            its drift.
        normals_first: all contacts at once, their motion along the normals before the one across: for fingers that have
            fewer joints than their contacts ask for, or whose joints move together.
        deeper: how much deeper than ``profile`` the points go (m, c) [m], to make up for links that turn as they press.
    """
    times = array_of("times", times, (None,))
    if times.size < 3:
        raise InvalidInput(f"times: expected at least 3 samples, got {times.size}")
    dt = times[1] - times[0]
    normals = np.array([contact.normal_o for contact in contacts])
    origins = np.array([contact.point_o for contact in contacts])
    chain = _Chain(hand, finger, contacts, points_l, normals if normals_first else None)
    q = np.array(array_of("start", start, (finger.n,)))
    m, c, n = times.size, len(contacts), finger.n
    middle = (times[:-1] + times[1:]) / 2
    depth, rate = profile.depth(times)[:, which], profile.rate(times)[:, which]
    half_rate = profile.rate(middle)[:, which]
    if deeper is not None:
        depth = depth + deeper
        rate = rate + np.gradient(deeper, dt, axis=0)
        half_rate = half_rate + np.diff(deeper, axis=0) / dt
    out_q, out_dq = np.empty((m, n)), np.empty((m, n))
    jacobians, errors, slips = np.empty((m, c, 6, n)), np.empty((m, c)), np.zeros((m, c))
    limited: set[int] = set()
    # What is corrected in one step: never faster than the contact's own impact, so that a path that cannot be followed
    # (a singular posture, too few joints) does not drive the joints wild.
    fastest = rate.max(axis=0)[:, None]
    for i in range(m):
        points, J = chain.at(q)
        error = origins + depth[i][:, None] * normals - points
        correction = error / dt * (1.0 if feedback else 0.0)
        if normals_first:
            # Slip that the joints cannot undo is no reason to shake them: it is worked off over some ten samples.
            along_n = np.einsum("cx,cx->c", correction, normals)[:, None] * normals
            correction = along_n + _SLOWLY * (correction - along_n)
        correction *= np.minimum(1.0, fastest / np.maximum(np.linalg.norm(correction, axis=1, keepdims=True), 1e-300))
        dq, stopped = chain.rates(q, J, rate[i][:, None] * normals + correction, dt)
        limited |= stopped
        out_q[i], out_dq[i], jacobians[i], errors[i] = q, dq, J, np.linalg.norm(error, axis=1)
        if normals_first:
            along = np.einsum("cx,cx->c", error, normals)
            errors[i], slips[i] = np.abs(along), np.linalg.norm(error - along[:, None] * normals, axis=1)
        if i == m - 1:
            break
        if not euler:
            _, J = chain.at(q + dq * dt / 2)
            dq, stopped = chain.rates(q, J, half_rate[i][:, None] * normals + correction, dt)
            limited |= stopped
        q = np.clip(q + dq * dt, chain.lower, chain.upper)
    return FingerMotion(
        q=read_only(out_q),
        dq=read_only(out_dq),
        ddq=read_only(np.gradient(out_dq, dt, axis=0, edge_order=2)),
        jacobians=read_only(jacobians),
        errors=read_only(errors),
        slips=read_only(slips),
        limited=tuple(finger.actuated[j] for j in sorted(limited)),
    )


class _Chain:
    """One finger's contact points and Jacobians at a configuration, and its damped least-squares rates."""

    def __init__(self, hand: HandModel, finger: Finger, contacts: list[Contact], points_l: np.ndarray, normals=None):
        self.model, self.data = hand.model, hand.model.createData()
        self.dofs = finger.dofs
        self.lower, self.upper = hand.lower[finger.dofs], hand.upper[finger.dofs]
        self.q = np.zeros(hand.n)
        ends = [finger.links.index(contact.link) for contact in contacts]
        self.joints = [finger.joint_ids[end] for end in ends]
        self.points_l, self.normals = points_l, normals
        self.parts = [slice(a, b) for a, b in zip([0, *(e + 1 for e in ends[:-1])], [e + 1 for e in ends])]

    def at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Contact points (c, 3) and Jacobians (c, 6, n_f), linear first, world axes."""
        self.q[self.dofs] = q
        pin.computeJointJacobians(self.model, self.data, self.q)
        points = [self.data.oMi[j].act(p) for j, p in zip(self.joints, self.points_l)]
        J = [contact_jacobian(self.model, self.data, j, p)[:, self.dofs] for j, p in zip(self.joints, self.points_l)]
        return np.array(points), np.array(J)

    def rates(self, q, J, velocities, dt) -> tuple[np.ndarray, set[int]]:
        """Joint rates (n_f,) for contact-point velocities (c, 3) (Eqs. 17a, 17b), and the joints stopped at a limit."""
        dq, stopped = np.zeros(len(q)), set()
        for contact, part in enumerate(self.parts if self.normals is None else [slice(0, len(q))]):
            velocity = velocities[contact] - J[contact][:3, : part.start] @ dq[: part.start]
            free = np.arange(part.start, part.stop)
            while free.size:
                if self.normals is None:
                    step = _damped_least_squares(J[contact][:3, free], velocity)
                else:
                    step = self.along_normals_first(J[:, :3, free], velocities)
                after = q[free] + step * dt
                beyond = (after < self.lower[free] - _LIMIT_SLACK) | (after > self.upper[free] + _LIMIT_SLACK)
                if not beyond.any():
                    dq[free] = step
                    break
                # A joint at its limit stands still; the others do what they can.
                stopped |= set(free[beyond].tolist())
                free = free[~beyond]
        return dq, stopped

    def along_normals_first(self, J: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """Rates that give the contacts (c, 3, n) their speeds along the normals, and with what freedom is left the
        others.
        """
        across = velocities - np.einsum("cx,cx->c", velocities, self.normals)[:, None] * self.normals
        normal = np.einsum("cx,cxn->cn", self.normals, J)
        step = _damped_least_squares(normal, np.einsum("cx,cx->c", velocities, self.normals), _BARELY)
        tangential = J - self.normals[:, :, None] * normal[:, None, :]
        rows = tangential.reshape(-1, J.shape[2])
        null = np.eye(J.shape[2]) - np.linalg.pinv(normal, rcond=1e-3) @ normal
        free = rows @ null
        left = across.ravel() - rows @ step
        # Damped: freedom that hardly moves a contact is not worth wild joints.
        return step + null @ np.linalg.solve(free.T @ free + _BARELY**2 * np.eye(J.shape[2]), free.T @ left)


def _damped_least_squares(J: np.ndarray, velocity: np.ndarray, near: float = _NEAR_SINGULAR) -> np.ndarray:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = 0.0
    if sigma[-1] < near:
        damping = (_MAX_DAMPING * near / _NEAR_SINGULAR) ** 2 * (1 - (sigma[-1] / near) ** 2)
    return Vt.T @ (sigma / (sigma**2 + damping) * (U.T @ velocity))
