"""The tree of links and joints of a URDF: a sub-tree cut out, and what is wrong with it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from typing import TYPE_CHECKING

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import end_of, find_named
from pinograsp.hands.tree import MOVING

if TYPE_CHECKING:
    import yourdfpy


def cut_out(source: str, robot: ElementTree.Element, root: str, notes: list[str]) -> set[str]:
    """Keep the links and joints below ``root`` only; the names of the joints outside."""
    links = [name for name, _ in find_named(robot, "link")]
    if root not in links:
        raise HandNotLoaded(source, f"root '{root}' is not a link; links: {', '.join(links)}")
    kept = _reach([(end_of(joint, "parent"), end_of(joint, "child")) for joint in robot.findall("joint")], root)
    outside = {name for name, joint in find_named(robot, "joint") if end_of(joint, "parent") not in kept}
    for name, link in find_named(robot, "link"):
        if name not in kept:
            robot.remove(link)
    for _, joint in find_named(robot, "joint"):
        if end_of(joint, "parent") not in kept:
            robot.remove(joint)
    notes.append(f"the sub-tree of '{root}' is the hand: {len(kept)} of {len(links)} links")
    return outside


def _reach(joints: Iterable[tuple[str, str]], root: str) -> set[str]:
    """The links below ``root``, itself included, by the parents and children of joints."""
    below: dict[str, list[str]] = {}
    for parent, child in joints:
        below.setdefault(parent, []).append(child)
    reached, waiting = {root}, [root]
    while waiting:
        further = set(below.get(waiting.pop(), [])) - reached
        reached |= further
        waiting += further
    return reached


def links_below(robot: yourdfpy.Robot, link: str) -> set[str]:
    """Names of a link and of those that it carries, directly or through others."""
    return _reach([(joint.parent, joint.child) for joint in robot.joints], link)


def find_tree_problems(robot: yourdfpy.Robot, root: str | None) -> list[str]:
    """What is wrong with the links and joints of a tree that should have one root and move."""
    links = [link.name for link in robot.links]
    if not links:
        return ["no <link> found: expected a <robot> with links and joints (a file of macros is for others to include)"]
    problems = []
    for kind, names in (("link", links), ("joint", [joint.name for joint in robot.joints])):
        if not all(names):
            problems.append(f"{names.count('')} <{kind}> without a name")
        repeated = sorted({name for name in names if name and names.count(name) > 1})
        problems += [f"{kind} '{name}' is defined {names.count(name)} times" for name in repeated]
        if kind == "joint" and "universe" in names:
            problems.append("joint 'universe': Pinocchio keeps that name for the world, choose another")
    children = [joint.child for joint in robot.joints]
    unknown = [
        f"joint '{joint.name}' names the unknown link '{link}': add it, or correct the name"
        for joint in robot.joints
        for link in (joint.parent, joint.child)
        if link not in links
    ]
    problems += unknown
    twice = sorted({name for name in children if children.count(name) > 1})
    problems += [f"link '{name}' has several parent joints: URDF is a tree, leave all but one out" for name in twice]
    roots = [name for name in links if name not in children]
    if len(roots) > 1 or not (roots or unknown):
        found = ", ".join(roots) or "every link has a parent, which is a loop"
        problems.append(f"expected one root link, found {len(roots)}: {found}; join them, or give root=")
    elif not problems:
        reached = links_below(robot, roots[0])
        if loose := [name for name in links if name not in reached]:
            problems.append(f"links that hang on each other in a loop: {', '.join(loose)}")
    if not any(joint.type in (*MOVING, "continuous") for joint in robot.joints):
        where = f" beyond root '{root}'" if root else ""
        problems.append(f"no revolute or prismatic joint{where}: expected a hand that moves")
    return problems
