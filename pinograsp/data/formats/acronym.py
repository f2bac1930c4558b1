"""ACRONYM: an HDF5 file. Needs h5py (extra ``data``).

Layout as of the examples of NVlabs/acronym: ``object/file``, ``object/scale``, ``object/mass`` [kg], ``com`` [m],
``inertia``, ``density``, ``friction``, ``volume``; ``grasps/transforms`` (N, 4, 4) of the gripper in the object's frame
(fingers close along x, and reach along z); ``grasps/qualities/flex/*`` (N,) from a simulation; ``gripper/type``.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import math
import struct
import subprocess
import sys
from collections.abc import Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import shorten
from pinograsp.data import hdf5_child
from pinograsp.data.files import LARGEST, File
from pinograsp.data.format import Format, Payload
from pinograsp.data.keys import NAME, is_name
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.errors import ExtraMissing, GraspsNotRead
from pinograsp.words import printable


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file, a block at a time."""
    _expect_h5py()
    command = [sys.executable, hdf5_child.__file__, str(file.path.absolute()), str(file.block)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL
    ) as child:
        try:
            assert child.stdout is not None
            frames = _Frames(file, child, child.stdout)
            about = frames.document()
            for begin in range(0, about["count"], file.block):
                yield _draft(about, frames, min(file.block, about["count"] - begin))
        finally:
            with contextlib.suppress(OSError):
                child.kill()


def _expect_h5py() -> None:
    if importlib.util.find_spec("h5py") is None:
        raise ExtraMissing("ACRONYM's files need h5py: pip install 'pinograsp[data]'")


class _Frames:
    """What the child writes; its end before it is complete is a crash, or its own word that the file is broken."""

    def __init__(self, file: File, child: subprocess.Popen[bytes], stream: IO[bytes]):
        self._file, self._child, self._stream = file, child, stream

    def _refusal(self, problem: str) -> GraspsNotRead:
        return GraspsNotRead(self._file.source, f"acronym: {problem}")

    def _bytes(self, size: int) -> bytes:
        content = self._stream.read(size)
        if len(content) < size:
            code = self._child.wait()
            raise self._refusal(f"the HDF5 file is broken: its reader stopped (exit code {code})")
        return content

    def _frame(self) -> bytes:
        (size,) = struct.unpack("<Q", self._bytes(8))
        if size > LARGEST:
            raise self._refusal(f"expected at most {LARGEST} bytes a block, got {size}: give a smaller block=")
        return self._bytes(size)

    def document(self) -> dict[str, Any]:
        """The first frame."""
        document: dict[str, Any] = json.loads(self._frame())
        if "refused" in document:
            raise self._refusal(document["refused"])
        for key in ("object", "gripper"):
            if not is_name(document[key]):
                raise self._refusal(f"name of the {key}: expected {NAME}, got {shorten(document[key])}")
        return document

    def column(self, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """The next frame, as an array."""
        content = self._frame()
        dtype = np.dtype(kind)
        if len(content) != math.prod(shape) * dtype.itemsize:
            document = json.loads(content) if content.startswith(b'{"refused"') else {}
            raise self._refusal(document.get("refused", "the HDF5 file is broken"))
        return np.frombuffer(content, dtype=dtype).reshape(shape)


def _draft(about: dict[str, Any], frames: _Frames, count: int) -> Draft:
    poses = np.zeros((0, 4, 4))
    labels: dict[str, NDArray[Any]] = {}
    extras: dict[str, NDArray[Any]] = {}
    for path, kind, shape in about["columns"]:
        array = frames.column(kind, (count, *shape))
        if path == hdf5_child.TRANSFORMS:
            poses = np.asarray(array, dtype=float)
        else:
            (extras if shape else labels)[printable(path.rpartition("/")[2])] = array
    facts = {name: np.reshape(np.array(one), about["shapes"][name]) for name, one in about["facts"].items()}
    return Draft(
        poses=poses,
        q=np.zeros((count, 0)),
        scale=np.full(count, about["scale"]),
        object_name=about["object"],
        hand_name=about["gripper"],
        labels=labels,
        extras=extras,
        object_facts=facts,
    )


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; forces are datasets beside the transforms."""
    _expect_h5py()
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as h5:
        h5["object/file"] = rows.object_name
        h5["object/scale"] = float(rows.scale[0]) if rows.n else 1.0
        for name, array in rows.object_facts.items():
            h5[f"object/{name}"] = np.array(array)
        h5["gripper/type"] = rows.hand_name
        h5[hdf5_child.TRANSFORMS] = np.array(rows.poses)
        for name, array in payload.labels.items():
            h5[f"{hdf5_child.QUALITIES}/{name}"] = np.array(array)
        for name, array in payload.extras.items():
            h5[f"{hdf5_child.GRASPS}/{name}"] = np.array(array)
        for name, text in payload.texts.items():
            h5[f"{hdf5_child.GRASPS}/contact_force"].attrs[name] = text
    return stream.getvalue()


FORMAT = Format(
    name="acronym",
    container="an HDF5 file",
    sniff=lambda file: True,
    read=read,
    write=write,
    keys=("transforms", "qualities"),
    convention=lambda rows: "panda_graspgen" if rows.hand_name == "panda" else None,
)
