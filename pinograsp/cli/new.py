"""``pinograsp new``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from pinograsp.cli.options import force_option, refuse_existing
from pinograsp.cli.screen import command, show
from pinograsp.cli.session import Session
from pinograsp.errors import InvalidInput
from pinograsp.words import printable

_ENDINGS = (".yaml", ".yml")


def new(
    *,
    file: Annotated[Path, typer.Argument(help="File to write; its name ends in .yaml.")],
    search: Annotated[
        bool, typer.Option("--search", help="Write a case with a hand and an object, for which grasps are searched.")
    ] = False,
    sweep: Annotated[bool, typer.Option("--sweep", help="Write a sweep instead of a case.")] = False,
    force: Annotated[bool, force_option("FILE")] = False,
    session: Session,
) -> None:
    """Write a case file, or a sweep file, to start from; it runs as it is and explains each key.

    Examples:
      pinograsp new case.yaml && pinograsp plan case.yaml

      pinograsp new pick.yaml --search && pinograsp plan pick.yaml

      pinograsp new sweep.yaml --sweep && pinograsp sweep sweep.yaml
    """
    from pinograsp.writing import write_file

    if file.suffix not in _ENDINGS:
        raise InvalidInput(f"FILE: expected a name that ends in {' or '.join(_ENDINGS)}, got '{file.name:.100}'")
    refuse_existing("FILE", file, force)
    if search and sweep:
        raise InvalidInput("--search, --sweep: expected one of them, got both")
    kind = "sweep" if sweep else "search" if search else "case"
    text = (Path(__file__).parent / f"new_{kind}.yaml").read_text(encoding="utf-8")
    write_file(file, text.replace("FILE", printable(shlex.quote(str(file))), 1).encode())
    if session.as_json:
        session.print_json({"file": str(file), "kind": kind})
        return
    running = [(command("sweep" if sweep else "plan", file), "runs as it is: make it yours")]
    show([], [("Written", f"{file}: a {'sweep' if sweep else 'case'} with all its keys explained")], running)
