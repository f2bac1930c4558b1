"""The arrays of a run and of a simulation: read without running anything, within bounds, shapes that fit each other."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinograsp.checks import frozen, one_line
from pinograsp.errors import InvalidInput
from pinograsp.storage.documents import HUGE, LARGEST, bounded, is_text

Arrays = dict[str, NDArray[Any]]

_MAY_BE_INFINITE = ("torque_limit", "branches")


def read_arrays(path: Path) -> Arrays:
    """The arrays of an archive, read-only; nothing in it is run (no pickles)."""
    try:
        with zipfile.ZipFile(bounded(path)) as archive:
            members = archive.infolist()
        if sum(one.file_size for one in members) > LARGEST:
            raise ValueError(f"expected at most {LARGEST} bytes of arrays")
        if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in members):
            raise ValueError("expected an archive that NumPy has written")
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("expected arrays alone")
    except Exception as error:  # zipfile, zlib and NumPy raise whatever comes of a broken file
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    return {name: frozen(array) for name, array in arrays.items()}


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """An archive of arrays by their names."""
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]  # names might be those of its own arguments


def expect(file: str, name: str, wanted: str, holds: bool) -> None:
    """:class:`InvalidInput` unless it ``holds``."""
    if not holds:
        raise InvalidInput(f"{file}: {name}: expected {wanted[:200]}")


def sizes_of(file: str, arrays: Arrays, shapes: dict[str, str], known: dict[str, int]) -> dict[str, int]:
    """The sizes that letters stand for, after a look at every array: its kind, shape, and that it is finite."""
    sizes = dict(known)
    for name, letters in shapes.items():
        if name not in arrays:
            raise InvalidInput(
                f"{file}: expected an array '{name}', got none: written by another version? Plan or simulate it again"
            )
        array = arrays[name]
        if array.ndim == len(letters):
            for letter, size in zip(letters, array.shape):
                sizes.setdefault(letter, size)
        wanted = tuple(int(letter) if letter.isdigit() else sizes.get(letter, -1) for letter in letters)
        if array.shape != wanted or array.dtype != np.float64:
            shape = "(" + ", ".join("any" if size < 0 else str(size) for size in wanted) + ")"
            raise InvalidInput(f"{file}: {name}: expected float64 of shape {shape}, got {array.dtype} of {array.shape}")
        bad = np.isnan(array) if name in _MAY_BE_INFINITE else ~np.isfinite(array)
        if bad.any() or (np.abs(array[np.isfinite(array)]) > HUGE).any():
            raise InvalidInput(f"{file}: {name}: expected finite numbers up to {HUGE:g}")
    return sizes


def texts_of(file: str, arrays: Arrays, name: str, count: int) -> tuple[str, ...]:
    """An array of ``count`` texts."""
    array = arrays.get(name)
    if array is None or array.dtype.kind != "U" or array.shape != (count,):
        raise InvalidInput(f"{file}: {name}: expected {count} names")
    try:
        texts: list[str] = array.tolist()
    except (ValueError, UnicodeError):  # not characters
        texts = ["\ud800"]
    expect(file, name, "readable text", is_text(texts))
    return tuple(texts)
