"""A hand mounted on an arm: one robot of two descriptions."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import items_of, one_of, placement_of, shorten, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.hands.descriptions import RobotDescription, read_description
from pinograsp.hands.geometry import Triangles
from pinograsp.hands.load import ON_ROOT, build_hand, load_hand
from pinograsp.hands.model import HandModel
from pinograsp.hands.motors import Actuation
from pinograsp.hands.shapes import MeshNames
from pinograsp.hands.urdf_tree import links_below
from pinograsp.spatial import Array

if TYPE_CHECKING:
    import mujoco

_PARTS = ("links", "joints")


def attach(
    arm: str | Path | mujoco.MjSpec,
    hand: str | Path | mujoco.MjSpec,
    *,
    link: str,
    at: ArrayLike | None = None,
    remove: Sequence[str] = (),
    root: str | None = None,
    pose: ArrayLike | None = None,
    posture: Mapping[str, float] | None = None,
    trusted: bool = False,
    packages: Mapping[str, str | Path] | None = None,
    xacro_args: Mapping[str, object] | None = None,
) -> HandModel:
    """Mount a hand on an arm: the robot of both, with the hand's fingers, palm, drives and limits.

    Args:
        arm, hand: files, texts, specifications or names of libraries, as for :func:`load_hand`, in any pair of formats;
            the hand may be a name of the catalogue.
        link: link of the arm to which the hand's root is fixed.
        at: the hand's root frame in that link (4, 4); identity by default.
        remove: links of the arm to leave out with everything that they carry, such as a hand in the file.
        root: link whose sub-tree is the hand, if its file has more.
        pose: the arm's root frame in the world (4, 4); identity by default.
        posture: positions of the arm's joints while the hand grasps, ``{joint: position}`` [rad or m].
        trusted, packages, xacro_args: as for :func:`load_hand`, for both files; the arguments are for the arm's.

    Raises:
        HandNotLoaded: a file is missing or broken.
        InvalidInput: the arm has no such link, both have links or joints of the same name, or the posture does not fit.

    Example:
        >>> import pinograsp as pg
        >>> from pinograsp.hands.catalogue import file_of
        >>> arm = file_of("panda")
        >>> robot = pg.attach(arm, "allegro_right", link="panda_link8", remove=["panda_hand"])
        >>> print(len(robot.joint_names), "joints;", *(finger.name for finger in robot.fingers))
        23 joints; index middle ring thumb

    See Also:
        :func:`~pinograsp.hands.load_hand`, :func:`~pinograsp.hands.detach`, :func:`~pinograsp.pick.plan_pick`.
    """
    link, remove = text_of("link", link), items_of("remove", remove, str)
    placement = np.eye(4) if at is None else placement_of("at", at)
    entry = CATALOGUE.get(hand) if isinstance(hand, str) else None
    root = root if root is not None or entry is None else entry.root
    alone = load_hand(hand, root=root, trusted=trusted, packages=packages)
    carrying = read_description(arm, None, trusted, packages, xacro_args)
    carried = read_description(hand, root, trusted, packages, None)
    for name in (link, *remove):
        one_of("link of the arm", name, [one.name for one in carrying.robot.links])
    both = _mount(_without(carrying, remove), carried, link, placement)
    robot = build_hand(both, palm=alone.palm, fingers={finger.name: finger.tip for finger in alone.fingers})
    robot = take_drives(robot, alone)
    robot = replace(robot, notes=tuple(note for note in robot.notes if not note.startswith(ON_ROOT)))
    if posture is not None:
        robot = robot.with_posture(posture)
    return robot if pose is None else robot.placed(pose)


def _without(arm: RobotDescription, remove: Sequence[str]) -> RobotDescription:
    """The description without links and all that they carry."""
    gone = set[str]().union(*(links_below(arm.robot, name) for name in remove))
    joints = [one for one in arm.robot.joints if one.child not in gone]
    kept = {one.name for one in joints}
    arm.robot.links, arm.robot.joints = [one for one in arm.robot.links if one.name not in gone], joints
    actuation = replace(
        arm.actuation,
        motors=[one for one in arm.actuation.motors if kept.issuperset(one.arms)],
        springs=[one for one in arm.actuation.springs if one.joint in kept],
    )
    armatures = {joint: value for joint, value in arm.armatures.items() if joint in kept}
    return replace(arm, actuation=actuation, armatures=armatures)


def _mount(arm: RobotDescription, hand: RobotDescription, link: str, at: Array) -> RobotDescription:
    """One description of both."""
    import yourdfpy

    carried = {joint.child for joint in hand.robot.joints}
    (top,) = [one for one in hand.robot.links if one.name not in carried]
    if not top.collisions and top.inertial is None:  # a bare frame, as MuJoCo's world
        bare, top.name = top.name, f"root of {hand.robot.name}"
        for joint in hand.robot.joints:
            joint.parent = top.name if joint.parent == bare else joint.parent
    links, joints = ([{one.name for one in getattr(side.robot, kind)} for side in (arm, hand)] for kind in _PARTS)
    for what, (ours, theirs) in zip(_PARTS, (links, joints)):
        if shared := sorted(ours & theirs):
            got = shorten(", ".join(shared))
            raise InvalidInput(f"{what}: expected names that arm and hand do not share, got {got}: rename the hand's")
    mount = yourdfpy.Joint(name=f"{link} carries {top.name}", type="fixed", parent=link, child=top.name, origin=at)
    inline = [_find_meshes(side) for side in (arm, hand)]
    robot = arm.robot
    robot.name = f"{robot.name} with {hand.robot.name}"
    robot.links, robot.joints = [*robot.links, *hand.robot.links], [*robot.joints, mount, *hand.robot.joints]
    collisions = ElementTree.Element("robot")
    collisions.extend([*arm.collisions, *hand.collisions])
    return RobotDescription(
        name=f"{arm.name} with {hand.name}",
        robot=robot,
        names=MeshNames(folder=Path(), inline={**inline[0], **inline[1]}),
        collisions=collisions,
        armatures={**arm.armatures, **hand.armatures},
        actuation=Actuation(
            motors=[*arm.actuation.motors, *hand.actuation.motors],
            springs=[*arm.actuation.springs, *hand.actuation.springs],
            alone=hand.actuation.alone,
            notes=[*arm.actuation.notes, *hand.actuation.notes],
        ),
        labels={**arm.labels, **hand.labels},
        problems=[*arm.problems, *hand.problems],
        notes=[*arm.notes, *hand.notes],
    )


def _find_meshes(side: RobotDescription) -> dict[str, Triangles]:
    """Name the files of a description's meshes by where they are, and its inline ones by whose they are."""
    inline = dict[str, Triangles]()
    for one in side.robot.links:
        for shape in (*one.collisions, *one.visuals):
            mesh = None if shape.geometry is None else shape.geometry.mesh
            if mesh is None:
                continue
            if mesh.filename in side.names.inline:
                name = f"{side.name}/{mesh.filename}"
                inline[name] = side.names.inline[mesh.filename]
                mesh.filename = name
            elif (found := side.names.find(mesh.filename)) is not None:
                mesh.filename = str(found.resolve())
    return inline


def take_drives(robot: HandModel, alone: HandModel) -> HandModel:
    """The robot with the drives, springs and limits that the hand has by itself."""
    model, own = robot.model.copy(), alone.model
    for name in alone.joint_names:
        i, j = (one.joints[one.getJointId(name)].idx_v for one in (model, own))
        for limit in ("effortLimit", "velocityLimit", "armature"):
            values = getattr(model, limit)
            values[i] = getattr(own, limit)[j]
            setattr(model, limit, values)
    joints = set(alone.joint_names)
    drives = [one for one in robot.drives if joints.isdisjoint(one.joints)]
    springs = [one for one in robot.springs if one.joint not in joints]
    return replace(robot, model=model).with_drives([*drives, *alone.drives], [*springs, *alone.springs])
