"""Motors and springs of a URDF file: transmissions, ros2_control, and Gazebo's springs at joints."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable

from pinograsp.hands.drives import Control, Spring
from pinograsp.hands.elements import floats
from pinograsp.hands.motors import Actuation, Motor
from pinograsp.words import printable

# By the command that a joint takes; of several, the first here.
_CONTROLS: dict[str, Control] = {"effort": "torque", "position": "position", "velocity": "position"}


def actuation_of(robot: ElementTree.Element, problems: list[str]) -> Actuation:
    """Motors of the joints that a URDF says are commanded, and springs; problems with their numbers are added.

    The effort is that at the joint, for which the file gives a limit: reductions of the gears make no difference.
    """
    commands = {
        joint.get("name", ""): [one.get("name", "") for one in joint.findall("command_interface")]
        for control in robot.iter("ros2_control")
        for joint in control.findall("joint")
    }
    driven: dict[str, Motor] = {}
    for element in robot.iter("transmission"):
        joints, actuators = element.findall("joint"), element.findall("actuator")
        for joint in joints:
            name = joint.get("name", "")
            given = [(one.text or "").strip() for one in joint.findall("hardwareInterface")]
            if not name or name in driven or (given and all(one.endswith("JointStateInterface") for one in given)):
                continue  # told, not commanded
            own = actuators[0].get("name") if len(joints) == len(actuators) == 1 else None
            driven[name] = _motor(own or name, name, given or commands.get(name, []))
            if len(joints) > 1 or len(actuators) > 1:
                shared = f"transmission '{printable(element.get('name', ''), 60)}', of several joints or motors,"
                more = f"{shared} is taken as one motor at each joint (drives= gives others)"
                driven[name].remark = "; ".join(filter(None, (more, driven[name].remark)))
    for name, interfaces in commands.items():
        if name and interfaces and name not in driven:
            driven[name] = _motor(name, name, interfaces)
    return Actuation(motors=list(driven.values()), springs=_springs(robot, problems), alone=True)


def _motor(name: str, joint: str, interfaces: Iterable[str]) -> Motor:
    """A motor at its own joint, by the names of the interfaces that command it: of ROS 1 or ROS 2."""
    words = " ".join(interfaces).lower()
    for command, control in _CONTROLS.items():
        if command in words:
            remark = "commanded by velocity, taken as position servos" if command == "velocity" else ""
            return Motor(name=name, arms={joint: 1.0}, control=control, remark=remark)
    return Motor(name=name, arms={joint: 1.0})


def _springs(robot: ElementTree.Element, problems: list[str]) -> list[Spring]:
    springs: list[Spring] = []
    joints = {joint.get("name") for joint in robot.findall("joint")}
    for element in robot.findall("gazebo"):
        name = element.get("reference", "")
        if name not in joints:
            continue
        values = []
        for key in ("springStiffness", "springReference"):
            text = element.findtext(key, "0")
            try:
                (value,) = floats(text)
            except ValueError:
                problems.append(f"joint '{name}': <gazebo> <{key}>: expected a number, got '{text:.40}'")
                value = 0.0
            values.append(value)
        stiffness, rest = values
        if stiffness < 0:
            problems.append(f"joint '{name}': <gazebo> <springStiffness>: expected a number >= 0, got {stiffness:g}")
        elif stiffness > 0:
            springs.append(Spring(joint=name, stiffness=stiffness, rest=rest))
    return springs
