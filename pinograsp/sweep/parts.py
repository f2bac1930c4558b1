"""Tables on disk as Parquet files that are written as rows come, so that long work can continue."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from pinograsp.checks import one_line
from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten
from pinograsp.spatial import BoolArray
from pinograsp.sweep.shards import WHOLE, Shard, list_shards
from pinograsp.words import printable
from pinograsp.writing import (
    ASIDE,
    MOMENT,
    PATIENCE,
    InUse,
    discard,
    left_over,
    lock,
    place_of,
    write_errors,
    write_file,
)

if TYPE_CHECKING:
    import pyarrow as pa

# Readers of folders, such as pyarrow's, ignore names with these first characters.
MANIFEST = "_manifest.json"
_OURS = f"{ASIDE}rows"  # the mark whose lock a folder is under, or that of a shard
_BEGINNING = f"{ASIDE}manifest"  # and while its manifest is written
_PART = re.compile(r"part-(\d{6,})-(\d{6,})\.parquet")
_KINDS = {"hash": str, "settings": dict, "versions": dict}  # what a manifest has
_SHOWN = 5  # differences that a message names
_MERGED = 100  # number of parts that are merged into one
_AT_ONCE = 2**16  # rows of a part that are looked at, so that it need not fit into memory

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

    A shard writes into a folder of its own within that folder, under a lock of its own: those of one number of shards
    have no row in common, and may write at the same time. The manifest, of the folder, is that of all of them.

    Args:
        folder: of the table.
        work: what kind it is.
        settings: what all rows rest on.
        more: what else the manifest tells.
        shard: whose rows are written.
        look: only look at what is there: nothing is locked or written, and others may be writing.
    """

    def __init__(
        self,
        folder: Path,
        work: Work,
        settings: dict[str, Any],
        more: dict[str, Any],
        shard: Shard = WHOLE,
        look: bool = False,
    ):
        need_pyarrow(work)
        self.folder, self.work, self.shard = folder, work, shard
        self.own = shard.folder_in(folder)
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
                self._refuse_others()
                if not look:
                    self._begin(manifest)
                if (folder / MANIFEST).exists():
                    self._compare(manifest, list(more))
                if not look:
                    self._open()
        except BaseException:
            self.__exit__()
            raise

    def _begin(self, manifest: dict[str, Any]) -> None:
        """Write the manifest, unless it is there: one of those that begin at once does so."""
        path = self.folder / MANIFEST
        self.folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            with lock(self.folder / _BEGINNING):
                self._refuse_others()
                if not path.exists():
                    write_file(path, (json.dumps(manifest, indent=2) + "\n").encode())

    def _compare(self, manifest: dict[str, Any], more: list[str]) -> None:
        """Raise where the folder is of other work, and say what differs."""
        noun, found = self.work.noun, manifest_of(self.folder, self.work)
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

    def _open(self) -> None:
        self.own.mkdir(exist_ok=True)
        self._hold(self.own, MOMENT)
        self._lock = os.stat(self.own / f"{_OURS}.lock")  # nothing else is this while it is open
        for other in self._others():
            if os.path.lexists(other / f"{_OURS}.lock"):  # of one that works, or was killed
                self._hold(other, PATIENCE).close()
        for entry in left_over(self.own):
            discard(entry)
        live, stale = live_parts(self.own)
        for one in stale:
            one.unlink()
        self.next = 1 + max((_span(one)[1] for one in live), default=-1)

    def _hold(self, folder: Path, patience: float) -> contextlib.ExitStack:
        """Lock the rows of a shard, until this is closed."""
        held = contextlib.ExitStack()
        try:
            held.enter_context(lock(folder / _OURS, patience))
        except InUse:
            which = "" if folder == self.folder else f" ({folder.name})"
            raise ResultsNotWritten(
                f"folder '{self.folder}': another {self.work.noun} is writing there{which}: wait for it, or stop it"
            ) from None
        self._held.push(held)
        return held

    def _others(self) -> list[Path]:
        """Folders of shards that may have rows of this one, too: those of another number of shards."""
        return [one.folder_in(self.folder) for one in list_shards(self.folder) if one.count != self.shard.count]

    def _refuse_others(self) -> None:
        """Raise where the folder holds other files and no manifest."""
        inside = os.listdir(self.folder) if self.folder.exists() else []
        foreign = sorted(name for name in inside if not name.startswith(ASIDE))
        if foreign and not (self.folder / MANIFEST).exists():  # looked for last: others may be beginning now
            raise ResultsNotWritten(
                f"folder '{self.folder}' holds files that no {self.work.noun} wrote ({', '.join(foreign[:5])}): "
                "give another folder"
            )

    def count_all(self, columns: Sequence[str]) -> None:
        """Count all rows that are there, but for those of other shards of the same number."""
        while True:
            try:
                for folder in (self.own, *self._others()):
                    for path in live_parts(folder)[0]:
                        for rows in read_slices(path, columns):
                            self.count(rows, path)
                return
            except FileNotFoundError:  # merged in the meantime
                continue

    def write(self, table: pa.Table) -> Path:
        """Write the part number ``next``, again where it was written and not counted: an interruption doubles none."""
        try:
            ours = os.path.samestat(os.stat(self.own / f"{_OURS}.lock"), self._lock)
        except OSError:
            ours = False
        if not ours or not (self.folder / MANIFEST).exists():
            raise ResultsNotWritten(
                f"folder '{self.folder}' was removed, or another has taken its place, while a {self.work.noun} was "
                "writing there"
            )
        return write_file(self.own / f"part-{self.next:06d}-{self.next:06d}.parquet", _parquet([table]))

    def add(self, table: pa.Table) -> None:
        """Keep rows; the next :meth:`save` writes them."""
        self._kept.append(table)

    def save(self) -> None:
        """Write the rows that were added. Called again after an interruption, it writes no row twice."""
        if not self._kept:
            return
        import pyarrow as pa

        table = pa.concat_tables(self._kept)
        path = self.write(table)
        self._kept, self.next = [], self.next + 1
        self.count(table, path)
        if self.next % _MERGED == 0:
            self.merge()

    def count(self, table: pa.Table, path: Path) -> None:
        """Hear of rows that are on disk, perhaps again; what kind of work it is knows what to count."""

    def list_counts(self) -> list[int]:
        """Into how many shards the work is, or was, divided; that of this one alone, if it is one."""
        all_counts = {one.count for one in list_shards(self.folder)} - {1}
        return [self.shard.count] if self.shard.count > 1 else sorted(all_counts)

    def keep_rows(self, which: Callable[[pa.Table], BoolArray]) -> None:
        """Remove other rows, part by part, but for those of another writer that does the same now."""
        import pyarrow as pa

        for folder in (self.own, *self._others()):
            with contextlib.suppress(InUse), contextlib.ExitStack() as held:
                if folder != self.own:
                    held.enter_context(lock(folder / _OURS))
                for path in live_parts(folder)[0]:
                    kept = [which(table) for table in read_slices(path)]
                    if not all(one.all() for one in kept):
                        write_file(path, _parquet(map(pa.Table.filter, read_slices(path), kept)))

    def merge(self) -> None:
        """Merge small parts into one: work of a day would leave tens of thousands."""
        small = [one for one in live_parts(self.own)[0] if _span(one)[0] == _span(one)[1]]
        if len(small) < 2:
            return
        path = self.own / f"part-{_span(small[0])[0]:06d}-{_span(small[-1])[1]:06d}.parquet"
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
    """The parts in a folder and its shards, in the order of their writes; those of work that still runs as well."""
    manifest_of(folder, work)
    need_pyarrow(work)
    while True:
        try:
            return [read_part(one) for shard in list_shards(folder) for one in live_parts(shard.folder_in(folder))[0]]
        except FileNotFoundError:  # merged in the meantime
            continue


