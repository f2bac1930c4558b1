"""The bytes of a file of grasps, and what kind of container they are."""

from __future__ import annotations

import io
import os
import stat
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np

from pinograsp.checks import one_line, path_of
from pinograsp.data.pickled import PickleRefused, Unpickled
from pinograsp.errors import GraspsNotRead

LARGEST = 2**29  # [bytes] of a file that is read at once
_LARGEST_TEXT = 2**26  # of JSON or YAML, which grow when they are taken apart


def header_of(stream: IO[bytes], version: tuple[int, int]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type of an .npy file; headers of other versions than 1 may be of any length, and are refused."""
    if version != (1, 0):
        raise ValueError(f"expected an .npy file of version 1, got {version[0]}")
    return np.lib.format.read_array_header_1_0(stream)


class File:
    """A file that is there; its parts are read when they are asked for."""

    def __init__(self, path: str | Path):
        self.path = path_of("path", path)
        self.source = str(self.path)
        try:
            if not os.path.lexists(self.path):
                raise GraspsNotRead(self.source, "no such file")
            status = self.path.stat()
            if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting, a device might never end
                kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, a device or a socket"
                raise GraspsNotRead(self.source, f"expected a file, got {kind}")
            self.size = status.st_size
            with open(self.path, "rb") as stream:
                self.head = stream.read(4096)
        except (OSError, ValueError) as error:
            if isinstance(error, GraspsNotRead):
                raise
            raise GraspsNotRead(self.source, one_line(error)) from error
        if not self.size:
            raise GraspsNotRead(self.source, "the file is empty: was it copied completely?")

    @cached_property
    def content(self) -> bytes:
        """All bytes, of a file that is not too large."""
        if self.size > LARGEST:
            raise GraspsNotRead(self.source, f"expected at most {LARGEST} bytes, got {self.size}: split it")
        try:
            return self.path.read_bytes()
        except OSError as error:
            raise GraspsNotRead(self.source, one_line(error)) from error

    @property
    def text(self) -> bytes:
        """All bytes of a text."""
        if self.size > _LARGEST_TEXT:
            raise GraspsNotRead(
                self.source, f"expected at most {_LARGEST_TEXT} bytes of text, got {self.size}: split it"
            )
        return self.content

    @cached_property
    def pickled(self) -> tuple[Any, str | None]:
        """What an .npy file of objects holds: a list of rows, or one object; and what is wrong after these rows."""
        stream = io.BytesIO(self.content)
        try:
            version = np.lib.format.read_magic(stream)
            shape, _, dtype = header_of(stream, version)
        except Exception as error:  # the header is a text that NumPy takes apart
            raise GraspsNotRead(self.source, f"the .npy file is broken or cut off ({one_line(error)})") from error
        if dtype.kind != "O":
            raise GraspsNotRead(
                self.source,
                f"expected an .npy file with dicts in it, got numbers ({dtype}): no format of grasps known here",
            )
        try:
            value = Unpickled(stream.read()).value
        except PickleRefused as refusal:
            if not refusal.rows or shape == ():
                raise GraspsNotRead(self.source, str(refusal)) from None
            return refusal.rows, str(refusal)
        if isinstance(value, np.ndarray):
            value = value.item() if value.ndim == 0 else list(value.ravel())
        return value, None
