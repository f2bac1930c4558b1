"""Isaac grasp files: YAML.

Layout as of NVIDIA's documentation of Isaac Sim's Grasp Editor and of Isaac ROS, ``grasp_gen/dataset/eval_utils.py`` of
NVlabs/GraspGen and the documentation of NVlabs/GraspDataGen: ``format: isaac_grasp``, ``format_version: 1.0`` (or
``"1.0"``), and ``grasps`` {name: {``confidence``, ``position`` [m] and ``orientation`` {``w``, ``xyz``} of the
gripper's frame in the object's, ``cspace_position`` and ``pregrasp_cspace_position`` {joint: value}}}. What the
object is called stands under ``object_frame`` (``object_frame_link`` of the Grasp Editor), the gripper under
``gripper_frame``
(``gripper_frame_link``): remarks for people. GraspDataGen has ``object_file``, ``object_scale`` and ``gripper_file``
instead, and GraspGen's export neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

from pinograsp.checks import one_line
from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload
from pinograsp.data.keys import Keys, rows_to_fault
from pinograsp.data.rotations import poses_from_wxyz, wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.errors import GraspsNotRead
from pinograsp.plain import YamlValues
from pinograsp.spatial import Array

_OBJECT = ("object_file", "object_frame", "object_frame_link")  # the first that a file has
_GRIPPER = ("gripper_file", "gripper_frame", "gripper_frame_link")
_DEEPEST, _MOST = 10, 10**7  # mappings and lists within each other, and values
_TAKEN = ("position", "orientation", "cspace_position", "pregrasp_cspace_position")
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    value, problem = _document(file)
    if problem is not None and not (isinstance(value, dict) and value.get("grasps") and "format_version" in value):
        raise GraspsNotRead(file.source, problem)
    keys = Keys(file.source, value, "isaac")
    keys.need(["format", "format_version", "grasps"])
    if keys.get("format") != "isaac_grasp" or keys.get("format_version") not in (1.0, "1.0"):
        raise keys.refusal("expected format: isaac_grasp and format_version: 1.0")
    grasps = keys.inner("grasps")
    items = (
        Keys(file.source, grasps.get(name), "isaac", f"grasps/{name}", at) for at, name in enumerate(grasps.values)
    )
    rows, fault = rows_to_fault(items, lambda keys, rows: _IsaacRow(keys, rows[:1]))
    if not rows and (fault or problem):
        raise GraspsNotRead(file.source, fault or problem or "", row=0 if fault else None)
    yield _draft(rows, keys, fault, problem)


def _draft(rows: list[_IsaacRow], keys: Keys, fault: str | None, problem: str | None) -> Draft:
    poses, bad = poses_from_wxyz(np.array([row.pose for row in rows]).reshape(-1, 7))
    draft = Draft(
        poses=poses,
        q=np.array([row.q for row in rows], dtype=float).reshape(len(rows), -1 if rows else 0),
        joint_names=rows[0].joints if rows else (),
        scale=np.full(len(rows), keys.number("object_scale") if "object_scale" in keys else 1.0),
        object_name=_read_first(keys, _OBJECT),
        hand_name=_read_first(keys, _GRIPPER),
        last=problem,
    )
    if rows and rows[0].before is not None:
        draft.pregrasp_q = np.array([row.before for row in rows], dtype=float)
    draft.put_tables([row.others for row in rows], keys.source)
    draft.refuse(bad, "orientation: expected a unit quaternion w, xyz")
    draft.end(fault)
    return draft


def _read_first(keys: Keys, names: tuple[str, ...]) -> str:
    """What stands under the first of the names that is there, and is not null."""
    return next((keys.text(name) for name in names if keys.values.get(name) is not None), "")


class _IsaacRow:
    """One grasp, with the joints of the first one."""

    def __init__(self, keys: Keys, first: list[_IsaacRow]):
        keys.need(["position", "orientation"])
        orientation = keys.inner("orientation")
        orientation.need(["w", "xyz"])
        self.pose = np.concatenate(
            [keys.array("position", (3,)), [orientation.number("w")], orientation.array("xyz", (3,))]
        )
        joints: tuple[str, ...] | None = first[0].joints if first else None
        self.joints: tuple[str, ...]
        self.q, self.joints = _joints(keys, "cspace_position", joints)
        self.before: Array | None = None
        if "pregrasp_cspace_position" in keys:
            self.before = _joints(keys, "pregrasp_cspace_position", self.joints)[0]
        if first and (self.before is None) != (first[0].before is None):
            raise keys.refusal("expected 'pregrasp_cspace_position' in all grasps or in none")
        self.others = keys.arrays(_TAKEN)


def _joints(keys: Keys, name: str, joints: tuple[str, ...] | None) -> tuple[Array, tuple[str, ...]]:
    if name not in keys:
        if joints:
            raise keys.refusal(f"expected '{name}', as in the grasps before")
        return np.zeros(0), ()
    inner = keys.inner(name)
    names = inner.names(inner.values) if joints is None else joints
    if set(names) != set(inner.values):
        raise inner.refusal("expected the same names of joints in all grasps")
    return np.array([inner.number(one) for one in names]), names


# -- YAML


def _document(file: File) -> tuple[Any, str | None]:
    """Plain data, as far as the file goes, and what is wrong after it."""
    try:
        text = file.text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise GraspsNotRead(file.source, f"isaac: expected YAML in UTF-8 ({one_line(error)})") from error
    values, problem = YamlValues(text, _DEEPEST, _MOST), None
    try:
        values.run()
    except (yaml.YAMLError, ValueError) as error:
        problem = f"isaac: the YAML is broken or cut off ({one_line(error)})"
    if len(values.documents) > 1:
        problem = "isaac: expected one document of YAML"
    return values.documents[0] if values.documents else None, problem


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps."""
    labels = dict(payload.labels)
    confidence = labels.pop("confidence", np.ones(rows.n))
    values = wxyz_from_poses(rows.poses)
    grasps: dict[str, Any] = {}
    for i in range(rows.n):
        grasp: dict[str, Any] = {
            "confidence": float(confidence[i]),
            "position": values[i, :3].tolist(),
            "orientation": {"w": float(values[i, 3]), "xyz": values[i, 4:].tolist()},
        }
        if rows.joint_names:
            grasp["cspace_position"] = dict(zip(rows.joint_names, rows.q[i].tolist()))
        if rows.joint_names and rows.pregrasp_q is not None:
            grasp["pregrasp_cspace_position"] = dict(zip(rows.joint_names, rows.pregrasp_q[i].tolist()))
        for table in (labels, payload.extras):
            grasp = {**{name: array[i].tolist() for name, array in table.items()}, **grasp}
        grasps[f"grasp_{rows.first + i}"] = grasp
    document = {
        "format": "isaac_grasp",
        "format_version": 1.0,
        "object_frame": rows.object_name,
        "gripper_frame": rows.hand_name,
        **({} if not rows.n or rows.scale[0] == 1 else {"object_scale": float(rows.scale[0])}),
        **payload.texts,
        "grasps": grasps,
    }
    content: bytes = yaml.dump(document, Dumper=_DUMPER, sort_keys=False, encoding="utf-8", default_flow_style=None)
    return content


FORMAT = Format(
    name="isaac",
    container="text",
    sniff=lambda file: not file.head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"),
    read=read,
    write=write,
    keys=_TAKEN,
)
