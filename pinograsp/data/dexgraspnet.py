"""DexGraspNet: an .npy file of a list of dicts, one for each grasp.

Layout as of ``grasp_generation/scripts/generate_grasps.py`` of PKU-EPIC/DexGraspNet: ``scale``; ``qpos`` with the
palm's place ``WRJTx WRJTy WRJTz`` [m], its angles ``WRJRx WRJRy WRJRz`` [rad] about the fixed axes x, y, z of the
object, one after the other, and the joints by their names [rad]; ``qpos_st`` alike, before the optimisation;
energies.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pinograsp.checks import shown
from pinograsp.data.files import File
from pinograsp.data.keys import Keys, as_numbers, stacked
from pinograsp.data.rotations import poses_from_sxyz, sxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.data.written import Payload, npy_of
from pinograsp.errors import GraspsNotRead
from pinograsp.spatial import Array

_PLACE = ("WRJTx", "WRJTy", "WRJTz")
_ANGLES = ("WRJRx", "WRJRy", "WRJRz")
_START = ("start_poses", "start_q")


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    values, last = file.pickled
    if not isinstance(values, list) or not values:
        raise GraspsNotRead(file.source, "dexgraspnet: expected a list of dicts, one for each grasp")
    rows: list[_Row] = []
    fault = None
    for at, value in enumerate(values):
        try:
            rows.append(_Row(Keys(file.source, value, "dexgraspnet", row=at), rows[0].joints if rows else None))
        except GraspsNotRead as refusal:
            fault = at, refusal.problem
            break
    if not rows:
        raise GraspsNotRead(file.source, fault[1] if fault else "", row=0)
    draft = Draft(
        poses=poses_from_sxyz(*_split(np.array([row.palm for row in rows]))),
        q=np.array([row.q for row in rows]),
        joint_names=rows[0].joints,
        scale=np.array([row.scale for row in rows]),
        object_name=file.path.stem,
        last=last,
    )
    if all(row.start is not None for row in rows):
        start = np.array([row.start for row in rows])
        draft.extras = {"start_poses": poses_from_sxyz(*_split(start[:, :6])), "start_q": start[:, 6:]}
    for name in rows[0].others:
        array = stacked([row.others.get(name) for row in rows], file.source)
        if array is not None:
            (draft.extras if array.ndim > 1 else draft.labels)[name] = array
    if fault is not None:  # one more row, which is refused after those before it
        draft.last = None
        yield from _with_fault(draft, fault[1])
    else:
        yield draft


def _with_fault(draft: Draft, problem: str) -> Iterator[Draft]:
    for name in ("poses", "q", "scale"):
        array = getattr(draft, name)
        setattr(draft, name, np.concatenate([array, array[-1:]]))
    for table in (draft.labels, draft.extras):
        table.update({name: np.concatenate([array, array[-1:]]) for name, array in table.items()})
    draft.fault = len(draft.poses) - 1, problem
    yield draft


def _split(palm: Array) -> tuple[Array, Array]:
    return palm[:, :3], palm[:, 3:6]


class _Row:
    """One grasp: the palm's place and angles, the joints, the scale, and further numbers."""

    def __init__(self, keys: Keys, joints: tuple[str, ...] | None):
        keys.need(["qpos", "scale"])
        self.scale = keys.number("scale")
        self.palm, self.q, self.joints = _posture(keys.inner("qpos"), joints)
        self.start: list[float] | None = None
        if "qpos_st" in keys:
            palm, q, _ = _posture(keys.inner("qpos_st"), self.joints)
            self.start = palm + q
        taken = ("qpos", "qpos_st", "scale")
        self.others = {
            name: array
            for name, value in keys.values.items()
            if isinstance(name, str) and name not in taken and not isinstance(value, list | tuple)
            if (array := as_numbers(value)) is not None
        }


def _posture(keys: Keys, joints: tuple[str, ...] | None) -> tuple[list[float], list[float], tuple[str, ...]]:
    keys.need((*_PLACE, *_ANGLES))
    names = tuple(name for name in keys.values if name not in _PLACE and name not in _ANGLES)
    if joints is None:
        names = keys.names(names)
    else:
        if set(names) != set(joints):
            odd = ", ".join(sorted(shown(name) for name in set(names) ^ set(joints))[:4])
            raise keys.refusal(f"expected the names of joints of the rows before, which differ by {odd}")
        names = joints
    return [keys.number(name) for name in (*_PLACE, *_ANGLES)], [keys.number(name) for name in names], names


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps, with the payload's numbers in each row's dict."""
    out = []
    angles = sxyz_from_poses(rows.poses)
    start = rows.extras.get("start_poses"), rows.extras.get("start_q")
    start_angles = None if start[0] is None else sxyz_from_poses(np.asarray(start[0]))
    extras = {name: array for name, array in payload.extras.items() if name not in _START}
    for i in range(rows.n):
        row: dict[str, Any] = {
            "scale": float(rows.scale[i]),
            "qpos": _qpos(rows.joint_names, rows.poses[i], angles[i], rows.q[i]),
        }
        if start_angles is not None and start[1] is not None:
            row["qpos_st"] = _qpos(rows.joint_names, start[0][i], start_angles[i], start[1][i])  # type: ignore[index]
        labels = {name: array[i].item() for name, array in payload.labels.items()}
        out.append({**labels, **{name: np.array(array[i]) for name, array in extras.items()}, **payload.texts, **row})
    return npy_of(out)


def _qpos(joints: tuple[str, ...], pose: Array, angles: Array, q: Array) -> dict[str, float]:
    values = (*q.tolist(), *angles.tolist(), *pose[:3, 3].tolist())
    return dict(zip((*joints, *_ANGLES, *_PLACE), values))
