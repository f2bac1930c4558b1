"""A table under the object: it stands there freely until the hand carries it, so that a hit on the way moves it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import hull_of, hull_points
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, cross, inverse_of

_SINK = 1e-4  # [m] by which the object sinks in under its weight
_NEAR = 1e-3  # [m] above its lowest point that still bear it
_AROUND, _TILT = 16, 0.3  # directions beside the one downwards, and their angle to it [rad]
_FAR = 10.0  # radii of the object: where points are whose nearest ones may bear it
_CREEP = 5e-3  # [m/s] below which friction grows with the speed


class Table:
    """A plane across gravity under the lowest points of an object, with springs, dampers and friction at its points.

    Only the object meets it: the hand passes through.
    """

    def __init__(self, body: Body, pose: Array, gravity_o: Array, mass: float, mu: float, time_step: float):
        """The table under an object, its shape at a pose oMs (4, 4); :class:`InvalidInput` where it would not stand."""
        size = float(np.linalg.norm(gravity_o))
        if size == 0:
            raise InvalidInput("support 'table': expected gravity, got none: without it nothing lies on a table")
        self.up: Array = -gravity_o / size
        self.body = body.placed(inverse_of(body.shape_b))
        self.corners, self.below = _corners(body), _below(body, self.up)
        arms = self._arms(pose)
        heights = (arms + pose[:3, 3]) @ self.up
        self.height = float(heights.min()) + _SINK
        _check_standing(arms[heights < heights.min() + _NEAR], self.up)
        depths = np.maximum(self.height - heights, 0.0)
        self.stiffness = mass * size / float(depths.sum())
        self.damping = 2 * np.sqrt(self.stiffness * mass / np.count_nonzero(depths))
        self.mu, self.creep = mu, max(_CREEP, 4 * mu * size * time_step)

    def wrench(self, pose: Array, twist: Array) -> Array:
        """On the object (6,) about its centre of mass [N, N m], at a pose oMs (4, 4) and a twist (6,)."""
        arms = self._arms(pose)
        depth = self.height - (arms + pose[:3, 3]) @ self.up
        arms, depth = arms[depth > 0], depth[depth > 0]
        speed = twist[:3] + cross(twist[3:], arms)
        rising = speed @ self.up
        normal = np.maximum(self.stiffness * depth - self.damping * rising, 0.0)
        across = speed - rising[:, None] * self.up
        slowed = self.mu * normal / np.maximum(np.linalg.norm(across, axis=1), self.creep)
        forces = normal[:, None] * self.up - slowed[:, None] * across
        return np.concatenate([forces.sum(axis=0), cross(arms, forces).sum(axis=0)])

    def _arms(self, pose: Array) -> Array:
        """Points (p, 3) that may bear the object at a pose oMs (4, 4), from its centre of mass, world axes."""
        corners = self.corners
        if corners is None:
            corners = np.unique(self.body.project(self.below @ pose[:3, :3])[0].round(9), axis=0)
        arms: Array = corners @ pose[:3, :3].T
        return arms


def _corners(body: Body) -> Array | None:
    """The corners (p, 3) of a mesh's hull in the shape's own frame; None for other shapes."""
    geometry = body.collision_geometry
    return None if hull_of(geometry) is None else hull_points(geometry)


def _below(body: Body, up: Array) -> Array:
    """Points (p, 3) far below the object, from its centre of mass: what bears it is nearest to one of them."""
    across = tangents(up[None])[0].T
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    beside = np.column_stack([np.cos(turn), np.sin(turn)]) @ across
    below: Array = _FAR * body.bounding_radius * np.vstack([-up, np.sin(_TILT) * beside - np.cos(_TILT) * up])
    return below


def _check_standing(arms: Array, up: Array) -> None:
    """Raise :class:`InvalidInput` where the centre of mass is not above the points that bear the object (p, 3)."""
    flat = arms @ tangents(up[None])[0]
    try:
        beside = float(ConvexHull(flat).equations[:, 2].max())
    except (QhullError, ValueError):  # one point or one edge
        beside = float(np.linalg.norm(flat.mean(axis=0)))
    if beside > _NEAR:
        raise InvalidInput(
            "support 'table': expected an object that stands by itself in its pose and under this gravity, but its "
            f"centre of mass is {1e3 * beside:.3g} mm beside the points that it would stand on: turn the object "
            "(and plan again), or take support='fixed'"
        )
