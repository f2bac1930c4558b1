"""ROS packages without ROS: folders with a ``package.xml`` that gives their name."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

from pinograsp.checks import mapping_of, path_of, shorten, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.elements import parse_xml, read_bytes

NAME = re.compile(r"[A-Za-z][\w.-]*")


Packages: TypeAlias = Mapping[str, Path]  # folders by the names of the packages


class PackageNotFound(Exception):
    """A package that is nowhere, and ``others`` that are not, either."""

    def __init__(self, name: str, others: str = ""):
        nor = f" (nor of {others})" if others else ""
        super().__init__(
            f"'$(find {name})': no package.xml of that name{nor} in the folders above or in ROS_PACKAGE_PATH: its "
            "folder is to be given by packages="
        )


def packages_of(given: Mapping[str, str | Path] | None) -> Packages:
    """Packages and their folders as a user gives them.

    Raises:
        InvalidInput: names that no package has, and folders that do not exist.
    """
    found: dict[str, Path] = {}
    for name, folder in mapping_of("packages", {} if given is None else given, "{name: folder}").items():
        if not NAME.fullmatch(text_of("name of a package", name)):
            raise InvalidInput(f"packages: expected the name of a ROS package, got {shorten(name)}")
        path = path_of(f"folder of package '{name}'", folder).expanduser()
        if not path.is_dir():
            raise InvalidInput(f"packages: expected the folder of package '{name}', got '{folder}', which is none")
        found[name] = path.resolve()
    return found


def find_package(name: str, folder: Path, packages: Packages) -> Path | None:
    """The folder of a package, or None: a given one, one that ``folder`` is in, one beside it, or where ROS looks.

    ``ROS_PACKAGE_PATH`` lists folders that hold packages, ``AMENT_PREFIX_PATH`` ROS 2's installations.
    """
    if name in packages:
        return packages[name]
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
