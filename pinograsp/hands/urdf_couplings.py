"""Couplings of joints that a URDF leaves to its controllers or its simulation: ros2_control and Gazebo's plugins."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import NamedTuple

from pinograsp.hands.elements import find_named, floats
from pinograsp.hands.tree import MOVING
from pinograsp.words import printable

# Elements of Gazebo's plugins that name the joint that leads and the one that follows: those of roboticsgroup, of
# ign_ros2_control, and of others that took after them.
_ENDS = (
    ("joint", "mimicJoint"),
    ("mimic_joint_name", "joint_name"),
    ("joint", "mimic_joint"),
    ("main_joint", "mimic_joint"),
)


class _Told(NamedTuple):
    """A coupling as a file tells it; ``where``: in words."""

    follower: str
    leader: str
    multiplier: str
    offset: str
    where: str


def add_couplings(robot: ElementTree.Element, problems: list[str], notes: list[str]) -> None:
    """Add the <mimic> that ros2_control's ``<param name="mimic">`` and Gazebo's mimic plugins stand for.

    A joint with a <mimic> of its own keeps it. What cannot be read is noted; ``problems``: numbers that are none.
    """
    joints = {name: joint for name, joint in find_named(robot, "joint") if joint.get("type") in (*MOVING, "continuous")}
    added: dict[str, _Told] = {}
    for told in [*_of_controllers(robot, joints, notes), *_of_plugins(robot, notes)]:
        what = f"{told.where}: {printable(told.follower, 60)} is declared to follow {printable(told.leader, 60)}"
        if told.follower not in joints or told.leader not in joints:
            unknown = told.leader if told.follower in joints else told.follower
            notes.append(f"{what}, left out: no joint '{printable(unknown, 60)}' that moves")
            continue
        try:
            (multiplier,), (offset,) = floats(told.multiplier), floats(told.offset)
        except ValueError:
            problems.append(
                f"joint '{told.follower}': {told.where}: expected multiplier and offset to be numbers, got "
                f"'{told.multiplier:.40}' and '{told.offset:.40}'"
            )
            continue
        given = joints[told.follower].find("mimic")
        if given is None:
            ElementTree.SubElement(
                joints[told.follower], "mimic", joint=told.leader, multiplier=repr(multiplier), offset=repr(offset)
            )
            added[told.follower] = told
        elif _differs(given, told.leader, multiplier, offset):
            first = added[told.follower].where if told.follower in added else "its <mimic>"
            notes.append(f"{what}, which contradicts {first}; {first} is used")
    for where in dict.fromkeys(told.where for told in added.values()):
        followers = [name for name, told in added.items() if told.where == where]
        notes.append(f"couplings taken from {where}: {', '.join(printable(name, 60) for name in followers)}")


def _differs(mimic: ElementTree.Element, leader: str, multiplier: float, offset: float) -> bool:
    try:
        own = [*floats(mimic.get("multiplier", "1")), *floats(mimic.get("offset", "0"))]
    except ValueError:
        return False  # listed with the other numbers
    return mimic.get("joint") != leader or own != [multiplier, offset]


def _of_controllers(
    robot: ElementTree.Element, joints: dict[str, ElementTree.Element], notes: list[str]
) -> Iterator[_Told]:
    """Couplings of ROS 2 up to Iron; later ones only say that a joint follows, and leave the rest to its <mimic>."""
    for control in robot.iter("ros2_control"):
        for element in control.findall("joint"):
            name = element.get("name", "")
            values = {one.get("name", ""): (one.text or "").strip() for one in element.findall("param")}
            if values.get("mimic"):
                yield _Told(
                    name,
                    values["mimic"],
                    values.get("multiplier") or "1",
                    values.get("offset") or "0",
                    "<ros2_control>",
                )
                continue
            mimic, follows = element.get("mimic", "").lower(), name in joints and joints[name].find("mimic") is not None
            if mimic == "true" and name in joints and not follows:
                notes.append(
                    f"<ros2_control>: {printable(name, 60)} is declared to follow another joint, and nothing says "
                    "which: give the joint a <mimic joint=>"
                )
            elif mimic == "false" and follows:
                notes.append(
                    f"<ros2_control>: {printable(name, 60)} is declared to follow nothing; its <mimic> is used"
                )


def _of_plugins(robot: ElementTree.Element, notes: list[str]) -> Iterator[_Told]:
    for plugin in robot.findall("gazebo/plugin"):
        names = f"{plugin.get('filename', '')} {plugin.get('name', '')}"
        ends = next((ends for ends in _ENDS if all((plugin.findtext(one) or "").strip() for one in ends)), None)
        if ends is not None:
            leader, follower = ((plugin.findtext(one) or "").strip() for one in ends)
            multiplier, offset = ((plugin.findtext(key) or "").strip() for key in ("multiplier", "offset"))
            yield _Told(follower, leader, multiplier or "1", offset or "0", "Gazebo's plugin")
        elif "mimic" in names.lower():
            notes.append(
                f"Gazebo's plugin {printable(names.strip(), 80)} couples joints in a way that is not supported: give "
                "them a <mimic joint=>"
            )
