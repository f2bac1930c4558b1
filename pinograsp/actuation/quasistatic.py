"""Linear quasi-static maps of a grasp: how forces, object and joints answer loads and commands.

Bicchi, "On the problem of decomposing grasp and manipulation forces in multiple whole-limb manipulation" (Robotics and
Autonomous Systems 13, 1994); Prattichizzo, Malvezzi and Bicchi, "On motion and force controllability of grasping hands
with postural synergies" (RSS 2010), whose maps P, V, Q are ``force_by_reference``, ``object_by_reference`` and
``joints_by_reference``. With f the forces on the object, x its motion (a twist about its centre of mass, linear first)
and w its load,

    f = K_c (J q - G^T x),   G f + w = 0,   S^T J^T f = gains (a_ref - a),   J^T f = -joint_stiffness (q - S a),

all as changes from the operating point. What changes with the directions and arms of forces that are there already is
left out here; :func:`~pinograsp.actuation.object_stiffness` has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.actuation.compliant_hand import (
    LARGEST,
    CompliantHand,
    check_sizes,
    invert_stiffness,
    symmetric_of,
    yielding_motions,
)
from pinograsp.checks import array_of, at_least_zero, brief, frozen, instance_of, number
from pinograsp.contacts import Compliance
from pinograsp.contacts.compliance import checked_law
from pinograsp.errors import InvalidInput
from pinograsp.spatial import FARTHEST, Array

_RANK = 1e-9  # relative: below it forces are rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuasistaticMaps:
    """How a grasp answers small changes of load w (6,), of references a_ref (m,) and of efforts of the drives (m,).

    Forces are those on the object, in contact axes, f (3k,) [N]; the object's motion x (6,) is a twist about its centre
    of mass, linear first, in world axes [m, rad].

    Attributes:
        stiffness: K_s (3k, 3k) of contacts and hand in series [N/m].
        object_stiffness: G K_s G^T (6, 6) [N/m, N, N m], without the preload.
        rank: of ``object_stiffness``: 6 where every motion of the object is resisted. Maps have no answer to loads
            along the other motions.
        force_by_load: f = -K_s G^T (G K_s G^T)^-1 w (3k, 6).
        object_by_load: x = (G K_s G^T)^-1 w (6, 6).
        joints_by_load: q (n, 6).
        force_by_reference: f (3k, m): P of RSS 2010; columns of torque control are zero.
        object_by_reference: x (6, m): V of RSS 2010.
        joints_by_reference: q (n, m): Q of RSS 2010.
        force_by_effort: f (3k, m) by efforts that are added to the servos'; columns of rigid drives are zero.
        internal: E (3k, e), an orthonormal basis of the internal forces that the drives control, by references or
            efforts: the range of (I - G_K^+ G) K_s J S.
        moment_length: moments are divided by it to tell the rank [m].
    """

    stiffness: Array
    object_stiffness: Array
    rank: int
    force_by_load: Array
    object_by_load: Array
    joints_by_load: Array
    force_by_reference: Array
    object_by_reference: Array
    joints_by_reference: Array
    force_by_effort: Array
    internal: Array
    moment_length: float

    __repr__ = brief("rank", "internal", "stiffness", "force_by_reference")


def contact_stiffness(compliance: Compliance, normal_forces: ArrayLike, *, tangential_ratio: float = 2 / 3) -> Array:
    """K_c (3k, 3k) [N/m] of k contacts in contact axes at normal forces (k,) [N]: diagonal (k_t, k_t, k_n) each.

    The normal stiffness is the contact law's slope at rest, rho K delta^(rho-1) of the paper's. The tangential one is
    that of a contact that sticks, k_t = k_n 2 (1 - nu) / (2 - nu) (Mindlin, 1949): ``tangential_ratio`` is 2/3 for an
    incompressible fingertip, nu = 1/2; 0: no friction.

    Raises:
        InvalidInput: a negative force or ratio, or a law whose slope is infinite at no force.
    """
    normal = normal_stiffness(compliance, normal_forces)
    ratio = number("tangential stiffness ratio", tangential_ratio, at_least=0)
    return frozen(np.diag(np.column_stack([ratio * normal, ratio * normal, normal]).ravel()))


def normal_stiffness(compliance: Compliance, normal_forces: ArrayLike) -> Array:
    """Slope k_n (k,) [N/m] of the contact law at rest, for normal forces (k,) [N]."""
    if not np.isfinite(checked_law(compliance).slope(0.0)):
        raise InvalidInput(f"contact law: expected a finite stiffness at no force (an exponent >= 1), got {compliance}")
    forces = at_least_zero("normal forces", array_of("normal forces", normal_forces, (None,)))
    with np.errstate(over="ignore"):
        slope = compliance.slope(compliance.depth(forces))
    check_sizes("stiffness of the contacts", slope, LARGEST)
    return slope


def quasistatic_maps(
    grasp_map: ArrayLike, stiffness: ArrayLike, hand: CompliantHand, *, moment_length: float | None = None
) -> QuasistaticMaps:
    """The linear maps of a grasp at its operating point.

    Args:
        grasp_map: G (6, 3k), contact forces in contact axes -> wrench about the object's centre of mass, world axes
            (``ContactSet.G``).
        stiffness: K_c (3k, 3k) of the contacts in contact axes [N/m] (:func:`contact_stiffness`).
        hand: that touches there.
        moment_length: moments are divided by it to tell the rank [m]; None: the root mean square distance of the
            contacts from the centre of mass.

    Raises:
        InvalidInput: shapes that do not go together, or a stiffness that is not symmetric or not above or equal zero.
    """
    G, K, hand, length = checked_grasp(grasp_map, stiffness, hand, moment_length)
    Z, D = yielding_motions(hand)
    B, drives, S = hand.jacobian @ Z, hand.yielding, hand.transmission
    X = invert_stiffness(D + B.T @ K @ B)  # what yields, per effort on it, where the object is held still
    series = K - K @ B @ X @ B.T @ K
    series = series / 2 + series.T / 2
    stiff = G @ series @ G.T
    object_by_load, rank, loose = _invert_resisted(stiff, length)
    dragged = Z @ X @ B.T @ K @ G.T  # joints that yield to the object's motion

    # Commands, first with the object held still.
    count = int(drives.sum())
    by_effort, joints_by_effort = K @ B @ X[:, :count], Z @ X[:, :count]
    gains = hand.gains if hand.gains.ndim == 2 else np.diag(hand.gains[drives])
    rigid = S[:, ~drives]
    joints_by_rigid = rigid - Z @ X @ (Z.T @ (hand.springs[:, None] * rigid) + B.T @ K @ hand.jacobian @ rigid)
    force, joints, effort = np.zeros((3 * hand.k, hand.m)), np.zeros((hand.n, hand.m)), np.zeros((3 * hand.k, hand.m))
    force[:, drives], joints[:, drives], effort[:, drives] = by_effort @ gains, joints_by_effort @ gains, by_effort
    force[:, ~drives], joints[:, ~drives] = K @ hand.jacobian @ joints_by_rigid, joints_by_rigid

    object_by_reference = object_by_load @ G @ force
    answer = np.eye(3 * hand.k) - series @ G.T @ object_by_load @ G  # I - G_K^+ G
    commands = np.hstack([by_effort, force[:, ~drives]])
    return QuasistaticMaps(
        stiffness=frozen(series),
        object_stiffness=frozen(stiff),
        rank=rank,
        force_by_load=frozen(-series @ G.T @ object_by_load),
        object_by_load=frozen(object_by_load),
        joints_by_load=frozen(dragged @ object_by_load),
        force_by_reference=frozen(answer @ force),
        object_by_reference=frozen(object_by_reference),
        joints_by_reference=frozen(joints + dragged @ object_by_reference),
        force_by_effort=frozen(answer @ effort),
        internal=frozen(_internal(answer, commands, loose @ G)),
        moment_length=length,
    )


def checked_grasp(
    grasp_map: ArrayLike, stiffness: ArrayLike, hand: CompliantHand, moment_length: float | None
) -> tuple[Array, Array, CompliantHand, float]:
    """Grasp map, contact stiffness, hand and moment length [m] that go together."""
    instance_of("hand", hand, CompliantHand)
    G = check_sizes("grasp map", array_of("grasp map", grasp_map, (6, 3 * hand.k)), FARTHEST)
    K = symmetric_of("contact stiffness", stiffness, 3 * hand.k)
    if moment_length is None:  # |skew(r) R| and |R| of each contact are sqrt(2) |r| and sqrt(3)
        forces, moments = np.linalg.norm(G[:3]) / np.sqrt(3), np.linalg.norm(G[3:]) / np.sqrt(2)
        moment_length = float(moments / forces) if moments > 1e-9 * forces else 1.0
    return G, K, hand, number("moment length", moment_length, at_least=1e-9, at_most=FARTHEST, unit="m")


def _invert_resisted(stiffness: Array, length: float) -> tuple[Array, int, Array]:
    """The inverse (6, 6) of the object's stiffness along the motions that it resists, their number, and the other
    motions (6 - rank, 6).
    """
    units = np.repeat([1.0, 1.0 / length], 3)
    values, vectors = np.linalg.eigh(units[:, None] * stiffness * units)
    held = values > _RANK * max(float(values[-1]), 0.0)
    modes = units[:, None] * vectors[:, held]
    return (modes / values[held]) @ modes.T, int(held.sum()), vectors[:, ~held].T * units


def _internal(answer: Array, commands: Array, unbalanced: Array) -> Array:
    """An orthonormal basis (3k, e) of the internal forces among the ``answer`` (3k, 3k) to forces (3k, c) by commands;
    ``unbalanced`` (6 - rank, 3k) gives what no motion of the object would balance.
    """
    sizes = np.linalg.norm(commands, axis=0)
    commands = commands[:, sizes > 0] / sizes[sizes > 0]
    if len(unbalanced):  # commands in step with each other only: others would carry the object off
        left = unbalanced @ commands
        _, sigma, Vt = np.linalg.svd(left, full_matrices=True)
        commands = commands @ Vt[int(np.sum(sigma > _RANK)) :].T
    U, sigma, _ = np.linalg.svd(answer @ commands, full_matrices=False)
    return np.ascontiguousarray(U[:, sigma > _RANK])
