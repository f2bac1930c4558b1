"""Values as viser takes them: sizes of arrows, quaternions, colours."""

from __future__ import annotations

from typing import TypedDict

from pinograsp.viz.scene_meshes import HEAD, WIDE, rgb


class ArrowSize(TypedDict):
    """Dimensions of an arrow [m], as viser names them."""

    shaft_radius: float
    head_radius: float
    head_length: float


def arrow_size(radius: float) -> ArrowSize:
    """An arrow whose shaft has a radius [m]."""
    return {"shaft_radius": radius, "head_radius": WIDE * radius, "head_length": HEAD * radius}


def colour(text: str) -> tuple[int, int, int]:
    """A colour such as ``#0072B2`` as viser takes it."""
    red, green, blue = rgb(text).tolist()
    return red, green, blue


def dark(text: str) -> tuple[int, int, int]:
    """The colour for viser's arrows, which would show it too bright: they take its values as linear."""
    red, green, blue = (round(255 * (value / 255) ** 2.2) for value in colour(text))
    return red, green, blue
