"""The bytes of a file of grasps, and what kind of container they are."""

from __future__ import annotations

import io
import itertools
import os
import stat
import zipfile
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from pinograsp.checks import one_line, path_of
from pinograsp.data.keys import Keys
from pinograsp.data.pickled import PickleRefused, Unpickled
from pinograsp.errors import GraspsNotRead

Keep = Literal["valid", "all"]

LARGEST = 2**29  # [bytes] of a file that is read at once
_LARGEST_TEXT = 2**26  # of JSON or YAML, which grow when they are taken apart


def header_of(stream: IO[bytes], version: tuple[int, int]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type of an .npy file; headers of other versions than 1 may be of any length, and are refused."""
    if version != (1, 0):
        raise ValueError(f"expected an .npy file of version 1, got {version[0]}")
    return np.lib.format.read_array_header_1_0(stream)


class File:
    """A file that is there; its parts are read when they are asked for.

    Args:
        path: the file.
        block: grasps that are wanted at once, of formats that are read a part at a time.
        keep: as for :func:`~pinograsp.data.read_grasps`.
    """

    def __init__(self, path: str | Path, *, block: int = 1024, keep: Keep = "valid"):
        self.path = path_of("path", path)
        self.block, self.keep = block, keep
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

    @property
    def container(self) -> str:
        """What kind of file it is, by its first bytes."""
        if self.head.startswith(b"\x93NUMPY"):
            return "an .npy file"
        if self.head.startswith(b"\x89HDF\r\n\x1a\n"):
            return "an HDF5 file"
        if self.head.startswith(b"PK"):
            return "a ZIP archive"
        if self.head.startswith(b"\x80"):
            return "a bare pickle (of PyTorch before 1.6, perhaps: load it with torch there, and save it again)"
        head = self.head.lstrip(b"\xef\xbb\xbf")
        return "text" if b"\0" not in head and head.strip() else "something unknown"

    def describe(self) -> str:
        """What is in it, for messages."""
        if self.container == "a ZIP archive":
            return f"a ZIP archive of {', '.join(self.members[:6])}"[:200]
        if self.container != "an .npy file":
            return self.container
        value = self.pickled[0]
        if not isinstance(value, dict):
            return f"an .npy file with a {type(value).__name__} in it"
        return f"a dict with the keys {', '.join(str(key)[:40] for key in itertools.islice(value, 10)) or '(none)'}"

    @cached_property
    def members(self) -> list[str]:
        """Names of the files in an archive."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.namelist()
        except Exception as error:  # zipfile raises whatever comes of a broken file
            raise GraspsNotRead(self.source, f"the ZIP archive is broken or cut off ({error})") from error

    def has(self, name: str) -> bool:
        """Whether an .npy file holds a dict with this key."""
        value = self.pickled[0]
        return isinstance(value, dict) and name in value

    def keys(self, format: str) -> Keys:
        """The dict that an .npy file holds."""
        return Keys(self.source, self.pickled[0], format)

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
