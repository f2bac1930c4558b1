"""Stiffness of a held object with its preload: whether a squeeze is stable, as springs under load may buckle.

Let u be the motion of the hand's point at a contact less that of the object's, v = d + theta x r, for a small twist
(d, theta) of the object about its centre of mass and the arm r of the contact; F the force on the object, n the inward
normal, c_o and c_h the curvatures of the two surfaces there. As the object moves,

- the contact's axes turn by psi = s theta - c n x u, with s = c_h / (c_o + c_h) and c = c_o c_h / (c_o + c_h);
- the force changes by dF = K_c u + psi x F;
- it acts on a point that moves by theta x r + theta x n / (c_o + c_h) + s u from the centre of mass.

For forces along the normals this is the second-order geometry of two surfaces that roll (Montana, 1988; Rimon and
Burdick, 1998; Cutkosky and Kao, 1989). c_o infinite and c_h = 0, the default, is a spring between a point of the object
and a point of the hand, with axes fixed in the hand: opposed fingers with flat pads, which tip an object over easily.
c_h infinite and c_o = 0 is a pointed finger on a flat face, with axes fixed in the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from pinograsp.actuation.compliant_hand import CompliantHand, inverse_of, yielding_motions
from pinograsp.actuation.quasistatic import checked_grasp
from pinograsp.checks import are_rotations, array_of, brief, floats_of, frozen, shown
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, skew

_NEUTRAL = 1e-9  # relative: a stiffness this much below zero is rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectStiffness:
    """Stiffness of a held object at its operating point: load = matrix @ twist, to first order.

    Twists (6,) are about the centre of mass, linear first, in world axes; the load keeps its direction and its point.

    Attributes:
        matrix: (6, 6) [N/m, N, N m], with the preload. Symmetric, where the load is a force at the centre of mass.
        elastic: (6, 6), contacts and hand in series without the preload: G K_s G^T.
        moment_length: rotations are multiplied by it to compare them with displacements [m].
        eigenvalues: of the symmetric part, rotations times ``moment_length`` (6,) [N/m], rising.
        motions: their unit eigenvectors (6, 6) in columns: displacements [m], and rotations times ``moment_length``.
    """

    matrix: Array
    elastic: Array
    moment_length: float
    eigenvalues: Array
    motions: Array

    __repr__ = brief("margin", "eigenvalues")

    @property
    def preload(self) -> Array:
        """What the preload adds to the elastic stiffness (6, 6) [N/m, N, N m]."""
        return frozen(self.matrix - self.elastic)

    @property
    def margin(self) -> float:
        """The least eigenvalue [N/m]: below zero the equilibrium is unstable, and the object leaves along
        ``weakest``.
        """
        return float(self.eigenvalues[0])

    @property
    def weakest(self) -> Array:
        """The twist (6,) [m, rad] with the least stiffness."""
        return frozen(self.motions[:, 0] / np.repeat([1.0, self.moment_length], 3))

    def is_stable(self, least: float = 0.0) -> bool:
        """Whether every motion is resisted with more than ``least`` [N/m], within rounding."""
        return self.margin >= least - _NEUTRAL * float(np.abs(self.eigenvalues).max())


def object_stiffness(
    grasp_map: ArrayLike,
    stiffness: ArrayLike,
    hand: CompliantHand,
    forces_c: ArrayLike,
    *,
    object_curvature: ArrayLike = np.inf,
    hand_curvature: ArrayLike = 0.0,
    moment_length: float | None = None,
) -> ObjectStiffness:
    """Stiffness of the object between contacts under preload; the hand's drives hold their references.

    The contact points of the hand move with its joints; that links turn as well, and that the Jacobian changes, is left
    out. Contacts roll and stick; none slips or opens.

    Args:
        grasp_map: G (6, 3k), as :attr:`~pinograsp.contacts.ContactSet.G`.
        stiffness: K_c (3k, 3k) of the contacts in contact axes [N/m].
        hand: that touches there.
        forces_c: preload (k, 3) on the object in contact axes [N].
        object_curvature: of the object's surface at the contacts, a number or (k,) [1/m], positive where it is convex,
            infinite at a point; the mean of the principal ones.
        hand_curvature: the same of the hand's.
        moment_length: rotations are multiplied by it in the eigenvalues [m]; None: the root mean square distance of the
            contacts from the centre of mass.

    Raises:
        InvalidInput: shapes that do not go together, a grasp map that no contact frames give, or curvatures of surfaces
            that do not touch at a point.
    """
    G, K, hand, length = checked_grasp(grasp_map, stiffness, hand, moment_length)
    rotations, arms = _frames_of(G)
    forces = np.einsum("kxc,kc->kx", rotations, array_of("preload", forces_c, (hand.k, 3)))
    turn, roll, bend = _geometry(object_curvature, hand_curvature, hand.k)

    R = block_diag(*rotations)
    Z, D = yielding_motions(hand)
    B, K = R @ hand.jacobian @ Z, R @ K @ R.T
    G = np.hstack([np.vstack([np.eye(3), skew(arm)]) for arm in arms])
    pull, normal = skew(forces), skew(rotations[:, :, 2])
    along = K + block_diag(*(bend[:, None, None] * pull @ normal))  # dF = along u + about theta
    about = (-turn[:, None, None] * pull).reshape(-1, 3)
    shift, shift_about = -turn[:, None, None] * pull, pull @ (skew(arms) + roll[:, None, None] * normal)  # moments
    spin = np.hstack([np.zeros((3, 3)), np.eye(3)])  # theta of a twist

    def total(along: Array, about: Array, shift: Array, turned: Array) -> Array:
        yielded = inverse_of(D + B.T @ along @ B) @ B.T @ (along @ G.T - about @ spin)
        u = B @ yielded - G.T
        wrench = G @ (along @ u + about @ spin)
        wrench[3:] += shift @ u + turned @ spin
        stiff: Array = -wrench
        return stiff

    matrix = total(along, about, np.hstack(list(shift)), shift_about.sum(axis=0))
    elastic = total(K, np.zeros_like(about), np.zeros((3, 3 * hand.k)), np.zeros((3, 3)))
    units = np.repeat([1.0, 1.0 / length], 3)
    values, vectors = np.linalg.eigh(units[:, None] * (matrix + matrix.T) / 2 * units)
    return ObjectStiffness(
        matrix=frozen(matrix),
        elastic=frozen(elastic),
        moment_length=length,
        eigenvalues=frozen(values),
        motions=frozen(vectors),
    )


def _frames_of(G: Array) -> tuple[Array, Array]:
    """Contact frames (k, 3, 3) and arms from the centre of mass (k, 3) [m] of a grasp map."""
    blocks = G.reshape(6, -1, 3).transpose(1, 0, 2)
    rotations, moments = blocks[:, :3], blocks[:, 3:]
    if not are_rotations(rotations).all():
        raise InvalidInput("grasp map: expected columns by three per contact, unit axes of its frame; see ContactSet.G")
    crossed = moments @ rotations.transpose(0, 2, 1)
    arms = np.stack([crossed[:, 2, 1], crossed[:, 0, 2], crossed[:, 1, 0]], axis=1)
    if np.abs(crossed - skew(arms)).max() > 1e-6 * max(1.0, float(np.abs(arms).max())):
        raise InvalidInput("grasp map: expected the forces' moments about the centre of mass in its lower rows")
    return rotations, arms


def _geometry(object_curvature: ArrayLike, hand_curvature: ArrayLike, k: int) -> tuple[Array, Array, Array]:
    """Per contact (k,): the share s [-] of the object's rotation that the axes follow, the rolling radius
    1 / (c_o + c_h) [m], and the curvature c [1/m] by which they turn as the object slides along.
    """
    given = []
    for name, value in (("object", object_curvature), ("hand", hand_curvature)):
        curvature = floats_of(f"{name} curvature", value, f"a number or {k} [1/m]")
        if curvature.shape not in ((), (k,)) or not np.all(curvature > -np.inf):
            raise InvalidInput(f"{name} curvature: expected a number or {k} [1/m], got {shown(curvature.tolist())}")
        given.append(np.broadcast_to(curvature, (k,)))
    own, other = given
    with np.errstate(invalid="ignore"):
        sharp = own + other
    if np.any(~(sharp > 0) | (np.isinf(own) & np.isinf(other))):
        raise InvalidInput(
            f"curvatures: expected surfaces that touch at a point, their sum above zero and at most one infinite, got "
            f"{shown(own.tolist())} of the object and {shown(other.tolist())} of the hand: give a flat pad on a flat "
            "face one contact at each corner, with an object_curvature of infinity"
        )
    turn = np.where(np.isinf(sharp), np.isinf(other) * 1.0, _finite(other) / _finite(sharp))
    bend = np.where(np.isinf(own), other, np.where(np.isinf(other), own, _finite(own) * turn))
    return turn, 1.0 / sharp, bend


def _finite(values: Array) -> Array:
    return np.where(np.isinf(values), 1.0, values)
