"""URDF prepared for Pinocchio: couplings resolved, limits and masses checked, every problem listed at once."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.coupling import Coupling, Limits, in_order, led_from_the_front, narrow_limits, resolve
from pinograsp.hands.elements import LARGEST, LEAST
from pinograsp.hands.geometry import Shape
from pinograsp.hands.rotors import find_rotors
from pinograsp.hands.shapes import choose_shapes, read_shapes, read_visuals
from pinograsp.hands.tree import MOVING
from pinograsp.hands.urdf_masses import find_unweighed, mend_inertias
from pinograsp.hands.urdf_tree import find_tree_problems, links_below
from pinograsp.spatial import Array

if TYPE_CHECKING:
    import yourdfpy

    from pinograsp.hands.descriptions import RobotDescription

# Of a whole robot, for Pinocchio builds trees by recursion; of a hand, for Pinocchio's memory grows with the cube of
# its joints.
_MOST_LINKS, _MOST_MOVING, _MOST_SHAPES = 2000, 100, 2000
# Range of a joint that is play [m or rad], and of the widest of the hand's.
_PLAY, _PLAY_SHARE = {"prismatic": 1e-4, "revolute": 1e-3}, 1e-2
_CUT = "root= is the link that a hand on a robot starts from"


@dataclass(slots=True)
class PreparedHand:
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
    joints: list[yourdfpy.Joint] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    followed: dict[str, str] = field(default_factory=dict)
    shapes: list[Shape] = field(default_factory=list)
    visuals: list[Shape] = field(default_factory=list)
    unweighed: list[str] = field(default_factory=list)
    armatures: dict[str, float] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)
    continuous: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def prepare_hand(
    description: RobotDescription, given_limits: Mapping[str, tuple[float, float]] = MappingProxyType({})
) -> PreparedHand:
    """Check and complete a description, whose robot is changed; ``given_limits``: positions [rad or m] for joints
    whose own limits have no range between them.

    Raises:
        HandNotLoaded: with all problems found.
    """
    source, robot, names = description.name, description.robot, description.names
    _check_counts(source, robot)
    problems, notes = list(description.problems), list(description.notes)
    visuals = read_visuals(robot, names)
    _mend_limits(robot, given_limits)
    _fix_still_joints(robot, notes)
    broken = find_tree_problems(robot, description.root)
    if not (broken or problems):
        _fix_idle_joints(robot, find_rotors(robot, names), notes)
    limits, joint_problems, continuous = _read_limits(robot, notes)
    couplings, mimic_problems = _resolve_mimics(robot, description.outside, notes)
    shapes, of_shapes = list[Shape](), list[str]()
    if not broken:
        moved = set[str]().union(*(links_below(robot, joint.child) for joint in robot.joints if joint.type in MOVING))
        shapes = choose_shapes(read_shapes(robot, names, of_shapes), visuals, moved, of_shapes)
    shaped = {shape.link for shape in shapes}
    unweighed, weightless = ([], []) if broken else find_unweighed(robot, shaped)
    problems += broken + joint_problems + mimic_problems + mend_inertias(robot, notes) + weightless
    if problems:
        raise HandNotLoaded(source, problems)
    followed = {name: one.followed for name, one in couplings.items()}
    order = in_order(robot.joints, couplings)
    efforts = {name: one.effort for name, one in limits.items()}
    couplings, limits = led_from_the_front(order, couplings, narrow_limits(limits, couplings, notes), notes)
    joints = [joint.name for joint in robot.joints]
    without = [name for name in joints if name in limits and not limits[name].effort]
    if without:
        notes.append(f"no effort limit (none given, or 0): {', '.join(without)}")
    following: dict[str, list[str]] = {}
    for name in joints:
        if name in couplings:
            following.setdefault(str(couplings[name]), []).append(name)
    notes += [
        f"joint {', '.join(names)} follows {other}" if len(names) == 1 else f"joints {', '.join(names)} follow {other}"
        for other, names in following.items()
    ]
    aliases = {f"{place:04d} {name}": name for place, name in enumerate(order)} if couplings else {}
    return PreparedHand(
        name=robot.name or Path(source).stem,
        text=_write_text(robot, couplings, limits, {own: alias for alias, own in aliases.items()}),
        aliases=aliases,
        joints=robot.joints,
        links=[link.name for link in robot.links],
        followed=followed,
        shapes=shapes,
        visuals=visuals,
        unweighed=unweighed,
        armatures=_carry_over(robot, couplings, description.armatures),
        efforts=efforts,
        # What follows one may have an end.
        continuous=[name for name in continuous if name not in (*couplings, *followed.values())],
        notes=[*notes, *of_shapes],
    )


def _check_counts(source: str, robot: yourdfpy.Robot) -> None:
    shapes = sum(len(link.collisions) for link in robot.links)
    moving = sum(joint.type != "fixed" for joint in robot.joints)
    for what, count, most in (
        ("links", len(robot.links), _MOST_LINKS),
        ("joints", len(robot.joints), _MOST_LINKS),
        (f"collision shapes ({_CUT})", shapes, _MOST_SHAPES),
        (f"moving joints ({_CUT})", moving, _MOST_MOVING),
    ):
        if count > most:
            raise HandNotLoaded(source, f"expected at most {most} {what}, got {count}")


# -- limits, couplings -------------------------------------------------------------------------------------------------


def _mend_limits(robot: yourdfpy.Robot, limits: Mapping[str, tuple[float, float]]) -> None:
    """Put position limits where the file's own have no range between them."""
    from yourdfpy import Limit

    for joint in robot.joints:
        lower, upper = _ends(joint)
        if joint.name in limits and not lower < upper:
            lower, upper = array_of(f"limits of '{joint.name}'", limits[joint.name], (2,)).tolist()
            most = {key: getattr(joint.limit, key, None) or 0.0 for key in ("effort", "velocity")}
            joint.limit = Limit(lower=lower, upper=upper, **most)


