"""What the compiled core is set up with is checked at its door: sizes, ranges, indices, finite numbers."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp import core

if not core.installed():
    pytest.skip("the core is not compiled", allow_module_level=True)
FAIR = {
    "contacts": 3,
    "components": 3,
    "round": 2,
    "rows": 6,
    "torsion": 0.0,
    "arm": 0.03,
    "safety": 1.0,
    "ramp": 1.0,
    "most_steps": 50,
    "most_rate": np.inf,
    "joints": 2,
    "links": np.array([[0, 0, 0], [1, 1, 1]]),
    "limited": [0, 1],
    "couplings": np.array([[1.0, -1.0]]),
    "coupled": [0.0],
    "borne": 0.1,
}
UNFAIR = {
    "contacts": [0, -1, 2**31 - 1],
    "components": [0, 5],
    "round": [1, 3],
    "torsion": [-1.0, np.nan, np.inf, 1e300],
    "arm": [0.0, -1.0, np.nan, np.inf, 1e-300],
    "safety": [0.0, -1.0, np.nan, np.inf],
    "ramp": [0.0, -1.0, 2.0, np.nan],
    "most_steps": [0, -5, 2**31 - 1],
    "most_rate": [-1.0, np.nan],
    "joints": [-1, 1, 2**31 - 1],
    "links": [np.array([[3, 0, 0]]), np.array([[0, 0, 2]]), np.array([[1, 0, 0], [0, 0, 0]]), np.array([[0, -1, 0]])],
    "limited": [[10**6], [-1], [0, 0], [2]],
    "couplings": [np.zeros((1, 3)), np.array([[np.nan, 1.0]]), np.zeros((2, 2))],
    "coupled": [[np.inf], [0.0, 0.0], []],
    "borne": [-0.1, 1.5, np.nan],
}


@pytest.mark.parametrize("name", UNFAIR)
def test_a_loop_refuses_what_it_cannot_be_set_up_with(name):
    core.load().Loop(**FAIR)
    for value in UNFAIR[name]:
        with pytest.raises(ValueError):
            core.load().Loop(**FAIR | {name: value})


def test_a_loop_refuses_a_jacobian_without_the_columns_that_its_links_name():
    loop = core.load().Loop(**FAIR)
    with pytest.raises(ValueError, match="jacobian"):
        loop.hand(np.zeros(6), np.zeros(2))


def test_a_multiplier_box_refuses_what_is_no_number():
    for changed in ({"H": np.full((6, 4), np.nan)}, {"eps": 0.0}, {"eps": np.nan}, {"fixed": np.full(6, np.inf)}):
        fair = {"H": np.ones((6, 4)), "eps": 1e-6, "fixed": np.zeros(6), "row": np.ones(6)}
        with pytest.raises(ValueError):
            core.load().Box(**fair | changed)
