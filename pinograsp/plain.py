"""Plain values from the JSON and YAML of others: of bounded depth and number, and nothing in them is run."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

import yaml

from pinograsp.checks import one_line

_MOST_DIGITS, _MOST_DOCUMENTS = 400, 1000  # of a number, and of a YAML file
_NUMBER = re.compile(r"[-+]?(?:\d+(\.\d*)?|(\.\d+))([eE][-+]?\d+)?", re.ASCII)  # 1e-5 too, which is a text to YAML 1.1
_BOOL = re.compile("true|false", re.IGNORECASE)
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def plain_json(content: bytes, deepest: int, most: float = math.inf) -> Any:
    """What JSON says: mappings, lists, texts and finite numbers.

    Raises:
        ValueError: no JSON in UTF-8, a key that comes twice, NaN or infinity, halves of characters, more than
            ``deepest`` levels or ``most`` values.
    """
    if sum(map(content.count, (b",", b"[", b"{"))) > most:
        raise ValueError(f"expected at most {most} values")
    try:
        value = json.loads(
            content.decode("utf-8-sig"), object_pairs_hook=_once, parse_constant=_no_constant, parse_int=_bounded_int
        )
    except RecursionError:
        raise ValueError(f"expected at most {deepest} levels") from None
    if b"\\u" in content:  # only escapes can be halves of characters
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeError:
            raise ValueError("expected readable text, got characters that no encoding has") from None
        except RecursionError:
            raise ValueError(f"expected at most {deepest} levels") from None
    level = [value]
    for _ in range(deepest):
        level = [
            one
            for part in level
            if isinstance(part, dict | list)
            for one in (part.values() if isinstance(part, dict) else part)
            if isinstance(one, dict | list)
        ]
    if level:
        raise ValueError(f"expected at most {deepest} levels")
    return value


def plain_yaml(content: bytes, deepest: int, most: int) -> list[Any]:
    """What the documents of a YAML file say, one after another, as of :class:`YamlValues`.

    Raises:
        ValueError: no YAML in UTF-8, or more than that allows.
    """
    values = YamlValues(content.decode("utf-8-sig"), deepest, most)
    try:
        values.run()
    except yaml.YAMLError as error:
        raise ValueError(one_line(error)) from error
    return values.documents


class YamlValues:
    """Plain data from the events of a YAML text, as they come; tags are refused.

    Args:
        text: YAML.
        deepest: mappings and lists within each other.
        most: values and keys, aliases expanded.

    Attributes:
        documents: what was read so far. Of a document that breaks off, the outermost two levels are complete up to
            there.
    """

    def __init__(self, text: str, deepest: int, most: int):
        self._loader = _LOADER(text)
        self._deepest, self._most, self._count = deepest, most, 0
        self._anchors: dict[str, tuple[Any, int]] = {}  # complete values, and of how many parts
        self.documents: list[Any] = []

    def run(self) -> None:
        """Read to the end.

        Raises:
            yaml.YAMLError, ValueError: it is broken, or more than allowed.
        """
        try:
            while self._loader.check_event():
                if isinstance(self._loader.get_event(), yaml.DocumentStartEvent):
                    self._value(self._loader.get_event(), self.documents.append, 0)
                    self._anchors.clear()
                    if len(self.documents) > _MOST_DOCUMENTS:
                        raise ValueError(f"expected at most {_MOST_DOCUMENTS} documents")
        finally:
            self._loader.dispose()

    def _value(self, event: Any, put: Callable[[Any], None], depth: int) -> None:
        self._more(1)
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise ValueError(f"expected aliases of complete values before them, got *{event.anchor[:60]}")
            value, parts = self._anchors[event.anchor]
            self._more(parts)
            return put(value)
        if event.tag is not None:
            raise ValueError("expected plain values, without tags")
        if isinstance(event, yaml.ScalarEvent):
            value, before = self._scalar(event), self._count
            put(value)
        else:
            if depth >= self._deepest:
                raise ValueError(f"expected at most {self._deepest} mappings and lists within each other")
            before = self._count
            value = self._collection(event, put, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = value, self._count - before
        return None

    def _collection(self, event: yaml.Event, put: Callable[[Any], None], depth: int) -> Any:
        """A list or a mapping; at depth 2 and below it is put where it belongs when it is complete."""
        value: Any = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        late = depth >= 2 and isinstance(value, dict)
        if not late:
            put(value)
        if isinstance(value, list):
            while not isinstance(inner := self._loader.get_event(), yaml.SequenceEndEvent):
                self._value(inner, value.append, depth + 1)
        else:
            while not isinstance(key := self._loader.get_event(), yaml.MappingEndEvent):
                if not isinstance(key, yaml.ScalarEvent) or key.value in value:
                    raise ValueError("expected texts as keys, each once")
                self._more(1)
                self._value(self._loader.get_event(), functools.partial(value.__setitem__, key.value), depth + 1)
            if isinstance(merged := value.pop("<<", None), dict):
                value.update({**merged, **value})
        if late:
            put(value)
        return value

    def _scalar(self, event: yaml.ScalarEvent) -> Any:
        text = event.value
        if event.implicit[0] and (number := _NUMBER.fullmatch(text)):
            if len(text) > _MOST_DIGITS:
                raise ValueError("expected numbers, got one of too many digits")
            return float(text) if any(number.groups()) else int(text)
        tag = self._loader.resolve(yaml.ScalarNode, text, event.implicit)
        kind = tag.rpartition(":")[2]
        # Of YAML 1.1 only what YAML 1.2 has as well: "on", "no" and "1:30" are texts.
        if (
            kind not in ("int", "float", "bool", "null")
            or ":" in text
            or (kind == "bool" and not _BOOL.fullmatch(text))
        ):
            return text
        if len(text) > _MOST_DIGITS:
            raise ValueError("expected numbers, got one of too many digits")
        return self._loader.construct_object(yaml.ScalarNode(tag, text))

    def _more(self, parts: int) -> None:
        self._count += parts
        if self._count > self._most:
            raise ValueError(f"expected at most {self._most} values, aliases expanded")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"expected each key once, got {max(keys, key=keys.count)[:60]!r} again")
    return document


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"expected finite numbers, got {name}")


def _bounded_int(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"expected numbers, got one of {len(text)} digits")
    return int(text)
