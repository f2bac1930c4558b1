"""The tree of links and joints of a URDF: a sub-tree cut out, and what is wrong with it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import end_of, named
from pinograsp.hands.tree import MOVING


def cut_out(source: str, robot: ElementTree.Element, root: str, notes: list[str]) -> set[str]:
    """Keep the links and joints below ``root`` only; the names of the joints outside."""
    links = [name for name, _ in named(robot, "link")]
    if root not in links:
        raise HandNotLoaded(source, f"root '{root}' is not a link; links: {', '.join(links)}")
    kept = _reached(robot, root)
    outside = {name for name, joint in named(robot, "joint") if end_of(joint, "parent") not in kept}
    for name, link in named(robot, "link"):
        if name not in kept:
            robot.remove(link)
    for _, joint in named(robot, "joint"):
        if end_of(joint, "parent") not in kept:
            robot.remove(joint)
    notes.append(f"the sub-tree of '{root}' is the hand: {len(kept)} of {len(links)} links")
    return outside


def _reached(robot: ElementTree.Element, root: str) -> set[str]:
    """The links below ``root``, itself included."""
    below: dict[str, list[str]] = {}
    for _, joint in named(robot, "joint"):
        below.setdefault(end_of(joint, "parent"), []).append(end_of(joint, "child"))
    reached, waiting = {root}, [root]
    while waiting:
        further = set(below.get(waiting.pop(), [])) - reached
        reached |= further
        waiting += further
    return reached


def joints_below(robot: ElementTree.Element, link: str) -> set[str]:
    """Names of the joints that a link carries, directly or through others."""
    reached = _reached(robot, link)
    return {name for name, joint in named(robot, "joint") if end_of(joint, "parent") in reached}


def leave_out(robot: ElementTree.Element, link: str) -> None:
    """Remove a link with all that it carries, and the joint that carries it."""
    reached = _reached(robot, link)
    for name, one in named(robot, "link"):
        if name in reached:
            robot.remove(one)
    for _, joint in named(robot, "joint"):
        if end_of(joint, "child") in reached:
            robot.remove(joint)


def tree_problems(robot: ElementTree.Element, root: str | None) -> list[str]:
    """What is wrong with the links and joints of a tree that should have one root and move."""
    links = [name for name, _ in named(robot, "link")]
    joints = robot.findall("joint")
    if not links:
        return ["no <link> found: expected a <robot> with links and joints (a file of macros is for others to include)"]
    problems = []
    for kind, names in (("link", links), ("joint", [name for name, _ in named(robot, "joint")])):
        if not all(names):
            problems.append(f"{names.count('')} <{kind}> without a name")
        repeated = sorted({name for name in names if name and names.count(name) > 1})
        problems += [f"{kind} '{name}' is defined {names.count(name)} times" for name in repeated]
        if kind == "joint" and "universe" in names:
            problems.append("joint 'universe': Pinocchio keeps that name for the world, choose another")
    children = [end_of(joint, "child") for joint in joints]
    for joint in joints:
        problems += [
            f"joint '{joint.get('name')}' names the unknown link '{link}': add it, or correct the name"
            for link in (end_of(joint, "parent"), end_of(joint, "child"))
            if link not in links
        ]
    twice = sorted({name for name in children if children.count(name) > 1})
    problems += [f"link '{name}' has several parent joints: URDF is a tree, leave all but one out" for name in twice]
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        found = ", ".join(roots) or "every link has a parent, which is a loop"
        problems.append(f"expected one root link, found {len(roots)}: {found}; join them, or give root=")
    elif not problems:
        reached = _reached(robot, roots[0])
        if loose := [name for name in links if name not in reached]:
            problems.append(f"links that hang on each other in a loop: {', '.join(loose)}")
    if not any(joint.get("type") in (*MOVING, "continuous") for joint in joints):
        where = f" beyond root '{root}'" if root else ""
        problems.append(f"no revolute or prismatic joint{where}: expected a hand that moves")
    return problems
