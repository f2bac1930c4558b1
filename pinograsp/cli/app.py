"""What every command shares: the application and options."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from pinograsp.writing import NewFolder

app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Grasp forces in newtons, joint torques and trajectories for robotic hands.",
)

# Options that commands share.
Root = Annotated[str | None, typer.Option(help="Link whose sub-tree is the hand, on an arm or a robot.")]
At = Annotated[
    str | None, typer.Option(help="Object in the hand's frame, x,y,z\\[,roll,pitch,yaw] \\[m, deg]; default: searched.")
]
Mu = Annotated[float, typer.Option(help="Friction coefficient of the search and the plan.")]
FrictionModel = Annotated[
    str, typer.Option(help="Friction of the search and the plan: pyramid, cone or soft (torsion 5 mm).")
]
Samples = Annotated[int, typer.Option(help="Without --at: placements to try.")]
Seed = Annotated[int, typer.Option(help="Without --at: seed of the placements.")]
Wrap = Annotated[bool, typer.Option("--wrap", help="Wrap the fingers round the object (power grasp).")]
Safety = Annotated[float, typer.Option(help="Friction is used up to mu / safety.")]
Hulls = Annotated[
    bool,
    typer.Option(
        "--hulls", help="Convex hulls of the hand's meshes, as physics engines take them: for plans to be checked."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


told = {"quiet": False, "verbose": False}  # by options before the command or after it


def _hush(context: typer.Context, quiet: bool) -> None:
    if quiet and not told["quiet"]:
        told["quiet"] = True
        context.with_resource(contextlib.redirect_stdout(context.with_resource(open(os.devnull, "w"))))  # noqa: SIM115


def _tell_more(verbose: bool) -> None:
    told["verbose"] |= verbose


Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet", "-q", callback=_hush, expose_value=False, help="Print errors alone; the exit code tells the rest."
    ),
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", callback=_tell_more, expose_value=False, help="Print the traceback of an error as well."
    ),
]


def _version(show: bool) -> None:
    if show:
        from importlib.metadata import version

        typer.echo(f"pinograsp {version('pinograsp')}")
        raise typer.Exit()


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    pass


def bar(as_json: bool) -> bool | None:
    """Whether to show a bar: on terminals, unless less is asked for."""
    return False if as_json or told["quiet"] else None


def console() -> Console:
    """Standard output for tables: as wide as the terminal; a pipe has no width, and gets whole rows."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 150, highlight=False, markup=False)


def new_folder(out: Path | None, force: bool, name: str, beside: Path = Path("runs")) -> NewFolder:
    """``--out``, or a folder that does not exist yet, NAME, NAME-2, ...: kept for this process from now on."""
    from pinograsp.writing import NewFolder

    return NewFolder(out, force=force) if out is not None else NewFolder.fresh(name, beside)
