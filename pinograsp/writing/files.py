"""Single files, and the lists that folders keep of what was written into them."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from pinograsp.checks import instance_of, path_of
from pinograsp.errors import ResultsNotWritten
from pinograsp.writing.locks import ASIDE, is_live, left_over, list_staged, lock, mark, stage

LISTING = "files.txt"
_HEADER = "# Written by pinograsp: overwriting removes these files, and no others."
_LONGEST = 255  # bytes of a name


def write_file(path: str | Path, content: bytes) -> Path:
    """Write one file, completely or not at all: next to its place, then renamed; returns its path. Symbolic links are
    followed.

    Raises:
        ResultsNotWritten: it cannot be written.
    """
    path = path_of("path", path)
    instance_of("content", content, bytes)
    with write_errors(path):
        place = place_of(path)
        if place.exists() and not place.is_file():
            raise ResultsNotWritten(f"cannot write '{path}': expected the path of a file, and it is something else")
        place.parent.mkdir(parents=True, exist_ok=True)
        with lock(mark(place)):
            for left in left_over(place.parent):
                discard(left)
            staging = stage(mark(place))
            try:
                with open(staging, "xb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(
                        stream.fileno()
                    )  # renamed before its content is on disk, it could be empty after a power cut
                    if place.exists():
                        os.fchmod(stream.fileno(), place.stat().st_mode & 0o777)
                staging.replace(place)
            finally:
                for left in list_staged(mark(place)):
                    discard(left)
    return path


def list_in(folder: str | Path, *paths: str | Path) -> None:
    """Add files, or folders with lists of their own (their paths end with '/'), to a folder's list.

    Paths outside the folder are left out, and a folder without a list is left alone.

    Raises:
        ResultsNotWritten: the list cannot be written.
    """
    with write_errors(folder):
        folder = place_of(folder)
        places = [(place_of(path), "/" if str(path).endswith("/") else "") for path in paths]
        inner = {place.relative_to(folder).as_posix() + end for place, end in places if place.is_relative_to(folder)}
        if inner and listing_of(folder) is not None:
            with lock(folder / f"{ASIDE}listing"):
                write_listing(folder, (listing_of(folder) or set()) | inner)


def safe_name(text: str) -> str:
    """A text as the name of a file or a folder: not hidden, not too long, and of letters, digits, '.', '_' and '-'."""
    return cut(re.sub(r"[^\w.-]", "_", text).lstrip("."), 100) or "_"


def cut(text: str, longest: int) -> str:
    """The beginning of a text, at most ``longest`` bytes."""
    return text.encode(errors="replace")[:longest].decode(errors="ignore")


@contextlib.contextmanager
def write_errors(path: str | Path) -> Iterator[None]:
    """Errors of the operating system become :class:`~pinograsp.errors.ResultsNotWritten`."""
    try:
        yield
    except OSError as error:
        raise ResultsNotWritten(f"cannot write '{path}': {error}") from error


def place_of(path: str | Path) -> Path:
    """Where a path leads."""
    try:
        place = Path(os.path.realpath(path))
        longest = max((os.fsencode(part) for part in place.parts), key=len)
    except ValueError as error:  # a NUL, or characters that cannot be encoded
        raise ResultsNotWritten(f"cannot write {str(path)!r}: {error}") from error
    if len(longest) > _LONGEST:
        raise ResultsNotWritten(
            f"cannot write '{cut(os.fsdecode(longest), 30)}...': expected names of at most {_LONGEST} bytes, got "
            f"{len(longest)}"
        )
    return place


def flush(path: Path) -> None:
    """Onto the disk itself, as far as the file system does that."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


# -- what was written here


def listing_of(folder: Path) -> set[str] | None:
    """Files that a folder lists as written here, and folders, with '/' at their end, that list their own; None without
    a list.
    """
    try:
        header, *names = (folder / LISTING).read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return None
    return set(names) - {""} if header == _HEADER else None


def write_listing(folder: Path, names: set[str]) -> None:
    """Write down which files of a folder were written here."""
    write_file(folder / LISTING, "\n".join([_HEADER, *sorted(names), ""]).encode())


def entries(folder: Path) -> Iterator[tuple[Path, bool]]:
    """Everything within a folder and whether it was written here: our folders after their contents, foreign ones as one
    entry.
    """
    listed = listing_of(folder)
    yield from _within(folder, "", listed or set())
    if os.path.lexists(folder / LISTING):
        yield folder / LISTING, listed is not None


def _within(folder: Path, prefix: str, listed: set[str]) -> Iterator[tuple[Path, bool]]:
    for entry in sorted(os.scandir(folder), key=lambda one: one.name):
        path, name = Path(entry.path), prefix + entry.name
        if entry.name.startswith(ASIDE):
            yield path, not is_live(path)
        elif not entry.is_dir(follow_symlinks=False):
            if name != LISTING:
                yield path, name in listed
        elif f"{name}/" in listed and listing_of(path) is not None:
            yield from entries(path)
            yield path, True
        elif any(one.startswith(f"{name}/") and one != f"{name}/" for one in listed):
            yield from _within(path, f"{name}/", listed)
            yield path, True
        else:
            yield path, False


def discard(path: Path) -> None:
    """Remove what was put aside: a file, a half-written folder, or a complete one as far as it was written here."""
    if path.is_symlink() or not path.is_dir():
        path.unlink(missing_ok=True)
        return
    if listing_of(path) is None:
        shutil.rmtree(path, ignore_errors=True)
        return
    for inner, ours in [*entries(path), (path, True)]:
        if not ours or (inner.name == LISTING and len(os.listdir(inner.parent)) > 1):
            continue  # a list stays with what stays
        with contextlib.suppress(OSError):  # a folder with something left in it
            if inner != path and inner.name.startswith(ASIDE):
                discard(inner)
            elif inner.is_dir() and not inner.is_symlink():
                inner.rmdir()
            else:
                inner.unlink(missing_ok=True)
