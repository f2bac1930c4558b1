"""Long work whose rows are stored as they come: on all cores, or on a cluster; interrupted, it can be continued."""

from __future__ import annotations

import contextlib
import itertools
import socket
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args

import joblib
from tqdm import tqdm

from pinograsp.checks import flag, one_of, processes
from pinograsp.errors import ExtraMissing, InvalidInput, PinograspError
from pinograsp.interrupts import interrupts_kept
from pinograsp.processes import parallel_results
from pinograsp.sweep.parts import Parts

Executor = Literal["joblib", "dask"]
EXECUTORS: tuple[Executor, ...] = get_args(Executor)
_SAVED_EVERY = 2.0  # [s] between writes: what may have to be computed again when the process is killed
_ANSWERED_WITHIN, _CONNECTED_WITHIN = 3, 10  # [s] for the address of a scheduler, and for the scheduler itself
_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class Progress:
    """What a bar shows.

    Attributes:
        label: before it.
        unit: that it counts.
        done: rows that are there already.
        total: rows altogether; None: not known.
    """

    label: str
    unit: str
    done: int
    total: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Runner:
    """Who runs long work.

    Attributes:
        jobs: processes; -1: all cores; 1: this process.
        executor: ``"joblib"`` or ``"dask"``.
        scheduler: address of a Dask scheduler, with that and only there.
        progress: bar on stderr: None (on a terminal), True or False.

    Raises:
        InvalidInput: any of them.
    """

    jobs: int = -1
    executor: Executor = "joblib"
    scheduler: str | None = None
    progress: bool | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "jobs", processes(self.jobs))
        one_of("executor", self.executor, EXECUTORS)
        if self.progress is not None:
            flag("progress", self.progress)
        if (self.executor == "dask") != (self.scheduler is not None):
            raise InvalidInput(
                "scheduler: expected the address of a Dask scheduler with executor='dask', and only there"
            )

    def run(
        self,
        function: Callable[..., _Result],
        work: Iterator[tuple[object, ...]],
        parts: Parts,
        take: Callable[[_Result], int],
        progress: Progress,
        employ: Callable[[int], None] = lambda workers: None,
    ) -> bool:
        """Take the results of ``function`` for each of the arguments as they come, and save them every two seconds.

        Args:
            function: of the arguments.
            work: the arguments; it may give more after it has given none, until the last result is taken.
            parts: where ``take`` adds rows.
            take: a result, and returns how many rows it was.
            progress: what the bar shows.
            employ: hears of the number of workers.

        Returns:
            Whether Ctrl-C stopped it.

        Raises:
            PinograspError: workers were lost; saved rows are kept.
        """
        bar = tqdm(
            total=progress.total,
            initial=progress.done,
            desc=progress.label,
            unit=progress.unit,
            disable=None if self.progress is None else not self.progress,
            leave=False,
        )
        saved = time.perf_counter()
        by = self._by_joblib if self.scheduler is None else self._by_dask
        with contextlib.closing(by(function, work, employ)) as results, bar, interrupts_kept() as interrupt:
            try:
                for result in results:
                    bar.update(take(result))
                    if time.perf_counter() - saved >= _SAVED_EVERY:
                        parts.save()
                        saved = time.perf_counter()
                    interrupt()
            except KeyboardInterrupt:
                return True
            finally:
                parts.save()
        parts.merge()
        return False

    def _by_joblib(
        self, function: Callable[..., _Result], work: Iterator[tuple[object, ...]], employ: Callable[[int], None]
    ) -> Generator[_Result, None, None]:
        employ(joblib.effective_n_jobs(self.jobs))
        try:
            while (first := next(work, None)) is not None:
                every = itertools.chain([first], work)
                with parallel_results(
                    function, every, self.jobs, return_as="generator_unordered", batch_size=1
                ) as results:
                    yield from results
        except BrokenProcessPool as error:
            why = str(error).splitlines()[0]
            raise PinograspError(
                f"a worker was lost, by lack of memory or a crash; completed rows are kept: start again ({why})"
            ) from error

    def _by_dask(
        self, function: Callable[..., _Result], work: Iterator[tuple[object, ...]], employ: Callable[[int], None]
    ) -> Generator[_Result, None, None]:
        scheduler = str(self.scheduler)
        try:
            import distributed
        except ImportError as error:
            raise ExtraMissing(
                f"work on a cluster needs distributed: pip install 'pinograsp[dask]' ({error})"
            ) from error
        _check_answer(scheduler)
        try:
            client: Any = distributed.Client(scheduler, timeout=_CONNECTED_WITHIN, set_as_default=False)
        except Exception as error:  # an unknown server's answer can cause any error
            raise InvalidInput(
                f"scheduler: expected the address of a running Dask scheduler, got '{scheduler}' ({error})"
            ) from error
        with client:
            ahead = distributed.as_completed(loop=client.loop, with_results=True)
            try:
                while True:
                    workers = max(1, sum(client.nthreads().values()))
                    employ(workers)
                    while ahead.count() < 2 * workers and (given := next(work, None)):
                        ahead.add(client.submit(function, *given, pure=False))
                    if not ahead.count():
                        return
                    yield next(ahead)[1]
            except distributed.KilledWorker as error:
                raise PinograspError(
                    f"workers were lost repeatedly; completed rows are kept: start again ({error})"
                ) from error
            finally:
                client.cancel([*ahead.futures])


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
