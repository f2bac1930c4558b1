"""Masses and inertia matrices of a URDF: what is wrong with them, what is mended, and which joints move none."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from pinograsp.hands.tree import MOVING
from pinograsp.hands.urdf_file import WAY_OUT

if TYPE_CHECKING:
    import yourdfpy

_MENDED = 0.3  # of the largest moment of inertia: a negative one of at most that share was rounded or scaled


def mend_inertias(robot: yourdfpy.Robot, notes: list[str]) -> list[str]:
    """Problems of masses and matrices that cannot be; matrices that are a little off are mended and noted."""
    problems: list[str] = []
    mended: list[str] = []
    for link in robot.links:
        inertial = link.inertial
        if inertial is None or inertial.mass is None or inertial.inertia is None:
            continue  # the reader tells
        if inertial.mass < 0:
            problems.append(f"link '{link.name}': mass must be >= 0, got {inertial.mass:g}: {WAY_OUT}")
        moments, axes = np.linalg.eigh(inertial.inertia)
        if moments.min() < -1e-9 * max(np.abs(inertial.inertia).max(), 1e-12):
            if min(inertial.inertia.diagonal()) < 0 or -moments.min() > _MENDED * moments.max():
                got = ", ".join(f"{moment:.3g}" for moment in moments)
                problems.append(
                    f"link '{link.name}': inertia matrix is not positive semi-definite (moments {got} kg m^2): "
                    f"{WAY_OUT}"
                )
                continue
            inertial.inertia = axes * np.maximum(moments, 0.0) @ axes.T
            mended.append(link.name)
    if mended:
        notes.append(f"inertia matrices with a negative moment, which is taken as 0: {', '.join(mended)}")
    return problems


def find_unweighed(robot: yourdfpy.Robot, shaped: Collection[str]) -> tuple[list[str], list[str]]:
    """Joints that move links without any <inertial>, and problems where masses cannot be taken from shapes.

    Links without mass get that of their shapes; ``shaped``: those that have some. In a description that gives the
    masses of others, links without shapes are massless.
    """
    links = {link.name: link for link in robot.links}
    fixed: dict[str, list[str]] = {}
    for joint in robot.joints:
        if joint.type not in MOVING:
            fixed.setdefault(joint.parent, []).append(joint.child)
    moving = [joint for joint in robot.joints if joint.type in MOVING]
    followed = {joint.mimic.joint for joint in moving if joint.mimic is not None}
    joints: list[str] = []
    shapeless: list[str] = []
    for joint in moving:
        together = [joint.child]
        for link in together:
            together += fixed.get(link, [])
        if any(links[link].inertial is not None for link in together):
            continue
        joints.append(joint.name)
        # What a motor turns may have nothing of its own: what follows it has the mass.
        if joint.name not in followed and not any(links[link].collisions or link in shaped for link in together):
            shapeless.append(joint.child)
    if len(joints) < len(moving):
        return joints, []
    if not shapeless:
        return joints, []
    which = (
        f"link '{shapeless[0]}' moves but has" if len(shapeless) == 1 else f"links {', '.join(shapeless)} move but have"
    )
    return joints, [f"{which} no <inertial>, nor a shape to take it from: torques would be wrong, add one"]
