"""Mimic joints in the order Pinocchio needs: the joint that is followed has to come before those that follow it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from pinograsp.errors import HandNotLoaded


def in_order(source: str, text: str) -> tuple[str, dict[str, str]]:
    """URDF text with joints renamed so that followed ones come first, and the names to give back.

    Pinocchio visits the joints below a link by name and refuses a mimic joint that it meets before the joint it follows.
    Without mimic joints the text stays as it is.

    Raises:
        HandNotLoaded: two branches follow joints of each other.
    """
    robot = ElementTree.fromstring(text)
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    follows = {name: m.get("joint") for name, joint in joints.items() if (m := joint.find("mimic")) is not None}
    if not follows:
        return text, {}
    below: dict[str, list[str]] = {}
    for name, joint in joints.items():
        below.setdefault(joint.find("parent").get("link"), []).append(name)

    def inside(name: str) -> set[str]:
        child = joints[name].find("child").get("link")
        return {name}.union(*(inside(other) for other in below.get(child, [])))

    renamed = {}
    for siblings in below.values():
        branches = {name: inside(name) for name in sorted(siblings)}
        # A branch waits for those that hold a joint it follows.
        waits = {
            name: {other for other, theirs in branches.items() if other != name
                   and any(follows.get(joint) in theirs for joint in own)}
            for name, own in branches.items()
        }  # fmt: skip
        order: list[str] = []
        while waits:
            ready = next((name for name in waits if not waits[name] - set(order)), None)
            if ready is None:
                raise HandNotLoaded(
                    source, f"mimic joints in {' and '.join(waits)} follow each other: let all follow one joint"
                )
            order.append(ready)
            del waits[ready]
        renamed |= {name: f"{place:04d} {name}" for place, name in enumerate(order)}
    for name, joint in joints.items():
        joint.set("name", renamed[name])
        if name in follows:
            joint.find("mimic").set("joint", renamed[follows[name]])
    return ElementTree.tostring(robot, encoding="unicode"), {new: old for old, new in renamed.items()}
