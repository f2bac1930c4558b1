"""A still picture of a grasp: hand, object, contacts and forces, drawn without a screen."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, zoom

from pinograsp.checks import array_of, flag, number
from pinograsp.errors import InvalidInput
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array
from pinograsp.viz.raster import Camera, Layer, Surface, rendered
from pinograsp.viz.scene import ViewScene, scene_of
from pinograsp.viz.scene_meshes import LOAD, arrow, ball, rgb
from pinograsp.viz.solids import cloud_of, placed
from pinograsp.viz.style import label_of

_SIZE = (900, 640)  # pixels
_FINER = 2  # pixels that are drawn for each one of the picture, along either side
_BAND = 80  # of their rows are drawn at a time
_DPI = 130
_FOV = np.radians(28.0)
_CLEAR = 0.5  # opacity of the object where it faces the camera
_HIDDEN = 0.3  # opacity of forces behind the hand
_SOFT = 4  # how many times coarser shadows are drawn
_OUTLINE = 0.45  # how much darker pixels are where one solid ends before another


def picture(
    plan: PlanRecord, *, time: float | None = None, view: ArrayLike | None = None, collision_shapes: bool = False
) -> Figure:
    """A grasp as a picture: the object is translucent, arrows are forces on it, the black one its weight and load.

    Args:
        plan: with its hand.
        time: of the plan [s]; None: when the grasp is complete.
        view: direction towards the camera (3,) in the world; None: where little hides the contacts.
        collision_shapes: draw the shapes that plans work with, in place of the hand as it looks.

    Raises:
        InvalidInput: a plan without its hand, or a direction along gravity.
    """
    scene = scene_of(plan)
    return picture_of(scene, scene.closed if time is None else time, view=view, collision_shapes=collision_shapes)


def picture_of(
    scene: ViewScene, time: float, *, view: ArrayLike | None = None, collision_shapes: bool = False
) -> Figure:
    """A scene at a time [s], as :func:`picture` draws it."""
    flag("collision_shapes", collision_shapes)
    frame = scene.frame_at(number("time", time, unit="s"))
    pose = scene.object_at(frame)
    camera = _camera(scene, scene.view if view is None else _direction(view, scene.up), frame)
    hidden = "visual" if collision_shapes else "collision"
    solids = [solid for solid in scene.solids if solid.look != hidden]
    hand = [
        Surface(placed(one, scene.link_poses[frame, one.link]), one.faces, rgb(one.colour) / 255)
        for one in solids
        if one.link is not None
    ]
    thing = [
        Surface(placed(one, pose), one.faces, rgb(one.colour) / 255)
        for one in solids
        if one.link is None and pose is not None
    ]
    image = _image((hand, thing, _forces(scene, frame)), camera, _shadow(scene, camera, hand + thing), scene.up)
    figure = Figure(figsize=(_SIZE[0] / _DPI, _SIZE[1] / _DPI), dpi=_DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(image, extent=(0, _SIZE[0], _SIZE[1], 0))
    axes.set(xlim=(0, _SIZE[0]), ylim=(_SIZE[1], 0))
    axes.set_axis_off()
    _label(axes, scene, frame, camera)
    for caution in scene.unseen:  # meshes that are gone
        axes.text(12, _SIZE[1] - 12, caution.partition(":")[0], fontsize=7, color="0.35")
    return figure


def png_of(figure: Figure) -> bytes:
    """A picture as the content of a PNG file."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI)
    return content.getvalue()


def _direction(view: ArrayLike, up: Array) -> Array:
    given = array_of("view", view, (3,))
    if np.linalg.norm(np.cross(given, up)) < 1e-3 * np.linalg.norm(given) or not given.any():
        raise InvalidInput(f"view: expected a direction towards the camera, not along gravity, got {given.tolist()}")
    unit: Array = given / np.linalg.norm(given)
    return unit


def _camera(scene: ViewScene, view: Array, frame: int) -> Camera:
    """A camera that sees all of the hand and the object at an instant."""
    right = np.cross(scene.up, view)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view, right), view])
    cloud = cloud_of(scene.solids, scene.link_poses[frame], scene.object_at(frame))
    seen = np.concatenate([cloud, scene.moved(scene.arrows(frame), frame).reshape(-1, 3)]) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    # Room on either side for the labels.
    slope = np.tan(_FOV / 2)
    distance = max(1.12 * half[1], 1.45 * half[0] * _SIZE[1] / _SIZE[0]) / slope + half[2]
    width, height = (_FINER * side for side in _SIZE)
    return Camera(centre @ axes + distance * view, axes, height / 2 / slope, width, height)


def _forces(scene: ViewScene, frame: int) -> list[Surface]:
    """Contact points, the forces there, and the load."""
    width = scene.thickness
    vertices, faces = ball()
    surfaces = [
        Surface(1.7 * width * vertices + point, faces, rgb(colour) / 255)
        for point, colour in zip(scene.moved(scene.points_o, frame), scene.colours)
    ]
    arrows = scene.moved(np.stack([*scene.arrows(frame), scene.load_arrow(frame)]), frame)
    for (start, end), colour in zip(arrows, [*scene.colours, LOAD]):
        surfaces += _arrow(start, end - start, width, rgb(colour) / 255)
    return surfaces


