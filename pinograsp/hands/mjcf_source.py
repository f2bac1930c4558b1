"""MJCF as MuJoCo's own compiler has it. Meshes are read and checked before: MuJoCo opens no file."""

from __future__ import annotations

import copy
import math
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.checks import one_line
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.file_reads import is_there
from pinograsp.hands.mesh_file import read_triangles
from pinograsp.hands.mjcf_document import MjcfDocument
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.spatial import Array

_SPECK = 1e-6  # [m] radius of what stands for a shape that is left out
_LEAST_TURN = 2 * math.pi  # [deg] some hinge of a hand turns farther
_LEAST_MASS = 1e-9  # [kg], [kg m^2] of bodies whose only shapes are left out: MuJoCo wants some
# Stands for a mesh that is only seen, of which MuJoCo needs nothing.
_CORNERS, _FACES = (
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)
G = mujoco.mjtGeom


@dataclass(slots=True)
class Compiled:
    """A model that MuJoCo has compiled.

    Attributes:
        model: MuJoCo's.
        name: of the model; empty where it has none.
        placed: by mesh that comes from a file, that file, and where its vertices are, which are scaled first, in the
            mesh's frame.
        textures: by texture that comes from a file, that file.
        missing: meshes that cannot be read, by name, and why.
        left_out: shapes that are left out: their bodies and what they are called, or why.
        notes: for the user.
    """

    model: mujoco.MjModel
    name: str = ""
    placed: dict[str, tuple[Path, pin.SE3]] = field(default_factory=dict)
    textures: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def compile_file(name: str, element: ElementTree.Element, path: Path, trusted: bool) -> Compiled:
    """The compiled model of an MJCF file; ``element``, its outermost one, stays as it is.

    Args:
        name: what to call it in errors.
        path: of the file; included files and meshes are looked for from its folder on.
        trusted: let it include files from outside its own folder.

    Raises:
        HandNotLoaded: broken, too large, files outside of its folder, or what MuJoCo refuses it for.
    """
    document = MjcfDocument(name, path.resolve().parent, trusted)
    element = copy.deepcopy(element)
    text = document.read(element, path)
    if document.problems:
        raise HandNotLoaded(name, list(dict.fromkeys(document.problems)))
    try:
        with without_callbacks():
            spec = mujoco.MjSpec.from_string(text, include=document.models)
    except ValueError as error:
        raise _refusal(name, error) from error
    told = document.models or any("angle" in compiler.attrib for compiler in element.iter("compiler"))
    if not told and _in_radians(spec):
        spec.compiler.degree = False
        document.notes.append(
            "in degrees, MuJoCo's default without <compiler angle=>, no hinge could turn farther than "
            f'{_LEAST_TURN:.2g}: all angles of the file are taken as radians (<compiler angle="degree"/> keeps them)'
        )
    return _compile_spec(name, spec, document.notes)


