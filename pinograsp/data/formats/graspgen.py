"""GraspGen: a JSON file of one mapping.

Layout as of ``docs/GRASP_DATASET_FORMAT.md`` of NVlabs/GraspGen: ``object`` {``file``, ``scale``}, ``grasps``
{``transforms`` (N, 4, 4) of the gripper's base link in the object's frame (fingers close along x, and reach along z),
``object_in_gripper`` (N,)}. The published data set (PhysicalAI-Robotics-GraspGen) has no ``file``: its files are called
after the object; and a column (N, 1). The gripper is not named in the file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from pinograsp.checks import one_line
from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload
from pinograsp.data.keys import Keys, as_numbers
from pinograsp.data.rows import Draft, GraspRows
from pinograsp.errors import GraspsNotRead
from pinograsp.plain import plain_json

_GRASPS = ("transforms", "object_in_gripper")
_DEEPEST = 40  # lists and mappings within each other


def read(file: File) -> Iterator[Draft]:
    """The grasps of a file."""
    try:
        value = plain_json(file.text, _DEEPEST)
    except ValueError as error:
        raise GraspsNotRead(file.source, f"graspgen: the JSON is broken or cut off ({one_line(error)})") from error
    keys = Keys(file.source, value, "graspgen")
    keys.need(["object", "grasps"])
    about, grasps = keys.inner("object"), keys.inner("grasps")
    about.need(["scale"])
    grasps.need(_GRASPS)
    transforms = grasps.get("transforms")
    if not isinstance(transforms, list):
        raise grasps.refusal("'transforms': expected a list of 4 x 4 matrices")
    matrices = [as_numbers(one) for one in transforms]
    good = [one is not None and one.shape == (4, 4) for one in matrices]
    success = grasps.any_array("object_in_gripper")
    if success.size != len(transforms) or success.shape[:1] != (len(transforms),):
        raise grasps.refusal(f"'object_in_gripper': expected {len(transforms)} truth values, got {success.shape}")
    labels, extras = grasps.leftovers(_GRASPS, len(transforms))
    draft = Draft(
        poses=np.array(
            [one if is_good else np.full((4, 4), np.nan) for one, is_good in zip(matrices, good)], dtype=float
        ).reshape(-1, 4, 4),
        q=np.zeros((len(transforms), 0)),
        scale=np.full(len(transforms), about.number("scale")),
        object_name=about.text("file") if "file" in about else "",
        hand_name=keys.inner("gripper").text("name") if "gripper" in keys else "",
        labels={"object_in_gripper": success.reshape(-1) != 0, **labels},
        extras=extras,
    )
    draft.refuse(~np.array(good, dtype=bool), "'grasps/transforms': expected a 4 x 4 matrix of numbers")
    yield draft


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of these grasps; the hand's name stands under ``gripper``, where there is one."""
    labels = dict(payload.labels)
    success = labels.pop("object_in_gripper", np.ones(rows.n, dtype=bool))
    document: dict[str, Any] = {
        "object": {
            **({"file": rows.object_name} if rows.object_name else {}),
            "scale": float(rows.scale[0]) if rows.n else 1.0,
        },
        "grasps": {
            **{name: array.tolist() for table in (labels, payload.extras) for name, array in table.items()},
            **payload.texts,
            "transforms": rows.poses.tolist(),
            "object_in_gripper": (success != 0).tolist(),
        },
    }
    if rows.hand_name:
        document["gripper"] = {"name": rows.hand_name}
    return (json.dumps(document, allow_nan=False) + "\n").encode("utf-8")


FORMAT = Format(
    name="graspgen",
    container="text",
    sniff=lambda file: file.head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"),
    read=read,
    write=write,
    keys=("transforms",),
    ask="convention='panda_graspgen' if the grasps are for it",
)
