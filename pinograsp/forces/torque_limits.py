"""Limits of the joint torques under contact forces, and what fewer drives than joints cannot choose of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, floats_of, frozen, instance_of, items_of, read_only, share_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray, IntArray

LARGEST = 1e12  # [m] or [N m]: more comes from a mistake of units; solvers would lose all digits to rounding
_ENDLESS = 1e300  # [N m] of a torque limit: more overflows when it is scaled


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Underactuation:
    """What fewer drives than joints cannot choose: rows @ (bias + J^T f) = torques, with the forces f on the object.

    The planned forces satisfy these equations; the forces under disturbances need not, because friction in the joints,
    and their motion, carry the rest.

    Attributes:
        rows: combinations (p, n) of the joint torques that no drive produces, of unit length.
        torques: the part of springs in them (p,) [N m].
        why: the drive that causes each row (p,).
        stops: how joints that rest at the end of their range relax each equation (p,): 1: the left side may be larger,
            -1: smaller, 0: equal. Default: all equal.
        friction: share of the contacts' torques that friction in joints and tendons carries [-]: each side may differ
            by this share of the sum over contacts of F_n times its largest arm on the row.
    """

    rows: Array
    torques: Array
    why: tuple[str, ...]
    stops: IntArray = None  # type: ignore[assignment]  # None becomes an array in __post_init__
    friction: float = 0.0

    __repr__ = brief()

    def __post_init__(self) -> None:
        rows = array_of("rows of an underactuation", self.rows, (None, None))
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "torques", array_of("torques of an underactuation", self.torques, (len(rows),)))
        object.__setattr__(self, "friction", share_of("friction of an underactuation", self.friction))
        why = items_of("why of an underactuation", self.why, str)
        if len(why) != len(rows):
            raise InvalidInput(f"why of an underactuation: expected one text per row, {len(rows)}, got {len(why)}")
        object.__setattr__(self, "why", why)
        stops = np.zeros(len(rows)) if self.stops is None else array_of("stops of them", self.stops, (len(rows),))
        if not np.isin(stops, (-1, 0, 1)).all():
            raise InvalidInput(f"stops of an underactuation: expected -1, 0 or 1 each, got {shorten(stops.tolist())}")
        object.__setattr__(self, "stops", frozen(stops.astype(int)))

    @property
    def limited_sides(self) -> tuple[BoolArray, BoolArray]:
        """Which equations limit their left side from above (p,), and from below (p,)."""
        return self.stops <= 0, self.stops >= 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueLimits:
    """Limits of the joint torques: |bias + J^T f| <= (1 - headroom) limit, with the forces f on the object.

    Attributes:
        jacobian: of each contact point (k, 6, n), linear velocity first, world axes (``LOCAL_WORLD_ALIGNED``).
        bias: torque without contact at that posture (n,) [N m], usually that of gravity.
        limit: largest |torque| (n,) [N m]; infinity: no limit.
        joints: names (n,).
        headroom: share of each limit that is kept free [-]: forces use |torque| <= (1 - headroom) limit.
        underactuation: what the drives cannot choose of these torques; None: nothing.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> jacobian = np.zeros((3, 6, 1))
        >>> jacobian[0, 0, 0] = 0.08  # one joint, which presses the first contact over 80 mm
        >>> limits = pg.TorqueLimits(jacobian=jacobian, bias=[0.0], limit=[0.05])
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.1, torques=limits)
        >>> print(pg.optimize_forces(problem, 0.9).status)
        infeasible

    See Also:
        :func:`~pinograsp.motion.torque_limits` makes them for a hand.
    """

    jacobian: Array
    bias: Array
    limit: Array
    joints: tuple[str, ...] = ()
    headroom: float = 0.0
    underactuation: Underactuation | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        jacobian = array_of("contact Jacobians", self.jacobian, (None, 6, None))
        n = jacobian.shape[2]
        limit = floats_of("torque limits", self.limit, f"{n} numbers [N m]")
        if limit.shape != (n,) or not np.all((limit > 0) & ((limit <= _ENDLESS) | (limit == np.inf))):
            raise InvalidInput(
                f"torque limits: expected {n} values > 0, up to {_ENDLESS:g} [N m] or infinity where a joint has none, "
                f"got {shorten(limit.tolist())}; a hand description without effort limits needs limit=..."
            )
        joints = items_of("joints of the torque limits", self.joints, str)
        if joints and len(joints) != n:
            raise InvalidInput(f"torque limits: expected {n} joint names, got {len(joints)}")
        bias = array_of("bias torques", self.bias, (n,))
        for name, unit, values in (("contact Jacobians", "m", jacobian), ("bias torques", "N m", bias)):
            if np.abs(values).max(initial=0.0) > LARGEST:
                raise InvalidInput(f"{name}: expected sizes up to {LARGEST:g} [{unit}], got {np.abs(values).max():g}")
        object.__setattr__(self, "jacobian", jacobian)
        object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "limit", read_only(limit))
        object.__setattr__(self, "joints", joints or tuple(f"joint {j + 1}" for j in range(n)))
        object.__setattr__(self, "headroom", share_of("headroom of the torque limits", self.headroom))
        instance_of("underactuation", self.underactuation, Underactuation, type(None))
        if self.underactuation is not None and self.underactuation.rows.shape[1] != n:
            raise InvalidInput(f"underactuation: expected {n} torques, got {self.underactuation.rows.shape[1]}")

    @property
    def usable(self) -> Array:
        """Largest |torque| that forces may use (n,) [N m], which leaves the headroom of the limits free."""
        usable: Array = (1.0 - self.headroom) * self.limit
        return usable

    @property
    def limited(self) -> BoolArray:
        """Which joints have a limit (n,) bool."""
        finite: BoolArray = np.isfinite(self.limit)
        return finite

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Names of the joints that have a limit, in the order of a program's torque rows."""
        return tuple(joint for joint, finite in zip(self.joints, self.limited) if finite)

    def torques(self, forces_o: ArrayLike, moments_o: ArrayLike | None = None) -> Array:
        """Joint torques (n,) [N m] under forces on the object (k, 3) [N] and moments (k, 3) [N m], world axes."""
        shape = (len(self.jacobian), 3)
        tau: Array = self.bias + np.einsum("kxn,kx->n", self.jacobian[:, :3], array_of("forces", forces_o, shape))
        if moments_o is not None:
            tau += np.einsum("kxn,kx->n", self.jacobian[:, 3:], array_of("moments", moments_o, shape))
        return tau
