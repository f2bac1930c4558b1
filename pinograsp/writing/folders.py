"""Folders written completely or not at all, never in the place of anything that was not written here."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from pinograsp.checks import flag, path_of
from pinograsp.errors import ResultsNotWritten
from pinograsp.writing.files import (
    cut,
    discard,
    entries,
    flush,
    list_in,
    listing_of,
    place_of,
    safe_name,
    write_errors,
    write_listing,
)
from pinograsp.writing.locks import ASIDE, MOMENT, InUse, is_live, left_over, list_staged, lock, mark, stage

# Begins the name of what is being replaced, where two folders cannot change places at once.
_RETIRED = ".pinograsp.old"
_EXCHANGE = 2  # Linux: RENAME_EXCHANGE
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR)


class NewFolder:
    """A folder to be written completely or not at all. A context: it reserves the name from the start.

    Args:
        folder: a new or an empty one; symbolic links are followed.
        force: or one that was written here and holds nothing else.

    Raises:
        ResultsNotWritten: it exists and ``force`` is off, it holds files that were not written here, another process is
            writing it, or the place cannot be written.
    """

    def __init__(self, folder: str | Path, *, force: bool = False):
        self.path, self.force = path_of("folder", folder), flag("force", force)
        with write_errors(self.path), contextlib.ExitStack() as undo:
            self.place = place_of(self.path)
            self._check(self.place)
            undo.enter_context(_claim(self.place, mark(self.place)))
            _restore(self.place)
            self._check(self.place)
            self.staging = undo.enter_context(_make_staging(mark(self.place)))
            self._undo = undo.pop_all()

    @classmethod
    def fresh(cls, name: str, beside: Path) -> NewFolder:
        """The first of ``name``, ``name-2``, ... that does not exist and is not being written, with characters that
        are safe in names.
        """
        for count in itertools.count(1):
            folder = beside / (safe_name(name) if count == 1 else f"{safe_name(name)}-{count}")
            if not os.path.lexists(folder):
                with contextlib.suppress(InUse):
                    return cls(folder)
        raise AssertionError

    def write(self, fill: Callable[[Path], None]) -> Path:
        """Write what ``fill(path)`` writes; once. Returns the folder.

        Raises:
            ResultsNotWritten: it cannot be written, or files have been put there meanwhile: then the message names
                the folder beside it where the results are.
        """
        with write_errors(self.path):
            fill(self.staging)
            files = [path for path in self.staging.rglob("*") if not path.is_dir()]
            write_listing(self.staging, {path.relative_to(self.staging).as_posix() for path in files})
            for path in (*files, self.staging):
                flush(path)
            try:
                while not self._take_place():
                    pass
            except ResultsNotWritten as refusal:
                raise ResultsNotWritten(f"{refusal}; the results are in '{self._keep_beside()}'") from None
            finally:
                flush(self.place.parent)
        return self.path

    def _check(self, place: Path) -> None:
        """Raise unless the folder may take the place of what is there."""
        if not place.exists():
            return
        if not place.is_dir():
            raise ResultsNotWritten(f"'{self.path}' is a file: give a folder that does not exist yet")
        if place.is_mount():
            raise ResultsNotWritten(
                f"folder '{self.path}' is a mount point, which cannot be replaced: give a folder within it"
            )
        if place in (here := Path.cwd(), *here.parents):
            raise ResultsNotWritten(
                f"folder '{self.path}' is the one you are in: give another --out, or call from elsewhere"
            )
        if not any(place.iterdir()):
            return
        if not self.force:
            raise InUse(
                f"folder '{self.path}' already exists: choose another one (--out), or replace it (force=True, --force)"
            )
        foreign = [path for path, ours in entries(place) if not ours]
        if any(path.name.startswith(ASIDE) for path in foreign):
            raise ResultsNotWritten(
                f"another process is writing into folder '{self.path}': wait for it, or choose another --out"
            )
        if foreign:
            names = ", ".join(f"{path.relative_to(place)}" + "/" * path.is_dir() for path in foreign[:5]) + ", ..." * (
                len(foreign) > 5
            )
            raise ResultsNotWritten(
                f"folder '{self.path}' holds files that no run wrote ({names}): it is not overwritten, choose another "
                "--out"
            )

    def _take_place(self) -> bool:
        """Whether the staging folder has taken its place; False where something has just come there."""
        self._check(self.place)
        if not self.place.exists() or not any(self.place.iterdir()):
            return _rename(self.staging, self.place)
        _exchange(self.staging, self.place)
        try:
            self._check(self.staging)
        except ResultsNotWritten:  # something came between the two
            _exchange(self.staging, self.place)
            raise
        discard(self.staging)
        return True

    def _keep_beside(self) -> Path:
        for count in itertools.count(2):
            beside = self.place.with_name(f"{cut(self.place.name, 200)}-{count}")
            if not os.path.lexists(beside) and _rename(self.staging, beside):
                return beside
        raise AssertionError

    def __enter__(self) -> NewFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self._undo.close()


def write_folder(folder: str | Path | NewFolder, fill: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write a folder by ``fill(path)``, completely or not at all; arguments and errors as for :class:`NewFolder`."""
    if isinstance(folder, NewFolder):
        return folder.write(fill)
    with NewFolder(folder, force=force) as new:
        return new.write(fill)


