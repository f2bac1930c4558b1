"""The files of a record: read without running anything, plain, finite, and within bounds.

``record.json`` has the record without its arrays, an archive these by their paths, ``scene.json`` hands and objects.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pinograsp.checks import frozen, one_line, path_of
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.plain import plain_json
from pinograsp.storage.schema import Arrays, read_record, write_record

RECORD, SCENE = "record.json", "scene.json"
SCENE_SCHEMA = "pinograsp.scene/2"
_LARGEST = 2**29  # [bytes] of a file, unpacked
_DEEPEST = 40  # levels of a document


T = TypeVar("T")


class Documents(NamedTuple):
    """What is written of a record.

    Attributes:
        texts: JSON by the names of the files.
        arrays: by their paths.
    """

    texts: dict[str, str]
    arrays: Arrays

    def write(self, folder: Path, archive: str) -> None:
        """The files into a folder that exists; the arrays go into the ``archive`` of that name."""
        for name, text in self.texts.items():
            (folder / name).write_text(text + "\n", encoding="utf-8")
        np.savez_compressed(folder / archive, **self.arrays)  # type: ignore[arg-type]  # might be its own arguments


def documents_of(record: object, schema: str, figures: Mapping[str, Mapping[str, Any]]) -> Documents:
    """The documents of a record, and others of ``figures`` for people and their scripts, which nobody reads back.

    Raises:
        InvalidInput: values that are not plain and finite.
    """
    written = write_record(record)
    scene = {SCENE: {"schema": SCENE_SCHEMA, **written.scene}} if written.scene else {}
    try:
        texts = {name: json.dumps(values, indent=2, allow_nan=False) for name, values in figures.items()}
        for name, values in ({RECORD: {"schema": schema, "record": written.plain}} | scene).items():
            texts[name] = json.dumps(values, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{type(record).__name__}: expected plain, finite values ({one_line(error)})") from error
    return Documents(texts, written.arrays)


def read_folder(folder: str | Path, kind: type[T], schema: str, archive: str, what: str) -> T:
    """The record in a folder, with its hands and objects; ``what`` it is, in words.

    Raises:
        InvalidInput: the folder holds none, or one that is damaged or of another version.
        HandNotLoaded: mesh files of a hand that are missing.
    """
    folder = path_of("folder", folder)

    def read(folder: Path) -> T:
        document, scene = read_document(folder / RECORD, schema), read_document(folder / SCENE, SCENE_SCHEMA)
        return read_record(kind, document.get("record"), read_arrays(folder / archive), scene)

    return read_whole(folder, read, what)


def read_whole(folder: Path, read: Callable[[Path], T], what: str) -> T:
    """As :func:`read_of_one`, of ``what`` in words.

    Raises:
        InvalidInput: it cannot be read, and why.
        HandNotLoaded: mesh files of a hand that are missing.
    """
    try:
        return read_of_one(folder, read)
    except HandNotLoaded:
        raise
    except Exception as error:  # what is made of a broken file raises whatever it likes
        raise InvalidInput(f"'{folder}' holds no readable {what}: {one_line(error)}") from error


def read_of_one(folder: Path, read: Callable[[Path], T]) -> T:
    """What ``read(folder)`` gives, all of one folder: another may take its place meanwhile."""
    while True:
        before = _state(folder)
        try:
            value = read(folder)
        except Exception:
            if _state(folder) == before:
                raise
        else:
            if _state(folder) == before:
                return value


def _state(folder: Path) -> tuple[int, int] | None:
    try:
        found = folder.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_ctime_ns


def read_document(path: Path, schema: str | None = None) -> dict[str, Any]:
    """The mapping in a JSON file.

    Raises:
        InvalidInput: another schema, a key that comes twice, or a document that is not plain, finite, and of bounded
            depth.
    """
    try:
        document = plain_json(_check_size(path).read_bytes(), _DEEPEST)
    except (ValueError, OSError) as error:
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    if not isinstance(document, dict):
        raise InvalidInput(f"{path.name}: expected a mapping, got {type(document).__name__}")
    if schema is not None and document.get("schema") != schema:
        raise InvalidInput(f"{path.name}: expected schema {schema}, got {document.get('schema')!r:.60}")
    return document


def read_arrays(path: Path) -> Arrays:
    """The arrays of an archive, read-only; nothing in it is run (no pickles)."""
    try:
        with zipfile.ZipFile(_check_size(path)) as archive:
            members = archive.infolist()
        if sum(one.file_size for one in members) > _LARGEST:
            raise ValueError(f"expected at most {_LARGEST} bytes of arrays")
        if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in members):
            raise ValueError("expected an archive that NumPy has written")
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("expected arrays alone")
    except Exception as error:  # zipfile, zlib and NumPy raise whatever comes of a broken file
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    return {name: frozen(array) for name, array in arrays.items()}


def _check_size(path: Path) -> Path:
    """``path``, if a file is there that is not too large."""
    if not path.is_file():
        raise ValueError("there is no such file")
    if (size := path.stat().st_size) > _LARGEST:
        raise ValueError(f"expected at most {_LARGEST} bytes, got {size}")
    return path
