"""YAML files that xacro files read their numbers from: plain data of bounded size, in the YAML that xacro reads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from pinograsp.hands import arithmetic
from pinograsp.hands.elements import read_bytes

_SUFFIXES = (".yaml", ".yml")
_MOST_BYTES = 100_000
_DEEPEST = 50  # lists and mappings inside each other
# Numbers with units, as xacro reads them: in radians and metres.
_UNITS = {
    "!radians": 1.0,
    "!degrees": math.pi / 180,
    "!meters": 1.0,
    "!millimeters": 1e-3,
    "!foot": 0.3048,
    "!inches": 0.0254,
}


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # it has no types
    """Builds plain data, and numbers with units."""

    def number(self, node: yaml.ScalarNode) -> float:
        return float(arithmetic.evaluate(node.value, {}, {})) * _UNITS[str(node.tag)]

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        super().flatten_mapping(node)
        if len(node.value) > arithmetic.MOST_DATA:  # what is merged may double again and again
            raise ValueError(f"expected at most {arithmetic.MOST_DATA} values in a mapping")


for _unit in _UNITS:
    _Loader.add_constructor(_unit, _Loader.number)


def read_yaml(path: Path) -> Any:
    """What a YAML file says: mappings, lists, texts and numbers.

    Raises:
        OSError: it cannot be read.
        ValueError: not YAML, more than plain data, or too large.
    """
    if path.suffix not in _SUFFIXES:
        raise ValueError(f"only {' and '.join(_SUFFIXES)} files are allowed")
    text = read_bytes(path, _MOST_BYTES).decode("utf-8-sig")
    try:
        value = yaml.load(text, _Loader)
    except RecursionError:
        raise ValueError(f"expected at most {_DEEPEST} nested lists and mappings") from None
    except Exception as error:  # numbers, dates, keys and tags that cannot be built raise errors of many kinds
        raise ValueError(f"not valid YAML: {' '.join(str(error).split())}") from error
    if arithmetic.size_of(value) > arithmetic.MOST_DATA:
        raise ValueError(f"expected at most {arithmetic.MOST_DATA} values and characters, aliases expanded")
    if _depth(value) > _DEEPEST:
        raise ValueError(f"expected at most {_DEEPEST} nested lists and mappings")
    return value


def _depth(value: Any) -> int:
    """How deep lists and mappings are inside each other."""
    inside = value if isinstance(value, list | tuple) else value.values() if isinstance(value, dict) else None
    return 0 if inside is None else 1 + max(map(_depth, inside), default=0)