def _fix_still_joints(robot: yourdfpy.Robot, notes: list[str]) -> None:
    """Fix joints that cannot move, but for play: with (almost) one limit for both sides, or following another 0 times;
    and what follows them.

    Where no joint has a range the limits were forgotten: they stay, to be listed.
    """
    joints = {joint.name: joint for joint in robot.joints if joint.type in MOVING}
    at: dict[str, float] = {}
    ranges = {name: _ends(joint) for name, joint in joints.items() if joint.mimic is None}
    widest = max((upper - lower for lower, upper in ranges.values() if lower < upper), default=0.0)
    if widest > 0:
        at = {
            name: min(max(lower, 0.0), upper)
            for name, (lower, upper) in ranges.items()
            if 0 <= upper - lower <= min(_PLAY[joints[name].type], _PLAY_SHARE * widest)
            and max(abs(lower), abs(upper)) <= LARGEST
        }
    following = {name: joint.mimic for name, joint in joints.items() if joint.mimic is not None}
    at |= {name: one.offset for name, one in following.items() if one.multiplier == 0 and abs(one.offset) <= LARGEST}
    while more := {
        name: one.multiplier * at[one.joint] + one.offset
        for name, one in following.items()
        if one.joint in at and name not in at
    }:
        at.update(more)
    for name, value in at.items():
        _fix(joints[name], value)
    if at:
        notes.append(f"joints without travel are fixed: {', '.join(sorted(at))}")


def _fix_idle_joints(robot: yourdfpy.Robot, rotors: list[str], notes: list[str]) -> None:
    """Fix joints that turn a bar or wheel about its own middle, and one that lets a whole hand float; leave out what
    floats and does not move by itself, as an object of a scene.
    """
    for joint in robot.joints:
        if joint.name in rotors:
            _fix(joint, 0.0)
    if rotors:
        notes.append(f"joints that only turn a bar or wheel about its middle are fixed: {', '.join(rotors)}")
    moving = [joint for joint in robot.joints if joint.type in (*MOVING, "continuous")]
    for joint in [joint for joint in robot.joints if joint.type == "floating"]:
        below = links_below(robot, joint.child)
        carried = [one for one in moving if one.parent in below]
        if not carried:
            robot.links = [link for link in robot.links if link.name not in below]
            robot.joints = [one for one in robot.joints if one.child not in below]
            notes.append(f"'{joint.child}' floats freely and has no joints: left out")
        elif len(carried) == len(moving):
            _fix(joint, 0.0)
            notes.append(f"joint '{joint.name}' lets the whole hand float: taken as fixed, pose= places the hand")


