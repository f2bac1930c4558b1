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
from pinograsp.data.format import Format, Payload, by_joint, npy_bytes
from pinograsp.data.keys import Keys
from pinograsp.data.postures import PREFIXES, postures, put_posture, world_of, world_pose
from pinograsp.data.rotations import wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.spatial import Array

_TAKEN = ("robot_pose", "joint_names", "world_cfg", "manip_name", "scene_path")


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    keys = file.keys("bodex")
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
    if arm:  # the root stays
        robot = np.concatenate([np.broadcast_to([0, 0, 0, 1.0, 0, 0, 0], (count, steps, 7)), robot], axis=2)
    draft = Draft(
        poses=np.zeros((count, 4, 4)), q=np.zeros((count, 0)), scale=np.zeros(count), joint_names=joints, in_world=True
    )
    for prefix, step in zip(PREFIXES, range(-4, -1) if steps > 3 else range(3)):
        put_posture(draft, prefix, robot[:, step], "'robot_pose': expected unit quaternions w x y z after x y z")
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
    pose = world_pose(mesh, "pose")
    return pose, mesh.scale("scale"), mesh.text("file_path") if "file_path" in mesh else name


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; ``contact_force`` has the shape [1, n, 1, p, 3] that BODex gives it."""
    extras = {name: np.array(array)[None] for name, array in payload.extras.items()}
    if payload.texts:
        extras["contact_force"] = extras["contact_force"][:, :, None]
    mesh = {
        "pose": wxyz_from_poses(world_of(rows)).tolist(),
        "scale": [float(rows.scale[0])] * 3,
        "file_path": rows.object_name,
    }
    return npy_bytes(
        {
            **{name: np.array(array)[None] for name, array in payload.labels.items()},
            **extras,
            **payload.texts,
            "robot_pose": np.stack(list(postures(rows).values()), axis=1)[None],
            "joint_names": list(rows.joint_names),
            "world_cfg": [{"mesh": {"object": mesh}}],
            "manip_name": ["object"],
            "scene_path": [""],
        }
    )


FORMAT = Format(
    name="bodex",
    container="an .npy file",
    sniff=lambda file: file.has("robot_pose") and not file.has("grasp_qpos"),
    read=read,
    write=write,
    keys=_TAKEN,
    named=True,
    convention=by_joint({"rh_FFJ4": "shadow_palm", "joint_0.0": "allegro_palm", "j0": "leap_base"}),
)
