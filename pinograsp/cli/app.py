"""What every command shares: the application, options, and errors told as JSON."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Annotated

import typer

from pinograsp.errors import NoGrasp, PinograspError

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Grasp forces in newtons, joint torques and trajectories for robotic hands.",
)

HELD = ("ok", "unbalanced")  # statuses of plans that are usable

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
    bool, typer.Option("--hulls", help="Convex hulls of the hand's meshes, as physics engines take them: for plans to be checked.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def _version(show: bool) -> None:
    if show:
        from importlib.metadata import version

        typer.echo(f"pinograsp {version('pinograsp')}")
        raise typer.Exit()


@app.callback()
def _main(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors alone; the exit code tells the rest.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the traceback of an error as well.")] = False,
) -> None:
    told["verbose"] = verbose
    if quiet:
        context.with_resource(contextlib.redirect_stdout(context.with_resource(open(os.devnull, "w"))))  # noqa: SIM115


told = {"verbose": False}  # by the options before the command


@contextlib.contextmanager
def errors_told(as_json: bool):
    """With ``--json``, an error of ours is told as one JSON object before it goes on."""
    try:
        yield
    except PinograspError as error:
        if as_json:
            typer.echo(json.dumps({"status": status_of(error), "error": type(error).__name__, "message": str(error)}))
        raise


def status_of(error: PinograspError) -> str:
    solution = getattr(error, "solution", None)
    if solution is not None:
        return str(solution.status)
    return "not_reached" if isinstance(error, NoGrasp) else "invalid_input"


def fresh_folder(name: str, beside: Path = Path("runs")) -> Path:
    """A folder that does not exist yet: NAME, NAME-2, ..."""
    folder, count = beside / name, 1
    while folder.exists():
        count += 1
        folder = beside / f"{name}-{count}"
    return folder
