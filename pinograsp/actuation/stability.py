"""Stiffness of a held object with its preload: whether a squeeze is stable, as springs under load may buckle.

At a contact let u be the motion of the hand's point less that of the object's, d + theta x r, for a small twist (d,
theta) of the object about its centre of mass and the arm r; phi the rotation of the link; F the force on the object, n
the inward normal, c_o and c_h the curvatures of the two surfaces there. Then

- the contact's axes turn by psi = s theta + (1 - s) phi - c n x u, with s = c_h / (c_o + c_h) and
  c = c_o c_h / (c_o + c_h);
- the force changes by dF = K_c u + psi x F;
- its point moves by theta x r + (theta - phi) x n / (c_o + c_h) + s u from the centre of mass, and on the link by
  (theta - phi) x n / (c_o + c_h) - (1 - s) u.

For forces along the normals this is the second-order geometry of two surfaces that roll (Montana, 1988; Rimon and
Burdick, 1998; Cutkosky and Kao, 1989). c_o infinite and c_h = 0, the default, is a spring between a point of the object
and a point of the hand, with axes fixed in the hand: opposed fingers with flat pads, which tip an object over easily.
c_h infinite and c_o = 0 is a pointed finger on a flat face, with axes fixed in the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from pinograsp.actuation.compliant_hand import LARGEST, CompliantHand, check_sizes, invert_stiffness, yielding_motions
from pinograsp.actuation.quasistatic import checked_grasp
from pinograsp.checks import are_rotations, array_of, at_least_zero, brief, each_of, floats_of, frozen, shorten
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, skew

_SHARPEST = 1e12  # [1/m]
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
        hand_margin: least stiffness of what yields in the hand, the object held still, each motion relative to its
            elastic stiffness [-]: below zero the hand gives way by itself, as a finger that buckles.
    """

    matrix: Array
    elastic: Array
    moment_length: float
    eigenvalues: Array
    motions: Array
    hand_margin: float

    __repr__ = brief("margin", "hand_margin", "eigenvalues")

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
        """The twist (6,) [m, rad] with the least stiffness, of length 1 as in ``motions``."""
        return frozen(self.motions[:, 0] / np.repeat([1.0, self.moment_length], 3))

    def is_stable(self, least: float = 0.0) -> bool:
        """Whether hand and object stay: every motion of the object is resisted with at least ``least`` [N/m], within
        rounding, and the hand does not give way by itself.
        """
        enough = self.margin >= least - _NEUTRAL * float(np.abs(self.eigenvalues).max())
        return enough and self.hand_margin >= -_NEUTRAL


def object_stiffness(
    grasp_map: ArrayLike,
    stiffness: ArrayLike,
    hand: CompliantHand,
    forces_c: ArrayLike,
    *,
    object_curvature: ArrayLike = np.inf,
    hand_curvature: ArrayLike = 0.0,
    torsional_stiffness: ArrayLike = 0.0,
    joint_preload: ArrayLike | None = None,
    moment_length: float | None = None,
) -> ObjectStiffness:
    """Stiffness of the object between contacts under preload; the hand's drives hold their references.

    Contacts roll and stick; none slips or opens. The links turn where the hand knows how (``CompliantHand.turning``).

    Args:
        grasp_map: G (6, 3k), as :attr:`~pinograsp.contacts.ContactSet.G`.
        stiffness: K_c (3k, 3k) of the contacts in contact axes [N/m].
        hand: that touches there.
        forces_c: preload (k, 3) on the object in contact axes [N].
        object_curvature: of the object's surface at the contacts, a number or (k,) [1/m], positive where it is convex,
            infinite at a point; the mean of the principal ones.
        hand_curvature: the same of the hand's.
        torsional_stiffness: of the contacts against turning about their normals, a number or (k,) [N m/rad]: (4/3) (1 -
            nu) a^2 k_n for a patch of the radius a that sticks (Johnson, Contact Mechanics, 1985, section 7.4), 0
            for a hard finger.
        joint_preload: (n, n) [N m/rad or N/m], what the preload itself adds to the stiffness of the joints, the slope
            of J^T f over q for forces that keep their direction in the world, at points that are fixed in the links
            (:func:`~pinograsp.motion.preload_slope`); None: left out, as for joints much stiffer than the
            preload times the length of their links.
        moment_length: rotations are multiplied by it in the eigenvalues [m]; None: the root mean square distance of the
            contacts from the centre of mass.

    Raises:
        InvalidInput: shapes that do not go together, a grasp map that no contact frames give, or curvatures of surfaces
            that do not touch at a point.
    """
    G, K, hand, length = checked_grasp(grasp_map, stiffness, hand, moment_length)
    rotations, arms = _frames_of(G)
    preload = check_sizes("preload", array_of("preload", forces_c, (hand.k, 3)), LARGEST)
    forces = np.einsum("kxc,kc->kx", rotations, preload)
    rolling = _measure_rolling(object_curvature, hand_curvature, hand.k)
    about_normals = at_least_zero("torsional stiffness", each_of("torsional stiffness", torsional_stiffness, hand.k))
    check_sizes("torsional stiffness", about_normals, LARGEST)
    normals = rotations[:, :, 2]
    pull, normal, arm = (block_diag(*skew(one)) for one in (forces, normals, arms))
    share, roll, bend = (np.diag(np.repeat(one, 3)) for one in rolling)
    torsion = block_diag(*(about_normals[:, None, None] * normals[:, :, None] * normals[:, None]))
    geometry = _Geometry(pull=pull, normal=normal, arm=arm, share=share, roll=roll, bend=bend, torsion=torsion)

    R = block_diag(*rotations)
    Z, D = yielding_motions(hand)
    slope = np.zeros((hand.n, hand.n))
    if joint_preload is not None:
        slope = check_sizes("joint preload", array_of("joint preload", joint_preload, slope.shape), LARGEST)
    B, W, K = R @ hand.jacobian @ Z, R @ hand.turning @ Z, R @ K @ R.T
    G = np.hstack([np.vstack([np.eye(3), skew(arm)]) for arm in arms])
    spin = np.tile(np.hstack([np.zeros((3, 3)), np.eye(3)]), (hand.k, 1))
    # What yields moves the hand's points by u and turns its links; the object's twist moves and turns its own.
    joints, twists = (B, W, np.zeros_like(B)), (-G.T, np.zeros_like(G.T), spin)

    def stiffness_of(geometry: _Geometry, slope: Array) -> tuple[Array, Array]:
        """Of the object (6, 6), and of what yields, the object held still (p, p)."""
        by_joints, by_twists = geometry.changes(K, *joints), geometry.changes(K, *twists)
        own = D + Z.T @ slope @ Z + B.T @ by_joints.force + W.T @ by_joints.hand_moment
        yielded = -invert_stiffness(own) @ (B.T @ by_twists.force + W.T @ by_twists.hand_moment)
        wrench = G @ (by_twists.force + by_joints.force @ yielded)
        moments = by_twists.object_moment + by_joints.object_moment @ yielded
        wrench[3:] += moments.reshape(hand.k, 3, 6).sum(axis=0)
        return -wrench, own

    matrix, yielding = stiffness_of(geometry, slope)
    elastic, without = stiffness_of(geometry.without_load(), np.zeros_like(slope))
    units = np.repeat([1.0, 1.0 / length], 3)
    values, vectors = np.linalg.eigh(units[:, None] * (matrix + matrix.T) / 2 * units)
    return ObjectStiffness(
        matrix=frozen(matrix),
        elastic=frozen(elastic),
        moment_length=length,
        eigenvalues=frozen(values),
        motions=frozen(vectors),
        hand_margin=_least_share(yielding, without),
    )


