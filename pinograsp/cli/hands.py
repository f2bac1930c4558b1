"""``pinograsp hands``."""

from __future__ import annotations

from typing import Annotated

import typer

from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions
from pinograsp.cli.screen import RIGHT, columns, command, console, print_table, show, tell
from pinograsp.cli.session import Session
from pinograsp.errors import InvalidInput

_BALL = "sphere:radius=0.03,mass=0.1"
_WIDE = 120  # columns of a terminal that are enough for titles and names of fingers


def hands(
    *,
    name: Annotated[
        str | None,
        typer.Argument(
            help="A hand of the catalogue, or a URDF, xacro or MJCF file; none: the catalogue.",
            autocompletion=completion.complete_hands,
        ),
    ] = None,
    arm: ArmOptions,
    session: Session,
) -> None:
    """List the hands of the catalogue, or describe a hand: fingers, joints, limits, couplings, masses.

    Examples:
      pinograsp hands

      pinograsp hands psyonic_left

      pinograsp hands humanoid --root index_proximal --json

    A file of your own: its path, with --root, --package and --arg where it needs them.
    """
    from pinograsp.hands import load_hand
    from pinograsp.hands.catalogue import CATALOGUE
    from pinograsp.hands.summary import record

    if name is None:
        if arm.root is not None:
            raise InvalidInput("--root needs the NAME of a hand or file")
        if arm != ArmOptions():
            raise InvalidInput(
                "--palm, --finger, --package, --arg, --trusted, --masses, --exclude, --srdf, --posture need the "
                "NAME of a hand or file"
            )
        _list_hands(session)
        return
    hand = load_hand(name, **arm.settings())
    if session.as_json:
        session.print_json(record(hand))
        return
    answer, *details = hand.describe().splitlines()
    tell("\n".join(line.removeprefix("  ") for line in details))
    trying = [(command("plan", "--hand", name, "--object", _BALL), "hold a ball")]
    show([], [("What is it?", answer)], trying if name in CATALOGUE else [])


def _list_hands(session: Session) -> None:
    from pinograsp.hands.summary import cells, overview

    rows, problems = overview()
    if session.as_json:
        session.print_json({"hands": rows, "problems": problems})
        raise typer.Exit(2 if problems else 0)
    names = ["name", "title", "joints", "moving", "mass [kg]", "fingers", "effort limits"]
    listed = [dict(zip(names, cells(row))) for row in rows]
    if columns() < _WIDE:  # keeps each hand on one line
        names.remove("title")
        for cell, row in zip(listed, rows):
            cell["fingers"] = str(len(row["fingers"]))
    justified = {name: RIGHT if name in ("joints", "moving", "mass [kg]") else {} for name in names}
    print_table(
        {name: {**side, "no_wrap": True} for name, side in justified.items()},
        [[cell[name] for name in names] for cell in listed],
    )
    # No empty line before it, and as much as fits: with it the list fills a terminal of 24 lines.
    console().print(f" Next: {command('hands', rows[0]['name'])} tells all of one", style="bold")
    if problems:
        raise InvalidInput("; ".join(problems))
