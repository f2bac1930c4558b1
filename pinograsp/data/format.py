"""What a format of a data set is: how its files are told, read and written, and what they mean."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import brief
from pinograsp.data.files import File
from pinograsp.data.rows import Draft, GraspRows

UNIT = {"force_unit": "N", "force_frame": "object"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """What is written besides the grasps themselves.

    Attributes:
        labels: {name: (N,)}.
        extras: {name: (N, ...)}.
        texts: the forces' unit and frame, where there are forces.
    """

    labels: dict[str, NDArray[Any]]
    extras: dict[str, NDArray[Any]]
    texts: dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Format:
    """The file format of a data set's grasps.

    Attributes:
        name: of the format.
        container: the kind of file, see :attr:`~pinograsp.data.files.File.container`.
        sniff: whether a file of that kind is of this format.
        read: reads the grasps of a file, part by part.
        write: makes the file of grasps and the additional values; :class:`~pinograsp.errors.InvalidInput` if the format
            cannot hold them.
        keys: names that the format uses, which no label may have.
        single: whether a file has one grasp.
        named: whether a file names the joints.
        scales: whether each grasp has its own scale of the object.
        convention: from rows the name of their :class:`~pinograsp.data.conventions.Convention`, if the file determines
            it.
        ask: what to give otherwise, in words.
        reach: label with the distance of the hand's actual frame along x from ``poses`` [m].
    """

    name: str
    container: str
    sniff: Callable[[File], bool]
    read: Callable[[File], Iterator[Draft]]
    write: Callable[[GraspRows, Payload], bytes]
    keys: tuple[str, ...]
    single: bool = False
    named: bool = False
    scales: bool = False
    convention: Callable[[GraspRows], str | None] = lambda rows: None
    ask: str = ""
    reach: str = ""

    __repr__ = brief("name", "container")


def by_joint(conventions: Mapping[str, str]) -> Callable[[GraspRows], str | None]:
    """The convention of rows by a joint that tells it, ``{joint: convention}``."""
    return lambda rows: next((one for joint, one in conventions.items() if joint in rows.joint_names), None)


def npy_bytes(value: Any) -> bytes:
    """An .npy file of plain dicts, lists and arrays, as ``numpy.save`` writes it."""
    array = np.empty(len(value) if isinstance(value, list) else (), dtype=object)
    if isinstance(value, list):
        array[:] = value
    else:
        array[()] = value
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()
