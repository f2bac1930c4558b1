"""What every benchmark writes: a header that says where and with what it ran, and the rows below it."""

from __future__ import annotations

import csv
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


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


def _with_version(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"no {name}"
