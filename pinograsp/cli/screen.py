"""What commands print for people: lines as wide as the terminal, and the answer last."""

from __future__ import annotations

import shlex
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pinograsp.cli.remedies import as_options
from pinograsp.words import escape_controls

if TYPE_CHECKING:
    from rich.console import Console

_PIPED = 80  # columns where there is no terminal
_ROWS = 22  # of a terminal of 24: the command and the next prompt stay visible, too
_COLOURS = {"yes": "green", "caution": "yellow", "no": "red"}

RIGHT = {"justify": "right"}  # of a table's column

Fact = tuple[str, str]  # its name, and what is said of it


def columns() -> int:
    """Width of standard output: that of its terminal, 80 where it is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else _PIPED


def console() -> Console:
    """Standard output for tables, as wide as :func:`columns`."""
    from rich.console import Console

    return Console(width=columns(), highlight=False, markup=False)


def print_table(
    columns: Mapping[str, Mapping[str, Any]], rows: Iterable[Sequence[str]], title: str | None = None, **style: Any
) -> None:
    """Print a table; ``columns``: by name what rich takes for one, ``style``: and for a table."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, header_style="bold", **style)
    for name, options in columns.items():
        table.add_column(name, **options)
    for row in rows:
        table.add_row(*row)
    console().print(table)


def tell(text: str, width: int | None = None) -> None:
    """Print text, its lines wrapped; what follows of a line is indented further than its beginning."""
    for line in wrap_text(text, width):
        typer.echo(line)


def tell_missing_core() -> None:
    """Print one line to standard error if the compiled core is missing, about which pip is silent."""
    from pinograsp import core

    if not core.is_installed():
        what = "the compiled core is missing, so plans take longer and 1 kHz loops are refused"
        typer.echo(f"pinograsp: {what}: {core.REMEDY}", err=True)


def wrap_text(text: str, width: int | None = None) -> list[str]:
    """Wrap text to lines of at most ``width`` columns, by default those of the terminal; longer words (paths) stay
    whole.
    """
    found = []
    for line in escape_controls(text, keep="\n").split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        found += _fill(line.strip(), indent, f"{indent}  ", width)
    return found


def _fill(text: str, first: str, others: str, width: int | None) -> list[str]:
    return textwrap.wrap(
        as_options(text),
        columns() if width is None else width,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    ) or [first.rstrip()]


def list_facts(facts: Sequence[Fact], most: int | None = None) -> list[str]:
    """Facts as two columns; ``most``: lines of each, what goes beyond is left out and marked by dots."""
    indent = max((len(name) for name, _ in facts), default=0) + 2
    found = []
    for name, text in facts:
        lines = _fill(escape_controls(text), escape_controls(name).ljust(indent), " " * indent, None)
        if most is not None and len(lines) > most:
            last = lines[most - 1]
            kept = last if len(last) <= columns() - 4 else last[: columns() - 4].rpartition(" ")[0]
            lines = [*lines[: most - 1], f"{kept.rstrip(' ,;')} ..."]
        found += lines
    return found


def show(
    facts: Sequence[Fact],
    answers: Sequence[Fact],
    then: Sequence[Fact] = (),
    *,
    title: str = "",
    level: str = "",
    more: str = "",
) -> None:
    """Print facts, an empty line, and the answer: what was asked, where the results are, what to type next.

    Args:
        facts: by name, the most important first.
        answers: by name; the verdict first.
        then: commands to type next, and what they do; a command stays in one line, to be copied.
        title: above the facts.
        level: "yes", "caution", "no" or "" (neutral), the colour of the verdict.
        more: where to find the rest: at most two lines of each fact, and together with the answer no more than a
            terminal shows; empty: all.
    """
    from rich.text import Text

    ended = _answer(answers, then)
    lines = list_facts(facts, 2 if more else None)
    room = _ROWS - len(ended) - 1 - bool(title)
    if more and len(lines) > room:
        lines = [*lines[: max(room - 1, 0)], f"... {more}"]
    screen = console()
    if title:
        screen.print(Text(escape_controls(title), "bold"), soft_wrap=True)
    for line in lines:
        screen.print(line, soft_wrap=True)
    screen.print()
    for name, line in ended:
        colour = _COLOURS[level] if level and name == ended[0][0] else ""
        screen.print(Text.assemble((name, "bold"), (line, colour)), soft_wrap=True)


def _answer(answers: Sequence[Fact], then: Sequence[Fact]) -> list[Fact]:
    """The lines of the answer: a column of names, and the text beside it."""
    indent = max(len(name) for name, _ in answers) + 2
    found = []
    for i, (name, text) in enumerate(answers):
        lines = list_facts([(name.ljust(indent - 2), text)], 4 if i == 0 else 3)
        found += [(line[:indent], line[indent:]) for line in lines]
    width = max((len(one) for one, _ in then), default=0)
    for i, (one, what) in enumerate(then):
        remark = f"{one.ljust(width)}  # {what}"
        found.append((("" if i else "Next").ljust(indent), remark if indent + len(remark) <= columns() else one))
    return found


def command(*words: str | Path) -> str:
    """A command as it is typed."""
    return shlex.join(["pinograsp", *map(str, words)])


def needs(extra: str, module: str) -> str:
    """A remark where the extra of a command is not installed."""
    return "" if find_spec(module) else f" (needs the extra {extra})"
