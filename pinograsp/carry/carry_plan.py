"""A carry plan with its ways out: to pages, pictures and figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pinograsp.carry.record import CarryRecord
from pinograsp.showing import in_notebook
from pinograsp.viz.shown import Shown

if TYPE_CHECKING:
    from pinograsp.viz.scene import ViewScene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryPlan(CarryRecord, Shown):
    """The timing of a path with the contact forces and joint torques along it: see :class:`CarryRecord`."""

    __repr__ = CarryRecord.__repr__
    _repr_html_ = in_notebook

    def _make_scene(self) -> ViewScene:
        from pinograsp.carry.scene import carry_scene  # brings matplotlib

        return carry_scene(self)

    def _most_telling(self) -> float:
        return float(self.instants[self.squeeze.argmax()])

    def save_figures(self, folder: str | Path) -> list[Path]:
        """Write the figures as PNG into an existing folder; returns their paths. See :mod:`pinograsp.viz.carried`."""
        from pinograsp.viz.carried import save_carry_figures

        return save_carry_figures(self, folder)
