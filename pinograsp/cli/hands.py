"""``pinograsp hands``."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from pinograsp.cli import completion
from pinograsp.cli.options import ArmOptions
from pinograsp.cli.screen import RIGHT, columns, command, console, print_table, show, tell
from pinograsp.cli.session import Session
from pinograsp.errors import InvalidInput

_BALL = "sphere:radius=0.03,mass=0.1"
_WIDE = 120  # columns of a terminal that are enough for titles and names of fingers


class CommandWithSheet(TyperCommand):
    """Takes ``--drives`` without a file as ``--write-drives``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As its base class."""
        pairs = zip(args, [*args[1:], "-"])
        alone = [one == "--drives" and then.startswith("-") for one, then in pairs]
        return super().parse_args(ctx, ["--write-drives" if flag else one for one, flag in zip(args, alone)])


def hands(
    *,
    name: Annotated[
        str | None,
        typer.Argument(
            help="A hand from the catalogue, menagerie:NAME, robot_descriptions:NAME, or a URDF, xacro or MJCF file; "
            "without a name, the catalogue is listed.",
            autocompletion=completion.complete_hands,
        ),
    ] = None,
    arm: ArmOptions,
    write_drives: Annotated[
        bool,
        typer.Option(
            "--write-drives", help="Print the data sheet of the hand's drives; --drives without a file does the same."
        ),
    ] = False,
    session: Session,
) -> None:
    """List the hands of the catalogue, or describe a hand: fingers, joints, limits, couplings, masses.

    Examples:
      pinograsp hands

      pinograsp hands psyonic_left

      pinograsp hands humanoid --root index_proximal --json

      pinograsp hands so101 --drives

    For your own file, give its path, with --root, --package and --arg if it needs
    them. The names menagerie: and robot_descriptions: list the hands of these two
    packages (extra names).
    """
    from pinograsp.hands import load_hand
    from pinograsp.hands.catalogue import CATALOGUE
    from pinograsp.hands.libraries import LIBRARIES
    from pinograsp.hands.sheets import write_sheet
    from pinograsp.hands.summary import record

    library = next((one for one in LIBRARIES if name == f"{one}:"), None)
    if name is None or library is not None:
        if arm.root is not None:
            raise InvalidInput("--root needs the NAME of a hand or file")
        if arm != ArmOptions() or write_drives:
            raise InvalidInput(
                "--palm, --finger, --package, --arg, --trusted, --masses, --exclude, --srdf, --drives, --posture, "
                "--write-drives need the NAME of a hand or file"
            )
        if library is None:
            _list_hands(session)
        else:
            _list_library(library, session)
        return
    hand = load_hand(name, **arm.settings())
    if write_drives:
        typer.echo(write_sheet(hand.drives, hand.name), nl=False)
        return
    if session.as_json:
        session.print_json(record(hand))
        return
    answer, *details = hand.describe().splitlines()
    tell("\n".join(line.removeprefix("  ") for line in details))
    trying = [(command("plan", "--hand", name, "--object", _BALL), "hold a ball")]
    show([], [("What is it?", answer)], trying if name in CATALOGUE else [])


def _list_hands(session: Session) -> None:
    from pinograsp.hands.libraries import LIBRARIES
    from pinograsp.hands.summary import cells, library_names, overview

    rows, problems = overview()
    if session.as_json:
        session.print_json({"hands": rows, "problems": problems, "others": library_names()})
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
    others = " or ".join(f"{library}:" for library in LIBRARIES)
    console().print(f" Next: {command('hands', rows[0]['name'])}, or {others} for others", style="bold")
    if problems:
        raise InvalidInput("; ".join(problems))


def _list_library(library: str, session: Session) -> None:
    from pinograsp.hands.libraries import list_library

    titles = {f"{library}:{name}": title for name, title in list_library(library).items()}
    if session.as_json:
        session.print_json({"hands": [{"name": name, "title": title} for name, title in titles.items()]})
        return
    print_table({"name": {"no_wrap": True}, "title": {}}, [[name, title] for name, title in titles.items()])
    console().print(f" Next: {command('hands', next(iter(titles)))} (fetches it)", style="bold")
