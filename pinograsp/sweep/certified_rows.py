"""Blocks of grasps on their way to workers, and what these make of them."""

from __future__ import annotations

import functools
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinograsp.certification import Certifier
from pinograsp.data import GraspRows, placed
from pinograsp.errors import PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.objects.lookup import object_in
from pinograsp.spatial import Array, IntArray
from pinograsp.sweep.certified_table import certified_table, refused_table

if TYPE_CHECKING:
    import pyarrow as pa

_PREPARED = 8  # objects that a worker keeps: a file has up to five sizes of one


class Prepared(NamedTuple):
    """What all blocks have in common."""

    hand: HandModel
    objects: Path
    mass: float | None
    density: float | None
    conditions: GraspConditions
    tolerance: float
    drives: bool


class Block(NamedTuple):
    """Grasps of one object.

    Attributes:
        rows: their numbers in the file (N,).
        object_name: as the file has it.
        scale: of the object's mesh.
        object_pose: oMb (4, 4), of the object in a world whose gravity is meant.
        poses: bMh (N, 4, 4), of the hand's root in the object's frame.
        q: positions of the joints (N, n); None: of jaws that are to close.
        labels: the file's own numbers of each, {name: (N,)}.
    """

    rows: IntArray
    object_name: str
    scale: float
    object_pose: Array
    poses: Array
    q: Array | None
    labels: dict[str, Array]


def blocks_of(rows: GraspRows, hand: HandModel, **meant: Any) -> Iterator[Block]:
    """The rows for a hand, those of each size of the object for themselves.

    Args:
        rows: as they were read.
        hand: of one joint, where the file gives none: jaws that are to close.
        meant: as for :func:`~pinograsp.data.placed`.

    Raises:
        InvalidInput: they are not of this hand.
    """
    closing = hand.n == 1 and not rows.q.shape[1]
    at = {hand.joint_names[0]: float(hand.resting[0])} if closing else None
    poses, q = placed(rows, hand, at=at, **meant)
    pose = np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose)
    for scale in np.unique(rows.scale):
        own = np.flatnonzero(rows.scale == scale)
        yield Block(
            rows=rows.first + own,
            object_name=rows.object_name,
            scale=float(scale),
            object_pose=pose,
            poses=poses[own],
            q=None if closing else q[own],
            labels={name: np.asarray(values)[own] for name, values in rows.labels.items()},
        )


def certified_block(payload: bytes, file: str, block: Block | None, message: str) -> pa.Table:
    """The rows of a block, or of the fault that a message tells."""
    if block is None:
        return refused_table(file, message)
    try:
        certifier = _certifier(payload, block.object_name, block.scale, block.object_pose.tobytes())
        roots = block.object_pose @ block.poses
        found = certifier.jaws(roots) if block.q is None else certifier(block.q, roots)
    except PinograspError as error:
        return refused_table(file, str(error))
    return certified_table(file, block.rows, block.object_name, block.scale, block.object_pose, found, block.labels)


@functools.lru_cache(maxsize=_PREPARED)
def _certifier(payload: bytes, name: str, scale: float, pose: bytes) -> Certifier:
    given = _given(payload)
    body = object_in(given.objects, name, scale=scale, mass=given.mass, density=given.density)
    body = body.placed(np.frombuffer(pose).reshape(4, 4) @ body.pose)
    return Certifier(given.hand, body, given.conditions, tolerance=given.tolerance, drives=given.drives, threads=1)


@functools.lru_cache(maxsize=1)
def _given(payload: bytes) -> Prepared:
    given: Prepared = pickle.loads(payload)  # this program's own
    return given
