"""``pinograsp close``."""

from __future__ import annotations

import functools
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions, FrictionOptions, GraspOptions
from pinograsp.cli.plan import SPECS, make_case, search_grasps
from pinograsp.cli.screen import show, tell
from pinograsp.cli.session import Session

if TYPE_CHECKING:
    from pinograsp.contacts import Closure

_thing = functools.partial(typer.Option, rich_help_panel="What to grasp")


def close(
    *,
    hand: Annotated[
        str,
        _thing(help="A hand of the catalogue, or its URDF, xacro or MJCF file.", autocompletion=completion.hands),
    ],
    object: Annotated[str, _thing(help=f"What to close on, as {SPECS}.", autocompletion=completion.objects)],
    grasp: GraspOptions,
    friction: FrictionOptions,
    arm: ArmOptions,
    session: Session,
) -> None:
    """Close a hand on an object: which links touch it where, and what stops each joint.

    Examples:
      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2

      pinograsp close --hand panda --object sphere:radius=0.03,mass=0.2 --at 0,0,0.1
    """
    case = make_case(hand, object, {**grasp.settings(), **asdict(friction), **arm.settings()})
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
