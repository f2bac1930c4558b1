"""Samples of a search in batches, here or in other processes."""

from __future__ import annotations

import itertools
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from pinograsp.errors import InvalidInput, PinograspError
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.processes import forked_results
from pinograsp.synthesis.found import FoundGrasp, hold
from pinograsp.synthesis.near import wider_conditions
from pinograsp.synthesis.samples import Batch, SearchCase, make_batch
from pinograsp.synthesis.setting import REFUSED

_NEAR = 2  # grasps of wider conditions that are kept
_AGAIN = 4  # of the grasps found that are held again under wider conditions
BATCH = 4  # samples, of which the best is refined


def rank(found: list[FoundGrasp]) -> list[FoundGrasp]:
    """Best first."""
    return sorted(found, key=lambda one: one.worth, reverse=True)


def with_bodies(hand: HandModel, body: Body, grasp: FoundGrasp) -> FoundGrasp:
    """A grasp as it came from another process, with its hand and object."""
    closure = replace(grasp.closure, hand=hand.placed(grasp.pose), object=body)
    forces = replace(grasp.forces, problem=replace(grasp.forces.problem, object=body))
    return replace(grasp, closure=closure, forces=forces)


class SearchRun:
    """The batches of a search, here or in other processes."""

    def __init__(self, case: SearchCase, count: int, jobs: int, progress: bool | None):
        self.case, self.jobs = case, jobs
        self.sizes = [min(BATCH, count - i) for i in range(0, count, BATCH)]
        self.found: list[FoundGrasp] = []
        self.outcomes: dict[str, int] = {}
        self.interrupted = False
        disable = None if progress is None else not progress
        self.bar = tqdm(total=0, desc="grasps", unit="sample", disable=disable, leave=False)

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
        work = [(case, each, size) for each, size in zip(seed.spawn(len(sizes)), sizes)]
        with forked_results(_try, work, self.jobs, known=(case.hand, case.body, case.conditions)) as results:
            for batch in results:
                if isinstance(batch, Exception):
                    raise batch
                self.bar.update(len(batch.outcomes))
                yield batch
                interrupt()

    def near(self, seed: np.random.SeedSequence, interrupt: Callable[[], None]) -> tuple[FoundGrasp, ...]:
        """The best grasps of wider conditions, for what is in the way of the given ones: without the limits of forces
        and torques, then with more friction as well. The best of those found, or, where none of them would do, of the
        first round again.
        """
        wider = list(wider_conditions(self.case.conditions))

        def search_again(conditions: GraspConditions) -> list[FoundGrasp]:
            return self.other_round(replace(self.case, conditions=conditions), seed, interrupt)

        for find, conditions in itertools.product((self._hold_again, search_again), wider):
            found = find(conditions)
            if any(one.withstands for one in found):
                return tuple(rank(found)[:_NEAR])
        return ()

    def _hold_again(self, conditions: GraspConditions) -> list[FoundGrasp]:
        """The best of the grasps found under other conditions."""
        case, found = self.case, list[FoundGrasp]()
        for one in rank(self.found)[:_AGAIN]:
            closure = with_bodies(case.hand, case.body, one).closure
            _, again = hold(closure, conditions, impact_time=case.impact_time, wanted_fingers=one.wanted_fingers)
            if again is not None:
                found.append(replace(again, room=one.room, look_o=one.look_o))
        return found


def _try(case: SearchCase, seed: np.random.SeedSequence, size: int) -> Batch | Exception:
    """A batch of samples, or the error that it ended in."""
    try:
        return make_batch(case, np.random.default_rng(seed), size)
    except Exception as error:
        return plain_error(error)


def plain_error(error: Exception) -> PinograspError:
    """An error that survives the way to another process, and says where others' code failed."""
    if isinstance(error, PinograspError):
        return (InvalidInput if isinstance(error, InvalidInput) else PinograspError)(str(error))
    at = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error} (in {at.name}, {at.filename}, line {at.lineno})"
    return PinograspError(f"find_grasps: the search failed with {what}")
