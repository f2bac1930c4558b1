"""What is asked of a grasp, as case files and options say it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from pinograsp.cases.sections import CaseSection, NotNegative, Number, Vector
from pinograsp.synthesis import Approach, Wishes
from pinograsp.synthesis.wishes import Side

Corners = tuple[Number, Number, Number, Number, Number, Number]
Part = str | Corners


class ApproachSection(CaseSection):
    """A direction that the hand comes along, see :class:`~pinograsp.synthesis.Approach`."""

    direction: Vector
    cone_deg: Annotated[float, Field(gt=0, le=180)] = 40.0
    frame: Literal["world", "object"] = "world"


def _approach(given: object) -> object:
    """Of a text: a side, or ``x,y,z`` and perhaps ``,cone`` [deg] and ``,object``."""
    if not isinstance(given, str) or "," not in given:
        return given
    words = [word.strip() for word in given.split(",")]
    frame = words.pop() if words[-1] in ("world", "object") else "world"
    cone = {"cone_deg": words[3]} if len(words) == 4 else {}
    if len(words) not in (3, 4):
        raise ValueError(f"expected above, below, side, or x,y,z[,cone in deg][,object], got '{given:.60}'")
    return {"direction": words[:3], "frame": frame, **cone}


def _names(given: object) -> object:
    return [name.strip() for name in given.split(",")] if isinstance(given, str) else given


def _part(given: object) -> object:
    """Of a text: a name, or six numbers."""
    words = given.split(",") if isinstance(given, str) else ()
    return tuple(words) if len(words) == 6 else given


def _parts(given: object) -> object:
    return [given] if isinstance(given, str) else given


PartOrText = Annotated[Part, BeforeValidator(_part)]


class WishesSection(CaseSection):
    """How an object is to be held, see :class:`~pinograsp.synthesis.Wishes`; texts as options give them, too."""

    fingers: Annotated[tuple[str, ...] | None, BeforeValidator(_names)] = None
    least_fingers: Annotated[int, Field(ge=1)] | None = None
    within: PartOrText | None = None
    touching: Annotated[tuple[PartOrText, ...], BeforeValidator(_parts)] = ()
    forbidden: Annotated[tuple[PartOrText, ...], BeforeValidator(_parts)] = ()
    approach: Annotated[Side | ApproachSection | None, BeforeValidator(_approach)] = None
    edges: bool = True
    palm: bool | None = None
    opening: NotNegative = 0.0

    def make(self) -> Wishes:
        """As the search takes them."""
        approach: Side | Approach | None
        if isinstance(self.approach, ApproachSection):
            cone, frame = np.radians(self.approach.cone_deg), self.approach.frame
            approach = Approach(direction=np.array(self.approach.direction), cone=float(cone), frame=frame)
        else:
            approach = self.approach
        return Wishes(
            fingers=self.fingers,
            least_fingers=self.least_fingers,
            within=None if self.within is None else _corners(self.within),
            touching=tuple(map(_corners, self.touching)),
            forbidden=tuple(map(_corners, self.forbidden)),
            approach=approach,
            edges=self.edges,
            palm=self.palm,
            opening=self.opening,
        )


def _corners(part: Part) -> Any:
    return part if isinstance(part, str) else (part[:3], part[3:])
