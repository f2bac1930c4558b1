"""Threads for compiled work, which releases Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from pinograsp import core

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_AT_ONCE, _WORTHWHILE = 2048, 128  # rows per call: an interruption waits for the end of one; less is not worth a thread


def count_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_out(work: Callable[[_Item], _Result], items: Sequence[_Item], threads: int | None) -> list[_Result]:
    """What ``work`` makes of each item, in their order; ``threads``: None: one for each core."""
    threads = count_cores() if threads is None else threads
    if threads == 1 or len(items) < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))


def call_in_parts(name: str, count: int, threads: int | None, given: Mapping[str, object]) -> None:
    """The core's ``name(start, stop, **given)`` for parts of rows 0 to ``count``, on so many threads; None: one for
    each core. Arrays that it fills are contiguous.

    Raises:
        ExtraMissing: the core is not installed.
    """
    compiled, threads = getattr(core.load(), name), count_cores() if threads is None else threads
    given = {key: np.ascontiguousarray(one) if isinstance(one, np.ndarray) else one for key, one in given.items()}
    size = min(_AT_ONCE, max(-(-count // threads), _WORTHWHILE))
    share_out(lambda start: compiled(start, min(start + size, count), **given), range(0, count, size), threads)
