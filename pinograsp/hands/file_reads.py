"""Which files something was made of, and with what content, so that it is made again when one of them changes."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Generic, TypeVar

_Made = TypeVar("_Made")

ABSENT = ""  # in place of the digest of a file that was looked for in vain
_CHUNK = 2**20  # [bytes]
# [ns] from a file's last change to when its status tells any further one: clocks of file systems tick in up to 10 ms,
# those of old or remote ones in 2 s.
_SETTLED = 2_000_000_000

_noted: ContextVar[tuple[dict[str, str], ...]] = ContextVar("_noted", default=())


@contextlib.contextmanager
def noting_files() -> Iterator[dict[str, str]]:
    """The files that are read meanwhile by hands and objects, ``{path: SHA-256}``; :data:`ABSENT` for those that are
    looked for and not there.
    """
    files: dict[str, str] = {}
    token = _noted.set((*_noted.get(), files))
    try:
        yield files
    finally:
        _noted.reset(token)


def note_files(files: Mapping[str, str]) -> None:
    """Note files as read with these digests."""
    for noted in _noted.get():
        noted.update(files)


def note_content(path: Path, content: bytes) -> None:
    """Note a file as read with this content."""
    if _noted.get():
        note_files({os.path.abspath(path): hashlib.sha256(content).hexdigest()})


def is_there(path: str | Path) -> bool:
    """Whether a path is that of a file; noted where it is none."""
    if os.path.isfile(path):
        return True
    note_files({os.path.abspath(path): ABSENT})
    return False


def digest_of(path: str | Path) -> str:
    """SHA-256 of a regular file's content, computed once for each change of it; noted as read.

    Raises:
        OSError: it cannot be read, or is no regular file.
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"{path} is not a regular file")
    state = (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino, status.st_dev)
    place = os.path.abspath(path)
    settled = time.time_ns() - max(status.st_ctime_ns, status.st_mtime_ns) > _SETTLED
    digest = _known_digest(place, state) if settled else _hash(place)
    note_files({place: digest})
    return digest


@functools.lru_cache(maxsize=20_000)
def _known_digest(path: str, state: tuple[int, ...]) -> str:
    return _hash(path)


def _hash(path: str) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def changed_files(files: Mapping[str, str]) -> list[str]:
    """Those of ``{path: SHA-256}`` that have another content now, are gone, or have come; noted as they are now."""
    return [path for path, digest in files.items() if digest != _digest_now(path)]


def _digest_now(path: str) -> str:
    try:
        return digest_of(path) if is_there(path) else ABSENT
    except OSError:
        return ABSENT


class Kept(Generic[_Made]):
    """A few things that were made of files, each kept until one of its files changes.

    Args:
        most: how many; the oldest goes first.
    """

    def __init__(self, most: int):
        self._most = most
        self._entries: dict[Hashable, tuple[_Made, dict[str, str]]] = {}

    def get(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What is kept under ``key``; made now where there is none, or where a file of it has changed."""
        entry = self._entries.get(key)
        if entry is None or changed_files(entry[1]):
            with noting_files() as files:
                entry = make(), files
            self._entries.pop(key, None)
            while len(self._entries) >= self._most:
                del self._entries[next(iter(self._entries))]
            self._entries[key] = entry
        note_files(entry[1])
        return entry[0]
