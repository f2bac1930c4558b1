"""Masses and inertia matrices of a URDF: what is wrong with them, what is mended, and which joints move none."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from pinograsp.hands.elements import end_of, named, numbers
from pinograsp.hands.tree import MOVING

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_WAY_OUT = "correct it, or leave <inertial> out: mass and inertia are then taken from the link's shapes"
_MENDED = 0.3  # of the largest moment of inertia: a negative one of at most that share was rounded or scaled


def inertia_problems(robot: ElementTree.Element, notes: list[str]) -> list[str]:
    """Masses and matrices that cannot be; matrices that are a little off are mended and noted."""
    problems: list[str] = []
    mended: list[str] = []
    for name, link in named(robot, "link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass is None or inertia is None:
            problems.append(f"link '{name}': <inertial> needs both <mass> and <inertia>: {_WAY_OUT}")
            continue
        wanted = [(mass, "value"), *((inertia, key) for key in MOMENTS)]
        if lacking := [key for element, key in wanted if element.get(key) is None]:
            problems.append(f"link '{name}': <inertial> lacks {', '.join(lacking)}: {_WAY_OUT}")
            continue
        try:
            value, xx, xy, xz, yy, yz, zz = (numbers(element, key, 1)[0] for element, key in wanted)
        except ValueError:
            continue  # listed with the other numbers
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if value < 0:
            problems.append(f"link '{name}': mass must be >= 0, got {value:g}: {_WAY_OUT}")
        moments, axes = np.linalg.eigh(matrix)
        if moments.min() < -1e-9 * max(np.abs(matrix).max(), 1e-12):
            if min(xx, yy, zz) < 0 or -moments.min() > _MENDED * moments.max():
                got = ", ".join(f"{moment:.3g}" for moment in moments)
                problems.append(
                    f"link '{name}': inertia matrix is not positive semi-definite (moments {got} kg m^2): {_WAY_OUT}"
                )
                continue
            matrix = axes * np.maximum(moments, 0.0) @ axes.T
            for key, (i, j) in zip(MOMENTS, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
                inertia.set(key, repr(float(matrix[i, j])))
            mended.append(name)
    if mended:
        notes.append(f"inertia matrices with a negative moment, which is taken as 0: {', '.join(mended)}")
    return problems


def unweighed_joints(robot: ElementTree.Element) -> tuple[list[str], list[str]]:
    """Joints that move links without any <inertial>, and problems where masses cannot be taken from shapes.

    Links without mass get that of their shapes. In a description that gives the masses of others, links without shapes
    are massless.
    """
    links = dict(named(robot, "link"))
    held: dict[str, list[str]] = {}
    for _, joint in named(robot, "joint"):
        if joint.get("type") not in MOVING:
            held.setdefault(end_of(joint, "parent"), []).append(end_of(joint, "child"))
    joints: list[str] = []
    shapeless: list[str] = []
    moving = 0
    for name, joint in named(robot, "joint"):
        if joint.get("type") not in MOVING:
            continue
        moving += 1
        together = [end_of(joint, "child")]
        for link in together:
            together += held.get(link, [])
        if any(links[link].find("inertial") is not None for link in together):
            continue
        joints.append(name)
        if all(links[link].find("collision") is None for link in together):
            shapeless.append(together[0])
    if len(joints) < moving:
        return joints, []
    problem = "moves but has no <inertial>, nor <collision> to take it from: torques would be wrong, add one"
    return joints, [f"link '{one}' {problem}" for one in shapeless]
