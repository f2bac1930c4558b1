"""SRDF files, as MoveIt has them beside a URDF: which pairs of links are not to be looked at for collisions."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import parse, read_bytes

_TAGS = ("disable_collisions", "disable_default_collisions")
Pairs: TypeAlias = tuple[tuple[str, str], ...]


def pairs_in(robot: ElementTree.Element, links: Sequence[str]) -> Pairs:
    """Pairs of a hand's links whose collisions a description disables, in the order of ``links``; those of other links,
    as of an arm that is left out, do not count.
    """
    place = {link: i for i, link in enumerate(links)}

    def read_pairs(tag: str) -> set[tuple[str, str]]:
        ends = [(one.get("link1", ""), one.get("link2", "")) for one in robot.findall(tag)]
        inside = [sorted(pair, key=place.__getitem__) for pair in ends if set(pair) <= place.keys()]
        return {(one, other) for one, other in inside}

    never = {one.get("link", "") for one in robot.findall("disable_default_collisions")}
    default = {pair for pair in itertools.combinations(links, 2) if not never.isdisjoint(pair)}
    found = (default - read_pairs("enable_collisions")) | read_pairs("disable_collisions")
    return tuple(sorted(found, key=lambda pair: (place[pair[0]], place[pair[1]])))


def disabled_collisions(path: Path, links: Sequence[str], driven: Sequence[str], notes: list[str]) -> Pairs:
    """Pairs of a hand's links whose collisions an SRDF file disables; noted, as are those of the ``driven`` joints that
    it calls passive.

    Raises:
        HandNotLoaded: no SRDF file.
    """
    try:
        robot = parse(str(path), read_bytes(path).decode("utf-8-sig"))
    except (OSError, UnicodeError) as error:
        raise HandNotLoaded(path, f"it cannot be read as SRDF: {error}") from error
    if robot.tag != "robot" or all(robot.find(tag) is None for tag in _TAGS):
        raise HandNotLoaded(path, "expected an SRDF file with <disable_collisions link1= link2=>, found none")
    found = pairs_in(robot, links)
    notes.append(f"pairs of links whose collisions the SRDF disables: {len(found)}")
    if passive := [name for one in robot.findall("passive_joint") if (name := one.get("name", "")) in driven]:
        notes.append(
            f"joints that the SRDF calls passive have motors here (drives= gives others): {', '.join(passive)}"
        )
    return found
