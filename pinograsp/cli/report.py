"""``pinograsp report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli.app import Quiet, Verbose, app
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.plan import PlanFailure, PlanRecord


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run, as `pinograsp plan` writes it.")],
    check: Annotated[
        Path | None, typer.Option(help="Folder of a simulation to include; default: the newest in the run.")
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Rewrite a run's report and figures, with the verdict of its newest simulation.

    Examples:
      pinograsp report runs/paper

      pinograsp check runs/paper && pinograsp report runs/paper
    """
    from pinograsp.plan import PlanFailure
    from pinograsp.plan.answer import does_it_hold
    from pinograsp.report import write_report
    from pinograsp.storage import newest_check, read_check, read_run
    from pinograsp.viz.figures import save_figures
    from pinograsp.writing import add_files

    read_run(run, with_scene=False)  # raises its errors before anything is written

    answers = []

    def fill(path: Path) -> None:
        # Read again, now that the folder is locked: it may have been replaced.
        loaded = _read(run)
        if isinstance(loaded, PlanFailure):
            write_report(loaded, path)
            answers.append(f"No grasp ({loaded.status}).")
            return
        found = check if check is not None else newest_check(run)
        simulation = None if found is None else read_check(found)
        write_report(loaded, path, [figure.name for figure in save_figures(loaded, path)], simulation)
        answers.append(does_it_hold(loaded, simulation).text)

    add_files(run, fill)
    typer.echo(f"Does it hold? {answers[-1]}")
    typer.echo(f"written to {run}: report.html, report.md and figures")


def _read(run: Path) -> PlanRecord | PlanFailure:
    """A run with its hand; without it where that cannot be read: the picture of the grasp alone needs it."""
    from pinograsp.storage import read_run

    try:
        return read_run(run)
    except InvalidInput:  # HandNotLoaded, too
        return read_run(run, with_scene=False)
