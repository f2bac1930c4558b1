"""Hands that need no file from the user: the paper's, and all hands and grippers in ``example-robot-data``."""

from __future__ import annotations

import importlib.metadata
import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.drives import Control, Drive
from pinograsp.hands.sources import Source


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Where a hand is described: ``file`` below the robots of ``example-robot-data``, or shipped with this package.

    Attributes:
        title: what it is, in words.
        shipped: whether ``file`` comes with this package.
        root: link whose sub-tree is the hand.
        palm, fingers: as :func:`~pinograsp.hands.load.load_hand` takes them, where the tree alone does not tell.
        drives: motors of the real hand, where the file does not tell or tells otherwise; one without a limit has that
            of its joints, else the limits of the joints are what the drives can do.
        sources: where the figures of its drives come from, and which of them are guesses.
        sheet: data sheet of its drives that comes with the package.
        hollow: names of collision meshes that are far from convex, for which convex parts come with this package.
    """

    file: str
    title: str
    shipped: bool = False
    root: str | None = None
    palm: str | None = None
    fingers: dict[str, str] | None = field(default=None)
    drives: tuple[Drive, ...] | None = None
    sources: tuple[Source, ...] = ()
    sheet: str | None = None
    hollow: tuple[str, ...] = ()


def _sides(entries: Callable[[str], dict[str, Entry]]) -> dict[str, Entry]:
    return {name: entry for side in ("left", "right") for name, entry in entries(side).items()}


def _motors(joints: Iterable[str], control: Control, limit: float = math.inf) -> tuple[Drive, ...]:
    """A motor at each of the joints, called like it."""
    return tuple(Drive(name=joint, joints=(joint,), arms=(1.0,), control=control, limit=limit) for joint in joints)


def _limit(text: str, *, guess: bool = False) -> tuple[Source, ...]:
    """Where the limits of a hand's drives come from."""
    return (Source(figure="limit", text=text, guess=guess),)


def _guess(text: str) -> tuple[Source, ...]:
    return _limit(f"{text}; no figure of the maker's is known to us", guess=True)


def _tendon(name: str, closing: dict[str, float]) -> Drive:
    """A motor that closes fingers by tendons against springs.

    Args:
        closing: how far each joint moves per unit of the motor while nothing is in the way [rad/rad]. Springs of equal
            stiffness let joints move in the ratio of their arms, and a = sum arms_j q_j is the motor's angle. As nobody
            has published that stiffness, torques are not held to the ratio of the arms.
    """
    size = sum(ratio**2 for ratio in closing.values())
    return Drive(
        name=name,
        joints=tuple(closing),
        arms=tuple(ratio / size for ratio in closing.values()),
        control="position",
        exact=False,
    )


def _hey5_finger(finger: str, ratio: float, bends: int, abduction: float = 0.0) -> dict[str, float]:
    joints = {f"hand_{finger}_{kind}_{i}_joint": ratio for i in range(1, bends + 1) for kind in ("virtual", "flex")}
    return {f"hand_{finger}_abd_joint": abduction, **joints} if abduction else joints


# Three motors, one tendon each: PAL's transmissions in tiago.urdf (type Hey5Reducer), whose reductions are the closing
# ratios. The hand derives from the Pisa/IIT SoftHand, with springs in its joints (README of
# pal-robotics/hey5_description); their stiffness is not in the file: taken as equal. Left out: dead bands, the middle
# finger's abduction, which the file holds at 0, and hand_thumb_joint, hand_index_joint, hand_mrl_joint, which show the
# motors' angles and move no finger.
_HEY5_DRIVES = (
    _tendon("hand_thumb_motor", _hey5_finger("thumb", 0.162993578547, 2, 0.654498469498)),
    _tendon("hand_index_motor", _hey5_finger("index", 0.102888610798, 3, 0.49866550057)),
    _tendon(
        "hand_mrl_motor",
        {
            **_hey5_finger("middle", 0.0679245283019, 3),
            **_hey5_finger("ring", 0.0739176962651, 3, -0.232710566933),
            **_hey5_finger("little", 0.0739176962651, 3, -0.465421133865),
        },
    ),
)

