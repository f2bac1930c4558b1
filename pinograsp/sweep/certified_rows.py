"""Blocks of grasps on their way to workers, and what these make of them."""

from __future__ import annotations

import functools
import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinograsp.certification import Certifier, Commands, Protocol
from pinograsp.checks import one_line
from pinograsp.data import GraspRows, place_hand
from pinograsp.errors import ExtraMissing, PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.objects.lookup import object_in
from pinograsp.spatial import Array, IntArray
from pinograsp.sweep.certified_table import Block, Fault, RowSource, certified_table, refused_table
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
    protocol: Protocol | None
    commanded: bool


def place_block(grasps: GraspRows, rows: IntArray, hand: HandModel, **meant: Any) -> Block:
    """Grasps for a hand.

    Args:
        grasps: as they were read, of one size of the object.
        rows: their numbers in the file (N,).
        hand: of one joint, where the file gives none: jaws that are to close.
        meant: as for :func:`~pinograsp.data.place_hand`.

    Raises:
        InvalidInput: they are not of this hand.
    """
    closing = hand.n == 1 and not grasps.q.shape[1]
    at = {hand.joint_names[0]: float(hand.resting[0])} if closing else None
    poses, q = place_hand(grasps, hand, at=at, **meant)
    stages = None if grasps.squeeze_q is None or closing else _place_stages(grasps, hand, (poses, q), meant)
    return Block(
        rows=rows,
        object_name=object_named(grasps),
        scale=float(grasps.scale[0]),
        object_pose=np.eye(4) if grasps.object_pose is None else np.asarray(grasps.object_pose),
        poses=poses,
        q=None if closing else q,
        labels={name: np.asarray(values) for name, values in grasps.labels.items()},
        commanded_poses=None if stages is None else np.stack([poses for poses, _ in stages], axis=1),
        commanded_q=None if stages is None else np.stack([q for _, q in stages], axis=1),
    )


def _place_stages(
    grasps: GraspRows, hand: HandModel, placed: tuple[Array, Array], meant: dict[str, Any]
) -> list[tuple[Array, Array]]:
    """What a file commands, before the grasp, in it, where it is ``placed``, and after: poses (N, 4, 4), q (N, n)."""
    before = [] if grasps.pregrasp_q is None else [place_hand(grasps.at("pregrasp"), hand, **meant)]
    return [*before, placed, place_hand(grasps.at("squeeze"), hand, **meant)]


def object_named(rows: GraspRows) -> str:
    """The object's name; of a file that names none, that of the file."""
    return rows.object_name or Path(rows.source).stem


def certified_block(payload: bytes, source: RowSource, block: Block | Fault) -> pa.Table:
    """The rows of a block, or of a fault.

    Raises:
        ExtraMissing: an extra that is needed is not installed.
    """
    if isinstance(block, Fault):
        return refused_table(source, block)
    try:
        object_is = block.object_name, source.object_content, block.scale, block.object_pose.tobytes()
        certifier = _certifier(payload, *object_is)
        roots = block.object_pose @ block.poses
        commands = None
        if block.commanded_q is not None and block.commanded_poses is not None:
            commands = Commands(block.commanded_q, block.object_pose @ block.commanded_poses)
        found = certifier.jaws(roots) if block.q is None else certifier(block.q, roots, commands)
    except ExtraMissing:
        raise
    except Exception as error:  # one file must not end the certification of the others
        return refused_table(source, Fault(int(block.rows[0]), fault_of(error)))
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
    return Certifier(
        given.hand,
        body,
        given.conditions,
        tolerance=given.tolerance,
        drives=given.drives,
        protocol=given.protocol,
        commanded=given.commanded,
        threads=1,
    )


@functools.lru_cache(maxsize=1)
def _load(payload: bytes) -> Prepared:
    given: Prepared = pickle.loads(payload)  # this program's own
    return given
