"""Meshes of what is seen of a hand: their colours, with few enough triangles for a picture; and their record."""

from __future__ import annotations

import base64
import functools
import io
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinograsp.checks import array_of, one_of, placement_of, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.elements import read_bytes
from pinograsp.hands.geometry import PRIMITIVES, SIZES, Kind, Shape, Triangles
from pinograsp.hands.mesh_file import check_triangles, join_vertices, load_mesh_file
from pinograsp.hands.shapes import hex_of
from pinograsp.spatial import FARTHEST, Array, IntArray

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image
    from trimesh.resolvers import Resolver

# A colour, "#rrggbb" or empty where the file has none, and the vertices (n, 3) and faces (m, 3) that have it.
Part: TypeAlias = tuple[str, Array, IntArray]
# (rows, columns, 3).
Pixels: TypeAlias = NDArray[np.uint8]
# File of a mesh, that of a texture on it, and the colour that is a factor on the latter.
MeshKey: TypeAlias = tuple[str, str, str]

_MOST_COLOURS = 8  # of a mesh: parts, or what is left of a texture
_MOST_TRIANGLES = 5_000_000  # of a hand's files
_MOST_BYTES, _MOST_PIXELS = 50_000_000, 40_000_000  # of a file of materials or a texture
_FINEST, _COARSER = 400, 1.3  # cells along a mesh's longest side, and how many times fewer the next time
_TEXTURES, _PICTURES = ("textures", "materials"), (".png", ".jpg", ".jpeg", ".tga", ".bmp", ".tif", ".tiff", ".webp")
_UNPAINTED = np.array([-1.0, -1.0, -1.0])


def mesh_of(shape: Shape) -> MeshKey:
    """Under which a shape's mesh is found in what :func:`meshes_of` returns."""
    return shape.path, shape.texture, shape.colour if shape.texture else ""


