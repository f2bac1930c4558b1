"""The command ``pinograsp``. Exit codes: 0 done, 2 unusable input, 3 no grasp or a grasp that is lost, 130 interrupted."""

from __future__ import annotations

import traceback

import typer

from pinograsp.cli import bench, check, hands, plan, report, sweep, view  # they register their commands
from pinograsp.cli.app import app, status_of, told
from pinograsp.errors import NoGrasp, PinograspError, Status

__all__ = ["app", "bench", "check", "hands", "main", "plan", "report", "sweep", "view"]


def main() -> None:
    """Entry point: our errors become one message and an exit code, never a traceback."""
    try:
        app(prog_name="pinograsp")
    except PinograspError as error:
        if told["verbose"]:
            traceback.print_exc()
        typer.echo(f"pinograsp: {error}", err=True)
        interrupted = status_of(error) == Status.INTERRUPTED
        raise SystemExit(130 if interrupted else 3 if isinstance(error, NoGrasp) else 2) from None
