"""Colours and names as figures show them, and their files."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.transforms import BboxBase

from pinograsp.processes import count_few, forked_results
from pinograsp.words import printable

# Okabe-Ito colours, which colour-blind readers can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_FINGERS = COLOURS[:6]  # black is the load
# Fingers of these names have the same colour in every figure of every hand.
_KNOWN = {"thumb": 0, "index": 1, "middle": 2, "ring": 3, "little": 4, "pinky": 4, "palm": 5}
_PAD = 0.04  # between panels and what is around them [inch]
_LETTER, _ENTRY = 0.064, 0.53  # width of a letter of legends, and of what is beside a name [inch]
_NUMBERS = 7  # intervals of an axis


class PanelLayout(LayoutEngine):
    """Makes room for what panels have around them: numbers, names of axes, notes, and legends above.

    In one pass, since :func:`grid` fixes how many numbers an axis has: Matplotlib's own engines take two, and look
    at each curve, which takes as long as the drawing.
    """

    _adjust_compatible = True
    _colorbar_gridspec = True

    def execute(self, fig: Figure) -> None:
        """Place the panels of a figure, which are one of its grids."""
        room: dict[str, Counter[int]] = {side: Counter() for side in ("left", "right", "bottom", "top")}
        for axes in fig.axes:
            place, inner = axes.get_subplotspec(), axes.bbox
            if place is None:
                continue
            beside = [axes.xaxis, axes.yaxis, *([legend] if (legend := axes.get_legend()) else [])]
            boxes = [box for one in beside if axes.axison and (box := one.get_tightbbox()) is not None]
            sides = (
                ("left", place.colspan.start, [inner.x0 - box.x0 for box in boxes]),
                ("right", place.colspan.stop, [box.x1 - inner.x1 for box in boxes]),
                ("top", place.rowspan.start, [box.y1 - inner.y1 for box in [*boxes, *_above(axes)]]),
                ("bottom", place.rowspan.stop, [inner.y0 - box.y0 for box in boxes]),
            )
            for side, at, needs in sides:
                room[side][at] = max([room[side][at], *needs])
        pad = _PAD * fig.dpi
        across = _divide(room["left"], room["right"], pad, fig.bbox.width)
        down = _divide(room["top"], room["bottom"], pad, fig.bbox.height)
        if across and down:
            (left, right, wide), (top, bottom, high) = across, down
            fig.subplots_adjust(left=left, right=right, wspace=wide, top=1 - top, bottom=1 - bottom, hspace=high)


class GridLines(LineCollection):
    """Lines at the numbers of both axes, as one artist: Matplotlib's own grid has several for each number."""

    def draw(self, renderer: RendererBase) -> None:
        """Draw them where the numbers are by now."""
        if (axes := self.axes) is not None:
            (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
            upright = [[(x, low), (x, high)] for x in axes.get_xticks() if min(left, right) <= x <= max(left, right)]
            level = [[(left, y), (right, y)] for y in axes.get_yticks() if min(low, high) <= y <= max(low, high)]
            self.set_segments([*upright, *level])
        super().draw(renderer)


def _above(axes: Axes) -> list[BboxBase]:
    """Boxes of texts that begin above the panel."""
    boxes = [text.get_window_extent() for text in axes.texts]
    return [box for box in boxes if box.y0 >= axes.bbox.y1]


def _divide(before: Counter[int], after: Counter[int], pad: float, length: float) -> tuple[float, float, float] | None:
    """Where the first panel begins and the last one ends, over the figure's length, and what is between two, over their
    own; None where there is no room.

    Args:
        before: room that panels need before them, by the place in the grid where they begin.
        after: and after them, by where they end.
        pad: room between two, and twice that to the figure's edges.
        length: of the figure.
    """
    count = max(after, default=0)
    start, end = before[0] + pad, after[count] + pad
    gap = max((before[i] + after[i] + 2 * pad for i in range(1, count)), default=0.0)
    own = (length - start - end - (count - 1) * gap) / max(count, 1)
    return (start / length, 1 - end / length, gap / own) if own > 0 else None


class NotebookFigure(Figure):
    """A figure that notebooks, and pages made of them, show by itself, without pyplot.

    It is drawn without warnings of names in scripts that the font lacks and of panels too small for their labels, about
    which nobody can do anything.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        FigureCanvasAgg(self)

    def savefig(self, *args: Any, **options: Any) -> None:
        """As Matplotlib's, laid out and drawn once: with a layout engine Matplotlib does either twice."""
        engine, dpi, asked = self.get_layout_engine(), self.dpi, options.get("dpi")
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=UserWarning)
            if engine is not None:
                self.set_dpi(asked if isinstance(asked, int | float) else dpi)  # text is not quite as wide at another
                engine.execute(self)
                with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
                    self.set_layout_engine(None)
            try:
                super().savefig(*args, **options)
            finally:
                self.set_dpi(dpi)
                if engine is not None:
                    self.set_layout_engine(engine)

    def _repr_png_(self) -> bytes:
        return encode_figure(self, "png")


