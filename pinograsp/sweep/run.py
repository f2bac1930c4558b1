"""Plans of one case over ranges or random draws of its inputs, on all cores or on a cluster."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinograsp.cases.sweep_file import SweepSpec, load_sweep
from pinograsp.checks import brief, path_of
from pinograsp.spatial import IntArray
from pinograsp.sweep.rows import FIGURES, ChunkResult, Kind, Row, kind_of, run_chunk
from pinograsp.sweep.runner import Executor, Progress, Runner
from pinograsp.sweep.shards import Missing, Shard, deal_rows
from pinograsp.sweep.store import Store, read_sweep

if TYPE_CHECKING:
    import pyarrow

_CHUNK = 0.3  # [s] of work in a chunk: long compared with its transfer, short compared with the sweep
_MOST_AT_ONCE = 2000  # rows of a chunk


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """Result of a sweep. Its rows are in its folder; :meth:`table` reads them.

    Attributes:
        folder: that holds the rows.
        rows: number of rows of the sweep, or of the shard's share; so all numbers.
        done: number of rows in the folder, those of earlier runs included.
        counts: number of rows by status.
        interrupted: whether Ctrl-C stopped it; the same call continues it.
        elapsed: of this run [s].
    """

    folder: Path
    rows: int
    done: int
    counts: dict[str, int]
    interrupted: bool
    elapsed: float

    __repr__ = brief()

    def table(self) -> pyarrow.Table:
        """The rows in order, a ``pyarrow.Table``: see :func:`read_sweep`."""
        return read_sweep(self.folder)

    def summary(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "rows": self.rows,
            "done": self.done,
            "counts": dict(self.counts),
            "interrupted": self.interrupted,
            "elapsed_s": self.elapsed,
            "folder": str(self.folder),
        }


def sweep(
    spec: SweepSpec | dict[str, Any] | str | Path,
    folder: str | Path,
    *,
    jobs: int = -1,
    executor: Executor = "joblib",
    scheduler: str | None = None,
    progress: bool | None = None,
    shard: tuple[int, int] | str | None = None,
) -> Sweep:
    """Plan a case over ranges or random draws of its inputs, one row each; called again, it continues.

    A row has ``index``, the inputs by name, ``status``, ``message``, and the columns of
    :data:`~pinograsp.sweep.rows.FIGURES`. A plan that fails is a row as well. Its status is that of the plan or its
    search (``infeasible``, ``joint_limit``...), ``not_reached`` (a finger cannot reach its contact), ``not_found`` (no
    placement), ``invalid_input`` (unusable values) or ``failed`` (anything else), and its message says why. With
    ``what: forces``, only contact forces at a given impact time are computed, in batches.

    Args:
        spec: a sweep file, a mapping with the same content, or a sweep that was loaded.
        folder: for the rows, as Parquet files that are written every two seconds; a new folder, or one of this sweep.
        jobs: processes of ``"joblib"``; -1: all cores; 1: this process.
        executor: ``"joblib"``, or ``"dask"``, whose workers need this package, and the files of hands and meshes at the
            same paths.
        scheduler: address of a Dask scheduler, such as ``"tcp://10.0.0.1:8786"``.
        progress: bar on stderr: None (on a terminal), True or False.
        shard: compute the i-th of n shares alone, ``(i, n)`` or ``"i/n"``, i from 1: n processes, on machines that
            share the folder, do all of them at once. Whatever they leave, a call without it computes, or one with
            another n, once none of them is running.

    Raises:
        CaseRejected: a sweep or case that cannot be used.
        InvalidInput: jobs, executor, scheduler or shard.
        ResultsNotWritten: the folder holds another sweep or other files, is in use (by this shard, or by one of another
            n), or cannot be written.
        ExtraMissing: pyarrow (extra ``sweep``), distributed (``dask``) or, for forces alone, the compiled core is not
            installed.
        PinograspError: workers were lost; completed rows are kept.
    """
    started = time.perf_counter()
    runner = Runner(jobs=jobs, executor=executor, scheduler=scheduler, progress=progress)
    spec = spec if isinstance(spec, SweepSpec) else load_sweep(spec)
    payload = spec.base.model_copy(update={"files": spec.files}).model_dump_json()
    with _open(spec, folder, shard) as store:
        chunks, total = _Chunks(spec, store.left), int(store.share.sum())

        def take(result: ChunkResult) -> int:
            rows, seconds, left = result
            chunks.report(seconds / len(rows), left)
            store.add_rows(rows)
            return len(rows)

        interrupted = runner.run(
            run_chunk,
            # A map, unlike a generator, goes on with rows that workers return after the last chunk was sent.
            map(lambda rows: (payload, rows), chunks),
            store,
            take,
            Progress("sweep", "row", store.done, total),
            chunks.employ,
        )
        return Sweep(
            folder=Path(folder),
            rows=total,
            done=store.done,
            counts=dict(store.counts),
            interrupted=interrupted,
            elapsed=time.perf_counter() - started,
        )


def find_missing_rows(
    spec: SweepSpec | dict[str, Any] | str | Path, folder: str | Path, *, shard: tuple[int, int] | str | None = None
) -> Missing:
    """The rows that :func:`sweep` would compute with these arguments; nothing is written, and shards may be running.

    Raises:
        CaseRejected, InvalidInput, ResultsNotWritten, ExtraMissing: as of :func:`sweep`.
    """
    spec = spec if isinstance(spec, SweepSpec) else load_sweep(spec)
    store = _open(spec, folder, shard, look=True)
    left = store.left
    return Missing(
        rows=len(left),
        total=int(store.share.sum()),
        shards={n: tuple(np.unique(deal_rows(spec.rows, n)[left]).tolist()) for n in store.list_counts()},
    )


def _open(spec: SweepSpec, folder: str | Path, shard: tuple[int, int] | str | None, look: bool = False) -> Store:
    kinds: dict[str, Kind] = {key: kind_of(values) for key, values in spec.inputs.items()}
    columns = {**kinds, **FIGURES[spec.what]}
    return Store(path_of("folder", folder), spec.settings(), spec.rows, columns, Shard.of(shard), look)


class _Chunks:
    """The rows that are left, in chunks of equal work; workers return rows for which there was no time."""

    def __init__(self, spec: SweepSpec, left: IntArray):
        self.spec, self.left, self.at = spec, left, 0
        self.back: deque[int] = deque()
        self.workers, self.pace = 1, math.inf

    def __len__(self) -> int:
        return len(self.left) - self.at + len(self.back)

    def __iter__(self) -> _Chunks:
        return self

    def __next__(self) -> list[tuple[int, Row]]:
        left = len(self)
        if not left:
            raise StopIteration
        # Chunks become smaller at the end, so that no worker waits long for another.
        count = max(1, min(int(_CHUNK / max(self.pace, 1e-9)), _MOST_AT_ONCE, left // (2 * self.workers)))
        rows = [self.back.popleft() for _ in range(min(count, len(self.back)))]
        start = self.at
        self.at = min(start + count - len(rows), len(self.left))
        return [(index, self.spec.row(index)) for index in (*rows, *self.left[start : self.at].tolist())]

    def employ(self, workers: int) -> None:
        """Record the number of workers."""
        self.workers = workers

    def report(self, pace: float, back: list[int]) -> None:
        """Record the ``pace`` of a chunk [s per row], and the rows that it left over."""
        self.pace = pace
        self.back.extend(back)
