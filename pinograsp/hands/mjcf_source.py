"""MJCF as MuJoCo's own compiler has it. The files that a model names are found and checked here: MuJoCo opens none.

What has no part in how a hand moves, touches and looks (sensors, key frames, soft bodies, height fields) is left out
before.
"""

from __future__ import annotations

import copy
import math
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.checks import one_line, shown
from pinograsp.errors import HandNotLoaded
from pinograsp.hands.elements import MOST_ELEMENTS, floats, parse_xml, read_bytes
from pinograsp.hands.file_reads import is_there
from pinograsp.hands.mesh_file import read_triangles
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.spatial import Array

_MOST_INCLUDES, _DEEPEST, _MOST_CLASSES = 1000, 20, 2000
_MOST = {"body": 2000, "joint": 2000, "geom": 10_000, "default": _MOST_CLASSES}
_MOST_PARAMETER = 1000.0  # of built-in meshes, whose triangles grow with its square
# They make many elements of one.
_COPIES = {"replicate": "count", "composite": "count"}
_DROPPED = ("size", "option", "visual", "statistic", "sensor", "keyframe", "custom", "deformable", "flexcomp")
_TOLD = ("deformable", "flexcomp")
_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
_SPECK = 1e-6  # [m] radius of what stands for a shape that is left out
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
    document = _Document(name, path.resolve().parent, trusted)
    text = document.read(copy.deepcopy(element), path)
    if document.problems:
        raise HandNotLoaded(name, list(dict.fromkeys(document.problems)))
    try:
        with without_callbacks():
            spec = mujoco.MjSpec.from_string(text, include=document.models)
    except ValueError as error:
        raise _refusal(name, error) from error
    return _compiled(name, spec, document.notes)


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
    return HandNotLoaded(name, f"MuJoCo does not take it: {one_line(error).removeprefix('Error: ')}")


