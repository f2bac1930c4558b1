"""Small pieces of rigid-body geometry that every room needs (numpy only).

Example:
    >>> import numpy as np
    >>> import pinograsp as pg
    >>> pose = pg.spatial.pose_of([0.1, 0.0, 0.0], pg.spatial.rotation_rpy(0, 0, np.pi / 2))
    >>> print(pg.spatial.inverse_of(pose).round(3) + 0.0)
    [[ 0.   1.   0.   0. ]
     [-1.   0.   0.   0.1]
     [ 0.   0.   1.   0. ]
     [ 0.   0.   0.   1. ]]

See Also:
    :class:`~pinograsp.hands.HandModel`, :class:`~pinograsp.objects.Box`: what is placed by such poses.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp.errors import InvalidInput

# The arrays of the package: numbers, indices and counts, answers.
Array: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.integer]
BoolArray: TypeAlias = NDArray[np.bool_]

# Below this, a direction's projection on a tangent plane counts as zero: far above rounding
# (1e-16), far below any angle at which the tangent direction would matter in practice.
_VANISHED = 1e-6

_YZX, _ZXY, _MANY = np.array([1, 2, 0]), np.array([2, 0, 1]), 3000

_DIGITS = 1e-2  # of inertias in files, which are rounded

# [m] No hand or object reaches farther: more is a mistake of units, and beyond where distances keep their digits.
FARTHEST = 1e3


def _numbers(name: str, value: ArrayLike, *ends: int, single: bool = False) -> Array:
    """``value`` (..., *ends), or (*ends) of a ``single`` one, as finite numbers."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    extra = array.ndim - len(ends)
    if extra < 0 or (single and extra) or array.shape[array.ndim - len(ends) :] != ends or not np.isfinite(array).all():
        wanted = f"finite numbers of shape (..., {', '.join(map(str, ends))})" if ends else "a finite number"
        raise InvalidInput(f"{name}: expected {wanted}, got {value!r:.60}")
    return array


def skew(v: ArrayLike) -> Array:
    """Cross-product matrices, shape (..., 3, 3), of vectors (..., 3): ``skew(a) @ b == cross(a, b)``."""
    v = _numbers("vector", v, 3)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: Array, b: Array) -> Array:
    """Cross products (..., 3) of arrays (..., 3); of few without numpy's checks, which take ten times as long."""
    if a.size + b.size > _MANY:
        many: Array = np.cross(a, b)
        return many
    few: Array = a.take(_YZX, -1) * b.take(_ZXY, -1) - a.take(_ZXY, -1) * b.take(_YZX, -1)
    return few


def tangent_frame(normal_o: ArrayLike, gravity_o: ArrayLike = (0.0, 0.0, -9.81)) -> Array:
    """Contact frame R_oc (3, 3) with columns x, y, z for a unit inward normal [-].

    z is the normal (into the object); x is the direction opposite to gravity projected on the tangent plane,
    or, where that vanishes, the world x (then y) axis projected; y completes a right-handed frame. The rule is
    deterministic, so the friction multipliers (k1, k2) of Eq. (27) have a fixed meaning: k1 is "up".
    """
    z, gravity = _numbers("normal", normal_o, 3, single=True), _numbers("gravity", gravity_o, 3, single=True)
    size = float(np.linalg.norm(z))
    if not 0 < size < np.inf:
        raise InvalidInput(f"tangent frame: expected one normal that is not zero, one gravity, got {normal_o!r:.60}")
    z = z / size
    strength = np.linalg.norm(gravity)
    up = -gravity / strength if strength > 0 else np.array([0.0, 0.0, 1.0])
    for direction in (up, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        x = direction - z * (z @ direction)
        length = np.linalg.norm(x)
        if length > _VANISHED:
            x /= length
            x -= z * (z @ x)  # once more: a short projection carries the rounding of the long vectors
            x /= np.linalg.norm(x)
            break
    return np.column_stack([x, cross(z, x), z])


def rotation_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation (3, 3) from fixed-axis roll, pitch, yaw [rad], the URDF convention Rz(yaw) Ry(pitch) Rx(roll)."""
    angles = (_numbers("roll, pitch, yaw", angle, single=True) for angle in (roll, pitch, yaw))
    cr, sr, cp, sp, cy, sy = (f(a) for a in angles for f in (np.cos, np.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def multiply_rows(rows: Array, matrix: Array) -> Array:
    """``rows @ matrix`` of many rows (..., n) and a small matrix (n, m), row by row.

    In one product BLAS would wake all its threads, which then wait for more work longer than it takes.
    """
    products: Array = rows[..., None, :] @ matrix
    return products[..., 0, :]


def inverse_of(poses: Array) -> Array:
    """Inverses of homogeneous placements (..., 4, 4)."""
    poses = _numbers("placements", poses, 4, 4)
    found = np.zeros_like(poses)
    turned = poses[..., :3, :3].swapaxes(-1, -2)
    found[..., :3, :3], found[..., 3, 3] = turned, 1.0
    found[..., :3, 3] = -(turned @ poses[..., :3, 3, None])[..., 0]
    return found


def pose_of(position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> Array:
    """Homogeneous placement aMb (4, 4) from a position [m] and a rotation (3, 3)."""
    pose = np.eye(4)
    pose[:3, 3] = _numbers("position", position, 3, single=True)
    if rotation is not None:
        pose[:3, :3] = _numbers("rotation", rotation, 3, 3, single=True)
    return pose


def move_about(pose: Array, centre: Array, shift: Array, turn: Array) -> Array:
    """A placement (4, 4) turned by ``turn`` (3, 3) about a point (3,), which moves by ``shift`` (3,); world axes, m."""
    moved = np.array(pose)
    moved[:3, :3] = turn @ moved[:3, :3]
    moved[:3, 3] = centre + shift + turn @ (moved[:3, 3] - centre)
    return moved


def moments_problem(moments: Array, most: float) -> str:
    """Why no solid has these moments of inertia, in words; empty where one may, up to the rounding of files.

    Args:
        moments: about the centre of mass (3,), ascending [kg m^2].
        most: mass times the square of the farthest point's distance from there [kg m^2].
    """
    rounding = _DIGITS * moments[2]
    if moments[0] <= 0 or moments[:2].sum() < moments[2] - rounding:
        return (
            "expected moments > 0, none above the sum of the others, got moments "
            f"{', '.join(f'{moment:.3g}' for moment in moments)} kg m^2"
        )
    if moments[2] > most * (1 + _DIGITS):
        return (
            f"expected moments of at most {most:.3g} kg m^2, its mass times the square of its largest radius, got "
            f"{moments[2]:.3g}: are the units right?"
        )
    return ""


def rotation_angle(rotation: Array) -> float:
    """By how much a rotation (3, 3) turns, about its own axis [rad]."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
