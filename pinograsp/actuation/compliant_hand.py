"""How a hand gives way at its contacts: its servos, transmission, elastic joints and springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from pinograsp.checks import array_of, at_least_zero, brief, floats_of, frozen, instance_of, read_only, shorten
from pinograsp.contacts import ContactSet
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray

_UNEVEN = 1e-9  # relative: stiffnesses are symmetric, and not below zero, within rounding
_NOTHING = 1e-13  # relative: far above rounding, far below any stiffness beside another
# Larger and smaller numbers come from a mistake of units; products of them would overflow.
LARGEST, _SMALLEST, _LONGEST = 1e15, 1e-15, 1e6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompliantHand:
    """A hand that gives way under the forces at its k contacts, to first order around a posture.

    Its n joints move with m drives and with what yields between: q = S a + y. A servo gives the effort gains (a_ref -
    a), an elastic joint yields by y = -joint_stiffness^-1 J^T f, a spring gives the torque -springs q: servos and
    elastic joints yield in series, springs act beside them. Prattichizzo, Malvezzi and Bicchi (RSS 2010) call the
    drives postural synergies, and those with finite gains soft.

    Gains of 0 are torque control, infinite ones rigid drives. A tendon that runs over several joints with the arms R
    (m, n) couples their torques, not their motions: ``transmission=None, gains=R.T @ np.diag(gains) @ R``.

    Attributes:
        jacobian: J (3k, n) of the hand's contact points, linear velocity in contact axes [m/rad or m/m].
        gains: of the servos (m,), effort per unit of a, from 0 to infinity; or a finite matrix (m, m).
        transmission: S (n, m), motion of the joints per unit of a; None: a drive at each joint.
        joint_stiffness: of elastic joints (n,) [N m/rad or N/m], infinity where a joint is rigid, or a matrix (n, n);
            None: all are rigid.
        springs: beside the drives (n,) [N m/rad or N/m]; None: there are none.
        turning: how the links turn (3k, n), angular velocity in contact axes [rad/rad or rad/m]; None: they do not.
            Only :func:`~pinograsp.actuation.object_stiffness` looks at it.

    Raises:
        InvalidInput: shapes that do not go together, or stiffnesses that cannot be.
    """

    jacobian: Array
    gains: Array
    transmission: Array = None  # type: ignore[assignment]  # None becomes an array in __post_init__
    joint_stiffness: Array | None = None
    springs: Array = None  # type: ignore[assignment]  # None becomes an array in __post_init__
    turning: Array = None  # type: ignore[assignment]  # None becomes an array in __post_init__

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            jacobian: ArrayLike,
            gains: ArrayLike,
            transmission: ArrayLike | None = ...,
            joint_stiffness: ArrayLike | None = ...,
            springs: ArrayLike | None = ...,
            turning: ArrayLike | None = ...,
        ) -> None: ...

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("jacobian", check_sizes("hand Jacobian", array_of("hand Jacobian", self.jacobian, (None, None)), _LONGEST))
        rows, n = self.jacobian.shape
        if not rows or rows % 3 or not n:
            raise InvalidInput(
                f"hand Jacobian: expected shape (3k, n) with three rows for each contact and one column or more, got "
                f"{(rows, n)}: CompliantHand.at takes Jacobians as pinograsp.motion gives them"
            )
        S = np.eye(n) if self.transmission is None else array_of("transmission S", self.transmission, (n, None))
        put("transmission", frozen(check_sizes("transmission S", S, _LONGEST)))
        put("gains", _stiffness_of("servo gains", self.gains, S.shape[1], least="zero"))
        if self.joint_stiffness is not None:
            put("joint_stiffness", _stiffness_of("joint stiffness", self.joint_stiffness, n, least="above zero"))
        put("springs", read_only(np.zeros(n)) if self.springs is None else array_of("springs", self.springs, (n,)))
        _not_tiny("springs", check_sizes("springs", at_least_zero("springs", self.springs), LARGEST))
        turning = (
            np.zeros((rows, n)) if self.turning is None else array_of("turning of the links", self.turning, (rows, n))
        )
        put("turning", frozen(check_sizes("turning of the links", turning, _LONGEST)))

    @classmethod
    def at(
        cls,
        contacts: ContactSet,
        jacobians: ArrayLike,
        *,
        gains: ArrayLike,
        transmission: ArrayLike | None = None,
        joint_stiffness: ArrayLike | None = None,
        springs: ArrayLike | None = None,
    ) -> CompliantHand:
        """The hand with its Jacobians (k, 3, n) or (k, 6, n) in world axes, linear velocity first.

        They are what ``torque_limits(hand, contacts, q).jacobian`` holds. With six rows the links turn. The
        other arguments are those of the class.
        """
        given = array_of(
            "contact Jacobians", jacobians, (len(instance_of("contacts", contacts, ContactSet)), None, None)
        )
        if given.shape[1] not in (3, 6):
            raise InvalidInput(f"contact Jacobians: expected shape (k, 3, n) or (k, 6, n), got {given.shape}")
        linear, angular = (
            np.einsum("kxc,kxn->kcn", contacts.rotations_oc, part).reshape(-1, given.shape[2])
            for part in (given[:, :3], given[:, -3:])
        )
        return cls(
            jacobian=linear,
            turning=angular if given.shape[1] == 6 else None,
            gains=gains,
            transmission=transmission,
            joint_stiffness=joint_stiffness,
            springs=springs,
        )

    @property
    def k(self) -> int:
        """Number of contacts."""
        return len(self.jacobian) // 3

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.jacobian.shape[1])

    @property
    def m(self) -> int:
        """Number of drives."""
        return int(self.transmission.shape[1])

    @property
    def yielding(self) -> BoolArray:
        """Which drives yield (m,) bool: those whose gain is finite."""
        finite: BoolArray = np.isfinite(np.diag(self.gains) if self.gains.ndim == 2 else self.gains)
        return finite


def yielding_motions(hand: CompliantHand) -> tuple[Array, Array]:
    """What yields: motions of the joints (n, p), first by the drives that yield, then by elastic joints; and the
    stiffness against them (p, p).
    """
    drives = hand.yielding
    gains = hand.gains if hand.gains.ndim == 2 else np.diag(hand.gains[drives])
    motions, stiffness = [hand.transmission[:, drives]], [gains]
    if hand.joint_stiffness is not None:
        if hand.joint_stiffness.ndim == 2:
            motions.append(np.eye(hand.n))
            stiffness.append(hand.joint_stiffness)
        else:
            elastic = np.isfinite(hand.joint_stiffness)
            motions.append(np.eye(hand.n)[:, elastic])
            stiffness.append(np.diag(hand.joint_stiffness[elastic]))
    Z = np.hstack(motions)
    D: Array = np.asarray(block_diag(*stiffness), dtype=float).reshape(Z.shape[1], Z.shape[1])
    return Z, D + (Z.T * hand.springs) @ Z


def invert_stiffness(matrix: Array) -> Array:
    """Inverse (p, p) of a stiffness, zero along motions against which there is none; units of the p motions do not
    matter.
    """
    size = np.sqrt(np.abs(np.diag(matrix)))
    factor = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    inverse = np.linalg.pinv(factor[:, None] * matrix * factor, rcond=_NOTHING)
    return np.asarray(factor[:, None] * inverse * factor, dtype=float)


def symmetric_of(name: str, value: object, size: int) -> Array:
    """``value`` as a symmetric matrix (size, size) without negative eigenvalues, or :class:`InvalidInput`."""
    matrix = check_sizes(name, array_of(name, value, (size, size)), LARGEST)
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _UNEVEN * largest:
        raise InvalidInput(f"{name}: expected a symmetric matrix, got one that is not: check its axes and its order")
    matrix = matrix / 2 + matrix.T / 2
    if size and np.linalg.eigvalsh(matrix)[0] < -_UNEVEN * largest:
        raise InvalidInput(f"{name}: expected a stiffness >= 0 along every motion, got a negative one: check its signs")
    return frozen(matrix)


def _stiffness_of(name: str, value: object, size: int, *, least: str) -> Array:
    """``value`` as stiffnesses (size,), infinite ones included, or as a finite matrix (size, size)."""
    wanted = f"{size} values {'> 0' if least == 'above zero' else '>= 0'}, or a matrix ({size}, {size})"
    stiffness = floats_of(name, value, wanted)
    if stiffness.ndim == 2:
        matrix = symmetric_of(name, stiffness, size)
        if least == "above zero" and size and np.linalg.eigvalsh(matrix)[0] <= 0:
            raise InvalidInput(f"{name}: expected a matrix that resists every motion, got a singular one")
        return matrix
    if stiffness.shape != (size,):
        raise InvalidInput(f"{name}: expected {wanted}, got shape {stiffness.shape}")
    if not np.all(stiffness > 0 if least == "above zero" else stiffness >= 0):
        raise InvalidInput(f"{name}: expected {wanted}, got {shorten(stiffness.tolist())}")
    _not_tiny(name, check_sizes(name, stiffness[np.isfinite(stiffness)], LARGEST))
    return frozen(stiffness)


def check_sizes(name: str, values: Array, largest: float) -> Array:
    """``values`` of sizes up to ``largest``, or :class:`InvalidInput`."""
    size = float(np.abs(values).max(initial=0.0))
    if not size <= largest:
        raise InvalidInput(f"{name}: expected sizes up to {largest:g}, got {size:.3g}: check the units")
    return values


def _not_tiny(name: str, stiffness: Array) -> None:
    """:class:`InvalidInput` for numbers next to zero."""
    least = float(stiffness[stiffness > 0].min(initial=np.inf))
    if least < _SMALLEST:
        raise InvalidInput(f"{name}: expected 0 or at least {_SMALLEST:g}, got {least:.3g}: check the units")
