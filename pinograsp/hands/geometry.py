"""Collision geometry of a hand: exact primitives, ellipsoids among them, and meshes; masses and inertias of shapes."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from pinograsp.checks import brief
from pinograsp.hands.file_reads import digest_of
from pinograsp.hands.mesh_file import (
    FORMATS,
    MOST_BYTES,
    MOST_TRIANGLES,
    collision_model,
    join_vertices,
    read_triangles,
    tells_unit,
    triangles_of,
)
from pinograsp.spatial import FARTHEST, Array, IntArray

# [kg/m^3] of links without mass: most of a hand is lighter than its hull would be, so this is on the heavy side.
DENSITY = 1000.0
UNSEEN = "so these links cannot touch anything"  # in notes
_RING = 12  # points round a circle
# A link whose mesh is drawn in metres is not so many times as large as its joints are apart or slide. Joints may sit in
# one place, with all distances in the meshes: then as large as this [m], half a finger.
_TOO_LARGE, _MILLI, _APART = 100.0, 1e-3, 0.05
_SLIDE = "JointModelP"  # how Pinocchio's names of joints that slide begin
_FLAT = 1e-6  # volume over the longest extent's cube, of a mesh that is flat up to rounding

Kind: TypeAlias = Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"]
# Vertices (n, 3) [m] and faces (m, 3) of a mesh that comes from no file.
Triangles: TypeAlias = tuple[Array, IntArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A shape of a link, which can touch something or is only seen.

    Attributes:
        link: the link it is fixed to.
        placement: in the link's frame.
        kind: which shape.
        size: edges of a box; radius of a sphere; radius and length (of the cylindrical part) of a cylinder or capsule;
            semi-axes of an ellipsoid [m]; scale of a mesh.
        path: file of a mesh, or a name for one that comes from none.
        colour: ``#rrggbb`` of a shape that is seen; empty: its file's own, or none.
        texture: file of a picture on a shape that is seen, in which ``colour`` is a factor.
        triangles: of a mesh that comes from no file.
    """

    link: str
    placement: pin.SE3
    kind: Kind
    size: tuple[float, ...]
    path: str = ""
    colour: str = ""
    texture: str = ""
    triangles: Triangles | None = field(default=None, compare=False)

    __repr__ = brief()


# Numbers that give the size of a shape.
SIZES: dict[Kind, int] = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 3}
PRIMITIVES: dict[str, type[coal.ShapeBase]] = {
    "box": coal.Box,
    "sphere": coal.Sphere,
    "cylinder": coal.Cylinder,
    "capsule": coal.Capsule,
    "ellipsoid": coal.Ellipsoid,
}


def collision_geometry(model: pin.Model, shapes: list[Shape], notes: list[str]) -> tuple[pin.GeometryModel, float]:
    """Collision geometry at the links' frames, and the unit [m] of meshes whose files do not say theirs.

    Meshes that cannot be read are left out and noted.
    """
    geometry = pin.GeometryModel()
    broken: list[str] = []
    frames = {frame.name: (i, frame) for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY}
    counts: dict[str, int] = {}
    meshes = _Meshes()
    for shape in shapes:
        try:
            form = meshes.read(shape) if shape.kind == "mesh" else PRIMITIVES[shape.kind](*shape.size)
        except (ValueError, OSError) as error:
            broken.append(f"{shape.link} ({shape.path}: {error})")
            continue
        frame, link = frames[shape.link]
        i = counts[shape.link] = counts.get(shape.link, -1) + 1
        one = pin.GeometryObject(f"{shape.link}_{i}", link.parentJoint, frame, link.placement * shape.placement, form)
        if shape.kind == "mesh" and shape.triangles is None:
            one.meshPath, one.meshScale = shape.path, np.array(shape.size)
        geometry.addGeometryObject(one)
    unit = _in_metres(model, geometry, notes)
    if broken:
        notes.append(f"meshes that cannot be read, {UNSEEN}: {', '.join(broken)}")
    return geometry, unit


def form_of(shape: Shape) -> coal.CollisionGeometry:
    """A shape for coal; ValueError, OSError: why its mesh cannot be used."""
    if shape.triangles is not None:
        return collision_model(*join_vertices(*shape.triangles))
    return read_mesh(shape.path, shape.size) if shape.kind == "mesh" else PRIMITIVES[shape.kind](*shape.size)


class _Meshes:
    """Meshes of one hand: what cannot be read is tried once, and all together have a bounded number of triangles."""

    def __init__(self) -> None:
        self.errors: dict[str, str] = {}
        self.sizes: dict[tuple[str, tuple[float, ...]], int] = {}

    def read(self, shape: Shape) -> coal.BVHModelOBBRSS:
        """As :func:`read_mesh`."""
        if shape.triangles is not None:
            return form_of(shape)
        if shape.path in self.errors:
            raise ValueError(self.errors[shape.path])
        key = (shape.path, shape.size)
        if key not in self.sizes and sum(self.sizes.values()) > MOST_TRIANGLES:
            raise ValueError(f"the meshes before it have more than {MOST_TRIANGLES} triangles: simplify them")
        try:
            _triangles(shape.path, _content_of(shape.path))
        except (ValueError, OSError) as error:
            self.errors[shape.path] = str(error)
            raise
        mesh = read_mesh(shape.path, shape.size)
        self.sizes[key] = mesh.num_tris
        return mesh


