"""Words and numbers for people, the same in reports, figures, on the command line and in the viewer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

_MOST_LINES = 20


def format_number(value: float | None, digits: int = 4) -> str:
    """A number for people: plain where that is short, scientific where it is not, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    return f"{value:.{max(digits - 1 - exponent, 0)}f}" if -4 <= exponent < 6 else f"{value:.{digits - 2}e}"


def format_fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, and without a sign where these are all 0."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if not text.strip("-0.") else text


def escape_controls(text: str, keep: str = "") -> str:
    """Text without what would steer a terminal or turn the direction, but for the characters to ``keep``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def printable(text: str, most: int = 200) -> str:
    """A name of someone else's as one line of text: no control characters, nothing that turns the direction, at most so
    long.
    """
    shown = escape_controls(str(text))
    return shown if len(shown) <= most else f"{shown[: most - 3]}..."


def no_formula(name: str) -> str:
    """A name as a cell of a table: an apostrophe before what a spreadsheet would take for a formula."""
    return f"'{name}" if name.startswith(("=", "+", "-", "@", "\t", "\r", "'")) else name


def few(names: Sequence[str], most: int) -> str:
    """The first names of a list, and how many more there are."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def by_name(names: Iterable[str], values: Iterable[float], unit: str = "") -> str:
    """Values by name, for people: ``thumb 1.2, index 0.8 N``."""
    listed = ", ".join(f"{printable(name, 60)} {value:.3g}" for name, value in zip(names, values))
    return f"{listed} {unit}".rstrip()


def lines_of(first: str, *lines: str) -> str:
    """A record as text: the answer, and below it those lines that are not empty, as far as they are few."""
    said = [line for line in lines if line]
    if len(said) > _MOST_LINES:
        said = [*said[:_MOST_LINES], f"and {len(said) - _MOST_LINES} more lines"]
    return "\n  ".join([first, *said])
