"""From a file to a :class:`HandModel`: URDF or xacro in, fingers found from the tree."""

from __future__ import annotations

import contextlib
import io
import logging
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.xacro_guard import expand_xacro

_CATALOGUE = {"humanoid": "humanoid_hand.urdf"}
_MOVING = ("revolute", "prismatic")


def urdf_folder() -> Path:
    """Folder of the hands shipped with the package (inside the wheel, or beside the package in a checkout)."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"


def load_hand(
    source: str | Path,
    *,
    pose=None,
    palm: str | None = None,
    fingers: dict[str, str] | None = None,
    limits: dict[str, tuple[float, float]] | None = None,
    trusted: bool = False,
    **xacro_args,
) -> HandModel:
    """Load a hand by name or from a file.

    Args:
        source: ``"humanoid"`` (the paper's hand), or the path of a ``.urdf`` or ``.xacro`` file.
        pose: oMh (4, 4), the hand's root frame in the world; identity by default.
        palm: link the fingers start from; by default the first link at which moving chains part.
        fingers: names to use, ``{finger name: a link of its outermost part}``; by default every chain from the palm
            to a leaf, named after what its links have in common.
        limits: position limits that replace the file's, ``{joint: (lower, upper)}`` [rad]; noted on the model.
        trusted: let a xacro file run everything xacro offers (see :mod:`pinograsp.hands.xacro_guard`).
        **xacro_args: values of the xacro file's arguments.

    Raises:
        HandNotLoaded: the file is missing or broken; all problems found are listed.
        InvalidInput: a name or a limit given here does not fit the hand.
    """
    name = str(source)
    path = urdf_folder() / _CATALOGUE[name] if name in _CATALOGUE else Path(source)
    if not path.is_file():
        known = ", ".join(_CATALOGUE)
        raise HandNotLoaded(name, f"no such file; expected a .urdf or .xacro file, or one of: {known}")
    if path.suffix == ".xacro":
        text = expand_xacro(path, xacro_args, trusted=trusted)
    elif xacro_args:
        raise HandNotLoaded(name, f"arguments {', '.join(xacro_args)} given, but only xacro files take arguments")
    else:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise HandNotLoaded(name, f"cannot be read as text: {error}") from error
    robot = _parse(name, text)
    hand = _hand_model(name, text, robot, palm, fingers)
    if limits:
        hand = hand.with_limits(limits)
    return hand if pose is None else hand.placed(pose)


def _parse(source: str, text: str):
    """yourdfpy's description of the robot, checked; every problem found ends up in one error."""
    try:
        ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        raise HandNotLoaded(source, f"not well-formed XML: {error}") from error
    import yourdfpy

    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)  # it logs what it raises; we raise it
    try:
        urdf = yourdfpy.URDF.load(io.BytesIO(text.strip().encode()), load_meshes=False, build_scene_graph=False)
        urdf.validate()
    except Exception as error:  # yourdfpy raises what its parsers raise: AttributeError, KeyError, ValueError...
        raise HandNotLoaded(source, f"not a URDF that yourdfpy can read: {error!r}") from error
    robot = urdf.robot
    problems = [str(getattr(error, "msg", error)) for error in urdf.errors]
    problems += _tree_problems(robot) + _link_problems(robot)
    if problems:
        raise HandNotLoaded(source, problems)
    return robot


def _tree_problems(robot) -> list[str]:
    links = [link.name for link in robot.links]
    problems = [f"link '{name}' is defined {links.count(name)} times" for name in sorted(set(links)) if links.count(name) > 1]
    if not links:
        return ["no <link> found: expected a <robot> with links and joints"]
    children = [joint.child for joint in robot.joints]
    for joint in robot.joints:
        problems += [
            f"joint '{joint.name}' names the unknown link '{link}'"
            for link in (joint.parent, joint.child)
            if link not in links
        ]
    problems += [f"link '{name}' has several parent joints" for name in sorted(set(children)) if children.count(name) > 1]
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        problems.append(f"expected one root link, found {len(roots)}: {', '.join(roots) or 'a loop'}")
    if not any(joint.type in _MOVING for joint in robot.joints):
        problems.append("no revolute or prismatic joint: expected a hand that moves")
    return problems


def _link_problems(robot) -> list[str]:
    problems = []
    links = {link.name: link for link in robot.links}
    for joint in robot.joints:
        if joint.type in _MOVING:
            limit = joint.limit
            if limit is None or limit.lower is None or limit.upper is None:
                problems.append(f"joint '{joint.name}' has no position limits: give it <limit lower= upper=>")
            elif not limit.lower < limit.upper:
                problems.append(f"joint '{joint.name}': lower limit {limit.lower:g} is not below upper {limit.upper:g}")
            missing = _bodies_without_inertial(robot, links, joint.child)
            if missing:
                problems.append(f"link '{joint.child}' moves but has no <inertial>: torques would be wrong, add one")
        elif joint.type != "fixed":
            problems.append(f"joint '{joint.name}' is {joint.type}: only revolute, prismatic and fixed joints are supported")
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


