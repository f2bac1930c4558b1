"""URDF text made ready for Pinocchio: a sub-tree cut out, files found, couplings resolved, every problem listed at once."""

from __future__ import annotations

import io
import logging
import math
import os
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pinograsp.errors import HandNotLoaded

MOVING = ("revolute", "prismatic")


@dataclass(slots=True)
class Prepared:
    """URDF text that Pinocchio reads as meant.

    Attributes:
        text: the description. robot: yourdfpy's reading of it.
        notes: what was changed or left out, for the user.
    """

    text: str
    robot: object
    notes: list[str] = field(default_factory=list)


def prepare(source: str, text: str, folder: Path, root: str | None = None) -> Prepared:
    """Check and complete a URDF.

    Args:
        source: what to call it in errors. text: the URDF. folder: relative mesh paths start there.
        root: link whose sub-tree is the hand; None: everything.

    Raises:
        HandNotLoaded: with all problems found.
    """
    try:
        robot = ElementTree.fromstring(text.lstrip("\ufeff").strip())
    except ElementTree.ParseError as error:
        raise HandNotLoaded(source, f"not well-formed XML: {error}") from error
    problems, notes = _tree_problems(robot), []
    if problems:
        raise HandNotLoaded(source, problems)
    if root is not None:
        _cut_out(source, robot, root, notes)
    problems += _joint_problems(robot, notes) + _resolve_mimics(robot, notes)
    _find_meshes(robot, folder, notes)
    text = ElementTree.tostring(robot, encoding="unicode")
    read = _read(source, text, problems)
    problems += _inertia_problems(read)
    if problems:
        raise HandNotLoaded(source, problems)
    return Prepared(text=text, robot=read, notes=notes)


def _read(source: str, text: str, problems: list[str]):
    import yourdfpy

    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)  # it logs what it raises; we raise it
    try:
        urdf = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False, build_scene_graph=False)
        urdf.validate()
    except Exception as error:  # yourdfpy raises what its parsers raise: AttributeError, KeyError, ValueError...
        problems.append(f"not a URDF that yourdfpy can read: {error!r}")
        raise HandNotLoaded(source, problems) from error
    problems += [str(getattr(error, "msg", error)) for error in urdf.errors]
    return urdf.robot


def _name(element, tag: str) -> str:
    found = element.find(tag)
    return "" if found is None else found.get("link", "")


def _tree_problems(robot) -> list[str]:
    links = [link.get("name", "") for link in robot.findall("link")]
    joints = robot.findall("joint")
    if not links:
        return ["no <link> found: expected a <robot> with links and joints"]
    problems = [f"{kind} '{name}' is defined {names.count(name)} times" for kind, names in (
        ("link", links), ("joint", [joint.get("name", "") for joint in joints])
    ) for name in sorted(set(names)) if names.count(name) > 1]  # fmt: skip
    children = [_name(joint, "child") for joint in joints]
    for joint in joints:
        problems += [
            f"joint '{joint.get('name')}' names the unknown link '{link}'"
            for link in (_name(joint, "parent"), _name(joint, "child"))
            if link not in links
        ]
    problems += [f"link '{name}' has several parent joints" for name in sorted(set(children)) if children.count(name) > 1]
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        problems.append(f"expected one root link, found {len(roots)}: {', '.join(roots) or 'a loop'}")
    if not any(joint.get("type") in (*MOVING, "continuous") for joint in joints):
        problems.append("no revolute or prismatic joint: expected a hand that moves")
    return problems


