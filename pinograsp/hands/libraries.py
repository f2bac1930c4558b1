"""Hands by the names of two packages that fetch robots' files: ``mujoco_menagerie`` and ``robot_descriptions``."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pinograsp.checks import one_line, shorten
from pinograsp.errors import ExtraMissing, HandNotLoaded

LIBRARIES = ("menagerie", "robot_descriptions")  # what names start with, before a colon

_SUFFIX, _MJCF_SUFFIX = "_description", "_mj_description"
_FORMATS = {"URDF_PATH": "URDF", "XACRO_PATH": "xacro", "MJCF_PATH": "MJCF"}  # the first of a module is taken


@dataclass(frozen=True, slots=True, kw_only=True)
class LibraryFile:
    """The file that a name of a library stands for.

    Attributes:
        path: URDF, xacro or MJCF, on this machine.
        packages: folders of ROS packages that it needs, by name.
        xacro_args: what the library gives a xacro file.
        notes: for the user.
    """

    path: Path
    packages: Mapping[str, Path] = field(default_factory=dict)
    xacro_args: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def is_library_name(name: str) -> bool:
    """Whether a name starts with a library's, as ``menagerie:leap_hand``."""
    return name.partition(":")[0] in LIBRARIES and ":" in name


def list_library(library: str) -> dict[str, str]:
    """What the hands and grippers of a library are, by their names in it. Needs no network.

    Raises:
        ExtraMissing: its package is not installed.
    """
    if library == "menagerie":
        return {robot.name: robot.display_name for robot in _menagerie().robots("end_effector")}
    described = _robot_descriptions().DESCRIPTIONS
    return {name: one.robot for name, one in described.items() if "end_effector" in one.tags}


def find_in_library(name: str) -> LibraryFile:
    """The file of ``library:robot`` or ``library:robot/variant``; the library fetches it if it is not there yet.

    Raises:
        ExtraMissing: the library's package is not installed.
        HandNotLoaded: unknown or ambiguous names, and files that cannot be fetched.
    """
    library, _, inside = name.partition(":")
    robot, _, variant = inside.partition("/")
    find = _find_in_menagerie if library == "menagerie" else _find_in_descriptions
    return find(name, robot, variant)


def _find_in_menagerie(source: str, name: str, variant: str) -> LibraryFile:
    library = _menagerie()
    if name not in library.names():
        raise _explain_unknown(source, name, library.names(), "menagerie")
    robot = library.get(name)
    models = [one.name for one in robot.entry_points if one.kind == "robot"]
    chosen = variant or robot.default_model
    if chosen not in robot.entry_names:
        raise _explain_variant(source, variant, robot.entry_names)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            path = robot.xml(chosen)
    except (library.MenagerieError, OSError) as error:
        raise _explain_fetch(source, error) from error
    return LibraryFile(path=path, notes=_note_variants(f"menagerie:{name}", chosen, [] if variant else models))


def _find_in_descriptions(source: str, name: str, variant: str) -> LibraryFile:
    described = _robot_descriptions().DESCRIPTIONS
    if name in described:
        full = name
    else:
        meant = [name + suffix for suffix in (_SUFFIX, _MJCF_SUFFIX) if name + suffix in described]
        if len(meant) > 1:
            raise HandNotLoaded(source, f"'{name}' is ambiguous: expected {meant[0]} (URDF) or {meant[1]} (MJCF)")
        if not meant:
            raise _explain_unknown(source, name, described, "robot_descriptions")
        full = meant[0]
    try:
        # It clones a repository when it is imported, and prints that.
        with contextlib.redirect_stdout(sys.stderr):
            module = importlib.import_module(f"robot_descriptions.{full}")
    except Exception as error:  # git's own, of a missing git, of the file system
        raise _explain_fetch(source, error) from error
    kind = next((one for one in _FORMATS if hasattr(module, one)), None)
    if kind is None:
        raise HandNotLoaded(source, f"expected a URDF, xacro or MJCF file, and {full} has none")
    start = f"{kind}_"
    variants = {key.removeprefix(start).lower(): key for key in vars(module) if key.startswith(start)}
    if variant and variant not in variants:
        raise _explain_variant(source, variant, variants)
    path = Path(getattr(module, variants[variant] if variant else kind))
    if not os.path.isfile(path):
        raise HandNotLoaded(source, f"robot_descriptions names a file that its repository does not have: {path}")
    return LibraryFile(
        path=path,
        packages={package: Path(folder) for package, folder in getattr(module, "XACRO_PACKAGE_PATHS", {}).items()},
        xacro_args=getattr(module, "XACRO_ARGS", {}) if kind == "XACRO_PATH" else {},
        notes=_note_variants(f"robot_descriptions:{full}", path.name, [] if variant else list(variants)),
    )


def _menagerie() -> Any:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise _explain_missing("menagerie", "mujoco_menagerie", error) from error
    return mujoco_menagerie


def _robot_descriptions() -> Any:
    try:
        import robot_descriptions
    except ImportError as error:
        raise _explain_missing("robot_descriptions", "robot_descriptions", error) from error
    return robot_descriptions


def _explain_missing(library: str, package: str, error: ImportError) -> ExtraMissing:
    return ExtraMissing(f"names that start with {library}: need {package}: pip install 'pinograsp[names]' ({error})")


def _explain_unknown(source: str, name: str, names: Iterable[str], library: str) -> HandNotLoaded:
    """An unknown robot: those that are called alike, or else all hands."""
    if near := difflib.get_close_matches(name, names, n=3):
        return HandNotLoaded(source, f"{library} has no {shorten(name)}; did you mean {' or '.join(near)}?")
    hands = ", ".join(list_library(library))
    return HandNotLoaded(source, f"{library} has no {shorten(name)}; expected one of its robots, as its hands: {hands}")


def _explain_variant(source: str, variant: str, known: Iterable[str]) -> HandNotLoaded:
    expected = ", ".join(known) or "none (it has one file)"
    return HandNotLoaded(source, f"expected one of its files after the '/': {expected}; got {shorten(variant)}")


def _explain_fetch(source: str, error: Exception) -> HandNotLoaded:
    return HandNotLoaded(
        source, f"its file cannot be fetched, which needs the network the first time: {one_line(error, 500)}"
    )


def _note_variants(name: str, chosen: str, variants: list[str]) -> tuple[str, ...]:
    """A note where a robot has several files."""
    if len(variants) < 2:
        return ()
    return (f"{name} has several files, taken is {chosen}; others: {', '.join(f'{name}/{one}' for one in variants)}",)
