"""Samples of a search in batches, here or in other processes."""

from __future__ import annotations

import contextlib
import functools
import pickle
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pinograsp.contacts.advance import PreparedClosing
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.errors import InvalidInput, PinograspError
from pinograsp.interrupts import parallel_results
from pinograsp.synthesis.found import FoundGrasp
from pinograsp.synthesis.near import wider_conditions
from pinograsp.synthesis.prepared_hand import hand_of_hulls, scene_of
from pinograsp.synthesis.samples import Batch, SearchCase, make_batch
from pinograsp.synthesis.setting import REFUSED
from pinograsp.writing import write_errors

_NEAR = 2  # grasps of wider conditions that are kept
BATCH = 4  # samples, of which the best is refined
_POOL, _PROCESS = 4.0, 0.5  # [s] that it takes other processes to start, and to take up a case


def rank(found: list[FoundGrasp]) -> list[FoundGrasp]:
    """Best first."""
    return sorted(found, key=lambda one: one.worth, reverse=True)


class SearchRun:
    """The batches of a search, here or in other processes."""

    def __init__(self, case: SearchCase, count: int, jobs: int, progress: bool | None):
        self.case, self.jobs = case, jobs
        self.sizes = [min(BATCH, count - i) for i in range(0, count, BATCH)]
        self.found: list[FoundGrasp] = []
        self.outcomes: dict[str, int] = {}
        self.interrupted = False
        self.folder: str | None = None
        self.spent, self.done, self.started = 0.0, 0, False  # [s] and batches here; whether there are processes
        disable = None if progress is None else not progress
        self.bar = tqdm(total=0, desc="grasps", unit="sample", disable=disable, leave=False)

    @contextlib.contextmanager
    def on_disk(self) -> Iterator[None]:
        """With a folder for the case, from which other processes read it."""
        with tempfile.TemporaryDirectory() as folder:
            self.folder = folder
            yield

    def batches(self, seed: np.random.SeedSequence, interrupt: Callable[[], None], *, wrap: bool) -> None:
        """One round of samples."""
        case = replace(self.case, wrap=wrap)
        for batch in self._round(case, seed, interrupt, self.sizes):
            for outcome in batch.outcomes:
                self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1
            if batch.grasp is not None:
                self.found.append(batch.grasp)
        interrupt()

    @property
    def has_no_room(self) -> bool:
        """Whether there was room for none of the samples."""
        return all(what.startswith(REFUSED) for what in self.outcomes)

    def other_round(
        self,
        case: SearchCase,
        seed: np.random.SeedSequence,
        interrupt: Callable[[], None],
        batches: int | None = None,
    ) -> list[FoundGrasp]:
        """What one round of samples of another case finds, or so many whole ``batches``."""
        sizes = self.sizes if batches is None else [BATCH] * batches
        results = self._round(case, seed, interrupt, sizes)
        return [batch.grasp for batch in results if batch.grasp is not None]

    def _round(
        self, case: SearchCase, seed: np.random.SeedSequence, interrupt: Callable[[], None], sizes: Sequence[int]
    ) -> Iterator[Batch]:
        """Batches of these sizes, told to the bar; between them the search may be stopped."""
        self.bar.total += sum(sizes)
        for batch in self._results(case, seed, sizes):
            self.bar.update(len(batch.outcomes))
            yield batch
            interrupt()

    def near(self, seed: np.random.SeedSequence, interrupt: Callable[[], None]) -> tuple[FoundGrasp, ...]:
        """The best grasps of wider conditions, for what is in the way of the given ones: the first round again
        without the limits of forces and torques, then with more friction as well.
        """
        for conditions in wider_conditions(self.case.conditions):
            found = self.other_round(replace(self.case, conditions=conditions), seed, interrupt)
            if any(one.withstands for one in found):
                return tuple(rank(found)[:_NEAR])
        return ()

    def _results(self, case: SearchCase, seed: np.random.SeedSequence, sizes: Sequence[int]) -> Iterator[Batch]:
        work = list(zip(seed.spawn(len(sizes)), sizes))
        for i, (batch, size) in enumerate(work):
            if self._pays(len(work) - i):
                yield from self._results_elsewhere(case, work[i:])
                return
            started = time.perf_counter()
            result = _try(case, batch, size)
            self.spent, self.done = self.spent + time.perf_counter() - started, self.done + 1
            yield _unwrap(result)

    def _pays(self, batches: int) -> bool:
        """Whether other processes, which take a while to start, are done with so many batches before this one is."""
        import joblib  # slow to import

        jobs = min(joblib.effective_n_jobs(self.jobs), batches)
        if jobs < 2 or not self.done:
            return False
        start = _PROCESS if self.started else _POOL
        return bool(self.spent / self.done * batches * (1.0 - 1.0 / jobs) > start)

    def _results_elsewhere(self, case: SearchCase, work: list[tuple[np.random.SeedSequence, int]]) -> Iterator[Batch]:
        path = Path(str(self.folder)) / f"case-{self.bar.total}.pickle"
        task, self.started = _in_a_file(case, path), True
        calls = ((task, batch, size) for batch, size in work)
        with parallel_results(_try, calls, self.jobs, return_as="generator") as results:
            yield from map(_unwrap, results)


def _in_a_file(case: SearchCase, path: Path) -> str:
    """Write the case to a file, for other processes; its name."""
    import cloudpickle

    try:
        # Found again there.
        content = cloudpickle.dumps(replace(case, rough=case.hand, scene=None, closing=None))  # type: ignore[arg-type]
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise InvalidInput(
            f"find_grasps: hand, object or conditions cannot go to other processes ({error}): use jobs=1"
        ) from None
    with write_errors(path):
        path.write_bytes(content)
    return str(path)


@functools.lru_cache(maxsize=1)
def _case(path: str) -> SearchCase:
    case: SearchCase = pickle.loads(Path(path).read_bytes())
    rough = hand_of_hulls(case.hand)
    closing = PreparedClosing(rough, case.body, collisions=SelfCollisions(case.hand))
    return replace(case, rough=rough, scene=scene_of(rough, case.body), closing=closing)


def _try(case: SearchCase | str, seed: np.random.SeedSequence, size: int) -> Batch | Exception:
    """A batch of samples, or the error that it ended in."""
    try:
        return make_batch(_case(case) if isinstance(case, str) else case, np.random.default_rng(seed), size)
    except Exception as error:
        return plain_error(error)


def _unwrap(batch: Batch | Exception) -> Batch:
    if isinstance(batch, Exception):
        raise batch
    return batch


def plain_error(error: Exception) -> PinograspError:
    """An error that survives the way to another process, and says where others' code failed."""
    if isinstance(error, PinograspError):
        return (InvalidInput if isinstance(error, InvalidInput) else PinograspError)(str(error))
    at = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error} (in {at.name}, {at.filename}, line {at.lineno})"
    return PinograspError(f"find_grasps: the search failed with {what}")
