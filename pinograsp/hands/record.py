"""A hand as plain JSON values, and back: the URDF text its model was built from, and all that was changed since."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, number, one_of, placement_of
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands.descriptions import RobotDescription
from pinograsp.hands.drive_records import drive_record, read_drive
from pinograsp.hands.drives import Drive, Spring, checked_drives, checked_springs, one_each
from pinograsp.hands.elements import find_named, parse
from pinograsp.hands.geometry import PRIMITIVES, SIZES, read_mesh, solid_of
from pinograsp.hands.mesh_file import collision_model, triangles_of
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.shapes import MeshNames
from pinograsp.hands.urdf import prepare_hand
from pinograsp.hands.urdf_file import MOMENTS, read_urdf
from pinograsp.hands.visuals import parse_triangles, visuals_from, visuals_record, write_triangles
from pinograsp.spatial import FARTHEST

_Kind = TypeVar("_Kind")

_KINDS: dict[type, str] = {str: "a text", list: "a list", dict: "a mapping", int: "an integer"}
# Of the actuated joints, by their names in Pinocchio.
_LIMITS = ("lowerPositionLimit", "upperPositionLimit", "effortLimit", "velocityLimit", "armature")
_SIZES = {str(kind): count for kind, count in SIZES.items()} | {"hull": 3}


def hand_record(hand: HandModel) -> dict[str, Any] | None:
    """The hand as plain JSON values: a copy of all but its meshes, which are named by absolute path and scale.

    None where the hand cannot be rebuilt from them: one that was built without a description, or whose
    geometry is neither a primitive nor the mesh of a file.
    """
    objects = hand.geometry.geometryObjects
    own = hand.own_shapes if len(hand.own_shapes) == len(objects) else [one.geometry for one in objects]
    geometry = [_shape(*pair) for pair in zip(objects, own)]
    if not hand.description or None in geometry:
        return None
    model = hand.model
    record = {
        "name": hand.name,
        "source": str(hand.source),
        "description": hand.description,
        "palm": hand.palm,
        "pose": np.asarray(hand.pose).tolist(),
        "notes": [str(note) for note in hand.notes],
        "joints": [
            {
                "name": name,
                "placement": placement.homogeneous.tolist(),
                "mass": inertia.mass,
                "lever": inertia.lever.tolist(),
                "inertia": inertia.inertia.tolist(),
            }
            for name, placement, inertia in zip(model.names, model.jointPlacements, model.inertias)
        ],
        "limits": {name: np.ravel(getattr(model, name)).tolist() for name in _LIMITS},
        "frames": [
            {"name": frame.name, "joint": int(frame.parentJoint), "placement": frame.placement.homogeneous.tolist()}
            for frame in model.frames
        ],
        "geometry": geometry,
        "visuals": visuals_record(hand.visuals),
        "fingers": [
            {"name": finger.name, "joints": list(finger.joints), "links": list(finger.links), "tip": finger.tip}
            for finger in hand.fingers
        ],
        "drives": [drive_record(drive) for drive in hand.drives],
        "springs": [asdict(spring) for spring in hand.springs],
        "posture": {str(joint): float(value) for joint, value in hand.posture.items()},
        "disabled_collisions": [list(pair) for pair in hand.disabled_collisions],
        "continuous": list(hand.continuous),
    }
    try:
        _model(record, _description(record))
    except InvalidInput:  # the model is not the description's
        return None
    return record


def hand_of(record: dict[str, Any]) -> HandModel:
    """The hand that :func:`hand_record` wrote down; nothing in the record is run.

    Raises:
        HandNotLoaded: mesh files that are missing or cannot be read, all of them listed, or a broken description.
        InvalidInput: a record that is not one.
    """
    try:
        return _hand(record)
    except OverflowError as error:
        raise InvalidInput(f"hand record: expected numbers that a float can hold, got {error}") from None


def _hand(record: dict[str, Any]) -> HandModel:
    description = _description(record)
    model = _model(record, description)
    links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
    fingers = tuple(_finger(model, links, i, one) for i, one in enumerate(_field(record, "fingers", list)))
    shapes = _geometry(record["source"], model, _field(record, "geometry", list))
    hand = HandModel(
        name=_field(record, "name", str),
        source=record["source"],
        model=model,
        geometry=shapes.geometry,
        palm=one_of("hand record: palm", _field(record, "palm", str), links),
        fingers=fingers,
        pose=placement_of("hand record: pose", _field(record, "pose", list)),
        notes=tuple(_texts(record, "notes")),
        description=description,
        own_shapes=shapes.own if shapes.hulls else (),
        disabled_collisions=_disabled_collisions(record, links),
        visuals=visuals_from(_field(record, "visuals", list) if "visuals" in record else [], links),
    )
    hand = hand.with_posture(_field(record, "posture", dict) if "posture" in record else {})
    # Records of earlier versions do not tell.
    continuous = _texts(record, "continuous") if "continuous" in record else []
    for joint in continuous:
        one_of("hand record: continuous", joint, hand.joint_names)
    drives, springs = _drives(record, hand), _springs(record, hand)
    return replace(hand, drives=drives, springs=springs, continuous=tuple(continuous))


def _field(record: object, key: str, kind: type[_Kind], where: str = "") -> _Kind:
    """A value of the record, of the type it must have; ``where``: the part of the record."""
    name = f"hand record: {where}{key}"
    if not isinstance(record, dict) or key not in record:
        raise InvalidInput(f"{name}: expected {_KINDS[kind]}, got none: not the record of a hand, or cut short")
    value = record[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidInput(f"{name}: expected {_KINDS[kind]}, got {value!r:.60}")
    return value


def _texts(record: object, key: str, where: str = "") -> list[str]:
    texts: list[str] = _field(record, key, list, where)
    if not all(isinstance(one, str) for one in texts):
        raise InvalidInput(f"hand record: {where}{key}: expected a list of texts, got {texts!r:.60}")
    return texts


# -- the model ---------------------------------------------------------------------------------------------------------


def _model(record: dict[str, Any], description: str) -> pin.Model:
    try:
        model = pin.buildModelFromXML(description, True)
    except (ValueError, RuntimeError) as error:
        raise HandNotLoaded(record["source"], f"Pinocchio cannot build a model: {error}") from error
    joints, frames = _field(record, "joints", list), _field(record, "frames", list)
    _check_names("joints", list(model.names), joints)
    _check_names("frames", [frame.name for frame in model.frames], frames)
    for j, one in enumerate(joints):
        where = f"joints[{j}]: "
        model.names[j] = one["name"]
        model.jointPlacements[j] = _placement(one, where)
        mass = number(f"hand record: {where}mass", one.get("mass"), at_least=0, unit="kg")
        lever, inertia = (
            array_of(f"hand record: {where}{key}", one.get(key), shape)
            for key, shape in (("lever", (3,)), ("inertia", (3, 3)))
        )
        _near(f"{where}lever", lever)
        if not np.array_equal(inertia, inertia.T):
            raise InvalidInput(f"hand record: {where}inertia: expected a symmetric matrix, got {inertia.tolist()}")
        model.inertias[j] = pin.Inertia(mass, lever, inertia)
    for i, (frame, one) in enumerate(zip(model.frames, frames)):
        where = f"frames[{i}]: "
        if _field(one, "joint", int, where) != frame.parentJoint:
            raise InvalidInput(f"hand record: {where}expected joint {frame.parentJoint}, got {one['joint']}")
        frame.name, frame.placement = one["name"], _placement(one, where)
    limits = _field(record, "limits", dict)
    values = {name: array_of(f"hand record: limits: {name}", limits.get(name), (model.nv,)) for name in _LIMITS}
    if not np.all(values["lowerPositionLimit"] < values["upperPositionLimit"]):
        raise InvalidInput("hand record: limits: expected lower position limits below the upper ones")
    for name, value in values.items():
        if not name.endswith("PositionLimit") and np.any(value < 0):
            raise InvalidInput(f"hand record: limits: {name}: expected none below zero, got {value.tolist()}")
        setattr(model, name, value)
    return model


def _description(record: dict[str, Any]) -> str:
    """The record's URDF text, as one may give it to Pinocchio's reader.

    Raises:
        HandNotLoaded: with all its problems.
    """
    source = _field(record, "source", str)
    robot = parse(source, _field(record, "description", str))
    if robot.find("joint[@type='continuous']") is not None:  # written as revolute in every record
        raise HandNotLoaded(source, "expected revolute, prismatic and fixed joints, got continuous ones")
    try:
        same = ElementTree.tostring(robot, encoding="unicode")
        for _, link in find_named(robot, "link"):
            for collision in link.findall("collision"):
                link.remove(collision)
            if link.find("inertial") is None:  # the record has the masses that were found later
                inertial = ElementTree.SubElement(link, "inertial")
                ElementTree.SubElement(inertial, "mass", value="0")
                ElementTree.SubElement(inertial, "inertia", dict.fromkeys(MOMENTS, "0"))
        problems: list[str] = []
        types = [joint.get("type") for joint in robot.findall("joint")]
        read, names = read_urdf(robot, problems)[0], MeshNames(folder=Path())
        prepared = prepare_hand(
            RobotDescription(name=source, robot=read, names=names, collisions=robot, problems=problems)
        )
        if [joint.type for joint in prepared.joints] != types:
            raise HandNotLoaded(source, "a joint without travel: make it fixed, as in every record")
    except RecursionError:
        raise HandNotLoaded(source, "expected a description, got elements nested without end") from None
    return same


def _check_names(key: str, built: list[str], given: list[Any]) -> None:
    """Refuse what belongs to another description; coupled hands number their joints in it: ``0003 name``."""
    names = [_field(one, "name", str, f"{key}[{i}]: ") for i, one in enumerate(given)]
    known = set(names)
    own = [one if one in known else re.sub(r"^\d{4,} ", "", one) for one in built]
    if own != names:
        raise InvalidInput(
            f"hand record: {key}: expected its description's ({', '.join(own)[:300]}), got "
            f"{', '.join(names)[:300] or 'none'}"
        )


def _placement(one: dict[str, Any], where: str) -> pin.SE3:
    placement = placement_of(f"hand record: {where}placement", one.get("placement"))
    _near(f"{where}placement", placement[:3, 3])
    return pin.SE3(placement)


def _near(where: str, lengths: ArrayLike) -> None:
    """Refuse lengths beyond those of any robot: their squares and products would overflow in the end."""
    if not np.abs(lengths).max() <= FARTHEST:
        raise InvalidInput(
            f"hand record: {where}: expected lengths up to {FARTHEST:g} m, got {np.abs(lengths).max():g}"
        )


def _finger(model: pin.Model, links: list[str], i: int, one: dict[str, Any]) -> Finger:
    where = f"fingers[{i}]: "
    joints, moved = _texts(one, "joints", where), _texts(one, "links", where)
    if not joints or len(joints) != len(moved):
        raise InvalidInput(f"hand record: {where}expected one link for each joint, got {len(moved)} for {len(joints)}")
    for name in joints:
        one_of(f"hand record: {where}joint", name, list(model.names)[1:])
    for name in (*moved, tip := _field(one, "tip", str, where)):
        one_of(f"hand record: {where}link", name, links)
    return Finger.on_model(model, _field(one, "name", str, where), joints, moved, tip)


def _drives(record: dict[str, Any], hand: HandModel) -> tuple[Drive, ...]:
    """The record's drives; those of older records, which have none, are one motor at each joint."""
    if "drives" not in record:
        return one_each(hand.joint_names, hand.effort_or_infinity)
    drives = [read_drive(one, f"hand record: drives[{i}]: ") for i, one in enumerate(_field(record, "drives", list))]
    return checked_drives(hand.name, hand.joint_names, hand.couplings, drives)


