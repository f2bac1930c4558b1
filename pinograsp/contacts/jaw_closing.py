"""Jaws closed on an object at many places at once, for grasps that are told as the gripper's pose alone."""

from __future__ import annotations

import numpy as np

from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.synergy import open_and_closed
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray, IntArray

_TOUCH = 1e-6  # [m] a gap that counts as touching
_ROUNDS = 40  # of conservative advancement
_REFINED, _FILLED, _ACROSS = 2, 3e-3, 0.05  # rounds, [m], and closing speed against the normal [m per rad or m]
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
    limits = min(opened, closed), max(opened, closed)
    stops, touching = [], []
    for parts in jaws:
        q, touches = _stops(scene, roots, parts, opened, closed)
        stops.append(_refine(scene, roots, parts, q, touches, limits))
        touching.append(touches)
    q = np.mean(stops, axis=0)
    shift = np.zeros((len(roots), 3))
    for own, parts in zip(stops, jaws):
        before, after = (scene.placed_parts(one[:, None], roots)[:, parts] for one in (own, q))
        shift += (after - before)[..., :3, 3].mean(axis=1) / len(jaws)
    moved = np.array(roots)
    moved[:, :3, 3] -= shift
    return q[:, None], moved, np.all(touching, axis=0)


def _refine(
    scene: BulkScene, roots: Array, parts: IntArray, q: Array, touching: BoolArray, limits: tuple[float, float]
) -> Array:
    """Where they touch the object itself (N,): its convex parts may fill hollows, by less than 2 mm as a rule."""
    q = q.copy()
    for _ in range(_REFINED):
        found = scene.contacts(q[:, None], roots, tolerance=_FILLED)
        own = np.flatnonzero(np.isin(found.part, parts) & touching[found.grasp])
        rate = np.einsum("tx,tx->t", found.normals_o[own], found.jacobians_o[own, :3, 0])
        own, rate = own[np.abs(rate) > _ACROSS], rate[np.abs(rate) > _ACROSS]
        step = np.full(len(q), np.inf)
        np.minimum.at(step, found.grasp[own], found.gap[own] / np.abs(rate))
        sign = np.zeros(len(q))
        sign[found.grasp[own]] = np.sign(rate)
        q = np.clip(q + sign * np.where(np.isfinite(step), step, 0.0), *limits)
    return q


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
