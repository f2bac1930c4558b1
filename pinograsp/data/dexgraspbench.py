"""DexGraspBench and Dexonomy: an .npy file of one dict with one grasp, of a hand whose description is MJCF.

Layout as of ``src/task/convert_format.py`` and ``src/util/hand_util.py`` of JYChen18/DexGraspBench, and of
``dexonomy/op/gen_init.py`` and ``gen_grasp.py`` of JYChen18/Dexonomy: ``grasp_qpos`` and alike [7 + d] are x y z [m]
and w x y z of a free joint, that of the MJCF file's world (which is no body of the hand: Shadow's palm is 34 mm
farther, the palms of Allegro and LEAP are turned), and the joints in the order of the MJCF file, which no key names.
Dexonomy has k pregrasps, the farthest first, of which the record has that one; contacts are in the world: points and
normals.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pinograsp.data.files import File
from pinograsp.data.keys import Keys, as_numbers
from pinograsp.data.rotations import poses_from_wxyz, wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.data.written import Payload, npy_of
from pinograsp.spatial import Array

_STEPS = {"pregrasp_": "pregrasp_qpos", "": "grasp_qpos", "squeeze_": "squeeze_qpos"}
_TAKEN = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos", "obj_pose", "obj_scale", "obj_path", "scene_path", "hand_name")
_CONTACT = "ho_c/"


def read(file: File) -> Iterator[Draft]:
    """The grasp of a file of DexGraspBench's."""
    keys = Keys(file.source, file.pickled[0], "dexgraspbench")
    keys.need([*_STEPS.values(), "obj_pose", "obj_scale", "obj_path"])
    draft = _grasp(keys, {name: keys.array(name, (None,)) for name in _STEPS.values()})
    draft.object_name = keys.text("obj_path")
    if "approach_qpos" in keys:
        draft.extras["approach_qpos"] = keys.array("approach_qpos", (None, None))[None]
    yield draft


def read_dexonomy(file: File) -> Iterator[Draft]:
    """The grasp of a file of Dexonomy's."""
    keys = Keys(file.source, file.pickled[0], "dexonomy")
    keys.need(["hand_name", "grasp_qpos", "obj_pose", "obj_scale", "scene_path"])
    steps = {name: keys.array(name, (None, None)) for name in _STEPS.values() if name in keys}
    if len(steps["grasp_qpos"]) != 1 or any(not len(one) for one in steps.values()):
        raise keys.refusal(f"'grasp_qpos': expected one grasp, got {len(steps['grasp_qpos'])}")
    draft = _grasp(keys, {name: values[0] for name, values in steps.items()})
    draft.object_name, draft.hand_name = keys.text("scene_path"), keys.text("hand_name")
    if len(steps.get("pregrasp_qpos", ())) > 1:
        draft.extras["pregrasp_qpos"] = steps["pregrasp_qpos"][None]
    if "ho_c" in keys:
        for name, value in keys.inner("ho_c").values.items():
            if isinstance(name, str) and (array := as_numbers(value)) is not None:
                draft.extras[f"{_CONTACT}{name}"] = array[None]
    yield draft


def _grasp(keys: Keys, steps: dict[str, Array]) -> Draft:
    """One grasp from its steps (7 + d,), and the file's other numbers."""
    width = len(steps["grasp_qpos"])
    draft = Draft(
        poses=np.zeros((1, 4, 4)), q=np.zeros((1, 0)), scale=np.array([keys.scale("obj_scale")]), in_world=True
    )
    for prefix, name in _STEPS.items():
        if name not in steps:
            continue
        values = steps[name][None]
        if values.shape[1] != width or width < 7:
            raise keys.refusal(
                f"'{name}': expected 7 + d numbers, as many as in 'grasp_qpos' ({width}), got {len(values[0])}"
            )
        poses, bad = poses_from_wxyz(values[:, :7])
        draft.refuse(bad, f"'{name}': expected a unit quaternion w x y z after x y z: of a hand without an arm")
        setattr(draft, f"{prefix}poses", poses)
        setattr(draft, f"{prefix}q", values[:, 7:])
    pose, bad = poses_from_wxyz(keys.array("obj_pose", (7,)))
    if bad or not np.isfinite(pose).all():
        raise keys.refusal("'obj_pose': expected x y z and a unit quaternion w x y z")
    draft.object_pose = pose
    for name, value in keys.values.items():
        if isinstance(name, str) and name not in _TAKEN and (array := as_numbers(value)) is not None:
            if array.shape in ((), (1,)):
                draft.labels[name] = array.reshape(1)
            else:
                draft.extras[name] = array[None]
    return draft


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of one grasp, as DexGraspBench has it."""
    steps = _steps(rows)
    return npy_of(
        {
            **_numbers(payload),
            "obj_pose": _object_pose(rows),
            "obj_scale": float(rows.scale[0]),
            "obj_path": rows.object_name,
            **steps,
        }
    )


def write_dexonomy(rows: GraspRows, payload: Payload) -> bytes:
    """The file of one grasp, as Dexonomy has it."""
    numbers = _numbers(payload)
    contacts = {name[len(_CONTACT) :]: numbers.pop(name) for name in list(numbers) if name.startswith(_CONTACT)}
    steps = {name: values[None] for name, values in _steps(rows, all_of_them=False).items()}
    if "pregrasp_qpos" in numbers:
        steps["pregrasp_qpos"] = numbers.pop("pregrasp_qpos")
    return npy_of(
        {
            "hand_name": rows.hand_name,
            "obj_pose": _object_pose(rows),
            "obj_scale": float(rows.scale[0]),
            "scene_path": rows.object_name,
            **steps,
            **({"ho_c": contacts} if contacts else {}),
            **numbers,
        }
    )


def _object_pose(rows: GraspRows) -> Array:
    return wxyz_from_poses(np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose))


def _numbers(payload: Payload) -> dict[str, Any]:
    labels = {name: array[0] for name, array in payload.labels.items()}
    return {**labels, **{name: np.array(array[0]) for name, array in payload.extras.items()}, **payload.texts}


def _steps(rows: GraspRows, all_of_them: bool = True) -> dict[str, Array]:
    world = np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose)
    steps = {}
    for prefix, name in _STEPS.items():
        poses, q = getattr(rows, f"{prefix}poses"), getattr(rows, f"{prefix}q")
        if poses is None and q is None and not all_of_them:
            continue
        poses, q = rows.poses if poses is None else poses, rows.q if q is None else q
        steps[name] = np.concatenate([wxyz_from_poses(world @ poses[0]), q[0]])
    return steps
