"""Hands described in MuJoCo's XML: read by Pinocchio, completed and checked here."""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.tree import Joint

_KINDS = {"JointModelR": "revolute", "JointModelP": "prismatic"}


def is_mjcf(text: str) -> bool:
    """Whether a text is MJCF: its outermost element is ``<mujoco>``."""
    try:
        return ElementTree.fromstring(text.strip()).tag == "mujoco"
    except ElementTree.ParseError:
        return False


def read(source: str, path: Path, root: str | None):
    """Name, model, collision geometry, joints, links and notes of an MJCF file, as :func:`~pinograsp.hands.load_hand` needs.

    Bodies are links. Equality constraints between two joints become mimic joints where they are linear; force ranges of
    motors, position and general actuators become effort limits. With ``root``, only that body and what it carries.

    Raises:
        HandNotLoaded: with all problems found.
    """
    element = ElementTree.fromstring(path.read_text(encoding="utf-8").strip())
    notes: list[str] = []
    if root is not None:
        _cut_out(source, element, path.resolve().parent, root, notes)
    with tempfile.TemporaryDirectory() as folder:
        if root is not None:
            path = Path(folder) / path.name
            ElementTree.ElementTree(element).write(path)
        try:
            with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
                model = pin.buildModelFromMJCF(str(path))
                geometry = pin.buildGeomFromMJCF(model, str(path), pin.GeometryType.COLLISION)
        except Exception as error:  # Pinocchio raises what its parsers raise
            raise HandNotLoaded(source, f"Pinocchio cannot read this MJCF: {error}") from error
    problems = _joint_problems(model)
    if problems:
        raise HandNotLoaded(source, problems)
    joints, links = _tree(model)
    model, coupled = _couple(source, model, element)
    _effort_limits(model, element, notes)
    notes += coupled
    return element.get("model") or path.stem, model, geometry, joints, links, notes


def _cut_out(source: str, element, folder: Path, root: str, notes: list[str]) -> None:
    """Keep the body ``root`` and what it carries, with its frame at the world's origin."""
    world = element.find("worldbody")
    ancestors = _path_to(world, root) if world is not None else None
    if ancestors is None:
        bodies = [body.get("name", "") for body in element.iter("body")]
        raise HandNotLoaded(source, f"root '{root}' is not a body; bodies: {', '.join(filter(None, bodies))}")
    hand = ancestors[-1]
    inherited = [body.get("childclass") for body in ancestors if body.get("childclass")]
    for key in [key for key in hand.attrib if key not in ("name", "childclass")]:
        del hand.attrib[key]  # its placement in the robot
    if inherited:
        hand.set("childclass", inherited[-1])
    for joint in [child for child in hand if child.tag in ("joint", "freejoint")]:
        hand.remove(joint)
    world[:] = [hand]
    joints = {joint.get("name") for joint in hand.iter("joint")}
    for group in ("equality", "actuator", "tendon", "sensor", "contact", "keyframe"):
        for part in element.findall(group):
            for one in list(part):
                if not (group in ("equality", "actuator") and {one.get("joint"), one.get("joint1")} & joints):
                    part.remove(one)
    compiler = element.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(element, "compiler")
    for key in ("meshdir", "assetdir"):
        if key == "meshdir" or compiler.get(key):
            compiler.set(key, str((folder / compiler.get(key, compiler.get("assetdir", ""))).resolve()))
    notes.append(f"the sub-tree of '{root}' is the hand: {len(joints)} joints")


def _path_to(body, name: str) -> list | None:
    """The bodies from ``body`` (left out) down to the one called ``name``."""
    for child in body.findall("body"):
        if child.get("name") == name:
            return [child]
        further = _path_to(child, name)
        if further is not None:
            return [child, *further]
    return None


def _kind(joint) -> str:
    name = joint.shortname()
    return next((kind for start, kind in _KINDS.items() if name.startswith(start) and joint.nq == 1), name)


def _joint_problems(model: pin.Model) -> list[str]:
    problems = []
    for j in range(1, model.njoints):
        name, kind = model.names[j], _kind(model.joints[j])
        if kind not in _KINDS.values():
            problems.append(
                f"joint '{name}' is {kind}: only hinge and slide joints with one degree of freedom each are supported; "
                "a free body needs root= at the hand's palm"
            )
            continue
        i = model.joints[j].idx_q
        low, high = model.lowerPositionLimit[i], model.upperPositionLimit[i]
        if not (math.isfinite(low) and math.isfinite(high) and low < high and high - low < 1e3):
            problems.append(f"joint '{name}' has no position limits: give it range= (and limited=, or autolimits)")
    return problems


