"""Files of grasps, recognised by their content."""

from __future__ import annotations

import itertools
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, get_args

from pinograsp.checks import integer, one_of
from pinograsp.data import acronym, bodex, dexgraspbench, dexgraspnet, get_a_grip, graspgen, graspnet, graspqp, isaac
from pinograsp.data.files import File
from pinograsp.data.rows import Draft, Format, GraspRows, checked_rows
from pinograsp.errors import GraspsNotRead

Keep = Literal["valid", "all"]

FORMATS: tuple[Format, ...] = get_args(Format)
_BLOCK = 1024
_CONTAINERS = {
    "an .npy file": ("dexgraspnet", "bodex", "dexgraspbench", "dexonomy", "get_a_grip"),
    "an HDF5 file": ("acronym",),
    "a ZIP archive": ("graspqp", "graspnet"),
    "text": ("graspgen", "isaac"),
}


def read_grasps(
    path: str | Path,
    *,
    format: Format | Literal["auto"] = "auto",
    block: int = _BLOCK,
    most: int | None = None,
    keep: Keep = "valid",
) -> Iterator[GraspRows]:
    """The grasps of a public data set's file, in blocks, in the order of the file.

    Nothing of the file is run: pickles and PyTorch's files are taken apart opcode by opcode, and refused where they
    hold more than numbers, texts, lists, dicts and arrays. ACRONYM's and GraspNet's files are read a part at a time;
    the others are in memory once (512 MB at most).

    Args:
        path: the file.
        format: how it is written; ``"auto"`` tells by its content.
        block: grasps a record has, at most.
        most: grasps to read, at most; None: all.
        keep: of GraspNet's grid, ``"valid"`` grasps that hold at some friction and do not collide, or ``"all"``.

    Yields:
        records whose ``first`` counts the grasps before them.

    Raises:
        GraspsNotRead: there is no such file, it is of another format, broken or hostile; or a row has what no grasp
            has, after the rows before it were yielded.
        ExtraMissing: ACRONYM's file without h5py (extra ``data``).
    """
    block = integer("block", block, at_least=1)
    most = None if most is None else integer("most", most, at_least=0)
    one_of("format", format, ["auto", *FORMATS])
    one_of("keep", keep, ["valid", "all"])
    return _read(path, format, block, most, keep)


def _read(
    path: str | Path, format: Format | Literal["auto"], block: int, most: int | None, keep: Keep
) -> Iterator[GraspRows]:
    if most == 0:
        return
    file = File(path)
    kind = format_of(file) if format == "auto" else format
    _expect_container(file, kind)
    first = 0
    for draft in _drafts(file, kind, block, keep):
        for rows in checked_rows(draft, source=file.source, kind=kind, first=first, block=block):
            if most is not None and rows.first + rows.n >= most:
                yield rows.only(range(most - rows.first))
                return
            yield rows
        first += len(draft.poses)


def _drafts(file: File, kind: Format, block: int, keep: Keep) -> Iterator[Draft]:
    if kind == "acronym":
        return acronym.read(file, block)
    if kind == "graspnet":
        return graspnet.read(file, keep)
    readers: dict[str, Callable[[File], Iterator[Draft]]] = {
        "dexgraspnet": dexgraspnet.read,
        "bodex": bodex.read,
        "dexgraspbench": dexgraspbench.read,
        "dexonomy": dexgraspbench.read_dexonomy,
        "graspqp": graspqp.read,
        "get_a_grip": get_a_grip.read,
        "graspgen": graspgen.read,
        "isaac": isaac.read,
    }
    return readers[kind](file)


def container_of(file: File) -> str:
    """What kind of file it is, by its first bytes."""
    if file.head.startswith(b"\x93NUMPY"):
        return "an .npy file"
    if file.head.startswith(b"\x89HDF\r\n\x1a\n"):
        return "an HDF5 file"
    if file.head.startswith(b"PK"):
        return "a ZIP archive"
    if file.head.startswith(b"\x80"):
        return "a bare pickle (of PyTorch before 1.6, perhaps: load it with torch there, and save it again)"
    head = file.head.lstrip(b"\xef\xbb\xbf")
    return "text" if b"\0" not in head and head.strip() else "something unknown"


def _expect_container(file: File, kind: Format) -> None:
    got = container_of(file)
    if kind not in _CONTAINERS.get(got, ()):
        wanted = next(name for name, kinds in _CONTAINERS.items() if kind in kinds)
        raise GraspsNotRead(file.source, f"{kind}: expected {wanted}, got {got}")


def format_of(file: File) -> Format:
    """The format of a file by its content.

    Raises:
        GraspsNotRead: none of those that are read.
    """
    container = container_of(file)
    if container == "an HDF5 file":
        return "acronym"
    if container == "text":
        return "graspgen" if file.head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") else "isaac"
    if container == "a ZIP archive":
        try:
            with zipfile.ZipFile(file.path) as archive:
                names = archive.namelist()
        except Exception as error:  # zipfile raises whatever comes of a broken file
            raise GraspsNotRead(file.source, f"the ZIP archive is broken or cut off ({error})") from error
        if any(name.endswith("/data.pkl") for name in names):
            return "graspqp"
        if "offsets.npy" in names or "scores.npy" in names:
            return "graspnet"
        there = ", ".join(itertools.islice(names, 6))
        raise GraspsNotRead(file.source, _unknown(f"a ZIP archive of {there}"[:200]))
    if container != "an .npy file":
        raise GraspsNotRead(file.source, _unknown(container))
    return _npy_format(file)


def _npy_format(file: File) -> Format:
    value = file.pickled[0]
    if isinstance(value, list):
        return "dexgraspnet"
    if isinstance(value, dict):
        if "robot_pose" in value and "grasp_qpos" not in value:
            return "bodex"
        if "joint_angles" in value and "trans" in value:
            return "get_a_grip"
        if "grasp_qpos" in value:
            return "dexonomy" if "hand_name" in value else "dexgraspbench"
        keys = ", ".join(str(key)[:40] for key in itertools.islice(value, 10))
        raise GraspsNotRead(file.source, _unknown(f"a dict with the keys {keys or '(none)'}"))
    raise GraspsNotRead(file.source, _unknown(f"an .npy file with a {type(value).__name__} in it"))


def _unknown(got: str) -> str:
    return f"expected a file of one of the formats {', '.join(FORMATS)}, got {got}: give format= if it is one of them"
