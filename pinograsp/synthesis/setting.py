"""What keeps hands from places where they would hold an object: what stands around it, or an arm that is too short."""

from __future__ import annotations

from typing import Protocol

from pinograsp.contacts.clearance import clearance
from pinograsp.hands import HandModel
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

REFUSED = "no place for the open hand"  # the outcome of samples, with the reason in brackets


class Setting(Protocol):
    """Where a hand can be."""

    def refuse(self, hand: HandModel, q: Array) -> str:
        """Why a hand cannot be where it is placed, with joints at q (n,); "": it can."""
        ...


class Surroundings:
    """The setting of a hand without an arm: it keeps its distance from obstacles, and does not reach into supports."""

    def __init__(self, scene: Scene, body: Body):
        supports = scene.find_supports(body)
        self._margins = {name: 0.0 if name in supports else scene.clearance for name in scene.obstacles}
        self._obstacles = scene.obstacles

    def refuse(self, hand: HandModel, q: Array) -> str:
        """Why a hand cannot be where it is placed: the obstacle that is in its way."""
        for name, margin in self._margins.items():
            if clearance(hand, self._obstacles[name], q) < margin:
                return f"hit {name}"
        return ""
