"""Figures of this package show themselves where a notebook or a page ends a cell with one."""

from __future__ import annotations

import io
import warnings
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from pinograsp.viz import figures


@pytest.mark.parametrize(
    "draw",
    [figures.joint_angles, figures.contact_forces, lambda plan: figures.joint_torques(plan, "thumb")],
)
def test_a_figure_shows_itself_as_a_picture(paper_plan, draw):
    """As IPython asks for it: a PNG that is not blank, of the figure's size."""
    figure = draw(paper_plan)
    assert isinstance(figure, Figure)
    shown = np.asarray(Image.open(io.BytesIO(figure._repr_png_())).convert("L"))
    width, height = figure.get_size_inches() * figure.dpi
    assert shown.shape == pytest.approx((height, width), abs=1) and np.ptp(shown) > 200


def test_names_that_the_font_lacks_are_drawn_without_a_warning(paper_plan):
    layout = paper_plan.layout
    named = replace(layout, joints=tuple(f"関節{i}" for i in range(len(layout.joints))))
    plan = replace(paper_plan, layout=named)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert figures.joint_torques(plan, "thumb")._repr_png_()
