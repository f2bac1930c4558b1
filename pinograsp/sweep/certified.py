"""Data sets of grasps certified, file by file, on all cores or on a cluster: a table with a row per grasp."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinograsp import defaults
from pinograsp.certification.protocols import Protocol, find_protocol
from pinograsp.checks import brief, flag, instance_of, items_of, number, one_of, path_of
from pinograsp.data import FORMATS, join_rows, read_grasps, write_grasps
from pinograsp.errors import ExtraMissing, GraspsNotRead, InvalidInput, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.spatial import Array
from pinograsp.sweep.certified_rows import (
    Prepared,
    Work,
    belong_together,
    certify_blocks,
    fault_of,
    object_named,
    place_block,
)
from pinograsp.sweep.certified_store import WORK, CertifiedRows
from pinograsp.sweep.certified_table import REFUSED, Block, Fault, schema_of
from pinograsp.sweep.inputs import Inputs, plain, settings_of_conditions, settings_of_hand
from pinograsp.sweep.parts import drop_doubles, read_parts
from pinograsp.sweep.runner import Executor, Progress, Runner
from pinograsp.sweep.shards import Missing, Shard
from pinograsp.writing import place_of, write_errors

if TYPE_CHECKING:
    import pyarrow as pa

_MEANT = ("joints", "frame", "convention", "original", "palm_in_root")
# Files of so few grasps are certified together, so many of these at once: one alone takes as long as dozens.
_FEW, _TOGETHER = 2, 64
# Labels that are written back, and the largest number that 32 bits hold.
_WRITTEN, _MOST = ("reserve", "least_mu", "largest_load_N"), 3.4e38


@dataclass(frozen=True, slots=True, kw_only=True)
class Certified:
    """Result of a certification of files. Its rows are in its folder; :meth:`table` reads them.

    Attributes:
        folder: that holds the rows.
        rows: number of grasps in the folder, those of earlier runs included; of a shard: that it has certified itself.
        counts: number of these grasps by reason, and of faults.
        verdicts: number of these grasps that are ``possible``, that were ``commanded``, and ``held_as_commanded``.
        faults: what could not be read or used, ``{file: message}``.
        hints: objects whose grasps are nearly all misplaced, and what to look at, ``{object: hint}``.
        changed: files with rows in the folder whose content, or whose object's, has changed since: certified again.
        interrupted: whether Ctrl-C stopped it; the same call continues it.
        elapsed: of this run [s].
    """

    folder: Path
    rows: int
    counts: dict[str, int]
    verdicts: dict[str, int]
    faults: dict[str, str]
    hints: dict[str, str]
    interrupted: bool
    elapsed: float
    changed: tuple[str, ...] = ()

    __repr__ = brief()

    def table(self) -> pa.Table:
        """The rows by file and number, a ``pyarrow.Table``: see :func:`read_certified`."""
        return read_certified(self.folder)

    def summary(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "rows": self.rows,
            "counts": dict(self.counts),
            "verdicts": dict(self.verdicts),
            "faults": dict(self.faults),
            "hints": dict(self.hints),
            "changed": list(self.changed),
            "interrupted": self.interrupted,
            "elapsed_s": self.elapsed,
            "folder": str(self.folder),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DataSet:
    """Files of grasps, and what they do not say.

    Attributes:
        files: of grasps, each of one object.
        hand: the hand that they are of.
        objects: folder of the objects that they name, see :func:`~pinograsp.objects.lookup.find_object`; or the file of
            the one object that all of them are of. Files that name none are of an object of their own name.
        format: a name of :data:`pinograsp.data.FORMATS`, or ``"auto"``.
        mass: of each object [kg]; None: by its density.
        density: [kg/m^3] of each object.
        joints: as for :func:`~pinograsp.data.place_hand`.
        frame: likewise.
        convention: likewise.
        original: likewise.
        palm_in_root: likewise.
    """

    files: Sequence[Path]
    hand: HandModel
    objects: Path
    format: str = "auto"
    mass: float | None = None
    density: float | None = None
    joints: dict[str, str] | None = None
    frame: str | None = None
    convention: str | None = None
    original: HandModel | None = None
    palm_in_root: Array | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        files = tuple(path_of("file of grasps", one) for one in items_of("files", self.files, str, Path))
        if not files:
            raise InvalidInput("files: expected at least one file of grasps")
        object.__setattr__(self, "files", files)
        one_of("format", self.format, ("auto", *FORMATS))
        instance_of("hand", self.hand, HandModel)
        object.__setattr__(self, "objects", path_of("folder of objects", self.objects))
        instance_of("original", self.original, HandModel, type(None))
        if (self.mass is None) == (self.density is None):
            raise InvalidInput("objects: expected mass [kg] or density [kg/m^3], one of them: data sets have neither")
        for name, unit in (("mass", "kg"), ("density", "kg/m^3")):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, number(name, getattr(self, name), above=0, unit=unit))

    @property
    def meant(self) -> dict[str, Any]:
        """What the files mean, for :func:`~pinograsp.data.place_hand`."""
        return {name: getattr(self, name) for name in _MEANT}


def certify_files(
    data: DataSet,
    folder: str | Path,
    conditions: GraspConditions,
    *,
    tolerance: float | None = None,
    drives: bool = True,
    protocol: Protocol | str | None = None,
    commanded: bool = False,
    jobs: int = -1,
    executor: Executor = "joblib",
    scheduler: str | None = None,
    progress: bool | None = None,
    shard: tuple[int, int] | str | None = None,
) -> Certified:
    """Certify the grasps of files; called again with the same arguments, it continues.

    Rows are written every two seconds, whole blocks at once, so that nothing is lost or doubled where the process is
    killed. A file that cannot be read, or whose object is not found, is a fault: a row without a number, with its
    message; what was read before it is kept.

    Rows are of the contents that they were computed from. Where a file of grasps or of its object has another content
    than its rows in the folder, these are computed again, and ``changed`` names the file; what the rows of all files
    rest on, the hand, the conditions and the options, makes another certification, which needs a folder of its own.

    Files of one or two grasps are certified together where they are of one object: the last digits of their forces
    depend on which of them were left.

    Args:
        data: the files, their hand and their objects.
        folder: for the rows, as Parquet files; a new folder, or one of this certification.
        conditions: as for :func:`~pinograsp.certification.certify`.
        tolerance: likewise [m]; None: 2 mm, or the protocol's.
        drives: likewise.
        protocol: likewise.
        commanded: likewise; what files command themselves is tried in any case.
        jobs: processes; -1: all cores; 1: this process.
        executor: ``"joblib"``, or ``"dask"``, whose workers need this package, and the objects at the same paths.
        scheduler: address of a Dask scheduler, such as ``"tcp://10.0.0.1:8786"``.
        progress: bar on stderr: None (on a terminal), True or False.
        shard: certify the i-th of n shares alone, as for :func:`~pinograsp.sweep.sweep`.

    Raises:
        InvalidInput: options that cannot be used.
        ResultsNotWritten: the folder holds another certification, one of another version of this package, or other
            files; it is in use (by this shard, or by one of another n), or cannot be written.
        ExtraMissing: pyarrow (extra ``sweep``), the compiled core, h5py (``data``) or distributed (``dask``).
        PinograspError: workers were lost; completed rows are kept.
    """
    started = time.perf_counter()
    runner = Runner(jobs=jobs, executor=executor, scheduler=scheduler, progress=progress)
    opened, payload = _open(data, folder, conditions, tolerance, drives, protocol, commanded, Shard.of(shard))
    with opened as rows:
        interrupted = runner.run(
            certify_blocks,
            _work(data, rows, payload),
            rows,
            rows.take,
            Progress("certify", "grasp", sum(rows.counts.values())),
        )
        return Certified(
            folder=Path(folder),
            rows=sum(rows.counts.values()) - rows.counts[REFUSED],
            counts=dict(rows.counts),
            verdicts=dict(rows.verdicts),
            faults=rows.faults,
            hints=rows.hints,
            changed=rows.changed,
            interrupted=interrupted,
            elapsed=time.perf_counter() - started,
        )


def find_missing_grasps(
    data: DataSet,
    folder: str | Path,
    conditions: GraspConditions,
    *,
    tolerance: float | None = None,
    drives: bool = True,
    protocol: Protocol | str | None = None,
    commanded: bool = False,
    shard: tuple[int, int] | str | None = None,
) -> Missing:
    """The grasps that :func:`certify_files` would certify with these arguments; the fault of a file counts as one.

    All files are read, or those of the shard. Nothing is written, and shards may be running.

    Raises:
        InvalidInput, ResultsNotWritten, ExtraMissing: as of :func:`certify_files`.
    """
    rows, _ = _open(data, folder, conditions, tolerance, drives, protocol, commanded, Shard.of(shard), look=True)
    missing, deals = 0, {count: rows.deal_to(count) for count in rows.list_counts()}
    shards: dict[int, set[int]] = {count: set() for count in deals}
    for left in rows.list_left(data.format):
        missing += len(left.rows)
        for count, deal in deals.items():
            shards[count].add(deal.number_of(left.file, left.block))
    found = {count: tuple(sorted(numbers)) for count, numbers in shards.items()}
    return Missing(rows=missing, total=rows.total, shards=found)


def read_certified(folder: str | Path) -> pa.Table:
    """The rows of a certification as a ``pyarrow.Table``, by file and number; its columns are in the documentation.

    Raises:
        InvalidInput: the folder holds no certification, or a damaged one.
        ExtraMissing: pyarrow (extra ``sweep``) is not installed.
    """
    tables = read_parts(path_of("folder", folder), WORK)
    import pyarrow as pa
    import pyarrow.compute as pc

    table = pa.concat_tables([schema_of().empty_table(), *tables], promote_options="default")
    number = table["row"]
    place = table.column_names.index("row")
    table = table.set_column(place, "row", pc.max_element_wise(number, -1)).append_column("number", number)
    table = table.sort_by([("file", "ascending"), ("row", "ascending"), ("number", "descending")])
    return drop_doubles(table.drop_columns("number"), ["file", "row"])


def written_back(data: DataSet, folder: str | Path, target: str | Path) -> tuple[list[Path], dict[str, str]]:
    """The files again in their own formats, with forces, points and what was certified, into ``target``.

    Rows without forces have zeros. Labels are ``held``, ``reason_code``, ``reserve``, ``least_mu`` and
    ``largest_load_N``; infinities are written as the largest number of 32 bits.

    Returns:
        The paths, and what could not be written, ``{file: message}``: files with faults, and formats without a place
        for forces.

    Raises:
        ResultsNotWritten: the folder cannot be written.
    """
    instance_of("data", data, DataSet)
    table, target = read_certified(folder), path_of("target", target)
    import pyarrow.compute as pc

    inputs = Inputs(data.objects)
    place_of(target)
    above = Path(os.path.commonpath([one.resolve().parent for one in data.files]))
    done, refused = list[Path](), dict[str, str]()
    for path in data.files:
        own = table.filter((pc.field("file") == str(path)) & (pc.field("row") >= 0))
        try:
            rows = join_rows(read_grasps(path, format=data.format))
            if own.num_rows != rows.n:
                raise InvalidInput(f"{own.num_rows} of its {rows.n} grasps are certified")
            if {inputs.source(path, object_named(rows)).inputs} != set(own["inputs"].to_pylist()):
                raise InvalidInput("it, or its object, has changed since it was certified: certify it again")
            forces, points = (_pad(own[name]) for name in ("forces_N", "points_m"))
            labels = {"held": own["code"].to_numpy() == Status.HELD.code, "reason_code": own["code"].to_numpy()}
            labels |= {name: np.minimum(own[name].to_numpy(), _MOST) for name in _WRITTEN}
            goal = target / path.resolve().relative_to(above)
            with write_errors(goal):
                goal.parent.mkdir(parents=True, exist_ok=True)
            done.append(write_grasps(goal, rows, forces=forces, points=points, labels=labels))
        except (InvalidInput, GraspsNotRead) as error:
            refused[str(path)] = str(error)
    return done, refused


def _pad(column: pa.ChunkedArray) -> Array:
    """Lists of three numbers for each contact as an array (N, k, 3), filled with zeros."""
    lists = column.to_pylist()
    found = np.zeros((len(lists), max((len(one) for one in lists), default=0) // 3, 3))
    for i, one in enumerate(lists):
        found[i, : len(one) // 3] = np.reshape(one, (-1, 3))
    return found


def _open(
    data: DataSet,
    folder: str | Path,
    conditions: GraspConditions,
    tolerance: float | None,
    drives: bool,
    protocol: Protocol | str | None,
    commanded: bool,
    shard: Shard,
    look: bool = False,
) -> tuple[CertifiedRows, bytes]:
    """The rows that are there, and what all blocks have in common, for their workers."""
    instance_of("data", data, DataSet)
    instance_of("conditions", conditions, GraspConditions)
    flag("drives", drives)
    flag("commanded", commanded)
    protocol = find_protocol(protocol)
    if tolerance is None:
        tolerance = defaults.TOUCHES if protocol is None else protocol.tolerance
    tolerance = number("tolerance", tolerance, above=0, unit="m")
    prepared = Prepared(
        hand=data.hand,
        objects=data.objects,
        mass=data.mass,
        density=data.density,
        conditions=conditions,
        tolerance=tolerance,
        drives=bool(drives),
        protocol=protocol,
        commanded=bool(commanded),
    )
    settings = {
        "files": [str(one) for one in data.files],
        "format": data.format,
        "mass": data.mass,
        "density": data.density,
        "hand": settings_of_hand(data.hand),
        "conditions": settings_of_conditions(conditions),
        **{name: plain(value) for name, value in data.meant.items() if value is not None},
        "tolerance": tolerance,
        "drives": bool(drives),
        "protocol": None if protocol is None else protocol.name,
        "commanded": bool(commanded),
    }
    files = tuple(data.files)
    rows = CertifiedRows(path_of("folder", folder), settings, files, Inputs(data.objects), shard, look)
    return rows, pickle.dumps(prepared)


def _work(data: DataSet, rows: CertifiedRows, payload: bytes) -> Iterator[tuple[bytes, list[Work]]]:
    """The blocks that are left, on the hand; those of small files together, where they are of one object."""
    together: list[Work] = []
    count = 0
    for left in rows.list_left(data.format):
        block: Block | Fault
        if isinstance(left.grasps, Fault):
            block = left.grasps
        else:
            try:
                block = place_block(left.grasps, left.rows, data.hand, **data.meant)
            except ExtraMissing:
                raise
            except Exception as error:  # one file must not end the certification of the others
                block = Fault(int(left.rows[0]), fault_of(error))
        one, own = (left.source, block), len(left.rows)
        few = left.block == 0 and own <= _FEW
        if together and not (few and count + own <= _TOGETHER and belong_together(together[0], one)):
            yield payload, together
            together, count = [], 0
        together.append(one)
        count += own if few else _TOGETHER
    if together:
        yield payload, together
