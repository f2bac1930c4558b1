"""Blocks of grasps on their way to workers, and what these make of them."""

from __future__ import annotations

import functools
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinograsp.certification import Certifier
from pinograsp.checks import one_line
from pinograsp.data import GraspRows, place_hand
from pinograsp.errors import ExtraMissing, PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.objects.lookup import object_in
from pinograsp.sweep.certified_table import Block, RowSource, certified_table, refused_table
from pinograsp.words import printable

if TYPE_CHECKING:
    import pyarrow as pa

_LONGEST = 1000  # characters of the message of a fault
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


def blocks_of(rows: GraspRows, hand: HandModel, **meant: Any) -> Iterator[Block]:
    """The rows for a hand, those of each size of the object for themselves.

    Args:
        rows: as they were read.
        hand: of one joint, where the file gives none: jaws that are to close.
        meant: as for :func:`~pinograsp.data.place_hand`.

    Raises:
        InvalidInput: they are not of this hand.
    """
    closing = hand.n == 1 and not rows.q.shape[1]
    at = {hand.joint_names[0]: float(hand.resting[0])} if closing else None
    poses, q = place_hand(rows, hand, at=at, **meant)
    pose = np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose)
    for scale in np.unique(rows.scale):
        own = np.flatnonzero(rows.scale == scale)
        yield Block(
            rows=rows.first + own,
            object_name=object_named(rows),
            scale=float(scale),
            object_pose=pose,
            poses=poses[own],
            q=None if closing else q[own],
            labels={name: np.asarray(values)[own] for name, values in rows.labels.items()},
        )


def object_named(rows: GraspRows) -> str:
    """The object's name; of a file that names none, that of the file."""
    return rows.object_name or Path(rows.source).stem


def certified_block(payload: bytes, source: RowSource, block: Block | None, message: str) -> pa.Table:
    """The rows of a block, or of the fault that a message tells.

    Raises:
        ExtraMissing: an extra that is needed is not installed.
    """
    if block is None:
        return refused_table(source, message)
    try:
        object_is = block.object_name, source.object_content, block.scale, block.object_pose.tobytes()
        certifier = _certifier(payload, *object_is)
        roots = block.object_pose @ block.poses
        found = certifier.jaws(roots) if block.q is None else certifier(block.q, roots)
    except ExtraMissing:
        raise
    except Exception as error:  # one file must not end the certification of the others
        return refused_table(source, fault_of(error))
    return certified_table(source, block, found)


def fault_of(error: Exception) -> str:
    """An error as the message of a file that could not be used."""
    return printable(str(error) if isinstance(error, PinograspError) else one_line(error), _LONGEST)


@functools.lru_cache(maxsize=_PREPARED)
def _certifier(payload: bytes, name: str, content: str, scale: float, pose: bytes) -> Certifier:
    """What certifies grasps of an object; ``content``: of its files, which are read again where it is another."""
    given = _load(payload)
    body = object_in(given.objects, name, scale=scale, mass=given.mass, density=given.density)
    body = body.placed(np.frombuffer(pose).reshape(4, 4) @ body.pose)
    return Certifier(given.hand, body, given.conditions, tolerance=given.tolerance, drives=given.drives, threads=1)


@functools.lru_cache(maxsize=1)
def _load(payload: bytes) -> Prepared:
    given: Prepared = pickle.loads(payload)  # this program's own
    return given
