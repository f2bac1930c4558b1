"""Triangles from mesh files, checked before any compiled code sees them: it trusts indices and sizes."""

from __future__ import annotations

import io
import json
import logging
import re
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import one_line
from pinograsp.hands.elements import LARGEST, LEAST, numbers, parse_xml, read_bytes
from pinograsp.spatial import Array, IntArray

if TYPE_CHECKING:
    import coal
    import trimesh

FORMATS = (".stl", ".obj", ".ply", ".glb", ".off", ".dae")
LFS_POINTER = b"version https://git-lfs.github.com/"
MOST_BYTES, MOST_TRIANGLES = 200_000_000, 2_000_000
# Of a scene: trimesh takes time as the square of their number, or of how deep they are nested.
_MOST_PIECES, _DEEPEST_NODE = 3000, 200

_SILENT = logging.NullHandler()


def read_triangles(path: Path, *, corners_alone: bool = False) -> tuple[Array, IntArray]:
    """Vertices (n, 3), in the file's units, and faces (m, 3) of a mesh file; the parts of a scene make one mesh.

    COLLADA files say what their unit is: their vertices are in metres. Their <up_axis> is not applied, as in RViz.
    Other files that it names (materials, pictures, buffers) are not opened.

    Args:
        path: of the file.
        corners_alone: of OBJ files, leave out normals, materials and the like: at each change of one the same vertex
            comes again, so that nobody could tell which triangles are connected.

    Raises:
        ValueError: why it cannot be used.
        OSError: it cannot be read.
    """
    import trimesh  # slow to import

    kind = path.suffix.lower()
    read = load_mesh_file(path, corners_alone=corners_alone, force="mesh")
    if not isinstance(read, trimesh.Trimesh):
        raise ValueError(f"expected a readable {kind[1:].upper()} mesh, got a {type(read).__name__}")
    return check_triangles(read.vertices, read.faces)


def load_mesh_file(path: Path, *, corners_alone: bool = False, **settings: Any) -> trimesh.parent.Geometry:
    """What trimesh makes of a mesh file that has been looked at; in metres where it says its unit, as COLLADA does.

    ``corners_alone`` as for :func:`read_triangles`; ``settings``: of ``trimesh.load``.

    Raises:
        ValueError: why it cannot be used.
        OSError: it cannot be read.
    """
    import trimesh  # slow to import

    logging.getLogger("trimesh").addHandler(_SILENT)  # it would print the traceback of what the error says
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise ValueError(f"expected a mesh file that ends in one of {', '.join(FORMATS)}, got '{path.name}'")
    content = read_bytes(path, MOST_BYTES)
    if content.startswith(LFS_POINTER):
        raise ValueError("expected a mesh, got a pointer of Git LFS to one: run 'git lfs pull' where it was cloned")
    unit = 1.0
    try:
        if kind == ".glb":
            _check_glb(content)
        elif kind == ".dae":
            unit = _check_dae(content)
        elif kind == ".obj" and corners_alone:
            content = _corners_alone(content)
        elif kind == ".obj":
            _check_pieces(len(re.findall(rb"^[ \t]*(?:usemtl|mtllib|o|g)\b", content, re.MULTILINE)), "groups")
        elif kind == ".stl":
            _check_pieces(content.lower().count(b"endsolid"), "solids")
        read: Any = trimesh.load(io.BytesIO(content), file_type=kind[1:], process=False, **settings)
        made: trimesh.parent.Geometry = read if unit == 1.0 else read.apply_scale(unit)
        return made
    except Exception as error:  # the readers raise errors of every type for broken files
        raise ValueError(f"expected a readable {kind[1:].upper()} mesh, got {one_line(error)}") from error


def tells_unit(path: str) -> bool:
    """Whether a file says what its unit is, so that it is read in metres."""
    return path.lower().endswith(".dae")


def check_triangles(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, IntArray]:
    """Vertices (n, 3) and faces (m, 3) that compiled code may be given; ValueError where they are anything else."""
    try:
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected a mesh of triangles, got {one_line(error)}") from error
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces):
        raise ValueError("expected a mesh of triangles, got none")
    if len(faces) > MOST_TRIANGLES:
        raise ValueError(f"expected at most {MOST_TRIANGLES} triangles, got {len(faces)}: simplify the mesh")
    faces = faces.astype(np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"expected faces of vertices 0 to {len(vertices) - 1}, got indices {faces.min()} to {faces.max()}"
        )
    if not np.isfinite(vertices).all():
        raise ValueError(f"expected finite vertices, got {np.sum(~np.isfinite(vertices).all(axis=1))} that are not")
    return vertices, faces


def _corners_alone(content: bytes) -> bytes:
    """The vertices and faces of an OBJ file, without what else their lines name."""
    content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")  # lines that go on
    lines = [line for line in map(bytes.strip, content.splitlines()) if line[:2] in (b"v ", b"f ", b"v\t", b"f\t")]
    return b"\n".join(re.sub(rb"/\S*", b"", line) if line[:1] == b"f" else line for line in lines) + b"\n"


