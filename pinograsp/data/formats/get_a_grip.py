"""get_a_grip: an .npy file of one dict of arrays (B, ...), called after the object's code and scale.

Layout as of ``docs/download.md`` and ``allegro_grasp_config.py`` of tylerlum/get_a_grip: ``trans`` (B, 3) [m] and
``rot`` (B, 3, 3) of the URDF's palm in the object's frame, whose y is up; ``joint_angles`` (B, 16) [rad], those of an
Allegro hand in the order joint_0.0 to joint_15.0; ``grasp_orientations`` (B, fingers, 3, 3), along whose column 2 the
fingertips close; ``y_pick``, ``y_coll``, ``y_PGS`` (B,), ``loss``. The name of the file is ``CODE_0_0622.npy`` for a
scale of 0.0622.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload, by_joint, npy_bytes
from pinograsp.data.rotations import placements
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.errors import GraspsNotRead, InvalidInput

_TAKEN = ("trans", "rot", "joint_angles")
_NAME = re.compile(r"(.+)_(\d+)_(\d+)")
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])  # its y is the world's z


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    keys = file.keys("get_a_grip")
    keys.need(_TAKEN)
    trans = keys.array("trans", (None, 3))
    count = len(trans)
    if "object_scale" in keys:  # as written here
        code, scale = keys.text("object_code"), keys.number("object_scale")
    elif name := _NAME.fullmatch(file.path.stem):
        code, scale = name[1], float(f"{name[2][:9]}.{name[3][:9]}")
    else:
        raise GraspsNotRead(
            file.source,
            f"get_a_grip: expected a file called CODE_0_0622.npy for a scale of 0.0622, got '{file.path.name}'",
        )
    q = keys.array("joint_angles", (count, None))
    labels, extras = keys.leftovers((*_TAKEN, "object_scale"), count)
    yield Draft(
        poses=placements(trans, keys.array("rot", (count, 3, 3))),
        q=q,
        joint_names=tuple(f"joint_{i}.0" for i in range(16)) if q.shape[1] == 16 else (),
        scale=np.full(count, scale),
        object_name=code,
        object_pose=Y_UP,
        labels=labels,
        extras=extras,
    )


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; with the object's code and scale, as its name need not have them."""
    if not rows.q.shape[1]:
        raise InvalidInput(
            "format: get_a_grip holds joint angles of a hand, and these grasps have none: write graspgen"
        )
    return npy_bytes(
        {
            **{name: np.array(array) for table in (payload.labels, payload.extras) for name, array in table.items()},
            "trans": np.array(rows.poses[:, :3, 3]),
            "rot": np.array(rows.poses[:, :3, :3]),
            "joint_angles": np.array(rows.q),
            "object_code": rows.object_name,
            "object_scale": float(rows.scale[0]) if rows.n else 1.0,
            **payload.texts,
        }
    )


FORMAT = Format(
    name="get_a_grip",
    container="an .npy file",
    sniff=lambda file: file.has("joint_angles") and file.has("trans"),
    read=read,
    write=write,
    keys=(*_TAKEN, "object_code", "object_scale"),
    convention=by_joint({"joint_0.0": "allegro_palm"}),
)