def _cut_out(source: str, robot, root: str, notes: list[str]) -> None:
    """Keep the links and joints below ``root`` only."""
    links = [link.get("name") for link in robot.findall("link")]
    if root not in links:
        raise HandNotLoaded(source, f"root '{root}' is not a link; links: {', '.join(links)}")
    kept, below = {root}, True
    while below:
        below = {
            _name(joint, "child")
            for joint in robot.findall("joint")
            if _name(joint, "parent") in kept and _name(joint, "child") not in kept
        }
        kept |= below
    for link in robot.findall("link"):
        if link.get("name") not in kept:
            robot.remove(link)
    for joint in robot.findall("joint"):
        if _name(joint, "parent") not in kept:
            robot.remove(joint)
    for element in list(robot):
        if element.tag not in ("link", "joint", "material"):  # transmissions, sensors and plugins of the whole robot
            robot.remove(element)
    notes.append(f"the sub-tree of '{root}' is the hand: {len(kept)} of {len(links)} links")


def _joint_problems(robot, notes: list[str]) -> list[str]:
    """Check joint types and limits; complete what Pinocchio insists on."""
    problems, without = [], {"effort": [], "velocity": []}
    for joint in robot.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        limit = joint.find("limit")
        if kind == "continuous":
            joint.set("type", "revolute")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", str(-math.pi))
            limit.set("upper", str(math.pi))
            notes.append(f"joint {name} is continuous: taken as revolute between -180 and 180 deg")
        elif kind not in (*MOVING, "fixed"):
            problems.append(f"joint '{name}' is {kind}: only revolute, prismatic and fixed joints are supported")
        if joint.get("type") not in MOVING:
            continue
        bounds = [] if limit is None else [limit.get("lower"), limit.get("upper")]
        if limit is None or None in bounds:
            problems.append(f"joint '{name}' has no position limits: give it <limit lower= upper=>")
            continue
        try:
            lower, upper = map(float, bounds)
            for key in without:
                if not float(limit.get(key, "0")) > 0:
                    limit.set(key, "0")
                    if joint.find("mimic") is None:
                        without[key].append(name)
        except ValueError:
            problems.append(f"joint '{name}': limits must be numbers, got {limit.attrib}")
            continue
        if not (lower < upper and math.isfinite(lower) and math.isfinite(upper)):
            problems.append(f"joint '{name}': lower limit {lower:g} is not below upper {upper:g}")
    for key, names in without.items():
        if names and key == "effort":
            notes.append(f"no effort limit (none given, or 0): {', '.join(names)}")
    return problems


def _resolve_mimics(robot, notes: list[str]) -> list[str]:
    """Make every mimic joint follow an actuated joint directly; the others become independent or fixed."""
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    problems, couplings = [], {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        followed = mimic.get("joint", "")
        if followed not in joints:
            # Exporters add a prefix to the joints and forget it here.
            near = [other for other in joints if followed and other.endswith(followed) and other != name]
            same = [other for other in near if name.startswith(other[: len(other) - len(followed)])]
            if len(same) != 1:
                problems.append(f"joint '{name}' mimics the unknown joint '{followed}'; joints: {', '.join(joints)}")
                continue
            notes.append(f"joint {name} mimics '{followed}', which does not exist: taken as {same[0]}")
            followed = same[0]
        try:
            couplings[name] = (followed, float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0)))
        except ValueError:
            problems.append(f"joint '{name}': mimic multiplier and offset must be numbers, got {mimic.attrib}")
    for name in couplings:
        followed, factor, offset = couplings[name]
        seen = {name}
        while followed in couplings and followed not in seen:
            seen.add(followed)
            followed, further, more = couplings[followed]
            factor, offset = factor * further, factor * more + offset
        mimic = joints[name].find("mimic")
        if followed in seen:
            problems.append(f"joint '{name}' mimics itself through {', '.join(sorted(seen))}: one of them must be free")
        elif joints[followed].get("type") not in MOVING:
            problems.append(f"joint '{name}' mimics '{followed}', which is {joints[followed].get('type')}")
        elif factor == 0:
            problems.append(f"joint '{name}' mimics '{followed}' with multiplier 0: make it a fixed joint")
        else:
            mimic.attrib.update(joint=followed, multiplier=repr(factor), offset=repr(offset))
            _narrow(joints[followed], joints[name], factor, offset, notes)
    return problems


