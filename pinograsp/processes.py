"""Work in several processes."""

from __future__ import annotations

import contextlib
import ctypes
import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, NamedTuple, TypeVar, cast

from pinograsp.errors import PinograspError
from pinograsp.interrupts import block_interrupts

_Result = TypeVar("_Result")
_FEW = 4  # at once, of what is short
_DIES_WITH_PARENT = 1  # prctl's PR_SET_PDEATHSIG


@contextlib.contextmanager
def parallel_results(
    function: Callable[..., _Result], arguments: Iterable[tuple[object, ...]], jobs: int, **settings: object
) -> Iterator[Iterator[_Result]]:
    """The results of ``function`` for each of the ``arguments``, in ``jobs`` processes; ``settings`` are joblib's.

    The processes ignore Ctrl-C: they end with the block.
    """
    import multiprocessing.resource_tracker

    import joblib  # slow to import
    from joblib.externals.loky.backend import resource_tracker

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # joblib's, of work that is given up
        for tracker in (resource_tracker, multiprocessing.resource_tracker):
            tracker.ensure_running()  # starting these processes opens signals that are blocked
        with block_interrupts():
            results = joblib.Parallel(n_jobs=jobs, **settings)(joblib.delayed(function)(*each) for each in arguments)
        with contextlib.closing(results):
            yield results


@contextlib.contextmanager
def forked_results(
    function: Callable[..., _Result],
    arguments: Iterable[tuple[object, ...]],
    jobs: int,
    known: Sequence[object] = (),
) -> Iterator[Iterator[_Result]]:
    """The results of ``function`` for each of the ``arguments``, in this order, as they are asked for.

    Copies of this process compute them: they start within milliseconds and need nothing sent, whereas new processes
    import for seconds. Only Linux copies safely, and only the main thread does; elsewhere, with one job, and in what is
    itself such a process, this one computes them. The processes ignore Ctrl-C: they end with the block.

    Args:
        function: computes one result, which can be pickled but for what is ``known``.
        arguments: of its calls.
        jobs: processes; -1: all cores.
        known: objects that results refer to, and that come back as themselves.

    Raises:
        PinograspError: a process was lost.
    """
    work = _Work(function, list(arguments), tuple(known))
    jobs = min(count_processes(jobs), len(work.arguments))
    if jobs < 2:
        yield (function(*each) for each in work.arguments)
        return
    copies = list[_Copy]()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which are those of linear algebra
            with block_interrupts():
                copies.extend(_Copy(work) for _ in range(jobs))
        yield _gather(work, copies)
    finally:
        for copy in copies:
            copy.end()


def count_processes(jobs: int) -> int:
    """How many processes :func:`forked_results` takes for so many ``jobs``."""
    apart = multiprocessing.parent_process() is not None or threading.current_thread() is not threading.main_thread()
    if apart or sys.platform != "linux":
        return 1
    if jobs > 0:
        return jobs
    import joblib  # slow to import

    return int(joblib.effective_n_jobs(jobs))


def count_few() -> int:
    """Processes for what takes each less than a second: as many as cores, at most four."""
    return min(_FEW, os.cpu_count() or 1)


def _gather(work: _Work[_Result], copies: list[_Copy]) -> Iterator[_Result]:
    """The results in order; a copy that is done gets the next call."""
    done: dict[int, tuple[bytes, Exception | None]] = {}
    left = iter(range(len(work.arguments)))
    busy = {copy.ours: i for copy, i in zip(copies, left)}
    try:
        for ours, i in busy.items():
            ours.send(i)
        for i in range(len(work.arguments)):
            while i not in done:
                for ready in wait(list(busy)):
                    ours = cast(Connection, ready)
                    done[busy.pop(ours)] = ours.recv()
                    if (following := next(left, None)) is not None:
                        ours.send(following)
                        busy[ours] = following
            content, error = done.pop(i)
            if error is not None:
                raise error
            yield work.read(content)
    except (EOFError, ConnectionError):
        raise PinograspError("a process was lost, by lack of memory or a crash: try fewer (jobs=1)") from None


class _Work(NamedTuple, Generic[_Result]):
    """What copies of a process compute, and how results come back."""

    function: Callable[..., _Result]
    arguments: list[tuple[object, ...]]
    known: tuple[object, ...]

    def compute(self, i: int) -> bytes:
        content = io.BytesIO()
        _Pickler(content, self.known).dump(self.function(*self.arguments[i]))
        return content.getvalue()

    def read(self, content: bytes) -> _Result:
        result: _Result = _Unpickler(io.BytesIO(content), self.known).load()
        return result


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, known: tuple[object, ...]):
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._known = {id(each): i for i, each in enumerate(known)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._known.get(id(obj))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, known: tuple[object, ...]):
        super().__init__(file)
        self._known = known

    def persistent_load(self, pid: int) -> object:
        return self._known[pid]


class _Copy:
    """A copy of this process, with a pipe of its own, so that it may be ended at any time."""

    def __init__(self, work: _Work[Any]):
        fork = multiprocessing.get_context("fork")
        self.ours, theirs = fork.Pipe()
        self._process = fork.Process(target=_serve, args=(work, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self.ours.close()


def _serve(work: _Work[Any], parent: Connection) -> None:
    """What a copy does, until it is ended: by its parent, or with it, however that ends."""
    ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGKILL)
    while True:
        i = parent.recv()
        answer: tuple[bytes, Exception | None]
        try:
            answer = work.compute(i), None
        except Exception as error:
            answer = b"", error
        parent.send(answer)