def _hand_model(source: str, text: str, robot, palm: str | None, names: dict[str, str] | None) -> HandModel:
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise HandNotLoaded(source, f"Pinocchio cannot build a model: {error}") from error
    for j in range(1, model.njoints):
        subtree = [i for i in range(1, model.njoints) if j in model.supports[i]]
        if sum(model.inertias[i].mass for i in subtree) <= 0:
            raise HandNotLoaded(source, f"joint '{model.names[j]}' moves no mass at all: give its links a mass")
    palm, chains = _chains(source, robot, palm)
    if names is None:
        chosen = dict(zip(_chain_names(chains), chains))
    else:
        chosen = {}
        for name, link in names.items():
            matching = [chain for chain in chains if any(link in (joint.child, *extra) for joint, extra in chain)]
            if not matching:
                tips = ", ".join(_tip(chain) for chain in chains)
                raise HandNotLoaded(source, f"finger '{name}': link '{link}' is on no finger; fingertips: {tips}")
            chosen[name] = matching[0]
    fingers = tuple(_finger(model, name, chain) for name, chain in chosen.items())
    notes = tuple(
        f"joint {joint.name} mimics {joint.mimic.joint}: the coupling is not applied, it is moved on its own"
        for joint in robot.joints
        if joint.mimic is not None
    )
    return HandModel(
        name=robot.name, source=source, model=model, palm=palm, fingers=fingers, pose=np.eye(4), notes=notes
    )


def _chains(source: str, robot, palm: str | None):
    """Palm link and, per finger, its moving joints with the links fixed beyond each: [(joint, (links...)), ...]."""
    below = {link.name: [] for link in robot.links}
    for joint in robot.joints:
        below[joint.parent].append(joint)

    def moves(joint) -> bool:
        return joint.type in _MOVING or any(moves(child) for child in below[joint.child])

    children = {joint.child for joint in robot.joints}
    if palm is None:
        palm = next(link.name for link in robot.links if link.name not in children)
        while len(parting := [joint for joint in below[palm] if moves(joint)]) == 1:
            # A single finger has no parting: its palm is the last link before the first moving joint.
            if parting[0].type in _MOVING and not _parts_below(parting[0], below, moves):
                break
            palm = parting[0].child
    elif palm not in below:
        raise HandNotLoaded(source, f"palm '{palm}' is not a link; links: {', '.join(below)}")

    def walk(joint, chain):
        chain = [*chain, (joint, ())] if joint.type in _MOVING else chain
        if joint.type not in _MOVING and chain:
            chain = [*chain[:-1], (chain[-1][0], (*chain[-1][1], joint.child))]
        further = [child for child in below[joint.child] if moves(child)]
        if further:
            for child in further:
                yield from walk(child, chain)
            return
        # Beyond the last joint only fixed links remain: follow them to the outermost.
        tips = below[joint.child]
        while tips and chain:
            chain = [*chain[:-1], (chain[-1][0], (*chain[-1][1], tips[-1].child))]
            tips = below[tips[-1].child]
        yield chain

    chains = [chain for joint in below[palm] if moves(joint) for chain in walk(joint, [])]
    if not chains:
        raise HandNotLoaded(source, f"no moving chain starts at palm '{palm}'")
    return palm, chains


def _parts_below(joint, below, moves) -> bool:
    further = [child for child in below[joint.child] if moves(child)]
    return len(further) > 1 or any(_parts_below(child, below, moves) for child in further)


def _tip(chain) -> str:
    joint, fixed = chain[-1]
    return fixed[-1] if fixed else joint.child


def _chain_names(chains) -> list[str]:
    """The common prefix of each finger's links, where that tells the fingers apart; else the fingertip's name."""
    names = []
    for chain in chains:
        links = [joint.child for joint, _ in chain] + [_tip(chain)]
        prefix = links[0]
        while not all(link.startswith(prefix) for link in links):
            prefix = prefix[:-1]
        names.append(prefix.rstrip("_-. 0123456789"))
    if len(set(names)) < len(names) or not all(names):
        names = [_tip(chain) for chain in chains]
    return names


def _finger(model: pin.Model, name: str, chain) -> Finger:
    joints = tuple(joint.name for joint, _ in chain)
    ids = tuple(model.getJointId(joint) for joint in joints)
    return Finger(
        name=name,
        joints=joints,
        links=tuple(joint.child for joint, _ in chain),
        tip=_tip(chain),
        joint_ids=ids,
        dofs=np.array([model.joints[j].idx_v for j in ids]),
    )
