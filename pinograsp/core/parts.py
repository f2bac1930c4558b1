"""Compiled code for many rows, on threads: it releases Python's lock."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from pinograsp import core

_AT_ONCE, _WORTHWHILE = 2048, 128  # rows per call: an interruption waits for the end of one; less is not worth a thread


def call_in_parts(name: str, count: int, threads: int | None, given: Mapping[str, object]) -> None:
    """The core's ``name(start, stop, **given)`` for parts of rows 0 to ``count``, on so many threads; None: one for
    each core. Arrays that it fills are contiguous.

    Raises:
        ExtraMissing: the core is not installed.
    """
    compiled, threads = getattr(core.load(), name), _cores() if threads is None else threads
    given = {key: np.ascontiguousarray(one) if isinstance(one, np.ndarray) else one for key, one in given.items()}
    size = min(_AT_ONCE, max(-(-count // threads), _WORTHWHILE))
    starts = range(0, count, size)

    def call(start: int) -> None:
        compiled(start, min(start + size, count), **given)

    if threads == 1 or len(starts) < 2:
        for start in starts:
            call(start)
    else:
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(call, starts):
                pass


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
