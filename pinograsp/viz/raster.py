"""Shaded triangles as pixels, without a graphics card: a depth buffer and a light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pinograsp.spatial import Array, BoolArray, IntArray

_CHUNK = 200_000  # pixels of triangles at a time: they fit a processor's cache
_EDGE = 1e-9  # share of a triangle by which pixels on its edges may be outside
_GAMMA = 2.2


class Surface(NamedTuple):
    """Triangles of one colour in the world: vertices (n, 3) [m], faces (m, 3), colour (3,) from 0 to 1."""

    vertices: Array
    faces: IntArray
    colour: Array


class Camera(NamedTuple):
    """A pinhole camera.

    Attributes:
        eye: where it is (3,) [m].
        axes: to the right, upwards, and backwards, in rows (3, 3).
        focal: length, in pixels.
        width, height: of the picture, in pixels.
    """

    eye: Array
    axes: Array
    focal: float
    width: int
    height: int

    def project(self, points: Array) -> Array:
        """Pixels across and down, and the inverse of the depth [1/m], of points (n, 3); behind the camera 0."""
        seen = (points - self.eye) @ self.axes.T
        near = np.divide(1.0, -seen[:, 2], out=np.zeros(len(seen)), where=seen[:, 2] < 0)
        across = self.width / 2 + self.focal * seen[:, 0] * near
        down = self.height / 2 - self.focal * seen[:, 1] * near
        return np.stack([across, down, near], axis=1)


class Layer(NamedTuple):
    """What a camera sees of some surfaces.

    Attributes:
        near: inverse of the depth (h, w) [1/m]; 0: nothing.
        colour: shaded (h, w, 3), from 0 to 1.
        surface: index of the surface (h, w); -1: nothing.
        facing: how far the surface faces the camera (h, w), from 0 to 1.
    """

    near: Array
    colour: Array
    surface: IntArray
    facing: Array

    @property
    def drawn(self) -> BoolArray:
        """Which pixels show a surface (h, w)."""
        drawn: BoolArray = self.near > 0
        return drawn


def fit_camera(cloud: Array, axes: Array, slope: float, room: tuple[float, float], size: tuple[int, int]) -> Camera:
    """A camera with these axes (3, 3) that sees all of a cloud (n, 3) [m].

    Args:
        cloud: what is to be seen.
        axes: to the right, upwards, and backwards, in rows.
        slope: of half the field of view, upwards.
        room: how much more than the cloud is seen across and up, over it.
        size: pixels across and down.
    """
    seen = cloud @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    width, height = size
    distance = max(room[1] * half[1], room[0] * half[0] * height / width) / slope + half[2]
    return Camera(centre @ axes + distance * axes[2], axes, height / 2 / slope, width, height)


def overlay(image: Array, hand: Layer, thing: Layer, forces: Layer, clear: float, hidden: float) -> None:
    """Draw a translucent object and forces into a picture (h, w, 3) of the hand.

    ``clear``: opacity of the object where it faces the camera; ``hidden``: of forces behind the hand.
    """
    before = thing.near > hand.near
    opacity = (clear + (1 - clear) * 0.6 * (1 - thing.facing[before]) ** 2)[:, None]
    image[before] = (1 - opacity) * image[before] + opacity * thing.colour[before]
    drawn = forces.drawn
    opacity = np.where(forces.near[drawn] >= hand.near[drawn], 1.0, hidden)[:, None]
    image[drawn] = (1 - opacity) * image[drawn] + opacity * forces.colour[drawn]


def average_blocks(image: Array, finer: int) -> Array:
    """Blocks of ``finer`` pixels along either side as one, of a picture (h, w, 3)."""
    parts = [image[i::finer, j::finer] for i in range(finer) for j in range(finer)]
    smooth: Array = sum(parts[1:], parts[0]) / finer**2
    return smooth


def render_surfaces(surfaces: Sequence[Surface], camera: Camera, up: Array) -> Layer:
    """The nearest surface at every pixel, shaded; ``up``: against gravity (3,)."""
    (layer,) = render_bands(surfaces, camera, up, [(0, camera.height)])
    return layer


def render_bands(
    surfaces: Sequence[Surface], camera: Camera, up: Array, bands: Sequence[tuple[int, int]]
) -> Iterator[Layer]:
    """Yield :func:`render_surfaces` in bands, each of rows from the first to the one before the last: of large
    pictures some at a time, to save memory.
    """
    points, faces, owner = _join(surfaces)
    spans = _find_spans(camera.project(points)[faces], camera)
    normals = np.concatenate([np.zeros((0, 3)), *(average_normals(one.vertices, one.faces) for one in surfaces)])
    linear = np.array([one.colour for one in surfaces]).reshape(-1, 3) ** _GAMMA
    for first, last in bands:
        shape = (last - first, camera.width)
        if not np.any((spans.row >= first) & (spans.row < last)):
            nothing = np.broadcast_to(0.0, shape)
            yield Layer(nothing, np.broadcast_to(0.0, (*shape, 3)), np.broadcast_to(-1, shape), nothing)
            continue
        near, which = _find_nearest(spans, camera, (first, last))
        colour, facing = np.zeros((*shape, 3), "f4"), np.zeros(shape)
        surface = np.full(shape, -1, np.int32)
        y, x = np.nonzero(which >= 0)
        if len(y):
            hit = which[y, x]
            shares = spans.share(hit, np.add(x, 0.5), np.add(y, first + 0.5))
            normal = np.einsum("pc,pci->pi", shares, normals[faces[hit]])
            place = np.einsum("pc,pci->pi", shares, points[faces[hit]])
            surface[y, x] = owner[hit]
            colour[y, x], facing[y, x] = _shade(linear[owner[hit]], normal, place, camera, up)
        yield Layer(near, colour, surface, facing)


def find_coverage(surfaces: Sequence[Surface], camera: Camera) -> BoolArray:
    """Which pixels show any surface (h, w)."""
    points, faces, _ = _join(surfaces)
    spans = _find_spans(camera.project(points)[faces], camera)
    steps = np.zeros((camera.height, camera.width + 1), int)
    np.add.at(steps, (spans.row, spans.start), 1)
    np.add.at(steps, (spans.row, spans.start + spans.length), -1)
    covered: BoolArray = steps.cumsum(axis=1)[:, :-1] > 0
    return covered


def _join(surfaces: Sequence[Surface]) -> tuple[Array, IntArray, IntArray]:
    """Vertices (n, 3) and faces (m, 3) of all surfaces, and the surface of each face (m,)."""
    points = np.concatenate([np.zeros((0, 3)), *(one.vertices for one in surfaces)])
    counts = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    faces = np.concatenate([np.zeros((0, 3), int), *(one.faces + start for one, start in zip(surfaces, counts))])
    return points, faces, np.repeat(np.arange(len(surfaces)), [len(one.faces) for one in surfaces])


class _Spans(NamedTuple):
    """Pixels of a row that a triangle covers.

    Attributes:
        corners: of all triangles (m, 3, 3): pixels across and down, and inverse depth.
        area: twice that of each (m,), with its sign [pixels^2].
        triangle, row, start, length: of each span (s,).
        depth, slope: inverse depth at the first pixel of each (s,), and how much it grows with every further one.
    """

    corners: Array
    area: Array
    triangle: IntArray
    row: IntArray
    start: IntArray
    length: IntArray
    depth: Array
    slope: Array

    def share(self, triangle: IntArray, across: Array, down: Array) -> Array:
        """Shares of the corners of triangles (p,) at places in the picture (p, 3)."""
        a, b, c = np.moveaxis(self.corners[triangle, :, :2], 1, 0)
        (x1, y1), (x2, y2), x, y = (b - a).T, (c - a).T, across - a[:, 0], down - a[:, 1]
        second, third = (x * y2 - y * x2) / self.area[triangle], (y * x1 - x * y1) / self.area[triangle]
        return np.stack([1 - second - third, second, third], axis=1)


def _find_spans(corners: Array, camera: Camera) -> _Spans:
    """Spans of triangles with these corners (m, 3, 3): pixels across and down, and inverse depth."""
    (x1, y1), (x2, y2) = (corners[:, 1, :2] - corners[:, 0, :2]).T, (corners[:, 2, :2] - corners[:, 0, :2]).T
    area = x1 * y2 - y1 * x2
    low = np.maximum(np.ceil(corners[:, :, 1].min(axis=1) - 0.5), 0)
    high = np.minimum(np.floor(corners[:, :, 1].max(axis=1) - 0.5), camera.height - 1)
    good = (high >= low) & (np.abs(area) > 1e-9) & np.all(corners[:, :, 2] > 0, axis=1)
    chosen = np.flatnonzero(good)
    low, rows = low[chosen].astype(int), (high - low + 1)[chosen].astype(int)
    t = np.repeat(chosen, rows)
    row = np.arange(rows.sum()) + np.repeat(low - np.cumsum(rows) + rows, rows)
    y = row + 0.5 - corners[t, 0, 1]
    # Shares of the corners are linear across: where each becomes positive, or ends.
    slopes = np.stack([y1 - y2, y2, -y1], axis=1)[t] / area[t, None]
    starts = np.stack([area[t] - y * (x1 - x2)[t], -y * x2[t], y * x1[t]], axis=1) / area[t, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = -(starts + _EDGE) / slopes
    left = np.where(slopes > 0, ends, -np.inf).max(axis=1) + corners[t, 0, 0]
    right = np.where(slopes < 0, ends, np.inf).min(axis=1) + corners[t, 0, 0]
    first = np.ceil(np.clip(left, 0, camera.width) - 0.5)
    count = np.floor(np.clip(right, -1, camera.width) - 0.5) - first + 1
    some = np.flatnonzero((count > 0) & np.all((slopes != 0) | (starts >= -_EDGE), axis=1))
    t, first, slopes, depths = t[some], first[some], slopes[some], corners[t[some], :, 2]
    shares = starts[some] + slopes * (first + 0.5 - corners[t, 0, 0])[:, None]
    depth, slope = (shares * depths).sum(axis=1), (slopes * depths).sum(axis=1)
    return _Spans(corners, area, t, row[some], first.astype(int), count[some].astype(int), depth, slope)


def _find_nearest(spans: _Spans, camera: Camera, rows: tuple[int, int]) -> tuple[Array, IntArray]:
    """Inverse depth (h, w) of what is nearest in some rows, 0: nothing; and which triangle that is, -1: none."""
    shape = (rows[1] - rows[0], camera.width)
    near, which = np.zeros(shape[0] * shape[1]), np.full(shape[0] * shape[1], -1)
    own = np.flatnonzero((spans.row >= rows[0]) & (spans.row < rows[1]))
    done = np.cumsum(spans.length[own])
    for part in np.split(own, np.searchsorted(done, np.arange(_CHUNK, done[-1] if len(own) else 0, _CHUNK))):
        count = spans.length[part]
        place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        depth = np.repeat(spans.depth[part], count) + np.repeat(spans.slope[part], count) * place
        pixel = np.repeat((spans.row[part] - rows[0]) * camera.width + spans.start[part], count) + place
        np.maximum.at(near, pixel, depth)
        won = np.flatnonzero(depth == near[pixel])
        which[pixel[won]] = np.repeat(spans.triangle[part], count)[won]
    return near.reshape(shape), which.reshape(shape)


def average_normals(vertices: Array, faces: IntArray) -> Array:
    """Normals (n, 3) at the vertices (n, 3) of any length: the mean of their faces' (m, 3) by area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corners, count = faces.ravel(), len(vertices)
    return np.stack([np.bincount(corners, across[:, i], count) for i in range(3)], axis=1)


def _shade(linear: Array, normals: Array, places: Array, camera: Camera, up: Array) -> tuple[Array, Array]:
    """Colours (p, 3) under the sky, a light from the upper left and one at the camera; how far they face the camera.

    ``linear``: the surfaces' colours, as light that they give back.
    """
    view = camera.eye - places
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    facing = (n * view).sum(axis=1)
    n *= np.where(facing < 0, -1.0, 1.0)[:, None]
    facing = np.abs(facing)
    key = camera.axes[2] - 0.7 * camera.axes[0] + 1.1 * up
    key /= np.linalg.norm(key)
    sky = 0.5 + 0.5 * (n @ up)[:, None]
    light = (1 - sky) * [0.30, 0.29, 0.30] + sky * [0.56, 0.59, 0.64]
    light += 0.55 * np.maximum(n @ key, 0)[:, None] + 0.22 * facing[:, None]
    half = key + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = 0.10 * np.maximum((n * half).sum(axis=1), 0)[:, None] ** 40
    return np.clip(linear * light + gloss, 0, 1) ** (1 / _GAMMA), facing
