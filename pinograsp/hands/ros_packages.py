"""ROS packages without ROS: folders with a ``package.xml`` that gives their name."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from pinograsp.hands.elements import parse_xml, read_bytes

NAME = re.compile(r"[A-Za-z][\w.-]*")


def find_package(name: str, folder: Path) -> Path | None:
    """The folder of a package, or None: one that ``folder`` is in, one beside it, or where ROS looks for them.

    ``ROS_PACKAGE_PATH`` lists folders that hold packages, ``AMENT_PREFIX_PATH`` ROS 2's installations.
    """
    if not NAME.fullmatch(name):
        return None
    for place in _places(name, folder.resolve()):
        if _name_of(place / "package.xml") == name:
            return place
    return None


def _places(name: str, folder: Path) -> Iterator[Path]:
    yield from (folder, *folder.parents)
    yield from (above / name for above in (folder, *folder.parents))
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for one in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield from ((Path(one) / inside).resolve(), (Path(one) / inside / name).resolve())


def _name_of(path: Path) -> str | None:
    """The name that a package.xml gives; None where it cannot be read."""
    if not os.path.isfile(path):
        return None
    try:
        return (parse_xml(read_bytes(path)).findtext("name") or "").strip()
    except (OSError, ValueError, SyntaxError):
        return None
