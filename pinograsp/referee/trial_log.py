"""Trials on disk, a line of JSON each as they come, so that a study goes on where it was stopped."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path

from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.writing import lock, place_of, write_errors

_SAME = 1e-6  # relative difference between a plan and the same one, planned again


class TrialLog:
    """Rows by error and trial, kept in ``rows`` and on disk, under a header that says what they are of.

    A context: it keeps the file from other writers, and closes it. Without a path nothing is written. A last line that
    was cut short is dropped.

    Raises:
        InvalidInput: the file holds something else, or rows under another header.
        ResultsNotWritten: it cannot be written, or another process is writing it.
    """

    def __init__(self, path: Path | None, header: dict):
        self.rows, self.file, self.path = {}, None, path
        if path is None:
            return
        self.head = _line(header)
        with write_errors(path):
            place_of(path).parent.mkdir(parents=True, exist_ok=True)
            self.file = path.open("a+b", buffering=0)
        try:
            with write_errors(path):
                if lock(self.file.fileno()) is False:
                    raise ResultsNotWritten(
                        f"another process is writing trials to '{path}': wait for it, or give another folder"
                    )
                self.file.seek(0)
                kept = self.file.read()
            whole = kept[: kept.rfind(b"\n") + 1]  # without a last line that was cut short
            self._read(whole, kept, header)
            with write_errors(path):
                self.file.truncate(len(whole))
        except BaseException:
            self.file.close()
            raise
        self.size = len(whole)

    def _read(self, whole: bytes, kept: bytes, header: dict) -> None:
        if not whole:
            if not self.head.startswith(kept):
                raise InvalidInput(f"'{self.path}' holds no trials: give another folder")
            return
        at = 1
        try:
            first, *lines = whole.split(b"\n")[:-1]
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

    def add(self, row: dict) -> None:
        """Keep a row; on disk at once."""
        if self.file is not None:
            # Not before the first row: settings that cannot be simulated leave nothing behind.
            line = (b"" if self.size else self.head) + _line(row)
            with write_errors(self.path):
                try:
                    written = 0
                    while written < len(line):
                        written += self.file.write(line[written:])
                except BaseException:
                    with contextlib.suppress(OSError):  # part of a line that stays is dropped by the next reader
                        self.file.truncate(self.size)
                    raise
            self.size += len(line)
        self.rows[row["error"], row["trial"]] = row

    def __enter__(self) -> TrialLog:
        return self

    def __exit__(self, *_) -> None:
        if self.file is not None:
            self.file.close()


def _line(value: dict) -> bytes:
    return json.dumps(value, allow_nan=False).encode() + b"\n"


def _differences(a, b, name: str = "") -> list[str]:
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
