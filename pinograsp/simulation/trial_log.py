"""Trials on disk, one line of JSON each, so that an interrupted study can continue."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Mapping
from io import FileIO
from pathlib import Path
from typing import Any, TypedDict

from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.writing import InUse, lock, mark, place_of, write_errors

_SAME = 1e-6  # relative difference below which values of two headers are equal: planning again reproduces no more


class TrialRow(TypedDict):
    """One trial of a study.

    Attributes:
        error: its error, or ``"together"``.
        trial: its number.
        drawn: the random values by error, as plain values.
        held: whether the object stayed in the hand.
        drift_m: of the object [m]; None: the simulation diverged.
        reason: why it was held or lost, in words.
    """

    error: str
    trial: int
    drawn: dict[str, Any]
    held: bool
    drift_m: float | None
    reason: str


class TrialLog:
    """Rows by error and trial, in ``rows`` and on disk, below a header that describes the study.

    A context manager: it locks the file against other writers, and closes it. Without a path nothing is written. An
    incomplete last line is dropped.

    Raises:
        InvalidInput: the file holds something else, or rows below another header.
        ResultsNotWritten: the file cannot be written, or another process is writing to it.
    """

    def __init__(self, path: Path | None, header: dict[str, Any]):
        self.rows: dict[tuple[str, int], TrialRow] = {}
        self.path, self.head, self.size = path, _line(header), 0
        self._file: FileIO | None = None
        self._held = contextlib.ExitStack()
        if path is not None:
            self._open(path, header)

    def __enter__(self) -> TrialLog:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _open(self, path: Path, header: dict[str, Any]) -> None:
        """Lock the file and read its rows."""
        with contextlib.ExitStack() as held:
            with write_errors(path):
                place = place_of(path)
                place.parent.mkdir(parents=True, exist_ok=True)
                try:
                    held.enter_context(lock(mark(place), 0))
                except InUse:
                    raise ResultsNotWritten(
                        f"another process is writing trials to '{path}': wait for it, or give another folder"
                    ) from None
                self._file = held.enter_context(path.open("a+b", buffering=0))
                self._file.seek(0)
                kept = self._file.read()
            lines = kept[: kept.rfind(b"\n") + 1]  # without an incomplete last line
            self._read(lines, kept, header)
            with write_errors(path):
                self._file.truncate(len(lines))
            self._held, self.size = held.pop_all(), len(lines)

    def _read(self, complete: bytes, kept: bytes, header: dict[str, Any]) -> None:
        if not complete:
            if not self.head.startswith(kept):
                raise InvalidInput(f"'{self.path}' holds no trials: give another folder")
            return
        at = 1
        try:
            first, *lines = complete.split(b"\n")[:-1]
            found = json.loads(first)
            if not isinstance(found, dict) or found.get("schema") != header["schema"]:
                raise InvalidInput(f"'{self.path}' holds no trials of schema {header['schema']}: give another folder")
            for line in lines:
                at += 1
                row = json.loads(line)
                self.rows.setdefault((row["error"], row["trial"]), row)
        except InvalidInput:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInput(f"'{self.path}': line {at} cannot be read: remove it, or give another folder") from error
        differ = _differences(found, json.loads(json.dumps(header)))
        if differ:
            raise InvalidInput(
                f"'{self.path}' holds trials of other settings ({', '.join(differ[:5])}): they are not mixed, give "
                "another folder"
            )

    def add(self, row: TrialRow) -> None:
        """Keep a row; it is written to disk at once, and what could not be written completely is removed again."""
        if self.path is not None and self._file is not None:
            # The header comes with the first row: settings that cannot be simulated leave nothing behind.
            line = (b"" if self.size else self.head) + _line(row)
            with write_errors(self.path):
                try:
                    written = 0
                    while written < len(line):
                        written += self._file.write(line[written:])
                except BaseException:
                    with contextlib.suppress(OSError):  # the next reader drops an incomplete line that stays
                        self._file.truncate(self.size)
                    raise
            self.size += len(line)
        self.rows[row["error"], row["trial"]] = row


def _line(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value, allow_nan=False).encode() + b"\n"


def _differences(a: object, b: object, name: str = "") -> list[str]:
    """Names of the values that differ by more than rounding."""
    if isinstance(a, dict) and isinstance(b, dict):
        return [
            one
            for key in sorted({*a, *b})
            for one in _differences(a.get(key), b.get(key), f"{name}.{key}" if name else key)
        ]
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return [name] if any(_differences(x, y, name) for x, y in zip(a, b)) else []
    if isinstance(a, float) and isinstance(b, float):
        return [] if math.isclose(a, b, rel_tol=_SAME, abs_tol=1e-9) else [name]
    # 1 and 1.0 are the same number.
    return [] if a == b and isinstance(a, bool) == isinstance(b, bool) else [name]
