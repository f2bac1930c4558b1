"""The plane that an object stands on, and where a hand would go through it."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of, number
from pinograsp.contacts.clearance import parts_of
from pinograsp.contacts.hits import Hit
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

_FAR = 1e4  # radii of the object: the point that is nearest to one so far below is its lowest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SupportPlane:
    """A table: nothing of a hand may be below it.

    Attributes:
        up_o: unit normal (3,), away from the table.
        height: of the plane along it [m].
    """

    up_o: Array
    height: float

    __repr__ = brief()

    def __post_init__(self) -> None:
        up = array_of("support plane's normal", self.up_o, (3,))
        size = float(np.linalg.norm(up))
        if size == 0:
            raise InvalidInput("support plane's normal: expected a direction, got zeros")
        object.__setattr__(self, "up_o", up / size)
        object.__setattr__(self, "height", number("support plane's height", self.height, unit="m"))

    @classmethod
    def under(cls, body: Body, gravity_o: ArrayLike) -> SupportPlane:
        """The plane across gravity (3,) [m/s^2] that touches ``body`` from below."""
        instance_of("body", body, Body)
        gravity = array_of("gravity", gravity_o, (3,))
        size = float(np.linalg.norm(gravity))
        if size == 0:
            raise InvalidInput("table: expected gravity, got none: without it nothing lies on a table")
        up = -gravity / size
        lowest = body.project((body.com_o - _FAR * body.bounding_radius * up)[None])[0][0]
        return cls(up_o=up, height=float(lowest @ up))


def deepest_below(hand: HandModel, plane: SupportPlane, postures: ArrayLike) -> Hit | None:
    """Where the hand is deepest below a plane at postures (m, n); None: nowhere."""
    data, parts = hand.model.createData(), parts_of(hand)
    space = coal.Halfspace(np.array(plane.up_o), plane.height)  # what is below the plane
    at, request = coal.Transform3s(), coal.DistanceRequest()
    worst: Hit | None = None
    for sample, q in enumerate(array_of("postures", postures, (None, hand.n))):
        pin.forwardKinematics(hand.model, data, q)
        for part in parts:
            pose = data.oMi[part.joint] * part.placement
            result = coal.DistanceResult()
            depth = -coal.distance(
                part.hull, coal.Transform3s(pose.rotation, pose.translation), space, at, request, result
            )
            if depth > (0.0 if worst is None else worst.depth):
                worst = Hit(sample=sample, link=part.link, depth=depth)
    return worst
