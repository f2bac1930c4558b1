"""How far a hand can go on a way without touching an object: bounds of conservative advancement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from pinograsp import core
from pinograsp.contacts.clearance import Distances, Gap, HandPart
from pinograsp.contacts.compiled import joints_of, support_shape
from pinograsp.spatial import Array

_NEAR = 2e-6  # [m] from here on distances are coal's
_NO_PLANE = 1e9  # [m] per unit of the way: what no part moves by


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

    def __init__(self, distances: Distances, parts: Sequence[HandPart], touch: float, creep: float):
        self._joints, self._touch, self._creep = [part.joint for part in parts], touch, creep
        self._reach, self._turning, self._sliding = (np.array(own) for own in zip(*(part.rates for part in parts)))
        self._corners = np.array([part.corners for part in parts])  # (p, 8, 3)
        # Where a part was looked at: its distance, by which its plane's shrinks at first, and how that can change.
        self._known = np.zeros((7, len(parts)))
        self._gaps, self._since, self._rate, self.times, self.stops, self.speed, self._bend = self._known
        self._gaps[:], self._rate[:] = -np.inf, _NO_PLANE
        self._pose = np.array(distances.body.shape_pose)
        self._compiled = _compile(distances, parts, touch, creep) if core.is_installed() else None

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


def _compile(distances: Distances, parts: Sequence[HandPart], touch: float, creep: float) -> Any:
    """The core's method for the same parts; those of unknown shapes it leaves to coal."""
    compiled = core.load().Approach(touch=touch, creep=creep, near=_NEAR)
    for joint in joints_of(distances.model):
        compiled.add_joint(*joint)
    for part in parts:
        compiled.add_part(part.joint - 1, part.placement.homogeneous, part.corners, *support_shape(part.hull))
    compiled.put(*support_shape(distances.hull))
    return compiled