def meshes_of(shapes: Iterable[Shape], most: int) -> tuple[dict[MeshKey, tuple[Part, ...]], list[str]]:
    """The meshes of shapes, in their files' units and with their textures, and why others cannot be read.

    All shapes together have about ``most`` triangles: meshes with more than their share are simplified.
    """
    shapes = [shape for shape in shapes if shape.kind == "mesh"]
    inline = {mesh_of(shape): shape.triangles for shape in shapes if shape.triangles is not None}
    keys = [key for shape in shapes if (key := mesh_of(shape)) not in inline]
    files: dict[MeshKey, tuple[int, ...]] = {}
    problems: dict[str, None] = {}
    for key in dict.fromkeys(keys):
        if os.path.isfile(key[0]):
            files[key] = tuple(os.stat(one).st_mtime_ns for one in key[:2] if os.path.isfile(one))
        else:
            problems[f"mesh '{key[0]}' is not there"] = None
    counts = tuple(keys.count(key) for key in files)
    meshes, broken = _meshes(tuple(files.items()), counts, most)
    share_of_one = max(most // max(len(inline), 1), 1)
    painted = {
        key: _parts(*join_vertices(*triangles), np.tile(_UNPAINTED, (len(triangles[1]), 1)), share_of_one)
        for key, triangles in inline.items()
    }
    return meshes | painted, [*problems, *broken]


@functools.lru_cache(maxsize=4)
def _meshes(
    files: tuple[tuple[MeshKey, tuple[int, ...]], ...], counts: tuple[int, ...], most: int
) -> tuple[dict[MeshKey, tuple[Part, ...]], list[str]]:
    """Meshes of files, which are kept until these change; ``counts``: how often each is shown."""
    painted: dict[MeshKey, tuple[Array, IntArray, Array]] = {}
    problems, total = [], 0
    for key, _ in files:
        if total > _MOST_TRIANGLES:
            problems.append(f"mesh '{key[0]}' is left out: those before it have {total} triangles")
            continue
        try:
            painted[key] = _paint(*key)
            total += len(painted[key][1])
        except (ValueError, OSError) as error:
            problems.append(f"mesh '{key[0]}' cannot be read: {error}")
    shown = [count for (key, _), count in zip(files, counts) if key in painted]
    largest = share([len(faces) for _, faces, _ in painted.values()], shown, most)
    return {key: _parts(*mesh, largest) for key, mesh in painted.items()}, list(dict.fromkeys(problems))


def mean_colour(shape: Shape) -> str:
    """The colour of a shape that is no mesh: the mean of its texture times its colour; empty without both."""
    pixels = _pixels(shape.texture) if shape.texture else None
    if pixels is None:
        return shape.colour
    return hex_of(pixels.reshape(-1, 3).mean(axis=0) / 255 * _factor(shape.colour))


def share(sizes: Sequence[int], counts: Sequence[int], most: int) -> int:
    """The largest number of triangles for any mesh with which all together have at most ``most``."""
    left, shown = most, sum(counts)
    for size, count in sorted(zip(sizes, counts)):
        if size * shown > left:
            return max(left // shown, 1)
        left, shown = left - size * count, shown - count
    return max(sizes, default=1)


def _paint(file: str, texture: str, colour: str) -> tuple[Array, IntArray, Array]:
    """Vertices (n, 3), faces (m, 3) and the faces' colours (m, 3), 0 to 255 or :data:`_UNPAINTED`, of a mesh file.

    Materials and textures of the file's own are read from its folder and those below it, pictures also from folders
    called textures or materials beside that; with a ``texture``, the picture takes their place, times ``colour``.
    """
    import trimesh

    path = Path(file)
    pixels = _pixels(texture) if texture else None
    scene = load_mesh_file(path, force="scene", resolver=_resolver(path.parent))
    if not isinstance(scene, trimesh.Scene):
        raise ValueError(f"expected a mesh, got a {type(scene).__name__}")
    vertices, faces, colours, count = [], [], list[Array](), 0
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue
        points, own = check_triangles(mesh.vertices, mesh.faces)
        turned = np.linalg.det(matrix[:3, :3]) < 0
        vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append((own[:, ::-1] if turned else own) + count)
        colours.append(_colours_of(mesh) if pixels is None else _factor(colour) * _on(mesh, pixels))
        count += len(points)
    if not count:
        raise ValueError("expected a mesh of triangles, got none")
    everything = check_triangles(np.concatenate(vertices), np.concatenate(faces))
    return *join_vertices(*everything), np.concatenate(colours)


def _colours_of(mesh: trimesh.Trimesh) -> Array:
    """Colours (m, 3) of a mesh's faces, 0 to 255; :data:`_UNPAINTED` where it has none."""
    m = len(mesh.faces)
    try:
        visual: Any = mesh.visual  # of a class for each kind
        if visual.kind == "face":
            colours = np.asarray(visual.face_colors, dtype=float)[:, :3]
        elif visual.kind == "vertex":
            colours = np.asarray(visual.vertex_colors, dtype=float)[mesh.faces, :3].mean(axis=1)
        elif visual.kind == "texture":
            colours = _texture(visual, mesh.faces)
        else:
            colours = np.tile(_UNPAINTED, (m, 1))
    except Exception:  # of broken pictures and materials; the mesh is still worth showing
        colours = np.tile(_UNPAINTED, (m, 1))
    return colours if colours.shape == (m, 3) and np.isfinite(colours).all() else np.tile(_UNPAINTED, (m, 1))


def _texture(visual: Any, faces: IntArray) -> Array:
    """Colours (m, 3) of faces: the texture's at their middle, or the material's; :data:`_UNPAINTED` without both."""
    material = visual.material
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is None or visual.uv is None:
        given = getattr(material, "name", None) or getattr(material, "baseColorFactor", None) is not None
        return np.tile(np.asarray(material.main_color, dtype=float)[:3] if given else _UNPAINTED, (len(faces), 1))
    return _at(np.asarray(visual.uv, dtype=float)[faces], _values(image))


def _on(mesh: trimesh.Trimesh, pixels: Pixels) -> Array:
    """Colours (m, 3) of a mesh's faces in a picture; its mean where the mesh does not tell which part of it."""
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(mesh.vertices), 2) or not np.isfinite(uv).all():
        return np.tile(pixels.reshape(-1, 3).mean(axis=0), (len(mesh.faces), 1))
    return _at(np.asarray(uv, dtype=float)[mesh.faces], pixels)


def _at(corners: Array, pixels: Pixels) -> Array:
    """Colours (m, 3) in a picture (rows, columns, 3) at the middles of triangles with texture coordinates (m, 3, 2)."""
    across, up = (corners.mean(axis=1) % 1.0).T
    rows = ((1 - up) * len(pixels)).astype(int) % len(pixels)
    found: Array = pixels[rows, (across * pixels.shape[1]).astype(int) % pixels.shape[1]].astype(float)
    return found


def _values(image: Image) -> Pixels:
    """The values (rows, columns, 3) of a picture, 0 to 255; ValueError for one that is too large."""
    if image.size[0] * image.size[1] > _MOST_PIXELS:
        raise ValueError(f"a texture of more than {_MOST_PIXELS} pixels")
    return np.asarray(image.convert("RGB"))


def _pixels(texture: str) -> Pixels | None:
    """The values (rows, columns, 3) of a picture file, 0 to 255; None for what cannot be read."""
    from PIL.Image import open as read

    try:
        with read(io.BytesIO(read_bytes(Path(texture), _MOST_BYTES))) as image:
            return _values(image)
    except Exception:  # of broken pictures, of every type; the shape is still worth showing
        return None


def _factor(colour: str) -> Array:
    """A colour as factors (3,) on another; 1 without one."""
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]) if colour else np.ones(3)


