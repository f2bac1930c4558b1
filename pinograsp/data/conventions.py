"""Which frame and which joints a data set means: the hands of public data sets by name."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import brief, read_only
from pinograsp.data import skeletons
from pinograsp.data.alignment import JointAxes
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """What a data set takes for a hand's root, and the order of its joints.

    Attributes:
        name: of this convention.
        family: whose names of joints are known here: shadow, allegro, leap; or jaws.
        root: the root frame, in words.
        joints: in the order of the file, where that names none.
        axes: of the joints in the root frame; None for jaws.
        link, pose: of jaws, the links by whose frame the root is known, and where it is in that (4, 4).
    """

    name: str
    family: str
    root: str
    joints: tuple[str, ...]
    axes: JointAxes | None = None
    link: tuple[str, ...] = ()
    pose: Array | None = None

    __repr__ = brief("name", "root")


def _palm(at: tuple[float, float, float], columns: list[list[float]]) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = columns, at
    return pose


def _seen(axes: JointAxes, palm: Array, names: Iterable[str]) -> JointAxes:
    """A skeleton from a root in which the palm's frame is at ``palm``, with other names for its joints."""
    moved = axes.moved(palm)
    return JointAxes(names=tuple(names), origins=moved.origins, directions=moved.directions)


_SHADOW_MJCF = tuple(
    f"rh_{finger}J{i}"
    for finger, most in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
    for i in range(most, 0, -1)
)
_ALLEGRO_MJCF = tuple(f"{finger}j{i}" for finger in ("ff", "mf", "rf", "th") for i in range(4))
# Of LEAP's joints in the order of the MJCF file, the numbers in the URDF file: the axes lie on each other so.
_LEAP_MJCF = {
    "if_mcp": 1,
    "if_rot": 0,
    "if_pip": 2,
    "if_dip": 3,
    "mf_mcp": 5,
    "mf_rot": 4,
    "mf_pip": 6,
    "mf_dip": 7,
    "rf_mcp": 9,
    "rf_rot": 8,
    "rf_pip": 10,
    "rf_dip": 11,
    "th_cmc": 12,
    "th_axl": 13,
    "th_mcp": 14,
    "th_ipl": 15,
}

