"""How far a hand can go on a way without touching an object: bounds of conservative advancement."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from pinograsp import core
from pinograsp.contacts.clearance import PALM, Gap, HandPart, parts_of
from pinograsp.contacts.compiled import joints_of, support_shape
from pinograsp.contacts.pushing import CompiledPush
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import solid_of
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

TOUCH = 1e-7  # [m] a gap that counts as touching; distances of smooth shapes are exact to 1e-9
_CREEP = 2e-5  # [m] least advance, so that what slides along the object does so in few steps
_NEAR = 2e-6  # [m] from here on distances are coal's
_NO_PLANE = 1e9  # [m] per unit of the way: what no part moves by


class PreparedClosing:
    """What closings of a hand on an object have in common, wherever the two are.

    Attributes:
        parts: of the hand that may touch, as it was placed.
        collisions: of the hand with itself.
    """

    def __init__(self, hand: HandModel, body: Body, *, palm: bool = True, collisions: SelfCollisions | None = None):
        self.parts = [part for part in parts_of(hand) if palm or part.finger != PALM]
        self.collisions = SelfCollisions(hand) if collisions is None else collisions
        self.rates = tuple(np.array(own) for own in zip(*(part.rates for part in self.parts)))
        self.corners = np.array([part.corners for part in self.parts])  # (p, 8, 3)
        self.pose = hand.pose
        self._hand, self._body = hand, body
        self.compiled = self._compile(hand, body) if core.is_installed() else None

    @cached_property
    def pushing(self) -> CompiledPush | None:
        """The core's pushes of the object by the parts; None where there are none."""
        return CompiledPush.of(self._hand, self._body, self.parts)

    def parts_at(self, hand: HandModel) -> list[HandPart]:
        """The parts of the same hand where it is now."""
        move = pin.SE3(np.array(hand.pose)) * pin.SE3(np.array(self.pose)).inverse()
        return [part if part.joint else part.transform(move) for part in self.parts]

    def _compile(self, hand: HandModel, body: Body) -> Any:
        """The core's way of the same parts; those of unknown shapes it leaves to coal."""
        compiled = core.load().Approach(touch=0.5 * TOUCH, creep=_CREEP, near=_NEAR)
        for joint in joints_of(hand.model):
            compiled.add_joint(*joint)
        for part in self.parts:
            compiled.add_part(part.joint - 1, part.placement.homogeneous, part.corners, *support_shape(part.hull))
        compiled.put(*support_shape(solid_of(body.collision_geometry)))
        return compiled


class Approach:
    """When parts of a hand can touch an object first, on a way at constant joint rates from one posture to the next.

    No part's distance shrinks faster than its fastest point moves. Where a plane parts it from the object, its distance
    from that plane counts: what its points' speeds across the plane take of it, and no more than their change of speed
    besides, which the rates bound (|a| <= turning (speed + sliding), the Coriolis term counted twice).

    Attributes:
        times: on the way (p,), before which a part comes no nearer than ``touch`` [m]; infinity for what does not move.
        stops: where to look at it next (p,): then, or when it has moved by ``creep`` [m].
        speed: bound of each part's (p,) [m per unit of the way].
    """

    def __init__(self, prepared: PreparedClosing, hand: HandModel, body: Body):
        parts, self._touch, self._creep = prepared.parts, 0.5 * TOUCH, _CREEP
        self._joints = [part.joint for part in parts]
        self._reach, self._turning, self._sliding = prepared.rates
        self._corners, self._compiled = prepared.corners, prepared.compiled
        # Where a part was looked at: its distance, by which its plane's shrinks at first, and how that can change.
        self._known = np.zeros((7, len(parts)))
        self._gaps, self._since, self._rate, self.times, self.stops, self.speed, self._bend = self._known
        self._gaps[:], self._rate[:] = -np.inf, _NO_PLANE
        # Of the object, seen with the hand where it was prepared.
        self._pose = np.ascontiguousarray(prepared.pose @ np.linalg.inv(hand.pose) @ body.shape_pose)

    def depart(self, at: float, rate: Array) -> None:
        """Go on at ``at`` with joint rates (n,); planes are found again where parts are looked at."""
        self._gaps[:] = self.room(at)
        self._since[:], self._rate[:] = at, _NO_PLANE
        rates = np.abs(rate)
        self.speed[:] = self._reach @ rates
        self._bend[:] = (self._turning @ rates) * (self.speed + self._sliding @ rates)
        for ends, least in ((self.times, 0.0), (self.stops, self._creep)):
            room = np.maximum(self._gaps - self._touch, least)
            ends[:] = at + np.divide(room, self.speed, out=np.full(len(room), np.inf), where=self.speed > 0)

    def pursue(self, q: Array, rate: Array, at: float, end: float, most: int) -> tuple[float, int]:
        """Where the compiled core gets from q (n,) at ``at``, at joint rates (n,), as long as planes clearly part all
        parts from the object: ``end`` at most; and in how many steps, at most ``most``.
        """
        if self._compiled is None:
            return at, 0
        found: tuple[float, int] = self._compiled.pursue(at, end, q, rate, self._pose, self._known, most)
        return found

    def room(self, at: float) -> Array:
        """Least distances (p,) [m] at ``at``."""
        way = at - self._since
        room: Array = self._gaps - np.minimum(self.speed * way, (self._rate + 0.5 * self._bend * way) * way)
        return room

    def due(self, at: float) -> list[int]:
        """Parts that can touch at ``at``, or a micrometre later."""
        soon = self.times <= at + 1e-6 / np.maximum(self.speed, 1e-9)  # where nothing moves the time is infinite
        return [int(i) for i in np.flatnonzero(soon)]

    def note(self, i: int, gap: Gap, at: float, data: pin.Data) -> None:
        """What part i's distance is at ``at``; ``data``: with the joints' velocities there."""
        self._gaps[i], self._since[i], self._rate[i] = gap.distance, at, _NO_PLANE
        speed = float(self.speed[i])
        if speed == 0.0:
            return
        room = gap.distance - self._touch
        wait = max(room, 0.0) / speed
        if gap.parted and room > 0.0:
            # n . (v + omega x r) = n . v + (n x omega) . r, largest at a corner of its box.
            joint = self._joints[i]
            twist = data.v[joint].vector.tolist()
            x, y, z = (gap.normal @ data.oMi[joint].rotation).tolist()
            a, b, c = twist[3:]
            across = float((self._corners[i] @ (y * c - z * b, z * a - x * c, x * b - y * a)).max())
            rate = self._rate[i] = x * twist[0] + y * twist[1] + z * twist[2] + across
            bend = float(self._bend[i])
            root = math.sqrt(rate * rate + 2.0 * bend * room)
            if rate > 0.0:
                wait = max(wait, 2.0 * room / (rate + root))
            elif bend > 0.0:
                wait = max(wait, (root - rate) / bend)
            else:
                wait = math.inf
        self.times[i], self.stops[i] = at + wait, at + max(wait, self._creep / speed)
