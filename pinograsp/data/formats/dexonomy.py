"""Dexonomy: an .npy file of one dict with one grasp, as DexGraspBench has it (see there), with its hand's name.

Layout as of ``dexonomy/op/gen_init.py`` and ``gen_grasp.py`` of JYChen18/Dexonomy: k pregrasps, the farthest first, of
which the record has that one; contacts are in the world: points and normals.
"""

from __future__ import annotations

from collections.abc import Iterator

from pinograsp.data.files import File
from pinograsp.data.format import Format, Payload, npy_bytes
from pinograsp.data.formats.dexgraspbench import STEPS, about_object, first_numbers, read_one
from pinograsp.data.keys import as_numbers
from pinograsp.data.postures import postures
from pinograsp.data.rows import Draft, GraspRows

_CONTACT = "ho_c/"
_CONVENTIONS = {"shadow": "shadow_mjcf", "allegro": "allegro_mjcf", "leap": "leap_mjcf"}


def read(file: File) -> Iterator[Draft]:
    """The grasp of a file."""
    keys = file.keys("dexonomy")
    keys.need(["hand_name", "grasp_qpos", "obj_pose", "obj_scale", "scene_path"])
    steps = {name: keys.array(name, (None, None)) for name in STEPS.values() if name in keys}
    if len(steps["grasp_qpos"]) != 1 or any(not len(one) for one in steps.values()):
        raise keys.refusal(f"'grasp_qpos': expected one grasp, got {len(steps['grasp_qpos'])}")
    draft = read_one(keys, {name: values[0] for name, values in steps.items()})
    draft.object_name, draft.hand_name = keys.text("scene_path"), keys.text("hand_name")
    if len(steps.get("pregrasp_qpos", ())) > 1:
        draft.extras["pregrasp_qpos"] = steps["pregrasp_qpos"][None]
    if "ho_c" in keys:
        for name, value in keys.inner("ho_c").values.items():
            if isinstance(name, str) and (array := as_numbers(value)) is not None:
                draft.extras[f"{_CONTACT}{name}"] = array[None]
    yield draft


def write(rows: GraspRows, payload: Payload) -> bytes:
    """The file of one grasp."""
    numbers = first_numbers(payload)
    contacts = {name[len(_CONTACT) :]: numbers.pop(name) for name in list(numbers) if name.startswith(_CONTACT)}
    steps = {STEPS[prefix]: values for prefix, values in postures(rows, fill=False).items()}
    if "pregrasp_qpos" in numbers:
        steps["pregrasp_qpos"] = numbers.pop("pregrasp_qpos")
    return npy_bytes(
        {
            "hand_name": rows.hand_name,
            **about_object(rows),
            "scene_path": rows.object_name,
            **steps,
            **({"ho_c": contacts} if contacts else {}),
            **numbers,
        }
    )


FORMAT = Format(
    name="dexonomy",
    container="an .npy file",
    sniff=lambda file: file.has("grasp_qpos") and file.has("hand_name"),
    read=read,
    write=write,
    keys=("hand_name", "scene_path", "ho_c"),
    single=True,
    convention=lambda rows: _CONVENTIONS.get(rows.hand_name),
)
