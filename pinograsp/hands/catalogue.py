"""Hands that need no file from the user: the paper's, and all hands and grippers in ``example-robot-data``."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pinograsp.errors import HandNotLoaded


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Where a hand is described: ``file`` below the robots of ``example-robot-data``, or shipped with this package.

    Attributes:
        title: what it is, in words.
        shipped: whether ``file`` comes with this package.
        root: link whose sub-tree is the hand.
        palm, fingers: as :func:`~pinograsp.hands.load.load_hand` takes them, where the tree alone does not tell.
    """

    file: str
    title: str
    shipped: bool = False
    root: str | None = None
    palm: str | None = None
    fingers: dict[str, str] | None = field(default=None)


def _sides(entries: Callable[[str], dict[str, Entry]]) -> dict[str, Entry]:
    return {name: entry for side in ("left", "right") for name, entry in entries(side).items()}


_HEY5 = {
    finger: f"hand_{finger}_flex_{2 if finger == 'thumb' else 3}_link"
    for finger in ("thumb", "index", "middle", "ring", "little")
}

_ALLEGRO = {finger: f"link_{4 * i + 3}.0_tip" for i, finger in enumerate(("index", "middle", "ring", "thumb"))}

CATALOGUE: dict[str, Entry] = {
    "humanoid": Entry(file="humanoid_hand.urdf", title="the paper's humanoid hand", shipped=True),
    **_sides(
        lambda side: {
            f"allegro_{side}": Entry(
                file=f"allegro_hand_description/urdf/allegro_{side}_hand.urdf",
                title=f"Allegro hand, {side}",
                fingers=_ALLEGRO,
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"g1_{side}": Entry(
                file="g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
                title=f"Unitree G1, three-fingered hand, {side}",
                root=f"{side}_hand_palm_link",
                fingers={
                    finger: f"{side}_hand_{finger}_{2 if finger == 'thumb' else 1}_link"
                    for finger in ("thumb", "middle", "index")
                },
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"psyonic_{side}": Entry(
                file="alex_description/urdf/alex_psyonic_hands.urdf",
                title=f"Alex, Psyonic Ability hand, {side}",
                root=f"{side.title()}PsyonicAbilityBaseLink",
                fingers={
                    finger: f"{side.title()}_{finger}_L2" for finger in ("thumb", "index", "middle", "ring", "pinky")
                },
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"sake_{side}": Entry(
                file="alex_description/urdf/alex_sake_hands.urdf",
                title=f"Alex, Sake gripper, {side}",
                root=f"{side.title()}SakePalmLink",
                fingers={f"finger {i}": f"{side.title()}SakeFingerTip{i}" for i in (1, 2)},
            ),
        }
    ),
    "hey5": Entry(
        file="tiago_description/robots/tiago.urdf", title="TIAGo, Hey5 hand", root="hand_palm_link", fingers=_HEY5
    ),
    **_sides(
        lambda side: {
            f"romeo_{side}": Entry(
                file="romeo_description/urdf/romeo.urdf",
                title=f"Romeo hand, {side}",
                root=f"{side[0]}_wrist",
                fingers={
                    "finger 1": f"{side[0].upper()}Finger13Link",
                    "finger 2": f"{side[0].upper()}Finger23Link",
                    "finger 3": f"{side[0].upper()}Finger33Link",
                    "thumb": f"{side[0].upper()}Thumb3Link",
                },
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"talos_{side}": Entry(
                file="talos_data/robots/talos_full_v2.urdf",
                title=f"Talos gripper, {side}",
                root=f"gripper_{side}_base_link",
                fingers={f"fingertip {i}": f"gripper_{side}_fingertip_{i}_link" for i in (1, 2, 3)},
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"tiago_pro_{side}": Entry(
                file="tiago_pro_description/robots/tiago_pro.urdf",
                title=f"TIAGo Pro gripper, {side}",
                root=f"gripper_{side}_base_link",
                fingers={jaw: f"gripper_{side}_fingertip_{jaw}_link" for jaw in ("left", "right")},
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"pr2_{side}": Entry(
                file="pr2_description/urdf/pr2.urdf",
                title=f"PR2 gripper, {side}",
                root=f"{side[0]}_gripper_palm_link",
                fingers={jaw: f"{side[0]}_gripper_{jaw[0]}_finger_tip_link" for jaw in ("left", "right")},
            ),
        }
    ),
    **_sides(
        lambda side: {
            f"baxter_{side}": Entry(
                file="baxter_description/urdf/baxter.urdf",
                title=f"Baxter gripper, {side}",
                root=f"{side}_gripper_base_link",
                fingers={jaw: f"{side[0]}_gripper_{jaw[0]}_finger" for jaw in ("left", "right")},
            ),
        }
    ),
    "panda": Entry(
        file="panda_description/urdf/panda.urdf",
        title="Panda gripper",
        root="panda_hand",
        fingers={jaw: f"panda_{jaw}finger" for jaw in ("left", "right")},
    ),
    "so101": Entry(
        file="so_arm_description/urdf/so101.urdf",
        title="SO-101 gripper",
        root="gripper_link",
        fingers={"jaw": "moving_jaw_so101_v1_link"},
    ),
}


def shipped_folder() -> Path:
    """Folder of the hands shipped with the package (inside the wheel, or beside the package in a checkout)."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"


def file_of(name: str) -> Path:
    """The description of a hand of the catalogue.

    Raises:
        HandNotLoaded: ``example-robot-data`` is not installed or has no such file.
    """
    entry = CATALOGUE[name]
    if entry.shipped:
        return shipped_folder() / entry.file
    wanted = f"example-robot-data/robots/{entry.file}"
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError as error:
        raise HandNotLoaded(name, "needs the package example-robot-data: pip install example-robot-data") from error
    found = next((Path(file.locate()) for file in files if str(file).endswith(wanted)), None)
    if found is None or not found.is_file():
        raise HandNotLoaded(name, f"example-robot-data has no {entry.file}: install version 6 or later")
    return found
