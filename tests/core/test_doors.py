"""What the compiled core is set up with is checked at its door: sizes, ranges, indices, finite numbers."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp import core

if not core.is_installed():
    pytest.skip("the core is not compiled", allow_module_level=True)
FAIR = {
    "contacts": 3,
    "joints": 2,
    "arm": 0.03,
    "links": [(0, 0, 0), (1, 1, 1)],
    "limited": [0, 1],
    "couplings": 1,
    "coupling_rows": np.array([[1.0, -1.0]]),
    "coupled": np.array([0.0]),
    "borne": 0.1,
}


def loop_with(**changed):
    setup = core.load().OnlineSetup()
    for name, value in (FAIR | changed).items():
        setattr(setup, name, value)
    return core.load().Loop(setup)


# All that the records refuse is in checks.cpp.
@pytest.mark.parametrize(
    ("name", "value"), [("arm", np.nan), ("limited", [10**6]), ("coupling_rows", np.zeros((2, 2))), ("contacts", 0)]
)
def test_a_loop_names_what_it_cannot_be_set_up_with(name, value):
    loop_with()
    with pytest.raises(ValueError, match=f"^{name}$"):
        loop_with(**{name: value})


def test_a_grasp_names_what_it_cannot_be_set_up_with():
    setup = core.load().GraspSetup()
    with pytest.raises(ValueError, match="^k$"):
        core.load().Grasp(setup)
    with pytest.raises(TypeError):
        setup.k = "three"
    with pytest.raises(TypeError):
        setup.B = None


def test_a_loop_refuses_a_jacobian_without_the_columns_that_its_links_name():
    with pytest.raises(ValueError, match="jacobian"):
        loop_with().hand(np.zeros(6), np.zeros(2))


def test_a_multiplier_box_refuses_what_is_no_number():
    for changed in ({"H": np.full((6, 4), np.nan)}, {"eps": 0.0}, {"eps": np.nan}, {"fixed": np.full(6, np.inf)}):
        fair = {"H": np.ones((6, 4)), "eps": 1e-6, "fixed": np.zeros(6), "row": np.ones(6)}
        with pytest.raises(ValueError):
            core.load().Box(**fair | changed)
