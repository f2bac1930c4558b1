"""URDF prepared for Pinocchio: a sub-tree cut out, files found, couplings resolved, every problem listed at once."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from pinograsp.checks import one_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.coupling import Coupling, Limits, in_order, led_from_the_front, narrowed, resolve
from pinograsp.hands.elements import LARGEST, LEAST, as_rpy, drop, end_of, named, numbers, written
from pinograsp.hands.geometry import Shape, Triangles
from pinograsp.hands.ros_packages import Packages
from pinograsp.hands.rotors import rotors
from pinograsp.hands.shapes import shapes_of, take_visuals
from pinograsp.hands.tree import JOINT_TYPES, MOVING, Joint
from pinograsp.hands.urdf_masses import MOMENTS, inertia_problems, unweighed_joints
from pinograsp.hands.urdf_tree import cut_out, joints_below, leave_out, tree_problems
from pinograsp.spatial import FARTHEST

# How many numbers an attribute holds and how large each may be, by element.
_NUMBERS: dict[str, dict[str, tuple[int, float]]] = {
    "origin": {"xyz": (3, FARTHEST), "rpy": (3, LARGEST)},
    "axis": {"xyz": (3, LARGEST)},
    "mass": {"value": (1, LARGEST)},
    "inertia": dict.fromkeys(MOMENTS, (1, LARGEST)),
    "mimic": {"multiplier": (1, LARGEST), "offset": (1, LARGEST)},
    "dynamics": {"damping": (1, LARGEST), "friction": (1, LARGEST), "armature": (1, LARGEST)},
}
# Of a whole robot, for Pinocchio builds trees by recursion; of a hand, for Pinocchio's memory grows with the cube of
# its joints.
_MOST_LINKS, _MOST_MOVING, _MOST_SHAPES = 2000, 100, 2000
# Range of a joint that is play [m or rad], and of the widest of the hand's.
_PLAY, _PLAY_SHARE = {"prismatic": 1e-4, "revolute": 1e-3}, 1e-2
_CUT = "root= is the link that a hand on a robot starts from"


@dataclass(slots=True)
class Prepared:
    """A description checked and completed.

    Attributes:
        name: of the hand.
        text: URDF for Pinocchio, without geometry.
        aliases: the names of joints in ``text``, by which Pinocchio orders them, and their own.
        joints, links: of the tree.
        followed: by joint that follows another, that one.
        shapes: what can touch.
        visuals: what is seen.
        unweighed: joints that move links without inertia.
        armatures: inertia of the motors [kg m^2], by actuated joint.
        efforts: limits of the joints by themselves, coupled ones included [N m or N]; 0: none.
        continuous: joints that turn without end.
        notes: what was changed or left out, for the user.
    """

    name: str
    text: str = ""
    aliases: dict[str, str] = field(default_factory=dict)
    joints: list[Joint] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    followed: dict[str, str] = field(default_factory=dict)
    shapes: list[Shape] = field(default_factory=list)
    visuals: list[Shape] = field(default_factory=list)
    unweighed: list[str] = field(default_factory=list)
    armatures: dict[str, float] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)
    continuous: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def prepare(
    source: str,
    robot: ElementTree.Element,
    folder: Path,
    root: str | None = None,
    problems: Iterable[str] = (),
    notes: Iterable[str] = (),
    packages: Packages = MappingProxyType({}),
    inline: Mapping[str, Triangles] = MappingProxyType({}),
) -> Prepared:
    """Check and complete a URDF; ``robot`` is changed.

    Args:
        source: what to call it in errors.
        robot: the URDF.
        folder: relative mesh paths start there.
        root: link whose sub-tree is the hand; None: everything.
        problems, notes: found before, to be listed with the others.
        packages: folders of ROS packages, by name.
        inline: meshes that come from no file, by the names that the URDF has for them.

    Raises:
        HandNotLoaded: with all problems found.
    """
    problems, notes = list(problems), list(notes)
    _check_count(source, "links", len(robot.findall("link")), _MOST_LINKS)
    _check_count(source, "joints", len(robot.findall("joint")), _MOST_LINKS)
    outside: set[str] = cut_out(source, robot, root, notes) if root is not None else set()
    shapes = len(robot.findall("link/collision"))
    _check_count(source, f"collision shapes ({_CUT})", shapes, _MOST_SHAPES)
    moving = sum(joint.get("type") != "fixed" for joint in robot.findall("joint"))
    _check_count(source, f"moving joints ({_CUT})", moving, _MOST_MOVING)
    for _, joint in named(robot, "joint"):
        if joint.get("type") == "fixed":  # it follows nothing and needs no axis
            drop(joint, "mimic", "limit", "axis")
    visuals = take_visuals(robot, folder, packages, inline)
    unreadable = _number_problems(robot)
    _lock(robot, notes)
    broken = tree_problems(robot, root)
    if not (broken or unreadable):
        _hold(robot, rotors(robot, folder, packages, inline), notes)
    limits, joint_problems, continuous = _limits(robot, notes)
    couplings, mimic_problems = _couplings(robot, outside, notes)
    unweighed, weightless = ([], []) if broken else unweighed_joints(robot)
    problems += broken + unreadable + joint_problems + mimic_problems + inertia_problems(robot, notes) + weightless
    if problems:
        raise HandNotLoaded(source, problems)
    joints = [
        Joint(
            name=name,
            type=one_of(f"type of joint '{name}'", joint.get("type"), JOINT_TYPES),
            parent=end_of(joint, "parent"),
            child=end_of(joint, "child"),
        )
        for name, joint in named(robot, "joint")
    ]
    followed = {name: one.followed for name, one in couplings.items()}
    order = in_order(joints, couplings)
    efforts = {name: one.effort for name, one in limits.items()}
    couplings, limits = led_from_the_front(order, couplings, narrowed(limits, couplings, notes), notes)
    without = [joint.name for joint in joints if joint.name in limits and not limits[joint.name].effort]
    if without:
        notes.append(f"no effort limit (none given, or 0): {', '.join(without)}")
    notes += [f"joint {joint.name} follows {couplings[joint.name]}" for joint in joints if joint.name in couplings]
    prepared = Prepared(name=robot.get("name") or Path(source).stem, joints=joints, followed=followed, notes=notes)
    prepared.links = [name for name, _ in named(robot, "link")]
    prepared.shapes = shapes_of(robot, folder, packages, notes, inline)
    prepared.visuals = visuals
    prepared.efforts = efforts
    prepared.unweighed = unweighed
    prepared.armatures = _armatures(robot, couplings)
    # What follows one may have an end.
    prepared.continuous = [name for name in continuous if name not in (*couplings, *followed.values())]
    prepared.aliases = {f"{place:04d} {name}": name for place, name in enumerate(order)} if couplings else {}
    prepared.text = _text(robot, couplings, limits, {own: alias for alias, own in prepared.aliases.items()})
    return prepared


def _check_count(source: str, what: str, count: int, most: int) -> None:
    if count > most:
        raise HandNotLoaded(source, f"expected at most {most} {what}, got {count}")


# -- numbers, limits, couplings ----------------------------------------------------------------------------------------


def _number_problems(robot: ElementTree.Element) -> list[str]:
    """Attributes that are not the numbers they should be; those of shapes are looked at with the shapes."""
    problems = []
    for tag in ("link", "joint"):
        for name, element in named(robot, tag):
            for part in element.iter():
                problems += [f"{tag} '{name}': {problem}" for problem in as_rpy(part)]
                for key, (count, most) in _NUMBERS.get(part.tag, {}).items():
                    if part.get(key) is None:
                        continue
                    try:
                        values = numbers(part, key, count, most=most)
                    except ValueError as error:
                        problems.append(f"{tag} '{name}': <{part.tag} {key}=>: {error}")
                        continue
                    part.set(key, written(values))
                    if part.tag == "axis" and max(map(abs, values)) < LEAST:
                        problems.append(f"{tag} '{name}': <axis xyz=> is zero, expected a direction")
    return problems


def _lock(robot: ElementTree.Element, notes: list[str]) -> None:
    """Fix joints that cannot move, but for play: with (almost) one limit for both sides, or following another 0 times;
    and what follows them.

    Where no joint has a range the limits were forgotten: they stay, to be listed.
    """
    joints = {name: joint for name, joint in named(robot, "joint") if joint.get("type") in MOVING}
    at: dict[str, float] = {}
    ranges = {name: _ends(joint) for name, joint in joints.items() if joint.find("mimic") is None}
    widest = max((upper - lower for lower, upper in ranges.values() if lower < upper), default=0.0)
    if widest > 0:
        at = {
            name: min(max(lower, 0.0), upper)
            for name, (lower, upper) in ranges.items()
            if 0 <= upper - lower <= min(_PLAY[joints[name].get("type", "")], _PLAY_SHARE * widest)
            and max(abs(lower), abs(upper)) <= LARGEST
        }
    following: dict[str, tuple[str, float, float]] = {}
    for name, joint in joints.items():
        if (mimic := joint.find("mimic")) is None:
            continue
        try:
            (factor,), (offset,) = numbers(mimic, "multiplier", 1, "1"), numbers(mimic, "offset", 1, "0")
        except ValueError:
            continue  # listed with the other numbers
        following[name] = mimic.get("joint", ""), factor, offset
        if factor == 0 and abs(offset) <= LARGEST:
            at[name] = offset
    while more := {
        name: factor * at[followed] + offset
        for name, (followed, factor, offset) in following.items()
        if followed in at and name not in at
    }:
        at.update(more)
    for name, value in at.items():
        _fix(joints[name], value)
    if at:
        notes.append(f"joints without a way to go are fixed: {', '.join(sorted(at))}")


def _hold(robot: ElementTree.Element, rotors: list[str], notes: list[str]) -> None:
    """Fix joints that turn a bar or wheel about its own middle, and one that lets a whole hand float; leave out what
    floats and does not move by itself, as an object of a scene.
    """
    joints = dict(named(robot, "joint"))
    for name in rotors:
        _fix(joints[name], 0.0)
    if rotors:
        notes.append(f"joints that only turn a bar or wheel about its middle are fixed: {', '.join(rotors)}")
    moving = {name for name, joint in joints.items() if joint.get("type") in (*MOVING, "continuous")}
    for name, joint in joints.items():
        carried = moving & joints_below(robot, end_of(joint, "child"))
        if joint.get("type") != "floating":
            continue
        if not carried:
            leave_out(robot, end_of(joint, "child"))
            notes.append(f"'{end_of(joint, 'child')}' floats freely and has no joints: left out")
        elif carried == moving:
            _fix(joint, 0.0)
            notes.append(f"joint '{name}' lets the whole hand float: taken as fixed, pose= places the hand")


def _ends(joint: ElementTree.Element) -> tuple[float, float]:
    """Lower and upper limit of a joint; not a number where there is none."""
    limit = joint.find("limit")
    try:
        lower, upper = (math.nan if limit is None else float(limit.get(side, "nan")) for side in ("lower", "upper"))
    except ValueError:
        return math.nan, math.nan
    return lower, upper


def _fix(joint: ElementTree.Element, value: float) -> None:
    """Fix a joint where it is at ``value`` [rad or m]; numbers that cannot be read are listed elsewhere."""
    origin, axis = joint.find("origin"), joint.find("axis")
    if value:
        origin = ElementTree.SubElement(joint, "origin") if origin is None else origin
        try:
            direction = np.array([1.0, 0.0, 0.0] if axis is None else numbers(axis, "xyz", 3, "1 0 0"))
            xyz, rpy = (numbers(origin, key, 3, "0 0 0") for key in ("xyz", "rpy"))
        except ValueError:
            return
        way = value * direction / max(float(np.linalg.norm(direction)), LEAST)
        turns = joint.get("type") == "revolute"
        moved = pin.SE3(pin.exp3(way), np.zeros(3)) if turns else pin.SE3(np.eye(3), way)
        placed = pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz)) * moved
        origin.set("xyz", written(placed.translation))
        origin.set("rpy", written(pin.rpy.matrixToRpy(placed.rotation)))
    joint.set("type", "fixed")
    drop(joint, "mimic", "limit", "axis", "dynamics")


def _limits(robot: ElementTree.Element, notes: list[str]) -> tuple[dict[str, Limits], list[str], list[str]]:
    """Limits of the moving joints, the problems with them and with joint types, and the joints that are continuous."""
    limits: dict[str, Limits] = {}
    problems: list[str] = []
    continuous: list[str] = []
    for name, joint in named(robot, "joint"):
        kind, limit = joint.get("type"), joint.find("limit")
        given = {} if limit is None else limit.attrib
        coupled = joint.find("mimic") is not None
        if kind == "continuous":
            joint.set("type", "revolute")
            given = {**given, "lower": repr(-math.pi), "upper": repr(math.pi)}
            if coupled:
                continue  # it turns as far as what it follows
            continuous.append(name)
        elif kind == "floating":
            problems.append(f"joint '{name}' floats freely: give root= the hand's palm, or fix it")
            continue
        elif kind not in (*MOVING, "fixed"):
            problems.append(
                f"joint '{name}' is {kind or 'without a type'}: only revolute, continuous, prismatic and fixed joints "
                "are supported"
            )
            continue
        if joint.get("type") not in MOVING:
            continue
        try:
            lower, upper = (float(given[side]) if side in given else math.nan for side in ("lower", "upper"))
            most = {key: float(given.get(key, "0")) for key in ("effort", "velocity")}
        except ValueError:
            problems.append(f"joint '{name}': limits must be numbers, got {given}")
            continue
        # Nobody means more than LARGEST: it stands for no limit.
        most = {key: value if 0 < value <= LARGEST else 0.0 for key, value in most.items()}
        problems += [
            f"joint '{name}': {key} limit {value:g} is next to nothing: expected 0 for none, or {LEAST:g} and more"
            for key, value in most.items()
            if 0 < value < LEAST
        ]
        sound = upper - lower >= LEAST and max(abs(lower), abs(upper)) <= LARGEST
        if sound:
            limits[name] = Limits(lower=lower, upper=upper, **most)
        elif coupled:
            continue  # what it follows bounds it
        elif "lower" not in given or "upper" not in given:
            problems.append(f"joint '{name}' has no position limits: give it <limit lower= upper=> (in MJCF: range=)")
        else:
            beyond = f", or beyond {LARGEST:g}" if max(abs(lower), abs(upper)) > LARGEST else ""
            problems.append(
                f"joint '{name}': lower limit {lower:g} is not below upper {upper:g}{beyond}: correct <limit>, or "
                "make it a fixed joint"
            )
    if continuous:
        notes.append(
            f"continuous joints taken as revolute between -180 and 180 deg: {', '.join(continuous)}; the path of an "
            "arm may pass these"
        )
    return limits, problems, continuous


def _couplings(
    robot: ElementTree.Element, outside: set[str], notes: list[str]
) -> tuple[dict[str, Coupling], list[str]]:
    """Couplings of the mimic joints to joints that follow none, and the problems with them."""
    joints = dict(named(robot, "joint"))
    problems: list[str] = []
    couplings: dict[str, Coupling] = {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        followed = mimic.get("joint", "")
        if followed in outside:
            problems.append(f"joint '{name}' mimics '{followed}', which root= leaves out: choose a root with both")
            continue
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
            (factor,), (offset,) = numbers(mimic, "multiplier", 1, "1"), numbers(mimic, "offset", 1, "0")
        except ValueError:
            continue  # listed with the other numbers
        couplings[name] = Coupling(followed=followed, factor=factor, offset=offset)
    direct, more = resolve(couplings, {name: joint.get("type") for name, joint in joints.items()})
    return direct, problems + more


def _armatures(robot: ElementTree.Element, couplings: dict[str, Coupling]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, joint in named(robot, "joint"):
        dynamics = joint.find("dynamics")
        value = 0.0 if dynamics is None else float(dynamics.get("armature", "0"))
        if joint.get("type") in MOVING and value > 0:
            coupling = couplings.get(name, Coupling(followed=name, factor=1.0, offset=0.0))
            found[coupling.followed] = found.get(coupling.followed, 0.0) + coupling.factor**2 * value
    return found


# -- for Pinocchio -----------------------------------------------------------------------------------------------------


def _text(
    robot: ElementTree.Element, couplings: dict[str, Coupling], limits: dict[str, Limits], aliases: dict[str, str]
) -> str:
    """URDF with only what Pinocchio needs: one of each element per joint, one inertial per link."""
    out = ElementTree.Element("robot", name=robot.get("name") or "hand")
    for name, link in named(robot, "link"):
        body = ElementTree.SubElement(out, "link", name=name)
        if (inertial := link.find("inertial")) is not None:
            body.append(inertial)
    for name, joint in named(robot, "joint"):
        kept = ElementTree.SubElement(out, "joint", name=aliases.get(name, name), type=joint.get("type", ""))
        kept.extend(part for tag in ("origin", "parent", "child", "axis") if (part := joint.find(tag)) is not None)
        if joint.get("type") in MOVING:
            own = limits.get(name, Limits(lower=-1.0, upper=1.0))  # those of a coupled joint are not used
            ElementTree.SubElement(
                kept, "limit", {key: repr(getattr(own, key)) for key in ("lower", "upper", "effort", "velocity")}
            )
        if name in couplings:
            one = couplings[name]
            ElementTree.SubElement(
                kept, "mimic", joint=aliases[one.followed], multiplier=repr(one.factor), offset=repr(one.offset)
            )
        elif (dynamics := joint.find("dynamics")) is not None:
            given = dynamics.attrib
            ElementTree.SubElement(kept, "dynamics", {k: given[k] for k in ("damping", "friction") if k in given})
    return ElementTree.tostring(out, encoding="unicode")
