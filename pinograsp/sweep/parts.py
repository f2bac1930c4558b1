"""Tables on disk as Parquet files that are written as rows come, so that long work can continue."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import re
from collections.abc import Collection, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pinograsp.checks import one_line
from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten
from pinograsp.words import printable
from pinograsp.writing import ASIDE, MOMENT, InUse, discard, left_over, lock, place_of, write_errors, write_file

if TYPE_CHECKING:
    import pyarrow as pa

# Readers of folders, such as pyarrow's, ignore names with these first characters.
MANIFEST = "_manifest.json"
_OURS = f"{ASIDE}rows"  # the mark whose lock a folder is under
_PART = re.compile(r"part-(\d{6,})-(\d{6,})\.parquet")
_KINDS = {"hash": str, "settings": dict, "versions": dict}  # what a manifest has
_SHOWN = 5  # differences that a message names
_MERGED = 100  # number of parts that are merged into one


_Parts = TypeVar("_Parts", bound="Parts")


class Work(NamedTuple):
    """What kind of work writes a folder, for its manifest and messages."""

    schema: str
    noun: str
    command: str


class Parts:
    """A table in a folder: part files, with a manifest that identifies the work that they come from.

    A context manager: it locks the folder against other writers. Each part is written to a temporary file and renamed.
    It is named after the writes that it holds, ``part-<first>-<last>.parquet``; a merged part replaces those within its
    range, even where they could not be removed.
    """

    def __init__(self, folder: Path, work: Work, settings: dict[str, Any], more: dict[str, Any]):
        need_pyarrow(work)
        self.folder, self.work = folder, work
        self._held = contextlib.ExitStack()
        self._kept: list[pa.Table] = []
        text = json.dumps(settings, sort_keys=True)
        manifest = {
            "schema": work.schema,
            "hash": hashlib.sha256(text.encode()).hexdigest(),
            **more,
            "settings": settings,
            "versions": {name: version(name) for name in ("pinograsp", "pin", "numpy", "pyarrow")},
        }
        try:
            with write_errors(folder):
                place_of(folder)
                self._open(manifest, list(more))
        except BaseException:
            self.__exit__()
            raise

    def _open(self, manifest: dict[str, Any], more: list[str]) -> None:
        path, noun = self.folder / MANIFEST, self.work.noun
        self._refuse_others()
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            self._held.enter_context(lock(self.folder / _OURS, MOMENT))
        except InUse:
            raise ResultsNotWritten(
                f"folder '{self.folder}': another {noun} is writing there: wait for it, or stop it"
            ) from None
        self._lock = os.stat(self.folder / f"{_OURS}.lock")  # nothing else is this while it is open
        self._refuse_others()
        if path.exists():
            found = manifest_of(self.folder, self.work)
            before, now = (one["versions"].get("pinograsp") for one in (found, manifest))
            differ = [] if before == now else [f"pinograsp {printable(str(before), 20)} wrote it, this is {now}"]
            if found["hash"] != manifest["hash"]:
                differ += [name for name in more if name != "columns" and found.get(name) != manifest[name]]
                differ += _differences(found["settings"], json.loads(json.dumps(manifest["settings"])))
            if differ:
                names = ", ".join(printable(name, 100) for name in differ[:_SHOWN])
                others = f" and {len(differ) - _SHOWN} more" if len(differ) > _SHOWN else ""
                raise ResultsNotWritten(
                    f"folder '{self.folder}' holds another {noun} ({names}{others}): they are not mixed, give another "
                    "folder, or put back what has changed"
                )
        else:
            write_file(path, (json.dumps(manifest, indent=2) + "\n").encode())
        for entry in left_over(self.folder):
            discard(entry)
        live, stale = live_parts(self.folder)
        for one in stale:
            one.unlink()
        self.live = live
        self.next = 1 + max((_span(one)[1] for one in live), default=-1)

    def _refuse_others(self) -> None:
        """Raise where the folder holds other files and no manifest."""
        if self.folder.exists() and not (self.folder / MANIFEST).exists():
            foreign = sorted(one.name for one in self.folder.iterdir() if not one.name.startswith(ASIDE))
            if foreign:
                raise ResultsNotWritten(
                    f"folder '{self.folder}' holds files that no {self.work.noun} wrote ({', '.join(foreign[:5])}): "
                    "give another folder"
                )

    def write(self, table: pa.Table) -> None:
        """Write the part number ``next``, again where it was written and not counted: an interruption doubles none."""
        try:
            ours = os.path.samestat(os.stat(self.folder / f"{_OURS}.lock"), self._lock)
        except OSError:
            ours = False
        if not ours or not (self.folder / MANIFEST).exists():
            raise ResultsNotWritten(
                f"folder '{self.folder}' was removed, or another has taken its place, while a {self.work.noun} was "
                "writing there"
            )
        write_file(self.folder / f"part-{self.next:06d}-{self.next:06d}.parquet", _parquet([table]))

    def add(self, table: pa.Table) -> None:
        """Keep rows; the next :meth:`save` writes them."""
        self._kept.append(table)

    def save(self) -> None:
        """Write the rows that were added. Called again after an interruption, it writes no row twice."""
        if not self._kept:
            return
        import pyarrow as pa

        table = pa.concat_tables(self._kept)
        self.write(table)
        self._kept, self.next = [], self.next + 1
        self.count(table)
        if self.next % _MERGED == 0:
            self.merge()

    def count(self, table: pa.Table) -> None:
        """Hear of rows that are on disk; what kind of work it is knows what to count."""

    def remove_rows(self, column: str, values: Collection[str]) -> None:
        """Remove the rows that have one of the ``values`` in a column, part by part."""
        if not values:
            return
        import pyarrow as pa
        import pyarrow.compute as pc

        for path in self.live:
            table = read_part(path)
            left = table.filter(pc.invert(pc.is_in(table[column], pa.array(list(values), pa.string()))))
            if left.num_rows < table.num_rows:
                write_file(path, _parquet([left]))

    def merge(self) -> None:
        """Merge small parts into one: work of a day would leave tens of thousands."""
        small = [one for one in live_parts(self.folder)[0] if _span(one)[0] == _span(one)[1]]
        if len(small) < 2:
            return
        path = self.folder / f"part-{_span(small[0])[0]:06d}-{_span(small[-1])[1]:06d}.parquet"
        with write_errors(path):
            write_file(path, _parquet(read_part(one) for one in small))
            for one in small:
                one.unlink()

    def __enter__(self: _Parts) -> _Parts:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()


def need_pyarrow(work: Work) -> None:
    """Raise, naming the extra, where pyarrow is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise ExtraMissing(
            f"{work.noun}s are kept as Parquet, which needs pyarrow: pip install 'pinograsp[sweep]' ({error})"
        ) from error


