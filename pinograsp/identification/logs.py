"""Logs of hands: columns of a table under the names and in the units that the identification takes."""

from __future__ import annotations

import csv
import difflib
import gzip
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from pinograsp.checks import brief, mapping_of, one_line, one_of, path_of, read_only, shorten
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.identification.bags import is_bag, read_bag
from pinograsp.spatial import Array

Quantity: TypeAlias = Literal["time", "position", "force", "speed", "limit"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
# How many of the unit in which a quantity is kept one of the unit in a file is. Register units stay as they are.
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": {"count": 1.0, "rad": 1.0, "deg": math.pi / 180, "m": 1.0, "mm": 1e-3},
    "force": {"count": 1.0, "N": 1.0, "mN": 1e-3, "gf": 9.80665e-3},
}
_COMMANDS = ("speed", "limit")  # may be missing, or be a number
_ASKED = {"position": "what the joint or finger has closed", "force": "what its sensor says"}

# What no hand does: newtons at a finger, radians of a joint, metres of a jaw, seconds between samples.
_LARGEST = {"N": 2000.0, "mN": 2000.0, "gf": 2000.0, "rad": 100.0, "deg": 100.0, "m": 2.0, "mm": 2.0}
_SLOWEST, _FASTEST = 10.0, 1e-5  # [s] between two samples
_WHOLE = 20  # different values; as many whole ones are no measured newtons
_MOST = 50_000_000  # samples


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """A log, sample by sample (s).

    Attributes:
        source: the file.
        time: rising (s,) [s].
        position: of the joint or finger (s,) [rad, m or counts, see ``units``].
        force: reading of its sensor (s,) [N or counts].
        speed, limit: commanded closing speed and force limit (s,), in the units of the drive's registers; None if the
            log has none.
        units: of ``position`` and ``force``: ``count``, ``rad``, ``m``, ``N``.
    """

    source: str
    time: Array
    position: Array
    force: Array
    speed: Array | None
    limit: Array | None
    units: Mapping[str, str]

    __repr__ = brief("source", "time", "units")


def read_log(
    path: str | Path, *, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> Log:
    """Read a log of one finger or joint: a CSV file, packed by gzip or not, Parquet, or a bag of ROS.

    Args:
        path: the file; its first line names the columns. Cells of Parquet that are lists, as in LeRobot's files, are
            columns ``NAME[0]``, ``NAME[1]``; bags have those of :func:`~pinograsp.identification.bags.read_bag`.
        columns: the file's name of each quantity, ``{"force": "Middle_Force_g"}``; by default each quantity is the
            column of its own name: ``time``, ``position``, ``force``, ``speed``, ``limit``. The last two may be
            missing, or be a number that holds for the whole file: ``{"speed": "250"}``.
        units: of ``position`` and ``force``, which you must give, and of ``time`` (default: s).

    Raises:
        InvalidInput: missing columns, units that are missing or contradict the numbers, cells that are not finite
            numbers, time that does not increase.
        ExtraMissing: Parquet without pyarrow, bags without rosbags.
    """
    path = path_of("log", path)
    given = mapping_of("units", {} if units is None else units, "a unit for each quantity")
    for quantity in given:
        one_of("units", quantity, tuple(UNITS))
    taken = {quantity: one_of(f"unit of {quantity}", unit, UNITS[quantity]) for quantity, unit in given.items()}
    for quantity, meaning in _ASKED.items():
        if quantity not in taken:
            raise InvalidInput(
                f"unit of {quantity}: expected one of {', '.join(UNITS[quantity])} ({meaning}), got none: a log does "
                "not say it, whatever its column is called; use 'count' for numbers of a register"
            )
    table = _choose_columns(path, _choose(columns))
    found: dict[str, Array | None] = {}
    for quantity in QUANTITIES:
        values = table[quantity]
        scale = UNITS[quantity][taken.get(quantity, "s")] if quantity in UNITS else 1.0
        found[quantity] = None if values is None else read_only(values * scale)
    log = Log(
        source=str(path),
        **found,  # type: ignore[arg-type]
        units={
            quantity: {"mN": "N", "gf": "N", "deg": "rad", "mm": "m"}.get(unit, unit)
            for quantity, unit in taken.items()
            if quantity != "time"
        },
    )
    _check(log, taken)
    return log


def _choose(columns: Mapping[str, str] | None) -> dict[Quantity, str]:
    names = mapping_of("columns", {} if columns is None else columns, "a column for each quantity")
    for quantity in names:
        one_of("columns", quantity, QUANTITIES)
    return {quantity: str(names.get(quantity, quantity)) for quantity in QUANTITIES}


def read_columns(path: Path, names: Iterable[str], needed: Iterable[str] = ()) -> dict[str, Array]:
    """Those of the columns that a table has, {name: (s,)}, finite.

    Raises:
        InvalidInput: no table, fewer than two samples, no ``needed`` column, cells that are no numbers.
    """
    try:
        header, cells = _read_table(path)
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"log {path}: expected a table, got {one_line(error)}") from None
    length = max((len(cells(name)) for name in header[:1]), default=0)
    if not 2 <= length <= _MOST:
        raise InvalidInput(f"log {path}: expected 2 to {_MOST} samples, got {length}")
    for name in needed:
        if name not in header:
            near = difflib.get_close_matches(name, header, n=1, cutoff=0.4)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise InvalidInput(
                f"log {path}: expected a column '{name}', got {shorten(', '.join(header))}{hint}: name it, "
                "QUANTITY=COLUMN"
            )
    return {name: _numbers(path, name, cells(name)) for name in names if name in header}


