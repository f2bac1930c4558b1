"""A picture of a grasp: hand, object, contacts and forces, drawn without a screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, flag, instance_of, integer, number, path_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array, BoolArray
from pinograsp.viz.outlines import draw_arrow, draw_ball
from pinograsp.viz.raster import (
    Camera,
    Layer,
    Surface,
    average_blocks,
    find_coverage,
    fit_camera,
    overlay,
    render_bands,
)
from pinograsp.viz.scene import ViewScene, make_scene
from pinograsp.viz.scene_meshes import BALL, LOAD, make_arrows
from pinograsp.viz.solids import make_surfaces, sample_cloud
from pinograsp.viz.style import SUFFIXES, NotebookFigure, encode_figure, make_label
from pinograsp.writing import write_file

_FINER = 2  # pixels that are drawn for each one of the picture, along either side
_BAND = 80  # of their rows are drawn at a time
_FOV = np.radians(28.0)
_CLEAR = 0.5  # opacity of the object where it faces the camera
_HIDDEN = 0.3  # opacity of forces behind the hand
_SOFT = 4  # how many times coarser shadows are drawn
_BLUR = 2.5  # standard deviation of their blur, in coarse pixels
_OUTLINE = 0.45  # how much darker pixels are where one solid ends before another
_LEVEL = 0.02  # of a direction: nearer to gravity's line it has no side of its own
_VIEWS = ("front", "back", "side", "top")


class Sheet(NamedTuple):
    """The sheet on which a picture is drawn.

    Attributes:
        width, height: in pixels.
        dpi: pixels per inch, for letters and lines.
        vector: arrows are vector graphics on white, and the rest has twice as many pixels.
        fading: the background darkens towards the lower edge.
    """

    width: int = 900
    height: int = 640
    dpi: int = 130
    vector: bool = False
    fading: bool = True

    def figure(self) -> Figure:
        """Empty, of this size."""
        return NotebookFigure(figsize=(self.width / self.dpi, self.height / self.dpi), dpi=self.dpi)


def picture(
    plan: PlanRecord,
    *,
    time: float | None = None,
    view: ArrayLike | None = None,
    collision_shapes: bool = False,
    vector: bool = False,
) -> Figure:
    """Draw a picture of a grasp: the object is translucent, arrows are forces on it, the black one its weight and load.

    Args:
        plan: a plan with its hand.
        time: of the plan [s]; None: when the grasp is complete.
        view: direction towards the camera (3,) in the world; ``"front"``, level with the grasp and with a good view of
            the contacts, ``"back"``, ``"side"`` (on the right of the front) or ``"top"``; None: the front, from
            slightly above.
        collision_shapes: draw the collision shapes instead of the visual ones.
        vector: for print, as SVG and PDF: arrows are vector graphics on white, and the hand has twice as many pixels.

    Raises:
        InvalidInput: a plan without its hand, or another view.
    """
    scene = make_scene(plan)
    when = scene.closed if time is None else time
    return draw_picture(scene, when, view=view, collision_shapes=collision_shapes, vector=vector)


def draw_picture(
    scene: ViewScene,
    time: float,
    *,
    view: ArrayLike | None = None,
    collision_shapes: bool = False,
    vector: bool = False,
) -> Figure:
    """Draw a scene at a time [s], as :func:`picture` does."""
    flag("collision_shapes", collision_shapes)
    sheet = Sheet(vector=flag("vector", vector), fading=not vector)
    frame = instance_of("scene", scene, ViewScene).frame_at(number("time", time, unit="s"))
    camera = find_camera(scene, view, [frame], sheet)
    figure = sheet.figure()
    draw(figure, scene, frame, camera, sheet, collision_shapes=collision_shapes)
    return figure


def write_picture(
    scene: ViewScene,
    path: str | Path,
    time: float,
    *,
    view: ArrayLike | None = None,
    collision_shapes: bool = False,
) -> Path:
    """Write a picture of a scene at a time [s]: .png, or .svg or .pdf for print; returns its path.

    Raises:
        InvalidInput: another suffix, or another view.
        ResultsNotWritten: the file cannot be written.
    """
    path = path_of("path", path)
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise InvalidInput(
            f"picture: expected a name that ends in {', '.join(SUFFIXES)} (moving pictures, .gif and .mp4, are made "
            f"by film), got '{path.name:.200}'"
        )
    figure = draw_picture(scene, time, view=view, collision_shapes=collision_shapes, vector=kind != ".png")
    return write_file(path, encode_figure(figure, kind[1:]))


def draw(
    figure: Figure, scene: ViewScene, frame: int, camera: Camera, sheet: Sheet, *, collision_shapes: bool = False
) -> None:
    """Draw a scene at an instant onto a figure of the sheet's size."""
    for value, kind in ((figure, Figure), (scene, ViewScene), (camera, Camera), (sheet, Sheet)):
        instance_of(kind.__name__.lower(), value, kind)
    frame = integer("frame", frame, at_least=0, at_most=len(scene.times) - 1)
    flag("collision_shapes", collision_shapes)
    pose = scene.object_at(frame)
    hidden = "visual" if collision_shapes else "collision"
    solids = [solid for solid in scene.solids if solid.look != hidden]
    hand, thing = make_surfaces(solids, scene.link_poses[frame], pose)
    forces = [] if sheet.vector else _forces(scene, frame)
    image, near = _image((hand, thing, forces), camera, _shadow(scene, camera, hand + thing), scene.up, sheet.fading)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    smooth = "none" if sheet.vector else "antialiased"
    axes.imshow(image, extent=(0, sheet.width, sheet.height, 0), interpolation=smooth)
    axes.set(xlim=(0, sheet.width), ylim=(sheet.height, 0))
    axes.set_axis_off()
    if sheet.vector:
        _outline(axes, scene, frame, camera, near, sheet)
    _label(axes, scene, frame, camera, sheet)
    for caution in scene.unseen:  # meshes that are gone
        axes.text(12, sheet.height - 12, caution.partition(":")[0], fontsize=7, color="0.35")


