"""Depths that a closed hand can press all its contacts to: its joints move them together, and the object may shift.

To first order contact i goes in by the motion of its joints less that of the object, delta = M dq - N x with the rows
n_i' J_i of M and the normal parts of the grasp map in N (Bicchi, IEEE Transactions on Robotics and Automation 10(6),
1994; Prattichizzo, Malvezzi and Bicchi, RSS 2010). The object is held until t_F, so it shifts where it is let go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of
from pinograsp.contacts import ContactSet
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import find_stops
from pinograsp.motion.jacobian import contact_jacobians
from pinograsp.spatial import Array, cross

HARDLY = 1e-4  # [m] per radian: what moves contacts less than this does not move them
# Singular values below these count as zero, of unit columns for the joints, and for the object of its motion in metres
# at the contacts: depths that would take larger motions than these allow cannot be had.
JOINTS, SHIFTS = 0.05, 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PressingTogether:
    """How the depths of a hand's k contacts are coupled.

    Attributes:
        moves: depth by joint motion (k, n) [m per rad or m].
        shifts: depth that is lost when the object moves (k, 6): twists about its centre of mass, linear first [m/m,
            m/rad].
        rows: combinations of the depths (p, k) [-] that neither joints nor the object's shift can change: zero.
    """

    moves: Array
    shifts: Array
    rows: Array

    __repr__ = brief()


def pressing_together(hand: HandModel, contacts: ContactSet, q: ArrayLike) -> PressingTogether:
    """Compute how the depths of the contacts are coupled for a hand closed in the posture ``q`` (n,) [rad or m].

    Raises:
        InvalidInput: the contacts were made without a hand.
    """
    model, data = instance_of("hand", hand, HandModel).model, hand.model.createData()
    instance_of("contacts", contacts, ContactSet)
    posture = array_of("q", q, (hand.n,))
    pin.computeJointJacobians(model, data, posture)
    normals = np.array([contact.normal_o for contact in contacts])
    moves = np.einsum("kx,kxn->kn", normals, contact_jacobians(hand, contacts, data)[:, :3])
    pressing = np.concatenate([finger.dofs for finger in hand.fingers])  # not joints before the palm, of a wrist
    moves[:, np.setdiff1d(np.arange(hand.n), pressing)] = 0.0
    moves[:, find_stops(hand, posture) != 0] = 0.0
    moves[:, np.abs(moves).max(axis=0) < HARDLY] = 0.0
    arms = np.array([contact.point_o for contact in contacts]) - contacts.com_o
    shifts = np.column_stack([normals, cross(arms, normals)])
    arm = max(HARDLY, float(np.sqrt((arms**2).sum(axis=1).mean())))
    # Unit columns of the joints, whose units do not matter; 0 for those that hardly move a contact.
    sizes = np.linalg.norm(moves, axis=0)
    scaled = moves * np.where(sizes > HARDLY, 1.0 / np.maximum(sizes, HARDLY), 0.0) / JOINTS
    columns = np.column_stack([scaled, shifts / (SHIFTS * np.repeat([1.0, arm], 3))])
    U, sigma, _ = np.linalg.svd(columns, full_matrices=True)
    return PressingTogether(moves=moves, shifts=shifts, rows=np.asarray(U[:, int(np.sum(sigma > 1.0)) :].T))
