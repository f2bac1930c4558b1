"""Quality of a grasp from its geometry: wrenches it resists, conditioning of the grasp map, stiffness, manipulability.

Nothing here needs an optimisation solver, nor forces that were found before. Moments are about the centre of mass,
world axes, and are divided by a length wherever they are compared with forces (default: the mean distance of the
contacts from the centre of mass).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from pinograsp.checks import array_of, brief, each_of, instance_of, number, one_of, read_only, shorten
from pinograsp.contacts.compliance import Compliance, checked_law
from pinograsp.contacts.contact_set import ContactSet
from pinograsp.contacts.friction import LARGEST_MU, Friction
from pinograsp.contacts.inscribed_ball import InscribedBall, inscribed_ball
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

Norm = Literal["L1", "Linf"]
NORMS: tuple[Norm, ...] = get_args(Norm)
Balance = Literal["wrench", "force"]
BALANCES: tuple[Balance, ...] = get_args(Balance)
_SupportPoint: TypeAlias = Callable[[Array], Array]
# Singular values below this share of the largest count as zero.
_FLAT = 1e-12
_STIFF = 1e50  # [N/m]: products of larger numbers may overflow


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspMapMetrics:
    """Conditioning of the grasp map with scaled moments (Roa and Suarez, "Grasp quality measures", 2015, section 2.1).

    Attributes:
        singular_values: descending (6,), or (3,) for forces alone [-]; 0 where a direction is missing.
        min_singular_value: the least of them: distance from a grasp that misses a direction.
        isotropy: least over greatest, 0 to 1.
        volume: sqrt(det(G G^T)), the product of the singular values, proportional to the volume of the wrenches that
            contact forces of unit norm make.
        moment_length: what moments were divided by [m].
    """

    singular_values: Array
    min_singular_value: float
    isotropy: float
    volume: float
    moment_length: float

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspStiffness:
    """Stiffness of the object on its compliant contacts, displacements (linear, then rotation) about the c.o.m.

    Attributes:
        matrix: (6, 6), symmetric, no negative eigenvalue; blocks in N/m, N, N and N m. A small displacement
            (dx [m], dtheta [rad]) in world axes meets the restoring wrench ``-matrix @ displacement`` [N, N m].
        compliance: (6, 6), the inverse of ``matrix``; where ``rank`` < 6 the pseudo-inverse, taken in the scaled units.
        rank: directions that meet resistance; 6 for a grasp that holds the object elastically.
        eigenvalues: ascending (6,) [N/m], of the matrix for displacements (dx, moment_length dtheta) and wrenches
            (f, m / moment_length), so that translations and rotations compare.
        eigenvectors: columns (6, 6), unit, in those scaled displacements.
        moment_length: that length [m].
        normal_stiffness: dF_n / ddelta per contact (k,) [N/m].
        tangential_stiffness: per contact (k,) [N/m].
    """

    matrix: Array
    compliance: Array
    rank: int
    eigenvalues: Array
    eigenvectors: Array
    moment_length: float
    normal_stiffness: Array
    tangential_stiffness: Array

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Manipulability:
    """Yoshikawa's measure per contact (Yoshikawa, "Manipulability of robotic mechanisms", IJRR 4(2), 1985).

    Attributes:
        values: sqrt(det(J J^T)) (k,), in the cube of the Jacobian's unit; 0 where a direction is out of reach.
        singular_values: of each Jacobian, descending (k, 3).
    """

    values: Array
    singular_values: Array

    __repr__ = brief()


def ferrari_canny(
    contacts: ContactSet,
    mu: ArrayLike,
    *,
    friction: Friction | None = None,
    norm: Norm = "L1",
    moment_length: float | None = None,
    balance: Balance = "wrench",
    tolerance: float = 1e-4,
    limit: int = 300_000,
) -> InscribedBall:
    """Ferrari and Canny's epsilon: the largest wrench that the contacts can make in *every* direction, per newton.

    "L1": the normal forces sum to at most 1 N, the wrenches are the convex hull of the contacts' cones; "Linf": each
    normal force is at most 1 N, the wrenches are the cones' Minkowski sum (Ferrari and Canny, "Planning optimal
    grasps", ICRA 1992). The friction model is used as it is: a cone is not replaced by a pyramid.

    Args:
        contacts: k contacts.
        mu: friction coefficient, a number or (k,) [-].
        friction: friction model; default the four-edged pyramid.
        norm: ``"L1"`` or ``"Linf"``.
        moment_length: moments are divided by it [m]; default: mean distance of the contacts from the c.o.m.
        balance: ``"wrench"``, or ``"force"`` for forces alone (moments are left out).
        tolerance: relative gap of the two bounds [-]. With a pyramid the bounds meet at any tolerance; a cone or a
            soft finger needs more work for a finer one.
        limit: see :func:`~pinograsp.contacts.inscribed_ball.inscribed_ball`.

    Returns:
        Bounds of epsilon [-] (N per N); 0 without force closure. ``direction`` (6,) or (3,) is the wrench the contacts
        are weakest in making, moments divided by ``moment_length``: the worst disturbance is the opposite one.

    Raises:
        InvalidInput: no contacts, wrong shapes, a negative number, or an unknown norm or balance.
    """
    one_of("norm", norm, NORMS)
    normals, tangents, friction = _cones(contacts, mu, friction, moment_length, balance)
    oracle = _hull_of_cones if norm == "L1" else _sum_of_cones
    support_point = oracle(normals, tangents, friction)
    return inscribed_ball(support_point, normals.shape[1], tolerance=tolerance, limit=limit)


def grasp_volume(
    contacts: ContactSet,
    mu: ArrayLike,
    *,
    friction: Friction | None = None,
    moment_length: float | None = None,
    balance: Balance = "wrench",
) -> float:
    """Volume of the wrenches of normal forces that sum to at most 1 N (Miller and Allen, ICRA 1999).

    The set is :func:`ferrari_canny`'s for "L1", the hull of the cones' edges and the origin; arguments are as there,
    with a pyramid as friction model. 0 if the set is flat.

    Raises:
        InvalidInput: as :func:`ferrari_canny`, or a friction model that is no polytope.
    """
    normals, tangents, friction = _cones(contacts, mu, friction, moment_length, balance)
    if not friction.polyhedral:
        raise InvalidInput(
            f"friction model of the grasp volume: expected 'pyramid', got '{friction.model}': use a pyramid with more "
            "edges"
        )
    corners = friction.vertices
    if friction.d == 4:
        corners = np.vstack([np.column_stack([corners, np.full(len(corners), sign)]) for sign in (-1.0, 1.0)])
    wrenches = (normals[:, None] + np.einsum("ej,kjr->ker", corners, tangents)).reshape(-1, normals.shape[1])
    _, scales, axes = np.linalg.svd(np.vstack([np.zeros(wrenches.shape[1]), wrenches]), full_matrices=False)
    if len(scales) < wrenches.shape[1] or scales[-1] <= _FLAT * scales[0]:
        return 0.0
    # Thin sets are stretched to the same extent in every direction, which Qhull copes with.
    round_set = np.vstack([np.zeros(wrenches.shape[1]), wrenches @ axes.T / scales])
    return float(ConvexHull(round_set).volume * np.prod(scales))


def grasp_map_metrics(
    contacts: ContactSet, *, moment_length: float | None = None, balance: Balance = "wrench"
) -> GraspMapMetrics:
    """Least singular value, isotropy and ellipsoid volume of the grasp map G, without regard to friction.

    Args:
        contacts: k contacts.
        moment_length, balance: as in :func:`ferrari_canny`.

    Raises:
        InvalidInput: no contacts, a length that is not positive, or an unknown balance.
    """
    length = _moment_length(contacts, moment_length)
    G = _scaled_map(contacts, length)[: _rows(balance)]
    values = np.zeros(len(G))
    found = np.linalg.svd(G, compute_uv=False)
    values[: len(found)] = np.where(found > _FLAT * found[0], found, 0.0)
    return GraspMapMetrics(
        singular_values=read_only(values),
        min_singular_value=float(values[-1]),
        isotropy=float(values[-1] / values[0]),
        volume=float(np.prod(values)),
        moment_length=length,
    )


def grasp_stiffness(
    contacts: ContactSet,
    compliance: Compliance,
    normal_forces: ArrayLike,
    *,
    tangential_ratio: float = 2 / 3,
    moment_length: float | None = None,
) -> GraspStiffness:
    """Stiffness matrix G diag(k_t, k_t, k_n) G^T of the grasp at its operating point, the fingers held still.

    The normal stiffness is the contact law's slope at rest, rho K delta^(rho-1) of the paper's.
    The tangential one is that of an elastic contact that sticks, k_t = k_n 2 (1 - nu) / (2 - nu) (Mindlin, 1949): 2/3
    of it for an incompressible fingertip, nu = 1/2. Springs follow Cutkosky and Kao, "Computing and controlling the
    compliance of a robotic hand" (1989); the change of the forces' directions and lever arms as the object moves, of
    the order F_n / (k_n r) on an arm r, is left out.

    Args:
        contacts: k contacts.
        compliance: the contact law.
        normal_forces: F_n at the operating point, a number or (k,) [N].
        tangential_ratio: k_t / k_n [-].
        moment_length: for the scaled eigenvalues, the rank and the pseudo-inverse [m]; default: mean distance of the
            contacts from the c.o.m.

    Raises:
        InvalidInput: no contacts, wrong shapes, a negative force or ratio, or zero force where rho < 1 (the slope is
            infinite there).
    """
    length = _moment_length(contacts, moment_length)
    checked_law(compliance)
    force = _per_contact("normal forces", normal_forces, len(contacts), "N")
    ratio = number("tangential stiffness ratio", tangential_ratio, at_least=0)
    normal = compliance.slope(compliance.depth(force))
    if not np.isfinite(normal[force == 0]).all():
        raise InvalidInput(
            "normal forces: expected > 0 [N] for a contact law that starts infinitely stiff (an exponent below 1), "
            f"got {force.tolist()}"
        )
    tangential = ratio * normal
    springs = np.column_stack([tangential, tangential, normal]).ravel()
    if np.any((springs != 0) & ~((springs > 1 / _STIFF) & (springs < _STIFF))):
        raise InvalidInput(
            f"contact law: expected stiffnesses of 0, or {1 / _STIFF:g} to {_STIFF:g} N/m, got {normal.tolist()} "
            f"along the normals, and {ratio:g} of it across"
        )
    G = _scaled_map(contacts, length)
    scaled = (G * springs) @ G.T
    eigenvalues, eigenvectors = np.linalg.eigh((scaled + scaled.T) / 2)
    held = eigenvalues > _FLAT * max(eigenvalues[-1], 0.0)
    modes = eigenvectors[:, held]
    units = np.repeat([1.0, length], 3)
    return GraspStiffness(
        matrix=read_only(units[:, None] * (scaled + scaled.T) / 2 * units),
        compliance=read_only((modes / eigenvalues[held]) @ modes.T / units[:, None] / units),
        rank=int(held.sum()),
        eigenvalues=read_only(np.where(held, eigenvalues, 0.0)),
        eigenvectors=read_only(eigenvectors),
        moment_length=length,
        normal_stiffness=read_only(normal),
        tangential_stiffness=read_only(tangential),
    )


def manipulability(jacobians: ArrayLike) -> Manipulability:
    """How freely the fingers can move each contact point: volume of the velocity ellipsoid of unit joint speeds.

    Args:
        jacobians: contact Jacobians (k, 3, n): joint speeds -> velocity of the contact point.

    Raises:
        InvalidInput: another shape, or numbers that are not finite.
    """
    J = array_of("contact Jacobians", jacobians, (None, 3, None))
    values = np.zeros((len(J), 3))
    if J.size:
        found = np.linalg.svd(J, compute_uv=False)
        values[:, : found.shape[1]] = np.where(found > _FLAT * found[:, :1], found, 0.0)
    return Manipulability(values=read_only(values.prod(axis=1)), singular_values=read_only(values))


# -- the contacts' cones ------------------------------------------------------------------------------------------


def _rows(balance: Balance) -> int:
    return 3 if one_of("balance", balance, BALANCES) == "force" else 6


def _moment_length(contacts: ContactSet, moment_length: float | None) -> float:
    if not isinstance(contacts, ContactSet) or len(contacts) == 0:
        raise InvalidInput(f"contacts: expected a ContactSet with at least one contact, got {shorten(contacts)}")
    return contacts.checked_moment_length(moment_length)


def _per_contact(name: str, value: ArrayLike, k: int, unit: str = "-", at_most: float = np.inf) -> Array:
    """Numbers >= 0 (k,), from one for all or one each."""
    result = each_of(name, value, k)
    if np.any((result < 0) | (result > at_most)):
        up_to = f", up to {at_most:g}" if at_most < np.inf else ""
        raise InvalidInput(f"{name}: expected numbers >= 0{up_to} [{unit}], got {result.tolist()}")
    return result


def _scaled_map(contacts: ContactSet, length: float) -> Array:
    """Grasp map (6, 3k) with moments divided by ``length`` [m]."""
    scaled: Array = contacts.G / np.repeat([1.0, length], 3)[:, None]
    return scaled


def _cones(
    contacts: ContactSet, mu: ArrayLike, friction: Friction | None, moment_length: float | None, balance: Balance
) -> tuple[Array, Array, Friction]:
    """Each contact's wrenches per newton: normals (k, r) and what each unit of u adds to them, tangents (k, d-1, r)."""
    length = _moment_length(contacts, moment_length)
    rows, k = _rows(balance), len(contacts)
    friction = Friction() if friction is None else friction
    instance_of("friction", friction, Friction)
    columns = _scaled_map(contacts, length).reshape(6, k, 3).transpose(1, 2, 0)
    normals, tangents = columns[:, 2], columns[:, :2]
    if friction.d == 4:
        about_normal = np.concatenate([np.zeros((k, 3)), normals[:, :3] / length], axis=1)
        tangents = np.concatenate([tangents, about_normal[:, None]], axis=1)
    tangents = friction.scale(_per_contact("mu", mu, k, at_most=LARGEST_MU))[:, :, None] * tangents
    return np.ascontiguousarray(normals[:, :rows]), np.ascontiguousarray(tangents[:, :, :rows]), friction


def _hull_of_cones(normals: Array, tangents: Array, friction: Friction) -> _SupportPoint:
    """Support points of the hull of what each contact makes with 1 N.

    No force at all is left out: the origin does not change the largest ball about it.
    """

    def support_point(y: Array) -> Array:
        along = tangents @ y
        best = np.argmax(normals @ y + friction.support(along))
        point: Array = normals[best] + friction.support_point(along[best]) @ tangents[best]
        return point

    return support_point


def _sum_of_cones(normals: Array, tangents: Array, friction: Friction) -> _SupportPoint:
    """Support points of the sum of what each contact makes with 0 to 1 N."""

    def support_point(y: Array) -> Array:
        along = tangents @ y
        on = normals @ y + friction.support(along) > 0
        across = np.einsum("kj,kjr->r", friction.support_point(along[on]), tangents[on])
        point: Array = normals[on].sum(axis=0) + across
        return point

    return support_point
