"""Shares of long work for processes that write into one folder at once: who does what, and what is missing."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import brief, integer, shorten
from pinograsp.errors import InvalidInput
from pinograsp.spatial import IntArray

_FOLDER = re.compile(r"shard-([1-9]\d{0,5})-of-([1-9]\d{0,5})")
_MOST = 100_000  # shards
_SPREAD = 4  # a file as large as a share is dealt to so many shards, one more than of smaller files


@dataclass(frozen=True, order=True)
class Shard:
    """The share ``number`` of ``count``, counted from 1; the only one of 1 is all of the work."""

    number: int = 1
    count: int = 1

    @classmethod
    def of(cls, given: tuple[int, int] | str | None) -> Shard:
        """A shard as it is given: ``(3, 64)``, ``"3/64"``, or None for all of the work.

        Raises:
            InvalidInput: anything else.
        """
        if given is None:
            return cls()
        parts = given.split("/") if isinstance(given, str) else given
        try:
            number, count = (int(one) if isinstance(one, str) and one.isdecimal() else one for one in parts)
            count = integer("count", count, at_least=1, at_most=_MOST)
            return cls(integer("number", number, at_least=1, at_most=count), count)
        except (TypeError, ValueError):
            raise InvalidInput(
                f"shard: expected I/N, the share I from 1 to N of N, at most {_MOST}, got {shorten(given)}"
            ) from None

    def __str__(self) -> str:
        return f"shard {self.number} of {self.count}"

    def folder_in(self, folder: Path) -> Path:
        """Where its rows are written."""
        return folder if self.count == 1 else folder / f"shard-{self.number}-of-{self.count}"


WHOLE = Shard()


def list_shards(folder: Path) -> list[Shard]:
    """The shards that a folder has rows of, in order; the first is all of the work, which writes into it directly."""
    found = [match for path in folder.glob("shard-*-of-*") if (match := _FOLDER.fullmatch(path.name)) and path.is_dir()]
    return [WHOLE, *sorted(Shard(int(one[1]), int(one[2])) for one in found)]


def deal_rows(rows: int, count: int) -> IntArray:
    """The number of the shard of each row (rows,): as many for each, give or take one.

    Neighbours cost alike, and so do rows that are a step of a grid apart: they are shuffled, otherwise for each
    ``count``, so that what one number of shards has left is as much for each shard of another.
    """
    dealt = np.empty(rows, dtype=int)
    dealt[_shuffle(rows, count)] = np.arange(rows) * count // max(rows, 1) + 1
    return dealt


class FileDeal:
    """Blocks of files dealt to shards, without a look into the files.

    Small files go to one shard as a whole, others block by block to some or all shards: few have to read a file.

    Args:
        sizes: of the files [bytes].
        count: number of shards.
    """

    def __init__(self, sizes: Sequence[int], count: int):
        self.count, share = count, max(1, sum(sizes) // count)
        self._among = np.array([min(count, 1 + _SPREAD * size // share) for size in sizes])
        pieces = np.frexp(sizes / self._among)[1]  # equal ones one after the other, or some shards get the large ones
        order = (shuffled := _shuffle(len(sizes), count))[np.argsort(-pieces[shuffled], kind="stable")]
        self._rank = np.argsort(order)
        self._first = (np.cumsum(self._among[order]) - self._among[order])[self._rank]

    def is_of(self, file: int, number: int) -> bool:
        """Whether a shard has to read a file."""
        return bool((number - 1 - self._first[file]) % self.count < self._among[file])

    def number_of(self, file: int, block: int) -> int:
        """The shard of a block of a file; both are counted from 0."""
        among = int(self._among[file])
        place = self._rank[file] + block
        if block >= among:
            place = _shuffle(among, self.count, file, block // among)[block % among]
        return int((self._first[file] + place % among) % self.count) + 1


def _shuffle(size: int, *seed: int) -> IntArray:
    """A permutation; NumPy has promised that this generator's stay, so all machines deal alike."""
    dealt: IntArray = np.random.RandomState(list(seed)).permutation(size)
    return dealt


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """What a folder does not have yet.

    Attributes:
        rows: number of rows that are missing.
        total: number of rows that there are to be; both of one shard, where that was asked.
        shards: for each number of shards that has begun, those with rows missing, ``{64: (3, 17)}``.
    """

    rows: int
    total: int
    shards: dict[int, tuple[int, ...]]

    __repr__ = brief()

    def summary(self) -> dict[str, Any]:
        """As plain JSON values."""
        shards = {str(count): list(numbers) for count, numbers in self.shards.items()}
        return {"missing": self.rows, "rows": self.total, "shards": shards}


def write_numbers(numbers: Iterable[int]) -> str:
    """Rising numbers as job arrays take them: ``3,17,40-42``."""
    runs = [list(run) for _, run in itertools.groupby(enumerate(numbers), lambda one: one[1] - one[0])]
    ends = [(run[0][1], run[-1][1]) for run in runs]
    return ",".join(f"{first}" if first == last else f"{first}-{last}" for first, last in ends)