def _direction(view: ArrayLike | None, scene: ViewScene) -> Array:
    if view is None:
        return scene.view
    if isinstance(view, str):
        front = scene.view - (scene.view @ scene.up) * scene.up
        front /= np.linalg.norm(front)
        named = dict(zip(_VIEWS, (front, -front, np.cross(scene.up, front), scene.up)))
        if view not in named:
            raise InvalidInput(
                f"view: expected a direction towards the camera (3,), or {', '.join(_VIEWS[:-1])} or {_VIEWS[-1]}, got "
                f"'{view:.100}'"
            )
        return named[view]
    given = array_of("view", view, (3,))
    if not given.any():
        raise InvalidInput(f"view: expected a direction towards the camera, got {given.tolist()}")
    unit: Array = given / np.linalg.norm(given)
    return unit


def find_camera(scene: ViewScene, view: ArrayLike | None, frames: Sequence[int], sheet: Sheet) -> Camera:
    """Find a camera that sees all of the hand and the object at these instants; ``view``: as for :func:`picture`."""
    instance_of("sheet", sheet, Sheet)
    view = _direction(view, instance_of("scene", scene, ViewScene))
    right = np.cross(scene.up, view)
    if np.linalg.norm(right) < _LEVEL:
        right = np.cross(scene.up, scene.view)  # from above, with the front below
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view, right), view])
    clouds = [sample_cloud(scene.solids, scene.link_poses[frame], scene.object_at(frame)) for frame in frames]
    clouds += [_arrows(scene, frame).reshape(-1, 3) for frame in frames]
    size = (_finer(sheet) * sheet.width, _finer(sheet) * sheet.height)
    # Room on either side for the labels.
    return fit_camera(np.concatenate(clouds), axes, np.tan(_FOV / 2), (1.45, 1.12), size)


def _arrows(scene: ViewScene, frame: int) -> Array:
    """Ends of the forces' arrows and, last, of the load's (k + 1, 2, 3) [m], where they are at an instant."""
    return scene.carry_points(np.stack([*scene.arrows(frame), scene.load_arrow(frame)]), frame)


def _finer(sheet: Sheet) -> int:
    return 2 * _FINER if sheet.vector else _FINER


def _outline(axes: Axes, scene: ViewScene, frame: int, camera: Camera, near: Array, sheet: Sheet) -> None:
    """Contact points and forces as vector graphics, the farthest first; pale where the hand hides them."""
    arrows = _arrows(scene, frame)
    points, finer = scene.carry_points(scene.points_o, frame), _finer(sheet)

    def project(places: Array) -> Array:
        return camera.project(places) / [finer, finer, 1.0]

    def hidden(places: Array) -> BoolArray:
        x, y, depth = camera.project(places).T
        rows, columns = (np.clip((at / _FINER).astype(int), 0, most - 1) for at, most in zip((y, x), near.shape))
        behind: BoolArray = near[rows, columns] > depth
        return behind

    for point, colour in zip(points, scene.colours):
        draw_ball(axes, project, hidden, point, BALL * scene.thickness, colour, _HIDDEN)
    order = np.argsort(camera.project(arrows.mean(axis=1))[:, 2], kind="stable")
    for i in order:
        colour = [*scene.colours, LOAD][i]
        draw_arrow(axes, project, hidden, arrows[i], scene.thickness, colour, _HIDDEN)


def _forces(scene: ViewScene, frame: int) -> list[Surface]:
    """Contact points, the forces there, and the load."""
    arrows, colours = list(_arrows(scene, frame)), [*scene.colours, LOAD]
    return make_arrows(scene.carry_points(scene.points_o, frame), arrows, colours, scene.thickness)