def _in_radians(spec: mujoco.MjSpec) -> bool:
    """Whether angles of a specification are so small that nobody means degrees: it is made to be included in others,
    which say that they are in radians.
    """
    hinges = [joint.range for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    turned = [one.alt for one in (*spec.bodies, *spec.geoms, *spec.frames, *spec.sites)]
    turns = [one.euler for one in turned if one.type == mujoco.mjtOrientation.mjORIENTATION_EULER]
    turns += [one.axisangle[3:] for one in turned if one.type == mujoco.mjtOrientation.mjORIENTATION_AXISANGLE]
    largest, most = (np.abs(np.concatenate([[0.0], *angles])).max() for angles in (hinges, turns))
    return bool(0 < largest <= _LEAST_TURN and most <= _LEAST_TURN)


def compile_spec(name: str, spec: mujoco.MjSpec) -> Compiled:
    """The compiled model of a specification, which stays as it is; it reads its own files.

    Raises:
        HandNotLoaded: what MuJoCo refuses it for.
    """
    notes: list[str] = []
    # Compiled first: the copy of a specification that is attached to another one would bring the process down.
    model = _compile(name, spec, notes)
    if spec.compiler.fusestatic or spec.compiler.discardvisual:
        spec = spec.copy()
        _keep_everything(spec)
        model = _compile(name, spec, notes)
    return Compiled(model, _given_name(spec), notes=list(dict.fromkeys(notes)))


def _keep_everything(spec: mujoco.MjSpec) -> None:
    """Let MuJoCo leave all bodies and shapes of a specification in the model."""
    spec.compiler.fusestatic = spec.compiler.discardvisual = False


def _compile(name: str, spec: mujoco.MjSpec, notes: list[str]) -> mujoco.MjModel:
    """What MuJoCo makes of a specification; its warnings are noted."""
    with warnings.catch_warnings(record=True) as told, without_callbacks():
        warnings.simplefilter("always")
        try:
            model = spec.compile()
        except ValueError as error:
            raise _refusal(name, error) from error
    notes += [f"MuJoCo: {one_line(ValueError(warning.message))}" for warning in told]
    return model


def _refusal(name: str, error: Exception) -> HandNotLoaded:
    return HandNotLoaded(name, f"MuJoCo rejects it: {one_line(error).removeprefix('Error: ')}")


# -- compiled ----------------------------------------------------------------------------------------------------------


def _compile_spec(name: str, spec: mujoco.MjSpec, notes: list[str]) -> Compiled:
    """Compile a specification in which files are named by whole paths, after these were read."""
    found = Compiled(None, _given_name(spec), notes=notes)
    _keep_everything(spec)
    for texture in spec.textures:
        named = [one for one in (texture.file, *texture.cubefiles) if one]
        if named:
            found.textures[texture.name] = named[0]
            texture.file, texture.content_type = "", ""
            for i in range(len(texture.cubefiles)):
                texture.cubefiles[i] = ""
            texture.builtin, texture.width, texture.height = mujoco.mjtBuiltin.mjBUILTIN_FLAT, 1, 1
    for skin in list(spec.skins):
        spec.delete(skin)
    users: dict[str, list[mujoco.MjsGeom]] = {}
    for geom in spec.geoms:
        if geom.type == G.mjGEOM_HFIELD:
            _leave_out(geom, found)
        elif geom.meshname:
            users.setdefault(geom.meshname, []).append(geom)
    for hfield in list(spec.hfields):
        spec.delete(hfield)
    placements = {}
    for mesh in list(spec.meshes):
        geoms = users.get(mesh.name, [])
        if mesh.file:
            placements[mesh.name] = Path(mesh.file), np.array(mesh.scale), _reference(mesh)
            _read_mesh(mesh, any(_counts(spec, geom) for geom in geoms), found)
        if mesh.name in found.missing:
            for geom in geoms:
                _leave_out(geom, found)
            spec.delete(mesh)
    try:
        found.model = _compile(name, spec, notes)
    except HandNotLoaded as error:
        if not found.missing or "mjMINVAL" not in str(error):
            raise
        spec.compiler.boundmass = spec.compiler.boundinertia = _LEAST_MASS
        found.model = _compile(name, spec, notes)
        light = found.model.body_mass <= _LEAST_MASS
        found.model.body_mass[light], found.model.body_inertia[light] = 0.0, 0.0
    for i in range(found.model.nmesh):
        mesh_name = found.model.mesh(i).name
        if mesh_name in placements:
            path, scale, reference = placements[mesh_name]
            if reference is not None and mesh_name not in found.missing:
                principal = placement(found.model.mesh_pos[i], found.model.mesh_quat[i])
                at = pin.SE3(reference.rotation.T, -scale * (reference.rotation.T @ reference.translation))
                found.placed[mesh_name] = path, principal.inverse() * at
    return found


def _given_name(spec: mujoco.MjSpec) -> str:
    """The model's name; MuJoCo gives one to those that have none."""
    return "" if spec.modelname == "MuJoCo Model" else str(spec.modelname)


def _leave_out(geom: mujoco.MjsGeom, found: Compiled) -> None:
    """Put a speck that nothing touches where a shape is, since others may name it."""
    called = geom.name or geom.hfieldname or "height field"
    found.left_out.append((geom.parent.name, found.missing.get(geom.meshname, called)))
    geom.type, geom.size, geom.fromto = G.mjGEOM_SPHERE, [_SPECK, 0, 0], [math.nan] * 6
    geom.contype = geom.conaffinity = 0
    geom.mass, geom.meshname, geom.hfieldname, geom.group = 0.0, "", "", 5


def _counts(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Whether a mesh's own form matters: it touches, weighs something or gives a primitive its size."""
    if geom.contype or geom.conaffinity or geom.type != G.mjGEOM_MESH:
        return True
    low, high = spec.compiler.inertiagrouprange
    ways = mujoco.mjtInertiaFromGeom
    given = geom.parent.explicitinertial and spec.compiler.inertiafromgeom != ways.mjINERTIAFROMGEOM_TRUE
    weightless = geom.mass == 0 or (math.isnan(geom.mass) and geom.density == 0)
    return not (given or weightless or spec.compiler.inertiafromgeom == ways.mjINERTIAFROMGEOM_FALSE) and (
        low <= geom.group <= high
    )


def _reference(mesh: mujoco.MjsMesh) -> pin.SE3 | None:
    """What is taken off a mesh's vertices before they are scaled; None where no placement comes to the same."""
    reference = placement(mesh.refpos, mesh.refquat)
    turned = not np.allclose(reference.rotation, np.eye(3), atol=1e-12)
    return None if turned and np.ptp(mesh.scale) > 0 else reference


def _read_mesh(mesh: mujoco.MjsMesh, counts: bool, found: Compiled) -> None:
    """Give a mesh the vertices and faces of its file."""
    path = Path(mesh.file)
    if not counts and is_there(path):
        vertices, faces = _CORNERS, _FACES
    else:
        try:
            vertices, faces = read_triangles(path)
        except (ValueError, OSError) as error:
            reason = str(error) if is_there(path) else "no such file"
            found.missing[mesh.name] = f"{path.name}: {reason}"
            return
    mesh.file, mesh.content_type = "", ""
    mesh.uservert, mesh.userface = vertices.astype(np.float32).ravel(), faces.astype(np.int32).ravel()


def placement(position: Array, quaternion: Array) -> pin.SE3:
    """Of MuJoCo's position (3,) and quaternion (4,), w first."""
    return pin.SE3(pin.Quaternion(*map(float, quaternion)).normalized().matrix(), np.array(position, dtype=float))
