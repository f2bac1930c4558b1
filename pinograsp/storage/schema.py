"""Records as plain values and arrays, and back, by the types of their fields.

A field is told once, in its record. Numbers, texts, mappings, tuples and records within records become JSON; arrays are
kept apart, by their path in the record (``motion.q``). Hands and objects are written once, however many records hold
them. Where a value is of another class than its field's type (a solution of one search, a contact law of one kind), its
class is written beside it: a class that inherits from the type of the field needs nothing else.

Beside its type, a field may tell the sizes of its array or tuple: ``Annotated[Array, "k 3"]``, letters being the same
number throughout a record and ``*`` any; :data:`INFINITE` admits infinite numbers in it.
"""

from __future__ import annotations

import functools
import inspect
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import frozen, one_of, shorten
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.objects.body import Body
from pinograsp.objects.record import object_of, object_record
from pinograsp.plan.parts import INFINITE

HUGE = 1e30  # no quantity here is larger, in any unit; products of a few still fit into a float
_MOST = 10**300  # of counts: the points of a grid are some 10^(5 k)
_CLASS = "class"  # beside the fields: no field can be called so

Arrays = dict[str, NDArray[Any]]
T = TypeVar("T")


class _Whole(NamedTuple):
    """A class whose instances have a form of their own, and are written once."""

    kind: type
    shelf: str
    write: Callable[[Any], dict[str, Any] | None]
    read: Callable[[dict[str, Any]], Any]


_WHOLE = (
    _Whole(HandModel, "hands", hand_record, hand_of),
    _Whole(Body, "objects", object_record, object_of),
)
# Classes of others that are made from arrays which they have as attributes.
_MADE_OF = {"PPoly": ("c", "x")}


class Written(NamedTuple):
    """A record, written down.

    Attributes:
        plain: its fields as plain JSON values, without arrays.
        arrays: by their paths.
        scene: ``{"hands": [...], "objects": [...]}``; None in place of what cannot be written down.
    """

    plain: dict[str, Any]
    arrays: Arrays
    scene: dict[str, list[dict[str, Any] | None]]


def write_record(record: object) -> Written:
    """The record as plain values, arrays, and the hands and objects that it holds.

    Raises:
        InvalidInput: values that cannot be written down.
    """
    writer = _Writer()
    plain = writer.fields(record, "")
    scene = {
        one.shelf: [one.write(value) for value in writer.shelves[one.shelf]]
        for one in _WHOLE
        if writer.shelves[one.shelf]
    }
    return Written(plain, writer.arrays, scene)


def read_record(kind: type[T], plain: Any, arrays: Mapping[str, NDArray[Any]], scene: Mapping[str, Any] | None) -> T:
    """The record of that class; fields that it does not know are left alone, those left out have their defaults.

    Args:
        kind: the record's class.
        plain, arrays, scene: as :func:`write_record` gave them; without a scene there are no hands and objects.

    Raises:
        InvalidInput: the first value that is not as its type says.
        HandNotLoaded: mesh files that are missing.
    """
    value: T = _Reader(arrays, scene).record(kind, plain, "")
    return value


class _Writer:
    """Collects arrays, hands and objects on the way through a record."""

    def __init__(self) -> None:
        self.arrays: Arrays = {}
        self.shelves: dict[str, list[Any]] = {one.shelf: [] for one in _WHOLE}

    def fields(self, record: Any, path: str) -> dict[str, Any]:
        plain = {}
        kind: type = type(record)
        for name, hint in _hints(kind).items():
            value, place = getattr(record, name), f"{path}.{name}" if path else name
            written = self.value(value, _bare(hint), place)
            if not isinstance(value, np.ndarray):
                plain[name] = written
        return plain

    def value(self, value: Any, hint: Any, path: str) -> Any:
        if hint is Any or value is None or (isinstance(value, bool | int | str) and not isinstance(value, Enum)):
            return value
        if isinstance(value, Enum):
            return value.value
        if isinstance(value, float | np.number | np.bool_):
            number = value.item() if isinstance(value, np.generic) else value
            return number if math.isfinite(number) else str(number)
        if isinstance(value, np.ndarray):
            self.arrays[path] = value
            return None
        for one in _WHOLE:
            if isinstance(value, one.kind):
                return self._number_on(self.shelves[one.shelf], value)
        if _is_record(type(value)):
            kind = {} if type(value) is hint else {_CLASS: type(value).__name__}
            return kind | self.fields(value, path)
        if isinstance(value, Mapping):
            inner = get_args(hint)[1] if get_origin(hint) in (dict, Mapping) else None
            return {str(name): self.value(one, inner, f"{path}.{name}") for name, one in value.items()}
        if isinstance(value, tuple | list):
            inner = [*get_args(hint), None]
            return [
                self.value(one, inner[0 if inner[1] is ... else min(i, len(inner) - 1)], f"{path}.{i}")
                for i, one in enumerate(value)
            ]
        raise InvalidInput(f"{path}: expected what can be written down, got {shorten(value)}")

    @staticmethod
    def _number_on(shelf: list[Any], value: Any) -> int:
        for i, other in enumerate(shelf):
            if other is value:
                return i
        shelf.append(value)
        return len(shelf) - 1


