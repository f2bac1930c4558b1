"""Shaded triangles as pixels, without a graphics card: a depth buffer and a light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pinograsp.spatial import Array, BoolArray, IntArray

_CHUNK = 50_000  # pairs of a triangle and a pixel at a time: they fit a processor's cache
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
        rows: the first row that is drawn and the one after the last: of large pictures some at a time; None: all.
    """

    eye: Array
    axes: Array
    focal: float
    width: int
    height: int
    rows: tuple[int, int] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of what is drawn."""
        first, last = self.rows or (0, self.height)
        return last - first, self.width

    def project(self, points: Array) -> Array:
        """Pixels across and down, and the inverse of the depth [1/m], of points (n, 3); behind the camera 0."""
        seen = (points - self.eye) @ self.axes.T
        near = np.divide(1.0, -seen[:, 2], out=np.zeros(len(seen)), where=seen[:, 2] < 0)
        across = self.width / 2 + self.focal * seen[:, 0] * near
        down = self.height / 2 - self.focal * seen[:, 1] * near - (self.rows or (0, 0))[0]
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
    before = thing.drawn & (thing.near > hand.near)
    opacity = (clear + (1 - clear) * 0.6 * (1 - thing.facing) ** 2)[before, None]
    image[before] = (1 - opacity) * image[before] + opacity * thing.colour[before]
    opacity = np.where(forces.near >= hand.near, 1.0, hidden)[forces.drawn, None]
    image[forces.drawn] = (1 - opacity) * image[forces.drawn] + opacity * forces.colour[forces.drawn]


def average_blocks(image: Array, finer: int) -> Array:
    """Blocks of ``finer`` pixels along either side as one, of a picture (h, w, 3)."""
    h, w, _ = image.shape
    smooth: Array = image.reshape(h // finer, finer, w // finer, finer, 3).mean(axis=(1, 3))
    return smooth


def render_surfaces(surfaces: Sequence[Surface], camera: Camera, up: Array) -> Layer:
    """The nearest surface at every pixel, shaded; ``up``: against gravity (3,)."""
    size = camera.shape[0] * camera.shape[1]
    near, which, weights = np.zeros(size), np.full(size, -1), np.zeros((size, 3))
    points = np.concatenate([np.zeros((0, 3)), *(one.vertices for one in surfaces)])
    counts = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    faces = np.concatenate([np.zeros((0, 3), int), *(one.faces + start for one, start in zip(surfaces, counts))])
    owner = np.repeat(np.arange(len(surfaces)), [len(one.faces) for one in surfaces])
    corners = camera.project(points)[faces]
    for triangle, pixel, shares in _cover(corners, camera):
        depth = np.einsum("pc,pc->p", shares, corners[triangle, :, 2])
        np.maximum.at(near, pixel, depth)
        won = np.flatnonzero(depth == near[pixel])
        which[pixel[won]], weights[pixel[won]] = triangle[won], shares[won]
    drawn = which >= 0
    hit = which[drawn]
    colour, facing, surface = np.zeros((size, 3)), np.zeros(size), np.full(size, -1)
    if len(hit):
        normals = np.concatenate([_normals(one) for one in surfaces])
        normal = np.einsum("pc,pci->pi", weights[drawn], normals[faces[hit]])
        place = np.einsum("pc,pci->pi", weights[drawn], points[faces[hit]])
        colours = np.array([one.colour for one in surfaces])
        colour[drawn], facing[drawn] = _shade(colours[owner[hit]], normal, place, camera, up)
        surface[drawn] = owner[hit]
    shape = camera.shape
    return Layer(near.reshape(shape), colour.reshape(*shape, 3), surface.reshape(shape), facing.reshape(shape))


def _cover(corners: Array, camera: Camera) -> Iterator[tuple[IntArray, IntArray, Array]]:
    """Yield triangles, the pixels that they cover, and the shares of their corners there (p, 3), some at a time.

    ``corners`` (m, 3, 3): pixels across and down, and inverse depth.
    """
    low = np.ceil(corners[:, :, :2].min(axis=1) - 0.5)
    high = np.floor(corners[:, :, :2].max(axis=1) - 0.5)
    low, high = np.maximum(low, 0), np.minimum(high, [camera.width - 1, camera.shape[0] - 1])
    a, b, c = np.moveaxis(corners[:, :, :2], 1, 0)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    good = np.all(high >= low, axis=1) & (np.abs(area) > 1e-9) & np.all(corners[:, :, 2] > 0, axis=1)
    chosen = np.flatnonzero(good)
    low, wide = low[chosen].astype(int), (high - low + 1)[chosen].astype(int)
    pairs = np.cumsum(wide.prod(axis=1))
    start = 0
    while start < len(chosen):
        done = pairs[start - 1] if start else 0
        stop = max(int(np.searchsorted(pairs, done + _CHUNK, side="right")), start + 1)
        many = wide[start:stop].prod(axis=1)
        own = np.repeat(np.arange(start, stop), many)
        place = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
        x, y = low[own, 0] + place % wide[own, 0], low[own, 1] + place // wide[own, 0]
        t = chosen[own]
        px, py = x + 0.5, y + 0.5
        first = ((b[t, 0] - px) * (c[t, 1] - py) - (b[t, 1] - py) * (c[t, 0] - px)) / area[t]
        second = ((c[t, 0] - px) * (a[t, 1] - py) - (c[t, 1] - py) * (a[t, 0] - px)) / area[t]
        third = 1 - first - second
        inside = np.flatnonzero((first >= -_EDGE) & (second >= -_EDGE) & (third >= -_EDGE))
        shares = np.stack([first[inside], second[inside], third[inside]], axis=1)
        yield t[inside], (y * camera.width + x)[inside], shares
        start = stop


def _normals(surface: Surface) -> Array:
    """Normals (n, 3) at the vertices: the mean of their faces' by area."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.vertices)
    for i in range(3):
        np.add.at(normals, surface.faces[:, i], across)
    return normals


def _shade(colours: Array, normals: Array, places: Array, camera: Camera, up: Array) -> tuple[Array, Array]:
    """Colours (p, 3) under the sky, a light from the upper left and one at the camera; how far they face the camera."""
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
    return np.clip(colours**_GAMMA * light + gloss, 0, 1) ** (1 / _GAMMA), facing
