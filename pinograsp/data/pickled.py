"""Pickles of plain data, read without running any: what their opcodes build is built here, and by nothing else.

:mod:`pickletools` splits a pickle into opcodes; a small machine carries out those that build numbers, texts, lists,
tuples, dicts, NumPy arrays and PyTorch tensors. There is no import, no call of a class, no attribute: names that a
pickle asks for are looked up in one table, and all others are refused by their name.
The machine is longer than other modules: its opcodes are read together.
"""

from __future__ import annotations

import io
import math
import pickletools
import re
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from pinograsp.data.extent import check_extent

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


_MARK = object()


class Unpickled:
    """The machine. ``value`` is what a pickle holds.

    Args:
        content: the pickle, from its first byte; what comes after its end is not looked at.
        size: of the file that it is in [bytes], where that holds the numbers of its arrays; default: of the pickle.
        names: further names, with what stands for them: a function of the call's arguments, or any other value.
        stored: what stands for a persistent id, where there may be any.
    """

    def __init__(
        self,
        content: bytes,
        *,
        size: int | None = None,
        names: Mapping[str, Any] | None = None,
        stored: Callable[[Any], Any] | None = None,
    ):
        self._names = {**_NUMPY, **(names or {})}
        self._stored = stored
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._room = self._left = min(_MOST_BYTES, _SMALL + _ARRAYS_A_BYTE * (len(content) if size is None else size))
        self._most_items = _FEW + _ITEMS_A_BYTE * len(content)
        self._opcode = ""
        self.value: Any = None
        try:
            self._run(content)
        except PickleRefused as refusal:
            raise PickleRefused(str(refusal), self._complete_rows()) from None
        except Exception as error:  # what comes of a broken file: of the length, of a number, of an empty stack
            text = " ".join(str(error).split())[:200]
            where = f" at opcode {self._opcode}" * bool(self._opcode)
            raise PickleRefused(f"the pickle is broken or cut off{where} ({text})", self._complete_rows()) from None

    def _run(self, content: bytes) -> None:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(_Lines(content))):
            self._opcode = opcode.name
            if count > _MOST_OPCODES:
                raise PickleRefused(f"expected at most {_MOST_OPCODES} opcodes")
            if opcode.name in _PUSHED:
                self._stack.append(argument)
            elif (step := _STEPS.get(opcode.name)) is not None:
                step(self, argument)
            elif opcode.name == "STOP":
                self.value = _plain(self._stack.pop())
                self._check_extent(self.value)
                return
            elif opcode.name not in _IGNORED:
                raise PickleRefused(f"opcode {opcode.name} is refused: plain data needs none")
        raise PickleRefused("the pickle is cut off")

    def _complete_rows(self) -> list[Any]:
        """Items of the outermost list that stand before a fault."""
        lists = [at for at, one in enumerate(self._stack) if type(one) is list]
        if not lists:
            return []
        rows, *above = self._stack[lists[0] :]
        if above and above[0] is _MARK:
            inner = next((at for at, one in enumerate(above[1:], 1) if one is _MARK), None)
            rows = [*rows, *(above[1:] if inner is None else above[1 : inner - 1])]
        complete = [one for one in rows if type(one) is dict and one]
        try:
            self._check_extent(complete)
        except PickleRefused:
            return []
        return complete

    def _check_extent(self, value: Any) -> None:
        try:
            check_extent(value, self._most_items)
        except ValueError as error:
            raise PickleRefused(str(error)) from None

    # -- opcodes

    def _pop_to_mark(self) -> list[Any]:
        at = len(self._stack) - 1
        while self._stack[at] is not _MARK:
            at -= 1
            if at < 0:
                raise IndexError("there is no mark")
        items = self._stack[at + 1 :]
        del self._stack[at:]
        return items

    def _pop(self) -> Any:
        value = self._stack.pop()
        if value is _MARK:
            raise IndexError("a mark where a value was expected")
        return value

    def _tuple(self, count: int) -> None:
        items = [self._pop() for _ in range(count)][::-1]
        self._stack.append(tuple(items))

    def _append(self, items: list[Any]) -> None:
        into = self._stack[-1]
        if type(into) is not list:
            raise PickleRefused(f"items are added to a {_kind(into)}: expected a list")
        into.extend(map(_plain, items))

    def _set(self, items: list[Any]) -> None:
        into = self._stack[-1]
        if type(into) is not dict:
            raise PickleRefused(f"items are set in a {_kind(into)}: expected a dict")
        if len(items) % 2:
            raise PickleRefused("a key without a value")
        for key, value in zip(items[::2], items[1::2]):
            into[self._key(key)] = _plain(value)

    @staticmethod
    def _key(key: Any) -> str | int:
        # Tuples within tuples are hashed without an end.
        if not (isinstance(key, str) or (isinstance(key, int) and -_LARGEST_KEY < key < _LARGEST_KEY)):
            kind = "too large an int" if isinstance(key, int) else f"a {_kind(key)}"
            raise PickleRefused(f"{kind} as a key: expected texts and integers")
        return key

    def _dict(self) -> None:
        items = self._pop_to_mark()
        self._stack.append({})
        self._set(items)

    def _put(self, at: int | None) -> None:
        place = len(self._memo) if at is None else at
        if not 0 <= place <= _MOST_OPCODES:
            raise PickleRefused(f"expected at most {_MOST_OPCODES} values to come back to, got number {place}")
        self._memo[place] = self._stack[-1]

    def _get(self, at: int) -> None:
        self._stack.append(self._memo[at])

    def _global(self, name: str | None) -> None:
        if name is None:
            inner, module = self._pop(), self._pop()
            name = f"{module} {inner}"
        if name not in self._names:
            shown = ".".join(str(name).split())[:100]
            raise PickleRefused(f"it asks for '{shown}', which is not plain data: nothing of the file was run")
        value = self._names[name]
        self._stack.append(_Name(name) if callable(value) else value)

    def _reduce(self) -> None:
        arguments, name = self._pop(), self._pop()
        if type(name) is not _Name or type(arguments) is not tuple:
            raise PickleRefused(f"a {_kind(name)} is called: nothing of the file was run")
        self._stack.append(self._names[name.name](self, *arguments))

    def _build(self) -> None:
        state, value = self._pop(), self._stack[-1]
        if type(value) is _Array and type(state) is tuple and len(state) == 5:
            _, shape, kind, fortran, raw = state
            value.value = self.array(kind, shape, raw, bool(fortran))
        elif type(value) is _Type and type(state) is tuple and len(state) in (8, 9):
            _ordered(value, state)
        else:
            raise PickleRefused(f"a {_kind(value)} gets a state: nothing of the file was run")

    def _persistent(self) -> None:
        if self._stored is None:
            raise PickleRefused("it refers to something outside of it")
        self._stack.append(self._stored(self._pop()))

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
    if value is _MARK:
        return "mark"
    return type(value).__name__ if not isinstance(value, _Name) else f"name '{'.'.join(value.name.split())}'"


