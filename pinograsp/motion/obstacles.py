"""What is in the way of a closing hand: the object, the table, and the hand's own links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.contacts.hits import Way
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.contacts.support_plane import SupportPlane, deepest_below
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

_HIT = 1e-4  # [m] that links may go into the object on the way: 0.05 N on contacts of the default stiffness
_GRAZED = 1e-3  # [m] likewise on its last part, on which all of them come to touch
_LOOKS, _EVERY = 28, 4  # samples of the way that are looked at for hits, and every which for links hitting each other
_LAST = 6  # samples of the last part


class Met(NamedTuple):
    """What is hit on a way: how deep [m], 0 where links hit each other, and in words."""

    depth: float
    text: str


class Obstacles:
    """The object, the table where there is one, and the links of the hand itself."""

    def __init__(self, hand: HandModel, body: Body, table: SupportPlane | None):
        self.hand, self.table = hand, table
        self.way, self.collisions = Way(hand, body), SelfCollisions(hand)

    def meet(self, q: Array, times: Array, until: float, impact: int) -> Met | None:
        """What the hand hits along q (m, n) at ``times`` (m,) [s] up to a sample, or the table at the end, too; and
        what goes far into the object from there to the impact.

        Some samples are enough: the way is smooth.
        """
        looked_at = np.unique(np.linspace(0, until, _LOOKS).astype(int))
        way = q[looked_at]
        what, hit = "the object", self.way.deepest_hit(way, allowed=_HIT)
        if hit is None and self.table is not None:
            what, hit = "the table", deepest_below(self.hand, self.table, np.vstack([way, q[-1:]]))
        if hit is None:
            looked_at = np.linspace(until, impact, _LAST).astype(int)
            what, hit = "the object", self.way.deepest_hit(q[looked_at], allowed=_GRAZED)
        if hit is not None:
            time = times[[*looked_at, -1][hit.sample]]
            return Met(hit.depth, f"{hit.link} hits {what} on the way, at {time:.2g} s, {1e3 * hit.depth:.2g} mm deep")
        crossing = self.collisions.after(way[0], way[1::_EVERY])
        return Met(0.0, f"{' and '.join(crossing[0])} hit each other on the way") if crossing else None
