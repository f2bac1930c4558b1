"""Objects whose size hints at other units than metres say so, however they were made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg

SHAPES = {
    "sphere": lambda k: pg.Sphere(radius=0.03 * k, mass=0.2),
    "cylinder": lambda k: pg.Cylinder(radius=0.02 * k, height=0.12 * k, mass=0.2),
    "capsule": lambda k: pg.Capsule(radius=0.015 * k, length=0.06 * k, mass=0.2),
    "box": lambda k: pg.Box(size=(0.03 * k, 0.04 * k, 0.08 * k), mass=0.2),
    "ellipsoid": lambda k: pg.Ellipsoid(semi_axes=(0.02 * k, 0.03 * k, 0.04 * k), mass=0.2),
    "text": lambda k: pg.object_from(f"box:size={0.03 * k}x{0.04 * k}x{0.08 * k},mass=0.1"),
    "mesh": lambda k: pg.Mesh(
        vertices=0.05 * k * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        mass=0.2,
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_millimetres_read_as_metres_are_told_with_the_factor(name):
    assert SHAPES[name](1.0).notes == ()
    for factor, cure in ((1000.0, "0.001"), (1e-3, "1000")):
        (note,) = SHAPES[name](factor).notes
        assert cure in note and "units" in note


def test_a_note_goes_with_its_size():
    huge = pg.Sphere(radius=30, mass=0.2)
    assert huge.placed(np.eye(4)).notes == huge.notes == replace(huge, density=None).notes
    assert replace(huge, radius=0.03, density=None).notes == ()
