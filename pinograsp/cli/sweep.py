"""``pinograsp sweep``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli.options import WorkerOptions, out_option, tell_missing
from pinograsp.cli.screen import RIGHT, command, print_table, show
from pinograsp.cli.session import Session
from pinograsp.errors import Status

if TYPE_CHECKING:
    from pinograsp.sweep import Sweep


def sweep(
    *,
    file: Annotated[
        Path,
        typer.Argument(
            metavar="SWEEP.yaml",
            help="Case, fixed inputs (set), grid (over), random draws (samples); 'pinograsp new' writes one.",
        ),
    ],
    out: Annotated[Path | None, out_option("runs/ and the file's name")] = None,
    workers: WorkerOptions,
    session: Session,
) -> None:
    """Plan a case over ranges or random draws of its inputs: a table with a row per plan. After an interruption, the
    same command continues.

    Examples:
      pinograsp new friction.yaml --sweep

      pinograsp sweep friction.yaml

      pinograsp sweep friction.yaml --out runs/again --jobs 2

    On a cluster of Dask: --executor dask --scheduler tcp://ADDRESS:8786. In a job
    array: --shard I/N.
    """
    from pinograsp.sweep import find_missing_rows, sweep
    from pinograsp.writing import safe_name

    folder = out if out is not None else Path("runs") / safe_name(file.stem)
    if workers.missing:
        tell_missing(find_missing_rows(file, folder, shard=workers.shard), folder, session)
    done = sweep(file, folder, progress=session.progress, **workers.settings())
    usable = any(done.counts.get(status) for status in Status if status.exit_code == 0) or workers.shard is not None
    if session.as_json:
        status = Status.INTERRUPTED if done.interrupted else Status.OK if usable else Status.NOT_FOUND
        session.print_json({"status": str(status), "remedy": status.remedy} | done.summary())
    else:
        _print(done, file, workers.shard)
    if done.interrupted:
        raise typer.Exit(130)
    if not usable:
        raise typer.Exit(3)


def _print(done: Sweep, file: Path, shard: str | None) -> None:
    rows = [
        (status, str(count), f"{100 * count / done.done:.1f} %")
        for status, count in sorted(done.counts.items(), key=lambda one: -one[1])
    ]
    print_table({"status": {}, "rows": RIGHT, "share": RIGHT}, rows, padding=(0, 2, 0, 0))
    good = sum(done.counts.get(status, 0) for status in Status if status.exit_code == 0)
    of = "" if shard is None else f" of shard {shard}"
    answer = f"{good} of {done.done} rows{of} are plans that hold, {done.elapsed:.1f} s"
    if done.interrupted:
        answer += f"; {done.rows - done.done} of {done.rows} are left: the same command continues"
    answers = [("What holds?", answer), ("Results", f"{done.folder}, rows as Parquet files")]
    then = []
    if done.interrupted:
        more = [] if shard is None else ["--shard", shard]
        then.append((command("sweep", file, "--out", done.folder, *more), "go on"))
    else:
        answers.append(("Next", f"in Python: pinograsp.sweep.read_sweep({str(done.folder)!r})"))
    show([], answers, then, level="yes" if good else "no")
