"""Pickles of plain data, read without running any: an unpickler that knows no names but those of numbers and arrays.

The standard library's own, in Python, builds numbers, texts, lists, tuples and dicts; it is given no other opcodes than
those need, and what it takes from a file is bounded before it is built. What a pickle asks for by name is looked up in
one table of stand-ins, and all else is refused by its name. The C form of the unpickler is no base for this: it sets
any key in any object, and hashes what keys a file has before anybody sees them.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.data.extent import check_contents

_MOST_OPCODES = 5_000_000  # 2 s; data sets have some thousands
_MOST_BYTES = 2**30  # of all arrays of a file, unpacked
# Bytes of arrays, and items of lists and dicts with all that stands in several places counted there, for each byte of
# the file: what is written out has at least one byte an item. The rest is for small files.
_ARRAYS_A_BYTE, _SMALL = 16, 2**24
_ITEMS_A_BYTE, _FEW = 2, 1000
_LARGEST_KEY = 2**60  # beyond it, many integers have the same hash, and a dict of them takes for ever
_OBJECT = 512  # [bytes] that an object in an array counts for: a list may be in many of them
_MOST_DIMENSIONS = 32
_LONGEST_LINE = 1000  # characters of a name or a number in text
# Numbers, truth values and texts; sizes in bytes, of characters for U.
_DTYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|[SU][1-9]\d{0,5}|O8?|\?)")
_OPCODES = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    *("PROTO", "FRAME", "MARK", "STOP", "NONE", "NEWTRUE", "NEWFALSE"),
    *("EMPTY_LIST", "LIST", "APPEND", "APPENDS", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
    *("EMPTY_DICT", "DICT", "SETITEM", "SETITEMS"),
    *("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET"),
    *("GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "BINPERSID"),
}
_CODES = {ord(one.code): one.name for one in pickletools.opcodes}


class PickleRefused(ValueError):
    """A pickle that is not plain data, or is broken. ``rows`` are the complete items of its outermost list."""

    def __init__(self, problem: str, rows: list[Any] | None = None):
        self.rows = rows or []
        super().__init__(problem)


class _Array:
    """An array that is still being built."""

    __slots__ = ("value",)

    def __init__(self) -> None:
        self.value: NDArray[Any] | None = None


class _Type:
    """A data type of arrays, by its letters; its byte order comes later."""

    __slots__ = ("text",)

    def __init__(self, text: str) -> None:
        self.text = text

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.text)


class _Name:
    """A name that a pickle asks for: no function, only what stands in the table under it."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name


class _Dispatch:
    """The unpickler's steps by opcode: counted, and only those that plain data needs."""

    def __init__(self, steps: Mapping[int, Callable[..., Any]]):
        self._steps, self._left, self.opcode = steps, _MOST_OPCODES, ""

    def __getitem__(self, code: int) -> Callable[..., Any]:
        self.opcode = _CODES.get(code, f"{code:#x}")
        self._left -= 1
        if self._left < 0:
            raise PickleRefused(f"expected at most {_MOST_OPCODES} opcodes")
        if self.opcode not in _OPCODES:
            if code not in _CODES:
                raise ValueError(f"no opcode {self.opcode}")
            raise PickleRefused(f"opcode {self.opcode} is not allowed: plain data does not need it")
        return self._steps[code]


