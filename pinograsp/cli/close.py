"""``pinograsp close``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import typer

from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions, GraspOptions
from pinograsp.cli.plan import SPECS, make_case, search_grasps
from pinograsp.cli.screen import show, tell
from pinograsp.cli.session import REQUIRED, Session, option

if TYPE_CHECKING:
    from pinograsp.contacts import Closure

_thing = partial(option, "What to grasp")


@dataclass(frozen=True, slots=True, kw_only=True)
class PairOptions:
    """A hand, and what it closes on."""

    hand: str = _thing(
        "A hand from the catalogue, or its URDF, xacro or MJCF file.",
        default=REQUIRED,
        complete=completion.complete_hands,
    )
    object: str = _thing(f"Object to close on, such as {SPECS}.", default=REQUIRED, complete=completion.objects)


def close(
    *,
    pair: PairOptions,
    grasp: GraspOptions,
    arm: ArmOptions,
    session: Session,
) -> None:
    """Close a hand on an object: which links touch it where, and what stops each joint.

    Examples:
      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2

      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2 --at 0,0,0.1
    """
    case = make_case(pair.hand, pair.object, {**grasp.settings(), **arm.settings()})
    search = search_grasps(case, session)
    closure = case.closure() if search is None else search.best.closure
    if session.as_json:
        session.print_json(closure.summary())
    else:
        _print_closure(closure)
    if not closure.touches:
        raise typer.Exit(3)


def _print_closure(closure: Closure) -> None:
    """What touches and stops, and at the end how many contacts there are."""
    answer, *others = closure.describe().splitlines()
    tell("\n".join(line.removeprefix("  ") for line in others))
    touching = [("Next", "move the object (--at), or let a place be searched (no --at)")]
    show([], [("Does it touch?", answer), *([] if closure.touches else touching)])
