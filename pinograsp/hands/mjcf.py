"""Hands described in MuJoCo's XML, as robots of the kind that URDF describes; checked and built like any other.

Bodies become links, under their names. A body with several joints, or with a joint that is not at its origin, gets a
link without mass per such joint, called ``body:joint``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator

import mujoco
import numpy as np
import pinocchio as pin
import yourdfpy

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import LARGEST
from pinograsp.hands.geometry import Triangles
from pinograsp.hands.mjcf_drives import find_couplings, find_effort_limits, read_actuation, read_rests
from pinograsp.hands.mjcf_loops import close_loops
from pinograsp.hands.mjcf_source import Compiled, G, placement
from pinograsp.hands.motors import Actuation
from pinograsp.hands.urdf_file import CAPSULE, ELLIPSOID
from pinograsp.spatial import FARTHEST, Array

_J = mujoco.mjtJoint
_HINGE, _SLIDE, _MESH = int(_J.mjJNT_HINGE), int(_J.mjJNT_SLIDE), int(G.mjGEOM_MESH)
_SHOWN = 2  # the last group of geoms that MuJoCo's viewer shows
_SHAPES = (G.mjGEOM_SPHERE, G.mjGEOM_CAPSULE, G.mjGEOM_CYLINDER, G.mjGEOM_BOX, G.mjGEOM_ELLIPSOID, G.mjGEOM_MESH)
INLINE = "inline:"  # how names of meshes begin that come from no file


class MjcfRobot:
    """The robot of a compiled model, of all of it or of the body ``root`` and what it carries.

    Equality constraints between two joints become mimic joints, curves by the line nearest to them; force ranges of
    actuators, and control ranges of motors, become effort limits.

    Attributes:
        robot: its links and joints.
        armatures: inertia of the motors [kg m^2], by joint.
        collisions: pairs of links whose collisions it excludes, as SRDF has them.
        notes: for the user.
        problems: why it cannot be used.
        actuation: the motors and springs at its joints.
        labels: names of sites and geoms by link.
        inline: meshes that come from no file, by the names that the robot has for them.

    Raises:
        HandNotLoaded: there is no body called ``root``.
    """

    def __init__(self, name: str, compiled: Compiled, root: str | None):
        self.model, self.compiled = compiled.model, compiled
        self.notes, self.problems = list(compiled.notes), list[str]()
        model = self.model
        self.names = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
        self.robot = yourdfpy.Robot(name=compiled.name or name)
        self.armatures: dict[str, float] = {}
        self.collisions = ElementTree.Element("robot")
        self.inline: dict[str, Triangles] = {}
        self.labels: dict[str, dict[str, list[str]]] = {"site": {}, "geom": {}}
        self.joints: dict[str, int] = {}
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
        self._check_sizes(inside)
        for body in sorted(inside):
            self._body(body, self._link(self.names[body]) if body == first else self._jointed_link(body))
        self._tell_shapes(inside)
        self._couple()
        for signature in model.exclude_signature.tolist():
            ends = signature >> 16, signature & 0xFFFF
            if inside.issuperset(ends):
                pair = {f"link{i}": self.names[end] for i, end in enumerate(ends, 1)}
                ElementTree.SubElement(self.collisions, "disable_collisions", pair)

    def _check_sizes(self, inside: set[int]) -> None:
        """List numbers beyond those of any robot: their squares and products would overflow in the end."""
        model, bodies = self.model, list(inside)
        joints, dofs, geoms = (
            np.isin(owners, bodies) for owners in (model.jnt_bodyid, model.dof_bodyid, model.geom_bodyid)
        )
        places = model.body_pos[bodies], model.body_ipos[bodies], model.jnt_pos[joints], model.geom_pos[geoms]
        masses = model.body_mass[bodies], model.body_inertia[bodies], model.dof_armature[dofs]
        losses = model.dof_damping[dofs], model.dof_frictionloss[dofs]
        for what, most, arrays in (
            ("positions", FARTHEST, places),
            ("masses and moments of inertia", LARGEST, masses),
            ("damping and friction", LARGEST, losses),
        ):
            largest = max(float(np.abs(one).max(initial=0.0)) for one in arrays)
            if not largest <= most:
                self.problems.append(f"{what}: expected numbers of at most {most:g}, got {largest:g}")

    def _couple(self) -> None:
        model, joints = self.model, self.joints
        links = {link.name for link in self.robot.links}
        records = {joint.name: joint for joint in self.robot.joints}
        bodies = {body for body, name in enumerate(self.names) if name in links}
        couplings, loops, opened = find_couplings(model, joints, bodies, self.names, self.notes, self.problems)
        if loops and not self.problems:
            motors = read_actuation(model, joints).motors
            rests = read_rests(model, joints)
            driven = {joint for motor in motors for joint in motor.arms} & rests.keys()
            closed, left = close_loops(self.robot, loops, rests, couplings, driven, self.notes)
            for joint in closed:  # its motor's limits bound it
                records[joint].limit = None
            couplings = couplings | closed
            opened += [loop.name for loop in left]
        if opened:
            self.notes.append(
                f"constraints are left out; the loops that they close move as if open: {', '.join(opened)}"
            )
        for coupled, coupling in couplings.items():
            records[coupled].mimic = yourdfpy.Mimic(coupling.followed, coupling.factor, coupling.offset)
        for name, effort in find_effort_limits(model, joints, couplings, self.notes).items():
            if records[name].limit is not None:
                records[name].limit.effort = effort

    # -- bodies and joints ---------------------------------------------------------------------------------------------

    def _link(self, name: str) -> yourdfpy.Link:
        self.robot.links.append(yourdfpy.Link(name=name))
        return self.robot.links[-1]

    def _jointed_link(self, body: int) -> yourdfpy.Link:
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
                link.inertial = yourdfpy.Inertial(mass=0.0, inertia=np.zeros((3, 3)))
            self._joint(joint, called, parent, child, at * before)
            if last:
                return link
            parent, at = child, after
        self._put_joint(f"fixed {name}", "fixed", parent, name, at)
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
        record = self._put_joint(name, urdf_kind, parent, child, at)
        self.joints[name] = joint
        if kind not in (_HINGE, _SLIDE):
            return
        record.axis = model.jnt_axis[joint].copy()
        if limited:
            low, high = model.jnt_range[joint].tolist()
            record.limit = yourdfpy.Limit(lower=low, upper=high)
        dof = model.jnt_dofadr[joint]
        damping, friction, self.armatures[name] = (
            float(np.ravel(values[dof])[0])
            for values in (model.dof_damping, model.dof_frictionloss, model.dof_armature)
        )
        record.dynamics = yourdfpy.Dynamics(damping=damping, friction=friction)

    def _put_joint(self, name: str, kind: str, parent: str, child: str, at: pin.SE3) -> yourdfpy.Joint:
        joint = yourdfpy.Joint(
            name=name, type=kind, parent=parent, child=child, origin=at.homogeneous, axis=np.array([1.0, 0.0, 0.0])
        )
        self.robot.joints.append(joint)
        return joint

    # -- masses and shapes ---------------------------------------------------------------------------------------------

    def _body(self, body: int, link: yourdfpy.Link) -> None:
        """Fill the link of a body."""
        model = self.model
        if body and model.body_mass[body] > 0:
            at = placement(model.body_ipos[body], model.body_iquat[body])
            turned = at.rotation @ np.diag(model.body_inertia[body]) @ at.rotation.T
            link.inertial = yourdfpy.Inertial(
                origin=pin.SE3(np.eye(3), at.translation).homogeneous,
                mass=float(model.body_mass[body]),
                inertia=(turned + turned.T) / 2,
            )
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

    def _geom(self, link: yourdfpy.Link, geom: int) -> None:
        """Add a geom that touches or is seen to its link."""
        model = self.model
        kind = G(int(model.geom_type[geom]))
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        if kind not in _SHAPES:
            if collides:
                self._left_out.append(f"{link.name} ({model.geom(geom).name or 'plane'})")
            return
        at, size = placement(model.geom_pos[geom], model.geom_quat[geom]), model.geom_size[geom].copy()
        radius, length = float(size[0]), 2 * float(size[1])
        if kind == G.mjGEOM_MESH:
            at, mesh = self._mesh(at, int(model.geom_dataid[geom]))
            form = yourdfpy.Geometry(mesh=mesh)
        elif kind == G.mjGEOM_BOX:
            form = yourdfpy.Geometry(box=yourdfpy.Box(2 * size))
        elif kind == G.mjGEOM_SPHERE:
            form = yourdfpy.Geometry(sphere=yourdfpy.Sphere(radius))
        elif kind == G.mjGEOM_CYLINDER:
            form = yourdfpy.Geometry(cylinder=yourdfpy.Cylinder(radius, length))
        elif kind == G.mjGEOM_CAPSULE:
            form = yourdfpy.Geometry(mesh=yourdfpy.Mesh(CAPSULE, np.array([radius, length, 1.0])))
        else:
            form = yourdfpy.Geometry(mesh=yourdfpy.Mesh(ELLIPSOID, size))
        if collides:
            link.collisions.append(yourdfpy.Collision(name=model.geom(geom).name, origin=at.homogeneous, geometry=form))
        if model.geom_group[geom] <= _SHOWN:
            link.visuals.append(yourdfpy.Visual(origin=at.homogeneous, geometry=form, material=self._material(geom)))

    def _mesh(self, at: pin.SE3, mesh: int) -> tuple[pin.SE3, yourdfpy.Mesh]:
        """Placement of a mesh and its file, or as MuJoCo has it where it comes from none."""
        model, name = self.model, self.model.mesh(mesh).name
        if name in self.compiled.placed:
            path, inner = self.compiled.placed[name]
            return at * inner, yourdfpy.Mesh(str(path), model.mesh_scale[mesh].copy())
        vertices, faces = (
            np.array(values[first : first + count])
            for values, first, count in (
                (model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]),
                (model.mesh_face, model.mesh_faceadr[mesh], model.mesh_facenum[mesh]),
            )
        )
        self.inline[INLINE + name] = vertices.astype(float), faces.astype(np.int64)
        return at, yourdfpy.Mesh(INLINE + name)

    def _material(self, geom: int) -> yourdfpy.Material:
        """The colour of a geom that is seen, and the texture of its material.

        Patterns that MuJoCo makes itself become their mean colour.
        """
        model, material = self.model, int(self.model.geom_matid[geom])
        rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        roles = [] if material < 0 else [int(i) for i in np.ravel(model.mat_texid[material]) if i >= 0]
        file = next((self.compiled.textures.get(model.texture(i).name, "") for i in roles), "")
        if roles and not file:
            rgba = rgba * np.append(_mean_colour(model, roles[0]), 1.0)
        texture = yourdfpy.Texture(file) if file else None
        return yourdfpy.Material(color=yourdfpy.Color(rgba.astype(float)), texture=texture)

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
