"""Reading YAML files as plain values, changing values, and error messages for those that are not valid."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pinograsp.checks import items_of, mapping_of, shorten
from pinograsp.errors import CaseRejected
from pinograsp.plain import plain_yaml

_DEEPEST, _MOST_PARTS = 50, 3_000_000  # nesting of lists and mappings, and number of values with aliases expanded
_Model = TypeVar("_Model", bound=BaseModel)


def validate(kind: type[_Model], data: Mapping[str, Any], what: str = "", also: Iterable[str] = ()) -> _Model:
    """``data`` as a checked ``kind``.

    Raises:
        CaseRejected: all errors in ``what``; for unknown keys with the nearest spelling of those that may stand there
            and ``also`` these.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        lines = dict.fromkeys(_describe(one, [*_keys_beside(kind, one["loc"]), *also]) for one in error.errors())
        raise CaseRejected((f"{what} is not valid: " if what else "") + "; ".join(lines)) from None


def _keys_beside(kind: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """The keys that may stand where an error is, in a file of that kind."""
    kinds = [kind]
    for part in loc[:-1]:  # numbers of items, and pydantic's tags of unions, lead no further
        fields = [field for one in kinds for name, field in one.model_fields.items() if part in (name, field.alias)]
        kinds = [model for field in fields for model in _models_in(field.annotation)] or kinds
    return [field.alias or name for one in kinds for name, field in one.model_fields.items() if not field.exclude]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def read_mapping(path: Path, kind: str, name: str, wanted: str, biggest: int, keys: str) -> dict[str, Any]:
    """The mapping in a YAML file of at most ``biggest`` bytes.

    Args:
        path: of the file.
        kind: of file, for error messages.
        name: of the file, for error messages.
        wanted: what was expected where there is no such file, for error messages.
        biggest: largest size [bytes].
        keys: that the mapping should have, for error messages.

    Raises:
        CaseRejected: no such file, one that cannot be read, or no mapping.
    """
    name = name if len(name) <= 300 else f"{name[:300]}..."
    what = f"{kind} '{name}'"
    try:
        if not os.path.isfile(path):
            raise CaseRejected(f"no {what}: expected {wanted}")
        with path.open("rb") as file:
            content = file.read(biggest + 1)  # the size that a file system reports may be wrong
        if len(content) > biggest:
            raise CaseRejected(
                f"{what}: {max(len(content), path.stat().st_size)} bytes; a {kind} file has at most {biggest}"
            )
        data = _parse_yaml(content, what)
    except OSError as error:
        raise CaseRejected(f"{what} cannot be read: {error}") from error
    if not isinstance(data, dict):
        raise CaseRejected(f"{what}: expected a mapping with {keys}, got {type(data).__name__}")
    return data


def check_extent(data: object, what: str) -> None:
    """Refuse plain values that are nested too deeply or, with YAML's aliases expanded, too many."""
    parts, left = 0, [(data, 0)]
    while left:
        one, depth = left.pop()
        inner: Sequence[object] | set[object] = ()
        if isinstance(one, dict):
            inner = [*one, *one.values()]
        elif isinstance(one, list | tuple | set):
            inner = one
        parts += len(inner)
        if depth > _DEEPEST:
            raise CaseRejected(f"{what}: expected at most {_DEEPEST} mappings and lists within each other")
        if parts > _MOST_PARTS:
            raise CaseRejected(f"{what}: expected at most {_MOST_PARTS} values, aliases expanded")
        left += [(part, depth + 1) for part in inner if isinstance(part, dict | list | tuple | set)]


def _parse_yaml(content: bytes, what: str) -> Any:
    try:
        return deepcopy(_read(content))
    except ValueError as error:
        raise CaseRejected(f"{what}: not valid YAML: {error}") from error


@lru_cache(maxsize=4)
def _read(content: bytes) -> Any:
    """What YAML says; kept, since sweeps read the same case for each of thousands of rows."""
    documents = plain_yaml(content, _DEEPEST, _MOST_PARTS)
    if len(documents) > 1:
        raise ValueError(f"expected one document, got {len(documents)}")
    return documents[0] if documents else None


def read_changes(changes: Mapping[str, object], texts: Iterable[str] = ()) -> dict[str, Any]:
    """Changes to a case by key, from a mapping and from texts ``key=value``."""
    wanted = "{key: value} with texts as keys (key=value as a text: texts=)"
    parsed: dict[str, Any] = mapping_of("changes", changes, wanted)
    for change in items_of("texts", texts, str):
        key, equals, value = change.partition("=")
        if not equals or not key.strip():
            raise CaseRejected(f"--set {change}: expected KEY=VALUE, for example object.mass=1.1")
        parsed[key.strip()] = _parse_yaml(value.encode(errors="surrogateescape"), f"--set {change}")
    return parsed


def change_values(data: Mapping[str, Any], changes: Mapping[str, object]) -> dict[str, Any]:
    """A copy of nested mappings and lists with other values at dotted keys."""
    changed = deepcopy(dict(data))
    for key, value in changes.items():
        _put_value(changed, key, deepcopy(value))
    return changed


def _put_value(data: dict[str, Any], key: str, value: object) -> None:
    """Put a value at a dotted key of nested mappings and lists."""
    *parents, last = key.split(".")
    at: dict[str, Any] | list[Any] = data
    for i, parent in enumerate(parents):
        inner = at.setdefault(parent, {}) if isinstance(at, dict) else None
        if not isinstance(at, dict) and parent.isdecimal() and int(parent) < len(at):
            inner = at[int(parent)]
        if not isinstance(inner, dict | list):
            raise CaseRejected(f"--set {key}: '{'.'.join(parents[: i + 1])}' has no further keys")
        at = inner
    if isinstance(at, list):
        if not last.isdecimal() or int(last) >= len(at):
            raise CaseRejected(f"--set {key}: expected an index below {len(at)}, got '{last}'")
        at[int(last)] = value
    else:
        at[last] = value


def _describe(error: ErrorDetails, known: Sequence[str]) -> str:
    """One of pydantic's errors in words; for an unknown key, with the nearest spelling among ``known``."""
    tags = ("Steps", "range", "list")  # pydantic's, of unions
    where = ".".join(str(part) for part in error["loc"] if "[" not in str(part) and part not in tags)
    text, got = error["msg"].removeprefix("Value error, "), error["input"]
    if error["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(error["loc"][-1]), known, n=1)
        text = "unknown key" + (f"; did you mean '{near[0]}'?" if near else "")
    elif isinstance(got, str | int | float | None):
        text += f" (got {shorten(got)})"
    return f"{where}: {text}" if where else text
