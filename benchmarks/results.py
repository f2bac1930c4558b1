"""What every benchmark writes: a header that says where and with what it ran, and the rows below it."""

from __future__ import annotations

import csv
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

UNITS = ("%", "N", "ms", "us", "s")


def header(packages, *notes: str) -> str:
    """One comment line: machine, cores, Python, versions of ``packages``, commit, then ``notes``."""
    git = ["git", "describe", "--always", "--dirty", "--abbrev=7", "--exclude=*"]
    commit = subprocess.run(git, cwd=Path(__file__).parent, capture_output=True, text=True).stdout.strip()
    versions = [_with_version(name) for name in packages]
    machine = [platform.machine(), f"{os.cpu_count()} cores", f"Python {platform.python_version()}"]
    return "# " + ", ".join([*machine, *versions, f"commit {commit}", *notes])


def write_rows(path: Path, first_line: str, rows: list[dict]) -> None:
    """``rows`` as CSV below ``first_line``; columns that some rows have are empty in the others."""
    with path.open("w", newline="") as stream:
        stream.write(first_line + "\n")
        writer = csv.DictWriter(stream, list(dict.fromkeys(column for row in rows for column in row)), restval="")
        writer.writeheader()
        writer.writerows(rows)


def table(rows: list[dict]) -> str:
    """``rows`` as a Markdown table, its columns aligned, numbers to the right; columns that some rows have are empty in
    the others.
    """
    names = list(dict.fromkeys(column for row in rows for column in row))
    cells = [[str(row.get(name, "")) for name in names] for row in rows]
    widths = [max(3, len(name), *(len(line[i]) for line in cells)) for i, name in enumerate(names)]
    right = [any(line[i] for line in cells) and all(_is_number(line[i]) for line in cells) for i in range(len(names))]
    rule = ["-" * (width - 1) + (":" if number else "-") for width, number in zip(widths, right)]
    aligned = [
        [cell.rjust(width) if number else cell.ljust(width) for cell, width, number in zip(line, widths, right)]
        for line in (names, rule, *cells)
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in aligned)


def _is_number(text: str) -> bool:
    """Whether a cell is a number, with its unit or without, or holds nothing."""
    number, _, unit = text.partition(" ")
    try:
        float(number if unit in UNITS else text)
    except ValueError:
        return text in ("", "-")
    return True


def _with_version(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"no {name}"
