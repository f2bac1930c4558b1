"""A hand described by Denavit-Hartenberg rows and ellipsoidal phalanges, written out as xacro and URDF.

Classical DH: A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i). In URDF the frame of joint i is frame {i-1} of the table,
its axis is z, and the placement of joint i+1 in link i is Tz(d_i) Tx(a_i) Rx(alpha_i).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of, items_of, number, placement_of, shorten, text_of
from pinograsp.spatial import Array, pose_of


@dataclass(frozen=True, slots=True, kw_only=True)
class PhalanxShape:
    """Semi-axes [m]: ``a`` along the link, ``b`` along the flexion axis, ``c`` perpendicular to both."""

    a: float
    b: float
    c: float

    def __post_init__(self) -> None:
        for name in ("a", "b", "c"):
            object.__setattr__(self, name, number(f"semi-axis {name}", getattr(self, name), above=0, unit="m"))

    def mass(self, density: float) -> float:
        """Mass [kg] at ``density`` [kg/m^3]."""
        return density * 4 / 3 * math.pi * self.a * self.b * self.c


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One DH row with the joint before it and the phalanx on it.

    Attributes:
        joint: joint name.
        link: link name.
        d, a: offset and length [m].
        alpha: twist [rad].
        lower, upper: joint range [rad].
        phalanx: the ellipsoid centred half-way along the link, or None for a massless link.
    """

    joint: str
    link: str
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    lower: float
    upper: float
    phalanx: PhalanxShape | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        text_of("name of the joint", self.joint)
        text_of("name of the link", self.link)
        for name in ("d", "a", "alpha", "lower", "upper"):
            object.__setattr__(self, name, number(f"{name} of link {shorten(self.link)}", getattr(self, name)))
        instance_of("phalanx", self.phalanx, PhalanxShape, type(None))


@dataclass(frozen=True, slots=True, kw_only=True)
class FingerDescription:
    """A serial finger: base frame {0} in the palm frame (4, 4), rows from base to tip, optional metacarpal."""

    name: str
    base: Array
    links: tuple[Link, ...]
    metacarpal: PhalanxShape | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        text_of("name of the finger", self.name)
        object.__setattr__(self, "base", placement_of("base of the finger", self.base))
        object.__setattr__(self, "links", items_of("links", self.links, Link))
        instance_of("metacarpal", self.metacarpal, PhalanxShape, type(None))

    def frames(self, q: ArrayLike) -> list[Array]:
        """DH frames {0}..{n} in the palm frame at joint angles ``q`` [rad]; the last one is the fingertip."""
        frames = [np.array(self.base)]
        for link, angle in zip(self.links, array_of("q", q, (len(self.links),)).tolist()):
            c, s, ca, sa = math.cos(angle), math.sin(angle), math.cos(link.alpha), math.sin(link.alpha)
            step = np.array(
                [
                    [c, -s * ca, s * sa, link.a * c],
                    [s, c * ca, -c * sa, link.a * s],
                    [0, sa, ca, link.d],
                    [0, 0, 0, 1],
                ]
            )
            frames.append(frames[-1] @ step)
        return frames


