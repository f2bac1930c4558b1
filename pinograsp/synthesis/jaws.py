"""Closing fingers that cannot stop one by one: the hand is moved so that they touch at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinograsp.contacts import PALM, Closure
from pinograsp.contacts.advance import PreparedClosing
from pinograsp.contacts.clearance import Distances, HandPart
from pinograsp.contacts.closing import Closing
from pinograsp.errors import PinograspError
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, cross, move_about

_CENTRINGS, _CHEAP, _RATHER = 8, 100.0, 3.0  # closings that centre jaws; they rather close on, or move, than turn


class NearPoint(NamedTuple):
    """The point of a finger that is nearest to an object.

    Attributes:
        gap: its signed distance [m].
        point_o: in the world (3,) [m].
        joint: Pinocchio's index of the joint that carries it.
    """

    gap: float
    point_o: Array
    joint: int


def near_points(distances: Distances, parts: Sequence[HandPart]) -> dict[str, NearPoint]:
    """The point of each finger that is nearest to the object, and of the palm as ``"palm"``; ``parts`` of the hand
    that may be.
    """
    near: dict[str, NearPoint] = {}
    for part in parts:
        if part.finger not in near or distances.rough(part) < near[part.finger].gap:
            gap, point = distances.of(part)
            if part.finger not in near or gap < near[part.finger].gap:
                near[part.finger] = NearPoint(gap, point, part.joint)
    return near


def cannot_stop_alone(hand: HandModel) -> bool:
    """Whether fingers share an actuator, or a single one presses against the palm: they cannot stop one by one."""
    return len(hand.fingers) == 1 or len({i for one in hand.fingers for i in one.dofs.tolist()}) < sum(
        one.n for one in hand.fingers
    )


def centre_on(hand: HandModel, body: Body, opened: Array, closed: Array, prepared: PreparedClosing) -> Closure | None:
    """The closure of fingers that cannot stop one by one, with the hand moved so that they touch at the same time.

    Pushing the object between them would take far longer. None where that does not come to two fingers that touch.
    """
    way = closed - opened
    fingers = {one.name for one in hand.fingers} | ({PALM} if len(hand.fingers) == 1 else set())
    last: Closing | None = None
    for _ in range(_CENTRINGS):
        try:
            closing = Closing(hand, body, opened, closed, prepared)
            closing.approach()
        except PinograspError:  # moved into the object
            break
        last, q = closing, closing.find_posture()
        closing.distances.put(q)
        near = near_points(closing.distances, closing.parts)
        # The others are too far away to take part.
        pressing = [name for name, one in near.items() if name in fingers and one.gap < 2 * body.bounding_radius]
        if len(pressing) < 2 or closing.touching.issuperset(pressing):
            break
        hand = hand.placed(_even_out(hand, body, q, way, [near[name] for name in pressing]))
    return last.result() if last is not None and len(last.touching & fingers) > 1 else None


def _even_out(hand: HandModel, body: Body, q: Array, way: Array, pressing: list[NearPoint]) -> Array:
    """The pose (4, 4) with the least motion of the hand after which closing on brings all points to the surface."""
    data = hand.model.createData()
    pin.computeJointJacobians(hand.model, data, q)
    points = np.array([one.point_o for one in pressing])
    _, normals, _ = body.project(points)
    arm = body.bounding_radius
    closing = []
    for one, point, normal in zip(pressing, points, normals):
        J = np.zeros((6, hand.n))
        if one.joint:
            J = pin.getJointJacobian(hand.model, data, one.joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, hand.n)
        speed = J[:3] @ way + cross(J[3:] @ way, point - data.oMi[one.joint].translation)
        closing.append(normal @ speed)
    turning = cross(points - body.com_o, normals) / (_RATHER * arm)
    rows = np.column_stack([normals, turning, _CHEAP * np.array(closing)])
    motion = np.linalg.lstsq(rows, np.array([one.gap for one in pressing]), rcond=1e-9)[0]
    size = float(np.linalg.norm(motion[:3]))
    if size > arm:
        motion *= arm / size
    turn = pin.exp3(motion[3:6] / (_RATHER * arm))
    return move_about(hand.pose, body.com_o, motion[:3], turn)
