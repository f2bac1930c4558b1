"""``pinograsp view``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp.cli.options import RunFolder, force_option, refuse_existing
from pinograsp.cli.screen import tell
from pinograsp.cli.session import Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.planner import GraspPlan

_FILMS = (".gif", ".mp4")

_shown = partial(option, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class PageOptions:
    """Where a plan is drawn, and how."""

    html: Path | None = _shown("Write a page that needs no server and no network.", metavar="FILE")
    png: Path | None = _shown(
        "Write a picture (.png, .svg or .pdf) or a film in which the hand moves and the forces grow (.gif or "
        ".mp4); needs no screen.",
        metavar="FILE",
    )
    side: str | None = _shown(
        "With --png: direction of the camera: front, back, side, top, or X,Y,Z in the world; default: a "
        "direction with a good view of the contacts.",
        "--from",
        metavar="WHERE",
    )
    check: Path | None = _shown("Folder of a check to show beside the plan; default: the newest in the run.")
    port: int = _shown("Port of the live page; if it is taken, the next free one is used.", default=8080)
    browser: bool = _shown("Open the live page in a browser.", default=True)


def view(
    *, run: RunFolder, page: PageOptions, force: Annotated[bool, force_option("FILE")] = False, session: Session
) -> None:
    """Show a plan: hand, object, forces and friction over time, and its simulation if there is one.

    The live page needs the extra viz; Ctrl-C ends it.

    Examples:
      pinograsp view runs/paper

      pinograsp view runs/paper --html paper.html

      pinograsp view runs/paper --png grasp.pdf --from front

      pinograsp view runs/paper --png grasp.gif

      pinograsp view runs/paper --port 9000 --no-browser
    """
    from pinograsp.planner import load_run
    from pinograsp.storage import newest_check, read_check

    html, png = page.html, page.png
    if page.side is not None and png is None:
        raise InvalidInput("--from: expected with --png, got it without")
    for name, path in (("--html", html), ("--png", png)):
        if path is not None:
            refuse_existing(name, path, force)
    loaded = load_run(run)
    if png is not None:
        _tell_written(_draw(loaded, png, page.side, session), session)
        if html is None:
            return
    found = page.check if page.check is not None else newest_check(run)
    simulation = None if found is None else read_check(found)
    if html is not None:
        from pinograsp.viz.viewer import save_html

        _tell_written(save_html(loaded, html, simulation=simulation), session)
        return
    if not 0 <= page.port < 65536:
        raise InvalidInput(f"--port: expected a number from 0 to 65535, got {page.port}")
    from pinograsp.viz.viewer import view as show

    with show(loaded, simulation=simulation, port=page.port, open_browser=page.browser) as viewer:
        try:
            if session.as_json:
                session.print_json({"url": viewer.url, "check": None if found is None else str(found)})
            else:
                beside = "" if found is None else f", with the simulation in {found}"
                tell(f"{run} at {viewer.url}{beside}; Ctrl-C ends it")
            viewer.wait()
        except KeyboardInterrupt:
            typer.echo("", err=True)


def _draw(plan: GraspPlan, path: Path, side: str | None, session: Session) -> Path:
    """A still or a film, by the file's suffix."""
    where: str | list[float] | None = side
    if side is not None and "," in side:
        try:
            where = [float(part) for part in side.split(",")]
        except ValueError:
            raise InvalidInput(f"--from: expected front, back, side, top, or X,Y,Z, got '{side:.100}'") from None
    if path.suffix.lower() in _FILMS:
        return plan.film(path, view=where, progress=session.progress)
    return plan.picture(path, view=where)


def _tell_written(path: Path, session: Session) -> None:
    from pinograsp.writing import list_in

    list_in(path.parent, path)  # so that it counts as one of a run's files
    if session.as_json:
        session.print_json({"file": str(path), "bytes": path.stat().st_size})
    else:
        tell(f"written to {path} ({path.stat().st_size / 1e6:.1f} MB)")
