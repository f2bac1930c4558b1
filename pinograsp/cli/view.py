"""``pinograsp view``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pinograsp.cli.app import Json, Quiet, Run, Verbose, app, tell_json
from pinograsp.cli.screen import tell
from pinograsp.errors import InvalidInput, ResultsNotWritten


@app.command()
def view(
    run: Run,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a page that needs no server and no network."),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(help="Folder of a check to show beside the plan; default: the newest in the run."),
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the live page; the next free one is used.")] = 8080,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the live page in a browser.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Show a plan: hand, object, forces and friction over time, and its simulation if there is one.

    The live page needs the extra viz; Ctrl-C ends it.

    Examples:
      pinograsp view runs/paper

      pinograsp view runs/paper --html paper.html

      pinograsp view runs/paper --port 9000 --no-browser
    """
    from pinograsp.planner import load_run
    from pinograsp.storage import newest_check, read_check

    if html is not None and os.path.lexists(html) and not force:
        raise ResultsNotWritten(f"'{html}' already exists: choose another --html, or overwrite it with --force")
    loaded = load_run(run)
    found = check if check is not None else newest_check(run)
    simulation = None if found is None else read_check(found)
    if html is not None:
        from pinograsp.viz.viewer import save_html
        from pinograsp.writing import list_in

        save_html(loaded, html, simulation=simulation)
        list_in(html.parent, html)  # so that it counts as one of a run's files
        if as_json:
            tell_json({"file": str(html), "bytes": html.stat().st_size})
        else:
            tell(f"written to {html} ({html.stat().st_size / 1e6:.1f} MB)")
        return
    if not 0 <= port < 65536:
        raise InvalidInput(f"--port: expected a number from 0 to 65535, got {port}")
    from pinograsp.viz.viewer import view as show

    with show(loaded, simulation=simulation, port=port, open_browser=browser) as viewer:
        try:
            if as_json:
                tell_json({"url": viewer.url, "check": None if found is None else str(found)})
            else:
                beside = "" if found is None else f", with the simulation in {found}"
                tell(f"{run} at {viewer.url}{beside}; Ctrl-C ends it")
            viewer.wait()
        except KeyboardInterrupt:
            typer.echo("", err=True)
