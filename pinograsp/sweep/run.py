"""Many plans of one case over ranges or random draws of its inputs, on all cores or on a cluster."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
from tqdm import tqdm

from pinograsp.cases.sweep_file import SweepSpec, load_sweep
from pinograsp.checks import one_of, processes
from pinograsp.errors import ExtraMissing, InvalidInput, PinograspError
from pinograsp.interrupts import interrupts_kept, parallel_results
from pinograsp.spatial import Array
from pinograsp.sweep.rows import FIGURES, kind_of, run_chunk
from pinograsp.sweep.store import Store, read_sweep

BACKENDS = ("joblib", "dask")
_SAVED_EVERY = 2.0  # [s] of rows that a kill may lose
_CHUNK = 0.3  # [s] of work handed over at once: long beside the handing over, short beside what is waited for
_MOST_AT_ONCE = 2000  # rows of a chunk
_ANSWERED_WITHIN, _CONNECTED_WITHIN = 3, 10  # [s] at the address of a scheduler, and by the scheduler itself


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """What came of a sweep; the rows themselves are in its folder, :meth:`table` reads them.

    Attributes:
        folder: with the rows.
        rows: asked for.
        done: there, those of earlier runs included.
        counts: of the rows by status.
        interrupted: whether it was stopped (Ctrl-C): the same call goes on.
        elapsed: of this run [s].
    """

    folder: Path
    rows: int
    done: int
    counts: dict[str, int]
    interrupted: bool
    elapsed: float

    def table(self):
        """The rows in order, a ``pyarrow.Table``: see :func:`read_sweep`."""
        return read_sweep(self.folder)

    def summary(self) -> dict:
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
    spec: SweepSpec | dict | str | Path,
    folder: str | Path,
    *,
    jobs: int = -1,
    backend: str = "joblib",
    scheduler: str | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Plan a case over ranges or random draws of its inputs, a row each; called again, it goes on where it was stopped.

    Rows: ``index``, the inputs by name, ``status`` and ``message``, and figures
    (:data:`~pinograsp.sweep.rows.FIGURES`). A plan that fails is a row as well: its status is that of the plan or its
    search (``infeasible``, ``joint_limit``...), ``not_reached`` (a finger cannot reach its contact), ``not_found`` (no
    placement), ``invalid_input`` (values that cannot be used) or ``failed`` (anything else), and the message says why.
    With ``what: forces`` only contact forces at a given impact time are computed, in bulk.

    Args:
        spec: a sweep file, the same as a mapping, or what :func:`~pinograsp.cases.sweep_file.load_sweep` has read.
        folder: for the rows: Parquet files, written every two seconds, whole or not at all; a new folder, or one of
            this sweep.
        jobs: processes of ``"joblib"``; -1: all cores. 1: this process.
        backend: ``"joblib"``, or ``"dask"``: the cluster of ``scheduler``, an address such as
            ``"tcp://10.0.0.1:8786"``; its workers need this package, and the files of hands and meshes at the same
            paths.
        progress: bar on stderr: None (on a terminal), True or False.

    Raises:
        CaseRejected: a sweep or case that cannot be used.
        InvalidInput: jobs, backend or scheduler.
        ResultsNotWritten: the folder holds another sweep or other files, is in use, or cannot be written.
        ExtraMissing: pyarrow (extra ``sweep``), distributed (``dask``) or, for forces alone, numba (``fast``) is not
            installed.
        PinograspError: workers were lost; what was done is kept.
    """
    started = time.perf_counter()
    jobs = processes(jobs)
    one_of("backend", backend, BACKENDS)
    if (backend == "dask") != (scheduler is not None):
        raise InvalidInput("scheduler: expected the address of a Dask scheduler with backend='dask', and only there")
    spec = spec if isinstance(spec, SweepSpec) else load_sweep(spec)
    payload = spec.base.model_dump_json()
    kinds = {key: kind_of(values) for key, values in spec.inputs.items()}
    with Store(Path(folder), spec.settings(), spec.rows, {**kinds, **FIGURES[spec.what]}) as store:
        chunks = _Chunks(spec, np.flatnonzero(~store.have))
        if backend == "dask":
            results, chunks.workers = _by_dask(scheduler, payload, chunks), 1
        else:
            results, chunks.workers = _by_joblib(jobs, payload, chunks), joblib.effective_n_jobs(jobs)
        bar = tqdm(
            total=spec.rows,
            initial=spec.rows - len(chunks),
            desc="sweep",
            unit="row",
            disable=None if progress is None else not progress,
            leave=False,
        )
        interrupted, saved = False, time.perf_counter()
        with bar, contextlib.closing(results), interrupts_kept() as interrupt:
            try:
                for rows, seconds, left in results:
                    chunks.told(seconds / len(rows), left)
                    store.add(rows)
                    bar.update(len(rows))
                    if time.perf_counter() - saved >= _SAVED_EVERY:
                        store.save()
                        saved = time.perf_counter()
                    interrupt()
            except KeyboardInterrupt:
                interrupted = True
            finally:
                store.save()
        if not interrupted:
            store.merge()
        return Sweep(
            folder=Path(folder),
            rows=spec.rows,
            done=store.done,
            counts=dict(store.counts),
            interrupted=interrupted,
            elapsed=time.perf_counter() - started,
        )