def _arrow(start: Array, along: Array, width: float, colour: Array) -> list[Surface]:
    length = float(np.linalg.norm(along))
    if length < 1e-5:
        return []
    z = along / length
    x = np.cross([1.0, 0.0, 0.0] if abs(z[0]) < 0.8 else [0.0, 1.0, 0.0], z)
    axes = np.stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z])
    tip = min(5 * width, 0.6 * length)
    sizes = ((width, length - tip, 0.0), (2.3 * width, tip, length - tip))
    return [
        Surface((vertices * [radius, radius, high]) @ axes + start + base * z, faces, colour)
        for (vertices, faces), (radius, high, base) in zip(arrow(), sizes)
    ]


def _shadow(scene: ViewScene, camera: Camera, surfaces: Sequence[Surface]) -> Array:
    """How dark the ground is (h, w), from 0 to 1, under a light from above."""
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
    dark = gaussian_filter(rendered(flat, coarse, scene.up).drawn.astype(float), 2.5)
    fine: Array = zoom(dark, _SOFT, order=1)
    return 0.22 * fine


def _image(
    parts: tuple[list[Surface], list[Surface], list[Surface]], camera: Camera, shadow: Array, up: Array
) -> Array:
    """The picture (h, w, 3), from 0 to 1, of hand, object and forces; drawn in bands, to save memory."""
    rows, bands = np.linspace(0, 1, camera.height), list[Array]()
    for first in range(0, camera.height, _BAND):
        last = min(first + _BAND, camera.height)
        # With one more on either side: edges are seen beside others.
        low, high = max(first - _FINER, 0), min(last + _FINER, camera.height)
        band = camera._replace(rows=(low, high))
        hand, thing, forces = (rendered(part, band, up) for part in parts)
        image = _composed(hand, thing, forces, shadow[low:high], rows[low:high, None, None])
        bands.append(image[(first - low) // _FINER : len(image) - (high - last) // _FINER])
    return np.concatenate(bands)


def _composed(hand: Layer, thing: Layer, forces: Layer, shadow: Array, rows: Array) -> Array:
    """Some rows of the picture (h, w, 3), from 0 to 1; ``rows``: how far down they are, from 0 to 1."""
    image = (1 - rows) * [1.0, 1.0, 1.0] + rows * [0.90, 0.92, 0.945]
    image = image * (1 - shadow[..., None])
    drawn = hand.drawn
    image[drawn] = hand.colour[drawn]
    image *= 1 - _OUTLINE * _edges(hand)[..., None]
    before = thing.drawn & (thing.near > hand.near)
    opacity = (_CLEAR + (1 - _CLEAR) * 0.6 * (1 - thing.facing) ** 2)[before, None]
    image[before] = (1 - opacity) * image[before] + opacity * thing.colour[before]
    opacity = np.where(forces.near >= hand.near, 1.0, _HIDDEN)[forces.drawn, None]
    image[forces.drawn] = (1 - opacity) * image[forces.drawn] + opacity * forces.colour[forces.drawn]
    h, w = shadow.shape
    smooth: Array = image.reshape(h // _FINER, _FINER, w // _FINER, _FINER, 3).mean(axis=(1, 3))
    return smooth


def _edges(layer: Layer) -> Array:
    """Where a surface ends before another one or the background (h, w), 0 or 1."""
    edges = np.zeros(layer.near.shape)
    for axis in (0, 1):
        for step in (1, -1):
            beside, behind = np.roll(layer.surface, step, axis), np.roll(layer.near, step, axis)
            edges[(beside != layer.surface) & (layer.near > behind) & layer.drawn] = 1.0
    return edges


def _label(axes: Axes, scene: ViewScene, frame: int, camera: Camera) -> None:
    """Names and normal forces of the contacts, in a column on either side, with lines to the contacts."""
    points = camera.project(scene.moved(scene.points_o, frame))[:, :2] / _FINER
    on_left = points[:, 0] < np.median(points[:, 0]) if len(points) > 1 else np.array([True] * len(points))
    for left in (True, False):
        chosen = np.flatnonzero(on_left == left)
        chosen = chosen[np.argsort(points[chosen, 1])]
        gap = min(26.0, (_SIZE[1] - 40.0) / max(len(chosen), 1))
        heights = points[chosen, 1].copy()
        for i in range(1, len(chosen)):
            heights[i] = max(heights[i], heights[i - 1] + gap)
        heights -= max(0.0, heights[-1] - (_SIZE[1] - 20.0)) if len(chosen) else 0.0
        for k, height in zip(chosen, heights):
            axes.annotate(
                f"{label_of(scene.contacts[k])}  {scene.normal[frame, k]:.3g} N",
                points[k],
                (12 if left else _SIZE[0] - 12, height),
                ha="left" if left else "right",
                va="center",
                fontsize=7.5,
                color="white",
                bbox={"boxstyle": "round,pad=0.35", "facecolor": scene.colours[k], "edgecolor": "none"},
                arrowprops={"arrowstyle": "-", "color": scene.colours[k], "linewidth": 0.8},
            )
