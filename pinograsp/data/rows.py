"""Grasps as a file of somebody else's has them, in one form: the record, and the checks of every row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinograsp.checks import brief, integer, one_of, read_only, shorten
from pinograsp.data.keys import stack
from pinograsp.data.rotations import nearest_rotations
from pinograsp.errors import GraspsNotRead, InvalidInput
from pinograsp.spatial import FARTHEST, Array, BoolArray, inverse_of

Table = Mapping[str, NDArray[Any]]

_ROTATION_TOLERANCE = 2e-3  # of matrices and quaternions written in 32 bits, or with a few digits
_LARGEST_JOINT = 1e3  # [rad or m]
_LARGEST = 2**30  # [bytes] of labels and other arrays: the same array may stand under many names


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspRows:
    """Grasps (N) of one file, in the order of the file. Frames: b the object's, that of its scaled mesh; h the hand's
    root in the file; o the file's world.

    Attributes:
        source: the file.
        format: a name of :data:`~pinograsp.data.FORMATS`.
        first: index of the first of these rows in the file.
        object_name: name of the object in the file: a path, a code; "" if it has none.
        hand_name: name of the hand in the file; "" if it has none.
        poses: bMh (N, 4, 4), of the hand's root frame in the object's.
        q: positions (N, d) of the hand's joints [rad or m], in the order of the file; d is 0 for most jaws.
        joint_names: of the d joints; () if the file does not name them.
        scale: of the object's mesh (N,) [-].
        object_pose: oMb (4, 4), of the object in the file's world, in which z is up; None if the file has none.
        pregrasp_poses, squeeze_poses: bMh (N, 4, 4) before the grasp and of the commanded posture that squeezes; None
            if the file has none, or if they equal ``poses``.
        pregrasp_q, squeeze_q: joint positions (N, d) [rad or m] of these postures; None if the file has none.
        widths: openings of jaws (N,) [m]; None if the file has none.
        labels: the file's own numbers of each row, {name: (N,)}: energies, scores, success.
        extras: the file's other arrays of each row, {name: (N, ...)}: contacts, directions, forces, in its units.
        object_facts: what the file says about the object, {name: array}, such as ``mass`` [kg] and ``friction`` [-].
    """

    source: str
    format: str
    first: int
    object_name: str
    hand_name: str
    poses: Array
    q: Array
    joint_names: tuple[str, ...]
    scale: Array
    object_pose: Array | None = None
    pregrasp_poses: Array | None = None
    pregrasp_q: Array | None = None
    squeeze_poses: Array | None = None
    squeeze_q: Array | None = None
    widths: Array | None = None
    labels: Table = field(default_factory=dict)
    extras: Table = field(default_factory=dict)
    object_facts: Table = field(default_factory=dict)

    __repr__ = brief("format", "first", "n", "hand_name", "object_name", "joint_names", "source")

    @property
    def n(self) -> int:
        """Number of grasps."""
        return len(self.poses)

    def only(self, which: ArrayLike) -> GraspRows:
        """Return some of the grasps, by a mask (N,) or by indices (M,), in that order.

        Raises:
            InvalidInput: a mask of another length, or indices out of range.
        """
        try:
            wanted = np.asarray(which)
        except (ValueError, TypeError, OverflowError):  # lists of different lengths
            wanted = np.array([None])
        mask = wanted.dtype.kind == "b" and wanted.shape == (self.n,)
        indices = wanted.dtype.kind in "iu" and wanted.ndim == 1 and not ((wanted < 0) | (wanted >= self.n)).any()
        if not (mask or indices or wanted.size == 0):
            raise InvalidInput(
                f"which: expected a mask of {self.n} rows or indices below {self.n}, got {shorten(which)}"
            )
        at = np.flatnonzero(wanted) if mask else wanted.astype(int).reshape(-1)
        values: dict[str, Any] = {
            name: None if (array := getattr(self, name)) is None else read_only(array[at]) for name in EACH_ROW
        }
        for table in ("labels", "extras"):
            values[table] = {name: read_only(array[at]) for name, array in getattr(self, table).items()}
        return replace(self, first=self.first + int(at[0]) if len(at) else self.first, **values)

    def at(self, posture: Literal["pregrasp", "grasp", "squeeze"]) -> GraspRows:
        """Return the same grasps with another posture as ``poses`` and ``q``: before the grasp, or the one that
        squeezes.

        Raises:
            InvalidInput: the file has no such posture.
        """
        one_of("posture", posture, ("pregrasp", "grasp", "squeeze"))
        if posture == "grasp":
            return self
        poses, q = getattr(self, f"{posture}_poses"), getattr(self, f"{posture}_q")
        if q is None:
            raise InvalidInput(f"posture: a file of format {self.format} has no {posture} posture")
        return replace(self, poses=self.poses if poses is None else poses, q=q)

    @property
    def world_poses(self) -> Array:
        """oMh (N, 4, 4), of the hand's root in the file's world; ``poses`` if the file has no world."""
        return self.poses if self.object_pose is None else read_only(self.object_pose @ self.poses)


@dataclass(kw_only=True, eq=False)
class Draft:
    """Rows that a reader has taken from a file, before they are looked at; fields as of :class:`GraspRows`.

    Attributes:
        in_world: whether the poses are oMh, relative to the object's world.
        fault: the first row that cannot be used, and why.
        last: what is wrong with the file after these rows.
    """

    poses: Array
    q: Array
    scale: Array
    joint_names: tuple[str, ...] = ()
    object_name: str = ""
    hand_name: str = ""
    object_pose: Array | None = None
    pregrasp_poses: Array | None = None
    pregrasp_q: Array | None = None
    squeeze_poses: Array | None = None
    squeeze_q: Array | None = None
    widths: Array | None = None
    labels: dict[str, NDArray[Any]] = field(default_factory=dict)
    extras: dict[str, NDArray[Any]] = field(default_factory=dict)
    object_facts: dict[str, NDArray[Any]] = field(default_factory=dict)
    in_world: bool = False
    fault: tuple[int, str] | None = None
    last: str | None = None

    def refuse(self, bad: BoolArray, problem: str) -> None:
        """Remember the first bad row, if there is an earlier one than before."""
        if bad.any() and (self.fault is None or int(bad.argmax()) < self.fault[0]):
            self.fault = int(bad.argmax()), problem

    def end(self, problem: str | None) -> None:
        """Remember that the row after the last one cannot be used, and why."""
        if problem is not None and self.fault is None:
            self.fault, self.last = (len(self.poses), problem), None

    def put_tables(self, rows: Sequence[Mapping[str, NDArray[Any]]], source: str) -> None:
        """Further numbers of each row, by name; those that are not in all of them, or of other shapes, are left out."""
        for name in rows[0] if rows else ():
            array = stack([row.get(name) for row in rows], source)
            if array is not None:
                (self.extras if array.ndim > 1 else self.labels)[name] = array


_POSES = ("poses", "pregrasp_poses", "squeeze_poses")
_JOINTS = ("q", "pregrasp_q", "squeeze_q")
EACH_ROW = (*_POSES, *_JOINTS, "scale", "widths")


def checked_rows(draft: Draft, *, source: str, kind: str, first: int, block: int) -> Iterator[GraspRows]:
    """The rows of a draft in blocks, up to the first that cannot be used.

    Raises:
        GraspsNotRead: after the rows before it, for that row or for what comes after the rows.
    """
    block = integer("block", block, at_least=1)
    if sum(array.nbytes for table in (draft.labels, draft.extras) for array in table.values()) > _LARGEST:
        raise GraspsNotRead(source, f"expected at most {_LARGEST} bytes of labels and other arrays, got more")
    _look(draft)
    count = len(draft.poses) if draft.fault is None else draft.fault[0]
    if draft.object_pose is not None:
        draft.object_pose = nearest_rotations(draft.object_pose)
    for begin in range(0, count, block):
        part = slice(begin, min(begin + block, count))
        yield _rows(draft, part, source=source, kind=kind, first=first + begin)
    if draft.fault is not None:
        raise GraspsNotRead(source, draft.fault[1], row=first + draft.fault[0])
    if draft.last is not None:
        raise GraspsNotRead(source, f"{draft.last}; the {first + count} rows before are good")


def _look(draft: Draft) -> None:
    """Find the first row with a number that no grasp has."""
    for name in _JOINTS:
        if (values := getattr(draft, name)) is not None:
            bad = ~(np.abs(values) <= _LARGEST_JOINT).all(axis=1)
            draft.refuse(bad, f"{name}: expected finite joint positions [rad or m] within +-{_LARGEST_JOINT:g}")
    for name in _POSES:
        if (poses := getattr(draft, name)) is not None:
            reach = FARTHEST if draft.in_world else FARTHEST / 10
            far = ~(np.abs(poses[:, :3, 3]) <= reach).all(axis=1)
            draft.refuse(far, f"{name}: expected finite positions within {reach:g} m: metres, not millimetres")
            draft.refuse(~_rotations(poses[:, :3, :3]), f"{name}: expected right-handed orthonormal rotations")
            last = ~(np.abs(poses[:, 3] - [0, 0, 0, 1]) <= _ROTATION_TOLERANCE).all(axis=1)
            draft.refuse(last, f"{name}: expected the last row 0 0 0 1")
    draft.refuse(~((draft.scale > 0) & (draft.scale < 1e6)), "scale: expected a finite number > 0")
    if draft.widths is not None:
        draft.refuse(~((draft.widths >= 0) & (draft.widths < FARTHEST)), "widths: expected finite widths >= 0 [m]")


def _rotations(matrices: Array) -> BoolArray:
    with np.errstate(all="ignore"):
        nearly = np.abs(matrices @ matrices.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2)) <= _ROTATION_TOLERANCE
        proper: BoolArray = nearly & (np.linalg.det(np.where(nearly[:, None, None], matrices, 0.0)) > 0)
    return proper


def _rows(draft: Draft, part: slice, *, source: str, kind: str, first: int) -> GraspRows:
    values: dict[str, Any] = {}
    for name in EACH_ROW:
        array = getattr(draft, name)
        if array is not None:
            array = array[part]
            if name in _POSES:
                array = nearest_rotations(array)
                if draft.in_world and draft.object_pose is not None:
                    array = inverse_of(draft.object_pose) @ array
            array = read_only(np.asarray(array, dtype=float))
        values[name] = array
    for name in ("labels", "extras"):
        values[name] = {key: read_only(array[part]) for key, array in getattr(draft, name).items()}
    return GraspRows(
        **values,
        source=source,
        format=kind,
        first=first,
        object_name=draft.object_name,
        hand_name=draft.hand_name,
        joint_names=draft.joint_names,
        object_pose=None if draft.object_pose is None else read_only(draft.object_pose),
        object_facts={key: read_only(array) for key, array in draft.object_facts.items()},
    )
