"""Points of a finger at many postures at once: forward kinematics as a product of exponentials, array by array.

At one posture all joints are screws (R. W. Brockett, Mathematical Theory of Networks and Systems, 1984): a point that
the joints 1..j carry goes to exp(S_1 d_1) ... exp(S_j d_j) p, with the screws S_i in the world and the distances d_i
from that posture. Pinocchio's own kinematics is quicker for a few postures, this for a hundred.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinograsp.hands import Finger, HandModel
from pinograsp.spatial import Array, skew

_TURNS = 1e-9  # [rad per rad or m] joints that turn less than this slide


def points_at(
    hand: HandModel, finger: Finger, joints: Sequence[int], points_l: Array, q: Array, posture: Array
) -> tuple[Array, Array]:
    """Points of a finger (m, c, 3) and their Jacobians (m, c, 6, n_f) at its joint positions ``q`` (m, n_f).

    Args:
        hand: the hand.
        finger: its finger.
        joints: Pinocchio's indices of the joints that carry the points (c,); 0: the palm does, which does not move.
        points_l: in the joints' frames (c, 3) [m].
        q: positions of the finger's actuated joints [rad or m].
        posture: (n,) of all others.

    Returns:
        World axes; of the Jacobians the linear velocity first.
    """
    model, data = hand.model, hand.model.createData()
    start = np.array(posture)
    start[finger.dofs] = q[0]
    pin.computeJointJacobians(model, data, start)
    known = {0: _Screws(np.zeros((6, model.nv)), np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3)), [])}
    points, jacobians = np.empty((len(q), len(joints), 3)), np.zeros((len(q), len(joints), 6, finger.n))
    for c, (joint, point_l) in enumerate(zip(joints, points_l)):
        for j in list(model.supports[joint])[1:]:
            if j not in known:
                own = pin.getJointJacobian(model, data, j, pin.WORLD).reshape(6, model.nv)
                known[j] = _carry(known[model.parents[j]], own, finger, q - q[0])
        last = known[joint]
        points[:, c] = last.turned @ data.oMi[joint].act(point_l) + last.moved
        for dof, before, linear, angular in last.passed:
            # The point where it would be if the joints before this one had not moved.
            point = (before.turned.transpose(0, 2, 1) @ (points[:, c] - before.moved)[:, :, None])[:, :, 0]
            speed = linear + point @ skew(angular).T
            jacobians[:, c, :3, dof] += (before.turned @ speed[:, :, None])[:, :, 0]
            jacobians[:, c, 3:, dof] += before.turned @ angular
    return points, jacobians


class _Screws(NamedTuple):
    """Where a joint has been carried at m postures: ``turned`` (m, 3, 3) and ``moved`` (m, 3) from where it was.

    ``own`` (6, n): its Jacobian at the first posture; ``passed``: of all joints on the way the index in the finger, the
    joint before, and the screw at the first posture: linear (3,) and angular (3,) part.
    """

    own: Array
    turned: Array
    moved: Array
    passed: list[tuple[int, _Screws, Array, Array]]


def _carry(before: _Screws, own: Array, finger: Finger, distances: Array) -> _Screws:
    """The next joint, with its Jacobian ``own`` (6, n), as the finger's joints go by ``distances`` (m, n_f)."""
    turned, moved, passed = before.turned, before.moved, before.passed
    # What this joint adds to the one before: one column, its own or that of the joint that it follows.
    screw = own[:, finger.dofs] - before.own[:, finger.dofs]
    for dof in np.flatnonzero(np.abs(screw).max(axis=0, initial=0.0) > _TURNS).tolist():
        linear, angular = screw[:3, dof], screw[3:, dof]
        passed = [*passed, (dof, before, linear, angular)]
        rate = float(np.linalg.norm(angular))
        if rate < _TURNS:
            moved = moved + (turned @ linear) * distances[:, dof, None]
            continue
        angle, axis = rate * distances[:, dof], angular / rate
        across = skew(axis)
        sine, versed = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
        turn = np.eye(3) + sine * across + versed * (across @ across)
        centre = across @ linear / rate  # a point on the axis
        moved = moved + turned @ centre
        turned = turned @ turn
        moved = moved - turned @ centre
    return _Screws(own, turned, moved, passed)
