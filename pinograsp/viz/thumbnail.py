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
from pinograsp.viz.raster import Camera, Layer, average_blocks, fit_camera, overlay, render_surfaces
from pinograsp.viz.scene_meshes import LOAD, make_arrows
from pinograsp.viz.solids import Links, Solid, make_solids, make_surfaces, sample_cloud, to_sevens
from pinograsp.viz.stage import Held, Stage, choose_scale

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
    found, _ = make_solids(seen.hand, seen.body, links, {})
    solids = tuple(one for one in found if one.look != "collision")
    poses = links.poses(seen.q[None])[0]
    thing = None if seen.body is None else to_sevens(seen.body.pose)
    cloud = sample_cloud(solids, poses, thing)
    size = float(np.ptp(cloud, axis=0).max())
    up, view = _sight(seen, solids, poses, thing, cloud)
    arrows = _arrows(seen, size)
    width = _THICKNESS * size
    camera = _camera(np.concatenate([cloud, *arrows]), up, view)
    long = [
        (ends, colour)
        for ends, colour in zip(arrows, [*seen.colours, LOAD])
        if np.linalg.norm(ends[1] - ends[0]) >= width
    ]
    forces = make_arrows(seen.points_o, [], seen.colours, width)
    forces += make_arrows(np.zeros((0, 3)), [ends for ends, _ in long], [colour for _, colour in long], width)
    hand, held = make_surfaces(solids, poses, thing)
    image = _compose(
        render_surfaces(hand, camera, up), render_surfaces(held, camera, up), render_surfaces(forces, camera, up)
    )
    content = io.BytesIO()
    imsave(content, np.round(image * _STEPS) / _STEPS, format="png", pil_kwargs={"optimize": True})
    return content.getvalue()


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
    return fit_camera(cloud, axes, _SLOPE, (1.06, 1.06), (_FINER * across, _FINER * down))


def _arrows(seen: Seen, size: float) -> list[Array]:
    """Ends (2, 3) [m] of the forces' arrows, and of the load's."""
    forces, points = seen.forces_o, seen.points_o
    if seen.body is not None:
        forces, points = np.vstack([forces, seen.load_o]), np.vstack([points, seen.body.com_o])
    largest = float(np.linalg.norm(np.vstack([seen.forces_o, seen.load_o]), axis=1).max())
    if largest == 0:
        return []
    scale = choose_scale(size, largest)
    return [np.stack([point, point + scale * force]) for point, force in zip(points, forces)]


def _compose(hand: Layer, held: Layer, forces: Layer) -> Array:
    """The picture (h, w, 3), from 0 to 1."""
    image = np.tile(np.array(_PAPER), (*hand.near.shape, 1))
    image[hand.drawn] = hand.colour[hand.drawn]
    overlay(image, hand, held, forces, _OPACITY, _HIDDEN)
    return average_blocks(image, _FINER)
