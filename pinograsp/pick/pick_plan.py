"""A plan that takes an object from where it stands to where it is to go, with its ways out: pages and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinograsp.pick.record import PickRecord
from pinograsp.viz.shown import Shown

if TYPE_CHECKING:
    from pinograsp.viz.scene import ViewScene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickPlan(PickRecord, Shown):
    """A plan of arm and hand from their start to the object, with it to its place, and back: see
    :class:`PickRecord`.
    """

    __repr__ = PickRecord.__repr__

    def _make_scene(self) -> ViewScene:
        from pinograsp.pick.scene import pick_scene  # brings matplotlib

        return pick_scene(self)

    def _most_telling(self) -> float:
        """The middle of the way with the object."""
        before = sum(phase.duration for phase in self.phases[:2])
        return before + self.phases[2].duration / 2.0
