"""Files of grasps, recognised by their content."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pinograsp.checks import integer, one_of
from pinograsp.data.files import File, Keep
from pinograsp.data.format import Format
from pinograsp.data.formats import FORMATS
from pinograsp.data.rows import GraspRows, checked_rows
from pinograsp.errors import GraspsNotRead

_BLOCK = 1024


def read_grasps(
    path: str | Path,
    *,
    format: str = "auto",
    block: int = _BLOCK,
    most: int | None = None,
    keep: Keep = "valid",
) -> Iterator[GraspRows]:
    """Read the grasps of a public data set's file, in blocks, in the order of the file.

    Nothing in the file is executed: pickles and PyTorch's files are interpreted opcode by opcode, and rejected if they
    hold more than numbers, texts, lists, dicts and arrays. ACRONYM's and GraspNet's files are read part by part; the
    others are loaded into memory (512 MB at most).

    Args:
        path: the file.
        format: a name of :data:`~pinograsp.data.FORMATS`; ``"auto"`` recognises the format by its content.
        block: largest number of grasps in a record.
        most: largest number of grasps to read; None: all.
        keep: from GraspNet's grid, the ``"valid"`` grasps, which hold with some friction and do not collide, or
            ``"all"``.

    Yields:
        records whose ``first`` counts the grasps before them.

    Raises:
        GraspsNotRead: the file does not exist, is of another format, broken or hostile; or a row is not a possible
            grasp; the rows before it are yielded first.
        ExtraMissing: ACRONYM's file without h5py (extra ``data``).
    """
    block = integer("block", block, at_least=1)
    most = None if most is None else integer("most", most, at_least=0)
    one_of("format", format, ["auto", *FORMATS])
    one_of("keep", keep, ["valid", "all"])
    return _read(path, format, block, most, keep)


def _read(path: str | Path, format: str, block: int, most: int | None, keep: Keep) -> Iterator[GraspRows]:
    if most == 0:
        return
    file = File(path, block=block, keep=keep)
    kind = find_format(file) if format == "auto" else FORMATS[format]
    if file.container != kind.container:
        raise GraspsNotRead(file.source, f"{kind.name}: expected {kind.container}, got {file.container}")
    first = 0
    for draft in kind.read(file):
        for rows in checked_rows(draft, source=file.source, kind=kind.name, first=first, block=block):
            if most is not None and rows.first + rows.n >= most:
                yield rows.only(range(most - rows.first))
                return
            yield rows
        first += len(draft.poses)


def find_format(file: File) -> Format:
    """The format of a file by its content.

    Raises:
        GraspsNotRead: none of those that are read.
    """
    for kind in FORMATS.values():
        if kind.container == file.container and kind.sniff(file):
            return kind
    raise GraspsNotRead(
        file.source,
        f"expected a file of one of the formats {', '.join(FORMATS)}, got {file.describe()}: give format= if it is one "
        "of them",
    )