def _ends(joint: yourdfpy.Joint) -> tuple[float, float]:
    """Lower and upper limit of a joint; not a number where there is none."""
    given = (None, None) if joint.limit is None else (joint.limit.lower, joint.limit.upper)
    lower, upper = (math.nan if value is None else value for value in given)
    return lower, upper


def _fix(joint: yourdfpy.Joint, value: float) -> None:
    """Fix a joint where it is at ``value`` [rad or m]."""
    if value:
        way = value * joint.axis / max(float(np.linalg.norm(joint.axis)), LEAST)
        turns = joint.type == "revolute"
        moved = pin.SE3(pin.exp3(way), np.zeros(3)) if turns else pin.SE3(np.eye(3), way)
        joint.origin = (np.eye(4) if joint.origin is None else joint.origin) @ moved.homogeneous
    joint.type, joint.mimic, joint.limit = "fixed", None, None


def _read_limits(robot: yourdfpy.Robot, notes: list[str]) -> tuple[dict[str, Limits], list[str], list[str]]:
    """Limits of the moving joints, the problems with them and with joint types, and the joints that are continuous."""
    limits: dict[str, Limits] = {}
    problems: list[str] = []
    continuous: list[str] = []
    for joint in robot.joints:
        lower, upper = _ends(joint)
        if joint.type == "continuous":
            joint.type, lower, upper = "revolute", -math.pi, math.pi
            if joint.mimic is not None:
                continue  # it turns as far as what it follows
            continuous.append(joint.name)
        elif joint.type == "floating":
            problems.append(f"joint '{joint.name}' floats freely: give root= the hand's palm, or fix it")
        elif joint.type not in (*MOVING, "fixed"):
            problems.append(
                f"joint '{joint.name}' is {joint.type or 'without a type'}: only revolute, continuous, prismatic and "
                "fixed joints are supported"
            )
        if joint.type not in MOVING:
            continue
        most = {key: getattr(joint.limit, key, None) or 0.0 for key in ("effort", "velocity")}
        # Nobody means more than LARGEST: it stands for no limit.
        most = {key: value if 0 < value <= LARGEST else 0.0 for key, value in most.items()}
        problems += [
            f"joint '{joint.name}': {key} limit {value:g} is next to nothing: expected 0 for none, or {LEAST:g} and "
            "more"
            for key, value in most.items()
            if 0 < value < LEAST
        ]
        if upper - lower >= LEAST and max(abs(lower), abs(upper)) <= LARGEST:
            limits[joint.name] = Limits(lower=lower, upper=upper, **most)
        elif joint.mimic is not None:
            continue  # what it follows bounds it
        elif joint.limit is None or None in (joint.limit.lower, joint.limit.upper):
            problems.append(
                f"joint '{joint.name}' has no position limits: give it <limit lower= upper=> (in MJCF: range=), or "
                "limits="
            )
        else:
            beyond = f", or beyond {LARGEST:g}" if max(abs(lower), abs(upper)) > LARGEST else ""
            problems.append(
                f"joint '{joint.name}': lower limit {lower:g} is not below upper {upper:g}{beyond}: correct <limit>, "
                "give limits=, or make it a fixed joint"
            )
    if continuous:
        notes.append(
            f"continuous joints taken as revolute between -180 and 180 deg: {', '.join(continuous)}; the path of an "
            "arm may pass these"
        )
    return limits, problems, continuous