class Unpickled(pickle._Unpickler):
    """``value`` is what a pickle holds.

    Args:
        content: the pickle, from its first byte; what comes after its end is not looked at.
        size: of the file that it is in [bytes], where that holds the numbers of its arrays; default: of the pickle.
        names: further names, with what stands for them: a function of the call's arguments, or any other value.
        stored: what stands for a persistent id, where there may be any.
    """

    stack: list[Any]
    metastack: list[list[Any]]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]
    read: Callable[[int], bytes]

    def __init__(
        self,
        content: bytes,
        *,
        size: int | None = None,
        names: Mapping[str, Any] | None = None,
        stored: Callable[[Any], Any] | None = None,
    ):
        super().__init__(_Lines(content))
        self._names = {**_NUMPY, **(names or {})}
        self._stored, self._size = stored, len(content)
        self._room = self._left = min(_MOST_BYTES, _SMALL + _ARRAYS_A_BYTE * (len(content) if size is None else size))
        self._most_items = _FEW + _ITEMS_A_BYTE * len(content)
        self._steps = _Dispatch({**pickle._Unpickler.dispatch, **_STEPS})
        self.dispatch = self._steps  # type: ignore[misc, assignment]
        try:
            self.value = _plain(self.load())
            self._check_extent(self.value)
        except PickleRefused as refusal:
            raise PickleRefused(str(refusal), self._complete_rows()) from None
        except Exception as error:  # what comes of a broken file: of the length, of a number, of an empty stack
            text = " ".join(str(error).split())[:200]
            where = f" at opcode {self._steps.opcode}" * bool(self._steps.opcode)
            raise PickleRefused(f"the pickle is broken or cut off{where} ({text})", self._complete_rows()) from None

    def _complete_rows(self) -> list[Any]:
        """Items of the outermost list that stand before a fault."""
        levels = [*self.metastack, self.stack]
        place = next(
            ((i, j) for i, level in enumerate(levels) for j, one in enumerate(level) if type(one) is list), None
        )
        if place is None:
            return []
        i, j = place
        rows = list(levels[i][j])
        if j + 1 == len(levels[i]) and i + 1 < len(levels):  # rows that are to be added together
            # The last of them may be a dict whose items are still to come, above a further mark.
            rows += levels[i + 1][:-1] if i + 2 < len(levels) else levels[i + 1]
        complete = [one for one in rows if type(one) is dict and one]
        try:
            self._check_extent(complete)
        except PickleRefused:
            return []
        return complete

    def _check_extent(self, value: Any) -> None:
        try:
            check_contents(value, self._most_items)
        except ValueError as error:
            raise PickleRefused(str(error)) from None

    # -- what a pickle may ask for

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of a name."""
        asked = f"{module} {name}"
        if asked not in self._names:
            shown = ".".join(asked.split())[:100]
            raise PickleRefused(f"it asks for '{shown}', which is not plain data: nothing in the file was executed")
        value = self._names[asked]
        return _Name(asked) if callable(value) else value

    def persistent_load(self, pid: Any) -> Any:
        """What stands for something outside of the pickle."""
        if self._stored is None:
            raise PickleRefused("it refers to something outside the file")
        return self._stored(pid)

    # -- steps that build from what is on the stack

    def _append(self, items: list[Any]) -> None:
        into = self.stack[-1]
        if type(into) is not list:
            raise PickleRefused(f"items are added to a {_kind(into)}: expected a list")
        into.extend(map(_plain, items))

    def _set(self, items: list[Any]) -> None:
        into = self.stack[-1]
        if type(into) is not dict:
            raise PickleRefused(f"items are set in a {_kind(into)}: expected a dict")
        if len(items) % 2:
            raise PickleRefused("a key without a value")
        for key, value in zip(items[::2], items[1::2]):
            # Tuples within tuples are hashed without an end.
            if not (isinstance(key, str) or (isinstance(key, int) and -_LARGEST_KEY < key < _LARGEST_KEY)):
                kind = "too large an int" if isinstance(key, int) else f"a {_kind(key)}"
                raise PickleRefused(f"{kind} as a key: expected texts and integers")
            into[key] = _plain(value)

    def _dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._set(items)

    def _bytearray(self) -> None:
        (size,) = np.frombuffer(self.read(8), dtype="<u8").tolist()
        if size > self._size:
            raise pickle.UnpicklingError("pickle data was truncated")
        self.append(bytearray(self.read(size)))

    def _reduce(self) -> None:
        arguments, name = self.stack.pop(), self.stack.pop()
        if type(name) is not _Name or type(arguments) is not tuple:
            raise PickleRefused(f"a {_kind(name)} is called: nothing in the file was executed")
        self.append(self._names[name.name](self, *arguments))

    def _build(self) -> None:
        state, value = self.stack.pop(), self.stack[-1]
        if type(value) is _Array and type(state) is tuple and len(state) == 5:
            _, shape, kind, fortran, raw = state
            value.value = self.array(kind, shape, raw, bool(fortran))
        elif type(value) is _Type and type(state) is tuple and len(state) in (8, 9):
            _order(value, state)
        else:
            raise PickleRefused(f"a {_kind(value)} gets a state: nothing in the file was executed")

    # -- arrays

    def room_for(self, size: int) -> None:
        """Refuse arrays that are larger altogether than a file of this size may unpack to."""
        self._left -= size
        if size < 0 or self._left < 0:
            raise PickleRefused(f"expected at most {self._room} bytes of arrays in a file of its size, got more")

    def room_for_shape(self, sizes: tuple[int, ...], size: int) -> None:
        """As :meth:`room_for`, for an array with numbers of ``size`` bytes each, or with none, but rows."""
        count = math.prod(sizes)
        self.room_for(count * size if count else _OBJECT * math.prod(max(one, 1) for one in sizes))

    def array(self, kind: Any, shape: Any, raw: Any, fortran: bool) -> NDArray[Any]:
        """An array of a type and a shape from its bytes, or from a list of objects."""
        if type(kind) is not _Type:
            raise PickleRefused(f"an array of a {_kind(kind)}: expected a data type")
        sizes = sizes_of(shape)
        count = math.prod(sizes)
        order: Any = "F" if fortran else "C"
        self.room_for_shape(sizes, _OBJECT if kind.dtype.kind == "O" else kind.dtype.itemsize)
        if kind.dtype.kind == "O":
            if type(raw) is not list or len(raw) != count:
                raise PickleRefused(f"an array of {count} objects from a {_kind(raw)} of others")
            objects = np.empty(count, dtype=object)
            for at, one in enumerate(raw):
                objects[at] = _plain(one)
            return objects.reshape(sizes, order=order)
        if not isinstance(raw, bytes | bytearray) or len(raw) != count * kind.dtype.itemsize:
            got = f"{len(raw)} bytes" if isinstance(raw, bytes | bytearray) else f"a {_kind(raw)}"
            raise PickleRefused(f"an array of shape {sizes} and type {kind.text} from {got}")
        truth = kind.dtype.kind == "b"
        array = np.frombuffer(bytes(raw), dtype=np.uint8 if truth else kind.dtype).reshape(sizes, order=order)
        return array != 0 if truth else array.astype(kind.dtype.newbyteorder("="))


class _Lines(io.BytesIO):
    """Bytes whose lines are short: names, and numbers as text."""

    def readline(self, size: int | None = -1, /) -> bytes:
        return super().readline(_LONGEST_LINE)


def sizes_of(shape: Any) -> tuple[int, ...]:
    """A shape as sizes that are small enough to count with, or :class:`PickleRefused`."""
    if (
        type(shape) is not tuple
        or len(shape) > _MOST_DIMENSIONS
        or not all(type(one) is int and 0 <= one < 2**40 for one in shape)
    ):
        raise PickleRefused(f"a shape of '{str(shape)[:60] if type(shape) is tuple else _kind(shape)}'")
    return shape


def _kind(value: Any) -> str:
    return type(value).__name__ if not isinstance(value, _Name) else f"name '{'.'.join(value.name.split())}'"


def _plain(value: Any) -> Any:
    """What stands on the stack, as a value: arrays that are complete, and no names."""
    if type(value) is _Array:
        if value.value is None:
            raise PickleRefused("an array without its numbers")
        return value.value
    if isinstance(value, _Name | _Type):
        raise PickleRefused(f"a {_kind(value)} as a value: it is not plain data")
    return value


def _reconstruct(machine: Unpickled, kind: Any, shape: Any, letter: Any) -> _Array:
    if type(kind) is not _Name or kind.name != "numpy ndarray":
        raise PickleRefused(f"an array of the class of a {_kind(kind)}: expected numpy.ndarray")
    return _Array()  # of no size until its state comes


def _dtype(machine: Unpickled, text: Any, align: Any = False, copy: Any = True) -> _Type:
    if type(text) is not str or not _DTYPE.fullmatch(text):
        shown = text[:30] if type(text) is str else _kind(text)
        raise PickleRefused(f"an array of type '{shown}': expected numbers, truth values, texts or objects")
    return _Type(text.lstrip("<>|="))


def _order(kind: _Type, state: tuple[Any, ...]) -> None:
    _, order, subtype, names, fields, *_ = state
    if subtype is not None or names is not None or fields is not None or order not in ("<", ">", "|", "="):
        raise PickleRefused("an array of records: expected numbers, truth values, texts or objects")
    kind.text = order + kind.text.lstrip("<>|=")


def _scalar(machine: Unpickled, kind: Any, raw: Any) -> Any:
    if type(kind) is _Type and kind.dtype.kind == "O":
        raise PickleRefused("a NumPy scalar that is an object")
    return machine.array(kind, (), raw, False)[()]


def _from_buffer(machine: Unpickled, raw: Any, kind: Any, shape: Any, order: Any) -> NDArray[Any]:
    if type(kind) is _Type and kind.dtype.kind == "O":
        raise PickleRefused("objects from bytes")
    return machine.array(kind, shape, raw, order == "F")


def _encode(machine: Unpickled, text: Any, encoding: Any) -> bytes:
    """How Python 3 puts bytes into old pickles."""
    if type(text) is not str or encoding != "latin1":
        raise PickleRefused("bytes of another encoding than latin1")
    return text.encode("latin1")


def _ordered_dict(machine: Unpickled, *items: Any) -> dict[Any, Any]:
    if items:
        raise PickleRefused("an OrderedDict with arguments")
    return {}


def _never(machine: Unpickled, *arguments: Any) -> None:
    raise PickleRefused("a class is called: nothing in the file was executed")


_NUMPY: dict[str, Any] = {
    "numpy ndarray": _never,
    "numpy dtype": _dtype,
    "collections OrderedDict": _ordered_dict,
    "_codecs encode": _encode,
}
for _core in ("core", "_core"):
    _NUMPY[f"numpy.{_core}.multiarray _reconstruct"] = _reconstruct
    _NUMPY[f"numpy.{_core}.multiarray scalar"] = _scalar
    _NUMPY[f"numpy.{_core}.numeric _frombuffer"] = _from_buffer

_STEPS: dict[int, Callable[[Unpickled], object]] = {
    pickle.APPEND[0]: lambda m: m._append([m.stack.pop()]),
    pickle.APPENDS[0]: lambda m: m._append(m.pop_mark()),
    pickle.LIST[0]: lambda m: m.append(list(map(_plain, m.pop_mark()))),
    pickle.SETITEM[0]: lambda m: m._set([m.stack.pop(), m.stack.pop()][::-1]),
    pickle.SETITEMS[0]: lambda m: m._set(m.pop_mark()),
    pickle.DICT[0]: Unpickled._dict,
    pickle.BYTEARRAY8[0]: Unpickled._bytearray,
    pickle.REDUCE[0]: Unpickled._reduce,
    pickle.BUILD[0]: Unpickled._build,
}
