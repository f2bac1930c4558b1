"""GraspQP: a PyTorch file (``.dexgrasp.pt``) of one dict of tensors.

Layout as of ``scripts/fit.py`` of leggedrobotics/graspqp: ``parameters`` with ``root_pose`` (N, 7) = x y z [m] and w
x y z of the URDF's root link in the object's frame, and each joint by its name (N,); ``values`` (N,) energies;
``grasp_velocities`` and alike, {joint: (N,)}; ``grasp_type``, ``contact_links``. The object's scale is not in the
file: its meshes have their size.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload, by_joint
from pinograsp.data.keys import Keys, as_numbers, stack
from pinograsp.data.pickled import PickleRefused
from pinograsp.data.rotations import poses_from_wxyz, wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.data.torch_file import read_torch, write_torch
from pinograsp.errors import GraspsNotRead, InvalidInput

_SUFFIX = ".dexgrasp"
_ROOT = "root_pose"


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    try:
        value = read_torch(file.content)
    except PickleRefused as refusal:
        raise GraspsNotRead(file.source, f"graspqp: {refusal}") from None
    keys = Keys(file.source, value, "graspqp")
    parameters = keys.inner("parameters")
    root = parameters.array(_ROOT, (None, 7))
    count = len(root)
    joints = parameters.names(name for name in parameters.values if name != _ROOT)
    poses, bad = poses_from_wxyz(root)
    labels, extras = keys.leftovers((), count)
    for name, inner in keys.values.items():
        if name != "parameters" and isinstance(inner, dict) and set(inner) == set(joints) and joints:
            array = stack([as_numbers(inner[joint]) for joint in joints], file.source)
            if array is not None and array.shape == (len(joints), count):
                extras[str(name)] = array.T
    stack([root[:, 0]] * len(joints), file.source)  # how large they would be
    columns = [parameters.array(joint, (count,)) for joint in joints]
    draft = Draft(
        poses=poses,
        q=np.stack(columns, axis=1) if columns else np.zeros((count, 0)),
        joint_names=joints,
        scale=np.ones(count),
        object_name=file.path.stem.removesuffix(_SUFFIX),
        labels=labels,
        extras=extras,
    )
    draft.refuse(bad, "'root_pose': expected unit quaternions w x y z after x y z")
    yield draft


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; ``torch.load`` reads it, also with ``weights_only=True``."""
    if not np.allclose(rows.scale, 1):
        raise InvalidInput(
            f"format: graspqp has no scale of the object, got {rows.scale[0]:g}: scale its mesh, and give 1"
        )
    out: dict[str, Any] = {name: np.array(array) for name, array in payload.labels.items()}
    for name, array in payload.extras.items():
        by_joint = array.shape == rows.q.shape and "velocities" in name
        out[name] = dict(zip(rows.joint_names, np.array(array).T)) if by_joint else np.array(array)
    out["parameters"] = {**dict(zip(rows.joint_names, np.array(rows.q).T)), _ROOT: wxyz_from_poses(rows.poses)}
    return write_torch({**out, **payload.texts})


FORMAT = Format(
    name="graspqp",
    container="a ZIP archive",
    sniff=lambda file: any(name.endswith("/data.pkl") for name in file.members),
    read=read,
    write=write,
    keys=("parameters",),
    named=True,
    convention=by_joint(
        {
            "robot0_FFJ3": "shadow_graspqp",
            "index_joint_0": "allegro_graspqp",
            "panda_finger_joint1": "panda_graspqp",
        }
    ),
)
