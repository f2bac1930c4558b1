"""Arrows as vector graphics: the outlines of their solids."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull, QhullError

from pinograsp.spatial import Array, BoolArray
from pinograsp.viz.scene_meshes import WIDE, ball, rgb, span_arrow

# Places (n, 3) [m] to pixels across and down, and the inverse of the depth (n, 3); and which of them are hidden (n,).
Project: TypeAlias = Callable[[Array], Array]
Hidden: TypeAlias = Callable[[Array], BoolArray]

_PIECES = 40  # along a shaft, of which each is seen or hidden
_AROUND = 24  # corners of a circle
_LIGHT = (0.45, 0.35)  # a brighter strip: its width and how far it is off the middle, over the shaft's radius


def draw_ball(
    axes: Axes, project: Project, hidden: Hidden, centre: Array, radius: float, colour: str, pale: float
) -> None:
    """A ball, of opacity ``pale`` where it is hidden."""
    _fill(axes, project(radius * ball()[0] + centre)[:, :2], colour, pale if hidden(centre[None])[0] else 1.0)


def draw_arrow(
    axes: Axes, project: Project, hidden: Hidden, ends: Array, width: float, colour: str, pale: float
) -> None:
    """An arrow between two places (2, 3) [m] with a shaft of radius ``width``, its hidden parts of opacity ``pale``."""
    if (span := span_arrow(ends[1] - ends[0], width)) is None:
        return
    (x, y, z), length, tip = span
    angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)[:, None]
    circle = np.cos(angle) * x + np.sin(angle) * y
    cuts = np.linspace(0.0, length - tip, _PIECES + 1)
    behind = hidden(ends[0] + np.outer((cuts[1:] + cuts[:-1]) / 2, z))
    head = np.vstack([WIDE * width * circle + ends[0] + (length - tip) * z, ends[1]])
    parts = [(head, bool(hidden((ends[0] + (length - 0.7 * tip) * z)[None])[0]), False)]
    first = np.flatnonzero(np.r_[True, behind[1:] != behind[:-1]])
    for start, stop in zip(first, [*first[1:], _PIECES]):
        rims = [width * circle + ends[0] + cut * z for cut in (cuts[start], cuts[stop])]
        parts.append((np.vstack(rims), bool(behind[start]), True))
    parts.sort(key=lambda part: project(part[0])[:, 2].mean())
    for corners, is_hidden, round_ in parts:
        flat = project(corners)[:, :2]
        _fill(axes, flat, colour, pale if is_hidden else 1.0)
        if round_ and not is_hidden:
            _shine(axes, flat, colour)


def _shine(axes: Axes, flat: Array, colour: str) -> None:
    """A brighter strip along a shaft (2 * corners, 2), on its upper side."""
    start, stop = flat[:_AROUND].mean(axis=0), flat[_AROUND:].mean(axis=0)
    along = stop - start
    if np.linalg.norm(along) < 1e-9:
        return
    across = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    across *= -1.0 if across[1] > 0 else 1.0  # pixels count downwards
    share, off = _LIGHT
    radius = [
        np.abs((rim - middle) @ across).max() for rim, middle in ((flat[:_AROUND], start), (flat[_AROUND:], stop))
    ]
    strip = [
        middle + r * (off + side * share / 2) * across
        for middle, r, sides in ((start, radius[0], (1, -1)), (stop, radius[1], (-1, 1)))
        for side in sides
    ]
    bright = tuple(0.6 * rgb(colour) / 255 + 0.4)
    axes.add_patch(Polygon(strip, facecolor=bright, edgecolor="none", linewidth=0.0))


def _fill(axes: Axes, places: Array, colour: str, opacity: float) -> None:
    """The outline of the places (n, 2), filled."""
    try:
        outline = places[ConvexHull(places).vertices]
    except QhullError:  # all on a line
        return
    # Darker at the edge, as round things are.
    edge = tuple(0.7 * rgb(colour) / 255)
    axes.add_patch(Polygon(outline, facecolor=colour, edgecolor=edge, linewidth=0.35, alpha=opacity))
