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