def without_shapes(
    geometry: pin.GeometryModel, model: pin.Model, links: list[str], notes: list[str]
) -> pin.GeometryModel:
    """The same geometry without the shapes of some links; noted."""
    if not links:
        return geometry
    kept = pin.GeometryModel()
    for one in geometry.geometryObjects:
        if model.frames[one.parentFrame].name not in links:
            kept.addGeometryObject(one)
    notes.append(f"shapes that take no part in touching (exclude=): {', '.join(dict.fromkeys(links))}")
    return kept


def _in_metres(model: pin.Model, geometry: pin.GeometryModel, notes: list[str]) -> float:
    """Scale meshes in millimetres down, where all that the hand's joints carry is far too large for their distances.

    Returns their unit [m].
    """
    lengths = [float(np.linalg.norm(pose.translation)) for pose in list(model.jointPlacements)[2:]]
    slides = [model.joints[j].idx_q for j in range(1, model.njoints) if model.joints[j].shortname().startswith(_SLIDE)]
    lengths += (model.upperPositionLimit - model.lowerPositionLimit)[slides].tolist()
    drawn = [one for one in geometry.geometryObjects if one.meshPath and not tells_unit(one.meshPath)]
    meshes = [one for one in drawn if one.parentJoint]
    for one in meshes:
        one.geometry.computeLocalAABB()
    if not meshes:
        return 1.0
    times = float(np.median([one.geometry.aabb_radius for one in meshes])) / max([*lengths, _APART])
    if times < _TOO_LARGE:
        return 1.0
    for one in drawn:
        one.meshScale = _MILLI * one.meshScale
        one.geometry = read_mesh(one.meshPath, tuple(one.meshScale.tolist()))
    notes.append(
        f"collision meshes are {times:.2g} times as large as its joints are apart or slide: taken as drawn "
        "in millimetres"
    )
    return _MILLI


def _content_of(path: str) -> str:
    """What a mesh file's content is known by; what cannot be a mesh is not opened, and refused as it is read."""
    mesh = Path(path).suffix.lower() in FORMATS and os.stat(path).st_size <= MOST_BYTES
    return digest_of(path) if mesh else ""


@functools.lru_cache(maxsize=2)
def _triangles(path: str, content: str) -> tuple[Array, IntArray]:
    """Those of a file, with every place given once; kept, since many shapes may be the same file in other sizes."""
    return join_vertices(*read_triangles(Path(path)))


@functools.lru_cache(maxsize=64)
def _read(path: str, scale: tuple[float, ...], content: str) -> coal.BVHModelOBBRSS:
    vertices, faces = _triangles(path, content)
    with np.errstate(over="ignore"):
        vertices = vertices * scale
    if not np.abs(vertices).max() <= FARTHEST:
        raise ValueError(f"a vertex is more than {FARTHEST:g} m from its origin: are the units right? (scale=)")
    return collision_model(vertices, faces)


def read_mesh(path: str, scale: tuple[float, ...] = (1.0, 1.0, 1.0)) -> coal.BVHModelOBBRSS:
    """A mesh as coal's bounding-volume tree, kept until its file's content changes.

    Raises:
        ValueError, OSError: why the file cannot be used.
    """
    return _read(path, scale, _content_of(path))


def solid(shape: coal.CollisionGeometry, density: float) -> pin.Inertia | None:
    """Mass and inertia of a shape filled evenly [kg/m^3], of the hull of an open mesh; None without volume."""
    open_mesh = isinstance(shape, coal.BVHModelBase) and not _close(shape)
    for body in (None if open_mesh else shape, hull_of(shape)):
        if body is None:
            continue
        volume = body.computeVolume()
        if not (np.isfinite(volume) and abs(volume) > 0):
            continue
        # A mesh turned inside out has negative volume, and negative inertia with it.
        inertia = np.sign(volume) * density * np.array(body.computeMomentofInertiaRelatedToCOM())
        inertia = 0.5 * (inertia + inertia.T)
        moments = np.linalg.eigvalsh(inertia) if np.all(np.isfinite(inertia)) else np.array([-1.0])
        if moments[0] > 0 and moments[0] + moments[1] > moments[2] * (1 - 1e-9):
            return pin.Inertia(density * abs(volume), np.array(body.computeCOM()).ravel(), inertia)
    return None