def _narrow(actuated, coupled, factor: float, offset: float, notes: list[str]) -> None:
    """Limits of a coupled joint bound the joint that moves it."""
    own, limit = coupled.find("limit"), actuated.find("limit")
    if own is None or limit is None or None in (own.get("lower"), own.get("upper")):
        return
    ends = sorted((float(own.get(side)) - offset) / factor for side in ("lower", "upper"))
    lower, upper = float(limit.get("lower")), float(limit.get("upper"))
    low, high = max(lower, ends[0]), min(upper, ends[1])
    if high - low < 0.5 * (upper - lower):
        # Limits of coupled joints are often copied without their sign; half the range lost is no range meant.
        notes.append(f"limits of {coupled.get('name')} do not fit what {actuated.get('name')} makes it do: ignored")
    elif (low, high) != (lower, upper):
        limit.set("lower", repr(low))
        limit.set("upper", repr(high))
        notes.append(f"limits of {actuated.get('name')} narrowed to {low:.4g}..{high:.4g} by {coupled.get('name')}")


def _find_meshes(robot, folder: Path, notes: list[str]) -> None:
    """Replace mesh names by absolute paths; geometry whose file is missing is left out."""
    missing = []
    for link in robot.findall("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                mesh = element.find("geometry/mesh")
                if mesh is None:
                    continue
                path = mesh_path(mesh.get("filename", ""), folder)
                if path is None:
                    link.remove(element)
                    if kind == "collision":
                        missing.append(f"{link.get('name')} ({mesh.get('filename')})")
                else:
                    mesh.set("filename", str(path))
    if missing:
        notes.append(f"meshes not found, so these links cannot touch anything: {', '.join(missing)}")


def mesh_path(name: str, folder: Path) -> Path | None:
    """The file that ``package://``, ``file://``, absolute or relative ``name`` means, or None."""
    name = name.replace("\\", "/")
    if name.startswith("file://"):
        name = name[len("file://") :]
    if "://" in name:
        name = name.split("://", 1)[1].lstrip("/")
        packages = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        # Beside the file's own package, then where ROS looks, then the package's folder under another name.
        places = [*(above / name for above in (folder, *folder.parents)), *(p / name for p in packages)]
        inside = name.split("/", 1)[-1]
        places += [above / inside for above in (folder, *list(folder.parents)[:3])]
        places += [p.parent / name for p in packages]
    else:
        places = [Path(name) if Path(name).is_absolute() else folder / name]
    return next((place.resolve() for place in places if place.is_file()), None)


def _inertia_problems(robot) -> list[str]:
    problems = []
    links = {link.name: link for link in robot.links}
    for joint in robot.joints:
        if joint.type in MOVING and _bodies_without_inertial(robot, links, joint.child):
            problems.append(f"link '{joint.child}' moves but has no <inertial>: torques would be wrong, add one")
    for link in robot.links:
        if link.inertial is None:
            continue
        mass, inertia = link.inertial.mass, link.inertial.inertia
        if mass is None or inertia is None:
            problems.append(f"link '{link.name}': <inertial> needs both <mass> and <inertia>")
        elif not (np.isfinite(mass) and mass >= 0 and np.all(np.isfinite(inertia))):
            problems.append(f"link '{link.name}': mass and inertia must be finite and mass >= 0, got mass {mass}")
        elif np.linalg.eigvalsh(inertia).min() < -1e-9 * max(np.abs(inertia).max(), 1e-12):
            problems.append(f"link '{link.name}': inertia matrix is not positive semi-definite")
    return problems


def _bodies_without_inertial(robot, links, link: str) -> bool:
    """Whether neither the link nor anything fixed to it carries an <inertial> element."""
    if link not in links or links[link].inertial is not None:
        return False
    fixed = [j.child for j in robot.joints if j.parent == link and j.type == "fixed"]
    return all(_bodies_without_inertial(robot, links, child) for child in fixed)
