"""The command ``pinograsp``. Exit codes: 0 success, 2 unusable input, 3 no grasp or a lost one, 130 interrupted."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import sys
import traceback
from typing import Any

try:  # Ctrl-C may come while the commands are imported
    import typer

    from pinograsp.cli import bench, carry, certify, check, export, hands, plan, report, sweep, view
    from pinograsp.cli.app import app, given
except KeyboardInterrupt:
    sys.stderr.write("pinograsp: interrupted\n")
    raise SystemExit(130) from None

from pinograsp.errors import PinograspError, Status, exit_code_of, status_of
from pinograsp.words import escaped

__all__ = [
    "app",
    "bench",
    "carry",
    "certify",
    "check",
    "export",
    "hands",
    "main",
    "plan",
    "report",
    "run",
    "sweep",
    "view",
]

_UsageError: Any = typer.BadParameter.__base__  # of click, or of the copy of it that typer brings


def main() -> None:
    """Entry point: runs the command line and ends the process."""
    code = run()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    if code == 130:
        # At once: after Ctrl-C in compiled code, an orderly exit could end by the signal instead, or crash.
        os._exit(130)
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # only clean-up is left
    raise SystemExit(code)


def run() -> int:
    """Run the command line and return the exit code; errors become a message without a traceback."""
    given.update(quiet=False, verbose=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files may hold invalid text
    try:
        code = int(app(prog_name="pinograsp", standalone_mode=False) or 0)
        sys.stdout.flush()
    except BaseException as error:
        code = _report(error)
    if code == 130:
        _say("interrupted")
    return code


def _report(error: BaseException) -> int:
    """Print an error, with ``--json`` also as JSON, and return the exit code. Unexpected errors are raised again."""
    if _interrupted(error):
        return 130
    if isinstance(error, _UsageError):
        code, name, status, text = int(error.exit_code), "UsageError", Status.INVALID_INPUT, error.format_message()
        if type(error).__name__ == "NoArgsIsHelpError":
            typer.echo(text, err=True)
            return code
        text += f" (try '{error.ctx.command_path if error.ctx else 'pinograsp'} --help')"
    elif isinstance(error, PinograspError | OSError | MemoryError):
        code, name, status = exit_code_of(error), type(error).__name__, status_of(error)
        text = str(error) if str(error) or not isinstance(error, MemoryError) else "not enough memory: ask for less"
    else:
        raise error
    if given["verbose"]:
        traceback.print_exception(error)
    if "--json" in sys.argv and not given["quiet"]:
        typer.echo(json.dumps({"status": str(status), "error": name, "message": text}))
    _say(text)
    return code


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused the error: libraries turn it into errors of their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt | typer.Abort):
        error = error.__cause__ or error.__context__
    return error is not None


def _say(text: str) -> None:
    typer.echo("pinograsp: " + escaped(text, keep="\n"), err=True)