class _Document:
    """An MJCF file made one text, in which files are named by their whole paths.

    Attributes:
        models: texts of models that it attaches, by the names that it has for them then.
        problems, notes: found on the way.
    """

    def __init__(self, name: str, folder: Path, trusted: bool):
        self.name, self.folder, self.trusted = name, folder, trusted
        self.models: dict[str, bytes] = {}
        self.problems: list[str] = []
        self.notes: list[str] = []
        self._size, self._includes = 0, 0

    def read(self, element: ElementTree.Element, path: Path, above: tuple[Path, ...] = ()) -> str:
        """The text of a model, whose files are included, and those it attaches in ``models``."""
        above = (*above, path.resolve())
        self._count(element)
        beside: dict[ElementTree.Element, Path] = {}
        self._include(element, path, above, beside)
        if not above[1:] and element.find("worldbody") is None:
            raise HandNotLoaded(self.name, [*self.problems, "no <worldbody> found: expected a model with bodies"])
        self._drop(element)
        self._check_copies(element)
        for tag, most in _MOST.items():
            if (count := sum(1 for _ in element.iter(tag))) > most:
                raise HandNotLoaded(self.name, f"expected at most {most} elements <{tag}>, got {count}")
        compiler: dict[str, str] = {}
        for one in element.findall("compiler"):
            compiler |= one.attrib
            for key in ("meshdir", "texturedir", "assetdir", "strippath"):
                one.attrib.pop(key, None)
        for asset in element.findall("asset/*"):
            if asset.tag == "model":
                self._attach(asset, path, above)
            else:
                self._name_files(asset, path.resolve().parent, beside.get(asset), compiler)
        return ElementTree.tostring(element, encoding="unicode")

    def _count(self, element: ElementTree.Element) -> None:
        self._size += sum(1 for _ in element.iter())
        if self._size > MOST_ELEMENTS:
            raise HandNotLoaded(self.name, f"expected at most {MOST_ELEMENTS} elements, with those of included files")

    # -- included and attached files -----------------------------------------------------------------------------------

    def _include(
        self, element: ElementTree.Element, path: Path, above: tuple[Path, ...], beside: dict[ElementTree.Element, Path]
    ) -> None:
        """Put what an element includes, on any level, in place; ``beside``: folders of what is included."""
        waiting = [element]
        while waiting:
            parent = waiting.pop()
            for child in list(parent):
                if child.tag != "include":
                    waiting.append(child)
                    continue
                place = list(parent).index(child)
                parent.remove(child)
                opened = self._opened(child, path, above)
                if opened is None:
                    continue
                found, included = opened
                self._count(included)
                self._include(included, found, (*above, found), beside)
                for one in included.iter():
                    beside.setdefault(one, found.parent)
                parent[place:place] = list(included)

    def _attach(self, asset: ElementTree.Element, path: Path, above: tuple[Path, ...]) -> None:
        """Read a model that may be attached, and name it by what MuJoCo is given for it."""
        opened = self._opened(asset, path, above)
        if opened is None:
            return
        found, element = opened
        asset.set("name", asset.get("name") or element.get("model") or found.stem)
        asset.set("file", key := f"{len(self.models)}.xml")
        self.models[key] = b""  # the name is taken while its own are read
        self.models[key] = self.read(element, found, above).encode()

    def _opened(
        self, element: ElementTree.Element, path: Path, above: tuple[Path, ...]
    ) -> tuple[Path, ElementTree.Element] | None:
        """The file that an element names, and its outermost element; None and a problem where it cannot be used."""
        self._includes += 1
        if self._includes > _MOST_INCLUDES or len(above) > _DEEPEST:
            raise HandNotLoaded(
                self.name,
                f"expected at most {_MOST_INCLUDES} included files, {_DEEPEST} deep: it includes more, or itself",
            )
        name = element.get("file", "")
        try:
            found = next((p.resolve() for p in (path.parent / name, self.folder / name) if is_there(p)), None)
            if found is None:
                raise ValueError("no such file")
            if not (self.trusted or found.is_relative_to(self.folder)):
                raise ValueError(
                    "outside the first file's own folder (symbolic links followed): pass trusted=True if you trust "
                    "this file"
                )
            if found in above:
                raise ValueError("includes itself")
            return found, parse_xml(read_bytes(found))
        except (OSError, ValueError) as error:
            self.problems.append(f"<{element.tag} file={shown(name)}>: {error}")
            return None

    def _name_files(
        self, asset: ElementTree.Element, folder: Path, beside: Path | None, compiler: dict[str, str]
    ) -> None:
        """Give the files of an asset their whole paths, as MuJoCo finds them: by the compiler's folder for its kind,
        or else from the file's folder on, or that of the included file that names it.
        """
        inside = compiler.get("texturedir" if asset.tag == "texture" else "meshdir", compiler.get("assetdir", ""))
        for key in _FILES:
            if not (file := asset.get(key, "").replace("\\", "/")):
                asset.attrib.pop(key, None)
                continue
            if compiler.get("strippath", "false") == "true":
                file = file.split("/")[-1]
            path = folder / inside / file
            if beside is not None and not inside and not is_there(path):
                path = beside / file
            if asset.tag == "mesh" and not asset.get("name"):
                asset.set("name", Path(file).stem)
            asset.set(key, str(path))

    # -- what is not needed, and what a small file can blow up to ------------------------------------------------------

    def _drop(self, element: ElementTree.Element) -> None:
        for parent in list(element.iter()):
            for child in list(parent):
                if child.tag in _DROPPED and (parent is element or child.tag == "flexcomp"):
                    parent.remove(child)
                    if child.tag in _TOLD:
                        self.notes.append(f"soft bodies are left out: <{child.tag}>")
        for mesh in element.iter("mesh"):
            for key in ("params", "subdivision", "resolution"):
                if (text := mesh.get(key)) and max(map(abs, _floats(text)), default=math.inf) > _MOST_PARAMETER:
                    self.problems.append(f"<mesh {key}={shown(text)}>: expected numbers up to {_MOST_PARAMETER:g}")

    def _check_copies(self, element: ElementTree.Element) -> None:
        """Refuse repetitions that would make more elements than are read."""
        for times, one in _copied(element):
            self._size += times * sum(1 for _ in one.iter())
            if self._size > MOST_ELEMENTS:
                raise HandNotLoaded(
                    self.name, f"expected at most {MOST_ELEMENTS} elements, with those that <{one.tag}> makes"
                )


def _copied(element: ElementTree.Element) -> Iterator[tuple[int, ElementTree.Element]]:
    """Yield what is repeated and how often, those inside of others as often as these."""
    waiting = [(element, 1)]
    while waiting:
        parent, times = waiting.pop()
        for child in parent:
            if key := _COPIES.get(child.tag):
                count = math.prod(max(value, 1.0) for value in _floats(child.get(key, "1"))[:3])
                copies = int(min(times * count, 1e9))
                yield copies, child
                waiting.append((child, copies))
            else:
                waiting.append((child, times))


def _floats(text: str) -> list[float]:
    """Numbers of a text, none where it has others: MuJoCo tells."""
    try:
        return floats(text)
    except ValueError:
        return []


# -- compiled ----------------------------------------------------------------------------------------------------------


def _compiled(name: str, spec: mujoco.MjSpec, notes: list[str]) -> Compiled:
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
