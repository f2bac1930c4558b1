"""Where an object can be held between two surfaces that face each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinograsp.checks import brief
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, BoolArray

_STEPS = 40  # of a ray through the object
_FACING = np.cos(np.radians(25.0))  # of the angle between the line through a pair and either normal
_POINTS = 400  # surface points that are looked at
_BALL = 0.95  # of a ball's radius: what may be nearer than the two walls that it touches
_MIDDLE = 0.49  # of the way across, where its centre is looked at


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Pairs of surface points that face each other, in the world; those near the centre of mass first.

    Attributes:
        middles_o: between the two points (p, 3) [m].
        axes_o: unit directions (p, 3) from the first point into the object, to the second.
        widths: their distances (p,) [m].
        aside: distances of the middles from the centre of mass (p,) [m].
    """

    middles_o: Array
    axes_o: Array
    widths: Array
    aside: Array

    __repr__ = brief()

    @property
    def ends_o(self) -> tuple[Array, Array]:
        """The first and the second points (p, 3) [m]."""
        half = self.widths[:, None] / 2 * self.axes_o
        return self.middles_o - half, self.middles_o + half

    def select(self, which: BoolArray) -> Pairs:
        """Those for which ``which`` (p,) holds."""
        return Pairs(
            middles_o=self.middles_o[which],
            axes_o=self.axes_o[which],
            widths=self.widths[which],
            aside=self.aside[which],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """A part of an object.

    Attributes:
        lower: corner of a box along the axes of the object's own frame (3,) [m].
        upper: the opposite corner (3,) [m].
        pose: oMb (4, 4), the object's.
    """

    lower: Array
    upper: Array
    pose: Array

    @property
    def middle_o(self) -> Array:
        """In the world (3,) [m]."""
        middle: Array = self.pose[:3, :3] @ ((self.lower + self.upper) / 2) + self.pose[:3, 3]
        return middle

    def outside(self, points_o: Array) -> Array:
        """How far points (p, 3) of the world are outside (p,) [m]; 0: inside."""
        points = (points_o - self.pose[:3, 3]) @ self.pose[:3, :3]
        beyond: Array = np.linalg.norm(np.maximum(0.0, np.maximum(self.lower - points, points - self.upper)), axis=-1)
        return beyond

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random points inside, in the world (count, 3) [m]."""
        points: Array = rng.uniform(self.lower, self.upper, (count, 3)) @ self.pose[:3, :3].T + self.pose[:3, 3]
        return points


def find_pairs(
    body: Body, rng: np.random.Generator, region: Region | None = None, touched: Sequence[Region] = ()
) -> Pairs:
    """Pairs of an object: lines along the normals of random surface points, from there to the other side.

    ``region``: where both are; ``touched``: regions near which half of the points are drawn.

    Raises:
        InvalidInput: none of them is in the region.
    """
    radius = body.bounding_radius
    if region is None:
        directions = rng.normal(size=(_POINTS, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        # Half of the points from outside, half from within, where handles and other thin parts are met as often.
        away = np.where(np.arange(_POINTS) % 2 == 0, 1.5, 0.9 * rng.uniform(0.1, 1.0, _POINTS))
        start: Array = body.com_o + radius * away[:, None] * directions
        for i, part in enumerate(touched):
            start[2 * i + 1 :: 2 * len(touched)] = part.draw(rng, len(start[2 * i + 1 :: 2 * len(touched)]))
    else:
        start = region.draw(rng, _POINTS)
    first, axes, _ = body.project(start)
    keep = np.isfinite(axes).all(axis=1)
    first, axes = first[keep], axes[keep]
    second, left = _through(body, first, axes)
    widths = np.einsum("pi,pi->p", second - first, axes)
    keep = left & (widths > 1e-4)
    first, second, axes, widths = first[keep], second[keep], axes[keep], widths[keep]
    # Just inside: on an edge the faces' own normals count, not their mean.
    inside = np.minimum(1e-3 * radius, 0.1 * widths)[:, None] * axes
    _, one, _ = body.project(first + inside)
    _, other, _ = body.project(second - inside)
    keep = (np.einsum("pi,pi->p", axes, one) > _FACING) & (np.einsum("pi,pi->p", axes, -other) > _FACING)
    if region is not None:
        keep &= (region.outside(first) == 0) & (region.outside(second) == 0)
        if not keep.any():
            raise InvalidInput(
                "within: expected a box with opposed surfaces of the object in it, found none: its corners are lower "
                "and upper x, y, z in the object's own frame [m]"
            )
    first, second, axes, widths = first[keep], second[keep], axes[keep], widths[keep]
    middles = (first + second) / 2
    aside = np.linalg.norm(middles - body.com_o, axis=1)
    order = np.argsort(aside, kind="stable")
    return Pairs(middles_o=middles[order], axes_o=axes[order], widths=widths[order], aside=aside[order])


def _through(body: Body, points: Array, axes: Array) -> tuple[Array, BoolArray]:
    """Where rays (p, 3) from surface points (p, 3) into the object leave it, and which of them were followed to there.

    The steps are as long as the surface is far.
    Every second ray is followed from the far side instead: across a hollow the two are not the same.
    """
    radius = body.bounding_radius
    back = np.arange(len(points)) % 4 < 2
    along = np.where(back, 2.5 * radius, 1e-3 * radius)
    sign = np.where(back, -1.0, 1.0)
    moving = np.ones(len(points), dtype=bool)
    for _ in range(_STEPS):
        if not moving.any():
            break
        _, _, distance = body.project(points[moving] + along[moving, None] * axes[moving])
        left = np.abs(distance)
        along[moving] += sign[moving] * np.maximum(left, 1e-4 * radius)
        ended = np.where(back[moving], distance < 1e-4 * radius, distance > -1e-4 * radius)
        moving[moving] = ~ended
    return points + along[:, None] * axes, ~moving


def find_gap(body: Body, region: Region, rng: np.random.Generator) -> float:
    """How wide the widest opening at a part of an object is [m], as between a mug and its handle; 0: there is none.

    The diameter of the largest ball that touches the part and the object on its other side.
    """
    start, normals, _ = body.project(region.draw(rng, _POINTS))
    keep = np.isfinite(normals).all(axis=1) & (region.outside(start) == 0)
    start, out = start[keep], -normals[keep]
    radius = body.bounding_radius
    along, ended = np.full(len(start), 4e-3 * radius), np.zeros(len(start), dtype=bool)
    for _ in range(_STEPS):
        moving = ~ended & (along < 2 * radius)
        if not moving.any():
            break
        _, _, distance = body.project(start[moving] + along[moving, None] * out[moving])
        along[moving] += np.maximum(distance, 1e-4 * radius)
        ended[moving] = distance < 1e-3 * radius
    start, out, along = start[ended], out[ended], along[ended]
    if not len(along):
        return 0.0
    # A little off the middle, which two opposite sides may be equally near to.
    _, _, free = body.project(start + _MIDDLE * along[:, None] * out)
    across = free > _BALL * _MIDDLE * along
    return float(along[across].max(initial=0.0))