def add_files(folder: str | Path, fill: Callable[[Path], None]) -> None:
    """Files that ``fill(path)`` writes, moved into a folder one by one and added to its list; they replace earlier
    ones.

    Raises:
        ResultsNotWritten: the folder cannot be written, or another process is writing there.
    """
    with write_errors(folder):
        place = place_of(folder)
        added = place / f"{ASIDE}added"
        with _claim(added, added), _make_staging(added) as staging:
            fill(staging)
            new = sorted(staging.iterdir())
            for path in new:
                flush(path)
            list_in(place, *(place / path.name for path in new))
            for path in new:
                path.replace(place / path.name)


@contextlib.contextmanager
def _claim(place: Path, mark_of_place: Path) -> Iterator[None]:
    """Hold a place; folders on the way to it are made, and removed again where nothing came of them."""
    parent = place.parent
    created = [folder for folder in (parent, *parent.parents) if not folder.exists()]
    try:
        with contextlib.ExitStack() as locks:
            for attempt in range(100):
                try:
                    parent.mkdir(parents=True, exist_ok=True)
                    locks.enter_context(lock(mark_of_place, MOMENT))
                    break
                except InUse:
                    raise InUse(
                        f"another process is writing '{place}': wait for it, or choose another folder"
                    ) from None
                except FileNotFoundError:  # another writer has just removed it again
                    if attempt == 99:
                        raise
            if listing_of(parent) is not None and is_live(mark(parent)):
                raise ResultsNotWritten(f"another process is writing '{parent}': wait for it, or choose another folder")
            for path in (*list_staged(mark_of_place), *left_over(parent)):
                discard(path)
            yield
    finally:
        for folder in created:
            with contextlib.suppress(OSError):  # there is something in it
                folder.rmdir()


@contextlib.contextmanager
def _make_staging(mark: Path) -> Iterator[Path]:
    """A new folder under a mark, removed again where it is not moved."""
    staging = stage(mark)
    staging.mkdir()
    try:
        yield staging
    finally:
        with contextlib.suppress(OSError):
            if staging.exists():
                discard(staging)


def _rename(folder: Path, place: Path) -> bool:
    """Whether a folder has got a name: never that of a file, nor of a folder with something in it."""
    try:
        os.rename(folder, place)
    except OSError as error:
        if error.errno not in _OCCUPIED:
            raise
        return False
    return True


def _exchange(one: Path, other: Path) -> None:
    """Two folders change places: at once on Linux, elsewhere one after the other, which :func:`_restore` repairs after
    a kill.
    """
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:
        failure = errno.ENOSYS
    else:
        here = -100  # AT_FDCWD
        if renameat2(here, os.fsencode(one), here, os.fsencode(other), _EXCHANGE) == 0:
            return
        failure = ctypes.get_errno()
    if failure not in (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP):
        raise OSError(failure, os.strerror(failure), str(other))
    retired = other.with_name(f"{_name_retired(other)}{os.urandom(4).hex()}")
    os.rename(other, retired)
    try:
        os.rename(one, other)
    except BaseException:
        os.rename(retired, other)
        raise
    os.rename(retired, one)


def _name_retired(place: Path) -> str:
    return f"{_RETIRED}-{mark(place).name.removeprefix(ASIDE)}-"


def _restore(place: Path) -> None:
    """What a writer killed between two renames has left: back in its place, or away if the new one got there."""
    for retired in place.parent.glob(f"{_name_retired(place)}*"):
        if place.exists():
            discard(retired)
        else:
            os.rename(retired, place)
