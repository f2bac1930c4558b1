"""A path passed at known speeds."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinograsp.carry.constraints import PathConstraints
from pinograsp.carry.program import CarrySolution
from pinograsp.carry.timing import Timing
from pinograsp.checks import brief
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Passage:
    """A known timing with its constraints, as functions of the square of a factor on its speed.

    Attributes:
        timing: of the path.
        instants: of the samples (N,) [s].
        knots: of the ends of the intervals (N + 1,) [s].
        places: constraints at the samples' places, at any speed.
        constraints: of the timing's loads there.
        level: the factor's square that belongs to ``timing`` [-].
        headroom: how many times as fast each interval may be passed (N,) [-].
        solution: the one that says so; of the fastest timing that timing's, whose forces withstand it.
        fastest: whether it is that, with accelerations that jump.
    """

    timing: Timing
    instants: Array
    knots: Array
    places: PathConstraints
    constraints: PathConstraints
    level: float
    headroom: Array
    solution: CarrySolution
    fastest: bool = False

    __repr__ = brief("timing", "level")

    @property
    def factor(self) -> float:
        """How many times as fast the whole may be passed [-]."""
        return float(self.headroom.min())

    @property
    def s(self) -> Array:
        """Path parameters of the samples (N,)."""
        return self.timing.at(self.instants).s

    def speed_up(self, factor: float) -> Passage:
        """The same way, ``factor`` times as fast."""
        return replace(
            self,
            timing=self.timing.speed_up(factor),
            instants=self.instants / factor,
            knots=self.knots / factor,
            level=self.level * factor**2,
            headroom=self.headroom / factor,
        )
