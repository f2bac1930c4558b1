"""The rows of a sweep on disk, as Parquet files that are written as rows come, so that a sweep can continue."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten
from pinograsp.spatial import BoolArray
from pinograsp.sweep.rows import Kind, Row
from pinograsp.writing import ASIDE, discard, is_still, lock, place_of, sweep, write_errors, write_file

if TYPE_CHECKING:
    import pyarrow as pa

# Readers of folders, such as pyarrow's, ignore names with these first characters.
SCHEMA, MANIFEST, _LOCK = "pinograsp.sweep/1", "_manifest.json", ".lock"
_PART = re.compile(r"part-(\d{6,})-(\d{6,})\.parquet")
_MERGED = 100  # number of parts that are merged into one


class Store:
    """The rows on disk: part files in a folder, with a manifest that identifies the sweep.

    A context manager: it locks the folder against other writers. Each part is written to a temporary file and renamed.
    It is named after the writes that it holds, ``part-<first>-<last>.parquet``; a merged part replaces those within its
    range, even where they could not be removed.

    Attributes:
        have: which rows are there (rows,).
        counts: number of rows by status.
    """

    def __init__(self, folder: Path, settings: dict[str, Any], rows: int, kinds: dict[str, Kind]):
        self.folder, self.kinds, self.schema = folder, kinds, _schema(kinds)
        self.have: BoolArray = np.zeros(rows, dtype=bool)
        self.counts: Counter[str] = Counter()
        self.kept: list[Row] = []
        self.lock: TextIO | None = None
        text = json.dumps(settings, sort_keys=True)
        manifest = {
            "schema": SCHEMA,
            "hash": hashlib.sha256(text.encode()).hexdigest(),
            "rows": rows,
            "columns": kinds,
            "settings": settings,
            "versions": {name: version(name) for name in ("pinograsp", "pin", "numpy", "pyarrow")},
        }
        try:
            with write_errors(folder):
                place_of(folder)
                self._open(manifest)
        except BaseException:
            self.__exit__()
            raise

    def _open(self, manifest: dict[str, Any]) -> None:
        path = self.folder / MANIFEST
        self._refuse_others()
        self.folder.mkdir(parents=True, exist_ok=True)
        self.lock = (self.folder / _LOCK).open("a")
        if lock(self.lock.fileno()) is False:
            raise ResultsNotWritten(f"folder '{self.folder}': another sweep is writing there: wait for it, or stop it")
        self._refuse_others()
        if path.exists():
            found = _manifest(self.folder)
            if found["hash"] != manifest["hash"]:
                differ = [name for name in ("rows",) if found["rows"] != manifest["rows"]] + _differences(
                    found["settings"], json.loads(json.dumps(manifest["settings"]))
                )
                raise ResultsNotWritten(
                    f"folder '{self.folder}' holds another sweep ({', '.join(differ[:5])}): they are not mixed, give "
                    "another folder"
                )
        else:
            write_file(path, (json.dumps(manifest, indent=2) + "\n").encode())
        sweep(self.folder, discard)
        live, stale = _parts(self.folder)
        for one in stale:
            one.unlink()
        for one in live:
            table = _read(one, ["index", "status"])
            rows = table["index"].to_numpy()
            if rows.min(initial=0) < 0 or rows.max(initial=0) >= len(self.have):
                raise InvalidInput(
                    f"'{one}' holds rows that this sweep does not have: remove it, and this sweep's are planned again"
                )
            self.have[rows] = True
            self.counts.update(table["status"].to_pylist())
        self.next = 1 + max((_span(one)[1] for one in live), default=-1)

    def _refuse_others(self) -> None:
        """Raise where the folder holds other files and no manifest."""
        if self.folder.exists() and not (self.folder / MANIFEST).exists():
            foreign = sorted(
                one.name for one in self.folder.iterdir() if one.name != _LOCK and not one.name.startswith(ASIDE)
            )
            if foreign:
                raise ResultsNotWritten(
                    f"folder '{self.folder}' holds files that no sweep wrote ({', '.join(foreign[:5])}): give another "
                    "folder"
                )

    @property
    def done(self) -> int:
        """Number of rows in the folder."""
        return int(self.have.sum())

    def add(self, rows: list[Row]) -> None:
        """Keep rows; the next :meth:`save` writes them."""
        self.kept += rows

    def save(self) -> None:
        """Write the rows that were added. Called again after an interruption, it writes no row twice."""
        import pyarrow as pa

        if not self.kept:
            return
        locked = self.lock is not None and is_still(self.lock.fileno(), self.folder / _LOCK)
        if not locked or not (self.folder / MANIFEST).exists():
            raise ResultsNotWritten(
                f"folder '{self.folder}' was removed, or another has taken its place, while a sweep was writing there"
            )
        kinds: dict[str, Kind] = {"index": "whole", **self.kinds}
        columns = {name: [_cell(kind, row.get(name)) for row in self.kept] for name, kind in kinds.items()}
        path = self.folder / f"part-{self.next:06d}-{self.next:06d}.parquet"
        write_file(path, _parquet(pa.table(columns, schema=self.schema)))
        new, self.kept, self.next = self.kept, [], self.next + 1
        self.have[[row["index"] for row in new]] = True
        self.counts.update(row["status"] for row in new)
        if self.next % _MERGED == 0:
            self.merge()

    def merge(self) -> None:
        """Merge small parts into one: a sweep of a day would leave tens of thousands."""
        import pyarrow as pa

        small = [one for one in _parts(self.folder)[0] if _span(one)[0] == _span(one)[1]]
        if len(small) < 2:
            return
        path = self.folder / f"part-{_span(small[0])[0]:06d}-{_span(small[-1])[1]:06d}.parquet"
        with write_errors(path):
            write_file(path, _parquet(pa.concat_tables([_read(one) for one in small])))
            for one in small:
                one.unlink()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        if self.lock is not None:
            self.lock.close()


def read_sweep(folder: str | Path) -> pa.Table:
    """The rows of a sweep as a ``pyarrow.Table``, in order of their index.

    For other forms: ``.to_pandas()``, ``["work_J"].to_numpy()``. A sweep that was interrupted, or is still running, has
    the rows that were written so far.

    Raises:
        InvalidInput: the folder holds no sweep, or a damaged one.
        ExtraMissing: pyarrow (extra ``sweep``) is not installed.
    """
    folder = Path(folder)
    schema = _schema(_manifest(folder)["columns"])
    import pyarrow as pa

    while True:
        try:
            tables = [_read(one) for one in _parts(folder)[0]]
        except FileNotFoundError:  # merged in the meantime
            continue
        try:
            return pa.concat_tables(tables).sort_by("index") if tables else schema.empty_table()
        except pa.ArrowException as error:
            raise InvalidInput(f"'{folder}' holds parts of other sweeps: {error}") from error


def _schema(kinds: dict[str, Kind]) -> pa.Schema:
    """The columns of a sweep by their kinds."""
    try:
        import pyarrow as pa
        import pyarrow.parquet
    except ImportError as error:
        raise ExtraMissing(
            f"sweeps are kept as Parquet, which needs pyarrow: pip install 'pinograsp[sweep]' ({error})"
        ) from error
    types: dict[Kind, pa.DataType] = {
        "text": pa.string(),
        "json": pa.string(),
        "number": pa.float64(),
        "whole": pa.int64(),
        "flag": pa.bool_(),
        "numbers": pa.list_(pa.float64()),
        "texts": pa.list_(pa.string()),
    }
    return pa.schema([("index", pa.int64()), *((name, types[kind]) for name, kind in kinds.items())])


def _cell(kind: Kind, value: Any) -> object:
    """A value as pyarrow takes it: a whole number too large for a float must be rounded first."""
    if kind == "json":
        return json.dumps(value)
    if kind == "number":
        return None if value is None else float(value)
    if kind == "numbers":
        return None if value is None else [float(one) for one in value]
    return value


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InvalidInput(f"'{folder}' holds no sweep: expected a folder that 'pinograsp sweep' has written") from None
    except (OSError, ValueError) as error:
        raise InvalidInput(f"'{folder}' holds no readable sweep: {MANIFEST}: {error}") from error
    if not isinstance(found, dict) or found.get("schema") != SCHEMA:
        raise InvalidInput(f"'{folder}' holds no sweep of schema {SCHEMA}: give another folder")
    return found


def _parts(folder: Path) -> tuple[list[Path], list[Path]]:
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


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.ParquetFile(path).read(columns)
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException) as error:
        raise InvalidInput(f"'{path}' cannot be read: remove it, and its rows are planned again ({error})") from error
    missing = [name for name in columns or ("index",) if name not in table.column_names]
    if missing:
        raise InvalidInput(
            f"'{path}' cannot be read: remove it, and its rows are planned again (no column {missing[0]})"
        )
    return table


def _parquet(table: pa.Table) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink)
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
