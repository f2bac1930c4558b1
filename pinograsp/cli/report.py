"""``pinograsp report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pinograsp.cli.app import Quiet, Verbose, app


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run, as `pinograsp plan` writes it.")],
    check: Annotated[
        Path | None, typer.Option(help="Folder of a simulation to tell about; default: the newest below the run.")
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a run's report and figures again, with the verdict of its newest simulation.

    Examples:
      pinograsp report runs/paper

      pinograsp check runs/paper && pinograsp report runs/paper
    """
    from pinograsp.report import write_report
    from pinograsp.storage import load_check, load_run, newest_check
    from pinograsp.viz.figures import save_figures
    from pinograsp.words import does_it_hold
    from pinograsp.writing import add_files

    load_run(run)  # says what is wrong with it before anything is made

    told = []

    def fill(path: Path) -> None:
        loaded = load_run(run)  # that of the folder in which the files are to be: another may have taken its place
        found = check if check is not None else newest_check(run)
        figures = [figure.name for figure in save_figures(loaded, path)] if loaded.arrays else []
        verdict = None if found is None else load_check(found)[0]
        write_report(loaded, path, figures, verdict)
        told.append(
            does_it_hold(loaded.summary, verdict).text if loaded.arrays else f"No grasp ({loaded.summary['status']})."
        )

    add_files(run, fill)
    typer.echo(f"Does it hold? {told[-1]}")
    typer.echo(f"written to {run}: report.html, report.md and figures")
