"""PyTorch's files (a ZIP archive with a pickle and the tensors' bytes), read and written without PyTorch.

The layout is that of ``torch.save`` since PyTorch 1.6: ``NAME/data.pkl``, ``NAME/data/KEY``, ``NAME/version``. Tensors
come as arrays: bfloat16, which NumPy has not, as float32.
"""

from __future__ import annotations

import io
import math
import pickle
import struct
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.data.pickled import PickleRefused, Unpickled, sizes_of

_MOST_MEMBERS = 100_000
_MOST_REPEATED = 100_000  # numbers of a tensor that repeats those of its storage, as torch.expand makes them
# PyTorch's storages by name, with the types of their numbers; bfloat16 are the upper halves of float32.
_STORAGES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "BFloat16Storage": "bf16",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "b1",
}
_WRITTEN = {np.dtype(text): name for name, text in _STORAGES.items() if text != "bf16"}


def read_torch(content: bytes) -> Any:
    """What a file holds, with arrays in the place of tensors.

    Raises:
        PickleRefused: another archive, a broken or a compressed one, or more than plain data.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive, len(content))
            return _Tensors(archive, members, len(content)).value
    except PickleRefused:
        raise
    except Exception as error:  # zipfile raises whatever comes of a broken file
        raise PickleRefused(f"the archive is broken or cut off ({' '.join(str(error).split())[:200]})") from None


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The files of the archive without its own name before theirs."""
    entries = archive.infolist()
    names = [one.filename.partition("/")[2] for one in entries]
    if len(entries) > _MOST_MEMBERS or len(set(names)) < len(names):
        raise PickleRefused("the archive has too many files, or files of the same name")
    if any(one.compress_type != zipfile.ZIP_STORED or one.flag_bits & 1 for one in entries):
        raise PickleRefused("the archive is compressed: PyTorch writes it plain")
    if sum(one.file_size for one in entries) > size:
        raise PickleRefused("the archive's files are larger than the archive")
    if "data.pkl" not in names:
        raise PickleRefused("the archive has no data.pkl: no file that torch.save has written")
    return dict(zip(names, entries))


