"""What stands under the keys of a file: taken strictly, and named where it is missing or of another kind."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import shorten
from pinograsp.errors import GraspsNotRead
from pinograsp.spatial import Array
from pinograsp.words import printable

_Row = TypeVar("_Row")
_MOST_NUMBERS = 2_000_000  # in lists; arrays have no such limit
_MOST_STACKED = 2**28  # [bytes] of arrays, which may be the same ones again and again
_DEEPEST = 6  # lists within each other
_LONGEST_NAME = 1000  # characters
NAME = f"a text of at most {_LONGEST_NAME} characters that can be printed"


class Keys:
    """A mapping of a file.

    Args:
        source: the file, for messages.
        values: the mapping; anything else is refused.
        format: how the file was taken to be written, for messages.
        where: the keys that lead to it.
        row: the row it stands in.
    """

    def __init__(self, source: str, values: Any, format: str, where: str = "", row: int | None = None):
        self.source, self._format, self._where, self._row = source, format, where, row
        if not isinstance(values, Mapping):
            raise self.refusal(f"expected a mapping {self._at()}, got a {type(values).__name__}".replace("  ", " "))
        self.values = values

    def refusal(self, problem: str) -> GraspsNotRead:
        """The exception that says ``problem`` of this file."""
        how = f" (read as {self._format}; format= says which it is)"
        return GraspsNotRead(self.source, printable(problem, 500) + how, row=self._row)

    def _at(self, name: str = "") -> str:
        path = f"{self._where}/{name}".strip("/")
        return f"'{printable(path)}'" if path else ""

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def need(self, names: Iterable[str]) -> None:
        """Refuse a file without all of these keys, and name those that are missing."""
        if missing := [self._at(name) for name in names if name not in self.values]:
            there = ", ".join(printable(str(key), 40) for key in list(self.values)[:20])
            raise self.refusal(f"expected keys {', '.join(missing)}, got only {there or 'none'}")

    def get(self, name: str) -> Any:
        """What stands there."""
        self.need([name])
        return self.values[name]

    def inner(self, name: str) -> Keys:
        """The mapping that stands there."""
        return Keys(self.source, self.get(name), self._format, f"{self._where}/{name}".strip("/"), self._row)

    def text(self, name: str) -> str:
        """A text that can be written down; arrays and lists of one text are that text."""
        value = self.get(name)
        for _ in range(3):
            if isinstance(value, np.ndarray) and value.size == 1:
                value = _item(value)
            elif isinstance(value, list | tuple) and len(value) == 1:
                value = value[0]
        try:
            text = value.decode("utf-8") if isinstance(value, bytes) else str(value) if isinstance(value, str) else None
        except UnicodeError:
            text = None
        if text is None or not is_name(text):
            raise self.refusal(f"{self._at(name)}: expected {NAME}, got {shorten(value)}")
        return text

    def texts(self, name: str) -> tuple[str, ...]:
        """A list of texts."""
        value = self.get(name)
        items = value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind in "UO" else value
        if not isinstance(items, list | tuple):
            raise self.refusal(f"{self._at(name)}: expected a list of names, got {shorten(value)}")
        return self.names(items)

    def names(self, items: Iterable[Any]) -> tuple[str, ...]:
        """Names of joints that stand there."""
        items = tuple(items)
        for one in items:
            if not is_name(one):
                raise self.refusal(f"{self._at()}: expected a joint's name, {NAME}, got {shorten(one)}".lstrip(": "))
        return items

    def number(self, name: str) -> float:
        """A number; NaN and infinity are kept."""
        return float(self.array(name, ()))

    def array(self, name: str, shape: tuple[int | None, ...]) -> Array:
        """Numbers of a shape, where None is any size, as floats; NaN and infinity are kept."""
        array = self.any_array(name)
        if array.ndim != len(shape) or any(wanted not in (None, got) for wanted, got in zip(shape, array.shape)):
            words = ", ".join("any" if one is None else str(one) for one in shape)
            raise self.refusal(f"{self._at(name)}: expected numbers of shape ({words}), got {array.shape}")
        return array

    def any_array(self, name: str) -> Array:
        """Numbers of any shape, as floats."""
        value = self.get(name)
        array = as_numbers(value)
        if array is None:
            raise self.refusal(f"{self._at(name)}: expected numbers, got {shorten(value)}")
        return np.asarray(array, dtype=float)

    def scale(self, name: str) -> float:
        """A scale: one number, or the same number three times."""
        values = self.any_array(name).ravel()
        if values.size not in (1, 3) or not np.allclose(values, values[:1], rtol=1e-6, atol=0):
            raise self.refusal(
                f"{self._at(name)}: expected one scale for all directions, got {shorten(values.tolist())}"
            )
        return float(values[0])

    def leftovers(self, taken: Iterable[str], count: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Further numbers of each row: those of one number a row (N,), and those of more (N, ...)."""
        labels, extras = {}, {}
        for name, array in self.arrays(taken).items():
            if array.shape == (count,):
                labels[printable(name)] = array
            elif array.ndim > 1 and len(array) == count:
                extras[printable(name)] = array
        return labels, extras

    def arrays(self, taken: Iterable[str], *, lists: bool = True) -> dict[str, NDArray[Any]]:
        """All numbers under other keys than those that were taken; ``lists``: also those of lists."""
        return {
            name: array
            for name, value in self.values.items()
            if isinstance(name, str) and name not in taken and (lists or not isinstance(value, list | tuple))
            if (array := as_numbers(value)) is not None
        }


