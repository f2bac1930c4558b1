"""The paper's hand: five fingers of four joints (Tables I, II, III), and where its fingers sit on the palm.

This module is the one source of these numbers. ``python -m pinograsp.hands.humanoid FOLDER`` writes the xacro and
the URDF that ship with the package.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pinograsp.hands.dh import FingerDescription, HandDescription, Link, PhalanxShape
from pinograsp.spatial import Array, pose_of

FINGERS = ("thumb", "index", "middle", "ring", "little")

# Table II: lengths of links 2, 3, 4 [mm]. Link 1 has length 0 and twist +90 deg; all offsets are 0.
LINK_LENGTHS_MM = {
    "thumb": (55.28, 43.16, 34.80),
    "index": (54.00, 31.48, 21.36),
    "middle": (58.58, 37.44, 23.80),
    "ring": (53.74, 36.34, 23.56),
    "little": (44.92, 25.80, 20.48),
}

# Table III: semi-axes a, b, c [mm] of rows 1..4. The rows run from the tip: 1 distal (link 4), 2 (link 3),
# 3 proximal (link 2), 4 metacarpal (part of the palm); 2a equals the link length in rows 1-3.
SEMI_AXES_MM = {
    "thumb": ((17.40, 7.97, 9.90), (21.58, 9.37, 9.46), (27.64, 12.88, 13.14), None),
    "index": ((10.68, 6.83, 8.15), (15.75, 8.06, 9.02), (26.98, 9.28, 9.11), (50.98, 17.52, 21.90)),
    "middle": ((11.89, 7.18, 8.23), (18.72, 8.32, 8.76), (29.29, 10.00, 8.85), (49.11, 16.03, 21.90)),
    "ring": ((11.78, 6.92, 7.97), (18.17, 7.80, 8.15), (26.87, 9.72, 8.50), (46.36, 15.15, 21.90)),
    "little": ((10.24, 6.30, 7.36), (12.88, 7.53, 7.62), (22.46, 8.67, 8.06), (45.59, 14.36, 21.90)),
}

# Table I: joint ranges [deg]. The thumb's CMC flexion is not printed; its abduction range is used.
JOINT_RANGES_DEG = {
    "thumb": ((-15, 90), (-15, 90), (0, 80), (-10, 80)),
    **{name: ((0, 60), (-40, 90), (0, 135), (-5, 90)) for name in FINGERS[1:]},
}

DENSITY = 1160.0  # [kg/m^3], section 3

# Names of joints and links 1..4. Link 1 has zero length.
_JOINTS = {
    "thumb": ("thumb_abduction", "thumb_cmc", "thumb_mcp", "thumb_ip"),
    **{n: (f"{n}_abduction", f"{n}_mcp", f"{n}_pip", f"{n}_dip") for n in FINGERS[1:]},
}
_LINKS = {
    "thumb": ("thumb_base", "thumb_metacarpal", "thumb_proximal", "thumb_distal"),
    **{n: (f"{n}_base", f"{n}_proximal", f"{n}_intermediate", f"{n}_distal") for n in FINGERS[1:]},
}

# The case study: Table IV's final angles [deg] and the published contact points [mm] in the world frame W.
FINAL_ANGLES_DEG = {"thumb": (130, 72, 50, 30), "index": (10, 82, 30, 30), "middle": (0, 71, 50, 30)}
CONTACT_POINTS_MM = {"thumb": (-2.6, -9.6, 61.5), "index": (4.7, 8.8, 71.0), "middle": (1.7, 9.7, 50.0)}

# Base frames {0}, not printed in the paper. z0 is the palm's normal N for every finger; x0 is the extended
# direction E turned about N by these angles [deg]: at the final angles the finger planes are then horizontal.
_PALM_YAW_DEG = 94.0
_BASE_YAW_DEG = {"thumb": 50.0, "index": -10.0, "middle": 0.0, "ring": 0.0, "little": 0.0}
# Knuckles of ring and little from the middle one, palm frame [mm] (y of the palm is -z of W).
_KNUCKLES_MM = {"ring": (-3.0, 21.0, 0.0), "little": (-9.0, 41.0, 0.0)}


def _palm_rotation() -> Array:
    """R_oh (3, 3) of the case study: columns E, N x E, N."""
    yaw = math.radians(_PALM_YAW_DEG)
    extended = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    normal = np.cross([0.0, 0.0, 1.0], extended)
    return np.column_stack([extended, np.cross(normal, extended), normal])


def _base_rotation(finger: str) -> Array:
    yaw = math.radians(_BASE_YAW_DEG[finger])
    return np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1.0]])


def _knuckle_o(finger: str) -> Array:
    """Origin of {0} in W (3,) [m], so that the tip at the final angles lies on the published contact point."""
    links = _links(finger)
    base = pose_of(rotation=_palm_rotation() @ _base_rotation(finger))
    at_origin = FingerDescription(name=finger, base=base, links=links)
    tip = at_origin.frames(np.radians(FINAL_ANGLES_DEG[finger]))[-1][:3, 3]
    knuckle: Array = np.array(CONTACT_POINTS_MM[finger]) * 1e-3 - tip
    return knuckle


def _links(finger: str) -> tuple[Link, ...]:
    distal, row2, row3, _ = (None if axes is None else _ellipsoid(axes) for axes in SEMI_AXES_MM[finger])
    lengths = (0.0, *(1e-3 * length for length in LINK_LENGTHS_MM[finger]))
    ranges = np.radians(JOINT_RANGES_DEG[finger])
    return tuple(
        Link(
            joint=_JOINTS[finger][i],
            link=_LINKS[finger][i],
            a=lengths[i],
            alpha=math.pi / 2 if i == 0 else 0.0,
            lower=ranges[i, 0],
            upper=ranges[i, 1],
            phalanx=(None, row3, row2, distal)[i],
        )
        for i in range(4)
    )


def _ellipsoid(axes_mm: Iterable[float]) -> PhalanxShape:
    a, b, c = (1e-3 * value for value in axes_mm)
    return PhalanxShape(a=a, b=b, c=c)


def case_study_pose() -> Array:
    """oMh (4, 4): the palm frame in the paper's world frame W (origin at the object's bottom centre) [m]."""
    return pose_of(_knuckle_o("middle"), _palm_rotation())


def humanoid_hand() -> HandDescription:
    """The paper's hand as a DH description, in its palm frame."""
    pose = case_study_pose()
    fingers = []
    for name in FINGERS:
        if name in FINAL_ANGLES_DEG:
            knuckle = pose[:3, :3].T @ (_knuckle_o(name) - pose[:3, 3])
        else:
            knuckle = 1e-3 * np.array(_KNUCKLES_MM[name])
        metacarpal = SEMI_AXES_MM[name][3]
        fingers.append(
            FingerDescription(
                name=name,
                base=pose_of(knuckle, _base_rotation(name)),
                links=_links(name),
                metacarpal=None if metacarpal is None else _ellipsoid(metacarpal),
            )
        )
    return HandDescription(
        name="humanoid_hand",
        fingers=tuple(fingers),
        density=DENSITY,
        # Not in the paper: generous bounds, so that they do not decide anything in the case study.
        effort=2.0,
        velocity=20.0,
        notes="       Lengths [m], angles [rad] unless a name says _deg. Sources: Tables I, II, III of the paper.\n",
    )


if __name__ == "__main__":
    import sys

    for path in humanoid_hand().write(sys.argv[1] if len(sys.argv) > 1 else "urdf"):
        print(path)