SUFFIXES = (".png", ".svg", ".pdf")  # of pictures


def make_label(name: str) -> str:
    """A name from a file as Matplotlib's text: short, without formulas, and never hidden from a legend."""
    name = printable(name, 40).replace("$", r"\$")
    return f" {name}" if name.startswith("_") or not name else name


def finger_of(contact: str) -> str:
    """The finger that a contact belongs to, or the contact itself where it was given by itself."""
    return contact.split("/")[0]


def finger_colours(contacts: Sequence[str], others: Sequence[str] = ()) -> dict[str, str]:
    """A colour for every one of these contacts, that of its finger, and for every one of ``others``, fingers that need
    not touch.
    """
    names = [*contacts, *others]
    touching = sorted({finger_of(name) for name in contacts})
    fingers = [*touching, *sorted({finger_of(name) for name in others} - set(touching))]
    found: dict[str, str] = {}
    for finger in fingers:
        place = next((i for word, i in _KNOWN.items() if word in finger.lower()), None)
        if place is not None and _FINGERS[place] not in found.values():
            found[finger] = _FINGERS[place]
    free = cycle([colour for colour in _FINGERS if colour not in found.values()] or _FINGERS)
    found |= {finger: next(free) for finger in fingers if finger not in found}
    return {name: found[finger_of(name)] for name in names}


def contact_colours(contacts: Sequence[str], fingers: Iterable[str] = ()) -> tuple[str, ...]:
    """Colours of contacts (k,); ``fingers``: of the hand."""
    colours = finger_colours(contacts, list(fingers))
    return tuple(colours[name] for name in contacts)


def ranks(colours: Sequence[str]) -> list[int]:
    """How many before each have the same colour (k,): contacts of a finger differ in their lines."""
    return [list(colours[:i]).count(colour) for i, colour in enumerate(colours)]


def shades(colour: str, count: int) -> list[tuple[float, ...]]:
    """Shades of a colour for the joints of a finger, from base to tip: dark to light."""
    mixes = np.linspace(-0.45, 0.4, count) if count > 1 else np.zeros(1)
    base = np.array(to_rgb(colour))
    return [tuple((1 - mix) * base + mix if mix > 0 else (1 + mix) * base) for mix in mixes.tolist()]


def grid(axes: Axes) -> None:
    """Thin lines, and few numbers, as they are: no offset that is added to them, and no factor."""
    axes.locator_params(nbins=_NUMBERS)
    axes.add_collection(
        GridLines([], colors=mpl.rcParams["grid.color"], alpha=0.3, linewidths=0.5, zorder=1.5), autolim=False
    )
    axes.ticklabel_format(useOffset=False, style="plain")


def legend_above(axes: Axes, columns: int, title: str | None = None, colour: str = "black") -> None:
    """Clear of the curves, in at most so many columns as have room; ``colour``: of the title."""
    figure, place = axes.get_figure(root=True), axes.get_subplotspec()
    room = 0.0 if figure is None else figure.get_figwidth() / (1 if place is None else place.get_gridspec().ncols)
    names = axes.get_legend_handles_labels()[1]
    while (
        columns > 1
        and sum(_ENTRY + _LETTER * max(map(len, some), default=0) for some in np.array_split(names, columns)) > room
    ):
        columns -= 1
    legend = axes.legend(
        fontsize=8,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        frameon=False,
        title=title,
        title_fontsize=8,
        alignment="left",
    )
    legend.get_title().set(color=colour, fontweight="bold")


def encode_figure(figure: Figure, kind: str = "png") -> bytes:
    """A picture as the content of a file: png, svg or pdf, the same bytes for the same picture."""
    content = io.BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    # Type 42: letters stay letters, as journals ask for.
    with mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "pinograsp"}):
        figure.savefig(content, format=kind, dpi=figure.dpi, metadata=undated)
    return content.getvalue()


def save_all(figures: Mapping[str, Callable[[], Figure]], folder: str | Path) -> list[Path]:
    """Draw figures, by the names of their files, and write them into an existing folder, several side by side; returns
    their paths.
    """
    paths = [Path(folder) / name for name in figures]
    with forked_results(_save, list(zip(figures.values(), paths)), count_few()) as saved:
        return list(saved)


def _save(draw: Callable[[], Figure], path: Path) -> Path:
    draw().savefig(path, dpi=130, pil_kwargs={"compress_level": 3})
    return path