def _least_share(stiffness: Array, elastic: Array) -> float:
    """Least eigenvalue [-] of a stiffness (p, p) whose motions are scaled by the elastic one's diagonal; 1 if p = 0."""
    size = np.sqrt(np.where(np.diag(elastic) > 0, np.diag(elastic), np.abs(np.diag(stiffness))))
    moves = size > 0
    scaled = ((stiffness + stiffness.T) / 2)[np.ix_(moves, moves)] / np.outer(size[moves], size[moves])
    return float(np.linalg.eigvalsh(scaled)[0]) if moves.any() else 1.0


class _Changes(NamedTuple):
    """Changes of the forces on the object (3k, c) [N], and what their points' shift and torsion add to the moments on
    the object about its centre of mass and to those that the links give about the contacts (3k, c) [N m]; world axes.
    """

    force: Array
    object_moment: Array
    hand_moment: Array


class _Geometry(NamedTuple):
    """Preloaded contacts as block diagonal matrices (3k, 3k) in world axes: cross products with the forces, with the
    normals and with the arms, the shares s, rolling radii and curvatures of the module's docstring, and the stiffness
    against turning about the normals.
    """

    pull: Array
    normal: Array
    arm: Array
    share: Array
    roll: Array
    bend: Array
    torsion: Array

    def without_load(self) -> _Geometry:
        return self._replace(pull=np.zeros_like(self.pull))

    def changes(self, K: Array, u: Array, phi: Array, theta: Array) -> _Changes:
        """By motions u (3k, c) of the hand's points less those of the object's, and turns of links and object."""
        rest = np.eye(len(K)) - self.share
        turned = self.share @ theta + rest @ phi - self.bend @ self.normal @ u
        rolled = self.roll @ self.normal @ (theta - phi)
        twisted = self.torsion @ (theta - phi)
        return _Changes(
            force=K @ u - self.pull @ turned,
            object_moment=self.pull @ (self.arm @ theta + rolled - self.share @ u) - twisted,
            hand_moment=self.pull @ (rest @ u + rolled) - twisted,
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


def _measure_rolling(object_curvature: ArrayLike, hand_curvature: ArrayLike, k: int) -> tuple[Array, Array, Array]:
    """Per contact (k,): the share s [-], the rolling radius 1 / (c_o + c_h) [m] and the curvature c [1/m]."""
    given = []
    for name, value in (("object", object_curvature), ("hand", hand_curvature)):
        curvature = floats_of(f"{name} curvature", value, f"a number or {k} [1/m]")
        if curvature.shape not in ((), (k,)) or not np.all(curvature > -np.inf):
            raise InvalidInput(f"{name} curvature: expected a number or {k} [1/m], got {shorten(curvature.tolist())}")
        check_sizes(f"{name} curvature", curvature[np.isfinite(curvature)], _SHARPEST)
        given.append(np.broadcast_to(curvature, (k,)))
    own, other = given
    with np.errstate(invalid="ignore"):
        sharp = own + other
    if np.any(~(sharp > 0) | (np.isinf(own) & np.isinf(other))):
        raise InvalidInput(
            f"curvatures: expected surfaces that touch at a point, their sum above zero and at most one infinite, got "
            f"{shorten(own.tolist())} of the object and {shorten(other.tolist())} of the hand: give a flat pad on a "
            "flat face one contact at each corner, with an object_curvature of infinity"
        )
    share = np.where(np.isinf(sharp), np.isinf(other) * 1.0, _finite(other) / _finite(sharp))
    bend = np.where(np.isinf(own), other, np.where(np.isinf(other), own, _finite(own) * share))
    return share, 1.0 / sharp, bend


def _finite(values: Array) -> Array:
    return np.where(np.isinf(values), 1.0, values)