def _shadow(scene: ViewScene, camera: Camera, surfaces: Sequence[Surface]) -> Array:
    """How dark the ground is at each pixel of the picture (h, w), from 0 to 1, under a light from above."""
    size = (camera.height // _FINER, camera.width // _FINER)
    if camera.eye @ scene.up < scene.ground:
        return np.zeros(size)
    light = scene.up + 0.25 * camera.axes[0]
    flat = [
        Surface(
            one.vertices - np.outer((one.vertices @ scene.up - scene.ground) / (light @ scene.up), light),
            one.faces,
            one.colour,
        )
        for one in surfaces
    ]
    coarse = Camera(camera.eye, camera.axes, camera.focal / _SOFT, camera.width // _SOFT, camera.height // _SOFT)
    dark = find_coverage(flat, coarse).astype(np.float32)
    down, across = (_soften(fine, rough) for fine, rough in zip(size, dark.shape))
    shadow: Array = 0.22 * (down @ dark @ across.T)
    return shadow


def _soften(fine: int, coarse: int) -> Array:
    """Weights (fine, coarse) of coarse pixels in a row, at finer ones, that blur them."""
    places, middles = (np.arange(fine) + 0.5) * coarse / fine, np.arange(coarse) + 0.5
    weights = np.exp(-0.5 * ((places[:, None] - middles) / _BLUR) ** 2).astype(np.float32)
    soft: Array = weights / weights.sum(axis=1, keepdims=True)
    return soft


def _image(
    parts: tuple[list[Surface], list[Surface], list[Surface]], camera: Camera, shadow: Array, up: Array, fading: bool
) -> tuple[Array, Array]:
    """The picture (h, w, 3), from 0 to 1, of hand, object and forces; and how near the hand is there (h, w) [1/m].

    Drawn in bands, to save memory.
    """
    rows = np.linspace(0, 1 if fading else 0, camera.height, dtype=np.float32)[:, None, None]
    ground = (1 - rows) + rows * np.array([0.90, 0.92, 0.945], np.float32)
    images, depths = list[Array](), list[Array]()
    firsts = range(0, camera.height, _BAND)
    # With one more on either side: edges are seen beside others.
    bands = [(max(first - _FINER, 0), min(first + _BAND + _FINER, camera.height)) for first in firsts]
    layers = [render_bands(part, camera, up, bands) for part in parts]
    for first, (low, high), hand, thing, forces in zip(firsts, bands, *layers):
        light = np.repeat(1 - shadow[low // _FINER : -(-high // _FINER)], _FINER, axis=0)[: high - low]
        image = _compose(hand, thing, forces, ground[low:high] * np.repeat(light, _FINER, axis=1)[..., None])
        last = min(first + _BAND, camera.height)
        images.append(image[(first - low) // _FINER : len(image) - (high - last) // _FINER])
        depths.append(hand.near[first - low : last - low : _FINER, ::_FINER])
    return np.concatenate(images), np.concatenate(depths)


def _compose(hand: Layer, thing: Layer, forces: Layer, image: Array) -> Array:
    """Some rows of the picture (h, w, 3), from 0 to 1, drawn upon the ground there, ``image``."""
    np.copyto(image, hand.colour, where=hand.drawn[..., None])
    image[_edges(hand)] *= np.float32(1 - _OUTLINE)
    overlay(image, hand, thing, forces, _CLEAR, _HIDDEN)
    return average_blocks(image, _FINER)


def _edges(layer: Layer) -> BoolArray:
    """Where a surface ends before another one or the background (h, w)."""
    edges = np.zeros(layer.near.shape, dtype=bool)
    for one, beside in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        differ, nearer = layer.surface[one] != layer.surface[beside], layer.near[one] > layer.near[beside]
        edges[one] |= differ & nearer
        edges[beside] |= differ & (layer.near[one] < layer.near[beside])
    return edges


def _label(axes: Axes, scene: ViewScene, frame: int, camera: Camera, sheet: Sheet) -> None:
    """Names and normal forces of the contacts that press, in a column on either side, with lines to the contacts."""
    pressing = np.flatnonzero(scene.normal[frame] > 0)
    points = camera.project(scene.carry_points(scene.points_o, frame))[:, :2] / _finer(sheet)
    # On the same side throughout a moving picture.
    on_left = points[:, 0] < np.median(points[:, 0]) if len(points) > 1 else np.array([True] * len(points))
    margin, line = sheet.dpi / 11, sheet.dpi / 5
    for left in (True, False):
        chosen = pressing[on_left[pressing] == left]
        chosen = chosen[np.argsort(points[chosen, 1])]
        gap = min(line, (sheet.height - 1.5 * line) / max(len(chosen), 1))
        heights = np.maximum(points[chosen, 1], line / 2)
        for i in range(1, len(chosen)):
            heights[i] = max(heights[i], heights[i - 1] + gap)
        heights -= max(0.0, heights[-1] - (sheet.height - 0.8 * line)) if len(chosen) else 0.0
        for k, height in zip(chosen, heights):
            axes.annotate(
                f"{make_label(scene.contacts[k])}  {scene.normal[frame, k]:.3g} N",
                (points[k, 0], points[k, 1]),
                (margin if left else sheet.width - margin, height),
                ha="left" if left else "right",
                va="center",
                fontsize=7.5,
                color="white",
                bbox={"boxstyle": "round,pad=0.35", "facecolor": scene.colours[k], "edgecolor": "none"},
                arrowprops={"arrowstyle": "-", "color": scene.colours[k], "linewidth": 0.8},
            )
