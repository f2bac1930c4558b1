"""``pinograsp report``."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli.options import RunFolder
from pinograsp.cli.screen import command, needs, show
from pinograsp.cli.session import Session
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.plan import PlanFailure, PlanRecord
    from pinograsp.plan.answer import Answer


def report(
    *,
    run: RunFolder,
    check: Annotated[
        Path | None, typer.Option(help="Folder of a simulation to include; default: the newest in the run.")
    ] = None,
    session: Session,
) -> None:
    """Rewrite a run's report and figures, with the verdict of its newest simulation.

    Examples:
      pinograsp report runs/paper

      pinograsp report runs/paper --check runs/paper/check
    """
    answer = refresh(run, check)
    if session.as_json:
        session.print_json({"level": answer.level, "answer": answer.text, "folder": str(run)})
        return
    told = [("Does it hold?", answer.text), ("Results", f"{run / 'report.html'}, beside it report.md and figures")]
    show([], told, [(command("view", run), f"look at it in a browser{needs('viz', 'viser')}")], level=answer.level)


def refresh(run: Path, check: Path | None = None, *, redraw: bool = True) -> Answer:
    """Rewrite the report and the figures of a run, with a simulation of it; None: the newest; returns the answer.

    Figures show the plan alone: without ``redraw`` those that are there are taken.
    """
    from pinograsp.plan import PlanFailure
    from pinograsp.plan.answer import does_it_hold, no_grasp
    from pinograsp.report import write_report
    from pinograsp.storage import newest_check, read_check, read_run
    from pinograsp.viz.figures import figure_files, save_figures
    from pinograsp.writing import add_files

    read_run(run, with_scene=False)  # raises its errors before anything is written
    answers: list[Answer] = []

    def fill(path: Path) -> None:
        # Read again, now that the folder is locked: it may have been replaced.
        loaded = _read(run)
        if isinstance(loaded, PlanFailure):
            write_report(loaded, path)
            answers.append(no_grasp(loaded.status))
            return
        found = check if check is not None else newest_check(run)
        simulation = None if found is None else read_check(found)
        names = figure_files(loaded)
        if redraw or not all((run / name).is_file() for name in names):
            save_figures(loaded, path)
        else:
            for name in names:
                shutil.copyfile(run / name, path / name)
        write_report(loaded, path, names, simulation)
        answers.append(does_it_hold(loaded, simulation))

    add_files(run, fill)
    return answers[-1]


def _read(run: Path) -> PlanRecord | PlanFailure:
    """A run with its hand; without it where that cannot be read: the picture of the grasp alone needs it."""
    from pinograsp.storage import read_run

    try:
        return read_run(run)
    except InvalidInput:  # HandNotLoaded, too
        return read_run(run, with_scene=False)
