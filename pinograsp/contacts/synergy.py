"""How any hand closes: an open and a closed posture for an object, from the tree and the geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pinograsp.checks import instance_of
from pinograsp.contacts.clearance import Distances, HandPart
from pinograsp.contacts.tips import link_centre
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, skew

_ROOM = 0.08  # of its range that a turning joint keeps from its stop: approaches swing back a little before they close
_AS_NEAR = 5e-3  # [m] distances that differ by less count as equal
_SPREADS, _SAMPLES = 7, 12  # values tried of a joint that spreads a finger, and postures along the way of each


def open_and_closed(hand: HandModel, body: Body) -> tuple[Array, Array]:
    """A default synergy: an open and a closed posture (n,), (n,) [rad or m] for closing on ``body``.

    Flexion joints (those parallel to their finger's last joint) and sliding joints move from the limit that takes the
    fingertip away from the object (turning joints keep a little room there) to the limit that takes it towards the
    object. Other joints spread or oppose the fingers: each stays in the position in which its flexing finger comes
    nearest to the object. Joints of no finger stay at ``hand.posture``, or near 0.
    """
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body)
    room = _ROOM * (hand.upper - hand.lower)
    middle = np.clip(hand.resting, hand.lower, hand.upper)
    towards, spreads, sliding = _roles(hand, body, middle)
    stays = np.isin(hand.joint_names, list(hand.posture))
    middle = np.where(stays, middle, np.clip(middle, hand.lower + room, hand.upper - room))
    opened, closed = middle.copy(), middle.copy()
    for i in np.flatnonzero(towards).tolist():
        opened[i], closed[i] = (hand.lower[i], hand.upper[i])[:: 1 if towards[i] > 0 else -1]
        if i not in sliding:
            opened[i] += _ROOM * (closed[i] - opened[i])
    distances = Distances(hand, body)
    for name, dofs in spreads.items():
        finger = hand.finger(name)
        outer = [
            HandPart(hand, one, {}) for one in hand.geometry.geometryObjects if one.parentJoint in finger.joint_ids[-2:]
        ]
        for i in dofs:
            values = np.linspace(hand.lower[i] + room[i], hand.upper[i] - room[i], _SPREADS)
            values = np.unique(np.append(values, middle[i]))
            nearest = [_least_distance(distances, outer, opened, closed, i, value) for value in values]
            best = min(nearest)
            # Among those that come about as near, the one that turns least: fingers spread for a reason only.
            good = [v for v, gap in zip(values, nearest) if gap <= best + _AS_NEAR]
            opened[i] = closed[i] = min(good, key=lambda v: abs(v - middle[i])) if good else middle[i]
    return opened, closed


def _roles(hand: HandModel, body: Body, middle: Array) -> tuple[Array, dict[str, list[int]], set[int]]:
    """What each joint is for.

    Returns:
        (n,): sign of the direction in which a flexion or sliding joint brings its fingertip to the object, 0 for the
        others; by finger, the joints that spread it; and which joints slide.
    """
    data = hand.model.createData()
    towards = np.zeros(hand.n)
    spreads: dict[str, list[int]] = {}
    sliding: set[int] = set()
    # At zero most hands are open, grippers closed: both postures together say which way leads to the object.
    for q in (middle, (hand.lower + hand.upper) / 2):
        pin.computeJointJacobians(hand.model, data, q)
        for finger in hand.fingers:
            j = finger.joint_ids[-1]
            J = pin.getJointJacobian(hand.model, data, j, pin.LOCAL_WORLD_ALIGNED).reshape(6, hand.n).copy()
            tip = link_centre(hand, data, j)
            J[:3] -= skew(tip - data.oMi[j].translation) @ J[3:]
            pull = body.com_o - tip
            last = J[3:, finger.dofs[-1]]
            for i in finger.dofs.tolist():
                turning = np.linalg.norm(J[3:, i])
                if turning < 1e-9:
                    sliding.add(i)
                if (
                    turning < 1e-9
                    or i == finger.dofs[-1]
                    or abs(J[3:, i] @ last) > 0.7 * turning * np.linalg.norm(last)
                ):
                    towards[i] += J[:3, i] @ pull
                elif i not in spreads.setdefault(finger.name, []):
                    spreads[finger.name].append(i)
    return towards, spreads, sliding


def _least_distance(
    distances: Distances, parts: Sequence[HandPart], opened: Array, closed: Array, dof: int, value: float
) -> float:
    """How near parts come to the object on the way, with one joint at a value; overlapping counts as 0."""
    least = np.inf
    for share in np.linspace(0.0, 1.0, _SAMPLES):
        q = opened + share * (closed - opened)
        q[dof] = value
        distances.put(q)
        # Of convex hulls: dents do not change where a finger points, and fine meshes are slow.
        least = min([least, *(max(0.0, distances.rough(part)) for part in parts)])
    return least