def _effort_limits(model: pin.Model, element, notes: list[str]) -> None:
    """Force ranges of the actuators that drive a joint directly, times their gear."""
    defaults = {
        (d.get("class", "main"), actuator.tag): actuator.attrib
        for d in element.iter("default")
        for actuator in d
        if actuator.tag in ("motor", "position", "velocity", "general")
    }
    limits = {}
    for actuator in element.findall("actuator/*"):
        values = {**defaults.get((actuator.get("class", "main"), actuator.tag), {}), **actuator.attrib}
        span = values.get("forcerange") or (values.get("ctrlrange") if actuator.tag == "motor" else None)
        if values.get("joint") and span:
            gear = float(values.get("gear", "1").split()[0])
            limits[values["joint"]] = abs(gear) * max(abs(float(v)) for v in span.split())
    without = []
    effort = model.effortLimit.copy()
    for j in range(1, model.njoints):
        i, name = model.joints[j].idx_v, model.names[j]
        if not model.joints[j].nv:
            continue
        own = effort[i] if 0 < effort[i] < 1e6 else 0.0
        effort[i] = limits.get(name, own)
        if not effort[i]:
            without.append(name)
    model.effortLimit = effort
    model.velocityLimit = np.where(model.velocityLimit < 1e6, model.velocityLimit, 0.0)
    if without:
        notes.append(f"no effort limit (none given, or 0): {', '.join(without)}")


def _tree(model: pin.Model) -> tuple[list[Joint], list[str]]:
    """Joints and links (bodies), from the frames' parents; held joints and sites are passed over."""
    kinds = pin.FrameType
    links = [frame.name for frame in model.frames if frame.type == kinds.BODY]
    moved = {model.frames[model.getFrameId(name, kinds.JOINT)].name for name in model.names[1:]}

    def above(index: int):
        """The nearest body or moving joint that carries a frame; the world is the body "universe"."""
        while True:
            index = model.frames[index].parentFrame
            if not index or model.frames[index].type == kinds.BODY or model.frames[index].name in moved:
                return index

    def body_above(index: int) -> str:
        index = above(index)
        while index and model.frames[index].type != kinds.BODY:
            index = above(index)
        return model.frames[index].name if index else "universe"

    joints = []
    for link in links:
        index = model.getFrameId(link, kinds.BODY)
        carrier = model.frames[above(index)]
        if carrier.type == kinds.JOINT and carrier.name in moved:
            joint = model.joints[model.getJointId(carrier.name)]
            parent = body_above(model.getFrameId(carrier.name, kinds.JOINT))
            joints.append(Joint(name=carrier.name, type=_kind(joint), parent=parent, child=link))
        else:
            joints.append(Joint(name=f"fixed {link}", type="fixed", parent=carrier.name, child=link))
    links.insert(0, "universe")
    return joints, links


def _couple(source: str, model: pin.Model, element) -> tuple[pin.Model, list[str]]:
    """Equality constraints joint1 = c0 + c1 joint2 as mimic joints."""
    coupled, problems = [], []
    for constraint in element.findall("equality/joint"):
        follower, followed = constraint.get("joint1", ""), constraint.get("joint2")
        if not all(model.existJointName(name) for name in (follower, followed or "")):
            continue  # outside the hand, or a joint held still
        offset, factor, *rest = [float(v) for v in constraint.get("polycoef", "0 1 0 0 0").split()] + [0.0] * 5
        if any(rest) or factor == 0:
            problems.append(f"joint '{follower}' follows '{followed}' by a curve {constraint.get('polycoef')}: not linear")
            continue
        one, other = model.getJointId(followed), model.getJointId(follower)
        if one > other:
            one, other, factor, offset = other, one, 1 / factor, -offset / factor
        try:
            model = pin.transformJointIntoMimic(model, one, other, factor, offset)
        except ValueError as error:
            problems.append(f"joint '{follower}' cannot follow '{followed}': {error}")
            continue
        coupled.append(f"joint {model.names[other]} follows {model.names[one]}: {factor:g} times its position"
                       + (f" + {offset:g}" if offset else ""))  # fmt: skip
    if problems:
        raise HandNotLoaded(source, problems)
    return model, coupled
