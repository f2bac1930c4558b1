"""Hands described in MuJoCo's XML, turned into the URDF that says the same; that is checked and built like any other.

Bodies become links, under their names. A body with several joints, or with a joint that is not at its origin, gets a
link without mass per such joint, called ``body:joint``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator

import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.drives import Actuation
from pinograsp.hands.elements import drop, written
from pinograsp.hands.geometry import Triangles
from pinograsp.hands.mjcf_drives import find_couplings, find_effort_limits, read_actuation, read_rests
from pinograsp.hands.mjcf_loops import close
from pinograsp.hands.mjcf_source import Compiled, G, placement
from pinograsp.hands.shapes import INLINE
from pinograsp.spatial import Array

_J = mujoco.mjtJoint
_HINGE, _SLIDE, _MESH = int(_J.mjJNT_HINGE), int(_J.mjJNT_SLIDE), int(G.mjGEOM_MESH)
_SHOWN = 2  # the last group of geoms that MuJoCo's viewer shows
_KINDS = {
    G.mjGEOM_SPHERE: "sphere",
    G.mjGEOM_CAPSULE: "capsule",
    G.mjGEOM_CYLINDER: "cylinder",
    G.mjGEOM_BOX: "box",
    G.mjGEOM_ELLIPSOID: "ellipsoid",
    G.mjGEOM_MESH: "mesh",
}


class Urdf:
    """The URDF of a compiled model, of all of it or of the body ``root`` and what it carries.

    Equality constraints between two joints become mimic joints, curves by the line nearest to them; force ranges of
    actuators, and control ranges of motors, become effort limits.

    Attributes:
        robot: the URDF.
        notes: for the user.
        problems: why it cannot be used.
        actuation: the motors and springs at its joints.
        labels: names of sites and geoms by link.
        inline: meshes that come from no file, by the names that the URDF has for them.

    Raises:
        HandNotLoaded: there is no body called ``root``.
    """

    def __init__(self, name: str, compiled: Compiled, root: str | None):
        self.model, self.compiled = compiled.model, compiled
        self.notes, self.problems = list(compiled.notes), list[str]()
        model = self.model
        self.names = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
        self.robot = ElementTree.Element("robot", name=compiled.name or name)
        self.inline: dict[str, Triangles] = {}
        self.labels: dict[str, dict[str, list[str]]] = {"site": {}, "geom": {}}
        self.joints: dict[str, int] = {}
        self._joint_elements: dict[str, ElementTree.Element] = {}
        self._left_out: list[str] = []
        self._read(name, root)
        self.actuation: Actuation = read_actuation(model, self.joints)

    def _read(self, name: str, root: str | None) -> None:
        model = self.model
        if root is not None and root not in self.names[1:]:
            raise HandNotLoaded(name, f"root '{root}' is not a body; bodies: {', '.join(self.names[1:])}")
        first = 0 if root is None else self.names.index(root)
        inside = {first}
        for body in range(first + 1, model.nbody):
            if model.body_parentid[body] in inside:
                inside.add(body)
        if root is not None:
            self.notes.append(f"the sub-tree of '{root}' is the hand: {len(inside)} bodies")
        for body in sorted(inside):
            self._body(body, self._link(self.names[body]) if body == first else self._jointed_link(body))
        self._tell_shapes(inside)
        self._couple()
        for signature in model.exclude_signature.tolist():
            ends = signature >> 16, signature & 0xFFFF
            if inside.issuperset(ends):
                pair = {f"link{i}": self.names[end] for i, end in enumerate(ends, 1)}
                ElementTree.SubElement(self.robot, "disable_collisions", pair)

    def _couple(self) -> None:
        model, joints = self.model, self.joints
        links = {link.get("name") for link in self.robot.findall("link")}
        bodies = {body for body, name in enumerate(self.names) if name in links}
        couplings, loops, opened = find_couplings(model, joints, bodies, self.names, self.notes, self.problems)
        if loops and not self.problems:
            motors = read_actuation(model, joints).motors
            rests = read_rests(model, joints)
            driven = {joint for motor in motors for joint in motor.arms} & rests.keys()
            closed, left = close(self.robot, loops, rests, couplings, driven, self.notes)
            for joint in closed:  # its motor's limits bound it
                drop(self._joint_elements[joint], "limit")
            couplings = couplings | closed
            opened += [loop.name for loop in left]
        if opened:
            self.notes.append(f"constraints are left out, loops that they close move as if open: {', '.join(opened)}")
        for coupled, coupling in couplings.items():
            mimic = ElementTree.SubElement(self._joint_elements[coupled], "mimic", joint=coupling.followed)
            mimic.attrib.update(multiplier=repr(coupling.factor), offset=repr(coupling.offset))
        for joint, limit in find_effort_limits(model, joints, couplings, self.notes).items():
            if (element := self._joint_elements[joint].find("limit")) is not None:
                element.set("effort", repr(limit))

    # -- bodies and joints ---------------------------------------------------------------------------------------------

    def _link(self, name: str) -> ElementTree.Element:
        return ElementTree.SubElement(self.robot, "link", name=name)

    def _jointed_link(self, body: int) -> ElementTree.Element:
        """The link of a body, with the joints by which its parent carries it."""
        model, name = self.model, self.names[body]
        parent, at = self.names[model.body_parentid[body]], placement(model.body_pos[body], model.body_quat[body])
        own = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        for i, joint in enumerate(own):
            called = model.joint(joint).name or f"{name} joint" + (f" {i + 1}" if len(own) > 1 else "")
            before, after = self._around(joint)
            last = i + 1 == len(own) and np.array_equal(after.homogeneous, np.eye(4))
            child = name if last else f"{name}:{called}"
            link = self._link(child)
            if not last:
                _put_inertial(link, pin.Inertia.Zero())
            self._joint(joint, called, parent, child, at * before)
            parent, at = child, after
        if parent == name:
            return link
        _put_joint(self.robot, f"fixed {name}", "fixed", parent, name, at)
        return self._link(name)

    def _around(self, joint: int) -> tuple[pin.SE3, pin.SE3]:
        """Placements of a joint in the body before it, and of the body in the joint after it."""
        model = self.model
        axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
        if model.jnt_type[joint] == _SLIDE:
            return pin.SE3(np.eye(3), -reference(model, joint) * axis), pin.SE3.Identity()
        if model.jnt_type[joint] != _HINGE:
            return pin.SE3.Identity(), pin.SE3.Identity()
        turn = pin.AngleAxis(-reference(model, joint), axis).toRotationMatrix()
        return pin.SE3(turn, anchor), pin.SE3(np.eye(3), -anchor)

    def _joint(self, joint: int, name: str, parent: str, child: str, at: pin.SE3) -> None:
        model, kind = self.model, int(self.model.jnt_type[joint])
        limited = bool(model.jnt_limited[joint])
        kinds = {_J.mjJNT_SLIDE: "prismatic", _J.mjJNT_FREE: "floating", _J.mjJNT_BALL: "a ball joint"}
        urdf_kind = ("revolute" if limited else "continuous") if kind == _HINGE else kinds[_J(kind)]
        element = _put_joint(self.robot, name, urdf_kind, parent, child, at)
        self.joints[name], self._joint_elements[name] = joint, element
        if kind not in (_HINGE, _SLIDE):
            return
        ElementTree.SubElement(element, "axis", xyz=written(model.jnt_axis[joint]))
        if limited:
            low, high = model.jnt_range[joint].tolist()
            ElementTree.SubElement(element, "limit", lower=repr(low), upper=repr(high))
        dof = model.jnt_dofadr[joint]
        values = {"damping": model.dof_damping, "friction": model.dof_frictionloss, "armature": model.dof_armature}
        ElementTree.SubElement(
            element, "dynamics", {key: repr(float(np.ravel(value[dof])[0])) for key, value in values.items()}
        )

    # -- masses and shapes ---------------------------------------------------------------------------------------------

    def _body(self, body: int, link: ElementTree.Element) -> None:
        """Fill the link of a body."""
        model = self.model
        if body and model.body_mass[body] > 0:
            at = placement(model.body_ipos[body], model.body_iquat[body])
            turned = at.rotation @ np.diag(model.body_inertia[body]) @ at.rotation.T
            inertia = (turned + turned.T) / 2
            _put_inertial(link, pin.Inertia(float(model.body_mass[body]), at.translation, inertia))
        for geom in _of_body(model.body_geomadr, model.body_geomnum, body):
            self._geom(link, geom)
        for kind, ids in (("geom", model.geom_bodyid), ("site", model.site_bodyid)):
            named = [self._label(kind, int(i)) for i in np.flatnonzero(ids == body)]
            if labels := [label for label in named if label]:
                self.labels[kind][self.names[body]] = labels

    def _label(self, kind: str, i: int) -> str:
        model = self.model
        if kind == "site":
            return str(model.site(i).name)
        mesh = int(model.geom_dataid[i]) if model.geom_type[i] == _MESH else -1
        return str(model.geom(i).name or (model.mesh(mesh).name if mesh >= 0 else ""))

    def _geom(self, link: ElementTree.Element, geom: int) -> None:
        """Add a geom that touches or is seen to its link."""
        model = self.model
        kind = _KINDS.get(G(int(model.geom_type[geom])))
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        if kind is None:
            if collides:
                self._left_out.append(f"{link.get('name')} ({model.geom(geom).name or 'plane'})")
            return
        at, size = placement(model.geom_pos[geom], model.geom_quat[geom]), model.geom_size[geom]
        attributes: dict[str, str] = {}
        if kind == "mesh":
            at, attributes = self._mesh(at, int(model.geom_dataid[geom]))
        elif kind in ("box", "ellipsoid"):
            attributes = {"size": written(2 * size if kind == "box" else size)}
        else:
            attributes = {"radius": repr(float(size[0]))}
            if kind != "sphere":
                attributes["length"] = repr(2 * float(size[1]))
        for tag, wanted in (("collision", collides), ("visual", model.geom_group[geom] <= _SHOWN)):
            if wanted:
                shape = ElementTree.SubElement(link, tag)
                _put_origin(shape, at)
                ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), kind, attributes)
                if tag == "visual":
                    self._paint(shape, geom)

    def _mesh(self, at: pin.SE3, mesh: int) -> tuple[pin.SE3, dict[str, str]]:
        """Placement and attributes of a mesh: of its file, or as MuJoCo has it where it comes from none."""
        model, name = self.model, self.model.mesh(mesh).name
        if name in self.compiled.placed:
            path, inner = self.compiled.placed[name]
            return at * inner, {"filename": str(path), "scale": written(model.mesh_scale[mesh])}
        vertices, faces = (
            np.array(values[first : first + count])
            for values, first, count in (
                (model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]),
                (model.mesh_face, model.mesh_faceadr[mesh], model.mesh_facenum[mesh]),
            )
        )
        self.inline[INLINE + name] = vertices.astype(float), faces.astype(np.int64)
        return at, {"filename": INLINE + name, "scale": "1 1 1"}

    def _paint(self, visual: ElementTree.Element, geom: int) -> None:
        """Give a geom that is seen its colour, and the texture of its material.

        Patterns that MuJoCo makes itself become their mean colour.
        """
        model, material = self.model, int(self.model.geom_matid[geom])
        rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        roles = [] if material < 0 else [int(i) for i in np.ravel(model.mat_texid[material]) if i >= 0]
        file = next((self.compiled.textures.get(model.texture(i).name, "") for i in roles), "")
        if roles and not file:
            rgba = rgba * np.append(_mean_colour(model, roles[0]), 1.0)
        paint = ElementTree.SubElement(visual, "material")
        ElementTree.SubElement(paint, "color", rgba=written(rgba))
        if file:
            ElementTree.SubElement(paint, "texture", filename=file)

    def _tell_shapes(self, inside: Iterable[int]) -> None:
        links = {self.names[body] for body in inside}
        gone = [(body or "world", why) for body, why in self.compiled.left_out]
        missing = [f"{body} ({why})" for body, why in gone if body in links]
        if self._left_out:
            self.notes.append(f"geoms left out: {', '.join(self._left_out)}")
        if missing:
            self.notes.append(
                "meshes not found or not readable, so these shapes are left out, and their masses, where no <inertial> "
                f"gives them: {', '.join(missing)}"
            )


def _mean_colour(model: mujoco.MjModel, texture: int) -> Array:
    """The mean colour (3,), 0 to 1, of a picture that MuJoCo has made."""
    channels = int(model.tex_nchannel[texture])
    count = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
    first = int(model.tex_adr[texture])
    pixels = model.tex_data[first : first + count].reshape(-1, channels)[:, :3]
    return np.broadcast_to(pixels.mean(axis=0) / 255, 3).astype(float)


def reference(model: mujoco.MjModel, joint: int) -> float:
    """The position of a hinge or slide as the bodies are written down [rad or m]."""
    return float(model.qpos0[model.jnt_qposadr[joint]])


def _of_body(first: Array, count: Array, body: int) -> Iterator[int]:
    yield from range(int(first[body]), int(first[body]) + int(count[body]))


# -- URDF elements -----------------------------------------------------------------------------------------------------


def _put_origin(element: ElementTree.Element, at: pin.SE3) -> None:
    ElementTree.SubElement(
        element, "origin", xyz=written(at.translation), rpy=written(pin.rpy.matrixToRpy(at.rotation))
    )


def _put_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, at: pin.SE3
) -> ElementTree.Element:
    element = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    _put_origin(element, at)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)
    return element


def _put_inertial(link: ElementTree.Element, inertia: pin.Inertia) -> None:
    element = ElementTree.SubElement(link, "inertial")
    _put_origin(element, pin.SE3(np.eye(3), inertia.lever))
    ElementTree.SubElement(element, "mass", value=repr(float(inertia.mass)))
    I = inertia.inertia
    values = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(I[i, j])) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(element, "inertia", values)
