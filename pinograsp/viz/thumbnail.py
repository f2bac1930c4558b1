"""A small picture of hand, object and forces, drawn in a fraction of a second, as notebooks show it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.image import imsave

from pinograsp.checks import brief
from pinograsp.hands.model import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array
from pinograsp.viz.raster import Camera, Layer, Surface, averaged, fitted, overlaid, rendered
from pinograsp.viz.scene_meshes import LOAD, arrow_along, ball, rgb
from pinograsp.viz.solids import Links, Solid, cloud_of, placed, sevens, solids_of
from pinograsp.viz.stage import Held, Stage, scale_of

_SIZE = (380, 290)  # pixels
_FINER = 2  # pixels that are drawn for each one of the picture, along either side
_SLOPE = float(np.tan(np.radians(14.0)))  # of half the field of view
_THICKNESS = 0.009  # of arrows, over the scene's size
_OPACITY, _HIDDEN = 0.55, 0.35  # of the object where it faces the camera; of forces behind the hand
_PAPER = (0.955, 0.962, 0.972)  # behind it all: pages of light and dark themes show the same picture
_STEPS = 48  # levels of each colour: more would double the file
_SIDEWAYS = 0.9  # cosine: from where on a direction is along gravity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """What there is to see.

    Attributes:
        hand: where it is.
        q: of its joints (n,) [rad or m].
        body: the object, where it is; None: there is none.
        points_o: contact points (k, 3) [m].
        normals_o: into the object (k, 3).
        forces_o: on the object (k, 3) [N].
        load_o: on the object, besides (3,) [N].
        colours: of the contacts (k,), ``#rrggbb``.
        gravity_o: (3,) [m/s^2].
    """

    hand: HandModel
    q: Array
    body: Body | None = None
    points_o: Array = field(default_factory=lambda: np.zeros((0, 3)))
    normals_o: Array = field(default_factory=lambda: np.zeros((0, 3)))
    forces_o: Array = field(default_factory=lambda: np.zeros((0, 3)))
    load_o: Array = field(default_factory=lambda: np.zeros(3))
    colours: Sequence[str] = ()
    gravity_o: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))

    __repr__ = brief()


def thumbnail(seen: Seen) -> bytes:
    """The picture as the content of a PNG file, some tens of kilobytes."""
    links = Links(seen.hand)
    found, _ = solids_of(seen.hand, seen.body, links, {})
    solids = tuple(one for one in found if one.look != "collision")
    poses = links.poses(seen.q[None])[0]
    thing = None if seen.body is None else sevens(seen.body.pose)
    cloud = cloud_of(solids, poses, thing)
    size = float(np.ptp(cloud, axis=0).max())
    up, view = _sight(seen, solids, poses, thing, cloud)
    arrows = _arrows(seen, size)
    width = _THICKNESS * size
    camera = _camera(np.concatenate([cloud, *(ends for ends, _ in arrows)]), up, view)
    vertices, faces = ball()
    forces = [
        Surface(1.7 * width * vertices + point, faces, _painted(colour))
        for point, colour in zip(seen.points_o, seen.colours)
    ]
    for (start, end), colour in arrows:
        if np.linalg.norm(end - start) >= width:
            forces += arrow_along(start, end - start, width, _painted(colour))
    hand = [
        Surface(placed(one, poses[one.link]), one.faces, _painted(one.colour)) for one in solids if one.link is not None
    ]
    held = [
        Surface(placed(one, thing), one.faces, _painted(one.colour))
        for one in solids
        if one.link is None and thing is not None
    ]
    image = _composed(rendered(hand, camera, up), rendered(held, camera, up), rendered(forces, camera, up))
    content = io.BytesIO()
    imsave(content, np.round(image * _STEPS) / _STEPS, format="png", pil_kwargs={"optimize": True})
    return content.getvalue()


def _painted(colour: str) -> Array:
    painted: Array = rgb(colour) / 255
    return painted


def _sight(
    seen: Seen, solids: tuple[Solid, ...], poses: Array, thing: Array | None, cloud: Array
) -> tuple[Array, Array]:
    """Upwards, and towards the camera: where little hides the contacts; of a hand alone its broad side."""
    if len(seen.points_o):
        com = seen.points_o.mean(axis=0) if seen.body is None else seen.body.com_o
        held = Held(seen.gravity_o, seen.points_o, seen.normals_o, com)
        stage = Stage(held, solids, poses[None], None if thing is None else thing[None])
        return stage.up, stage.view
    axes = np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)[2]
    up = np.array([0.0, 0.0, 1.0])
    if abs(float(axes[2] @ up)) > _SIDEWAYS:  # the hand lies flat
        up = axes[0]
    side, upright, flat = np.cross(up, axes[2]), up, axes[2] - (axes[2] @ up) * up
    view = 0.85 * flat / np.linalg.norm(flat) + 0.35 * side / np.linalg.norm(side) + 0.3 * upright
    return up, view / np.linalg.norm(view)


def _camera(cloud: Array, up: Array, view: Array) -> Camera:
    """A camera that sees all of a cloud."""
    right = np.cross(up, view) / np.linalg.norm(np.cross(up, view))
    axes = np.stack([right, np.cross(view, right), view])
    across, down = _SIZE
    return fitted(cloud, axes, _SLOPE, (1.06, 1.06), (_FINER * across, _FINER * down))


def _arrows(seen: Seen, size: float) -> list[tuple[Array, str]]:
    """Ends (2, 3) [m] and colours of the forces' arrows, and of the load's."""
    largest = float(np.linalg.norm(np.vstack([seen.forces_o, seen.load_o]), axis=1).max())
    if largest == 0:
        return []
    scale = scale_of(size, largest)
    ends = [
        (np.stack([point, point + scale * force]), colour)
        for point, force, colour in zip(seen.points_o, seen.forces_o, seen.colours)
    ]
    if seen.body is not None:
        com = seen.body.com_o
        ends.append((np.stack([com, com + scale * seen.load_o]), LOAD))
    return ends


def _composed(hand: Layer, held: Layer, forces: Layer) -> Array:
    """The picture (h, w, 3), from 0 to 1."""
    image = np.tile(np.array(_PAPER), (*hand.near.shape, 1))
    image[hand.drawn] = hand.colour[hand.drawn]
    overlaid(image, hand, held, forces, _OPACITY, _HIDDEN)
    return averaged(image, _FINER)
