"""Work on all cores, or on a cluster."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import Literal, TypeVar, get_args

from tqdm import tqdm

from pinograsp.errors import ExtraMissing, InvalidInput, PinograspError
from pinograsp.interrupts import interrupts_kept, parallel_results

Backend = Literal["joblib", "dask"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)
_ANSWERED_WITHIN, _CONNECTED_WITHIN = 3, 10  # [s] for the address of a scheduler, and for the scheduler itself
_Result = TypeVar("_Result")


def check_backend(backend: str, scheduler: str | None) -> None:
    """Refuse a scheduler without Dask, and Dask without one."""
    if (backend == "dask") != (scheduler is not None):
        raise InvalidInput("scheduler: expected the address of a Dask scheduler with backend='dask', and only there")


def by_joblib(
    function: Callable[..., _Result], work: Iterator[tuple[object, ...]], jobs: int
) -> Generator[_Result, None, None]:
    """The results of ``function`` for each of the arguments, as they come, in ``jobs`` processes; -1: all cores.

    Raises:
        PinograspError: a process was lost.
    """
    try:
        with parallel_results(function, work, jobs, return_as="generator_unordered", batch_size=1) as results:
            yield from results
    except BrokenProcessPool as error:
        why = str(error).splitlines()[0]
        raise PinograspError(
            f"a worker was lost, by lack of memory or a crash; completed rows are kept: start again ({why})"
        ) from error


def collected(
    results: Generator[_Result, None, None],
    take: Callable[[_Result], object],
    save: Callable[[], None],
    every: float,
    bar: tqdm,
) -> bool:
    """Take the results as they come, and save them ``every`` so many seconds; returns whether Ctrl-C stopped it."""
    saved = time.perf_counter()
    with bar, interrupts_kept() as interrupt:
        try:
            for result in results:
                take(result)
                if time.perf_counter() - saved >= every:
                    save()
                    saved = time.perf_counter()
                interrupt()
        except KeyboardInterrupt:
            return True
        finally:
            save()
    return False


def _check_answer(scheduler: str) -> None:
    """Refuse an address where no scheduler answers: Dask's own client reports that late, or waits for ever."""
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
            if scheme != "tls" and not link.recv(1):  # a scheduler sends first
                raise OSError("the connection was closed")
    except (OSError, UnicodeError) as error:
        raise InvalidInput(
            f"scheduler: expected the address of a running Dask scheduler, got '{scheduler}' ({error})"
        ) from error


def by_dask(
    function: Callable[..., _Result],
    work: Iterator[tuple[object, ...]],
    scheduler: str,
    counted: Callable[[int], None] = lambda workers: None,
) -> Generator[_Result, None, None]:
    """As :func:`by_joblib`, on the cluster of a Dask scheduler; ``counted`` hears of the number of its workers.

    Raises:
        ExtraMissing: distributed (extra ``dask``) is not installed.
        InvalidInput: no scheduler answers.
        PinograspError: workers were lost repeatedly.
    """
    try:
        import distributed
    except ImportError as error:
        raise ExtraMissing(f"work on a cluster needs distributed: pip install 'pinograsp[dask]' ({error})") from error
    _check_answer(scheduler)
    try:
        client = distributed.Client(scheduler, timeout=_CONNECTED_WITHIN, set_as_default=False)
    except Exception as error:  # an unknown server's answer can cause any error
        raise InvalidInput(
            f"scheduler: expected the address of a running Dask scheduler, got '{scheduler}' ({error})"
        ) from error
    with client:
        ahead = distributed.as_completed(loop=client.loop, with_results=True)
        try:
            while True:
                workers = max(1, sum(client.nthreads().values()))
                counted(workers)
                while ahead.count() < 2 * workers and (given := next(work, None)):
                    ahead.add(client.submit(function, *given, pure=False))
                if not ahead.count():
                    return
                yield next(ahead)[1]
        except distributed.scheduler.KilledWorker as error:
            raise PinograspError(
                f"workers were lost repeatedly; completed rows are kept: start again ({error})"
            ) from error
        finally:
            client.cancel([*ahead.futures])
