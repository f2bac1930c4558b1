"""The first stage: where postures touch the object, as padded arrays of contacts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinograsp.certification.protocols import find_protocol
from pinograsp.certification.record import BEYOND, FAR_OFF
from pinograsp.certification.setup import CertifySetup
from pinograsp.contacts.bulk import CORNERS, BulkContacts
from pinograsp.motion.producible import HARDLY
from pinograsp.objects.body import tangents
from pinograsp.spatial import Array, BoolArray, IntArray, cross

_Scalar = TypeVar("_Scalar", bound=np.generic)

# Motions that close gaps as a matter of course [rad; m with the lever], and what may be left of a gap [m].
_REACH, _LEVER, _OPEN = 0.1, 0.03, 3e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PostureTouches:
    """Where N postures touch, up to k contacts each; other arrays as in :class:`~pinograsp.certification.Certificates`.

    Attributes:
        beyond: which have a joint beyond its limits (N,).
        excess: how far joints were beyond their limits (N, n) [rad or m].
        failed: of which the distance from the object could not be computed (N,).
        collision: pair of links that overlap (N,); -1: none.
        gravity_torques: that hold the hand itself (N, n) [N m or N].
        touched: fingers and palm that touch (N,).
        closing: F_n that closes the gap which leaning faces leave (N, k) [N].
        rotations: contact frames (N, k, 3, 3), z inward.
        jacobians: of the contact points in world axes, linear part first (N, k, 6, n).
    """

    q: Array
    roots: Array
    beyond: BoolArray
    excess: Array
    failed: BoolArray
    collision: IntArray
    gravity_torques: Array
    depth: Array
    antipodal_mu: Array
    counts: IntArray
    touched: IntArray
    links: IntArray
    points_o: Array
    gaps: Array
    closing: Array
    rotations: Array
    jacobians: Array

    @property
    def used(self) -> BoolArray:
        """Which contacts there are (N, k)."""
        used: BoolArray = np.arange(self.points_o.shape[1]) < self.counts[:, None]
        return used

    def motions(self, setup: CertifySetup) -> tuple[Array, Array]:
        """How joints (N, k, n) and the object's shift (N, k, 6), turns times the arm, bring contacts closer."""
        normals = self.rotations[..., 2] * self.used[..., None]
        moves = np.einsum("nkxj,nkx->nkj", self.jacobians[:, :, :3], normals)
        moves[..., setup.idle] = 0.0
        arms = (self.points_o - setup.body.com_o) * self.used[..., None]
        arm = np.sqrt(np.einsum("nkx,nkx->n", arms, arms) / np.maximum(self.counts, 1))
        turned = cross(arms, normals) / np.maximum(arm, HARDLY)[:, None, None]
        return moves, np.concatenate([normals, turned], axis=2)


def find_touches(setup: CertifySetup, q: Array, roots: Array) -> PostureTouches:
    """PostureTouches of fingers and palm that can be at once as contacts, one at each corner of an area."""
    hand, options = setup.hand, setup.options
    allowed = BEYOND * np.where(hand.slides, _LEVER, 1.0)
    excess = np.maximum(np.maximum(hand.lower - q, q - hand.upper), 0.0)
    protocol = find_protocol(options.protocol)
    lenient = protocol is not None and protocol.lenient
    beyond = (excess > allowed).any(axis=1) & (not lenient)
    q = np.clip(q, hand.lower, hand.upper)
    bulk = setup.scene.contacts(
        q, roots, tolerance=options.tolerance, gravity_o=setup.conditions.gravity_o, threads=options.threads
    )
    depth = bulk.depth
    off = ~beyond & (depth == 0) & (np.bincount(bulk.grasp, minlength=len(q)) == 0)
    depth[off] = -setup.scene.gaps(q[off], roots[off], np.arange(len(setup.scene.parts)), FAR_OFF)
    fingers = setup.scene.fingers[bulk.part]
    chosen = np.flatnonzero((fingers >= 0) if options.palm else (fingers > 0))
    corners = bulk.counts[chosen] if options.patches else np.ones(len(chosen), dtype=np.int64)
    touch = np.repeat(chosen, corners)
    corner = np.arange(len(touch)) - np.repeat(np.cumsum(corners) - corners, corners)
    touches = PostureTouches(
        q=q,
        roots=roots,
        beyond=np.asarray(beyond),
        excess=excess,
        failed=bulk.failed,
        collision=np.full(len(q), -1) if lenient else bulk.collision,
        gravity_torques=bulk.gravity_torques,
        depth=depth,
        antipodal_mu=_antipodal(bulk, chosen, len(q)),
        **_pad(setup, bulk, touch, corner, len(q)),
    )
    if (stuck := _stays_open(setup, touches)).any():
        left = ~stuck[bulk.grasp[touch], _slots(touches.counts)]
        touches = replace(touches, **_pad(setup, bulk, touch[left], corner[left], len(q)))
    return touches


