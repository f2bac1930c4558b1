"""Where a hand is in an object: on its way, and with links that have no contact there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, instance_of
from pinograsp.contacts.clearance import Distances, check_geometry, parts_of
from pinograsp.contacts.contact_set import ContactSet
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body


class Hit(NamedTuple):
    """Where a hand on its way is deepest in an object.

    Attributes:
        sample: of the way.
        link: of the hand.
        depth: [m].
    """

    sample: int
    link: str
    depth: float


class Way:
    """A hand on several ways past the same object."""

    def __init__(self, hand: HandModel, body: Body):
        check_geometry(hand)
        self.n, self.distances, self.parts = hand.n, Distances(hand, instance_of("body", body, Body)), parts_of(hand)

    def deepest_hit(self, postures: ArrayLike, *, allowed: float = 0.0) -> Hit | None:
        """Where the hand is deepest in the object on one of them (m, n); None: nowhere deeper than ``allowed`` [m]."""
        distances, way = self.distances, array_of("postures", postures, (None, self.n))
        near, steps = distances.near(self.parts, way)
        worst: Hit | None = None
        gaps = np.full(len(self.parts), -np.inf)  # at least
        for sample, q in enumerate(way):
            gaps -= steps[sample - 1] if sample else 0.0
            looked_at = np.flatnonzero(near[sample] & (gaps <= 0.0)).tolist()
            if looked_at:
                distances.put(q)
            for i in looked_at:
                part = self.parts[i]
                gaps[i] = distances.rough(part)
                if gaps[i] >= -allowed:
                    continue
                depth = -distances.of(part)[0]
                if depth > max(allowed, 0.0 if worst is None else worst.depth):
                    worst = Hit(sample=sample, link=part.link, depth=depth)
        return worst


def find_overlaps(
    hand: HandModel, body: Body, contacts: ContactSet, q: ArrayLike, *, allowed: float
) -> tuple[str, ...]:
    """Links without a contact that are deeper in ``body`` than ``allowed`` [m] at q (n,)."""
    distances = Distances(hand, instance_of("body", body, Body))
    distances.put(array_of("q", q, (hand.n,)))
    own, found = {contact.link for contact in contacts}, list[str]()
    for part in parts_of(hand):
        if part.link not in own and distances.rough(part) < -allowed and distances.of(part)[0] < -allowed:
            found.append(part.link)
    return tuple(dict.fromkeys(found))