@dataclass(frozen=True, slots=True, kw_only=True)
class HandDescription:
    """A palm and its fingers. ``effort`` [N m] and ``velocity`` [rad/s] are the limits written for every joint."""

    name: str
    fingers: tuple[FingerDescription, ...]
    density: float
    effort: float
    velocity: float
    notes: str = ""

    __repr__ = brief()

    def __post_init__(self) -> None:
        text_of("name of the hand", self.name)
        text_of("notes", self.notes)
        object.__setattr__(self, "fingers", items_of("fingers", self.fingers, FingerDescription))
        for name, unit in (("density", "kg/m^3"), ("effort", "N m"), ("velocity", "rad/s")):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0, unit=unit))

    def to_xacro(self) -> str:
        """The description as a xacro text; its one argument is ``density`` [kg/m^3]."""
        blocks = [_HEADER.format(name=quoteattr(self.name), notes=self.notes, **self._numbers())]
        blocks += [_finger_xacro(finger) for finger in self.fingers]
        return "\n".join(blocks) + "\n</robot>\n"

    def _numbers(self) -> dict[str, str]:
        return {"density": _exact(self.density), "effort": _exact(self.effort), "velocity": _exact(self.velocity)}

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write ``<name>.urdf.xacro`` and the ``<name>.urdf`` that xacro makes of it; returns both paths."""
        from pinograsp.hands.xacro_files import expand_xacro

        source = Path(folder) / f"{self.name}.urdf.xacro"
        source.write_text(self.to_xacro(), encoding="utf-8")
        urdf = Path(folder) / f"{self.name}.urdf"
        urdf.write_text(expand_xacro(source), encoding="utf-8")
        return source, urdf


def _exact(value: float) -> str:
    """Decimal text of 13 significant digits: frames keep 1e-12 m, and the last bits, which differ from machine to
    machine, vanish.
    """
    return f"{value:.13g}" if abs(value) > 1e-14 else "0"


def _finger_xacro(finger: FingerDescription) -> str:
    lines = [f"\n  <!-- {finger.name} -->"]
    placement, parent = finger.base, "palm"
    if finger.metacarpal is not None:
        e = finger.metacarpal
        xyz = " ".join(_exact(v) for v in finger.base[:3, 3])
        lines.append(
            f'  <xacro:metacarpal finger="{finger.name}" knuckle="{xyz}" '
            f'a="{_exact(e.a)}" b="{_exact(e.b)}" c="{_exact(e.c)}"/>'
        )
    for link in finger.links:
        xyz = " ".join(_exact(v) for v in placement[:3, 3])
        rpy = " ".join(_exact(v) for v in _rpy(placement[:3, :3]))
        lines.append(
            f'  <xacro:joint_and_link joint="{link.joint}" parent="{parent}" link="{link.link}" xyz="{xyz}" '
            f'rpy="{rpy}"\n    lower_deg="{_exact(math.degrees(link.lower))}" '
            f'upper_deg="{_exact(math.degrees(link.upper))}">'
        )
        if link.phalanx is None:
            lines.append("    <body><xacro:massless/></body>")
        else:
            e = link.phalanx
            lines.append(
                f'    <body><xacro:ellipsoid x="{_exact(link.a / 2)}" a="{_exact(e.a)}" b="{_exact(e.b)}" '
                f'c="{_exact(e.c)}"/></body>'
            )
        lines.append("  </xacro:joint_and_link>")
        twist = np.array(
            [
                [1, 0, 0],
                [0, math.cos(link.alpha), -math.sin(link.alpha)],
                [0, math.sin(link.alpha), math.cos(link.alpha)],
            ]
        )
        placement, parent = pose_of([link.a, 0, link.d], twist), link.link
    xyz = " ".join(_exact(v) for v in placement[:3, 3])
    lines.append(f'  <xacro:tip finger="{finger.name}" parent="{parent}" xyz="{xyz}"/>')
    return "\n".join(lines)


def _rpy(rotation: Array) -> tuple[float, float, float]:
    # A DH hand's base and twist rotations stay clear of pitch = 90 deg, where rpy is singular.
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0])),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


_HEADER = """<?xml version="1.0"?>
<robot name={name} xmlns:xacro="http://www.ros.org/wiki/xacro">
  <!-- Written from the package's DH description of this hand; change the tables there, not this file.
{notes}  -->
  <xacro:arg name="density" default="{density}"/>
  <xacro:property name="density" value="$(arg density)"/>
  <xacro:property name="effort" value="{effort}"/>
  <xacro:property name="velocity" value="{velocity}"/>

  <!-- A homogeneous ellipsoid, centre at (x, 0, 0), semi-axes a, b, c along x, z, y of the link frame.
       URDF has no ellipsoid: the picture is a unit sphere scaled; inertia is exact. -->
  <xacro:macro name="ellipsoid" params="x a b c">
    <xacro:property name="m" value="${{density*4/3*pi*a*b*c}}"/>
    <inertial>
      <origin xyz="${{x}} 0 0" rpy="0 0 0"/>
      <mass value="${{m}}"/>
      <inertia ixx="${{m/5*(b*b+c*c)}}" iyy="${{m/5*(a*a+b*b)}}" izz="${{m/5*(a*a+c*c)}}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin xyz="${{x}} 0 0" rpy="0 0 0"/>
      <geometry><mesh filename="meshes/unit_sphere.stl" scale="${{a}} ${{c}} ${{b}}"/></geometry>
    </visual>
    <collision>
      <origin xyz="${{x}} 0 0" rpy="0 0 0"/>
      <geometry><mesh filename="meshes/unit_sphere.stl" scale="${{a}} ${{c}} ${{b}}"/></geometry>
    </collision>
  </xacro:macro>

  <!-- A link of zero length (the first of an abduction/flexion pair): said to be massless, not forgotten. -->
  <xacro:macro name="massless">
    <inertial>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <mass value="0"/>
      <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </xacro:macro>

  <xacro:macro name="joint_and_link" params="joint parent link xyz rpy lower_deg upper_deg **body">
    <joint name="${{joint}}" type="revolute">
      <parent link="${{parent}}"/>
      <child link="${{link}}"/>
      <origin xyz="${{xyz}}" rpy="${{rpy}}"/>
      <axis xyz="0 0 1"/>
      <limit lower="${{radians(lower_deg)}}" upper="${{radians(upper_deg)}}" effort="${{effort}}"
             velocity="${{velocity}}"/>
    </joint>
    <link name="${{link}}">
      <xacro:insert_block name="body"/>
    </link>
  </xacro:macro>

  <xacro:macro name="tip" params="finger parent xyz">
    <joint name="${{finger}}_tip_joint" type="fixed">
      <parent link="${{parent}}"/>
      <child link="${{finger}}_tip"/>
      <origin xyz="${{xyz}}" rpy="0 0 0"/>
    </joint>
    <link name="${{finger}}_tip"/>
  </xacro:macro>

  <!-- Part of the palm: from the knuckle back towards the wrist (-x of the palm), b across it, c along its normal. -->
  <xacro:macro name="metacarpal" params="finger knuckle a b c">
    <joint name="${{finger}}_metacarpal_joint" type="fixed">
      <parent link="palm"/>
      <child link="${{finger}}_metacarpal"/>
      <origin xyz="${{knuckle}}" rpy="${{pi/2}} 0 0"/>
    </joint>
    <link name="${{finger}}_metacarpal">
      <xacro:ellipsoid x="${{-a}}" a="${{a}}" b="${{b}}" c="${{c}}"/>
    </link>
  </xacro:macro>

  <!-- Palm frame: origin at the middle finger's knuckle, x along the extended fingers, z the palm's normal. -->
  <link name="palm"/>
"""
