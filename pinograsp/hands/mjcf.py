"""Hands described in MuJoCo's XML, turned into the URDF that says the same; that is checked and built like any other.

Bodies become links, under their names. A body with several joints, or with a joint that is not at its origin, gets a
link without mass per such joint, called ``body:joint``.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.coupling import Coupling
from pinograsp.hands.drives import Actuation
from pinograsp.hands.elements import drop, written
from pinograsp.hands.finger_names import Labels
from pinograsp.hands.geometry import PRIMITIVES, hull_of, read_mesh, solid
from pinograsp.hands.mesh_mass import counted_mass
from pinograsp.hands.mjcf_drives import actuation_of, couplings_of, effort_limits, rests_of
from pinograsp.hands.mjcf_loops import Loop, close
from pinograsp.hands.mjcf_paint import Paint
from pinograsp.hands.mjcf_source import Source, turned_to
from pinograsp.spatial import Array

_DENSITY = "1000"  # [kg/m^3], MuJoCo's
_TYPES = {"hinge": "revolute", "slide": "prismatic", "free": "floating"}
_MACROS = ("attach", "replicate", "composite", "flexcomp")
_MOST = {"body": 2000, "joint": 2000, "geom": 10_000}
# A body, its default class, its parent's link and its placement there.
_Body: TypeAlias = tuple[ElementTree.Element, str | None, str, pin.SE3]
_SHOWN = 2.0  # the last group of geoms that MuJoCo's viewer shows
_HALF = {"box": 2.0, "cylinder": 2.0, "capsule": 2.0}  # MuJoCo gives half lengths


def to_urdf(
    name: str, element: ElementTree.Element, path: Path, root: str | None, trusted: bool = False
) -> tuple[ElementTree.Element, list[str], list[str], Actuation, Labels]:
    """URDF of an MJCF file, problems, notes, the motors and springs at its joints, and names of sites and geoms.

    Equality constraints between two joints become mimic joints, curves by the line nearest to them; force ranges of
    actuators, and control ranges of motors, become effort limits. With ``root``, only that body and what it carries.
    Files are included from the folder of ``path`` and those below it, with ``trusted`` from anywhere.

    Raises:
        HandNotLoaded: there is no worldbody, or no body called ``root``.
    """
    reader = _Reader(Source(name, element, path, trusted), path)
    reader.read(name, root)
    return reader.robot, reader.source.problems, reader.notes, reader.actuation, reader.labels


class _Reader:
    def __init__(self, source: Source, path: Path):
        self.source = source
        self.notes: list[str] = []
        self.robot = ElementTree.Element("robot", name=source.element.get("model") or path.stem)
        self.joints: dict[str, dict[str, str]] = {}
        self.joint_elements: dict[str, ElementTree.Element] = {}
        self.links: list[str] = []
        self.meshes: dict[str, dict[str, str]] = {}
        for mesh in source.element.findall("asset/mesh"):
            given = source.attributes(mesh)
            self.meshes[given.get("name") or Path(given.get("file", "").replace("\\", "/")).stem] = given
        self.paint = Paint(source)
        self.left_out: list[str] = []
        self.weightless: list[str] = []
        self.actuation = Actuation()
        self.labels: dict[str, dict[str, list[str]]] = {"site": {}, "geom": {}}

    def read(self, name: str, root: str | None) -> None:
        worlds = self.source.element.findall("worldbody")
        if not worlds:
            raise HandNotLoaded(name, [*self.source.problems, "no <worldbody> found: expected a model with bodies"])
        for tag, most in _MOST.items():
            if (count := sum(1 for world in worlds for _ in world.iter(tag))) > most:
                raise HandNotLoaded(name, f"expected at most {most} elements <{tag}>, got {count}")
        if root is None:
            ElementTree.SubElement(self.robot, "link", name="world")
            bodies = [body for world in worlds for body in self._body(world, "world", world.get("childclass"))]
        else:
            bodies = self._sub_tree(name, worlds, root)
        waiting = bodies[::-1]
        while waiting:
            body, childclass, parent, at = waiting.pop()
            waiting += reversed(self._jointed_body(body, childclass, parent, at))
        couplings, loops, opened = couplings_of(self.source, self.joints, self.links, self.notes)
        if loops and not self.source.problems:
            couplings, left = self._closed(couplings, loops)
            opened += [loop.name for loop in left]
        if opened:
            self.notes.append(f"constraints are left out, loops that they close move as if open: {', '.join(opened)}")
        for coupled, coupling in couplings.items():
            mimic = ElementTree.SubElement(self.joint_elements[coupled], "mimic", joint=coupling.followed)
            mimic.attrib.update(multiplier=repr(coupling.factor), offset=repr(coupling.offset))
        for joint, limit in effort_limits(self.source, self.joints, couplings, self.notes).items():
            if (element := self.joint_elements[joint].find("limit")) is not None:
                element.set("effort", repr(limit))
        for pair in self.source.element.findall("contact/exclude"):
            ends = {"link1": pair.get("body1", ""), "link2": pair.get("body2", "")}
            ElementTree.SubElement(self.robot, "disable_collisions", ends)
        self.actuation = actuation_of(self.source, self.joints)
        if self.left_out:
            self.notes.append(f"geoms left out: {', '.join(self.left_out)}")
        if self.weightless:
            self.notes.append(f"geoms whose mass is not known count without: {', '.join(self.weightless)}")
        for setting in ("settotalmass", "balanceinertia"):
            if self.source.compiler.get(setting, "false") not in ("false", "-1"):
                self.notes.append(f"the compiler's {setting} is not applied")

    def _closed(self, couplings: dict[str, Coupling], loops: list[Loop]) -> tuple[dict[str, Coupling], list[Loop]]:
        """The couplings with those that loops bring about, and the loops that stay open."""
        driven = {joint for motor in actuation_of(self.source, self.joints).motors for joint in motor.arms}
        rests = rests_of(self.source, self.joints)
        found, left = close(self.robot, loops, rests, couplings, driven & rests.keys(), self.notes)
        for joint in found:  # its motor's limits bound it
            drop(self.joint_elements[joint], "limit")
        return couplings | found, left

    def _sub_tree(self, name: str, worlds: list[ElementTree.Element], root: str) -> list[_Body]:
        """Read the body ``root``, its frame as the origin; its children are returned."""
        waiting = [
            (body, inherited)
            for world in worlds
            for body, inherited, _ in self.source.contents(world, world.get("childclass"))
            if body.tag == "body"
        ]
        names = []
        for body, inherited in waiting:
            names.append(body.get("name", ""))
            if body.get("name") == root:
                below = self._body(body, self._link(root), body.get("childclass", inherited))
                self.notes.append(f"the sub-tree of '{root}' is the hand: {len(list(body.iter('body')))} bodies")
                return below
            inner = self.source.contents(body, body.get("childclass", inherited))
            waiting += [(child, own) for child, own, _ in inner if child.tag == "body"]
        raise HandNotLoaded(name, f"root '{root}' is not a body; bodies: {', '.join(filter(None, names))}")

    # -- bodies and joints ---------------------------------------------------------------------------------------------

    def _link(self, name: str) -> str:
        ElementTree.SubElement(self.robot, "link", name=name)
        self.links.append(name)
        return name

    def _jointed_body(self, body: ElementTree.Element, childclass: str | None, parent: str, at: pin.SE3) -> list[_Body]:
        """A body, with the joints by which its parent carries it; its children are returned."""
        name = body.get("name") or f"body {len(self.links) + 1}"
        childclass = body.get("childclass", childclass)
        at = at * self.source.placement({"name": name, **body.attrib})
        joints = [
            (child, own, frame)
            for child, own, frame in self.source.contents(body, childclass)
            if child.tag in ("joint", "freejoint")
        ]
        for i, (joint, own, frame) in enumerate(joints):
            given = self.source.attributes(joint, own)
            if joint.tag == "freejoint":
                given["type"] = "free"
            given["name"] = given.get("name") or f"{name} joint" + (f" {i + 1}" if len(joints) > 1 else "")
            before, after, axis = self._around(given, frame)
            last = i + 1 == len(joints) and np.array_equal(after.homogeneous, np.eye(4))
            child = self._link(name if last else f"{name}:{given['name']}")
            if not last:
                _inertial(self.robot[-1], pin.Inertia.Zero())
            self._joint(given, parent, child, at * before, axis)
            parent, at = child, after
        if parent != name:
            self._link(name)
            _joint(self.robot, f"fixed {name}", "fixed", parent, name, at)
        return self._body(body, name, childclass)

    def _around(self, given: dict[str, str], frame: pin.SE3) -> tuple[pin.SE3, pin.SE3, Array]:
        """Placements of the joint in the body before it and of the body in the joint after it, and the axis."""
        axis = frame.rotation @ self.source.direction(given, self.source.numbers(given, "axis", "0 0 1", 3))
        (ref,) = self.source.numbers(given, "ref", "0")
        kind = given.get("type", "hinge")
        if kind == "slide":
            return pin.SE3(np.eye(3), -ref * axis), pin.SE3.Identity(), axis
        if kind != "hinge":
            return pin.SE3.Identity(), pin.SE3.Identity(), axis
        anchor = frame.act(self.source.numbers(given, "pos", "0 0 0", 3))
        turn = pin.AngleAxis(-float(ref) * self._unit(kind), axis).toRotationMatrix()
        return pin.SE3(turn, anchor), pin.SE3(np.eye(3), -anchor), axis

    def _unit(self, kind: str) -> float:
        return math.pi / 180 if kind == "hinge" and self.source.degrees else 1.0

    def _joint(self, given: dict[str, str], parent: str, child: str, at: pin.SE3, axis: Array) -> None:
        name, kind = given["name"], given.get("type", "hinge")
        limited = self.source.limited(given, "limited", "range")
        endless = kind == "hinge" and not limited and "range" not in given
        urdf_kind = "continuous" if endless else _TYPES.get(kind, f"a {kind} joint")
        element = _joint(self.robot, name, urdf_kind, parent, child, at)
        self.joints[name], self.joint_elements[name] = given, element
        if kind not in ("hinge", "slide"):
            return
        ElementTree.SubElement(element, "axis", xyz=written(axis))
        if limited:
            low, high = self.source.numbers(given, "range", "0 0", 2) * self._unit(kind)
            ElementTree.SubElement(element, "limit", lower=repr(float(low)), upper=repr(float(high)))
        dynamics = {"damping": "damping", "friction": "frictionloss", "armature": "armature"}
        values = {key: self.source.numbers(given, theirs, "0", 1, 3)[0] for key, theirs in dynamics.items()}
        ElementTree.SubElement(element, "dynamics", {key: repr(float(value)) for key, value in values.items()})

    # -- masses and shapes ---------------------------------------------------------------------------------------------

    def _body(self, body: ElementTree.Element, link: str, childclass: str | None) -> list[_Body]:
        """Fill the link of a body; its child bodies are returned."""
        element = next(one for one in reversed(self.robot) if one.tag == "link" and one.get("name") == link)
        children: list[_Body] = []
        geoms, own = pin.Inertia.Zero(), None
        low, high = self.source.numbers(self.source.compiler, "inertiagrouprange", "0 5", 2)
        from_geoms = self.source.compiler.get("inertiafromgeom", "auto")
        use_geoms = from_geoms == "true" or (from_geoms == "auto" and body.find("inertial") is None)
        for child, inherited, at in self.source.contents(body, childclass):
            if child.tag in self.labels and (label := child.get("name") or child.get("mesh")):
                self.labels[child.tag].setdefault(link, []).append(label)
            if child.tag == "body":
                children.append((child, inherited, link, at))
            elif child.tag == "inertial" and from_geoms != "true":
                if own is not None:
                    self.source.problem(f"body '{link}' has several <inertial>")
                own = self._given_inertia(child, link, at)
            elif child.tag == "geom":
                given = self.source.attributes(child, inherited)
                inertia = self._geom(element, given, at, use_geoms and body.tag == "body")
                if inertia is not None and low <= self.source.numbers(given, "group", "0")[0] <= high:
                    geoms = geoms + inertia
            elif child.tag in _MACROS:
                self.source.problem(f"body '{link}': <{child.tag}> is not supported; save what MuJoCo makes of it")
        if own is None and use_geoms and geoms.mass > 0:
            own = geoms
        if own is not None:
            _inertial(element, own)
        return children

    def _given_inertia(self, element: ElementTree.Element, link: str, frame: pin.SE3) -> pin.Inertia | None:
        given = {"name": link, **element.attrib}
        at = frame * self.source.placement(given)
        (mass,) = self.source.numbers(given, "mass", "0")
        if "fullinertia" in given:
            xx, yy, zz, xy, xz, yz = self.source.numbers(given, "fullinertia", "0 0 0 0 0 0", 6)
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            inertia = np.diag(self.source.numbers(given, "diaginertia", "0 0 0", 3))
        if mass < 0 or np.linalg.eigvalsh(inertia).min() < -1e-9 * max(np.abs(inertia).max(), 1e-12):
            self.source.problem(f"body '{link}': mass must be >= 0 and the inertia positive, got mass {mass:g}")
            return None
        return at.act(pin.Inertia(float(mass), np.zeros(3), inertia))

    def _geom(
        self, link: ElementTree.Element, given: dict[str, str], frame: pin.SE3, wants_mass: bool
    ) -> pin.Inertia | None:
        """Add a geom that collides to its link; its mass and inertia in the body's frame, where they are wanted."""
        where = f"{link.get('name')} ({given.get('name', given.get('type', 'sphere'))})"
        kind = given.get("type", "sphere")
        collides = any(given.get(key, "1").strip() != "0" for key in ("contype", "conaffinity"))
        if kind == "mesh":
            at, kind, size, path = self._mesh(given)
        elif kind in PRIMITIVES and "mesh" not in given:
            at, size, path = *self._primitive(given, kind), ""
        else:  # planes, height fields, primitives fitted to meshes...
            if collides:
                self.left_out.append(where)
            if wants_mass and kind not in ("plane", "hfield"):
                self.weightless.append(where)
            return None
        at = frame * at
        if not all(size) or (kind != "mesh" and min(size) <= 0):
            self.source.problem(f"geom of {where}: size must be positive, got {' '.join(f'{one:g}' for one in size)}")
            return None
        if collides:
            _shape(link, "collision", at, kind, size, path)
        if self.source.numbers(given, "group", "0")[0] <= _SHOWN:
            _shape(link, "visual", at, kind, size, path)
            self.paint.put_on(link[-1], given)
        return self._geom_inertia(given, where, at, kind, size, path) if wants_mass else None

    def _geom_inertia(
        self, given: dict[str, str], where: str, at: pin.SE3, kind: str, size: Sequence[float], path: str
    ) -> pin.Inertia | None:
        mass = self.source.numbers(given, "mass", "-1")[0]
        (density,) = self.source.numbers(given, "density", _DENSITY)
        if mass == 0 or (mass < 0 and density == 0):
            return None
        try:
            inertia = self._weighed(given, kind, size, path, density if mass < 0 else 1.0)
        except (ValueError, OSError):  # the note on collision geometry says why
            inertia = None
        if inertia is None:
            self.weightless.append(where)
            return None
        if mass > 0:
            inertia = pin.Inertia(float(mass), inertia.lever, inertia.inertia * float(mass) / inertia.mass)
        return at.act(inertia)

    def _weighed(
        self, given: dict[str, str], kind: str, size: Sequence[float], path: str, density: float
    ) -> pin.Inertia | None:
        """Of a shape, None where it is not known; ValueError, OSError: a mesh that cannot be read."""
        if kind != "mesh":
            return solid(PRIMITIVES[kind](*size), density)
        mesh, way = read_mesh(path, tuple(size)), self.meshes[given["mesh"]].get("inertia", "legacy").strip()
        if way == "legacy":
            return counted_mass(mesh, density)
        if way == "convex":
            hull = hull_of(mesh)
            return None if hull is None else solid(hull, density)
        return solid(mesh, density) if way == "exact" else None

    def _primitive(self, given: dict[str, str], kind: str) -> tuple[pin.SE3, list[float]]:
        size = [*self.source.numbers(given, "size", "0", 1, 3), 0.0, 0.0][:3]
        if kind == "sphere" or "fromto" not in given:
            at = self.source.placement(given)
        else:
            ends = self.source.numbers(given, "fromto", "0 0 0 0 0 1", 6)
            along = ends[:3] - ends[3:]
            at = pin.SE3(turned_to(self.source.direction(given, along)), 0.5 * (ends[3:] + ends[:3]))
            half = 0.5 * float(np.linalg.norm(along))
            size = [size[0], half] if kind in ("capsule", "cylinder") else [size[0], size[0], half]
        if kind in ("capsule", "cylinder"):
            return at, [float(size[0]), 2.0 * float(size[1])]
        return at, [float(one) * _HALF.get(kind, 1.0) for one in size[: 1 if kind == "sphere" else 3]]

    def _mesh(self, given: dict[str, str]) -> tuple[pin.SE3, str, list[float], str]:
        """Placement, kind, scale and file of a mesh geom."""
        mesh = self.meshes.get(given.get("mesh", ""), {})
        if not mesh:
            known = ", ".join(self.meshes) or "none"
            self.source.problem(f"a geom names the unknown mesh '{given.get('mesh', '')}'; meshes: {known}")
        file = mesh.get("file", "")
        path = self.source.asset(file, "meshdir")
        origin = self.source.placement({"pos": mesh.get("refpos", "0 0 0"), "quat": mesh.get("refquat", "1 0 0 0")})
        scale = self.source.numbers(mesh, "scale", "1 1 1", 3)
        turned = not np.allclose(origin.rotation, np.eye(3), atol=1e-12)
        if turned and np.ptp(scale) > 0:
            self.source.problem(
                f"mesh '{given.get('mesh', '')}': refquat= works with one scale for all directions only"
            )
        # MuJoCo scales last: scale * R^T (v - p).
        at = pin.SE3(origin.rotation.T, -scale * (origin.rotation.T @ origin.translation))
        return self.source.placement(given) * at, "mesh", scale.tolist(), str(path) if file else ""


