"""Ctrl-C in long work: handled once, and not lost."""

from __future__ import annotations

import contextlib
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from types import FrameType
from typing import TypeVar

_Result = TypeVar("_Result")


@contextlib.contextmanager
def interrupts_kept() -> Iterator[Callable[[], None]]:
    """Ctrl-C raises ``KeyboardInterrupt`` at once, or, where that would be lost, in the next call of what this gives.

    Python prints exceptions raised in destructors, of finished progress bars for instance, and goes on: a Ctrl-C in
    that moment would not stop anything. Outside the main thread, and under another handler, nothing
    changes.
    """
    waiting = False

    def hear(number: int, frame: FrameType | None) -> None:
        nonlocal waiting
        waiting = True
        while frame is not None:
            if frame.f_code.co_name == "__del__":
                return
            frame = frame.f_back
        raise KeyboardInterrupt

    def check() -> None:
        if waiting:
            raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    ours = before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, hear)
    try:
        yield check
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def parallel_results(
    function: Callable[..., _Result], arguments: Iterable[tuple[object, ...]], jobs: int, **settings: object
) -> Iterator[Iterator[_Result]]:
    """The results of ``function`` for each of the ``arguments``, in ``jobs`` processes; ``settings`` are joblib's.

    The processes ignore Ctrl-C, which goes to all that a terminal runs: they end with the block.
    """
    import multiprocessing.resource_tracker

    import joblib  # slow to import
    from joblib.externals.loky.backend import resource_tracker

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # joblib's, of work that is given up
        for tracker in (resource_tracker, multiprocessing.resource_tracker):
            tracker.ensure_running()  # starting these processes opens signals that are blocked
        with _interrupts_not_inherited():
            results = joblib.Parallel(n_jobs=jobs, **settings)(joblib.delayed(function)(*each) for each in arguments)
        with contextlib.closing(results):
            yield results


@contextlib.contextmanager
def _interrupts_not_inherited() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