def _disabled_collisions(record: dict[str, Any], links: list[str]) -> tuple[tuple[str, str], ...]:
    """The record's pairs of links; older records have none."""
    pairs = []
    for i, one in enumerate(_field(record, "disabled_collisions", list) if "disabled_collisions" in record else []):
        where = f"hand record: disabled_collisions[{i}]"
        if not isinstance(one, list) or len(one) != 2:
            raise InvalidInput(f"{where}: expected two links, got {one!r:.60}")
        pairs.append((one_of(where, one[0], links), one_of(where, one[1], links)))
    return tuple(pairs)


def _springs(record: dict[str, Any], hand: HandModel) -> tuple[Spring, ...]:
    springs = []
    for i, one in enumerate(_field(record, "springs", list) if "springs" in record else []):
        joint = _field(one, "joint", str, f"springs[{i}]: ")
        springs.append(Spring(joint=joint, stiffness=one.get("stiffness"), rest=one.get("rest")))
    return checked_springs(hand.name, hand.joint_names, hand.couplings, springs)


# -- collision geometry ------------------------------------------------------------------------------------------------


def _shape(one: pin.GeometryObject, own: coal.CollisionGeometry) -> dict[str, Any] | None:
    """A shape of a link; ``own``: as its description has it, where that is replaced by its hull."""
    shape, path, inline = one.geometry, "", {}
    size: Iterable[float]
    if isinstance(shape, coal.Box):
        kind, size = "box", 2 * np.ravel(shape.halfSide)
    elif isinstance(shape, coal.Sphere):
        kind, size = "sphere", [shape.radius]
    elif isinstance(shape, coal.Ellipsoid):
        kind, size = "ellipsoid", np.ravel(shape.radii)
    elif isinstance(shape, coal.Cylinder | coal.Capsule):
        kind, size = type(shape).__name__.lower(), [shape.radius, 2 * shape.halfLength]
    elif isinstance(shape, coal.BVHModelBase | coal.ConvexBase) and isinstance(own, coal.BVHModelBase):
        kind, size = "mesh" if isinstance(shape, coal.BVHModelBase) else "hull", np.ravel(one.meshScale)
        if one.meshPath:
            path = os.path.abspath(one.meshPath)
        else:
            inline = {"triangles": write_triangles(*triangles_of(own))}
    else:
        return None
    return {
        "name": one.name,
        "joint": int(one.parentJoint),
        "frame": int(one.parentFrame),
        "placement": one.placement.homogeneous.tolist(),
        "kind": kind,
        "size": [float(value) for value in size],
        "path": path,
        **inline,
    }


