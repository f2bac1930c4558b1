"""The command ``pinograsp``. Exit codes: 0 success, 2 unusable input, 3 no grasp or a lost one, 130 interrupted, 141
nobody reads what is printed.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import select
import shutil
import signal
import sys
import traceback
from typing import Any

try:  # Ctrl-C may come while the commands are imported
    import typer

    from pinograsp.cli.app import app
    from pinograsp.cli.remedies import as_options
    from pinograsp.cli.screen import wrap_text
    from pinograsp.cli.session import Session
except KeyboardInterrupt:
    sys.stderr.write("pinograsp: interrupted\n")
    raise SystemExit(130) from None

from pinograsp.errors import PinograspError, SearchFailed, Status, status_of
from pinograsp.words import escape_controls

__all__ = ["app", "main", "run"]

_CUT_OFF = 141  # as shells tell of tools that end by SIGPIPE
_UsageError: Any = typer.BadParameter.__base__  # of click, or of the copy of it that typer brings


def main() -> None:
    """Entry point: runs the command line and ends the process."""
    gc.set_threshold(100_000)  # imports and figures make many objects that stay: looking through them takes its time
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before the start
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    code = run()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # what could not be printed would be tried, and told, once more at the end
            with contextlib.suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if code == 130:
        # At once: after Ctrl-C in compiled code, an orderly exit could end by the signal instead, or crash.
        os._exit(130)
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # only clean-up is left
    gc.freeze()  # or Python would look through all objects once more, to end
    raise SystemExit(code)


def run() -> int:
    """Run the command line and return the exit code; errors become a message without a traceback."""
    session = Session()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files may hold invalid text
    try:
        code = int(app(prog_name="pinograsp", standalone_mode=False, obj=session) or 0)
        sys.stdout.flush()
    except BaseException as error:
        if _is_cut_off(error):
            return _CUT_OFF
        code = _report(error, session)
    stopped = Status.INTERRUPTED
    if code == 130 and not _print_json(session, stopped, "KeyboardInterrupt", "interrupted", stopped.remedy):
        _say("interrupted")
    return code


def _is_cut_off(error: BaseException) -> bool:
    """Whether standard output is a pipe that nobody reads any more, as of ``| head``."""
    if isinstance(error, SystemExit) and isinstance(error.__context__, BrokenPipeError):  # rich and click say so
        return True
    try:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        return any(event & select.POLLERR for _, event in poll.poll(0))
    except (OSError, ValueError):  # no file at all
        return False


def _report(error: Any, session: Session) -> int:
    """Print an error, with ``--json`` also as JSON, and return the exit code. Unexpected errors are raised again."""
    name, status, remedy = type(error).__name__, status_of(error), ""
    code = status.exit_code
    if isinstance(error, SystemExit):  # of the completion of shells
        raise error
    if _interrupt(error):
        return 130
    if isinstance(error, _UsageError):
        code, name, status, text = int(error.exit_code), "UsageError", Status.INVALID_INPUT, error.format_message()
        if type(error).__name__ == "NoArgsIsHelpError":
            typer.echo(text, err=True)
            return code
        remedy = f"try '{error.ctx.command_path if error.ctx else 'pinograsp'} --help'"
    elif isinstance(error, PinograspError | OSError | MemoryError):
        remedy = error.remedy if isinstance(error, SearchFailed) else ""
        text = str(error) if str(error) or not isinstance(error, MemoryError) else "not enough memory: ask for less"
    else:
        _print_json(
            session, Status.FAILED, name, str(error), "This is an error of pinograsp: report it with its traceback."
        )
        raise error
    text = as_options(text)
    if session.verbose:
        traceback.print_exception(error)
    if not _print_json(session, status, name, text, remedy or status.remedy):
        _say(f"{text} ({remedy})" if isinstance(error, _UsageError) else text)
    return code


def _print_json(session: Session, status: Status, name: str, text: str, remedy: str) -> bool:
    """Where that is asked for and none was printed, print one object: status, error, message, and what to do; whether
    it was.
    """
    if "--json" not in sys.argv or session.quiet or session.printed:
        return False
    session.print_json({"status": str(status), "error": name, "message": text, "remedy": remedy})
    return True


def _interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused the error: libraries turn it into errors of their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt | typer.Abort):
        error = error.__cause__ or error.__context__
    return error is not None


def _say(text: str) -> None:
    """Print an error: wrapped on a terminal, unbroken elsewhere, where it is searched."""
    text = escape_controls(f"pinograsp: {text}", keep="\n")
    width = shutil.get_terminal_size().columns
    typer.echo("\n".join(wrap_text(text, width)) if sys.stderr.isatty() else text, err=True)
