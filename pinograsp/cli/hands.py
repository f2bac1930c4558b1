"""``pinograsp hands``."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from pinograsp.cli.app import Json, Root, app, errors_told
from pinograsp.errors import InvalidInput


@app.command()
def hands(
    name: Annotated[
        str | None, typer.Argument(help="A hand of the catalogue, or a URDF, xacro or MJCF file; none: the catalogue.")
    ] = None,
    root: Root = None,
    as_json: Json = False,
) -> None:
    """List the hands that need no file, or describe one: fingers, joints, limits, couplings, masses.

    Examples:

      pinograsp hands

      pinograsp hands psyonic_left

      pinograsp hands my_robot.urdf --root palm_link --json
    """
    from pinograsp.hands import load_hand
    from pinograsp.hands.summary import record

    with errors_told(as_json):
        if name is None:
            if root is not None:
                raise InvalidInput("--root needs the NAME of a hand or file")
            _list_hands(as_json)
            return
        hand = load_hand(name, root=root)
    typer.echo(json.dumps(record(hand), allow_nan=False) if as_json else hand.describe())


def _list_hands(as_json: bool) -> None:
    from pinograsp.hands.summary import cells, overview

    rows, problems = overview()
    if as_json:
        typer.echo(json.dumps({"hands": rows, "problems": problems}, allow_nan=False))
        raise typer.Exit(2 if problems else 0)
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold")
    for column in ("name", "title", "joints", "moving", "mass [kg]", "fingers", "effort limits"):
        number = column in ("joints", "moving", "mass [kg]")
        table.add_column(column, justify="right" if number else "left", no_wrap=number or column == "name")
    for row in rows:
        table.add_row(*cells(row))
    Console(width=None if sys.stdout.isatty() else 150, highlight=False, markup=False).print(table)
    if problems:
        raise InvalidInput("; ".join(problems))
