"""A carry plan with its ways out: to pages, pictures and figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from pinograsp.carry.record import CarryRecord
from pinograsp.showing import in_notebook
from pinograsp.writing import write_file

if TYPE_CHECKING:
    from pinograsp.viz.scene import ViewScene
    from pinograsp.viz.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryPlan(CarryRecord):
    """A timing of a path with the contact forces and joint torques on the way: see :class:`CarryRecord`."""

    __repr__ = CarryRecord.__repr__
    _repr_html_ = in_notebook

    def _make_scene(self) -> ViewScene:
        from pinograsp.carry.scene import carry_scene  # brings matplotlib

        return carry_scene(self)

    def show(self, *, port: int = 8080, open_browser: bool = True) -> Viewer:
        """Open a live page on which the arm moves and the hand holds; see :func:`pinograsp.viz.viewer.view`."""
        from pinograsp.viz.viewer import open_viewer

        return open_viewer(self._make_scene(), port=port, open_browser=open_browser)

    def save_html(self, path: str | Path) -> Path:
        """Write such a page as one file that needs no server and no network; returns its path."""
        from pinograsp.viz.page import render_page

        return write_file(path, render_page(self._make_scene()).encode())

    def picture(self, path: str | Path, *, time: float | None = None, view: ArrayLike | None = None) -> Path:
        """Write a picture of arm, object and forces; returns its path.

        Args:
            path: .png, or .svg or .pdf for print; an existing file is overwritten.
            time: of the plan [s]; None: when the hand squeezes hardest.
            view: in the robot's world, as for :func:`pinograsp.viz.still.picture`.
        """
        from pinograsp.viz.still import write_picture

        when = float(self.instants[self.squeeze.argmax()]) if time is None else time
        return write_picture(self._make_scene(), path, when, view=view)

    def film(
        self,
        path: str | Path,
        *,
        view: ArrayLike | None = None,
        seconds: float = 4.0,
        progress: bool | None = None,
    ) -> Path:
        """Write a moving picture, .gif or .mp4: the arm carries the object; returns its path.

        Args:
            path: an existing file is overwritten.
            view, seconds, progress: as for :func:`pinograsp.viz.film.write_film`.
        """
        from pinograsp.viz.film import write_film

        return write_film(self._make_scene(), path, view=view, seconds=seconds, progress=progress)

    def save_figures(self, folder: str | Path) -> list[Path]:
        """Write the figures as PNG into an existing folder; returns their paths. See :mod:`pinograsp.viz.carried`."""
        from pinograsp.viz.carried import save_carry_figures

        return save_carry_figures(self, folder)