# -- URDF elements -----------------------------------------------------------------------------------------------------


def _origin(element: ElementTree.Element, at: pin.SE3) -> None:
    ElementTree.SubElement(
        element, "origin", xyz=written(at.translation), rpy=written(pin.rpy.matrixToRpy(at.rotation))
    )


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, at: pin.SE3
) -> ElementTree.Element:
    element = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    _origin(element, at)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)
    return element


def _inertial(link: ElementTree.Element, inertia: pin.Inertia) -> None:
    element = ElementTree.SubElement(link, "inertial")
    _origin(element, pin.SE3(np.eye(3), inertia.lever))
    ElementTree.SubElement(element, "mass", value=repr(float(inertia.mass)))
    I = inertia.inertia
    values = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(I[i, j])) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(element, "inertia", values)


def _shape(link: ElementTree.Element, tag: str, at: pin.SE3, kind: str, size: Iterable[float], path: str) -> None:
    element = ElementTree.SubElement(link, tag)
    _origin(element, at)
    shape = ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), kind)
    if kind == "mesh":
        shape.attrib.update(filename=path, scale=written(size))
    elif kind in ("box", "ellipsoid"):
        shape.set("size", written(size))
    else:
        shape.attrib.update(zip(("radius", "length"), map(repr, size)))
