"""What files of postures in the object's world share: a free root and joints, before, at and after the grasp."""

from __future__ import annotations

import numpy as np

from pinograsp.data.keys import Keys
from pinograsp.data.rotations import poses_from_wxyz, wxyz_from_poses
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.spatial import Array

PREFIXES = ("pregrasp_", "", "squeeze_")  # of the fields of :class:`~pinograsp.data.rows.GraspRows`


def put_posture(draft: Draft, prefix: str, values: Array, problem: str) -> None:
    """Values (N, 7 + d), x y z [m], w x y z and joints, as a posture of a draft; ``problem``: of other quaternions."""
    poses, bad = poses_from_wxyz(values[:, :7])
    draft.refuse(bad, problem)
    setattr(draft, f"{prefix}poses", poses)
    setattr(draft, f"{prefix}q", values[:, 7:])


def world_pose(keys: Keys, name: str) -> Array:
    """Where the object is in the world (4, 4)."""
    pose, bad = poses_from_wxyz(keys.array(name, (7,)))
    if bad or not np.isfinite(pose).all():
        raise keys.refusal(f"'{name}': expected x y z and a unit quaternion w x y z")
    return pose


def world_of(rows: GraspRows) -> Array:
    """The object in the world (4, 4); in its own frame, where the rows have no world."""
    return np.eye(4) if rows.object_pose is None else np.asarray(rows.object_pose)


def postures(rows: GraspRows, *, fill: bool = True) -> dict[str, Array]:
    """The postures (N, 7 + d) by prefix, in the world; ``fill``: that of the grasp where there is none."""
    found = {}
    for prefix in PREFIXES:
        poses, q = getattr(rows, f"{prefix}poses"), getattr(rows, f"{prefix}q")
        if fill or poses is not None or q is not None:
            poses, q = rows.poses if poses is None else poses, rows.q if q is None else q
            found[prefix] = np.concatenate([wxyz_from_poses(world_of(rows) @ poses), q], axis=1)
    return found