def _resolver(folder: Path) -> Resolver:
    """Reads the files that a mesh names, from its own folder and those below it; pictures also from those beside it
    that are called textures or materials, as ROS packages have them.
    """
    from trimesh.resolvers import Resolver

    home = folder.resolve()

    class Beside(Resolver):
        def __init__(self) -> None:
            pass

        def get(self, key: str) -> bytes:
            path = (home / key.strip()).resolve()
            pictures = [above / name for above in list(home.parents)[:2] for name in _TEXTURES]
            beside = path.suffix.lower() in _PICTURES and any(path.is_relative_to(one) for one in pictures)
            if not (path.is_relative_to(home) or beside):
                raise OSError(f"{key} is outside of the mesh's folder")
            return read_bytes(path, _MOST_BYTES)

        def namespaced(self, namespace: str) -> Resolver:
            return _resolver(home)

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: object) -> None:
            raise OSError("nothing is written beside a mesh")

    return Beside()


def _parts(vertices: Array, faces: IntArray, colours: Array, most: int) -> tuple[Part, ...]:
    """The mesh in parts of one colour, with about ``most`` triangles in all."""
    if len(faces) > most:
        from scipy.spatial import cKDTree

        middles = vertices[faces].mean(axis=1)
        vertices, faces = simplify(vertices, faces, most)
        colours = colours[cKDTree(middles).query(vertices[faces].mean(axis=1))[1]]
    distinct, which = np.unique(colours, axis=0, return_inverse=True)
    which = which.ravel()
    if len(distinct) > _MOST_COLOURS:
        from scipy.cluster.vq import kmeans2

        distinct, which = kmeans2(colours, _MOST_COLOURS, minit="++", seed=0)
    parts = []
    for i, colour in enumerate(distinct):
        if len(own := faces[which == i]):
            used, place = np.unique(own, return_inverse=True)
            name = "" if colour.min() < 0 else hex_of(colour / 255)
            parts.append((name, vertices[used], place.reshape(-1, 3)))
    return tuple(parts)


def simplify(vertices: Array, faces: IntArray, most: int) -> tuple[Array, IntArray]:
    """A surface of about ``most`` triangles near the given one."""
    if len(faces) <= most:
        return vertices, faces
    try:
        import fast_simplification
    except ImportError:  # coarser, where the extra viz is not installed
        return _cluster(vertices, faces, most)
    size = float(np.ptp(vertices, axis=0).max()) or 1.0  # it works with single precision
    points, triangles = fast_simplification.simplify(
        (vertices / size).astype(np.float32), faces.astype(np.int32), target_count=most
    )
    inside = np.clip(size * np.asarray(points, dtype=float), vertices.min(axis=0), vertices.max(axis=0))  # no spikes
    return _cluster(inside, np.asarray(triangles, dtype=np.int64), most)


