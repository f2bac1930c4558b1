"""The application: its commands in the order in which they are used."""

from __future__ import annotations

from typing import Annotated

import typer

from pinograsp.cli.bench import bench
from pinograsp.cli.carry import carry
from pinograsp.cli.certify import certify
from pinograsp.cli.check import check
from pinograsp.cli.close import close
from pinograsp.cli.export import export
from pinograsp.cli.hands import CommandWithSheet, hands
from pinograsp.cli.identify import identify
from pinograsp.cli.new import new
from pinograsp.cli.pick import pick
from pinograsp.cli.plan import CommandWithObjects, plan
from pinograsp.cli.report import report
from pinograsp.cli.ros2 import ros2
from pinograsp.cli.screen import tell_missing_core
from pinograsp.cli.session import Quiet, Verbose, as_command
from pinograsp.cli.sweep import sweep
from pinograsp.cli.view import view

_PANELS = {
    "Plan": (hands, new, plan, close, check, carry, pick),
    "Use a plan": (export, report, view),
    "A real hand": (identify,),
    "Many at once": (certify, sweep),
    "This machine": (bench,),
}
_KINDS = {plan: CommandWithObjects, close: CommandWithObjects, pick: CommandWithObjects, hands: CommandWithSheet}


def _print_version(show: bool) -> None:
    if show:
        from importlib.metadata import version

        typer.echo(f"pinograsp {version('pinograsp')}")
        tell_missing_core()
        raise typer.Exit()


def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    pass


def _make_app() -> typer.Typer:
    application = typer.Typer(
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        help="Grasp forces in newtons, joint torques and trajectories for robotic hands.",
    )
    application.callback()(_main)
    for panel, functions in _PANELS.items():
        for function in functions:
            kind = _KINDS.get(function)
            application.command(cls=kind, rich_help_panel=panel)(as_command(function))
    application.add_typer(ros2, name="ros2", rich_help_panel="A real hand")
    return application


app = _make_app()