def _plain(value: Any) -> Any:
    """What stands on the stack, as a value: arrays that are complete, and no names."""
    if type(value) is _Array:
        if value.value is None:
            raise PickleRefused("an array without its numbers")
        return value.value
    if value is _MARK or isinstance(value, _Name | _Type):
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


def _ordered(kind: _Type, state: tuple[Any, ...]) -> None:
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


def _never(machine: Unpickled, *arguments: Any) -> NoReturn:
    raise PickleRefused("a class is called: nothing of the file was run")


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

_PUSHED = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
_IGNORED = {"PROTO", "FRAME"}
_STEPS: dict[str, Callable[[Unpickled, Any], object]] = {
    "MARK": lambda m, _: m._stack.append(_MARK),
    "NONE": lambda m, _: m._stack.append(None),
    "NEWTRUE": lambda m, _: m._stack.append(True),
    "NEWFALSE": lambda m, _: m._stack.append(False),
    "EMPTY_LIST": lambda m, _: m._stack.append([]),
    "LIST": lambda m, _: m._stack.append(list(map(_plain, m._pop_to_mark()))),
    "APPEND": lambda m, _: m._append([m._pop()]),
    "APPENDS": lambda m, _: m._append(m._pop_to_mark()),
    "EMPTY_TUPLE": lambda m, _: m._stack.append(()),
    "TUPLE": lambda m, _: m._stack.append(tuple(m._pop_to_mark())),
    "TUPLE1": lambda m, _: m._tuple(1),
    "TUPLE2": lambda m, _: m._tuple(2),
    "TUPLE3": lambda m, _: m._tuple(3),
    "EMPTY_DICT": lambda m, _: m._stack.append({}),
    "DICT": lambda m, _: m._dict(),
    "SETITEM": lambda m, _: m._set([m._pop(), m._pop()][::-1]),
    "SETITEMS": lambda m, _: m._set(m._pop_to_mark()),
    "PUT": lambda m, at: m._put(at),
    "BINPUT": lambda m, at: m._put(at),
    "LONG_BINPUT": lambda m, at: m._put(at),
    "MEMOIZE": lambda m, _: m._put(None),
    "GET": lambda m, at: m._get(at),
    "BINGET": lambda m, at: m._get(at),
    "LONG_BINGET": lambda m, at: m._get(at),
    "GLOBAL": lambda m, name: m._global(name),
    "STACK_GLOBAL": lambda m, _: m._global(None),
    "REDUCE": lambda m, _: m._reduce(),
    "BUILD": lambda m, _: m._build(),
    "BINPERSID": lambda m, _: m._persistent(),
}
