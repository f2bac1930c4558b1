"""Rotations as data sets write them: quaternions, angles, matrices in 32 bits."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp.spatial import Array, BoolArray

_UNIT = 1e-3  # of a quaternion's length, as of :data:`pinograsp.data.rows`


def poses_from_wxyz(values: Array) -> tuple[Array, BoolArray]:
    """Placements (..., 4, 4) from x y z [m] and a quaternion w x y z (..., 7), and which quaternions have another
    length than 1 (...,).
    """
    quaternions = values[..., 3:7]
    with np.errstate(all="ignore"):
        bad: BoolArray = np.asarray(~(np.abs(np.linalg.norm(quaternions, axis=-1) - 1) <= _UNIT))
    safe = np.where(bad[..., None], [1.0, 0.0, 0.0, 0.0], quaternions)
    flat = safe.reshape(-1, 4)[:, [1, 2, 3, 0]]
    matrices = Rotation.from_quat(flat).as_matrix() if len(flat) else np.zeros((0, 3, 3))
    return placements(values[..., :3], matrices.reshape(*values.shape[:-1], 3, 3)), bad


def wxyz_from_poses(poses: Array) -> Array:
    """x y z [m] and a quaternion w x y z with w >= 0 (..., 7) from placements (..., 4, 4)."""
    flat = poses.reshape(-1, 4, 4)
    xyzw = Rotation.from_matrix(flat[:, :3, :3]).as_quat(canonical=True) if len(flat) else np.zeros((0, 4))
    return np.concatenate([flat[:, :3, 3], xyzw[:, [3, 0, 1, 2]]], axis=-1).reshape(*poses.shape[:-2], 7)


def poses_from_sxyz(positions: Array, angles: Array) -> Array:
    """Placements (N, 4, 4) from positions (N, 3) [m] and angles about the fixed axes x, y, z (N, 3) [rad], one after
    the other.
    """
    good: BoolArray = np.asarray(np.isfinite(angles).all(axis=1))
    safe = np.where(good[:, None], angles, 0.0)
    matrices = Rotation.from_euler("xyz", safe).as_matrix() if len(safe) else np.zeros((0, 3, 3))
    return placements(positions, np.where(np.reshape(good, (-1, 1, 1)), matrices, np.nan))


def sxyz_from_poses(poses: Array) -> Array:
    """Angles about the fixed axes x, y, z (N, 3) [rad] from placements (N, 4, 4)."""
    angles: Array = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz") if len(poses) else np.zeros((0, 3))
    return angles


def placements(positions: Array, rotations: Array) -> Array:
    """Placements (..., 4, 4) from positions (..., 3) [m] and rotations (..., 3, 3)."""
    poses = np.zeros((*positions.shape[:-1], 4, 4))
    poses[..., :3, 3], poses[..., :3, :3], poses[..., 3, 3] = positions, rotations, 1.0
    return poses


def nearest_rotations(poses: Array) -> Array:
    """Placements (..., 4, 4) whose rotations were rounded, with the nearest ones; exact ones stay as they are."""
    poses = np.array(poses, dtype=float)
    rotations = poses[..., :3, :3]
    off = np.abs(rotations @ rotations.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    if rounded := (off > 1e-12).any():
        U, _, V = np.linalg.svd(rotations)
        poses[..., :3, :3] = np.where((off > 1e-12)[..., None, None], U @ V, rotations)
    if rounded or poses.size:
        poses[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    return poses
