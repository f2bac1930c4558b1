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


def springs_with(name, **changed):
    """A call of the core for two grasps of three contacts and eight wrenches, with something changed."""
    n, k, d, m = 2, 3, 3, 8
    reactions = {
        "change": np.zeros((n, k, d, m)),
        "borne": np.zeros((n, m), bool),
        "counts": np.array([3, 2]),
        "rows": np.arange(n),
    }
    contacts = {"points": np.ones((n, k, 3)), "rotations": np.tile(np.eye(3), (n, k, 1, 1)), "counts": np.array([3, 2])}
    friction = {"round": 2, "limits": np.array([0.5, 0.5]), "facets": np.zeros((0, 2))}
    forces = {"local": np.ones((n, k, d))}
    given = {
        "react": {**contacts, "torsion": 0.0, "arms": np.ones(n), "wrenches": np.ones((6, m))},
        "find_offsets": {**friction, **forces, "shares": np.ones(n), "offsets": np.zeros((n, k))},
        "find_multiples": {**friction, **forces, "multiples": np.zeros((n, m))},
        "find_efforts": {
            **forces,
            "jacobians": np.ones((n, k, 6, 4)),
            "places": np.arange(n),
            "rotations": contacts["rotations"],
            "bias": np.zeros((n, 4)),
            "torques": np.zeros((n, 4)),
            "most": np.zeros((n, 4)),
        },
        "find_least_mu": {
            **contacts,
            "components": 3,
            "round": 2,
            "torsion": 0.0,
            "most": 2.0,
            "within": 0.01,
            "loads": np.ones((n, 6)),
            "low": np.zeros((n, k)),
            "high": np.ones((n, k)),
            "arms": np.ones(n),
            "least": np.zeros(n),
            "codes": np.zeros(n, dtype=np.int64),
        },
    }[name]
    if name != "find_least_mu":
        given = {**reactions, **given}
    if name == "react":
        del given["rows"]
    given |= changed
    getattr(core.load(), name)(given.pop("start", 0), given.pop("stop", n), **given)


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        *(
            (name, changed)
            for name in ("react", "find_offsets", "find_multiples", "find_efforts", "find_least_mu")
            for changed in ({"start": -1}, {"start": 2, "stop": 1}, {"stop": 3}, {"counts": np.array([3, 4])})
        ),
        *(
            (name, changed)
            for name in ("react", "find_offsets", "find_multiples", "find_efforts")
            for changed in (
                {"change": np.zeros((2, 3, 5, 8))},
                {"change": np.zeros((2, 3, 3, 9)), "borne": np.zeros((2, 9), bool)},
                {"borne": np.zeros((2, 7), bool)},
                {"counts": np.array([3])},
            )
        ),
        *(
            (name, changed)
            for name in ("find_offsets", "find_multiples")
            for changed in (
                {"rows": np.array([0, 2])},
                {"round": 3},
                {"limits": np.array([0.5, 0.0])},
                {"limits": np.array([0.5, np.nan])},
                {"facets": np.zeros((1, 3))},
                {"local": np.ones((2, 3, 4))},
            )
        ),
        ("react", {"wrenches": np.ones((5, 8))}),
        ("react", {"points": np.ones((2, 2, 3))}),
        ("react", {"whole": np.zeros((2, 3, 3, 8))}),
        (
            "react",
            {"whole": np.zeros((2, 3, 3, 4)), "whole_borne": np.zeros((2, 8), bool), "capacities": np.ones((2, 3))},
        ),
        ("find_offsets", {"shares": np.ones(1)}),
        ("find_offsets", {"offsets": np.zeros((2, 2))}),
        ("find_multiples", {"multiples": np.zeros((2, 7))}),
        ("find_efforts", {"places": np.array([0, 2])}),
        ("find_efforts", {"places": np.array([0])}),
        ("find_efforts", {"jacobians": np.ones((2, 3, 6, 3))}),
        ("find_efforts", {"most": np.zeros((2, 3))}),
        ("find_least_mu", {"most": 0.0}),
        ("find_least_mu", {"within": np.nan}),
        ("find_least_mu", {"round": 3}),
        ("find_least_mu", {"low": np.zeros((2, 4))}),
        ("find_least_mu", {"least": np.zeros(1)}),
    ],
)
def test_springs_refuse_arrays_that_do_not_go_together(name, changed):
    springs_with(name)
    with pytest.raises(ValueError):
        springs_with(name, **changed)
