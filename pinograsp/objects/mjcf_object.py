"""Collision shapes, mass and inertia of one body of an MJCF file: read as hands' files are."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np

from pinograsp.checks import one_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.mjcf import MjcfRobot
from pinograsp.hands.mjcf_source import compile_file, compile_spec
from pinograsp.hands.shapes import MeshNames, read_shapes
from pinograsp.objects.description import MOST_SHAPES, CollisionShape, Description
from pinograsp.spatial import Array

_UNTOLD = ("the sub-tree of",)  # notes of the reader that say nothing of an object
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_MOST_NAMES = 10


def mjcf_description(
    source: ElementTree.Element | mujoco.MjSpec, path: Path, body: str | None, trusted: bool = False
) -> Description:
    """What an MJCF file, or a specification of MuJoCo's, says of the body called ``body``, or of the only one that is
    free or the only one there is.

    Bodies that are fixed in it belong to it. The frame is the body's own.

    Raises:
        ValueError: several bodies, joints that move, no shape that touches, a missing mesh; what hands' files are
            refused for.
    """
    try:
        if isinstance(source, mujoco.MjSpec):
            compiled = compile_spec(str(path), source)
        else:
            compiled = compile_file(str(path), source, path, trusted)
        chosen = _choose(compiled.model, body)
        read = MjcfRobot(str(path), compiled, chosen)
    except HandNotLoaded as error:
        raise ValueError("; ".join(error.problems)) from None
    if read.problems:
        raise ValueError("; ".join(read.problems))
    parts = _collect_parts(read, path.parent)
    if not parts:
        raise ValueError(f"body '{chosen}': expected a <geom> that touches (contype, conaffinity), got none")
    told = tuple(note for note in read.notes if not note.startswith(_UNTOLD))
    mass, com, inertia = _weigh(compiled.model, chosen)
    if mass <= 0:
        return Description(parts=tuple(parts), mass=None, com=None, inertia=None, notes=told)
    return Description(parts=tuple(parts), mass=mass, com=com, inertia=inertia if inertia.any() else None, notes=told)


def _choose(model: mujoco.MjModel, name: str | None) -> str:
    """The name of the body that is the object."""
    carried = [[b for b in range(model.nbody) if model.body_rootid[b] == top] for top in range(model.nbody)]
    shaped = [top for top in range(1, model.nbody) if carried[top] and any(model.body_geomnum[b] for b in carried[top])]
    names = {top: model.body(top).name or f"body {top}" for top in shaped}
    if name is not None:
        known = {called: top for top, called in names.items()}
        chosen = known[one_of("body", name, known)]
    else:
        free = [top for top in shaped if _FREE in _joint_types(model, top)]
        found = free or shaped
        if len(found) != 1:
            what = "free body" if free else "body with shapes in <worldbody>"
            listed = ", ".join(names[top] for top in found[:_MOST_NAMES])
            raise ValueError(
                f"expected one {what}, got {len(found)}{f' ({listed})' if listed else ''}: name one with body="
            )
        (chosen,) = found
    moving = [b for b in carried[chosen] if _joint_types(model, b) - {_FREE}]
    if moving:
        listed = ", ".join(model.body(b).name or f"body {b}" for b in moving[:_MOST_NAMES])
        raise ValueError(f"expected one rigid object, got bodies with joints that move ({listed})")
    return names[chosen]


def _joint_types(model: mujoco.MjModel, body: int) -> set[int]:
    """Types of the joints by which its parent carries a body."""
    first = int(model.body_jntadr[body])
    return set(model.jnt_type[first : first + int(model.body_jntnum[body])].tolist()) if first >= 0 else set()


def _collect_parts(read: MjcfRobot, folder: Path) -> list[CollisionShape]:
    """The shapes of all links, which are fixed to the first, in its frame."""
    robot = read.robot
    if max(len(link.collisions) for link in robot.links) > MOST_SHAPES:
        raise ValueError(f"expected at most {MOST_SHAPES} collision shapes of a body")
    at = {robot.links[0].name: np.eye(4)}
    for joint in robot.joints:  # parents come first
        at[joint.child] = at[joint.parent] @ joint.origin
    left_out: list[str] = []
    shapes = read_shapes(robot, MeshNames(folder=folder, inline=read.inline), left_out)
    if left_out:
        raise ValueError("; ".join(left_out))
    names = [collision.name for link in robot.links for collision in link.collisions]
    return [
        CollisionShape(
            kind=shape.kind,
            size=shape.size,
            pose=at[shape.link] @ shape.placement.homogeneous,
            path=None if shape.triangles is not None or not shape.path else Path(shape.path),
            triangles=shape.triangles,
            name=name,
        )
        for shape, name in zip(shapes, names)
    ]


def _weigh(model: mujoco.MjModel, name: str) -> tuple[float, Array, Array]:
    """Mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m^2] of a body and what is fixed in it, its frame."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    top = next(b for b in range(model.nbody) if (model.body(b).name or f"body {b}") == name)
    turn, com = data.xmat[top].reshape(3, 3), data.subtree_com[top]
    inertia = np.zeros((3, 3))
    for body in np.flatnonzero(model.body_rootid == top):
        axes, arm = turn.T @ data.ximat[body].reshape(3, 3), turn.T @ (data.xipos[body] - com)
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return float(model.body_subtreemass[top]), turn.T @ (com - data.xpos[top]), inertia
