"""The table of certified grasps: its columns, and how certificates fill them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinograsp.certification import Certificates
from pinograsp.errors import Status
from pinograsp.spatial import Array, BoolArray, IntArray

if TYPE_CHECKING:
    import pyarrow as pa

REFUSED = "refused"  # of a file, from some row on


def schema_of() -> pa.Schema:
    """The columns; lists have an entry for each contact, or three numbers."""
    import pyarrow as pa

    whole, text, real, numbers = pa.int64(), pa.string(), pa.float64(), pa.list_(pa.float64())
    return pa.schema(
        [
            ("file", text),
            ("row", whole),
            ("object", text),
            ("scale", real),
            ("reason", text),
            ("code", pa.int16()),
            ("message", text),
            ("contacts", whole),
            ("links", pa.list_(text)),
            ("points_m", numbers),
            ("normals", numbers),
            ("gaps_m", numbers),
            ("forces_N", numbers),
            ("normal_forces_N", numbers),
            ("torques_Nm", numbers),
            ("reserve", real),
            ("weakest", numbers),
            ("least_mu", real),
            ("antipodal_mu", real),
            ("largest_load_N", real),
            ("effort", real),
            ("producible", pa.bool_()),
            ("unproducible", real),
            ("depth_m", real),
            ("residual_N", real),
            ("possible", pa.bool_()),
            ("held_as_commanded", pa.bool_()),
            ("moved_m", real),
            ("turned_rad", real),
            ("pressed_N", numbers),
            ("labels", text),
            ("inputs", text),
        ]
    )


class Block(NamedTuple):
    """Grasps of one object.

    Attributes:
        rows: their numbers in the file (N,).
        object_name: as the file has it, or after which the file is called.
        scale: of the object's mesh.
        object_pose: oMb (4, 4), of the object in a world whose gravity is meant.
        poses: bMh (N, 4, 4), of the hand's root in the object's frame.
        q: positions of the joints (N, n); None: of jaws that are to close.
        commanded_poses, commanded_q: likewise before the grasp, in it and as commanded (N, s, 4, 4), (N, s, n); None:
            the file does not say what is commanded.
        labels: the file's own numbers of each, {name: (N,)}.
    """

    rows: IntArray
    object_name: str
    scale: float
    object_pose: Array
    poses: Array
    q: Array | None
    labels: dict[str, Array]
    commanded_poses: Array | None = None
    commanded_q: Array | None = None


class RowSource(NamedTuple):
    """Where rows come from.

    Attributes:
        file: of grasps.
        object_name: that they are of; None where the file was not read so far.
        content: digest of the file.
        object_content: digest of the object's files; "" without an object.
    """

    file: str
    object_name: str | None
    content: str
    object_content: str

    @property
    def inputs(self) -> str:
        """Both digests, as the table has them."""
        return f"{self.content} {self.object_content}".strip()


class Fault(NamedTuple):
    """Why a file, or a block of it, could not be used.

    Attributes:
        first: the first grasp that it is about.
        message: what it is.
    """

    first: int
    message: str

    @staticmethod
    def number(first: int) -> int:
        """Of a fault's row on disk, below 0: another one for each block, so that these are known. Readers see -1."""
        return -1 - first


def refused_table(source: RowSource, fault: Fault) -> pa.Table:
    """The row of a fault."""
    import pyarrow as pa

    row = {
        "file": source.file,
        "row": Fault.number(fault.first),
        "object": source.object_name,
        "reason": REFUSED,
        "code": -1,
        "message": fault.message,
        "inputs": source.inputs,
    }
    return pa.Table.from_pylist([row], schema=schema_of())


def certified_table(sources: Sequence[RowSource], blocks: Sequence[Block], found: Certificates) -> pa.Table:
    """The rows of the certificates of blocks of one object, in the frame of the object as its file has it."""
    import pyarrow as pa

    count, schema, block = len(found), schema_of(), blocks[0]
    each = [source for source, one in zip(sources, blocks) for _ in one.rows]
    used = np.arange(found.points_o.shape[1]) < found.counts[:, None]
    names = np.array(found.link_names, dtype=object)
    place, turn = block.object_pose[:3, 3], block.object_pose[:3, :3]
    columns: dict[str, Any] = {
        "file": [source.file for source in each],
        "row": np.concatenate([one.rows for one in blocks]),
        "object": [block.object_name] * count,
        "scale": np.full(count, block.scale),
        "reason": [str(Status.from_code(one)) for one in found.reason.tolist()],
        "code": found.reason,
        "message": [found.words(i) for i in range(count)],
        "contacts": found.counts,
        "links": _lists(names[found.links], used, 1),
        "points_m": _lists((found.points_o - place) @ turn, used, 3),
        "normals": _lists(found.normals_o @ turn, used, 3),
        "gaps_m": _lists(found.gaps, used, 1),
        "forces_N": _lists(found.forces_o @ turn, used, 3),
        "normal_forces_N": _lists(found.normal_forces, used, 1),
        "torques_Nm": _rows(found.torques),
        "reserve": found.reserve,
        "weakest": _rows((found.weakest.reshape(-1, 2, 3) @ turn).reshape(-1, 6)),
        "least_mu": found.least_mu,
        "antipodal_mu": found.antipodal_mu,
        "largest_load_N": found.largest_load,
        "effort": found.effort,
        "producible": found.producible,
        "unproducible": found.unproducible,
        "depth_m": found.depth,
        "residual_N": found.residual,
        "possible": found.possible,
        "held_as_commanded": pa.array(found.held_as_commanded, mask=~found.commanded),
        "moved_m": pa.array(found.moved, mask=~found.commanded),
        "turned_rad": pa.array(found.turned, mask=~found.commanded),
        "pressed_N": _rows(found.pressed),
        "labels": [
            json.dumps({name: np.asarray(values[i]).tolist() for name, values in one.labels.items()})
            for one in blocks
            for i in range(len(one.rows))
        ],
        "inputs": [source.inputs for source in each],
    }
    return pa.table({name: columns[name] for name in schema.names}, schema=schema)


def _lists(values: Array, used: BoolArray, width: int) -> pa.Array:
    """Lists of the entries that are used, of each row."""
    import pyarrow as pa

    offsets = np.concatenate([[0], np.cumsum(used.sum(axis=1) * width)]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values[used].ravel()))


def _rows(values: Array) -> pa.Array:
    """Lists of all entries of each row."""
    return _lists(values, np.ones(values.shape, dtype=bool), 1)