def rows_to_fault(items: Iterable[Keys], make: Callable[[Keys, list[_Row]], _Row]) -> tuple[list[_Row], str | None]:
    """What ``make`` takes from each mapping, given the rows before it, up to the first that is refused, and why."""
    rows: list[_Row] = []
    try:
        for keys in items:
            rows.append(make(keys, rows))
    except GraspsNotRead as refusal:
        return rows, refusal.problem
    return rows, None


def is_name(value: object) -> bool:
    """Whether a value is what a file may call something: what is printed of it can neither steer a terminal nor fill a
    screen.
    """
    return isinstance(value, str) and len(value) <= _LONGEST_NAME and value.isprintable()


def stack(arrays: Sequence[NDArray[Any] | None], source: str) -> NDArray[Any] | None:
    """Arrays of one shape in a first dimension; None where one is missing, or has another shape.

    Raises:
        GraspsNotRead: they are too large altogether.
    """
    first = arrays[0] if arrays else None
    if first is None or any(one is None or one.shape != first.shape for one in arrays):
        return None
    if first.size * len(arrays) > _MOST_STACKED // 8:
        raise GraspsNotRead(source, f"expected at most {_MOST_STACKED} bytes of one kind of numbers, got more")
    return np.array(arrays)


def _item(array: NDArray[Any]) -> Any:
    try:
        return array.reshape(-1)[0]
    except ValueError:  # characters that there are not
        return None


def as_numbers(value: Any) -> NDArray[Any] | None:
    """Numbers and truth values as an array, within bounds; None where it is anything else."""
    if isinstance(value, np.ndarray):
        return value if value.dtype.kind in "fiub" else None
    if isinstance(value, np.generic | float | int):
        array = np.asarray(value)
        return array if array.dtype.kind in "fiub" else None
    if not isinstance(value, list | tuple):
        return None
    level: list[Any] = [value]
    for _ in range(_DEEPEST):
        if not all(isinstance(one, list | tuple) for one in level):
            break
        if sum(map(len, level)) > _MOST_NUMBERS:  # lists may hold the same list again and again
            return None
        level = [one for part in level for one in part]
    if not all(isinstance(one, float | int | np.bool_ | np.number) for one in level):
        return None
    try:
        array = np.array(value)
    except (ValueError, OverflowError):  # lists of different lengths
        return None
    return array if array.dtype.kind in "fiub" and array.size == math.prod(array.shape) == len(level) else None