def _resolve_mimics(
    robot: yourdfpy.Robot, outside: Collection[str], notes: list[str]
) -> tuple[dict[str, Coupling], list[str]]:
    """Couplings of the mimic joints to joints that follow none, and the problems with them."""
    types = {joint.name: joint.type for joint in robot.joints}
    problems: list[str] = []
    unknown: dict[str, list[str]] = {}
    couplings: dict[str, Coupling] = {}
    for name, mimic in ((joint.name, joint.mimic) for joint in robot.joints if joint.mimic is not None):
        followed = mimic.joint
        if followed in outside:
            problems.append(f"joint '{name}' mimics '{followed}', which root= leaves out: choose a root with both")
            continue
        if followed not in types:
            # Exporters add a prefix or an ending to the joints and forget it here.
            near = [other for other in types if followed and other.endswith(followed) and other != name]
            same = [other for other in near if name.startswith(other[: len(other) - len(followed)])]
            same = same or [other for other in types if other == f"{followed}_joint" and other != name]
            if len(same) != 1:
                unknown.setdefault(followed, []).append(name)
                continue
            notes.append(f"joint {name} mimics '{followed}', which does not exist: taken as {same[0]}")
            followed = same[0]
        couplings[name] = Coupling(followed=followed, factor=mimic.multiplier, offset=mimic.offset)
    for followed, names in unknown.items():
        near = get_close_matches(followed or "", [name for name in types if name not in names])
        known = f"is it {' or '.join(near)}?" if near else f"joints: {', '.join(types)}"
        which = f"joint '{names[0]}' mimics" if len(names) == 1 else f"joints {', '.join(names)} mimic"
        problems.append(f"{which} the unknown joint '{followed}'; {known}")
    direct, more = resolve(couplings, types)
    return direct, problems + more


def _carry_over(
    robot: yourdfpy.Robot, couplings: Mapping[str, Coupling], armatures: Mapping[str, float]
) -> dict[str, float]:
    """Inertia of the motors [kg m^2] as the actuated joints have it."""
    found: dict[str, float] = {}
    for joint in robot.joints:
        if joint.type in MOVING and (value := armatures.get(joint.name, 0.0)) > 0:
            coupling = couplings.get(joint.name, Coupling(followed=joint.name, factor=1.0, offset=0.0))
            found[coupling.followed] = found.get(coupling.followed, 0.0) + coupling.factor**2 * value
    return found


# -- for Pinocchio -----------------------------------------------------------------------------------------------------


def _write_text(
    robot: yourdfpy.Robot, couplings: dict[str, Coupling], limits: dict[str, Limits], aliases: dict[str, str]
) -> str:
    """URDF with only what Pinocchio needs; yourdfpy's own leaves out which joints follow others."""
    out = ElementTree.Element("robot", name=robot.name or "hand")
    for link in robot.links:
        body = ElementTree.SubElement(out, "link", name=link.name)
        if link.inertial is not None:
            inertial = ElementTree.SubElement(body, "inertial")
            _put_origin(inertial, link.inertial.origin)
            ElementTree.SubElement(inertial, "mass", value=repr(float(link.inertial.mass)))
            (xx, xy, xz), (_, yy, yz), (*_, zz) = link.inertial.inertia.tolist()
            moments = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
            ElementTree.SubElement(inertial, "inertia", {key: repr(value) for key, value in moments.items()})
    for joint in robot.joints:
        put = ElementTree.SubElement(out, "joint", name=aliases.get(joint.name) or joint.name, type=joint.type)
        _put_origin(put, joint.origin)
        ElementTree.SubElement(put, "parent", link=joint.parent)
        ElementTree.SubElement(put, "child", link=joint.child)
        if joint.type not in MOVING:
            continue
        ElementTree.SubElement(put, "axis", xyz=_write_numbers(joint.axis))
        own = limits.get(joint.name, Limits(lower=-1.0, upper=1.0))  # those of a coupled joint are not used
        ElementTree.SubElement(
            put, "limit", {key: repr(getattr(own, key)) for key in ("lower", "upper", "effort", "velocity")}
        )
        if one := couplings.get(joint.name):
            ElementTree.SubElement(
                put, "mimic", joint=aliases[one.followed], multiplier=repr(one.factor), offset=repr(one.offset)
            )
        elif joint.dynamics is not None:
            damping, friction = (str(value or 0.0) for value in (joint.dynamics.damping, joint.dynamics.friction))
            ElementTree.SubElement(put, "dynamics", damping=damping, friction=friction)
    return ElementTree.tostring(out, encoding="unicode")


def _put_origin(element: ElementTree.Element, origin: Array | None) -> None:
    if origin is not None:
        rpy = pin.rpy.matrixToRpy(origin[:3, :3])
        ElementTree.SubElement(element, "origin", xyz=_write_numbers(origin[:3, 3]), rpy=_write_numbers(rpy))


def _write_numbers(values: Array) -> str:
    """Numbers as text, without losing a digit."""
    return " ".join(map(repr, values.tolist()))