def _close(mesh: coal.BVHModelBase) -> bool:
    """Whether every edge of a mesh borders two triangles, once in each direction."""
    vertices, triangles = triangles_of(mesh)
    _, same = np.unique(vertices, axis=0, return_inverse=True)  # files repeat a vertex for every triangle
    triangles = same.ravel()[triangles]
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there, back = (np.sort(pair @ [len(same), 1]) for pair in (edges, edges[:, ::-1]))
    return bool(np.array_equal(there, back) and np.all(np.diff(there)))


def solid_of(shape: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """The convex hull of a mesh, which has an inside; other shapes, and meshes without volume, as they are."""
    return hull_of(shape) or shape


def hull_of(shape: coal.CollisionGeometry) -> coal.ConvexBase | None:
    """Convex hull of a mesh; None for other shapes, and for meshes without volume."""
    if not isinstance(shape, coal.BVHModelBase):
        return None
    if shape.convex is None:
        points = shape.vertices()
        try:  # coal's own crashes on flat meshes
            volume = ConvexHull(points, qhull_options="Qt").volume
        except (QhullError, ValueError):
            return None
        if volume < _FLAT * np.ptp(points, axis=0).max() ** 3:
            return None
        try:
            shape.buildConvexHull(True, "Qt")
        except RuntimeError:  # a corner with too many neighbours, as of a disc with many corners: coal counts to 255
            shape.buildConvexHull(True, "QJ")
    return shape.convex


def hull_points(geometry: coal.CollisionGeometry) -> Array:
    """Points (p, 3) of a geometry's surface: the corners of a mesh's hull or of a box, others about as dense."""
    hull = geometry if isinstance(geometry, coal.ConvexBase) else hull_of(geometry)
    if hull is not None:
        return np.array([hull.point(i) for i in range(hull.num_points)])
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    middle, half = (low + high) / 2, (high - low) / 2
    if isinstance(geometry, coal.Box):
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        ends: Array = middle + corners * half
        return ends
    # Round shapes fill their box as an ellipsoid does, near enough to tell where a fingertip is.
    turn = np.linspace(0, 2 * np.pi, _RING, endpoint=False)
    height = np.linspace(-1, 1, 7)
    ring = np.sqrt(1 - height**2)
    sphere = np.stack(
        [np.outer(ring, np.cos(turn)), np.outer(ring, np.sin(turn)), np.outer(height, np.ones(_RING))], axis=-1
    )
    around: Array = middle + sphere.reshape(-1, 3) * half
    return around


def hulls(geometry: pin.GeometryModel) -> pin.GeometryModel:
    """The same geometry with every mesh replaced by its convex hull; flat ones stay."""
    replaced = pin.GeometryModel()
    for one in geometry.geometryObjects:
        hull = pin.GeometryObject(one.name, one.parentJoint, one.parentFrame, one.placement, solid_of(one.geometry))
        hull.meshPath, hull.meshScale = one.meshPath, one.meshScale
        replaced.addGeometryObject(hull)
    return replaced


def fill_masses(model: pin.Model, geometry: pin.GeometryModel, unweighed: list[str], notes: list[str]) -> None:
    """Give links without inertia the mass of their collision geometry; noted, and so are those that have none.

    These are those moved by the joints ``unweighed``, and those that have no mass, nor any link beyond them.
    """
    wanted = {model.getJointId(joint) for joint in unweighed}
    for j in range(1, model.njoints):
        if _sum_moved_mass(model, j) <= 0:
            wanted.update(model.subtrees[j])
    filled = []
    for j in sorted(wanted):
        for one in geometry.geometryObjects:
            if one.parentJoint == j and (own := solid(one.geometry, DENSITY)) is not None:
                model.inertias[j] = model.inertias[j] + one.placement.act(own)
        if model.inertias[j].mass > 0:
            filled.append(f"{model.names[j]} {1e3 * model.inertias[j].mass:.1f} g")
    if filled:
        notes.append(f"no masses given, taken from the geometry at {DENSITY:g} kg/m^3: {', '.join(filled)}")
    if massless := [name for name in unweighed if model.inertias[model.getJointId(name)].mass <= 0]:
        notes.append(f"neither masses nor shapes to take them from, so massless: {', '.join(massless)}")


def _sum_moved_mass(model: pin.Model, joint: int) -> float:
    """The mass that a joint moves [kg]."""
    return float(sum(model.inertias[i].mass for i in model.subtrees[joint]))


def moving_nothing(model: pin.Model) -> list[str]:
    """The actuated joints that move no mass at all."""
    data = model.createData()
    inertia = pin.crba(model, data, (model.lowerPositionLimit + model.upperPositionLimit) / 2).diagonal()
    together: dict[int, float] = {}  # what a motor moves, by its position in q
    for j in range(1, model.njoints):
        i = model.joints[j].idx_v
        together[i] = together.get(i, 0.0) + _sum_moved_mass(model, j)
    return [
        model.names[j]
        for j in range(1, model.njoints)
        if model.joints[j].nv and min(together[i := model.joints[j].idx_v], inertia[i]) <= 0
    ]
