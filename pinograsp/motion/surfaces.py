"""Grasp phase of a closed hand: the surfaces of its links, not the points that touched first, go in as planned.

At a few depths on the way the joints, and the shift of the object as it is let go, are solved for together, so that
every surface is as deep as planned; between them the joints follow a curve over the depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pinograsp.checks import frozen
from pinograsp.contacts import PALM, ContactSet, PenetrationProfile
from pinograsp.contacts.penetration import Penetration
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.contact_ik import ContactPostures
from pinograsp.motion.grasp_ik import FingerMotion, points_along
from pinograsp.motion.jacobian import point_jacobian
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

# Contact points must follow their path to this [m]; a thousandth of a typical penetration.
TRACKED = 1e-6
# Those of closed fingers to this share of their depth, which is 1.5 % of their force.
_SHARE = 0.01
_WELL = 2e-4  # share of their depth to which surfaces are brought
_KNOTS = 5  # depths at which the joints are solved for: their course over the depth is smooth
_ROUNDS, _HALVINGS = 15, 3
_AT_LIMIT = 1e-9  # [rad or m]
# What the joints' freedom is used for: contacts that slide by 1 mm cost as much as joints that turn by 1 rad (or slide
# by 30 mm), and as an object that shifts by 0.1 mm. Depths come first: they are off by 0.1 um at that cost.
_SLIDING, _SHIFTING, _DEPTH, _STROKE = 1e-3, 1e-4, 1e-7, 0.03


class ClosedPress(NamedTuple):
    """How a closed hand's joints, and the object as it is let go, move while its k contacts go in.

    Attributes:
        course: share of the final depth (c,) [-].
        q: postures there (c, n) [rad or m].
        shift: of the object (c, 6): twist about its centre of mass, linear first [m, rad].
        missing: depths less than planned (c, k) [m].
        limited: indices of the joints that were stopped by their limits.
    """

    course: Array
    q: Array
    shift: Array
    missing: Array
    limited: frozenset[int]


def press_closed(
    hand: HandModel, contacts: ContactSet, body: Body | None, profile: PenetrationProfile, posture: Array
) -> ClosedPress:
    """Joint positions at which the surfaces of a closed hand are as deep as planned, once the object has shifted.

    Args:
        hand: the hand.
        contacts: all k contacts.
        body: what is held; None: not known, so that the points that touched first go in.
        profile: penetration of all contacts.
        posture: of the closed hand (n,) [rad or m].
    """
    solver = _Solver(hand, contacts, body, posture)
    course, final = np.linspace(0.0, 1.0, _KNOTS), profile.final_depth
    q, shift = np.tile(posture, (_KNOTS, 1)), np.zeros((_KNOTS, 6))
    missing = np.zeros((_KNOTS, len(contacts)))
    limited: set[int] = set()
    for i in range(1, _KNOTS):
        # On from where the last steps led.
        ahead = 2 * q[i - 1] - q[i - 2] if i > 1 else q[0]
        gone = shift[i - 1] * course[i] / course[max(i - 1, 1)]
        q[i], shift[i], missing[i], stopped = solver.solve(
            np.clip(ahead, solver.lower, solver.upper), gone, course[i] * final
        )
        limited |= stopped
    return ClosedPress(course, q, shift, missing, frozenset(limited))


class _Pressed(NamedTuple):
    """k contacts at a posture.

    Attributes:
        depth: of the surfaces (k,) [m].
        slid: displacement across the normals of the points that touched first (k, 3) [m].
        deepening: how joints change the depths (k, n) [m/rad or m/m].
        across: how they displace these points across the normals (k, 3, n).
    """

    depth: Array
    slid: Array
    deepening: Array
    across: Array


class _Solver:
    """Depths of a closed hand's contacts as functions of its joints and of the object's shift, and their solution."""

    def __init__(self, hand: HandModel, contacts: ContactSet, body: Body | None, posture: Array):
        self.hand, self.contacts, self.posture = hand, contacts, np.array(posture)
        self.data = hand.model.createData()
        self.surfaces = None if body is None or contacts.posture is None else Penetration(hand, body, contacts)
        self.normals = np.array([contact.normal_o for contact in contacts])
        self.origins = np.array([contact.point_o for contact in contacts])
        self.joints = [0 if c.finger == PALM else hand.finger(c.finger).joint_of(c.link) for c in contacts]
        pin.forwardKinematics(hand.model, self.data, self.posture)
        self.points_l = [self.data.oMi[j].actInv(p) for j, p in zip(self.joints, self.origins)]
        arms = self.origins - contacts.com_o
        self.shifts = np.column_stack([self.normals, np.cross(arms, self.normals)])
        # Rigid motions of the object by the displacements of its contacts that they cause.
        arm = max(1e-3, float(np.sqrt((arms**2).sum(axis=1).mean())))
        slides = [hand.is_prismatic(hand.model.getJointId(name)) for name in hand.joint_names]
        self.joint_costs = np.where(slides, 1.0 / _STROKE, 1.0)
        self.shift_costs = np.repeat([1.0, arm], 3) / _SHIFTING
        # Joints of no finger, of a wrist, stay.
        self.moving = np.zeros(hand.n, dtype=bool)
        self.moving[np.concatenate([finger.dofs for finger in hand.fingers])] = True
        self.lower, self.upper = np.minimum(hand.lower, posture), np.maximum(hand.upper, posture)

    def at(self, q: Array) -> _Pressed:
        """How deep the contacts are, how far they have slid, and how joints change both."""
        model = self.hand.model
        pin.computeJointJacobians(model, self.data, q)
        material = np.array([self.data.oMi[j].act(p) for j, p in zip(self.joints, self.points_l)])
        moved = material - self.origins
        along = (moved * self.normals).sum(axis=1)
        if self.surfaces is None:
            depth, normals, deepest = along, self.normals, material
        else:
            depth, normals, on_object = self.surfaces.at(q)
            deepest = on_object + depth[:, None] * normals
        deepening, across = np.zeros((len(depth), model.nv)), np.zeros((len(depth), 3, model.nv))
        for i, joint in enumerate(self.joints):
            if joint:  # the palm does not move
                place = self.data.oMi[joint]
                deepening[i] = normals[i] @ point_jacobian(model, self.data, joint, place.actInv(deepest[i]))
                J = point_jacobian(model, self.data, joint, self.points_l[i])
                across[i] = J - np.outer(self.normals[i], self.normals[i] @ J)
        return _Pressed(depth, moved - along[:, None] * self.normals, deepening, across)

    def solve(self, q: Array, shift: Array, wanted: Array) -> tuple[Array, Array, Array, set[int]]:
        """Joints and shift with the depths ``wanted`` (k,), from a guess (Gauss and Newton), and what is missing."""
        well = np.maximum(TRACKED, _WELL * wanted)
        best: tuple[float, Array, Array, Array] | None = None
        stopped, halved = set[int](), 0
        for _ in range(_ROUNDS):
            now = self.at(q)
            missing = wanted + self.shifts @ shift - now.depth
            off = float(np.abs(missing / well).max())
            if best is None or off < best[0]:
                best, halved = (off, q, shift, missing), 0
                to_q, to_shift, at_limit = self._step(q, shift, missing, now)
                stopped |= at_limit
                if off < 1.0 and np.abs(now.deepening @ (to_q - q)).max() < TRACKED:
                    break
            elif halved < _HALVINGS:  # too far
                halved += 1
                to_q, to_shift = 0.5 * (best[1] + q), 0.5 * (best[2] + shift)
            else:
                break
            q, shift = to_q, to_shift
        assert best is not None
        _, q, shift, missing = best
        return q, shift, missing, {j for j in stopped if min(q[j] - self.lower[j], self.upper[j] - q[j]) < _AT_LIMIT}

    def _step(self, q: Array, shift: Array, missing: Array, now: _Pressed) -> tuple[Array, Array, set[int]]:
        """Where the least-squares step leads joints and shift, and which joints meet their limits on it."""
        n, k = len(q), len(missing)
        rows = np.zeros((4 * k + n + 6, n + 6))
        rows[:k] = np.hstack([now.deepening, -self.shifts]) / _DEPTH
        rows[k : 4 * k, :n] = now.across.reshape(3 * k, n) / _SLIDING
        rows[4 * k : 4 * k + n, :n] = np.diag(self.joint_costs)
        rows[4 * k + n :, n:] = np.diag(self.shift_costs)
        turned = self.joint_costs * (self.posture - q)
        left = np.concatenate([missing / _DEPTH, -now.slid.ravel() / _SLIDING, turned, -self.shift_costs * shift])
        step, stopped = np.zeros(n + 6), set[int]()
        free = np.concatenate([self.moving, np.ones(6, dtype=bool)])
        while True:
            step[free] = np.linalg.lstsq(rows[:, free], left - rows[:, ~free] @ step[~free], rcond=None)[0]
            after = np.clip(q + step[:n], self.lower, self.upper)
            beyond = free[:n] & (np.abs(after - q - step[:n]) > _AT_LIMIT)
            step[:n] = after - q
            if not beyond.any():
                return after, shift + step[n:], stopped
            # A joint that meets its limit stays there; the others do what they can.
            stopped |= set(np.flatnonzero(beyond).tolist())
            free[:n] &= ~beyond


def press_surfaces(
    hand: HandModel,
    finger: Finger,
    contacts: ContactSet,
    which: Sequence[int],
    found: ContactPostures,
    pressed: ClosedPress,
    profile: PenetrationProfile,
    times: Array,
) -> FingerMotion:
    """The grasp phase of a closed finger.

    Args:
        hand: the closed hand.
        finger: its finger that moves.
        contacts: all contacts, with the posture of the closed hand.
        which: those of the finger.
        found: the finger's contact points.
        pressed: how the hand's joints go.
        profile: penetration of all contacts.
        times: samples (m,) [s] from t_I to t_F.
    """
    own = [contacts[i] for i in which]
    first = int(np.argmax(profile.final_depth))  # all contacts take the same course
    course, rate = (of(times)[:, first] / profile.final_depth[first] for of in (profile.depth, profile.rate))
    along = CubicSpline(pressed.course, pressed.q[:, finger.dofs])
    q, dq = along(course), along(course, 1) * rate[:, None]
    points, jacobians = points_along(hand, finger, own, found.points_l[0], q, contacts.posture)
    normals = np.array([contact.normal_o for contact in own])
    moved = points - np.array([contact.point_o for contact in own])
    slid = moved - np.einsum("mcx,cx->mc", moved, normals)[:, :, None] * normals
    missing = np.abs(pressed.missing[:, list(which)])
    motion = FingerMotion(
        q=frozen(q),
        dq=frozen(dq),
        ddq=frozen(np.array(np.gradient(dq, float(times[1] - times[0]), axis=0, edge_order=2))),
        jacobians=frozen(jacobians),
        errors=frozen(np.column_stack([np.interp(course, pressed.course, column) for column in missing.T])),
        slips=frozen(np.linalg.norm(slid, axis=2)),
        limited=tuple(name for name, dof in zip(finger.actuated, finger.dofs.tolist()) if dof in pressed.limited),
    )
    return replace(motion, surfaces=bool(off_path(motion, profile, which).any()))


def off_path(motion: FingerMotion, profile: PenetrationProfile, which: Sequence[int]) -> NDArray[np.bool_]:
    """Which contacts (c,) of a closed finger miss their depths by more than is negligible."""
    allowed = np.maximum(TRACKED, _SHARE * profile.final_depth[list(which)])
    return np.asarray(motion.errors.max(axis=0) > allowed)
