"""Jaws that slide: their joints' frames may be anywhere along them."""

import numpy as np
import pytest
from own_hands import joint, link, robot

from pinograsp import Box, GraspConditions, find_grasps, load_hand
from pinograsp.synthesis.preshapes import preshapes


def jaws(folder, along):
    """Two jaws of 7 cm, their joints' frames so far from their inner ends [m]."""
    parts = [link("palm", 0.5, "box 0.12 0.05 0.04", "0 0 -0.02")]
    for side, sign in (("left", 1), ("right", -1)):
        middle = f"{sign * 0.007} 0 {0.035 - along}"
        parts += [
            link(f"{side}_jaw", 0.06, "box 0.014 0.02 0.07", middle),
            joint(
                f"{side}_slide", "palm", f"{side}_jaw", f"0 0 {along}", f"{sign} 0 0", "0 0.04 60 0.1", kind="prismatic"
            ),
        ]
    path = folder / f"jaws{along}.urdf"
    path.write_text(robot("jaws", *parts), encoding="utf-8")
    return load_hand(path)


@pytest.mark.parametrize("along", [0.035, 0.06, 0.075])
def test_jaws_reach_out_of_the_palm_wherever_their_joints_are(tmp_path, along):
    found, usual = (preshapes(jaws(tmp_path, at), np.random.default_rng(0)) for at in (along, 0.0))
    assert len(found) == len(usual)
    found, usual = (sorted(shapes, key=lambda one: one.width) for shapes in (found, usual))
    for one, other in zip(found, usual):
        np.testing.assert_allclose(one.centre_h, other.centre_h, atol=1e-9)
        np.testing.assert_allclose(one.out_h, [0, 0, 1], atol=1e-9)
        assert one.depth == pytest.approx(other.depth, abs=1e-9)


@pytest.mark.parametrize("along", [0.0, 0.07])
def test_grasps_are_found_wherever_the_joints_are(tmp_path, along):
    hand = jaws(tmp_path, along)
    box = Box(size=(0.03, 0.03, 0.08), mass=0.1)
    search = find_grasps(hand, box, GraspConditions(mu=0.6), count=8, seed=int(1e3 * along), jobs=1, progress=False)
    assert search.outcomes.get("holds", 0) >= 4


def test_a_search_tells_how_far_the_hand_opens():
    search = find_grasps(
        load_hand("panda"), Box(size=(0.2, 0.2, 0.2), mass=0.1), GraspConditions(mu=0.6), count=4, seed=1, jobs=1
    )
    assert search.opening[1] == pytest.approx(0.08, abs=1e-4)  # the maker's figure
    assert "too large" in str(search)
