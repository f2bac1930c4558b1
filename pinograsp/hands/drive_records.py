"""A drive as plain values, of JSON or TOML, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

from pinograsp.checks import items_of, mapping_of, one_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.drives import Drive
from pinograsp.hands.sources import Source

_FIELDS = tuple(field.name for field in fields(Drive))
_TABLES = ("peaks", "low", "high", "speeds", "limits", "trials")


def drive_record(drive: Drive) -> dict[str, Any]:
    """A drive as plain JSON values; None for figures that are not known."""
    plain: dict[str, Any] = {name: getattr(drive, name) for name in _FIELDS}
    plain["limit"] = drive.limit if drive.limit < math.inf else None
    plain |= {name: list(plain[name]) for name in ("joints", "arms")}
    plain |= {name: plain[name] and list(plain[name]) for name in ("efforts", "contact_stiffness")}
    plain["sources"] = [asdict(one) | {"interval": one.interval and list(one.interval)} for one in drive.sources]
    if drive.closing is not None:
        plain["closing"] = closing_record(drive.closing)
    return plain


def closing_record(table: ClosingTable) -> dict[str, Any]:
    """A closing table as plain JSON values."""
    plain = {**{name: list(getattr(table, name)) for name in _TABLES}, "unit": table.unit}
    return plain if table.position is None else {**plain, "position": table.position}


def read_drive(values: Mapping[str, object], where: str, base: Drive | None = None) -> Drive:
    """The drive of such values; those that are missing are those of ``base``, or what the constructor takes.

    Args:
        values: by the names of the fields of :class:`Drive`; sources of ``base`` stay for figures that are not given.
        where: how messages begin.
        base: a drive whose figures these replace.

    Raises:
        InvalidInput: names that a drive has not, values that make no drive.
    """
    try:
        return _read(values, where, base)
    except InvalidInput as error:
        raise error if str(error).startswith(where) else InvalidInput(f"{where}{error}") from None


def _read(values: Mapping[str, object], where: str, base: Drive | None) -> Drive:
    plain: dict[str, Any] = {}
    for name, value in mapping_of(f"{where}drive", values).items():
        key = one_of(f"{where}figure of a drive", name, _FIELDS)
        plain[key] = value
    if "limit" in plain and plain["limit"] is None:
        plain["limit"] = math.inf
    sources = [_read_source(one, where) for one in items_of(f"{where}sources", plain.pop("sources", ()), dict)]
    if plain.get("closing") is not None:
        plain["closing"] = ClosingTable(**_keys(f"{where}closing", plain["closing"], _TABLES, ("unit", "position")))
    if base is None:
        # Records of earlier versions do not tell all.
        return Drive(**{"name": "", "joints": (), "arms": (), "exact": False, **plain}, sources=tuple(sources))
    told = {one.figure for one in sources} | set(plain)
    kept = [one for one in base.sources if one.figure not in told]
    if "limit" in plain and "efforts" not in plain:
        plain["efforts"] = None
    return replace(base, **plain, sources=(*kept, *sources))


def _read_source(values: Mapping[str, object], where: str) -> Source:
    return Source(**_keys(f"{where}source", values, ("figure", "text"), ("guess", "interval", "date")))


def _keys(name: str, values: object, needed: tuple[str, ...], others: tuple[str, ...]) -> dict[str, Any]:
    plain: dict[str, Any] = mapping_of(name, values)  # type: ignore[arg-type]
    for key in plain:
        one_of(f"key of {name}", key, (*needed, *others))
    if missing := [key for key in needed if key not in plain]:
        raise InvalidInput(f"{name}: expected {', '.join(needed)}, got none of {', '.join(missing)}")
    return plain
