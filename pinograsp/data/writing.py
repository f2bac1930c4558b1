"""Grasps written back in the formats they came in, with newtons."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp.checks import array_of, items_of, mapping_of, one_of, read_only
from pinograsp.data.format import UNIT, Format, Payload
from pinograsp.data.formats import FORMATS
from pinograsp.data.keys import as_numbers
from pinograsp.data.rows import EACH_ROW, GraspRows
from pinograsp.errors import InvalidInput
from pinograsp.writing import write_file

_FORCES, _POINTS = "contact_force", "contact_point"
_NAME = re.compile(r"[A-Za-z][\w-]{0,99}")
# Of the formats, and what is written with forces.
_RESERVED = {_FORCES, _POINTS, *UNIT, *(key for kind in FORMATS.values() for key in kind.keys)}


def write_grasps(
    path: str | Path,
    rows: GraspRows | Iterable[GraspRows],
    *,
    format: str | None = None,
    forces: ArrayLike | None = None,
    points: ArrayLike | None = None,
    labels: Mapping[str, ArrayLike] | None = None,
) -> Path:
    """Write grasps in a data set's own format, completely or not at all, and return the path.

    Grasps that were read from a file are written so that reading returns equal ones; keys of the file without numbers
    for each row are not kept. Forces are stored under ``contact_force``, with ``force_unit: N`` and ``force_frame:
    object``, points under ``contact_point``.

    Args:
        path: the new file; an old one is replaced.
        rows: the grasps (N), also in blocks as :func:`read_grasps` yields them, all of one object and hand.
        format: a name of :data:`~pinograsp.data.FORMATS`; None: the format in which they were read.
        forces: on the object, in the object's frame b (N, k, 3) [N].
        points: their points of application, in the same frame (N, k, 3) [m].
        labels: further numbers of each grasp, {name: (N,)}; they replace labels of the same name.

    Raises:
        InvalidInput: a format that cannot hold these grasps: GraspNet's labels are a grid, those of DexGraspBench and
            Dexonomy have one grasp a file.
        ResultsNotWritten: the file cannot be written.
        ExtraMissing: ACRONYM's file without h5py (extra ``data``).
    """
    rows = join_rows(rows)
    kind = FORMATS[one_of("format", rows.format if format is None else format, FORMATS)]
    _check(rows, kind)
    payload = _payload(rows, forces, points, {} if labels is None else labels)
    return write_file(path, kind.write(rows, payload))


def join_rows(rows: GraspRows | Iterable[GraspRows]) -> GraspRows:
    """Join blocks of one file into one record.

    Raises:
        InvalidInput: no blocks, or grasps of different files.
    """
    if isinstance(rows, GraspRows):
        return rows
    blocks = items_of("rows", rows, GraspRows)
    if not blocks:
        raise InvalidInput("rows: expected grasps, got none")
    head = blocks[0]
    for one in blocks[1:]:
        for name in ("format", "object_name", "hand_name", "joint_names"):
            if getattr(one, name) != getattr(head, name):
                raise InvalidInput(f"rows: expected grasps of one file, got different {name}")
    if len(blocks) == 1:
        return head
    arrays: dict[str, Any] = {
        name: read_only(np.concatenate([getattr(one, name) for one in blocks]))
        for name in EACH_ROW
        if all(getattr(one, name) is not None for one in blocks)
    }
    tables: dict[str, Any] = {
        table: {
            key: read_only(np.concatenate([getattr(one, table)[key] for one in blocks]))
            for key in getattr(head, table)
            if all(key in getattr(one, table) for one in blocks)
        }
        for table in ("labels", "extras")
    }
    return replace(head, **arrays, **tables)


def _check(rows: GraspRows, kind: Format) -> None:
    if kind.single and rows.n != 1:
        raise InvalidInput(f"format: {kind.name} has one grasp a file, got {rows.n}: write each to a file of its own")
    if kind.named and len(rows.joint_names) != rows.q.shape[1]:
        raise InvalidInput(
            f"format: {kind.name} names the joints, which the file of format {rows.format} does not: "
            "dataclasses.replace(rows, joint_names=...) gives them"
        )
    if not kind.scales and len(set(rows.scale.tolist())) > 1:
        raise InvalidInput(
            f"format: {kind.name} has one scale a file, got grasps of several: write each scale on its own"
        )


def _payload(
    rows: GraspRows, forces: ArrayLike | None, points: ArrayLike | None, labels: Mapping[str, ArrayLike]
) -> Payload:
    table: dict[str, NDArray[Any]] = dict(rows.labels)
    for name, values in mapping_of("labels", labels).items():
        if name in _RESERVED or not _NAME.fullmatch(name):
            raise InvalidInput(
                f"labels: expected a name of letters, digits, '_', '-', that no format uses, got '{name}'"
            )
        array = as_numbers(np.asarray(values))
        if array is None or array.shape != (rows.n,) or not np.isfinite(array).all():
            raise InvalidInput(f"labels: '{name}': expected {rows.n} finite numbers or truth values")
        table[name] = array
    extras: dict[str, NDArray[Any]] = dict(rows.extras)
    if forces is None:
        if points is not None:
            raise InvalidInput("points: expected forces with them")
        return Payload(labels=table, extras=extras, texts={})
    extras[_FORCES] = array_of("forces", forces, (rows.n, None, 3))
    extras.pop(_POINTS, None)
    if points is not None:
        extras[_POINTS] = array_of("points", points, extras[_FORCES].shape)
    return Payload(labels=table, extras=extras, texts=dict(UNIT))
