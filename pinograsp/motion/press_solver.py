"""How deep the contacts of a closed hand are by its joints, and the joints and the object's shift that they ask for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from pinograsp.contacts import PALM
from pinograsp.contacts.penetration import Penetration
from pinograsp.forces import ForceSolution
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import find_stops
from pinograsp.motion.contact_springs import Servos, describe_object_motion
from pinograsp.motion.jacobian import point_jacobians
from pinograsp.motion.rounds import PRESS
from pinograsp.spatial import Array, cross

# Contact points must follow their path to this [m]; a thousandth of a typical penetration.
TRACKED = 1e-6
_AT_LIMIT = 1e-9  # [rad or m]
# What the joints' freedom is used for: contacts that slide by 1 mm cost as much as joints that turn by 1 rad (or slide
# by 30 mm), and as an object that shifts by 0.1 mm. Depths come first: they are off by 0.1 um at that cost.
_SLIDING, _SHIFTING, _DEPTH, _STROKE = 1e-3, 1e-4, 1e-7, 0.03


class PressedContacts(NamedTuple):
    """k contacts at a posture.

    Attributes:
        depth: of the surfaces (k,) [m].
        normals: into the object, where the surfaces are deepest (k, 3).
        deepening: how joints change the depths (k, n) [m/rad or m/m].
        across: how they move the links where they touch the object's surface, across the normals, and turn them about
            these (k, 4, n).
    """

    depth: Array
    normals: Array
    deepening: Array
    across: Array


class Before(NamedTuple):
    """Where links came from: posture (n,), how far they had slid and turned (k, 4), and how they pressed."""

    q: Array
    slid: Array
    pressed: PressedContacts

    def slid_at(self, q: Array, across: Array) -> Array:
        """How far links have slid and turned (k, 4) [m, rad] at the posture ``q`` (n,), moved by ``across``."""
        slid: Array = self.slid + 0.5 * ((self.pressed.across + across) @ (q - self.q))
        return slid


class PressSolver:
    """Depths of a closed hand's contacts as functions of its joints and of the object's shift, and their solution."""

    def __init__(self, hand: HandModel, solution: ForceSolution, posture: Array, gains: Array | None):
        self.hand, self.problem, self.posture, self.gains = hand, solution.problem, np.array(posture), gains
        contacts, body = self.problem.contacts, self.problem.object
        self.data = hand.model.createData()
        self.surfaces = None if body is None or contacts.posture is None else Penetration(hand, body, contacts)
        self.normals = np.array([contact.normal_o for contact in contacts])
        self.origins = np.array([contact.point_o for contact in contacts])
        self.joints = [0 if c.finger == PALM else hand.finger(c.finger).joint_of(c.link) for c in contacts]
        pin.forwardKinematics(hand.model, self.data, self.posture)
        self.points_l = [self.data.oMi[j].actInv(p) for j, p in zip(self.joints, self.origins)]
        arms = self.origins - contacts.com_o
        self.shifts = np.column_stack([self.normals, cross(arms, self.normals)])
        # Rigid motions of the object by the displacements of its contacts that they cause.
        arm = max(1e-3, float(np.sqrt((arms**2).sum(axis=1).mean())))
        self.motion = describe_object_motion(self.problem)
        self.joint_costs = np.where(hand.slides, 1.0 / _STROKE, 1.0)
        self.shift_costs = np.repeat([1.0, arm], 3) / _SHIFTING
        # Joints of no finger, of a wrist, stay.
        self.planned = solution
        self.moving = np.zeros(hand.n, dtype=bool)
        self.moving[np.concatenate([finger.dofs for finger in hand.fingers])] = True
        self.moving &= find_stops(hand, self.posture) == 0  # what presses them keeps them there
        self.lower, self.upper = np.minimum(hand.lower, posture), np.maximum(hand.upper, posture)
        self.rows = self._costs()
        self.start = self.at(self.posture)

    def at(self, q: Array, near: PressedContacts | None = None) -> PressedContacts:
        """How deep the contacts are, and how joints move them; ``near``: at a posture that is not far."""
        model = self.hand.model
        pin.computeJointJacobians(model, self.data, q)
        if self.surfaces is None:
            material = np.array([self.data.oMi[j].act(p) for j, p in zip(self.joints, self.points_l)])
            depth, normals = ((material - self.origins) * self.normals).sum(axis=1), self.normals
            on_object = material - depth[:, None] * normals
        else:
            depth, normals, on_object = self.surfaces.at(q, near=None if near is None else (near.normals, near.depth))
        J = point_jacobians(model, self.data, self.joints, on_object)  # the depth's are the same all along the normal
        along = (normals[:, None, None] @ J.reshape(len(depth), 2, 3, model.nv))[:, :, 0]
        deepening = along[:, 0]
        J[:, :3] -= normals[:, :, None] * deepening[:, None]
        across = np.concatenate([J[:, :3], along[:, 1:]], axis=1)
        return PressedContacts(depth, normals, deepening, across)

    def _share_forces(self, course: Array) -> Array:
        """Share of the final normal forces (c,) where depths are so far on their ``course`` (c,) to the final ones."""
        law, final = self.problem.compliance, self.planned.profile.final_depth
        pressed = law.force(course[:, None] * final).sum(axis=1)
        share: Array = pressed / law.force(final).sum()
        return share

    def servos(self, on_the_way: Sequence[PressedContacts], course: Array) -> tuple[Servos, ...] | None:
        """Of the joints where the contacts are so far on their ``course`` (c,); None where they do not give way."""
        if self.gains is None:
            return None
        forces_o = np.einsum("kij,kj->ki", self.problem.contacts.rotations_oc, self.planned.forces_c)
        normal = (forces_o * self.normals).sum(axis=1)
        turning = self.planned.torsion if self.planned.torsion.size else np.zeros(len(normal))
        across = np.column_stack([forces_o - normal[:, None] * self.normals, turning])
        found = []
        for now, share in zip(on_the_way, self._share_forces(course)):
            torques = now.deepening.T @ normal + np.einsum("kin,ki->n", now.across, across)
            found.append(
                Servos(deepening=now.deepening, across=now.across, stiffness=self.gains, torques=share * torques)
            )
        return tuple(found)

    def solve(
        self, q: Array, shift: Array, wanted: Array, towards: Array, before: Before, near: PressedContacts
    ) -> tuple[Array, Array, PressedContacts, set[int]]:
        """Joints and shift with the depths ``wanted`` (k,), from a guess (Gauss and Newton), and joints at limits.

        ``near``: how the contacts are pressed at a posture that is not far.
        """
        well = np.maximum(TRACKED, PRESS.well * wanted)
        best: tuple[float, Array, Array, PressedContacts] | None = None
        stopped, halved = set[int](), 0
        for _ in range(PRESS.newton_steps):
            now = self.at(q, near)
            missing = wanted + self.shifts @ shift - now.depth
            off = float(np.abs(missing / well).max())
            if best is None or off < best[0]:
                best, halved, near = (off, q, shift, now), 0, now
                to_q, to_shift, at_limit = self.step(q, shift, now, wanted, towards, before)
                stopped |= at_limit
                if off < 1.0 and np.abs(now.deepening @ (to_q - q)).max() < TRACKED:
                    break
            elif halved < PRESS.halvings:  # too far
                halved += 1
                to_q, to_shift = 0.5 * (best[1] + q), 0.5 * (best[2] + shift)
            else:
                break
            q, shift = to_q, to_shift
        assert best is not None
        _, q, shift, now = best
        return q, shift, now, {j for j in stopped if min(q[j] - self.lower[j], self.upper[j] - q[j]) < _AT_LIMIT}

    def _costs(self) -> Array:
        """The least-squares rows (4k + n + 6, n + 6), as far as they are the same for all steps."""
        n, k = self.hand.n, len(self.normals)
        rows = np.zeros((4 * k + n + 6, n + 6))
        rows[:k, n:] = -self.shifts / _DEPTH
        rows[4 * k : 4 * k + n, :n] = np.diag(self.joint_costs)
        rows[4 * k + n :, n:] = np.diag(self.shift_costs)
        return rows

    def step(
        self, q: Array, shift: Array, now: PressedContacts, wanted: Array, towards: Array, before: Before
    ) -> tuple[Array, Array, set[int]]:
        """Where the least-squares step leads joints and shift, and which joints meet their limits on it."""
        n, k = len(q), len(wanted)
        rows, left = self.rows.copy(), np.empty(len(self.rows))
        rows[:k, :n] = now.deepening / _DEPTH
        rows[k : 4 * k, :n] = now.across[:, :3].reshape(3 * k, n) / _SLIDING
        left[:k] = (wanted + self.shifts @ shift - now.depth) / _DEPTH
        left[k : 4 * k] = before.slid_at(q, now.across)[:, :3].ravel() / -_SLIDING
        left[4 * k : 4 * k + n] = self.joint_costs * (self.posture - q)
        left[4 * k + n :] = self.shift_costs * (towards - shift)
        step, stopped = np.zeros(n + 6), set[int]()
        free = np.concatenate([self.moving, np.ones(6, dtype=bool)])
        while True:
            if free.all():
                step = _least_squares(rows, left)
            else:
                step[free] = _least_squares(rows[:, free], left - rows[:, ~free] @ step[~free])
            after = np.clip(q + step[:n], self.lower, self.upper)
            beyond = free[:n] & (np.abs(after - q - step[:n]) > _AT_LIMIT)
            step[:n] = after - q
            if not beyond.any():
                return after, shift + step[n:], stopped
            # A joint that meets its limit stays there; the others do what they can.
            stopped |= set(np.flatnonzero(beyond).tolist())
            free[:n] &= ~beyond


def _least_squares(rows: Array, right: Array) -> Array:
    """The x (p,) with the least |rows x - right|, of independent columns: every unknown has a cost of its own."""
    found: Array = lapack.dgels(rows, right)[1][: rows.shape[1]]
    return found
