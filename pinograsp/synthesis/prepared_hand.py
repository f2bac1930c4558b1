"""What searches of all objects have in common of a hand: its preshapes, and what of it may collide."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pinograsp import core
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import hulls
from pinograsp.objects.body import Body
from pinograsp.synthesis.jaws import cannot_stop_alone
from pinograsp.synthesis.preshapes import Preshape, free_of_themselves, preshapes, refine, rest_of

_BALANCED = 0.15  # imbalance of preshapes that are used, where there are enough of them
_ENOUGH = 24  # of them
NEAREST = 12  # preshapes nearest in width to a pair, of which one is taken


class PreparedHand(NamedTuple):
    """What searches of all objects have in common."""

    rough: HandModel
    preshapes: tuple[Preshape, ...]
    collisions: SelfCollisions
    parts: bool


@functools.lru_cache(maxsize=4)
def prepare_hand(hand: HandModel, fingers: tuple[str, ...] | None) -> PreparedHand:
    """The hand with hulls, its preshapes, drawn once, and what of it may collide; a second or several.

    ``fingers``: that alone close; None: all.
    """
    rng, rough = np.random.default_rng(0), hand_of_hulls(hand)
    shapes = preshapes(rough, rng, fingers=fingers)
    good = _usable(rough, shapes)
    if len(good) < _ENOUGH and not cannot_stop_alone(hand):
        shapes += preshapes(rough, rng, uneven=True, fingers=fingers)
        shapes += refine(rough, [one for one in shapes if one.yielded] or shapes, rng, fingers=fingers)
        good = _usable(rough, shapes)
    if len(good) < NEAREST:
        good = sorted(shapes, key=lambda one: one.imbalance)[: 4 * NEAREST]
    collisions = SelfCollisions(hand)
    clear = [one for one in good if not collisions.between(rest_of(hand), one.opened)]
    if 2 * len(clear) >= len(good):  # else open fingers touch by design
        good = clear
    return PreparedHand(rough, tuple(good), collisions, len(clear) == len(good))


def hand_of_hulls(hand: HandModel) -> HandModel:
    """The hand with its meshes' convex hulls."""
    return replace(hand, geometry=hulls(hand.geometry))


def scene_of(rough: HandModel, body: Body) -> BulkScene | None:
    """Hand and object for the compiled core; None without it, or of geometry that it does not know."""
    try:
        return BulkScene(rough, body, surface=True) if core.is_installed() else None
    except InvalidInput:
        return None


def _usable(hand: HandModel, shapes: list[Preshape]) -> list[Preshape]:
    """The balanced preshapes, without those whose links hit each other as long as some are left."""
    good = [one for one in shapes if one.imbalance < _BALANCED]
    free = free_of_themselves(hand, good)
    return free if len(free) >= NEAREST // 2 else good
