"""``pinograsp sweep``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli.app import Json, Quiet, Verbose, app, bar, console
from pinograsp.errors import Status

if TYPE_CHECKING:
    from pinograsp.sweep import Sweep


@app.command()
def sweep(
    file: Annotated[
        Path,
        typer.Argument(metavar="SWEEP.yaml", help="Case, fixed inputs (set), grid (over), random draws (samples)."),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder for the rows; default: runs/ and the file's name.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; -1: all cores.")] = -1,
    backend: Annotated[str, typer.Option(help="joblib: this machine, or dask: the cluster of --scheduler.")] = "joblib",
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a Dask scheduler, such as tcp://10.0.0.1:8786.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Plan a case over ranges or random draws of its inputs: a table with a row per plan. After an interruption, the
    same command continues.

    Examples:
      pinograsp sweep friction.yaml

      pinograsp sweep friction.yaml --out runs/friction --jobs 8

      pinograsp sweep friction.yaml --backend dask --scheduler tcp://10.0.0.1:8786
    """
    from pinograsp.checks import one_of
    from pinograsp.sweep import sweep
    from pinograsp.sweep.workers import BACKENDS
    from pinograsp.writing import safe_name

    folder = out if out is not None else Path("runs") / safe_name(file.stem)
    done = sweep(
        file,
        folder,
        jobs=jobs,
        backend=one_of("backend", backend, BACKENDS),
        scheduler=scheduler,
        progress=bar(as_json),
    )
    if as_json:
        typer.echo(json.dumps(done.summary(), allow_nan=False))
    else:
        _print(done)
    if done.interrupted:
        raise typer.Exit(130)
    if not any(done.counts.get(status) for status in Status if status.exit_code == 0):
        raise typer.Exit(3)


def _print(done: Sweep) -> None:
    from rich.table import Table

    screen = console()
    table = Table(box=None, header_style="bold")
    table.add_column("status")
    for name in ("rows", "share"):
        table.add_column(name, justify="right")
    for status, count in sorted(done.counts.items(), key=lambda one: -one[1]):
        table.add_row(status, str(count), f"{100 * count / done.done:.1f} %")
    screen.print(table)
    left = f"; {done.rows - done.done} of {done.rows} are left: the same command continues" if done.interrupted else ""
    screen.print(f"\n{done.done} rows in {done.folder}{left}", soft_wrap=True)
