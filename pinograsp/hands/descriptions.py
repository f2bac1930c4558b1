"""What the name, file, text or specification of a hand says: its links and joints, motors and springs."""

from __future__ import annotations

import codecs
import copy
import difflib
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pinograsp.checks import mapping_of, path_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.catalogue import CATALOGUE, convex_parts_of, file_of
from pinograsp.hands.elements import is_text, parse, read_bytes
from pinograsp.hands.finger_names import Labels
from pinograsp.hands.libraries import LIBRARIES, find_in_library, is_library_name
from pinograsp.hands.mesh_file import LFS_POINTER
from pinograsp.hands.motors import Actuation
from pinograsp.hands.ros_packages import packages_of
from pinograsp.hands.shapes import MeshNames
from pinograsp.hands.urdf_couplings import add_couplings
from pinograsp.hands.urdf_drives import actuation_of
from pinograsp.hands.urdf_file import read_urdf
from pinograsp.hands.urdf_tree import cut_out

if TYPE_CHECKING:
    import mujoco
    import yourdfpy

    from pinograsp.hands.mjcf_source import Compiled

# Python knows others, some of which take hours for a small file.
_ENCODINGS = r"utf-?8(-sig)?|utf-?16|us-ascii|ascii|latin-?1|iso-?8859-?\d+|(windows-|cp)\d+"


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotDescription:
    """What a source says of a hand.

    Attributes:
        name: what to call it in errors.
        robot: links and joints.
        armatures: inertia of the motors [kg m^2], by joint.
        names: what the names of its meshes mean.
        actuation: motors and springs.
        collisions: pairs of links that are not looked at for collisions, as SRDF has them.
        root: link whose sub-tree it is of a larger robot; None: all of it.
        outside: joints of that robot.
        labels: other names that tell what fingers are called.
        problems, notes: found so far.
    """

    name: str
    robot: yourdfpy.Robot
    names: MeshNames
    collisions: ElementTree.Element
    armatures: Mapping[str, float] = field(default_factory=dict)
    actuation: Actuation = field(default_factory=Actuation)
    root: str | None = None
    outside: Collection[str] = ()
    labels: Labels = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_description(
    source: object,
    root: str | None,
    trusted: bool,
    packages: Mapping[str, str | Path] | None,
    xacro_args: Mapping[str, object] | None,
) -> RobotDescription:
    """The description that a name, a path, a text or a specification of MuJoCo's stands for.

    ``root`` is the link whose sub-tree is the hand; the others are those of :func:`pinograsp.load_hand`.

    Raises:
        HandNotLoaded: the file is missing or broken.
        ExtraMissing: the name is one of a library that is not installed.
        InvalidInput: packages or arguments that are none.
    """
    folders = packages_of(packages)
    arguments = dict(mapping_of("xacro_args", {} if xacro_args is None else xacro_args, "{name: value}"))
    if type(source).__name__ == "MjSpec":
        from pinograsp.hands.mjcf_source import compile_spec

        spec = cast("mujoco.MjSpec", source)
        return _from_mjcf(spec.modelname, compile_spec(spec.modelname, spec), root, MeshNames(folder=Path()))
    name = source if isinstance(source, str) else str(path_of("hand", source))
    notes = list[str]()
    if is_text(name):
        path, text, name = Path("text.xml"), name, "text"
    else:
        if is_library_name(name):
            found = find_in_library(name)
            path, notes = found.path, list(found.notes)
            folders, arguments = {**found.packages, **folders}, {**found.xacro_args, **arguments}
        else:
            path = file_of(name) if name in CATALOGUE else _find_file(name)
        text = "" if path.suffix.lower() == ".xacro" else _read_text(name, path)
    if path.suffix.lower() == ".xacro":
        from pinograsp.hands.xacro_files import expand_xacro  # its evaluator takes 50 ms to import

        text = expand_xacro(path, arguments, trusted=trusted, packages=folders)
    elif arguments:
        raise HandNotLoaded(name, f"arguments {', '.join(arguments)} given, but only xacro files take arguments")
    element, names = parse(name, text), MeshNames(folder=path.resolve().parent, packages=folders)
    if element.tag == "mujoco":
        from pinograsp.hands.mjcf_source import compile_file

        described = _from_mjcf(name, compile_file(name, element, path, trusted), root, names)
        return replace(described, notes=[*notes, *described.notes])
    if name in CATALOGUE:
        _put_convex_parts(element, convex_parts_of(name))
    problems = list[str]()
    add_couplings(element, problems, notes)
    actuation = actuation_of(element, problems)
    outside = set() if root is None else cut_out(name, element, root, notes)
    robot, armatures = read_urdf(element, problems)
    return RobotDescription(
        name=name,
        robot=robot,
        armatures=armatures,
        names=names,
        actuation=actuation,
        collisions=element,
        root=root,
        outside=outside,
        problems=problems,
        notes=notes,
    )


def _from_mjcf(name: str, compiled: Compiled, root: str | None, names: MeshNames) -> RobotDescription:
    from pinograsp.hands.mjcf import MjcfRobot

    read = MjcfRobot(name, compiled, root)
    return RobotDescription(
        name=name,
        robot=read.robot,
        armatures=read.armatures,
        names=replace(names, inline=read.inline),
        actuation=read.actuation,
        collisions=read.collisions,
        labels=read.labels,
        problems=read.problems,
        notes=read.notes,
    )


def _put_convex_parts(robot: ElementTree.Element, parts: Mapping[str, list[Path]]) -> None:
    """Put the files of convex parts where a collision shape has the mesh that they stand for."""
    for link in robot.iter("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            files = [] if mesh is None else parts.get(Path(mesh.get("filename", "")).stem, [])
            for path in files:
                part = copy.deepcopy(collision)
                cast(ElementTree.Element, part.find("geometry/mesh")).set("filename", str(path))
                link.append(part)
            if files:
                link.remove(collision)


def _find_file(name: str) -> Path:
    """The file called ``name``, which is no name of the catalogue."""
    try:
        path = Path(name).expanduser()
    except RuntimeError:  # of an unknown user: ~name
        path = Path(name)
    if os.path.isfile(path):
        return path
    near = difflib.get_close_matches(name, CATALOGUE, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise HandNotLoaded(
        name,
        f"no such file; expected a .urdf, .xacro or MJCF .xml file, a name of a library "
        f"({', '.join(f'{one}:NAME' for one in LIBRARIES)}), or one of: {', '.join(CATALOGUE)}{hint}",
    )


def _read_text(name: str, path: Path) -> str:
    """Text of an XML file, in the encoding that it declares."""
    try:
        content = read_bytes(path)
        if content.startswith(LFS_POINTER):
            raise LookupError("it is a pointer of Git LFS to the file: run 'git lfs pull' where it was cloned")
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return content.decode("utf-16")
        declared = re.match(rb"\s*<\?xml[^>]*encoding=[\"']([A-Za-z0-9._-]+)", content)
        encoding = declared[1].decode() if declared else "utf-8-sig"
        if not re.fullmatch(_ENCODINGS, encoding, re.IGNORECASE):
            raise LookupError(f"encoding '{encoding}' is not supported: save it as UTF-8")
        return content.decode(encoding)
    except (OSError, UnicodeError, LookupError) as error:
        raise HandNotLoaded(name, f"cannot be read as text: {error}") from error