def manifest_of(folder: Path, work: Work) -> dict[str, Any]:
    """The manifest in a folder."""
    noun, path = work.noun, folder / MANIFEST
    try:
        if not os.path.lexists(path):
            raise InvalidInput(
                f"'{folder}' holds no {noun}: expected a folder that 'pinograsp {work.command}' has written"
            )
        if not os.path.isfile(path):
            raise OSError("expected a file, got something else")
        found = json.loads(path.read_text(encoding="utf-8"))
    except InvalidInput:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidInput(f"'{folder}' holds no readable {noun}: {MANIFEST}: {one_line(error)}") from error
    if not isinstance(found, dict) or found.get("schema") != work.schema:
        raise InvalidInput(f"'{folder}' holds no {noun} of schema {work.schema}: give another folder")
    if any(not isinstance(found.get(name), kind) for name, kind in _KINDS.items()):
        raise InvalidInput(f"'{folder}' holds no readable {noun}: {MANIFEST}: expected {', '.join(_KINDS)}")
    return found


def read_parts(folder: Path, work: Work) -> list[pa.Table]:
    """The parts in a folder, in the order of their writes; those of work that is still running as well."""
    manifest_of(folder, work)
    need_pyarrow(work)
    while True:
        try:
            return [read_part(one) for one in live_parts(folder)[0]]
        except FileNotFoundError:  # merged in the meantime
            continue


def live_parts(folder: Path) -> tuple[list[Path], list[Path]]:
    """The parts in order, and those that a merged one has replaced."""
    live: list[Path] = []
    stale: list[Path] = []
    end = -1
    parts = [path for path in folder.glob("part-*.parquet") if _PART.fullmatch(path.name)]
    for path in sorted(parts, key=lambda path: (_span(path)[0], -_span(path)[1])):
        (live if _span(path)[0] > end else stale).append(path)
        end = max(end, _span(path)[1])
    return live, stale


def _span(path: Path) -> tuple[int, int]:
    """First and last write that a part holds."""
    _, first, last = path.stem.split("-")
    return int(first), int(last)


def read_part(path: Path, columns: list[str] | None = None) -> pa.Table:
    """The table of a part, or some of its columns."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        if os.path.lexists(path) and not os.path.isfile(path):  # a pipe would keep its reader waiting
            raise OSError("expected a file, got something else")
        table = parquet.ParquetFile(path).read(columns)
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException) as error:
        raise InvalidInput(f"'{path}' cannot be read: remove it, and its rows are computed again ({error})") from error
    missing = [name for name in columns or () if name not in table.column_names]
    if missing:
        raise InvalidInput(
            f"'{path}' cannot be read: remove it, and its rows are computed again (no column {missing[0]})"
        )
    return table


def _parquet(tables: Iterable[pa.Table]) -> bytes:
    """Tables of the same columns, one or more, one after the other: only one of them is open at a time."""
    import pyarrow as pa
    from pyarrow import parquet

    sink, rest = pa.BufferOutputStream(), iter(tables)
    first = next(rest)
    with parquet.ParquetWriter(sink, first.schema) as writer:
        for table in itertools.chain([first], rest):
            writer.write_table(table)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _differences(a: object, b: object, name: str = "") -> list[str]:
    """Names of the plain values that differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        inner = (
            (key, _differences(a.get(key), b.get(key), f"{name}.{key}" if name else key)) for key in sorted({*a, *b})
        )
        return [one for _, found in inner for one in found]
    return [] if a == b else [name]
