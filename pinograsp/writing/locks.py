"""Who is writing: staging entries, and locks of files and folders themselves, which leave nothing behind."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pinograsp.errors import ResultsNotWritten

ASIDE = ".pinograsp-"  # how the name of an entry begins until it is complete
_PATIENCE = 10.0  # [s] for another writer's last step, which takes milliseconds
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EBADF, errno.EISDIR)


def staged(start: Path, folder: bool) -> tuple[Path, int]:
    """A new file or folder, locked: path and handle."""
    while True:
        path = start.with_name(start.name + os.urandom(4).hex())
        if folder:
            path.mkdir()
        else:
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            handle = os.open(path, os.O_RDONLY if folder else os.O_WRONLY)
        except FileNotFoundError:  # taken for one whose writer was killed
            continue
        while lock(handle) is False:
            time.sleep(0.001)
        if is_still(handle, path):
            return path, handle
        os.close(handle)


def alive(path: Path) -> bool | None:
    """Whether a staging entry is being written; None where that cannot be known."""
    for _ in range(10):
        locked = _do_if_left_over(path, lambda path: None)
        if locked is not False:
            break
        time.sleep(0.01)  # it may be just being removed
    return None if locked is None else not locked


def sweep(folder: Path, remove: Callable[[Path], None]) -> None:
    """Remove what writers that were killed have left in a folder."""
    for path in folder.glob(f"{ASIDE}*"):
        _do_if_left_over(path, remove)


def _do_if_left_over(path: Path, do: Callable[[Path], None]) -> bool | None:
    """Whether a staging entry has no writer, so that ``do(path)`` was called; None where that cannot be known."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:  # gone, or not ours
        return None
    try:
        locked = lock(handle)
        if locked and is_still(handle, path):
            do(path)
        return locked
    finally:
        os.close(handle)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, for a moment."""
    end = time.monotonic() + _PATIENCE
    while True:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            while lock(handle) is False:
                if time.monotonic() > end:
                    raise ResultsNotWritten(f"another process keeps folder '{folder}' locked: wait for it, or stop it")
                time.sleep(0.01)
            if is_still(handle, folder):
                yield
                return
        finally:
            os.close(handle)


def lock(handle: int) -> bool | None:
    """Whether an open file or folder is now locked for this process; None where there are no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True


def is_still(handle: int, path: Path) -> bool:
    """Whether an open file or folder is still what is found under its path."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False
