"""What a URDF file says about joints and couplings, read by the tests on their own: an oracle for the hand loader."""

from __future__ import annotations

import copy
import functools
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin

MOVING = ("revolute", "prismatic", "continuous")


class Description:
    """The sub-tree of ``root`` in a URDF file, with every mimic joint freed and its coupling kept.

    ``couplings`` holds (followed joint, multiplier, offset) by coupled joint, chains not resolved. ``repair`` renames
    followed joints that do not exist.
    """

    def __init__(self, path: Path, root: str | None = None, repair=lambda joint, followed: followed):
        self.robot = ElementTree.parse(path).getroot()
        self.couplings = {}
        for joint in self.robot.findall("joint"):
            if (mimic := joint.find("mimic")) is not None:
                joint.remove(mimic)
                if joint.get("type") != "fixed":
                    followed = repair(joint.get("name"), mimic.get("joint"))
                    self.couplings[joint.get("name")] = (
                        followed,
                        float(mimic.get("multiplier", 1)),
                        float(mimic.get("offset", 0)),
                    )
        for link in self.robot.findall("link"):
            for element in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(element)
        if root is not None:
            self._cut(root)
        self.moving = [joint.get("name") for joint in self.robot.findall("joint") if joint.get("type") in MOVING]

    def _cut(self, root: str) -> None:
        kept, joints = {root}, []
        todo = [root]
        while todo:
            link = todo.pop()
            for joint in self.robot.findall("joint"):
                if joint.find("parent").get("link") == link:
                    joints.append(joint)
                    todo.append(joint.find("child").get("link"))
                    kept.add(todo[-1])
        for element in list(self.robot):
            if not (element in joints or (element.tag == "link" and element.get("name") in kept)):
                self.robot.remove(element)

    def position(self, joint: str, free: dict[str, float]) -> float:
        """Position of any joint, from those of the free ones."""
        if joint in self.couplings:
            followed, factor, offset = self.couplings[joint]
            return factor * self.position(followed, free) + offset
        return free[joint]

    def expansion(self, joints: list[str], actuated: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """E (len(joints), n) and offsets (len(joints),) with q_full = E q + offsets."""
        zero = dict.fromkeys(actuated, 0.0)
        offsets = np.array([self.position(joint, zero) for joint in joints])
        columns = [[self.position(joint, {**zero, name: 1.0}) for joint in joints] - offsets for name in actuated]
        return np.column_stack(columns), offsets

    @functools.cached_property
    def model(self) -> pin.Model:
        """Pinocchio's model of the sub-tree with every mimic joint free."""
        robot = copy.deepcopy(self.robot)
        for joint in robot.findall("joint"):
            if joint.get("type") == "continuous":  # one number per joint, as the loader has it
                joint.set("type", "revolute")
            if joint.find("limit") is None and joint.get("type") != "fixed":
                ElementTree.SubElement(joint, "limit", lower="-1", upper="1", effort="1", velocity="1")
        return pin.buildModelFromXML(ElementTree.tostring(robot, encoding="unicode"))

    def placements(self, links, free: dict[str, float]) -> np.ndarray:
        """Placements (k, 4, 4) of links in the root link, by Pinocchio's own reading of the file."""
        model, data = self.model, self.model.createData()
        q = np.array([self.position(joint, free) for joint in list(model.names)[1:]])
        pin.framesForwardKinematics(model, data, q)
        return np.array([data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous for link in links])