class _Reader:
    """Makes records from what was written, checked against the types of their fields."""

    def __init__(self, arrays: Mapping[str, NDArray[Any]], scene: Mapping[str, Any] | None):
        self._arrays, self._scene = arrays, scene
        self._made: dict[tuple[str, int], Any] = {}
        self._sizes: dict[str, int] = {}

    def record(self, kind: type, plain: Any, path: str) -> Any:
        if not isinstance(plain, dict):
            raise _refusal(path, f"a mapping, the fields of a {kind.__name__}", plain)
        kind = _class_of(kind, plain.get(_CLASS), path)
        values, optional = {}, _optional(kind)
        for name, hint in _hints(kind).items():
            place = f"{path}.{name}" if path else name
            if name in plain or place in self._arrays:
                values[name] = self.value(hint, plain.get(name), place)
            elif name not in optional:
                raise InvalidInput(f"{place}: expected {_in_words(hint)}, got none: written by another version?")
        return kind(**values)

    def value(self, hint: Any, plain: Any, path: str) -> Any:  # one return for each kind of type
        origin, inner = get_origin(hint), get_args(hint)
        if origin is Annotated:
            value = self.value(inner[0], plain, path)
            self._check_sizes(value, inner[1:], path)
            return value
        if hint is Any:
            return plain
        if origin in (Union, UnionType):
            return self._any_of(inner, plain, path)
        if origin is Literal:
            return one_of(path, plain, inner)
        if origin is np.ndarray:
            return self._array(hint, path)
        if origin is tuple:
            if not isinstance(plain, list) or (inner[-1] is not ... and len(plain) != len(inner)):
                raise _refusal(path, "a list" if inner[-1] is ... else f"a list of {len(inner)}", plain)
            kinds = inner[:1] * len(plain) if inner[-1] is ... else inner
            return tuple(self.value(*pair, f"{path}.{i}") for i, pair in enumerate(zip(kinds, plain)))
        if origin is not None and issubclass(origin, Mapping):
            if not isinstance(plain, dict):
                raise _refusal(path, "a mapping", plain)
            return {name: self.value(inner[1], one, f"{path}.{name}") for name, one in plain.items()}
        for one in _WHOLE:
            if issubclass(hint, one.kind):
                return self._from_shelf(one, plain, path)
        if issubclass(hint, Enum):
            return hint(one_of(path, plain, [one.value for one in hint]))
        return self._scalar(hint, plain, path) if hint in (bool, int, float, str) else self.record(hint, plain, path)

    def _scalar(self, hint: type, plain: Any, path: str) -> Any:
        if hint is float:
            if plain in ("inf", "-inf"):
                return float(plain)
            if isinstance(plain, int | float) and not isinstance(plain, bool) and abs(plain) <= HUGE:
                return float(plain)
            raise _refusal(path, f"a number up to {HUGE:g}", plain)
        good = isinstance(plain, hint) and (hint is bool or not isinstance(plain, bool))
        if not good or (hint is int and abs(plain) > _MOST):
            raise _refusal(path, _in_words(hint), plain)
        return plain

    def _any_of(self, kinds: tuple[Any, ...], plain: Any, path: str) -> Any:
        """A value of one of several types: None, an array where there is one, else the first that it fits."""
        if path in self._arrays:
            kinds = tuple(kind for kind in kinds if get_origin(_bare(kind)) is np.ndarray)
        elif plain is None and NoneType in kinds:
            return None
        kinds = tuple(kind for kind in kinds if kind is not NoneType)
        for kind in kinds[:-1]:
            try:
                return self.value(kind, plain, path)
            except InvalidInput:
                continue
        if not kinds:
            raise InvalidInput(f"{path}: expected no array")
        return self.value(kinds[-1], plain, path)

    def _array(self, hint: Any, path: str) -> NDArray[Any]:
        if path not in self._arrays:
            raise InvalidInput(f"{path}: expected an array of that name, got none: written by another version?")
        array, (wanted,) = self._arrays[path], get_args(get_args(hint)[1])
        if not np.issubdtype(array.dtype, wanted):
            raise InvalidInput(f"{path}: expected an array of {wanted.__name__}, got {array.dtype}")
        if array.dtype.kind == "f":
            finite = np.abs(array[np.isfinite(array)])
            if np.isnan(array).any() or (finite > HUGE).any():
                raise InvalidInput(f"{path}: expected numbers up to {HUGE:g}")
        return frozen(array)

    def _check_sizes(self, value: Any, notes: tuple[str, ...], path: str) -> None:
        """Whether an array or a tuple has the sizes that its field tells."""
        is_array = isinstance(value, np.ndarray)
        if value is None or not (is_array or isinstance(value, tuple)):
            return
        names, sizes = notes[0].split(), value.shape if is_array else (len(value),)
        if len(names) == len(sizes):
            for name, size in zip(names, sizes):
                if name.isalpha():
                    self._sizes.setdefault(name, size)
        wanted = tuple(int(name) if name.isdigit() else self._sizes.get(name, -1) for name in names)
        if len(wanted) != len(sizes) or any(a not in (-1, b) for a, b in zip(wanted, sizes)):
            shape = ", ".join("any" if size < 0 else str(size) for size in wanted)
            raise InvalidInput(f"{path}: expected sizes ({shape}), got {sizes}")
        if is_array and value.dtype.kind == "f" and INFINITE not in notes and not np.isfinite(value).all():
            raise InvalidInput(f"{path}: expected finite numbers")

    def _from_shelf(self, whole: _Whole, number: Any, path: str) -> Any:
        if self._scene is None:
            return None
        shelf = self._scene.get(whole.shelf)
        if type(number) is not int or not isinstance(shelf, list) or not 0 <= number < len(shelf):
            raise _refusal(path, f"the number of one of the scene's {whole.shelf}", number)
        key = (whole.shelf, number)
        if key not in self._made:
            self._made[key] = None if shelf[number] is None else whole.read(shelf[number])
        return self._made[key]


