"""A Panda whose hand is an Allegro's."""

from xml.etree import ElementTree

import pinograsp as pg
from pinograsp.hands.catalogue import file_of


def arm_with_allegro(folder):
    """A Panda whose hand is an Allegro's, as a URDF."""
    arm, hand = (ElementTree.parse(file_of(name)).getroot() for name in ("panda", "allegro_right"))
    gone = {"panda_hand", "panda_hand_tcp", "panda_leftfinger", "panda_rightfinger"}
    for one in list(arm):
        child = one.find("child") if one.tag == "joint" else None
        if one.get("name") in gone or (child is not None and child.get("link") in gone):
            arm.remove(one)
    arm.extend(one for one in hand if one.tag in ("link", "joint"))
    mount = ElementTree.SubElement(arm, "joint", name="mount", type="fixed")
    ElementTree.SubElement(mount, "parent", link="panda_link8")
    ElementTree.SubElement(mount, "child", link="palm_link")
    ElementTree.SubElement(mount, "origin", xyz="0 0 0.1", rpy="0 0 0")
    file = folder / "panda_allegro.urdf"
    ElementTree.ElementTree(arm).write(file)
    data = next(one for one in file_of("panda").parents if one.name == "example-robot-data")
    return pg.load_hand(file, packages={"example-robot-data": str(data)})
