"""Three hands as URDF text, for tests that need one they know by heart: primitives only, effort limits, coupled joints.

All grasp along +z of their palm; x is the direction in which the grippers open. Lengths in m, masses in kg.
"""

from __future__ import annotations

import math
from pathlib import Path


def _moments(shape: str, mass: float) -> tuple[float, float, float]:
    kind, *size = shape.split()
    size = [float(value) for value in size]
    if kind == "box":
        a, b, c = (mass / 12 * edge**2 for edge in size)
        return b + c, a + c, a + b
    if kind == "cylinder":
        radius, length = size
        across = mass * (3 * radius**2 + length**2) / 12
        return across, across, mass * radius**2 / 2
    return (0.4 * mass * size[0] ** 2,) * 3


def _shape(shape: str) -> str:
    kind, *size = shape.split()
    if kind == "box":
        return f'<box size="{" ".join(size)}"/>'
    if kind == "cylinder":
        return f'<cylinder radius="{size[0]}" length="{size[1]}"/>'
    return f'<sphere radius="{size[0]}"/>'


def link(name: str, mass: float = 0.0, shape: str = "", at: str = "0 0 0", more=()) -> str:
    """A link with mass and inertia of ``shape`` at ``at``; ``more`` (shape, place) only collide. No mass: a frame."""
    if not mass:
        return f'<link name="{name}"/>'
    xx, yy, zz = _moments(shape, mass)
    collisions = "".join(
        f'<collision><origin xyz="{place}"/><geometry>{_shape(one)}</geometry></collision>'
        for one, place in ((shape, at), *more)
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial>{collisions}</link>'
    )


def joint(
    name: str,
    parent: str,
    child: str,
    at: str,
    axis: str = "",
    limit: str = "",
    *,
    rpy: str = "0 0 0",
    kind: str = "revolute",
    mimic: str = "",
) -> str:
    """A joint, fixed without ``axis``. ``limit``: lower upper effort velocity. ``mimic``: joint factor offset."""
    inner = ""
    if axis:
        lower, upper, effort, velocity = limit.split()
        inner = f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>'
    if mimic:
        followed, multiplier, offset = mimic.split()
        inner += f'<mimic joint="{followed}" multiplier="{multiplier}" offset="{offset}"/>'
    return (
        f'<joint name="{name}" type="{kind if axis else "fixed"}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{rpy}"/>{inner}</joint>'
    )


def robot(name: str, *parts: str) -> str:
    """A whole description."""
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n' + "\n".join(parts) + "\n</robot>\n"


# Two jaws of 8 cm turn about y; the right one mirrors the left. At 0 they are parallel and 8 cm apart; + closes.
PLANAR_GRIPPER = robot(
    "planar_gripper",
    link("palm", 0.3, "box 0.12 0.04 0.03", "0 0 -0.015"),
    *(
        part
        for side, x, mimic in (("left", "-0.046", ""), ("right", "0.046", "left_hinge -1 0"))
        for part in (
            link(f"{side}_jaw", 0.04, "box 0.012 0.02 0.08", "0 0 0.04"),
            link(f"{side}_tip"),
            joint(
                f"{side}_hinge",
                "palm",
                f"{side}_jaw",
                f"{x} 0 0",
                "0 1 0",
                "-0.6 0.6 2.0 3.0" if mimic else "-0.3 0.6 2.0 3.0",
                mimic=mimic,
            ),
            joint(f"{side}_end", f"{side}_jaw", f"{side}_tip", "0 0 0.08"),
        )
    ),
)

# Three fingers of 8.5 cm around the palm; every distal joint turns 0.7 times the proximal one plus 0.1 rad.
THREE_FINGERS = robot(
    "three_fingers",
    link("palm", 0.4, "box 0.1 0.1 0.03", "0 0 -0.015"),
    *(
        part
        for i, angle in enumerate((0.0, 2 * math.pi / 3, 4 * math.pi / 3), 1)
        for part in (
            link(f"finger{i}_proximal", 0.03, "cylinder 0.008 0.05", "0 0 0.025"),
            link(f"finger{i}_distal", 0.018, "cylinder 0.007 0.028", "0 0 0.014", (("sphere 0.007", "0 0 0.028"),)),
            link(f"finger{i}_tip"),
            # Flexion about -y of a frame whose x points away from the middle: + closes towards the middle.
            joint(
                f"finger{i}_flexion",
                "palm",
                f"finger{i}_proximal",
                f"{0.045 * math.cos(angle)!r} {0.045 * math.sin(angle)!r} 0",
                "0 -1 0",
                "-0.4 1.2 1.5 4.0",
                rpy=f"0 0 {angle!r}",
            ),
            joint(
                f"finger{i}_coupled",
                f"finger{i}_proximal",
                f"finger{i}_distal",
                "0 0 0.05",
                "0 -1 0",
                "-0.2 1.0 1.0 4.0",
                mimic=f"finger{i}_flexion 0.7 0.1",
            ),
            joint(f"finger{i}_end", f"finger{i}_distal", f"finger{i}_tip", "0 0 0.035"),
        )
    ),
)

