"""Where the camera stands, and how large the scene is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinograsp.spatial import Array, tangent_frame
from pinograsp.viz.solids import Solid, place_solid, sample_cloud

_ARROW = 0.3  # length of the largest arrow relative to the scene's size, before the scale is rounded to 1, 2 or 5
_ELEVATION = np.radians(22.0)  # preferred elevation of the camera
_SAMPLES = 4000  # number of points on the hand, which may hide contacts


class Held(NamedTuple):
    """What the camera should see at some instant.

    Attributes:
        gravity: (3,) [m/s^2].
        points: of contact (k, 3) [m].
        normals: there (k, 3).
        com: centre of mass (3,) [m].
    """

    gravity: Array
    points: Array
    normals: Array
    com: Array


class Stage:
    """Camera direction and size of the scene.

    Args:
        held: what the camera should see.
        solids: of hand and object.
        link_poses: (f, l, 7).
        object_poses: (f, 7); None: there is no object.
        at: the instant of ``held``.

    Attributes:
        up: against gravity (3,).
        view: unit direction towards the camera (3,).
        right: (3,).
        size: the scene's largest dimension [m].
    """

    def __init__(
        self, held: Held, solids: tuple[Solid, ...], link_poses: Array, object_poses: Array | None, at: int = -1
    ):
        gravity = held.gravity
        self.up = -gravity / np.linalg.norm(gravity) if np.any(gravity) else np.array([0.0, 0.0, 1.0])
        shown = np.linspace(0, len(link_poses) - 1, 8).astype(int)
        things = [None if object_poses is None else object_poses[i] for i in shown]
        self.cloud = np.concatenate([sample_cloud(solids, link_poses[i], thing) for i, thing in zip(shown, things)])
        self.view = _view(self.up, held.points, held.normals, _spread(solids, link_poses[at]), held.com)
        self.right = np.cross(self.up, self.view) / np.linalg.norm(np.cross(self.up, self.view))
        self.size = float(np.ptp(self.cloud, axis=0).max())

    @property
    def beside(self) -> Array:
        """Shift that places a second copy beside the scene (3,) [m]."""
        shift: Array = 1.15 * np.ptp(self.cloud @ self.right) * self.right
        return shift

    def add(self, shift: Array) -> None:
        """Include a second copy of the scene, moved by ``shift`` (3,) [m]."""
        self.cloud = np.concatenate([self.cloud, self.cloud + shift])

    @property
    def ground(self) -> float:
        """Height of the lowest point along ``up`` [m]."""
        return float((self.cloud @ self.up).min())

    def frame(self) -> tuple[Array, Array]:
        """Centre of the scene (3,), and half its size to the right, upwards and along the view (3,) [m]."""
        axes = np.stack([self.right, np.cross(self.view, self.right), self.view])
        seen = axes @ self.cloud.T
        low, high = seen.min(axis=1), seen.max(axis=1)
        return (low + high) / 2 @ axes, (high - low) / 2


def _view(up: Array, points: Array, normals: Array, samples: _Samples, com: Array) -> Array:
    """Unit direction (3,) towards the camera.

    The choice is among rings of directions. The hand should hide little around the contacts, and the normals should be
    seen from the side, where arrows and cones appear long.

    Args:
        up: direction against gravity (3,).
        points: of the contacts (k, 3) [m].
        normals: of the contacts (k, 3).
        samples: of the hand's surface.
        com: of the object (3,) [m].
    """
    on_hand, area = samples
    x, y = tangent_frame(up, np.zeros(3)).T[:2]
    turn, lift = (
        part.ravel()[:, None] for part in np.meshgrid(np.radians(np.arange(0, 360, 10)), np.radians([10.0, 22.0, 35.0]))
    )
    views = np.cos(lift) * (np.cos(turn) * x + np.sin(turn) * y) + np.sin(lift) * up
    targets = np.vstack([points, com])
    radius = 0.06 * np.ptp(on_hand, axis=0).max(initial=1e-3)
    hidden = np.empty(len(views))
    offset = on_hand[None] - targets[:, None]
    squares = (offset**2).sum(axis=2)
    for i, view in enumerate(views):
        depth = offset @ view
        aside = squares - depth**2
        # Half of a closed surface faces away, so it covers with half its area.
        covered = ((aside < radius**2) & (depth > 0.1 * radius)).sum(axis=1) * area / 2 / (np.pi * radius**2)
        hidden[i] = np.minimum(covered, 1.0).mean()
    along = ((views @ normals.T) ** 2).mean(axis=1)
    best: Array = views[(hidden + 0.35 * along + 0.3 * np.abs(lift[:, 0] - _ELEVATION)).argmin()]
    return best


class _Samples(NamedTuple):
    """Points spread evenly over the hand's surface (s, 3) [m], and the area for each [m^2]."""

    points: Array
    area: float


def _spread(solids: Sequence[Solid], link_poses: Array) -> _Samples:
    """Samples of the hand's surface."""
    triangles = [
        place_solid(solid, link_poses[solid.link])[solid.faces]
        for solid in solids
        if solid.link is not None and solid.look != "collision"
    ]
    corners = np.concatenate([np.zeros((0, 3, 3)), *triangles])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    if not area.sum() > 0:
        return _Samples(np.zeros((0, 3)), 0.0)
    rng = np.random.default_rng(0)
    chosen = corners[rng.choice(len(corners), _SAMPLES, p=area / area.sum())]
    weights = rng.dirichlet(np.ones(3), _SAMPLES)
    return _Samples(np.einsum("si,sij->sj", weights, chosen), float(area.sum() / _SAMPLES))


def choose_scale(size: float, largest: float) -> float:
    """Length of arrows [m/N] in a scene of this size [m] with this largest force [N]: 1, 2, 5 times a power of ten."""
    scale = _ARROW * size / max(largest, 1e-9)
    powers = 10.0 ** np.arange(-9, 10)
    nice = np.outer(powers, [1.0, 2.0, 5.0]).ravel()
    return float(nice[np.abs(np.log(nice / scale)).argmin()])
