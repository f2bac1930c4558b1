"""Which frame and which joints a data set means: the hands of public data sets by name."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import brief, read_only
from pinograsp.data import skeletons
from pinograsp.data.alignment import JointAxes
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """The root frame and the order of joints that a data set uses for a hand.

    Attributes:
        name: name of this convention.
        family: hand whose joint names are known here: shadow, allegro, leap; or jaws.
        root: the root frame, in words.
        joints: in the order of the file, if that does not name them.
        axes: of the joints in the root frame; None for jaws.
        link, pose: for jaws, the links whose frame determines the root, and its pose in that frame (4, 4).
    """

    name: str
    family: str
    root: str
    joints: tuple[str, ...]
    axes: JointAxes | None = None
    link: tuple[str, ...] = ()
    pose: Array | None = None

    __repr__ = brief("name", "root")


_AS_IT_IS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def _palm(at: tuple[float, float, float], columns: ArrayLike = _AS_IT_IS) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = columns, at
    return pose


def _of_skeleton(name: str, family: str, root: str, axes: JointAxes) -> Convention:
    return Convention(name=name, family=family, root=root, joints=axes.names, axes=axes)


def _see_from(palm: Array, axes: JointAxes, names: Iterable[str]) -> JointAxes:
    """A skeleton from a root in which the palm's frame is at ``palm``, with other names for its joints."""
    return replace(axes.move(palm), names=tuple(names))


_SHADOW_MJCF = tuple(
    f"rh_{finger}J{i}"
    for finger, most in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
    for i in range(most, 0, -1)
)
_ALLEGRO_MJCF = tuple(f"{finger}j{i}" for finger in ("ff", "mf", "rf", "th") for i in range(4))
# Of LEAP's joints in the order of the MJCF file, the numbers in the URDF file: the axes lie on each other so.
_LEAP_FINGER = {"mcp": 1, "rot": 0, "pip": 2, "dip": 3}
_LEAP_THUMB = {"cmc": 0, "axl": 1, "mcp": 2, "ipl": 3}
_LEAP_FINGERS = {"if": _LEAP_FINGER, "mf": _LEAP_FINGER, "rf": _LEAP_FINGER, "th": _LEAP_THUMB}
_LEAP_MJCF = {
    f"{finger}_{joint}": 4 * i + number
    for i, (finger, joints) in enumerate(_LEAP_FINGERS.items())
    for joint, number in joints.items()
}

# In the MJCF files of DexGraspBench and Dexonomy, whose worlds carry the free joint: Shadow's palm is 34 mm up (the
# wrist is left out), Allegro's has quat="0 1 0 1", LEAP's pos="0 0 0.1" quat="0 1 0 0".
_IN_SHADOW_MJCF = _palm((0, 0, 0.034))
_IN_ALLEGRO_MJCF = _palm((0, 0, 0), [[0, 0, 1], [0, -1, 0], [1, 0, 0]])
_IN_LEAP_MJCF = _palm((0, 0, 0.1), [[1, 0, 0], [0, -1, 0], [0, 0, -1]])

# Jaws close along x in ACRONYM and GraspGen (acronym_tools/acronym.py, config/grippers/franka_panda.py), and along y in
# Franka's panda_hand. Which way round does not matter: the gripper is the same after half a turn.
_ACROSS = _palm((0, 0, 0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
# graspqp/assets/panda/franka_panda.urdf: panda_hand is 75 mm behind the root.
_PANDA_GRASPQP = _palm((0, 0, 0.075))
_PANDA_LINKS = ("panda_hand", "hand")

CONVENTIONS: dict[str, Convention] = {
    one.name: one
    for one in (
        _of_skeleton("shadow_dexgraspnet", "shadow", "robot0:palm", skeletons.SHADOW_OLD),
        _of_skeleton("shadow_palm", "shadow", "rh_palm", skeletons.SHADOW),
        _of_skeleton(
            "shadow_mjcf",
            "shadow",
            "the world of the MJCF file, in which rh_palm is 34 mm up",
            _see_from(_IN_SHADOW_MJCF, skeletons.SHADOW.choose(_SHADOW_MJCF), _SHADOW_MJCF),
        ),
        _of_skeleton("shadow_graspqp", "shadow", "root, at the forearm's mount", skeletons.SHADOW_GRASPQP),
        _of_skeleton("allegro_palm", "allegro", "palm_link (base_link)", skeletons.ALLEGRO),
        _of_skeleton(
            "allegro_mjcf",
            "allegro",
            "the world of the MJCF file, in which the palm is turned",
            _see_from(_IN_ALLEGRO_MJCF, skeletons.ALLEGRO, _ALLEGRO_MJCF),
        ),
        _of_skeleton("allegro_graspqp", "allegro", "allegro", skeletons.ALLEGRO_GRASPQP),
        _of_skeleton("leap_base", "leap", "hand_base_link", skeletons.LEAP),
        _of_skeleton(
            "leap_mjcf",
            "leap",
            "the world of the MJCF file, in which the palm is 0.1 m up and turned",
            _see_from(_IN_LEAP_MJCF, skeletons.LEAP.choose([f"j{i}" for i in _LEAP_MJCF.values()]), _LEAP_MJCF),
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
