"""From a name or a file to a :class:`HandModel`: URDF, xacro or MJCF in; fingers found from the tree and the geometry."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import mjcf
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.hands.coupling import in_order
from pinograsp.hands.geometry import collision_geometry, fill_masses
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.tree import Joint, find_fingers, tip_of
from pinograsp.hands.urdf import prepare
from pinograsp.hands.xacro_guard import expand_xacro


def load_hand(
    source: str | Path,
    *,
    pose=None,
    root: str | None = None,
    palm: str | None = None,
    fingers: dict[str, str] | None = None,
    limits: dict[str, tuple[float, float]] | None = None,
    trusted: bool = False,
    **xacro_args,
) -> HandModel:
    """Load a hand by name or from a file.

    Joints that mimic others are reduced to the joints that move them: q, torques and Jacobians are those of the actuated
    joints.

    Args:
        source: a name of :data:`~pinograsp.hands.catalogue.CATALOGUE` (``pinograsp hands`` lists them), or the path of a
            ``.urdf``, ``.xacro`` or MJCF ``.xml`` file.
        pose: oMh (4, 4), the hand's root frame in the world; identity by default.
        root: link whose sub-tree is the hand, where it sits on an arm or a whole robot; its frame is the hand's root frame.
        palm: link the fingers start from; by default the first link at which moving chains part.
        fingers: names to use, ``{finger name: a link of its outermost part}``; by default every chain from the palm
            to a leaf that has geometry, named after what its links have in common.
        limits: position limits that replace the file's, ``{joint: (lower, upper)}`` [rad]; noted on the model.
        trusted: let a xacro file run everything xacro offers (see :mod:`pinograsp.hands.xacro_guard`).
        **xacro_args: values of the xacro file's arguments.

    Raises:
        HandNotLoaded: the file is missing or broken; all problems found are listed.
        InvalidInput: a name or a limit given here does not fit the hand.
    """
    name = str(source)
    if name in CATALOGUE:
        path, entry = file_of(name), CATALOGUE[name]
        root, palm, fingers = root or entry.root, palm or entry.palm, fingers or entry.fingers
    else:
        path = Path(source)
    if not path.is_file():
        raise HandNotLoaded(
            name, f"no such file; expected a .urdf, .xacro or MJCF .xml file, or one of: {', '.join(CATALOGUE)}"
        )
    if path.suffix == ".xacro":
        text = expand_xacro(path, xacro_args, trusted=trusted)
    elif xacro_args:
        raise HandNotLoaded(name, f"arguments {', '.join(xacro_args)} given, but only xacro files take arguments")
    else:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise HandNotLoaded(name, f"cannot be read as text: {error}") from error
    if mjcf.is_mjcf(text):
        title, model, geometry, joints, links, notes = mjcf.read(name, path, root)
    else:
        title, model, geometry, joints, links, notes = _from_urdf(name, text, path, root)
    hand = _hand_model(name, title, model, geometry, joints, links, notes, palm, fingers)
    if limits:
        hand = hand.with_limits(limits)
    return hand if pose is None else hand.placed(pose)


def _from_urdf(source: str, text: str, path: Path, root: str | None):
    prepared = prepare(source, text, path.resolve().parent, root)
    text, names = in_order(source, prepared.text)
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            model = pin.buildModelFromXML(text, True)
            geometry = collision_geometry(model, text, prepared.notes)
    except (ValueError, RuntimeError) as error:
        raise HandNotLoaded(source, f"Pinocchio cannot build a model: {error}") from error
    for j, joint in enumerate(model.names):
        model.names[j] = names.get(joint, joint)
    for frame in model.frames:
        frame.name = names.get(frame.name, frame.name)
    robot = prepared.robot
    joints = [Joint(name=j.name, type=j.type, parent=j.parent, child=j.child) for j in robot.joints]
    notes = [
        f"joint {j.name} follows {j.mimic.joint}: {j.mimic.multiplier:g} times its position"
        + (f" + {j.mimic.offset:g}" if j.mimic.offset else "")
        for j in robot.joints
        if j.mimic is not None
    ]
    return robot.name, model, geometry, joints, [link.name for link in robot.links], [*prepared.notes, *notes]


def _hand_model(source, title, model, geometry, joints, links, notes, palm, names) -> HandModel:
    fill_masses(model, geometry, notes)
    for j in range(1, model.njoints):
        subtree = [i for i in range(1, model.njoints) if j in model.supports[i]]
        if sum(model.inertias[i].mass for i in subtree) <= 0:
            raise HandNotLoaded(source, f"joint '{model.names[j]}' moves no mass at all: give its links a mass")
    solid = {model.frames[one.parentFrame].name for one in geometry.geometryObjects}
    palm, chains = find_fingers(source, joints, links, solid.__contains__, palm, names)
    fingers = tuple(_finger(model, name, chain) for name, chain in chains.items())
    return HandModel(
        name=title, source=source, model=model, geometry=geometry, palm=palm, fingers=fingers, pose=np.eye(4),
        notes=tuple(notes),
    )  # fmt: skip


def _finger(model: pin.Model, name: str, chain) -> Finger:
    joints = tuple(part.joint.name for part in chain)
    ids = tuple(model.getJointId(joint) for joint in joints)
    dofs = list(dict.fromkeys(model.joints[j].idx_v for j in ids))
    actuated = {model.joints[j].idx_v: model.names[j] for j in range(1, model.njoints) if model.joints[j].nv}
    return Finger(
        name=name,
        joints=joints,
        links=tuple(part.joint.child for part in chain),
        tip=tip_of(chain),
        joint_ids=ids,
        dofs=np.array(dofs),
        actuated=tuple(actuated[i] for i in dofs),
    )
