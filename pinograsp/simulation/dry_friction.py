"""Dry friction of joints: what stops them within a step, up to a limit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.spatial import Array

_SWEEPS, _SETTLED = 100, 1e-9  # at most, and change of the last one over the largest limit


class Rubbing(NamedTuple):
    """Torques of dry friction (n,) [N m or N], and the joints' accelerations by it (n,) [rad/s^2 or m/s^2]."""

    torques: Array
    accelerations: Array


def stop_joints(mass: Array, dq: Array, dt: float, most: Array, start: Array) -> Rubbing:
    """Friction over a step that would end at the velocities dq: it stops a joint, as far as its limit allows.

    The joints move each other: Gauss-Seidel over them, each between its limits.

    Args:
        mass: the joints' mass matrix (n, n), with what acts implicitly.
        dq: velocities at the end of the step, without friction (n,) [rad/s or m/s].
        dt: of the step [s].
        most: largest friction (n,) [N m or N].
        start: friction to begin with, that of the last step (n,) [N m or N].
    """
    yields = np.linalg.inv(mass)
    wanted, torques = dq / dt, start.copy()
    joints = np.flatnonzero(most)
    for _ in range(_SWEEPS):
        before = torques.copy()
        for j in joints:
            stopping = torques[j] - (wanted[j] + yields[j] @ torques) / yields[j, j]
            torques[j] = min(max(stopping, -most[j]), most[j])
        if np.abs(torques - before).max() <= _SETTLED * most.max():
            break
    return Rubbing(torques, yields @ torques)
