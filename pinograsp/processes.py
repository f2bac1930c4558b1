"""Work in several processes."""

from __future__ import annotations

import contextlib
import ctypes
import io
import multiprocessing
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Generic, NamedTuple, TypeVar

from pinograsp.interrupts import interrupts_not_inherited

_Result = TypeVar("_Result")
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
        with interrupts_not_inherited():
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
        BrokenProcessPool: a process was lost.
    """
    work = _Work(function, list(arguments), tuple(known))
    jobs = min(count_processes(jobs), len(work.arguments))
    if jobs < 2:
        yield (function(*each) for each in work.arguments)
        return
    others = set(multiprocessing.active_children())
    fork = multiprocessing.get_context("fork")
    executor = ProcessPoolExecutor(jobs, mp_context=fork, initializer=_take_over, initargs=(work,))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which are those of linear algebra
        with interrupts_not_inherited():
            contents = executor.map(_compute, range(len(work.arguments)))
    try:
        yield map(work.read, contents)
    finally:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        executor.shutdown(cancel_futures=True)


def count_processes(jobs: int) -> int:
    """How many processes :func:`forked_results` takes for so many ``jobs``."""
    import joblib  # slow to import

    apart = multiprocessing.parent_process() is not None or threading.current_thread() is not threading.main_thread()
    return 1 if apart or sys.platform != "linux" else int(joblib.effective_n_jobs(jobs))


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


_work: _Work[Any] | None = None  # of a copy


def _take_over(work: _Work[Any]) -> None:
    """Begin in a copy, which ends with its parent, however that ends."""
    global _work
    ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGKILL)
    _work = work


def _compute(i: int) -> bytes:
    assert _work is not None
    return _work.compute(i)
