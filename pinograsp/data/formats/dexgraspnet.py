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

from pinograsp.checks import shorten
from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload, by_joint, npy_bytes
from pinograsp.data.keys import Keys, rows_to_fault
from pinograsp.data.rotations import poses_from_sxyz, sxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
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
    items = (Keys(file.source, value, "dexgraspnet", row=at) for at, value in enumerate(values))
    rows, fault = rows_to_fault(items, lambda keys, rows: _Row(keys, rows[0].joints if rows else None))
    if not rows:
        raise GraspsNotRead(file.source, fault or "", row=0)
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
    draft.put_tables([row.others for row in rows], file.source)
    draft.end(fault)
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
        self.others = keys.arrays(("qpos", "qpos_st", "scale"), lists=False)


def _posture(keys: Keys, joints: tuple[str, ...] | None) -> tuple[list[float], list[float], tuple[str, ...]]:
    keys.need((*_PLACE, *_ANGLES))
    names = tuple(name for name in keys.values if name not in _PLACE and name not in _ANGLES)
    if joints is None:
        names = keys.names(names)
    else:
        if set(names) != set(joints):
            odd = ", ".join(sorted(shorten(name) for name in set(names) ^ set(joints))[:4])
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
    return npy_bytes(out)


def _qpos(joints: tuple[str, ...], pose: Array, angles: Array, q: Array) -> dict[str, float]:
    values = (*q.tolist(), *angles.tolist(), *pose[:3, 3].tolist())
    return dict(zip((*joints, *_ANGLES, *_PLACE), values))


FORMAT = Format(
    name="dexgraspnet",
    container="an .npy file",
    sniff=lambda file: isinstance(file.pickled[0], list),
    read=read,
    write=write,
    keys=("qpos", "qpos_st", "scale"),
    named=True,
    scales=True,
    convention=by_joint({"robot0:FFJ3": "shadow_dexgraspnet", "joint_0.0": "allegro_palm"}),
)
