"""Ctrl-C in long work: handled once, and not lost."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType


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
def block_interrupts() -> Iterator[None]:
    """Processes that are started here ignore Ctrl-C, which goes to all that a terminal runs."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
