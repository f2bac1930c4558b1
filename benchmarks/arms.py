"""Arms with hands, each as one description made of two."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pinograsp as pg
from pinograsp.hands.catalogue import file_of

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
START = (0.3, -0.4, 0.2, -2.0, 0.3, 1.9, 0.5)
_OWN_HAND = {"panda_hand", "panda_hand_tcp", "panda_leftfinger", "panda_rightfinger"}


@cache
def robot(name: str) -> pg.HandModel:
    """``panda``, or ``panda + `` and a hand of the catalogue."""
    hand = name.partition(" + ")[2]
    if not hand:
        return panda()
    if hand == "humanoid":  # upright where the arm rests, as the paper has it
        return panda_with(hand, "palm", rpy="2.8123 -0.1606 -0.0325")
    return panda_with(hand, "palm_link")


def panda(posture=START) -> pg.HandModel:
    """The arm with its own jaws."""
    return pg.load_hand(file_of("panda"), posture=dict(zip(JOINTS, posture)))


def panda_with(name: str, link: str, rpy: str = "0 0 0", posture=START) -> pg.HandModel:
    """The arm with a hand of the catalogue at its flange; ``link``: the hand's outermost one."""
    arm, hand = (ElementTree.parse(file_of(own)).getroot() for own in ("panda", name))
    for one in list(arm):
        child = one.find("child") if one.tag == "joint" else None
        if one.get("name") in _OWN_HAND or (child is not None and child.get("link") in _OWN_HAND):
            arm.remove(one)
    arm.extend(one for one in hand if one.tag in ("link", "joint"))
    mount = ElementTree.SubElement(arm, "joint", name="mount", type="fixed")
    ElementTree.SubElement(mount, "parent", link="panda_link8")
    ElementTree.SubElement(mount, "child", link=link)
    ElementTree.SubElement(mount, "origin", xyz="0 0 0.1", rpy=rpy)
    data = next(one for one in file_of("panda").parents if one.name == "example-robot-data")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"panda_{name}.urdf"
        ElementTree.ElementTree(arm).write(file)
        return pg.load_hand(file, packages={"example-robot-data": str(data)}, posture=dict(zip(JOINTS, posture)))