class _Shapes(NamedTuple):
    """Collision geometry of a hand, its links' own shapes, and whether any of them is replaced by its hull."""

    geometry: pin.GeometryModel
    own: tuple[coal.CollisionGeometry, ...]
    hulls: bool


def _geometry(source: str, model: pin.Model, shapes: list[Any]) -> _Shapes:
    geometry, own, hulls = pin.GeometryModel(), list[coal.CollisionGeometry](), False
    problems: list[str] = []
    for i, one in enumerate(shapes):
        where = f"geometry[{i}]: "
        name = _field(one, "name", str, where)
        frame, joint = (_field(one, key, int, where) for key in ("frame", "joint"))
        if not 0 <= frame < model.nframes or model.frames[frame].parentJoint != joint:
            raise InvalidInput(f"hand record: {where}expected a frame and its joint, got {frame} and {joint}")
        if geometry.existGeometryName(name):
            raise InvalidInput(f"hand record: {where}expected each name once, got '{name}' again")
        kind = one_of(f"hand record: {where}kind", _field(one, "kind", str, where), _SIZES)
        size = array_of(f"hand record: {where}size", one.get("size"), (_SIZES[kind],)).tolist()
        from_file = kind in ("mesh", "hull")
        if not all(value != 0 if from_file else value > 0 for value in size):
            raise InvalidInput(f"hand record: {where}size: expected numbers above zero [m], got {size}")
        _near(f"{where}size", size)
        placement = _placement(one, where)
        if from_file and "triangles" in one:
            from_file = False
            form = collision_model(*parse_triangles(f"hand record: {where}triangles", one["triangles"]))
        elif from_file:
            form = _mesh(_field(one, "path", str, where), size, problems)
        else:
            form = PRIMITIVES[kind](*size)
        if form is not None:
            own.append(form)
            hulls |= kind == "hull"
            form = solid_of(form) if kind == "hull" else form
            added = pin.GeometryObject(name, joint, frame, placement, form)
            if from_file:
                added.meshPath, added.meshScale = one["path"], np.array(size)
            geometry.addGeometryObject(added)
    if problems:
        raise HandNotLoaded(source, list(dict.fromkeys(problems)))
    return _Shapes(geometry, tuple(own), hulls)


def _mesh(path: str, scale: list[float], problems: list[str]) -> coal.BVHModelOBBRSS | None:
    if not os.path.isabs(path) or not os.path.isfile(path):
        problems.append(f"mesh '{path}' is not there: put the file back, or load the hand from its own description")
        return None
    try:
        return read_mesh(path, tuple(scale))
    except (ValueError, OSError) as error:
        problems.append(f"mesh '{path}' cannot be read: {error}")
        return None