def _refusal(path: str, wanted: str, got: object) -> InvalidInput:
    return InvalidInput(f"{path[:200]}: expected {wanted}, got {shorten(got)}")


def _in_words(hint: Any) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}.get(hint, "a value")


def _bare(hint: Any) -> Any:
    """A type without the notes beside it, and without None where it has one other meaning."""
    if get_origin(hint) is Annotated:
        return _bare(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        others = [one for one in get_args(hint) if one is not NoneType]
        return _bare(others[0]) if len(others) == 1 else hint
    return hint


def _is_record(kind: type) -> bool:
    return is_dataclass(kind) or hasattr(kind, "_fields") or kind.__name__ in _MADE_OF


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    """The types of the fields that a record is made from."""
    if kind.__name__ in _MADE_OF:
        return dict.fromkeys(_MADE_OF[kind.__name__], NDArray[np.float64])
    if not (is_dataclass(kind) or hasattr(kind, "_fields")):
        raise InvalidInput(f"{kind.__name__}: expected a record")
    hints = get_type_hints(kind, include_extras=True)
    names = [one.name for one in fields(kind) if one.init] if is_dataclass(kind) else list(hints)
    return {name: hints[name] for name in names}


def _optional(kind: type) -> set[str]:
    """The fields that have a default."""
    if is_dataclass(kind):
        return {one.name for one in fields(kind) if one.default is not MISSING or one.default_factory is not MISSING}
    return set(getattr(kind, "_field_defaults", ()))


def _class_of(kind: type, name: Any, path: str) -> type:
    """The class of that name among ``kind`` and those that inherit from it; ``kind`` itself where none is told."""
    if name is None and not inspect.isabstract(kind):
        return kind
    known: dict[str, type] = {kind.__name__: kind} | {heir.__name__: heir for heir in _heirs(kind)}
    return known[one_of(f"{path}.{_CLASS}", name, known)]


def _heirs(kind: type) -> Iterator[type]:
    heirs: list[type] = kind.__subclasses__()
    for one in heirs:
        if (
            getattr(sys.modules.get(one.__module__), one.__name__, None) is one
        ):  # not what dataclass(slots=True) replaced
            yield one
        yield from _heirs(one)
