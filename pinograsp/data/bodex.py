"""BODex: an .npy file of one dict, with n grasps in a first dimension of length 1.

Layout as of ``src/curobo/util/save_helper.py`` and ``example_grasp/plan_batch_env.py`` of JYChen18/BODex:
``robot_pose`` [1, n, 3, 7 + d] (pregrasp, grasp, squeeze; x y z [m] and w x y z of the URDF's base link in the world,
then the joints of ``joint_names``, in the order of the URDF's tree); ``world_cfg`` with the object's pose in the
world (x y z, w x y z) and its scale under ``mesh``, by the name in ``manip_name``; ``contact_point``,
``contact_frame``, ``contact_force`` (without a unit). With an arm (``plan_mogen_batch.py``) there are joints alone,
and the last four are pregrasp, grasp, squeeze, lift.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pinograsp.data.files import File
from pinograsp.data.keys import Keys
from pinograsp.data.rotations import poses_from_wxyz, wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.data.written import Payload, npy_of
from pinograsp.spatial import Array

_TAKEN = ("robot_pose", "joint_names", "world_cfg", "manip_name", "scene_path")


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    keys = Keys(file.source, file.pickled[0], "bodex")
    keys.need(["robot_pose", "joint_names", "world_cfg", "manip_name"])
    joints = keys.texts("joint_names")
    robot = keys.array("robot_pose", (1, None, None, None))[0]
    count, steps, width = robot.shape
    arm = width == len(joints)
    if width not in (7 + len(joints), len(joints)) or (steps != 3 and not (arm and steps > 3)):
        raise keys.refusal(
            f"'robot_pose': expected [1, n, 3, 7 + {len(joints)}] for the {len(joints)} joints named, got "
            f"{(1, *robot.shape)}: middle results and motions of a free hand are not read"
        )
    draft = Draft(
        poses=np.zeros((count, 4, 4)), q=np.zeros((count, 0)), scale=np.zeros(count), joint_names=joints, in_world=True
    )
    for prefix, step in zip(("pregrasp_", "", "squeeze_"), range(-4, -1) if steps > 3 else range(3)):
        values = robot[:, step]
        poses, bad = (np.tile(np.eye(4), (count, 1, 1)), None) if arm else poses_from_wxyz(values[:, :7])
        if bad is not None:
            draft.refuse(bad, "'robot_pose': expected unit quaternions w x y z after x y z")
        setattr(draft, f"{prefix}poses", poses)
        setattr(draft, f"{prefix}q", values[:, 0 if arm else 7 :])
    draft.object_pose, scale, draft.object_name = _object(keys, file)
    draft.scale = np.full(count, scale)
    inner = {name: _first(value, count) for name, value in keys.values.items() if name not in _TAKEN}
    draft.labels, draft.extras = Keys(file.source, inner, "bodex").leftovers((), count)
    yield draft


def _first(value: Any, count: int) -> Any:
    return value[0] if isinstance(value, np.ndarray) and value.shape[:2] == (1, count) else value


def _object(keys: Keys, file: File) -> tuple[Array, float, str]:
    """The object's pose in the world (4, 4), its scale and its file."""
    worlds, name = keys.get("world_cfg"), keys.text("manip_name")
    world = worlds[0] if isinstance(worlds, list | tuple | np.ndarray) and len(worlds) else worlds
    meshes = Keys(file.source, world, "bodex", "world_cfg").inner("mesh")
    mesh = meshes.inner(name)
    pose, bad = poses_from_wxyz(mesh.array("pose", (7,)))
    if bad or not np.isfinite(pose).all():
        raise mesh.refusal("'pose': expected x y z and a unit quaternion w x y z")
    return pose, mesh.scale("scale"), mesh.text("file_path") if "file_path" in mesh else name


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; ``contact_force`` has the shape [1, n, 1, p, 3] that BODex gives it."""
    object_pose = np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose)
    steps = []
    for prefix in ("pregrasp_", "", "squeeze_"):
        poses, q = getattr(rows, f"{prefix}poses"), getattr(rows, f"{prefix}q")
        poses, q = rows.poses if poses is None else poses, rows.q if q is None else q
        steps.append(np.concatenate([wxyz_from_poses(object_pose @ poses), q], axis=1))
    extras = {name: np.array(array)[None] for name, array in payload.extras.items()}
    if payload.texts:
        extras["contact_force"] = extras["contact_force"][:, :, None]
    mesh = {
        "pose": wxyz_from_poses(object_pose).tolist(),
        "scale": [float(rows.scale[0])] * 3,
        "file_path": rows.object_name,
    }
    return npy_of(
        {
            **{name: np.array(array)[None] for name, array in payload.labels.items()},
            **extras,
            **payload.texts,
            "robot_pose": np.stack(steps, axis=1)[None],
            "joint_names": list(rows.joint_names),
            "world_cfg": [{"mesh": {"object": mesh}}],
            "manip_name": ["object"],
            "scene_path": [""],
        }
    )
