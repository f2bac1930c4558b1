"""Blocks of grasps on their way to workers, and what these make of them."""

from __future__ import annotations

import functools
import pickle
from collections.abc import Iterable, Sequence
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

Work = tuple[RowSource, Block | Fault]  # and where its rows come from


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


def certify_blocks(payload: bytes, work: Sequence[Work]) -> pa.Table:
    """The rows of a fault, or of blocks that :func:`belong_together`, certified at once.

    Raises:
        ExtraMissing: an extra that is needed is not installed.
    """
    source, first = work[0]
    if isinstance(first, Fault):
        return refused_table(source, first)
    blocks = [block for _, block in work if isinstance(block, Block)]
    try:
        certifier = _certifier(payload, *_object_of(source, first))
        roots = first.object_pose @ _all(block.poses for block in blocks)
        if first.q is None:
            found = certifier.jaws(roots)
        else:
            commands = None
            if first.commanded_q is not None:
                told = _all(block.commanded_q for block in blocks)
                commands = Commands(told, first.object_pose @ _all(block.commanded_poses for block in blocks))
            found = certifier(_all(block.q for block in blocks), roots, commands)
    except ExtraMissing:
        raise
    except Exception as error:  # one file must not end the certification of the others
        if len(blocks) > 1:
            import pyarrow as pa

            return pa.concat_tables([certify_blocks(payload, [one]) for one in work])
        return refused_table(source, Fault(int(first.rows[0]), fault_of(error)))
    return certified_table([one for one, _ in work], blocks, found)


def belong_together(one: Work, other: Work) -> bool:
    """Whether two blocks are of one object in one place, and told alike what is commanded."""
    (source, block), (another, second) = one, other
    if isinstance(block, Fault) or isinstance(second, Fault):
        return False
    stages = [None if told.commanded_q is None else told.commanded_q.shape[1] for told in (block, second)]
    alike = (block.q is None) == (second.q is None) and stages[0] == stages[1]
    return alike and _object_of(source, block) == _object_of(another, second)


def _object_of(source: RowSource, block: Block) -> tuple[str, str, float, bytes]:
    """What :func:`_certifier` is asked for: the object's name, its content, its scale and its pose."""
    return block.object_name, source.object_content, block.scale, block.object_pose.tobytes()


def _all(parts: Iterable[Array | None]) -> Array:
    """Arrays one after the other."""
    return np.concatenate([one for one in parts if one is not None])


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