# Two jaws of 7 cm slide along x, 0 closed, 4 cm each open; the right one goes the other way along its own axis.
PARALLEL_GRIPPER = robot(
    "parallel_gripper",
    link("palm", 0.5, "box 0.12 0.05 0.04", "0 0 -0.02"),
    *(
        part
        for side, axis, mimic in (("left", "1 0 0", ""), ("right", "-1 0 0", "left_slide 1 0"))
        for part in (
            link(f"{side}_jaw", 0.06, "box 0.014 0.02 0.07", f"{'' if side == 'left' else '-'}0.007 0 0.035"),
            link(f"{side}_tip"),
            joint(
                f"{side}_slide", "palm", f"{side}_jaw", "0 0 0", axis, "0 0.04 60 0.1", kind="prismatic", mimic=mimic
            ),
            joint(f"{side}_end", f"{side}_jaw", f"{side}_tip", "0 0 0.07"),
        )
    ),
)

HANDS = {
    "planar_gripper": PLANAR_GRIPPER,
    "three_fingers": THREE_FINGERS,
    "parallel_gripper": PARALLEL_GRIPPER,
}


def write(folder: Path, name: str) -> Path:
    """Write one of ``HANDS`` to a file and return its path."""
    path = Path(folder) / f"{name}.urdf"
    path.write_text(HANDS[name], encoding="utf-8")
    return path


def chuck(k: int) -> str:
    """Jaws at 360/k degrees slide towards the upright z axis; they touch the object at the height of its centre."""
    parts = [link("palm", 0.5, "cylinder 0.06 0.02", "0 0 -0.08")]
    for i in range(k):
        a = 2 * math.pi * i / k
        parts += [
            link(f"jaw{i}", 0.05, "sphere 0.008"),
            joint(
                f"slide{i}",
                "palm",
                f"jaw{i}",
                f"{0.06 * math.cos(a)!r} {0.06 * math.sin(a)!r} 0",
                "-1 0 0",
                "0 0.055 200 1",
                rpy=f"0 0 {a!r}",
                kind="prismatic",
            ),
        ]
    return robot(f"chuck{k}", *parts)


def parallel_gripper() -> str:
    """Two fingers of 9 cm that one motor turns, each held upright by a coupled joint and by a bar that ends in nothing.

    The bar turns beside the finger's lower link, 16 mm further in, and overlaps the upper one, where a pin would be.
    """
    parts = [link("palm", 0.3, "box 0.16 0.04 0.02", "0 0 -0.02")]
    for side, sign in (("left", 1), ("right", -1)):
        motor, along, against = "left_knuckle", f"left_knuckle {sign} 0", f"left_knuckle {-sign} 0"
        limits = "-0.2 0.8 5 2" if sign == 1 else "-0.8 0.2 5 2"
        bar = f"{side}_inner_knuckle"
        parts += [
            link(f"{side}_outer", 0.02, "box 0.008 0.01 0.04", "0 0 0.02"),
            link(f"{side}_finger", 0.02, "box 0.012 0.02 0.05", f"{0.008 * sign} 0 0.025"),
            link(bar, 0.01, "box 0.006 0.01 0.044", "0 0 0.022"),
            joint(
                f"{side}_knuckle",
                "palm",
                f"{side}_outer",
                f"{-0.05 * sign} 0 0",
                "0 1 0",
                limits,
                mimic="" if f"{side}_knuckle" == motor else along,
            ),
            joint(f"{side}_upright", f"{side}_outer", f"{side}_finger", "0 0 0.04", "0 1 0", "-1 1 5 2", mimic=against),
            joint(f"{side}_bar", "palm", bar, f"{-0.034 * sign} 0 0", "0 1 0", "-1 1 5 2", mimic=along),
        ]
    return robot("parallel_gripper", *parts)
