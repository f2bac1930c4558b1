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


def test_an_approach_refuses_joints_that_are_not_there_and_what_is_no_number():
    way = core.load().Approach(touch=1e-7, creep=1e-5, near=1e-6)
    frame, corners = np.eye(4), np.zeros((8, 3))
    with pytest.raises(ValueError, match="margins"):
        core.load().Approach(touch=0.0, creep=1e-5, near=1e-6)
    with pytest.raises(ValueError, match="joint"):
        way.add_joint(0, 0, frame, np.zeros(6))
    with pytest.raises(ValueError, match="frame"):
        way.add_joint(-1, 0, np.full((4, 4), np.nan), np.zeros(6))
    with pytest.raises(ValueError, match="points"):
        way.add_part(-1, frame, corners, np.zeros(4), np.zeros(3))
    way.add_joint(-1, 3, frame, np.zeros(6))
    with pytest.raises(ValueError, match="q, rate"):
        way.pursue(0.0, 1.0, np.zeros(3), np.zeros(3), frame, np.zeros((7, 0)), 9)
    way.add_part(0, frame, corners, np.zeros((1, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="known"):
        way.pursue(0.0, 1.0, np.zeros(4), np.zeros(4), frame, np.zeros((7, 2)), 9)