_HEY5 = {
    finger: f"hand_{finger}_flex_{2 if finger == 'thumb' else 3}_link"
    for finger in ("thumb", "index", "middle", "ring", "little")
}

_HUMANOID = (
    *(
        f"{finger}_{joint}"
        for finger in ("index", "middle", "ring", "little")
        for joint in ("abduction", "mcp", "pip", "dip")
    ),
    *(f"thumb_{joint}" for joint in ("abduction", "cmc", "mcp", "ip")),
)

_ALLEGRO = {finger: f"link_{4 * i + 3}.0_tip" for i, finger in enumerate(("index", "middle", "ring", "thumb"))}

CATALOGUE: dict[str, Entry] = {
    "humanoid": Entry(
        file="humanoid_hand.urdf",
        title="the paper's humanoid hand",
        shipped=True,
        # The paper's dynamics have a torque of its own at each joint.
        drives=_motors(_HUMANOID, "torque"),
        sources=_limit("2 N m, chosen so that limits decide nothing in the paper, which has none", guess=True),
    ),
    **_sides(
        lambda side: {
            f"allegro_{side}": Entry(
                file=f"allegro_hand_description/urdf/allegro_{side}_hand.urdf",
                title=f"Allegro hand, {side}",
                fingers=_ALLEGRO,
                # 16 motors whose torque is commanded (Wonik Robotics, Allegro Hand User's Manual); 15 N m in the file.
                drives=_motors((f"joint_{i}.0" for i in range(16)), "torque", limit=0.7),
                sources=_limit("largest torque of a joint (Wonik Robotics, Allegro Hand V4, technical specifications)"),
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
                # Dex3-1: 7 motors, each with torque, position and gains as commands (Unitree, G1 developer documents,
                # "Dexterous hand", and HandCmd_ of unitree_sdk2).
                drives=_motors(
                    (
                        f"{side}_hand_{joint}_joint"
                        for joint in ("thumb_0", "thumb_1", "thumb_2", "middle_0", "middle_1", "index_0", "index_1")
                    ),
                    "torque",
                ),
                sources=_limit("2.45 N m of the thumb's first joint, 1.4 N m of others (Unitree's own g1_description)"),
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
                # 6 motors, one per finger and one that turns the thumb, commanded by position, velocity or current
                # (PSYONIC, ability-hand-api); their gains are not given.
                drives=_motors(
                    (
                        f"{side.title()}_{joint}"
                        for joint in ("index_q1", "middle_q1", "ring_q1", "pinky_q1", "thumb_q1", "thumb_q2")
                    ),
                    "position",
                ),
                sources=_limit("6 N m, at the thumb's first joint 1.2 N m (PSYONIC, ability-hand-api, URDF)"),
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
                # EZGripper: one servo pulls the tendons of both fingers, which close independently, and grasps by
                # effort (SAKErobotics/MuJoCo_ezgripper_sim, README); equal arms, as the fingers are alike.
                drives=(
                    Drive(
                        name="servo",
                        joints=tuple(f"{side.title()}_GRIPPER_X{i}" for i in (1, 2)),
                        arms=(1.0, 1.0),
                        control="jaw",
                    ),
                ),
                sources=_guess("1 N m in alex_description"),
            ),
        }
    ),
    "hey5": Entry(
        file="tiago_description/robots/tiago.urdf",
        title="TIAGo, Hey5 hand",
        root="hand_palm_link",
        fingers=_HEY5,
        drives=_HEY5_DRIVES,
        sources=_guess("2 N m at every joint in tiago_description, whatever the tendons make there"),
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
                sources=_guess("1 N m in talos_data, beside a speed of 1 rad/s and a friction of 1 N m"),
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
                # One motor turns both fingers; what it makes is the torque at the joint that all others follow.
                drives=_motors([f"gripper_{side}_finger_joint"], "jaw", 6.0),
                sources=_guess("6 N m, which is 30 N at a fingertip, in place of 0.1 N m in tiago_pro_description"),
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
                # One motor (transmission PR2GripperTransmission of the file), commanded by position and largest effort
                # (pr2_gripper_sensor_msgs). Its force acts on the gap, by an arm that changes with the posture: given
                # is the torque at the finger's joint.
                drives=(
                    Drive(
                        name=f"{side[0]}_gripper_motor",
                        joints=(f"{side[0]}_gripper_l_finger_joint",),
                        arms=(1.0,),
                        control="jaw",
                    ),
                ),
                sources=_guess("1000 N m in pr2_description"),
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
                # One motor closes both jaws with a holding force (baxter_interface.Gripper); the effort is the force
                # of each jaw, which acts on the joint twice.
                drives=(
                    Drive(
                        name=f"{side} gripper",
                        joints=(f"{side[0]}_gripper_l_finger_joint",),
                        arms=(2.0,),
                        control="jaw",
                    ),
                ),
                sources=_guess("20 N of each jaw in baxter_description"),
            ),
        }
    ),
    "panda": Entry(
        file="panda_description/urdf/panda.urdf",
        title="Panda gripper",
        root="panda_hand",
        fingers={jaw: f"panda_{jaw}finger" for jaw in ("left", "right")},
        # Franka Hand: grasps with a force asked for (Grasp.action of franka_gripper). The effort is the force of each
        # jaw, which acts on the joint twice; its coordinate is the width. The file's 100 N are neither of the maker's.
        drives=(Drive(name="jaws", joints=("panda_finger_joint1",), arms=(2.0,), control="jaw", limit=70.0),),
        sources=_limit("of each jaw, without end; 140 N at most (Franka Robotics, Product Manual Franka Hand R50010)"),
    ),
    "so101": Entry(
        file="so_arm_description/urdf/so101.urdf",
        title="SO-101 gripper",
        root="gripper_link",
        fingers={"jaw": "moving_jaw_so101_v1_link"},
        hollow=("wrist_roll_follower_so101_v1", "moving_jaw_so101_v1"),
        # One STS3215 servo at 12 V, set up as LeRobot does (so_follower.py: P 16, half of the largest torque).
        drives=(Drive(name="gripper", joints=("gripper",), arms=(1.0,), control="position", limit=1.47),),
        sheet="sts3215",
    ),
}


def shipped_folder() -> Path:
    """Folder of the hands shipped with the package (inside the wheel, or beside the package in a checkout)."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"


def convex_parts_of(name: str) -> dict[str, list[Path]]:
    """Files of the convex parts that stand for collision meshes of a hand, by the names of these meshes."""
    folder = shipped_folder() / "meshes" / name
    return {mesh: sorted(folder.glob(f"{mesh}_*.stl")) for mesh in CATALOGUE[name].hollow}


def file_of(name: str) -> Path:
    """The description of a hand of the catalogue.

    Raises:
        HandNotLoaded: ``example-robot-data`` is not installed or has no such file.
    """
    entry = CATALOGUE[name]
    if entry.shipped:
        return shipped_folder() / entry.file
    wanted = f"example-robot-data/robots/{entry.file}"
    shared = Path(sys.prefix, "share", wanted)  # where conda's package has them, which is none of Python's
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = None
    found = next((Path(file.locate()) for file in files or () if str(file).endswith(wanted)), shared)
    if found.is_file():
        return found
    if files is None:
        raise HandNotLoaded(name, "needs the package example-robot-data: pip install example-robot-data")
    raise HandNotLoaded(name, f"example-robot-data has no {entry.file}: install version 6 or later")
