"""How much lists and dicts of a file hold altogether, where they may hold the same ones again and again."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

_DEEPEST = 100  # lists and dicts within each other
_CONTAINERS = (list, tuple, dict, np.ndarray)


def _inner(value: Any) -> Iterable[Any]:
    """What is in a list, a tuple, a dict, or an array of objects."""
    if isinstance(value, np.ndarray):
        return value.ravel().tolist() if value.dtype.kind == "O" else ()
    return value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()


def check_contents(value: Any, most: int) -> None:
    """Refuse lists and dicts that hold more than ``most`` values, counted wherever they stand, or each other without
    end.

    Raises:
        ValueError: they do.
    """
    extents: dict[int, int] = {}  # by identity: of what has been counted
    begun: set[int] = set()
    waiting = [(value, False)]
    while waiting:
        one, counted = waiting.pop()
        if counted:
            begun.discard(id(one))
            extents[id(one)] = 1 + sum(extents.get(id(part), 1) for part in _inner(one))
            if extents[id(one)] > most:
                raise ValueError(f"expected at most {most} values in a file of its size, got more")
        elif id(one) in begun or len(begun) > _DEEPEST:
            raise ValueError(f"expected at most {_DEEPEST} lists and dicts within each other")
        elif id(one) not in extents:
            begun.add(id(one))
            waiting.append((one, True))
            waiting += [(part, False) for part in _inner(one) if isinstance(part, _CONTAINERS)]
