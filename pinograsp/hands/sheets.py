"""Data sheets: figures of drives in a TOML file, beside the description of the hand or for drives of one kind."""

from __future__ import annotations

import fnmatch
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pinograsp.checks import items_of, mapping_of, one_line, one_of, shorten, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.drive_records import closing_record, drive_record, read_drive
from pinograsp.hands.drives import ON_DRIVES, Drive
from pinograsp.hands.elements import read_bytes
from pinograsp.hands.file_reads import is_there
from pinograsp.hands.model import HandModel

SUFFIX = ".drives.toml"
_LARGEST = 2**22  # [bytes]
_SHIPPED = Path(__file__).parent / "data_sheets"
_HEAD = """\
Drives of {hand}: efforts in N m or N, angles in rad, ways in m, times in s. Where 'name' has * or ?, the figures are
those of all drives of fingers that it fits. Each source says where a figure comes from, or that it is a guess."""


def list_sheets() -> tuple[str, ...]:
    """List the data sheets that come with the package."""
    return tuple(sorted(one.name.removesuffix(SUFFIX) for one in _SHIPPED.iterdir() if one.name.endswith(SUFFIX)))


def find_sheet(description: str | Path) -> Path | None:
    """Find the data sheet beside a hand's description: ``hand.drives.toml`` beside ``hand.urdf``."""
    if "<" in str(description) or not Path(description).suffix:
        return None
    path = Path(description)
    beside = path.with_name(path.stem.removesuffix(".urdf") + SUFFIX)
    # An empty one is just being written: 'pinograsp hands hand.urdf --drives > hand.drives.toml'.
    return beside if is_there(beside) and beside.stat().st_size else None


def read_sheet(source: str | Path) -> tuple[dict[str, Any], ...]:
    """Read the drives of a data sheet, each as plain values with the ``name`` of those that it describes.

    Args:
        source: a file, or the name of a sheet that comes with the package (:func:`list_sheets`).

    Raises:
        InvalidInput: the file is missing, broken, or not a data sheet.
    """
    shipped, path = _SHIPPED / f"{source}{SUFFIX}", Path(source)
    if not path.is_file() and path.suffix != ".toml":
        one_of("drives (a file that ends in .toml, or a data sheet)", str(source), list_sheets())
        text = shipped.read_text(encoding="utf-8")
    else:
        try:
            text = read_bytes(path, _LARGEST).decode("utf-8")
        except (OSError, ValueError) as error:
            raise InvalidInput(f"data sheet {path}: cannot read it: {one_line(error)}") from None
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidInput(f"data sheet {source}: expected TOML, got {one_line(error)}") from None
    if unknown := document.keys() - {"drives"}:
        raise InvalidInput(f"data sheet {source}: expected [[drives]] alone, got {shorten(', '.join(sorted(unknown)))}")
    drives = items_of(f"data sheet {source}: drives", document.get("drives", ()), dict)
    if not drives:
        raise InvalidInput(f"data sheet {source}: expected one or more [[drives]], got none")
    for i, values in enumerate(drives):
        mapping_of(f"data sheet {source}: drive {i + 1}", values)
        if not text_of(f"data sheet {source}: name of drive {i + 1}", values.get("name")):
            raise InvalidInput(f"data sheet {source}: expected a name of drive {i + 1}, got an empty one")
    return drives


def apply_sheet(hand: HandModel, source: str | Path) -> HandModel:
    """Return the hand with the figures of a data sheet in its drives; other figures stay.

    Notes name drives of the sheet that the hand does not have, as in a part of a robot.

    Raises:
        InvalidInput: as :func:`read_sheet`; no drive matches, or the figures do not describe a drive.
    """
    drives = {drive.name: drive for drive in hand.drives}
    moving = {joint for finger in hand.fingers for joint in finger.actuated}
    of_fingers = [name for name, drive in drives.items() if not moving.isdisjoint(drive.joints)]
    described, missing = read_sheet(source), []
    for values in described:
        pattern = values["name"]
        fitting = [pattern] if pattern in drives else fnmatch.filter(of_fingers, pattern)
        missing += [] if fitting else [pattern]
        figures = {key: value for key, value in values.items() if key != "name"}
        for name in fitting:
            drives[name] = read_drive(figures, f"data sheet {source}: {name}: ", drives[name])
    if len(missing) == len(described):
        raise InvalidInput(
            f"data sheet {source}: expected drives of hand '{hand.name}' ({shorten(', '.join(drives))}), got "
            f"{shorten(', '.join(missing))}: name its drives so, or '*' for all of them"
        )
    note = f"{ON_DRIVES}figures of {Path(source).name}"
    if missing:
        note += f"; not among this hand's drives: {shorten(', '.join(missing))}"
    return replace(hand.with_drives(tuple(drives.values()), hand.springs), notes=(*hand.notes, note))


def write_sheet(drives: Sequence[Drive], hand: str) -> str:
    """Return the data sheet of drives as TOML, with everything that is known and nothing else."""
    return _write([drive_record(drive) for drive in drives], hand)


def write_closing(
    table: ClosingTable, drive: str, source: str, contact_stiffness: tuple[float, float] | None = None
) -> str:
    """Return the data sheet of a drive, or of those that match a pattern, with the forces of its finger, and the least
    and largest stiffness of its contacts over the planned one [-], if known.
    """
    figures: dict[str, Any] = {
        "name": drive,
        "contact_stiffness": contact_stiffness,
        "closing": closing_record(table),
    }
    known = [figure for figure in ("closing", "contact_stiffness") if figures[figure] is not None]
    figures["sources"] = [{"figure": figure, "text": source} for figure in known]
    return _write([figures], "a finger that closes on a stop")


def _write(drives: Sequence[Mapping[str, Any]], hand: str) -> str:
    lines = [f"# {line}" for line in _HEAD.format(hand=hand).splitlines()]
    for drive in drives:
        plain = {key: value for key, value in drive.items() if value is not None}
        sources, closing = plain.pop("sources"), plain.pop("closing", None)
        if plain.get("floor") == 0:
            del plain["floor"]
        tables = [("[[drives]]", plain)]
        tables += [] if closing is None else [("[drives.closing]", closing)]
        tables += [("[[drives.sources]]", _shown(source)) for source in sources]
        for head, values in tables:
            lines += ["", head, *(f"{key} = {_toml(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    """A text, truth value, number or list of these as TOML has them: as JSON, but for numbers without an end."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(float(value))
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _shown(source: dict[str, Any]) -> dict[str, Any]:
    """A source without what it does not say."""
    return {key: value for key, value in source.items() if value not in (None, False, "")}
