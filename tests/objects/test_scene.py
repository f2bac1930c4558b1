"""What stands around a robot."""

from __future__ import annotations

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput


def test_a_table_has_its_top_where_it_is_said():
    scene = pg.Scene.on_table(0.7, size=(1.0, 0.6), at=(0.4, 0.1))
    (table,) = scene.obstacles.values()
    np.testing.assert_allclose(table.pose[:3, 3], [0.4, 0.1, 0.68])
    np.testing.assert_allclose(table.size, [1.0, 0.6, 0.04])
    more = scene.with_obstacle("ball", pg.Sphere(radius=0.1, mass=1.0)).with_box("box", (0.1, 0.1, 0.1), at=(0, 0, 1))
    assert list(more.obstacles) == ["table", "ball", "box"] and list(scene.obstacles) == ["table"]


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: pg.Scene(obstacles={"a": "box"}), "obstacle 'a'"),
        (lambda: pg.Scene(obstacles={"": pg.Sphere(radius=0.1, mass=1.0)}), "name of an obstacle"),
        (lambda: pg.Scene(clearance=-0.1), "clearance"),
        (lambda: pg.Scene.on_table().with_box("table", (1, 1, 1), at=(0, 0, 0)), "a new name"),
        (lambda: pg.Scene().with_box("a", (1, 1), at=(0, 0, 0)), "size"),
        (lambda: pg.Scene.on_table(float("nan")), "height"),
    ],
)
def test_unusable_scenes_are_refused(make, told):
    with pytest.raises(InvalidInput, match=told):
        make()
