"""ACRONYM: an HDF5 file. Needs h5py (extra ``data``).

Layout as of the examples of NVlabs/acronym: ``object/file``, ``object/scale``, ``object/mass`` [kg], ``com`` [m],
``inertia``, ``density``, ``friction``, ``volume``; ``grasps/transforms`` (N, 4, 4) of the gripper in the object's frame
(fingers close along x, and reach along z); ``grasps/qualities/flex/*`` (N,) from a simulation; ``gripper/type``.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import one_line
from pinograsp.data.files import LARGEST, File
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.data.written import Payload
from pinograsp.errors import ExtraMissing, GraspsNotRead
from pinograsp.spatial import Array

_TRANSFORMS = "grasps/transforms"
_QUALITIES = "grasps/qualities/flex"
_EXTRAS = "grasps/"
_FACTS = ("mass", "com", "inertia", "density", "friction", "volume")
_MOST_FACTS = 100  # numbers of each
_DENSEST = 1000  # times that placements may shrink in a file


def _h5py() -> ModuleType:
    try:
        import h5py
    except ImportError as error:
        raise ExtraMissing(f"ACRONYM's files need h5py: pip install 'pinograsp[data]' ({error})") from error
    module: ModuleType = h5py
    return module


def read(file: File, block: int) -> Iterator[Draft]:
    """The grasps of a file, a block at a time."""
    h5py = _h5py()
    try:
        opened = h5py.File(file.path, "r")
    except Exception as error:  # HDF5 raises what it finds
        raise GraspsNotRead(file.source, f"acronym: the HDF5 file is broken or cut off ({one_line(error)})") from error
    with opened as h5:
        try:
            reader = _Reader(h5py, h5, file.source)
            for begin in range(0, reader.count, block):
                yield reader.rows(begin, min(begin + block, reader.count))
        except GraspsNotRead:
            raise
        except (OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
            raise GraspsNotRead(file.source, f"acronym: the HDF5 file is broken ({one_line(error)})") from error


class _Reader:
    """An open file."""

    def __init__(self, h5py: ModuleType, h5: Any, source: str):
        self.h5py, self.h5, self.source = h5py, h5, source
        for name in (_TRANSFORMS, "object/file", "object/scale"):
            if not isinstance(self._at(name), h5py.Dataset):
                raise GraspsNotRead(source, f"acronym: expected a dataset '{name}', got none")
        shape = self._at(_TRANSFORMS).shape
        if len(shape) != 3 or shape[1:] != (4, 4):
            raise GraspsNotRead(source, f"acronym: '{_TRANSFORMS}': expected the shape (N, 4, 4), got {shape}")
        self.count: int = shape[0]
        if self.count * 128 > _DENSEST * os.path.getsize(source):
            raise GraspsNotRead(source, f"acronym: {self.count} grasps in a file of so few bytes: it is not read")
        self.name = self._text("object/file")
        self.scale = self._numbers("object/scale")
        if self.scale.size != 1:
            raise GraspsNotRead(source, f"acronym: 'object/scale': expected a number, got {self.scale.size}")
        self.gripper = self._text("gripper/type") if "gripper/type" in h5 else ""
        self.facts = {name: self._numbers(f"object/{name}") for name in _FACTS if f"object/{name}" in h5}

    def _at(self, name: str) -> Any:
        """What stands there, if it is in this very file: links to other files are not followed."""
        at = self.h5
        for part in name.split("/"):
            if not isinstance(at, self.h5py.Group) or part not in at:
                return None
            if not isinstance(at.get(part, getlink=True), self.h5py.HardLink):
                raise GraspsNotRead(self.source, f"acronym: '{name}' is a link to elsewhere, which is not followed")
            at = at[part]
        if isinstance(at, self.h5py.Dataset) and at.external:
            raise GraspsNotRead(self.source, f"acronym: '{name}' lies in another file, which is not read")
        return at

    def _text(self, name: str) -> str:
        data = self._at(name)
        value = data[()] if isinstance(data, self.h5py.Dataset) and data.shape == () else None
        try:
            text = value.decode("utf-8") if isinstance(value, bytes) else value
        except UnicodeDecodeError:
            text = None
        if not isinstance(text, str):
            raise GraspsNotRead(self.source, f"acronym: '{name}': expected a text")
        return text

    def _numbers(self, name: str, part: slice | None = None) -> Array:
        data = self._at(name)
        numeric = isinstance(data, self.h5py.Dataset) and data.dtype.kind in "fiub"
        if not numeric or (part is None and data.size > _MOST_FACTS):
            raise GraspsNotRead(self.source, f"acronym: '{name}': expected numbers")
        return np.asarray(data[()] if part is None else data[part], dtype=float)

    def rows(self, begin: int, end: int) -> Draft:
        """The grasps from ``begin`` to before ``end``."""
        part = slice(begin, end)
        labels: dict[str, NDArray[Any]] = {}
        extras: dict[str, NDArray[Any]] = {}
        for folder in (_QUALITIES, _EXTRAS.strip("/")):
            group = self._at(folder)
            for name in group if isinstance(group, self.h5py.Group) else ():
                data = self._at(f"{folder}/{name}")
                if f"{folder}/{name}" == _TRANSFORMS or not isinstance(data, self.h5py.Dataset):
                    continue
                if data.dtype.kind in "fiub" and data.shape[:1] == (self.count,):
                    if data.size // max(self.count, 1) * 8 * (end - begin) > LARGEST:
                        raise GraspsNotRead(self.source, f"acronym: '{folder}/{name}': too many numbers a grasp")
                    (labels if data.ndim == 1 else extras)[name] = np.asarray(data[part])
        count = end - begin
        return Draft(
            poses=self._numbers(_TRANSFORMS, part),
            q=np.zeros((count, 0)),
            scale=np.full(count, self.scale.ravel()[0]),
            object_name=self.name,
            hand_name=self.gripper,
            labels=labels,
            extras=extras,
            object_facts=self.facts,
        )


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; forces are datasets beside the transforms."""
    h5py = _h5py()
    stream = io.BytesIO()
    with h5py.File(stream, "w") as h5:
        h5["object/file"] = rows.object_name
        h5["object/scale"] = float(rows.scale[0]) if rows.n else 1.0
        for name, array in rows.object_facts.items():
            h5[f"object/{name}"] = np.array(array)
        h5["gripper/type"] = rows.hand_name
        h5[_TRANSFORMS] = np.array(rows.poses)
        for name, array in payload.labels.items():
            h5[f"{_QUALITIES}/{name}"] = np.array(array)
        for name, array in payload.extras.items():
            h5[f"{_EXTRAS}{name}"] = np.array(array)
        for name, text in payload.texts.items():
            h5[f"{_EXTRAS}contact_force"].attrs[name] = text
    return stream.getvalue()
