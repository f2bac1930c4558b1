"""Where the figures of a drive come from: a manual, a measurement, a file; or nowhere, which makes them guesses."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from pinograsp.checks import brief, flag, floats_of, one_of, shorten, text_of
from pinograsp.errors import InvalidInput

Figure: TypeAlias = Literal[
    "limit",
    "continuous",
    "floor",
    "stiffness",
    "damping",
    "step",
    "effort_step",
    "backlash",
    "friction",
    "latency",
    "closing",
    "contact_stiffness",
]

_DATE = re.compile(r"\d{4}(-\d{2}(-\d{2})?)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """The source of one figure of a drive.

    Attributes:
        figure: its name in :class:`~pinograsp.hands.drives.Drive`.
        text: the manual, paper or file; for a guess, its basis.
        guess: whether the figure is neither published nor measured.
        interval: range in which it varies between units or settings; None: not known.
        date: when it was measured or published, such as 2026-11 or 2026-11-28; "": not known.

    Raises:
        InvalidInput: the values do not describe a source.
    """

    figure: Figure
    text: str
    guess: bool = False
    interval: tuple[float, float] | None = None
    date: str = ""

    __repr__ = brief()

    def __post_init__(self) -> None:
        one_of("figure of a source", self.figure, get_args(Figure))
        if not text_of(f"source of a {self.figure}", self.text):
            raise InvalidInput(f"source of a {self.figure}: expected a text, got an empty one: say where it comes from")
        flag(f"guess of the source of a {self.figure}", self.guess)
        if self.date and not _DATE.fullmatch(text_of(f"date of the source of a {self.figure}", self.date)):
            raise InvalidInput(
                f"date of the source of a {self.figure}: expected YYYY, YYYY-MM or YYYY-MM-DD, got {shorten(self.date)}"
            )
        if self.interval is not None:
            ends = floats_of(f"interval of a {self.figure}", self.interval)
            if ends.shape != (2,) or not 0 <= ends[0] <= ends[1] < math.inf:
                raise InvalidInput(
                    f"interval of a {self.figure}: expected the least and the largest value, from 0 on, got "
                    f"{shorten(ends.tolist())}"
                )
            object.__setattr__(self, "interval", (float(ends[0]), float(ends[1])))

    def __str__(self) -> str:
        """The figure, its interval and where it comes from, in words."""
        between = "" if self.interval is None else f" ({self.interval[0]:g} to {self.interval[1]:g})"
        when = f" ({self.date})" if self.date else ""
        return f"{self.figure}{between}: {'a guess, ' if self.guess else ''}{self.text}{when}"


def unlike(sources: Iterable[tuple[Source, ...]]) -> list[Source]:
    """All sources of several drives, each once."""
    return list(dict.fromkeys(source for one in sources for source in one))
