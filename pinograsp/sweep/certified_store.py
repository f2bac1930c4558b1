"""The rows of certified grasps on disk, see :mod:`pinograsp.sweep.parts`, and the grasps that are left."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinograsp.certification import placement_hint
from pinograsp.data import GraspRows, read_grasps
from pinograsp.errors import ExtraMissing, Status
from pinograsp.spatial import Array, BoolArray, IntArray
from pinograsp.sweep.certified_rows import fault_of, object_named
from pinograsp.sweep.certified_table import REFUSED, Fault, RowSource
from pinograsp.sweep.inputs import Inputs
from pinograsp.sweep.parts import Parts, Work
from pinograsp.sweep.shards import FileDeal, Shard

if TYPE_CHECKING:
    import pyarrow as pa

WORK = Work("pinograsp.certified/1", "certification", "certify")
_VERDICTS = ("possible", "held_as_commanded")
_COUNTED = ("file", "row", "message", "object", "code", "depth_m", "inputs", *_VERDICTS)
_SOURCE = ("file", "object", "inputs")
_BLOCK = 512  # grasps at once: half a second of work


class Left(NamedTuple):
    """Grasps of one size of an object that are not there yet, of the block of a file; or the fault that ends it."""

    file: int
    block: int
    source: RowSource
    grasps: GraspRows | Fault
    rows: IntArray


class CertifiedRows(Parts):
    """The rows of a certification: a table in a folder, and what it says.

    Attributes:
        inputs: contents of the files that rows are of.
        changed: files whose rows were of another content, and are removed.
        counts: number of rows by reason; of a shard: of those that it has computed itself.
        verdicts: likewise of those that are possible, that were commanded, and that hold as commanded.
        total: number of rows, and of faults of files, that :meth:`list_left` has come by.
    """

    def __init__(
        self, folder: Path, settings: dict[str, Any], files: tuple[Path, ...], inputs: Inputs, shard: Shard, look: bool
    ):
        super().__init__(folder, WORK, settings, {}, shard, look)
        self.files, self.inputs, self.total = files, inputs, 0
        self.deal = self.deal_to(shard.count)
        self.counts: Counter[str] = Counter()
        self.verdicts = dict.fromkeys(("possible", "commanded", "held_as_commanded"), 0)
        self._faults: dict[str, dict[int, str]] = defaultdict(dict)
        self._have: dict[str, BoolArray] = {}
        self._placing: dict[str, list[tuple[IntArray, Array]]] = defaultdict(list)
        self._known: dict[tuple[str, str | None, str], bool] = {}
        try:
            self.count_all(_COUNTED)
            self.changed = tuple(dict.fromkeys(sorted(one[0] for one, same in self._known.items() if not same)))
            if self.changed and not look:
                self.keep_rows(self._find_current)
        except BaseException:
            self.__exit__()
            raise

    def deal_to(self, count: int) -> FileDeal:
        """The blocks of the files, dealt to so many shards."""
        return FileDeal([path.stat().st_size if path.is_file() else 0 for path in self.files], count)

    def _find_current(self, table: pa.Table) -> BoolArray:
        """Which rows are of the contents that their files and objects have now (N,)."""
        groups = np.zeros(table.num_rows, dtype=int)
        for name in _SOURCE:
            column = table[name].combine_chunks().dictionary_encode(null_encoding="encode").indices.to_numpy()
            groups = groups * (int(column.max(initial=0)) + 1) + column
            _, first, groups = np.unique(groups, return_index=True, return_inverse=True)
        current = []
        for file, name, inputs in zip(*table.select(_SOURCE).take(first).to_pydict().values()):
            if (file, name, inputs) not in self._known:
                self._known[file, name, inputs] = inputs == self.inputs.source(Path(file), name).inputs
            current.append(self._known[file, name, inputs])
        return np.array(current, dtype=bool)[groups]

    def count(self, table: pa.Table, path: Path) -> None:
        """Note which rows are there, and what they say."""
        import pyarrow.compute as pc

        table = table.filter(self._find_current(table))
        files = table["file"].combine_chunks().dictionary_encode()
        which, rows, codes = files.indices.to_numpy(), table["row"].to_numpy(), table["code"].to_numpy()
        order = np.argsort(which, kind="stable")
        for own in np.split(order, np.flatnonzero(np.diff(which[order])) + 1) if len(order) else []:
            file = str(files.dictionary[which[own[0]]])
            good = own[rows[own] >= 0]
            new = good[~self._look_up(file, rows[good])]
            self._note(file, rows[new])
            for i in own[rows[own] < 0].tolist():
                self._faults[file][int(rows[i])] = table["message"][i].as_py()
            if len(new) and (self.shard.count == 1 or path.parent == self.own):
                for code, number in zip(*np.unique(codes[new], return_counts=True)):
                    self.counts[str(Status.from_code(int(code)))] += int(number)
                told = {name: table[name].take(new) for name in _VERDICTS}
                for verdict, values in told.items():
                    self.verdicts[verdict] += pc.sum(values).as_py() or 0
                self.verdicts["commanded"] += len(new) - told["held_as_commanded"].null_count
                name = table["object"][int(new[0])].as_py()
                self._placing[name].append((codes[new], table["depth_m"].to_numpy()[new]))
        if self._faults:
            self.counts[REFUSED] = len(self._faults)

    def _look_up(self, file: str, rows: IntArray) -> BoolArray:
        """Which grasps of a file are there (N,); workers' threads ask, too."""
        have = self._have.get(file, np.zeros(0, dtype=bool))
        found = rows < len(have)
        found[found] = have[rows[found]]
        return found

    def _note(self, file: str, rows: IntArray) -> None:
        have = self._have.get(file, np.zeros(0, dtype=bool))
        if (most := int(rows.max(initial=-1)) + 1) > len(have):
            have = np.pad(have, (0, max(most, 2 * len(have)) - len(have)))
        have[rows] = True
        self._have[file] = have

    def is_there(self, file: str, rows: IntArray) -> bool:
        """Whether grasps of a file are there, or the fault that they are of."""
        return Fault.number(int(rows[0])) in self._faults.get(file, {}) or bool(self._look_up(file, rows).all())

    @property
    def faults(self) -> dict[str, str]:
        """The first of each file, ``{file: message}``."""
        return {file: found[max(found)] for file, found in self._faults.items()}

    @property
    def hints(self) -> dict[str, str]:
        """What to look at, by the objects whose grasps are nearly all misplaced."""
        found = {}
        for name, rows in self._placing.items():
            codes, depths = zip(*rows)
            found[name] = placement_hint(np.concatenate(codes), np.concatenate(depths), f"'{name}'")
        return {name: hint for name, hint in found.items() if hint}

    def take(self, table: pa.Table) -> int:
        """Keep the rows of a block, or its fault."""
        self.add(table)
        return int(table.num_rows)

    def list_left(self, format: str) -> Iterator[Left]:
        """What is left of the shard's share, in the order of the files."""
        for i, path in enumerate(self.files):
            if not self.deal.is_of(i, self.shard.number):
                continue
            source, at, block = self.inputs.source(path, None), 0, 0
            try:
                for grasps in read_grasps(path, format=format, block=_BLOCK):
                    source = self.inputs.source(path, object_named(grasps))
                    if self.deal.number_of(i, block) == self.shard.number:
                        yield from self._left_of(i, block, source, grasps)
                    at, block = grasps.first + grasps.n, block + 1
            except ExtraMissing:
                raise
            except Exception as error:  # one file must not end the certification of the others
                fault = Fault(at, fault_of(error))
                if self.deal.number_of(i, block) == self.shard.number:
                    self.total += 1
                    if not self.is_there(str(path), np.array([at])):
                        yield Left(i, block, source, fault, np.array([at]))

    def _left_of(self, file: int, block: int, source: RowSource, grasps: GraspRows) -> Iterator[Left]:
        self.total += grasps.n
        for scale in np.unique(grasps.scale):
            own = np.flatnonzero(grasps.scale == scale)
            if not self.is_there(source.file, grasps.first + own):
                yield Left(file, block, source, grasps.only(own), grasps.first + own)