def _cluster(vertices: Array, faces: IntArray, most: int) -> tuple[Array, IntArray]:
    """The surface with vertices of the same cell merged, in cells as small as ``most`` triangles allow.

    For triangles that hang together at few of their edges, of which a simplification by edges keeps too many.
    """
    cells = _FINEST
    while len(faces) > most and cells > 1:
        low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max()) or 1.0
        _, first, cell = np.unique(
            np.round((vertices - low) / size * cells).astype(int), axis=0, return_index=True, return_inverse=True
        )
        vertices, faces = vertices[first], cell.ravel()[faces]
        flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
        faces = faces[~flat]
        faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
        cells = int(cells / _COARSER)
    return vertices, faces


# -- the record --------------------------------------------------------------------------------------------------------


def visuals_record(visuals: Iterable[Shape]) -> list[dict[str, Any]]:
    """What is seen, as plain JSON values; meshes by absolute path and scale."""
    return [
        {
            "link": one.link,
            "placement": one.placement.homogeneous.tolist(),
            "kind": one.kind,
            "size": list(map(float, one.size)),
            "path": one.path if one.triangles or not one.path else os.path.abspath(one.path),
            "colour": one.colour,
            "texture": os.path.abspath(one.texture) if one.texture else "",
            **({} if one.triangles is None else {"triangles": write_triangles(*one.triangles)}),
        }
        for one in visuals
    ]


def visuals_from(records: Sequence[Any], links: Sequence[str]) -> tuple[Shape, ...]:
    """The shapes that :func:`visuals_record` wrote down; :class:`InvalidInput` for anything else."""
    shapes = []
    for i, one in enumerate(records):
        where = f"hand record: visuals[{i}]: "
        if not isinstance(one, dict):
            raise InvalidInput(f"{where}expected a mapping, got {one!r:.60}")
        kind: Kind = one_of(f"{where}kind", one.get("kind"), SIZES)
        size = array_of(f"{where}size", one.get("size"), (SIZES[kind],))
        placement = placement_of(f"{where}placement", one.get("placement"))
        path = text_of(f"{where}path", one.get("path"))
        colour = text_of(f"{where}colour", one.get("colour"))
        texture = text_of(f"{where}texture", one.get("texture", ""))
        good = re.fullmatch("(#[0-9A-F]{6})?", colour)
        if not good or max(np.abs(size).max(), np.abs(placement[:3, 3]).max()) > FARTHEST or not size.all():
            raise InvalidInput(f"{where}expected a path, a colour and lengths up to {FARTHEST:g} m, got {one!r:.60}")
        if kind in PRIMITIVES and size.min() <= 0:
            raise InvalidInput(f"{where}size: expected numbers above zero [m], got {size.tolist()}")
        link = one_of(f"{where}link", one.get("link"), links)
        shapes.append(
            Shape(
                link=link,
                placement=pin.SE3(placement),
                kind=kind,
                size=tuple(size.tolist()),
                path=path,
                colour=colour,
                texture=texture,
                triangles=parse_triangles(f"{where}triangles", one["triangles"]) if "triangles" in one else None,
            )
        )
    return tuple(shapes)


def write_triangles(vertices: Array, faces: IntArray) -> dict[str, str]:
    """Vertices (n, 3), in single precision, and faces (m, 3) as texts."""
    parts = {"vertices": vertices.astype("<f4"), "faces": faces.astype("<i4")}
    return {key: base64.b64encode(values.tobytes()).decode() for key, values in parts.items()}


def parse_triangles(where: str, record: object) -> Triangles:
    """What :func:`write_triangles` wrote down; :class:`InvalidInput` for anything else."""
    if not isinstance(record, dict):
        raise InvalidInput(f"{where}: expected a mapping, got {record!r:.60}")
    try:
        vertices, faces = (
            np.frombuffer(base64.b64decode(text_of(f"{where}: {key}", record.get(key)), validate=True), dtype=kind)
            for key, kind in (("vertices", "<f4"), ("faces", "<i4"))
        )
        triangles = check_triangles(vertices.reshape(-1, 3), faces.reshape(-1, 3))
    except ValueError as error:
        raise InvalidInput(f"{where}: expected vertices and faces of a mesh: {error}") from None
    if np.abs(triangles[0]).max() > FARTHEST:
        raise InvalidInput(f"{where}: expected lengths up to {FARTHEST:g} m")
    return triangles
