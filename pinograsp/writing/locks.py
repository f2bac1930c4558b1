"""Who is writing: a lock file beside what is being written, which is removed with the lock."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from pinograsp.errors import ResultsNotWritten

ASIDE = ".pinograsp-"  # how the name of an entry begins until it is complete
PATIENCE = 10.0  # [s] for another writer's last step, which takes milliseconds
MOMENT = 0.2  # [s] for another process that looks whether somebody is writing
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF)
_MARK = re.compile(rf"{re.escape(ASIDE)}\w+")


class InUse(ResultsNotWritten):
    """Another process is writing there."""


def mark(place: Path) -> Path:
    """How the names of all entries begin that stand for a place while it is written, however long its own name is."""
    return place.with_name(ASIDE + hashlib.sha256(os.fsencode(place.name)).hexdigest()[:12])


def stage(mark: Path) -> Path:
    """A new name under a mark."""
    return mark.with_name(f"{mark.name}-{os.urandom(4).hex()}")


@contextlib.contextmanager
def lock(mark: Path, patience: float = PATIENCE) -> Iterator[None]:
    """Hold the lock of a mark, or any other path.

    Raises:
        InUse: another process holds it for more than ``patience`` seconds.
    """
    from filelock import FileLock, SoftFileLock, Timeout  # 50 ms, for asyncio

    path = f"{mark}.lock"
    held = FileLock(path, thread_local=False)
    try:
        try:
            held.acquire(timeout=patience, poll_interval=0.01)
        except Timeout:
            raise
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            with contextlib.suppress(FileNotFoundError):
                if not os.path.getsize(path):  # of the attempt above
                    os.unlink(path)
            held = SoftFileLock(path, thread_local=False)
            held.acquire(timeout=patience, poll_interval=0.01)
    except Timeout:
        raise InUse(f"another process keeps '{path}' locked: wait for it, or stop it") from None
    try:
        yield
    finally:
        Path(path).unlink(missing_ok=True)  # still locked: who waits for this file sees that it is gone
        held.release()


def is_live(entry: Path) -> bool:
    """Whether somebody is writing what an entry, or a mark, stands for."""
    if (found := _MARK.match(entry.name)) is None:
        return False
    mark = entry.with_name(found[0])
    if not os.path.lexists(f"{mark}.lock"):
        return False
    try:
        with lock(mark, 0):
            return False
    except (OSError, ResultsNotWritten):
        return True


def list_staged(mark: Path) -> list[Path]:
    """What lies under a mark: what is being written, or was when its writer was killed."""
    return [mark, *mark.parent.glob(f"{mark.name}-*")]


def left_over(folder: Path) -> Iterator[Path]:
    """What writers that were killed have left in a folder; their marks are locked while each is looked at."""
    for name in {found[0] for path in folder.glob(f"{ASIDE}*") if (found := _MARK.match(path.name))}:
        with contextlib.suppress(OSError, InUse), lock(folder / name, 0):
            yield from list_staged(folder / name)
