"""What plans that move an arm have in common: pages, pictures and films of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from pinograsp.writing import write_file

if TYPE_CHECKING:
    from pinograsp.viz.scene import ViewScene
    from pinograsp.viz.viewer import Viewer


class Shown:
    """A plan that moves, as it is looked at."""

    __slots__ = ()

    def _make_scene(self) -> ViewScene:
        """The plan at every instant."""
        raise NotImplementedError

    def _most_telling(self) -> float:
        """When a picture is taken that is not told when [s]."""
        raise NotImplementedError

    def show(self, *, port: int = 8080, open_browser: bool = True) -> Viewer:
        """Open a live page on which the arm moves and the hand holds; see :func:`pinograsp.viz.viewer.view`."""
        from pinograsp.viz.viewer import open_viewer

        return open_viewer(self._make_scene(), port=port, open_browser=open_browser)

    def save_html(self, path: str | Path) -> Path:
        """Write such a page as one file that needs no server and no network; returns its path."""
        from pinograsp.viz.page import render_page

        return write_file(path, render_page(self._make_scene()).encode())

    def save_rerun(self, path: str | Path) -> Path:
        """Write a recording for the Rerun viewer, .rrd: see :func:`~pinograsp.viz.rerun_file.write_rerun`."""
        from pinograsp.viz.rerun_file import write_rerun

        return write_rerun(self._make_scene(), path)

    def picture(self, path: str | Path, *, time: float | None = None, view: ArrayLike | None = None) -> Path:
        """Write a picture of arm, object and forces; returns its path.

        Args:
            path: .png, or .svg or .pdf for print; an existing file is overwritten.
            time: of the plan [s]; None: when the hand squeezes hardest.
            view: in the robot's world, as for :func:`pinograsp.viz.still.picture`.
        """
        from pinograsp.viz.still import write_picture

        return write_picture(self._make_scene(), path, self._most_telling() if time is None else time, view=view)

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
