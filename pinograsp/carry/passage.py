"""A path passed at known speeds, and what is found along it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinograsp.carry.program import CarrySolution
from pinograsp.carry.programs import Programs
from pinograsp.carry.timing import Timing
from pinograsp.checks import brief
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Passage:
    """A known timing with its programs, as functions of the square of a factor on its speed.

    Attributes:
        timing: of the path.
        instants: of the samples (N,) [s].
        knots: of the ends of the intervals (N + 1,) [s].
        places: programs of the samples' places, at any speed.
        programs: of the timing's loads there.
        level: the factor's square that belongs to ``timing`` [-].
        free: how many times as fast each interval may be passed (N,) [-].
        found: the solution that says so; of the fastest timing that timing's, whose forces bear it.
        fastest: whether it is that, with accelerations that jump.
    """

    timing: Timing
    instants: Array
    knots: Array
    places: Programs
    programs: Programs
    level: float
    free: Array
    found: CarrySolution
    fastest: bool = False

    __repr__ = brief("timing", "level")

    @property
    def factor(self) -> float:
        """How many times as fast the whole may be passed [-]."""
        return float(self.free.min())

    def faster(self, factor: float) -> Passage:
        """The same way, ``factor`` times as fast."""
        return replace(
            self,
            timing=self.timing.faster(factor),
            instants=self.instants / factor,
            knots=self.knots / factor,
            level=self.level * factor**2,
            free=self.free / factor,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Held:
    """Forces along a passage.

    Attributes:
        passage: the timing.
        x: forces (N, k, d), as in a force program.
        commanded: normal forces that are commanded (N, k) [N].
        residual: largest error of the balance, over the largest load [-].
        notes: what the caller should know.
    """

    passage: Passage
    x: Array
    commanded: Array
    residual: float
    notes: tuple[str, ...] = ()

    __repr__ = brief("residual")
