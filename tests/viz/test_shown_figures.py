"""Figures of this package show themselves where a notebook or a page ends a cell with one."""

from __future__ import annotations

import base64
import io
import warnings
from dataclasses import replace

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from matplotlib.figure import Figure
from PIL import Image

from pinograsp.viz import figures


def picture(figure) -> bytes:
    """What IPython shows of it."""
    shown = DisplayFormatter().format(figure)[0]["image/png"]
    return base64.b64decode(shown) if isinstance(shown, str) else shown


@pytest.mark.parametrize(
    "draw",
    [figures.joint_angles, figures.contact_forces, lambda plan: figures.joint_torques(plan, "thumb")],
)
def test_a_figure_shows_itself_as_a_picture(paper_plan, draw):
    """A PNG that is not blank, of the figure's size."""
    figure = draw(paper_plan)
    assert isinstance(figure, Figure)
    shown = np.asarray(Image.open(io.BytesIO(picture(figure))).convert("L"))
    width, height = figure.get_size_inches() * figure.dpi
    assert shown.shape == pytest.approx((height, width), abs=1) and np.ptp(shown) > 200


def test_names_that_the_font_lacks_are_drawn_without_a_warning(paper_plan):
    layout = paper_plan.layout
    named = replace(layout, joints=tuple(f"関節{i}" for i in range(len(layout.joints))))
    plan = replace(paper_plan, layout=named)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert picture(figures.joint_torques(plan, "thumb"))


@pytest.mark.parametrize("length", [5, 25, 38])
def test_no_text_runs_into_another_panel_or_out_of_the_figure(paper_plan, length):
    """Names of contacts are those of links and may be long; each panel with its numbers and names has its own place."""
    names = tuple(f"{name}/{'link' * 10}"[:length] for name in paper_plan.contacts.names)
    figure = figures.contact_forces(replace(paper_plan, contacts=replace(paper_plan.contacts, names=names)))
    figure.savefig(io.BytesIO(), format="png")
    inside = figure.bbox
    boxes = [
        [axes.get_legend().get_window_extent(), axes.xaxis.get_tightbbox(), axes.yaxis.get_tightbbox()]
        for axes in figure.axes
    ]
    for box in (box for panel in boxes for box in panel):
        assert box.x0 >= inside.x0 and box.x1 <= inside.x1 and box.y0 >= inside.y0 and box.y1 <= inside.y1
    assert max(box.x1 for box in boxes[0]) <= min(box.x0 for box in boxes[1])
    for axes, (legend, *_) in zip(figure.axes, boxes):
        assert legend.y0 >= axes.bbox.y1 and axes.bbox.width > 0.25 * inside.width
