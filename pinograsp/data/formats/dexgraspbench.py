"""DexGraspBench: an .npy file of one dict with one grasp, of a hand whose description is MJCF.

Layout as of ``src/task/convert_format.py`` and ``src/util/hand_util.py`` of JYChen18/DexGraspBench: ``grasp_qpos`` and
alike [7 + d] are x y z [m] and w x y z of a free joint, that of the MJCF file's world (which is no body of the hand:
Shadow's palm is 34 mm farther, the palms of Allegro and LEAP are turned), and the joints in the order of the MJCF file,
which no key names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload, npy_bytes
from pinograsp.data.keys import Keys, as_numbers
from pinograsp.data.postures import PREFIXES, postures, put_posture, world_of, world_pose
from pinograsp.data.rotations import wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.spatial import Array

STEPS = {prefix: f"{prefix or 'grasp_'}qpos" for prefix in PREFIXES}
_TAKEN = (*STEPS.values(), "obj_pose", "obj_scale", "obj_path", "scene_path", "hand_name")


def read(file: File) -> Iterator[Draft]:
    """The grasp of a file."""
    keys = file.keys("dexgraspbench")
    keys.need([*STEPS.values(), "obj_pose", "obj_scale", "obj_path"])
    draft = read_one(keys, {name: keys.array(name, (None,)) for name in STEPS.values()})
    draft.object_name = keys.text("obj_path")
    if "approach_qpos" in keys:
        draft.extras["approach_qpos"] = keys.array("approach_qpos", (None, None))[None]
    yield draft


def read_one(keys: Keys, steps: Mapping[str, Array]) -> Draft:
    """One grasp from its steps (7 + d,), and the file's other numbers."""
    width = len(steps["grasp_qpos"])
    draft = Draft(
        poses=np.zeros((1, 4, 4)), q=np.zeros((1, 0)), scale=np.array([keys.scale("obj_scale")]), in_world=True
    )
    for prefix, name in STEPS.items():
        if name not in steps:
            continue
        if len(steps[name]) != width or width < 7:
            raise keys.refusal(
                f"'{name}': expected 7 + d numbers, as many as in 'grasp_qpos' ({width}), got {len(steps[name])}"
            )
        problem = f"'{name}': expected a unit quaternion w x y z after x y z: of a hand without an arm"
        put_posture(draft, prefix, steps[name][None], problem)
    draft.object_pose = world_pose(keys, "obj_pose")
    for name, value in keys.values.items():
        if isinstance(name, str) and name not in _TAKEN and (array := as_numbers(value)) is not None:
            if array.shape in ((), (1,)):
                draft.labels[name] = array.reshape(1)
            else:
                draft.extras[name] = array[None]
    return draft


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of one grasp."""
    steps = {STEPS[prefix]: values[0] for prefix, values in postures(rows).items()}
    return npy_bytes({**first_numbers(payload), **about_object(rows), "obj_path": rows.object_name, **steps})


def about_object(rows: GraspRows) -> dict[str, Any]:
    """Where the object is, and its size."""
    return {"obj_pose": wxyz_from_poses(world_of(rows)), "obj_scale": float(rows.scale[0])}


def first_numbers(payload: Payload) -> dict[str, Any]:
    """The numbers of the one grasp."""
    labels = {name: array[0] for name, array in payload.labels.items()}
    return {**labels, **{name: np.array(array[0]) for name, array in payload.extras.items()}, **payload.texts}


FORMAT = Format(
    name="dexgraspbench",
    container="an .npy file",
    sniff=lambda file: file.has("grasp_qpos") and not file.has("hand_name"),
    read=read,
    write=write,
    keys=_TAKEN,
    single=True,
    convention=lambda rows: "shadow_mjcf" if rows.q.shape[1] == 22 else None,  # 16: Allegro or LEAP
    ask="convention='allegro_mjcf' or 'leap_mjcf', which files of DexGraspBench do not distinguish",
)