def drop_doubles(table: pa.Table, keys: Sequence[str]) -> pa.Table:
    """A sorted table without rows that have the same values as the row before: of shards of different numbers."""
    import pyarrow.compute as pc

    new = np.zeros(table.num_rows, dtype=bool)
    new[:1] = True
    for one in (table[key] for key in keys):
        new[1:] |= pc.not_equal(one.slice(1), one.slice(0, max(len(one) - 1, 0))).to_numpy()
    return table if new.all() else table.filter(new)


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


def read_part(path: Path) -> pa.Table:
    """The table of a part."""
    import pyarrow as pa

    return pa.concat_tables(read_slices(path))


def read_slices(path: Path, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """The table of a part, or some of its columns, some rows at once; at least one table, also without rows."""
    import pyarrow as pa
    from pyarrow import parquet

    mend = f"'{path}' cannot be read: remove it, and its rows are computed again"
    try:
        if os.path.lexists(path) and not os.path.isfile(path):  # a pipe would keep its reader waiting
            raise OSError("expected a file, got something else")
        with parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            missing = [name for name in columns or () if name not in schema.names]
            if missing:
                raise InvalidInput(f"{mend} (no column {missing[0]})")
            empty = schema.empty_table()
            yield empty if columns is None else empty.select(columns)
            for batch in file.iter_batches(_AT_ONCE, columns=columns):
                yield pa.Table.from_batches([batch])
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException) as error:
        raise InvalidInput(f"{mend} ({error})") from error


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