def _choose_columns(path: Path, names: dict[Quantity, str]) -> dict[Quantity, Array | None]:
    """The columns of a file by quantity (s,)."""
    # A command may be a number for the whole file, or not be there where nobody named its column.
    fixed = {key: float(name) for key, name in names.items() if key in _COMMANDS and _is_number(name)}
    needed = [name for key, name in names.items() if key not in fixed and (key not in _COMMANDS or name != key)]
    columns = read_columns(path, names.values(), needed)
    length = len(next(iter(columns.values())))
    return {key: np.full(length, fixed[key]) if key in fixed else columns.get(name) for key, name in names.items()}


def _read_table(path: Path):  # type: ignore[no-untyped-def]
    """Names of the columns, and what gives the cells of one."""
    if is_bag(path):
        columns = read_bag(path)
        return list(columns), columns.__getitem__
    return _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)


def _read_csv(path: Path):  # type: ignore[no-untyped-def]
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt", newline="", encoding="utf-8-sig") as stream:
        lines = csv.reader(stream)
        header = [name.strip() for name in next(lines, [])]
        rows = [line for line in lines if line]
    for i, line in enumerate(rows):
        if len(line) != len(header):
            raise InvalidInput(f"log {path}: expected {len(header)} cells in line {i + 2}, got {len(line)}")
    columns = dict(zip(header, zip(*rows))) if rows else dict.fromkeys(header, ())
    return header, lambda name: columns[name]


def _read_parquet(path: Path):  # type: ignore[no-untyped-def]
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        raise ExtraMissing("Parquet needs pyarrow: pip install 'pinograsp[logs]'") from None
    try:
        table = parquet.read_table(path)
    except pyarrow.ArrowException as error:
        raise InvalidInput(f"log {path}: expected a Parquet file, got {one_line(error)}") from None
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    for name, cells in list(columns.items()):  # as LeRobot has them: a list in each cell
        if cells and isinstance(cells[0], list) and len({len(cell) for cell in cells}) == 1:
            columns |= {f"{name}[{i}]": values for i, values in enumerate(zip(*columns.pop(name)))}
    return list(columns), columns.__getitem__


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _numbers(path: Path, name: str, cells) -> Array:  # type: ignore[no-untyped-def]
    try:
        values = np.array(cells, dtype=float)
    except (TypeError, ValueError):
        values = np.array([float(cell) if cell is not None and _is_number(str(cell)) else np.nan for cell in cells])
    if (bad := ~np.isfinite(values)).any():
        row = int(np.argmax(bad))
        raise InvalidInput(
            f"log {path}: expected finite numbers in column '{name}', got {shorten(cells[row])} in sample {row + 1}, "
            f"{int(bad.sum())} such in total: cut them out, with the other columns of these samples"
        )
    return values


def _check(log: Log, units: Mapping[str, str]) -> None:
    """Refuse what no log of a hand can be: time that goes back, units that the numbers belie."""
    steps = np.diff(log.time)
    if (back := steps < 0).any():
        row = int(np.argmax(back))
        raise InvalidInput(
            f"log {log.source}: expected time that rises, got {log.time[row]:g} s and then {log.time[row + 1]:g} s in "
            f"sample {row + 2}: is it the time of each trial? Take the time since the log began"
        )
    step = float(np.median(steps))
    if not _FASTEST <= step <= _SLOWEST:
        raise InvalidInput(
            f"log {log.source}: expected samples {_FASTEST:g} to {_SLOWEST:g} s apart, got {step:g} s in the median: "
            f"is time in another unit ({', '.join(UNITS['time'])})?"
        )
    for quantity, values in (("position", log.position), ("force", log.force)):
        unit, most = units[quantity], float(np.abs(values).max())
        if most > _LARGEST.get(unit, math.inf):
            raise InvalidInput(
                f"log {log.source}: expected {quantity} in {unit}, got up to {most:g} {log.units[quantity]}, which is "
                "too much for a hand: are these counts of a register?"
            )
        raw = values / UNITS[quantity][unit]
        different = np.unique(raw)
        if unit in ("N", "rad", "m") and len(different) >= _WHOLE and np.all(different == np.round(different)):
            raise InvalidInput(
                f"log {log.source}: expected {quantity} in {unit}, got whole numbers alone, {different[0]:g} to "
                f"{different[-1]:g}: these are counts of a register, whatever their column is called; give "
                f"{quantity}=count" + (", and how many newtons a count is" if quantity == "force" else "")
            )