def join_vertices(vertices: Array, faces: IntArray) -> tuple[Array, IntArray]:
    """The same triangles with every place given once, in the order of the first use."""
    _, first, same = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return vertices[first[order]], place[same.ravel()][faces]


def collision_model(vertices: Array, faces: IntArray) -> coal.BVHModelOBBRSS:
    """Checked triangles as a ``coal.BVHModelOBBRSS``.

    Raises:
        ValueError: fewer than three vertices. The Python bindings of coal give a single one back as memory that is not
            its own.
    """
    import coal

    if len(vertices) < 3:
        raise ValueError(
            f"expected triangles, got all their corners at {len(vertices)} point{'s'[: len(vertices) - 1]}"
        )

    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(vertices)
    model.addTriangles(faces.astype(np.int64))
    model.endModel()
    return model


def triangles_of(model: coal.BVHModelOBBRSS) -> tuple[Array, IntArray]:
    """Vertices (n, 3) and faces (m, 3) of a model of :func:`collision_model`."""
    corners = (model.tri_indices(i) for i in range(model.num_tris))
    faces = np.array([(one[0], one[1], one[2]) for one in corners], dtype=np.int64).reshape(-1, 3)
    return np.array(model.vertices()), faces


def pack_shapes(shapes: Iterable[Any]) -> tuple[Any, ...]:
    """Shapes to be pickled: meshes as triangles, for coal writes down their trees as well, a hundred times as much."""
    import coal

    return tuple(triangles_of(one) if isinstance(one, coal.BVHModelOBBRSS) else one for one in shapes)


def unpack_shapes(packed: Iterable[Any]) -> tuple[Any, ...]:
    """The shapes that :func:`pack_shapes` packed."""
    return tuple(collision_model(*one) if isinstance(one, tuple) else one for one in packed)


# -- what small files can blow up to -----------------------------------------------------------------------------------


def _check_pieces(count: int, name: str) -> None:
    if count > _MOST_PIECES:
        raise ValueError(f"{count} {name}, more than the {_MOST_PIECES} that are read: unite them")


def _check_glb(content: bytes) -> None:
    """Refuse a GLB that names far more numbers or copies than it holds."""
    length, kind = struct.unpack_from("<II", content, 12)
    if kind != 0x4E4F534A:
        raise ValueError("its first chunk is not JSON")
    scene = json.loads(content[20 : 20 + length])
    accessors = [one["count"] for one in scene.get("accessors", [])]
    if any(not isinstance(count, int) or not 0 <= count <= 3 * MOST_TRIANGLES for count in accessors):
        raise ValueError(f"an accessor of more than {3 * MOST_TRIANGLES} elements")
    nodes = scene.get("nodes", [])
    children = [child for node in nodes for child in node.get("children", [])]
    if len(set(children)) < len(children):
        raise ValueError("a node with several parents")
    _check_pieces(len(nodes), "nodes")
    _check_depth([node.get("children", []) for node in nodes])
    sizes = [
        sum(accessors[part.get("indices", part["attributes"]["POSITION"])] for part in mesh["primitives"])
        for mesh in scene.get("meshes", [])
    ]
    if sum(sizes[node["mesh"]] for node in nodes if "mesh" in node) > 3 * MOST_TRIANGLES:
        raise ValueError(f"more than {MOST_TRIANGLES} triangles")


def _check_depth(children: list[list[int]]) -> None:
    """Refuse nodes, each with one parent at most, that are nested too deep."""
    inner = {child for those in children for child in those}
    level, depth = [node for node in range(len(children)) if node not in inner], 0
    while level:
        level, depth = [child for node in level for child in children[node]], depth + 1
        if depth > _DEEPEST_NODE:
            raise ValueError(f"nodes nested more than {_DEEPEST_NODE} deep")


def _check_dae(content: bytes) -> float:
    """Refuse a COLLADA file whose nodes repeat its geometry without end; its unit [m]."""
    root = parse_xml(content, MOST_TRIANGLES)
    for element in root.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    geometry = {f"#{one.get('id')}": len(ElementTree.tostring(one)) for one in root.iter("geometry")}
    if sum(1 for _ in root.iter("instance_node")):
        raise ValueError("<instance_node> is not supported: save the mesh without instances")
    instances = list(root.iter("instance_geometry"))
    _check_pieces(len(instances), "instances of geometry")
    if sum(geometry.get(one.get("url", ""), 0) for one in instances) > MOST_BYTES:
        raise ValueError(f"geometry repeated to more than {MOST_BYTES} bytes")
    unit = root.find("asset/unit")
    try:
        (metres,) = [1.0] if unit is None else numbers(unit, "meter", 1, "1", most=LARGEST)
        if metres < LEAST:
            raise ValueError(f"expected a length of {LEAST:g} m or more, got {metres:g}")
    except ValueError as error:
        raise ValueError(f"<unit meter=>: {error}") from None
    return metres
