"""Jaws closed on an object at many places at once, for grasps that are told as the gripper's pose alone."""

from __future__ import annotations

import numpy as np

from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.synergy import open_and_closed
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray, IntArray

_TOUCH = 1e-6  # [m] a gap that counts as touching
_ROUNDS = 40  # of conservative advancement
_FAR = 0.02  # [m] step where nothing is near


def close_jaws(scene: BulkScene, roots: Array) -> tuple[Array, Array, BoolArray]:
    """Where the jaws meet the object at each place of the hand's root.

    Each jaw closes until it touches (conservative advancement); jaws of one motor that would touch one after the other
    push the object, or are pushed, until both do: the hand's root is moved by half of the difference.

    Args:
        scene: a hand of one joint, and the object.
        roots: oMh (N, 4, 4).

    Returns:
        Positions (N, 1) [rad or m]; roots (N, 4, 4); whether all jaws touch (N,).

    Raises:
        InvalidInput: a hand of several joints.
    """
    hand = scene.hand
    if hand.n != 1:
        raise InvalidInput(
            f"jaws: expected a hand of one joint, got '{hand.name}' with {hand.n}: give the joints' positions"
        )
    opened, closed = (float(q[0]) for q in open_and_closed(hand, scene.body))
    jaws = [np.flatnonzero(scene.fingers == i) for i in range(1, len(hand.fingers) + 1)]
    stops, touching = zip(*(_stops(scene, roots, parts, opened, closed) for parts in jaws))
    q = np.mean(stops, axis=0)
    shift = np.zeros((len(roots), 3))
    for own, parts in zip(stops, jaws):
        before, after = (scene.placed_parts(one[:, None], roots)[:, parts] for one in (own, q))
        shift += (after - before)[..., :3, 3].mean(axis=1) / len(jaws)
    moved = np.array(roots)
    moved[:, :3, 3] -= shift
    return q[:, None], moved, np.all(touching, axis=0)


def _stops(scene: BulkScene, roots: Array, parts: IntArray, opened: float, closed: float) -> tuple[Array, BoolArray]:
    """Where some parts of the hand first touch on the way from open to closed (N,), and whether they do."""
    q, speed = np.full(len(roots), opened), max(float(scene.parts[i].reach[0]) for i in parts)
    touching = np.zeros(len(roots), dtype=bool)
    going = np.arange(len(roots))
    for _ in range(_ROUNDS):
        gaps = scene.gaps(q[going, None], roots[going], parts, _FAR)
        touching[going] = gaps <= _TOUCH
        left = ~touching[going] & (q[going] != closed)
        going, gaps = going[left], gaps[left]
        if not len(going):
            break
        step = np.sign(closed - opened) * gaps / speed
        q[going] = np.clip(q[going] + step, min(opened, closed), max(opened, closed))
    return q, touching