# In the MJCF files of DexGraspBench and Dexonomy, whose worlds carry the free joint: Shadow's palm is 34 mm up (the
# wrist is left out), Allegro's has quat="0 1 0 1", LEAP's pos="0 0 0.1" quat="0 1 0 0".
_IN_SHADOW_MJCF = _palm((0, 0, 0.034), [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
_IN_ALLEGRO_MJCF = _palm((0, 0, 0), [[0, 0, 1], [0, -1, 0], [1, 0, 0]])
_IN_LEAP_MJCF = _palm((0, 0, 0.1), [[1, 0, 0], [0, -1, 0], [0, 0, -1]])

# Jaws close along x in ACRONYM and GraspGen (acronym_tools/acronym.py, config/grippers/franka_panda.py), and along y in
# Franka's panda_hand. Which way round does not matter: the gripper is the same after half a turn.
_ACROSS = _palm((0, 0, 0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
# graspqp/assets/panda/franka_panda.urdf: panda_hand is 75 mm behind the root.
_PANDA_GRASPQP = _palm((0, 0, 0.075), [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
_PANDA_LINKS = ("panda_hand", "hand")

CONVENTIONS: dict[str, Convention] = {
    one.name: one
    for one in (
        Convention(
            name="shadow_dexgraspnet",
            family="shadow",
            root="robot0:palm",
            joints=skeletons.SHADOW_OLD.names,
            axes=skeletons.SHADOW_OLD,
        ),
        Convention(
            name="shadow_palm",
            family="shadow",
            root="rh_palm",
            joints=skeletons.SHADOW.names,
            axes=skeletons.SHADOW,
        ),
        Convention(
            name="shadow_mjcf",
            family="shadow",
            root="the world of the MJCF file, in which rh_palm is 34 mm up",
            joints=_SHADOW_MJCF,
            axes=_seen(skeletons.SHADOW.of(_SHADOW_MJCF), _IN_SHADOW_MJCF, _SHADOW_MJCF),
        ),
        Convention(
            name="shadow_graspqp",
            family="shadow",
            root="root, at the forearm's mount",
            joints=skeletons.SHADOW_GRASPQP.names,
            axes=skeletons.SHADOW_GRASPQP,
        ),
        Convention(
            name="allegro_palm",
            family="allegro",
            root="palm_link (base_link)",
            joints=skeletons.ALLEGRO.names,
            axes=skeletons.ALLEGRO,
        ),
        Convention(
            name="allegro_mjcf",
            family="allegro",
            root="the world of the MJCF file, in which the palm is turned",
            joints=_ALLEGRO_MJCF,
            axes=_seen(skeletons.ALLEGRO, _IN_ALLEGRO_MJCF, _ALLEGRO_MJCF),
        ),
        Convention(
            name="allegro_graspqp",
            family="allegro",
            root="allegro",
            joints=skeletons.ALLEGRO_GRASPQP.names,
            axes=skeletons.ALLEGRO_GRASPQP,
        ),
        Convention(
            name="leap_base",
            family="leap",
            root="hand_base_link",
            joints=skeletons.LEAP.names,
            axes=skeletons.LEAP,
        ),
        Convention(
            name="leap_mjcf",
            family="leap",
            root="the world of the MJCF file, in which the palm is 0.1 m up and turned",
            joints=tuple(_LEAP_MJCF),
            axes=_seen(skeletons.LEAP.of([f"j{i}" for i in _LEAP_MJCF.values()]), _IN_LEAP_MJCF, _LEAP_MJCF),
        ),
        Convention(
            name="panda_graspgen",
            family="jaws",
            root="panda_hand, turned so that the fingers close along x",
            joints=(),
            link=_PANDA_LINKS,
            pose=read_only(_ACROSS),
        ),
        Convention(
            name="panda_graspqp",
            family="jaws",
            root="panda, 75 mm before panda_hand",
            joints=("panda_finger_joint1",),
            link=_PANDA_LINKS,
            pose=read_only(_PANDA_GRASPQP),
        ),
    )
}

_SHADOW_JOINT = re.compile(r"(WR|FF|MF|RF|LF|TH)J([0-6])$")
_ALLEGRO_JOINTS = (
    re.compile(r"joint_(?P<number>1[0-5]|\d)(\.0)?$"),
    re.compile(r"(?P<finger>ff|mf|rf|th)j(?P<joint>[0-3])$"),
    re.compile(r"(?P<finger>index|middle|ring|thumb)_joint_(?P<joint>[0-3])$"),
)
_LEAP_NUMBER = re.compile(r"j?(1[0-5]|\d)$")
_LEAP_NAME = re.compile(r"(if|mf|rf|th)_(mcp|rot|pip|dip|cmc|axl|ipl)$")


def known_names(family: str, names: Iterable[str]) -> dict[str, str]:
    """Names of joints, {name that all descriptions share: name here}, for those that are known.

    Older descriptions of the Shadow hand count from 0, newer ones from 1: a hand with a joint 0 is an older one.
    """
    names = list(names)
    if family == "shadow":
        found = [(name, match) for name in names if (match := _SHADOW_JOINT.search(name))]
        old = any(match[2] == "0" for _, match in found)
        return {f"{match[1]}J{int(match[2]) + old}": name for name, match in found}
    if family == "allegro":
        return {number: name for name in names if (number := _allegro_number(name)) is not None}
    if family == "leap":
        return {number: name for name in names if (number := _leap_number(name)) is not None}
    return {name: name for name in names}


def _allegro_number(name: str) -> str | None:
    for pattern in _ALLEGRO_JOINTS:
        # "index_joint_0" ends like "joint_0", which is the first finger's: the longer name first.
        if match := pattern.search(name):
            groups = match.groupdict()
            if "number" in groups and name[: match.start()].endswith(("index_", "middle_", "ring_", "thumb_")):
                continue
            if "number" in groups:
                return groups["number"]
            finger = ("ff", "mf", "rf", "th", "index", "middle", "ring", "thumb").index(groups["finger"]) % 4
            return str(4 * finger + int(groups["joint"]))
    return None


def _leap_number(name: str) -> str | None:
    if match := _LEAP_NUMBER.fullmatch(name):
        return match[1]
    match = _LEAP_NAME.search(name)
    return str(_LEAP_MJCF[match[0]]) if match and match[0] in _LEAP_MJCF else None
