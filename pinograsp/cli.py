"""The command ``pinograsp``. Exit codes: 0 a plan, 2 unusable input, 3 no grasp, 130 interrupted."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from pinograsp.errors import GraspInfeasible, NoGrasp, PinograspError, Status

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Grasp forces in newtons, joint torques and trajectories for robotic hands.",
)

_DONE = ("ok", "unbalanced")


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
) -> None:
    pass


@app.command()
def plan(
    case: Annotated[str, typer.Argument(help="A built-in case ('paper') or a case file (YAML).")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default: a new one, runs/NAME, runs/NAME-2, ...")
    ] = None,
    search: Annotated[str | None, typer.Option(help="hybrid, paper, paper+qp (grids) or convex (certified optimum).")] = None,
    balance: Annotated[str | None, typer.Option(help="force (the paper) or wrench (forces and moments).")] = None,
    measure: Annotated[str | None, typer.Option(help="impulse [N s] or work [J].")] = None,
    solver: Annotated[str | None, typer.Option(help="auto, daqp, proxqp, osqp, quadprog, piqp or clarabel.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a value of the case; repeatable.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier run in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Plan a grasp: contact forces, joint torques, trajectories, figures and a report.

    Examples:

      pinograsp plan paper

      pinograsp plan paper --search convex --balance wrench --measure work --out runs/wrench

      pinograsp plan paper --set object.mass=1.1 --set friction.mu=0.8 --json
    """
    options = {"search": search, "balance": balance, "measure": measure, "solver": solver}
    try:
        _plan(case, out, options, changes, force, as_json)
    except PinograspError as error:
        if as_json:
            typer.echo(json.dumps({"status": _status_of(error), "error": type(error).__name__, "message": str(error)}))
        raise
    except KeyboardInterrupt:
        typer.echo("pinograsp: interrupted, nothing written", err=True)
        raise typer.Exit(130) from None


def _status_of(error: PinograspError) -> str:
    solution = getattr(error, "solution", None)
    if solution is not None:
        return str(solution.status)
    return "not_reached" if isinstance(error, NoGrasp) else "invalid_input"


def _plan(case: str, out: Path | None, options: dict, changes: list[str] | None, force: bool, as_json: bool) -> None:
    from pinograsp.cases import load_case
    from pinograsp.storage import check_folder, run_of, save_run

    loaded = load_case(case, changes)
    chosen = {f"forces.{key}": value for key, value in options.items() if value is not None}
    if chosen:
        loaded = load_case(case, [*(changes or []), *(f'{key}="{value}"' for key, value in chosen.items())])
    folder = out if out is not None else _fresh_folder(loaded.name)
    check_folder(folder, force)
    try:
        planned = loaded.plan(progress=False if as_json else None)
    except GraspInfeasible as error:
        # A proof is a result: it is kept like one. A grid that found nothing proves nothing.
        if error.solution.search == "convex" and error.solution.status is Status.INFEASIBLE:
            _keep_proof(error, loaded, folder, force)
        raise
    run = run_of(planned, loaded.settings())
    comparison = []
    if case == "paper":
        from pinograsp.cases.published import compare

        comparison = compare(loaded, planned)

    def extras(path: Path) -> None:
        from pinograsp.report import markdown
        from pinograsp.viz.figures import save_figures

        figures = [figure.name for figure in save_figures(run, path)]
        (path / "report.md").write_text(markdown(run, comparison, figures), encoding="utf-8")

    save_run(run, folder, force=force, extras=extras)
    if as_json:
        typer.echo(json.dumps({**run.summary, "folder": str(folder)}, allow_nan=False))
    else:
        _print(run, comparison, folder)
    if run.summary["status"] == "interrupted":
        raise typer.Exit(130)
    if run.summary["status"] not in _DONE:
        raise typer.Exit(3)


def _keep_proof(error, loaded, folder: Path, force: bool) -> None:
    from pinograsp.report import failure
    from pinograsp.storage import run_of_failure, save_run

    layout = {"hand": loaded.hand.source, "contacts": [contact.finger for contact in loaded.contacts]}
    run = run_of_failure(error, layout, loaded.settings())
    save_run(run, folder, force=force, extras=lambda path: (path / "report.md").write_text(failure(run), encoding="utf-8"))
    typer.echo(f"the proof is written to {folder}: report.md, plan.json", err=True)


def _fresh_folder(name: str) -> Path:
    folder, count = Path("runs") / name, 1
    while folder.exists():
        count += 1
        folder = Path("runs") / f"{name}-{count}"
    return folder


def _print(run, comparison, folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from pinograsp.report import answer, comparison_rows

    # A pipe has no width: leave the rows whole there.
    console = Console(width=None if sys.stdout.isatty() else 150, highlight=False)
    table = Table(title=f"Grasp plan '{run.settings['name']}'", show_header=False, box=None, title_justify="left")
    for row in answer(run):
        table.add_row(*row)
    console.print(table)
    if comparison:
        beside = Table(title="\nBeside the paper", title_justify="left", box=None, header_style="bold")
        for name in ("quantity", "unit"):
            beside.add_column(name)
        for name in ("paper", "ours", "difference"):
            beside.add_column(name, justify="right", no_wrap=True)
        beside.add_column("note")
        for row in comparison_rows(comparison):
            beside.add_row(*row)
        console.print(beside)
    for note in run.summary["notes"]:
        console.print(f"note: {note}")
    if run.summary["balance"] == "force":
        console.print("note: forces are balanced, moments are not; use --balance wrench for an object that may turn")
    if run.summary["remedy"]:
        console.print(f"{run.summary['status']}: {run.summary['remedy']}")
    console.print(f"\nwritten to {folder}: report.md, plan.json, plan.npz and figures", soft_wrap=True)


def main() -> None:
    """Entry point: our errors become one message and an exit code, never a traceback."""
    try:
        app(prog_name="pinograsp")
    except PinograspError as error:
        typer.echo(f"pinograsp: {error}", err=True)
        interrupted = _status_of(error) == Status.INTERRUPTED
        raise SystemExit(130 if interrupted else 3 if isinstance(error, NoGrasp) else 2) from None


if __name__ == "__main__":
    main()
