"""The rows of a sweep on disk, see :mod:`pinograsp.sweep.parts`."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from pinograsp.checks import path_of
from pinograsp.errors import InvalidInput
from pinograsp.spatial import BoolArray, IntArray
from pinograsp.sweep.parts import Parts, Work, drop_doubles, manifest_of, need_pyarrow, read_parts
from pinograsp.sweep.rows import Kind, Row
from pinograsp.sweep.shards import WHOLE, Shard, deal_rows

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA = "pinograsp.sweep/1"
_WORK = Work(SCHEMA, "sweep", "sweep")


class Store(Parts):
    """The rows of a sweep: a table in a folder.

    Attributes:
        share: which rows are the shard's (rows,).
        have: which rows are there (rows,), those of other shards aside.
        counts: number of rows of the shard's share by status.
    """

    def __init__(
        self,
        folder: Path,
        settings: dict[str, Any],
        rows: int,
        kinds: dict[str, Kind],
        shard: Shard = WHOLE,
        look: bool = False,
    ):
        self.kinds, self.schema = kinds, _schema(kinds)
        super().__init__(folder, _WORK, settings, {"rows": rows, "columns": kinds}, shard, look)
        self.share: BoolArray = deal_rows(rows, shard.count) == shard.number
        self.have: BoolArray = np.zeros(rows, dtype=bool)
        self.counts: Counter[str] = Counter()
        try:
            self.count_all(["index", "status"])
        except BaseException:
            self.__exit__()
            raise

    def count(self, table: pa.Table, path: Path) -> None:
        """Note which rows are there, and their statuses."""
        index, statuses = table["index"].to_numpy(), table["status"].to_pylist()
        if index.min(initial=0) < 0 or index.max(initial=0) >= len(self.have):
            raise InvalidInput(
                f"'{path}' holds rows that this sweep does not have: remove it, and this sweep's are computed again"
            )
        for i in np.flatnonzero(self.share[index] & ~self.have[index]).tolist():
            self.counts[statuses[i]] += 1
        self.have[index] = True

    @property
    def done(self) -> int:
        """Number of rows of the share that are there."""
        return int((self.have & self.share).sum())

    @property
    def left(self) -> IntArray:
        """The rows of the share that are not there (M,)."""
        return np.flatnonzero(self.share & ~self.have)

    def add_rows(self, rows: list[Row]) -> None:
        """Keep rows; the next :meth:`save` writes them."""
        import pyarrow as pa

        kinds: dict[str, Kind] = {"index": "whole", **self.kinds}
        columns = {name: [_cell(kind, row.get(name)) for row in rows] for name, kind in kinds.items()}
        self.add(pa.table(columns, schema=self.schema))


def read_sweep(folder: str | Path) -> pa.Table:
    """The rows of a sweep as a ``pyarrow.Table``, in order of their index.

    For other forms: ``.to_pandas()``, ``["work_J"].to_numpy()``. A sweep that was interrupted, or is still running, has
    the rows that were written so far.

    Raises:
        InvalidInput: the folder holds no sweep, or a damaged one.
        ExtraMissing: pyarrow (extra ``sweep``) is not installed.
    """
    folder = path_of("folder", folder)
    columns = manifest_of(folder, _WORK).get("columns")
    if not isinstance(columns, dict) or not all(kind in get_args(Kind) for kind in map(str, columns.values())):
        raise InvalidInput(f"'{folder}' holds no readable sweep: its manifest has no columns")
    schema = _schema(columns)
    import pyarrow as pa

    tables = read_parts(folder, _WORK)
    try:
        return drop_doubles(pa.concat_tables([schema.empty_table(), *tables]).sort_by("index"), ["index"])
    except pa.ArrowException as error:
        raise InvalidInput(f"'{folder}' holds parts of other sweeps: {error}") from error


def _schema(kinds: dict[str, Kind]) -> pa.Schema:
    """The columns of a sweep by their kinds."""
    need_pyarrow(_WORK)
    import pyarrow as pa

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