class _Chunks:
    """The rows that are left, in chunks of equal work; workers give back what takes too long."""

    def __init__(self, spec: SweepSpec, left: Array):
        self.spec, self.left, self.at, self.back = spec, left, 0, deque()
        self.workers, self.pace = 1, math.inf

    def __len__(self) -> int:
        return len(self.left) - self.at + len(self.back)

    def __iter__(self) -> _Chunks:
        return self

    def __next__(self) -> list[tuple[int, dict]]:
        left = len(self)
        if not left:
            raise StopIteration
        # At the end smaller ones, so that no worker waits long for another.
        count = max(1, min(int(_CHUNK / max(self.pace, 1e-9)), _MOST_AT_ONCE, left // (2 * self.workers)))
        rows = [self.back.popleft() for _ in range(min(count, len(self.back)))]
        start = self.at
        self.at = min(start + count - len(rows), len(self.left))
        return [(index, self.spec.row(index)) for index in (*rows, *self.left[start : self.at].tolist())]

    def told(self, pace: float, back: list[int]) -> None:
        """``pace`` [s per row] of a chunk, and the rows it did not come to."""
        self.pace = pace
        self.back.extend(back)


def _by_joblib(jobs: int, payload: str, chunks: _Chunks) -> Iterator[tuple[list[dict], float, list[int]]]:
    try:
        while len(chunks):  # rows may have come back when all chunks had been handed over
            work = ((payload, rows) for rows in chunks)
            with parallel_results(run_chunk, work, jobs, return_as="generator_unordered", batch_size=1) as results:
                yield from results
    except BrokenProcessPool as error:
        why = str(error).splitlines()[0]
        raise PinograspError(
            f"a worker was lost, by lack of memory or a crash; what is done is kept: start again ({why})"
        ) from error


def _check_answer(scheduler: str) -> None:
    """Refuse an address where no scheduler speaks: Dask's own client says so late and at length, or waits for ever."""
    scheme, _, rest = scheduler.rpartition("://")
    host, _, port = rest.rpartition(":")
    if not host or not (port.isascii() and port.isdecimal()) or not 1 <= int(port) <= 65535:
        raise InvalidInput(
            f"scheduler: expected an address with a port from 1 to 65535, as tcp://10.0.0.1:8786, got '{scheduler}'"
        )
    if scheme not in ("", "tcp", "tls"):
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWERED_WITHIN) as link:
            if scheme != "tls" and not link.recv(1):  # a scheduler speaks first
                raise OSError("what is there hangs up")
    except (OSError, UnicodeError) as error:
        raise InvalidInput(
            f"scheduler: expected the address of a running Dask scheduler, got '{scheduler}' ({error})"
        ) from error


def _by_dask(scheduler: str, payload: str, chunks: _Chunks) -> Iterator[tuple[list[dict], float, list[int]]]:
    try:
        import distributed
    except ImportError as error:
        raise ExtraMissing(f"sweeps on a cluster need distributed: pip install 'pinograsp[dask]' ({error})") from error
    _check_answer(scheduler)
    try:
        client = distributed.Client(scheduler, timeout=_CONNECTED_WITHIN, set_as_default=False)
    except Exception as error:  # whatever comes of a stranger's answer
        raise InvalidInput(
            f"scheduler: expected the address of a running Dask scheduler, got '{scheduler}' ({error})"
        ) from error
    with client:
        ahead = distributed.as_completed(loop=client.loop, with_results=True)
        try:
            while True:
                chunks.workers = max(1, sum(client.nthreads().values()))
                while ahead.count() < 2 * chunks.workers and (rows := next(chunks, None)):
                    ahead.add(client.submit(run_chunk, payload, rows, pure=False))
                if not ahead.count():
                    return
                yield next(ahead)[1]
        except distributed.scheduler.KilledWorker as error:
            raise PinograspError(
                f"a worker was lost again and again; what is done is kept: start again ({error})"
            ) from error
        finally:
            client.cancel([*ahead.futures])