def _slots(counts: IntArray) -> IntArray:
    """The number of each contact within its grasp."""
    slots: IntArray = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return slots


def _pad(setup: CertifySetup, bulk: BulkContacts, touch: IntArray, corner: IntArray, count: int) -> dict[str, Any]:
    """Contacts at corners of touches, as the padded arrays of :class:`PostureTouches`."""
    grasp, fingers, patches = bulk.grasp[touch], setup.scene.fingers, setup.options.patches
    counts = np.bincount(grasp, minlength=count)
    slot = _slots(counts)
    shape = count, max(int(counts.max(initial=0)), 1)

    def pad(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
        result: NDArray[_Scalar] = np.zeros((*shape, *values.shape[1:]), dtype=values.dtype)
        result[grasp, slot] = values
        return result

    points = bulk.corners_o[touch, corner] if patches else _middles(bulk)[touch]
    arms = points - bulk.points_o[touch]
    J = bulk.jacobians_o[touch]
    J[:, :3] += np.cross(J[:, 3:], arms[:, :, None], axis=1)
    normals = bulk.normals_o[touch]
    rotations = pad(np.concatenate([tangents(normals), normals[:, :, None]], axis=2))
    rotations[np.arange(shape[1]) >= counts[:, None]] = np.eye(3)
    leaning = bulk.leaning[touch, corner] if patches else np.zeros(len(touch))
    law = setup.conditions.compliance
    touched = np.zeros((count, fingers.max() + 2), dtype=bool)
    touched[grasp, fingers[bulk.part[touch]]] = True
    return {
        "counts": counts,
        "touched": touched.sum(axis=1),
        "links": pad(setup.scene.link_of[bulk.part[touch]]),
        "points_o": pad(points),
        "gaps": pad(bulk.gap[touch] + leaning),
        "closing": pad(law.force(leaning)),
        "rotations": rotations,
        "jacobians": pad(J),
    }


def _stays_open(setup: CertifySetup, touches: PostureTouches) -> BoolArray:
    """Which contacts (N, k) are off the surface and cannot come to it while the others stay there.

    The gaps that are left by the least motion of joints and object, as far as such motions go.
    """
    moves, shifts = touches.motions(setup)
    B = np.concatenate([moves * _REACH, shifts * _REACH * _LEVER], axis=2) / _OPEN
    return np.asarray((leave(B, touches.gaps) > _OPEN) & touches.used, dtype=bool)


def leave(B: Array, wanted: Array) -> Array:
    """What the motions B (N, k, m) leave of changes of k distances (N, k): (1 + B B^T)^-1 of these."""
    k = B.shape[1]
    left = np.linalg.solve(np.eye(k) + B @ np.swapaxes(B, 1, 2), wanted[..., None])[..., 0]
    return np.asarray(left, dtype=float)


def _antipodal(bulk: BulkContacts, touch: IntArray, count: int) -> Array:
    """Of grasps by two links: tan of the largest angle between a normal and the line through both touches (N,)."""
    grasp = bulk.grasp[touch]
    two = np.flatnonzero(np.bincount(grasp, minlength=count) == 2)
    first = touch[np.searchsorted(grasp, two)]
    second = touch[np.searchsorted(grasp, two) + 1]
    middle = _middles(bulk)
    line = middle[second] - middle[first]
    size = np.linalg.norm(line, axis=1)
    along = np.stack([np.einsum("tx,tx->t", line, bulk.normals_o[i]) for i in (first, second)])
    cosine = np.minimum(along[0], -along[1]) / np.where(size > 0, size, 1.0)
    least = np.full(count, np.inf)
    facing = cosine > 0
    least[two[facing]] = np.sqrt(np.maximum(1.0 / cosine[facing] ** 2 - 1.0, 0.0))
    return least


def _middles(bulk: BulkContacts) -> Array:
    """Middles of the areas that touch (t, 3)."""
    counts = (np.arange(CORNERS) < bulk.counts[:, None])[..., None]
    return np.asarray((bulk.corners_o * counts).sum(axis=1) / bulk.counts[:, None], dtype=float)