class _Tensors:
    """An archive, and the tensors of its pickle."""

    def __init__(self, archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], size: int):
        self._archive, self._members = archive, members
        self._storages: dict[str, NDArray[Any]] = {}
        if "byteorder" in members and archive.read(members["byteorder"]).strip() != b"little":
            raise PickleRefused("the archive was written on a machine of another byte order")
        names = {
            **{f"torch {name}": name for name in _STORAGES},
            "torch._utils _rebuild_tensor_v2": self._tensor,
            "torch._utils _rebuild_parameter": lambda machine, value, *_: value,
            "torch Size": lambda machine, sizes: tuple(sizes_of(sizes)),
        }
        pickled = archive.read(members["data.pkl"])
        self.value = Unpickled(pickled, size=size, names=names, stored=self._storage).value

    def _storage(self, key: Any) -> str:
        """The key of a storage that has been read."""
        if type(key) is not tuple or len(key) != 5 or key[0] != "storage" or key[1] not in _STORAGES:
            raise PickleRefused("a storage of an unknown type")
        _, kind, name, _, count = key
        if type(name) is not str or type(count) is not int or f"data/{name}" not in self._members:
            raise PickleRefused(f"the archive has no tensor '{str(name)[:40]}'")
        if name not in self._storages:
            raw = self._archive.read(self._members[f"data/{name}"])
            letters = _STORAGES[kind]
            if letters == "bf16":
                numbers = (np.frombuffer(raw, dtype="<u2").astype("<u4") << 16).view("<f4")
            elif letters == "b1":
                numbers = np.frombuffer(raw, dtype=np.uint8) != 0
            else:
                numbers = np.frombuffer(raw, dtype=letters)
            self._storages[name] = numbers
        if len(self._storages[name]) < count:
            raise PickleRefused(f"tensor '{name}' is cut off")
        return name

    def _tensor(self, machine: Unpickled, name: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> NDArray[Any]:
        if type(name) is not str or name not in self._storages or type(offset) is not int or offset < 0:
            raise PickleRefused("a tensor without a storage")
        storage, sizes, steps = self._storages[name], sizes_of(shape), sizes_of(strides)
        count = math.prod(sizes)
        last = offset + sum((size - 1) * step for size, step in zip(sizes, steps))
        if len(sizes) != len(steps) or (count and last >= len(storage)):
            raise PickleRefused(f"a tensor of shape {sizes} reaches beyond its storage")
        if count > max(len(storage), _MOST_REPEATED):  # by strides of zero, or less than a row
            raise PickleRefused(
                f"expected as many numbers as a tensor has, {count}, in its storage, got {len(storage)}"
            )
        machine.room_for_shape(sizes, storage.itemsize)
        if not count:
            return np.empty(sizes, dtype=storage.dtype)
        seen = np.lib.stride_tricks.as_strided(
            storage[offset:], shape=sizes, strides=[step * storage.itemsize for step in steps], writeable=False
        )
        copy: NDArray[Any] = seen.copy()
        return copy


# -- writing


def write_torch(value: Any) -> bytes:
    """A file that ``torch.load`` reads, also with ``weights_only=True``: texts, numbers, lists, dicts, and arrays as
    tensors.

    Raises:
        TypeError: anything else in it.
    """
    storages: list[NDArray[Any]] = []
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        for name, raw in {
            "data.pkl": pickle.PROTO + b"\x02" + _opcodes(value, storages) + pickle.STOP,
            "byteorder": b"little",
            **{f"data/{key}": array.tobytes() for key, array in enumerate(storages)},
            "version": b"3\n",
        }.items():
            archive.writestr(zipfile.ZipInfo(f"archive/{name}"), raw)
    return content.getvalue()


def _opcodes(value: Any, storages: list[NDArray[Any]]) -> bytes:
    """The opcodes that build a value, in protocol 2 as PyTorch writes it; its arrays join the ``storages``."""
    if value is None or isinstance(value, bool):
        return {None: pickle.NONE, True: pickle.NEWTRUE, False: pickle.NEWFALSE}[value]
    if isinstance(value, int):
        raw = pickle.encode_long(value)
        return pickle.LONG1 + bytes([len(raw)]) + raw
    if isinstance(value, float):
        return pickle.BINFLOAT + struct.pack(">d", value)
    if isinstance(value, str):
        raw = value.encode("utf-8")
        return pickle.BINUNICODE + struct.pack("<I", len(raw)) + raw
    if isinstance(value, tuple):
        return pickle.MARK + b"".join(_opcodes(one, storages) for one in value) + pickle.TUPLE
    if isinstance(value, list):
        items = b"".join(_opcodes(one, storages) for one in value)
        return pickle.EMPTY_LIST + pickle.MARK + items + pickle.APPENDS
    if isinstance(value, dict):
        items = b"".join(_opcodes(one, storages) for pair in value.items() for one in pair)
        return pickle.EMPTY_DICT + pickle.MARK + items + pickle.SETITEMS
    if isinstance(value, np.ndarray):
        return _tensor_opcodes(value, storages)
    raise TypeError(f"a {type(value).__name__} has no place in a file of PyTorch's")


def _tensor_opcodes(array: NDArray[Any], storages: list[NDArray[Any]]) -> bytes:
    stored = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    key = str(len(storages))
    storages.append(stored)
    strides = tuple(int(step) // max(array.itemsize, 1) for step in np.empty(array.shape, dtype=array.dtype).strides)
    storage = b"".join(
        (
            pickle.MARK,
            _opcodes("storage", storages),
            _pickle_name("torch", _WRITTEN[stored.dtype]),
            *(_opcodes(one, storages) for one in (key, "cpu", int(array.size))),
            pickle.TUPLE + pickle.BINPERSID,
        )
    )
    no_hooks = _pickle_name("collections", "OrderedDict") + pickle.EMPTY_TUPLE + pickle.REDUCE
    rest = b"".join(_opcodes(one, storages) for one in (0, array.shape, strides, False))
    arguments = pickle.MARK + storage + rest + no_hooks + pickle.TUPLE
    return _pickle_name("torch._utils", "_rebuild_tensor_v2") + arguments + pickle.REDUCE


def _pickle_name(module: str, name: str) -> bytes:
    return pickle.GLOBAL + f"{module}\n{name}\n".encode()
