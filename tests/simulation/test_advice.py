"""What a lost grasp is told would help does: planned so, it is held under what it was tried with."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from own_hands import joint, link, robot

import pinograsp as pg
from pinograsp.forces import GraspConditions, Reserve
from pinograsp.simulation import Disturbance, Push, simulate

CONDITIONS = GraspConditions(mu=0.5)
DOWN = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def bar_in_jaws(tmp_path_factory):
    """Two strong jaws of a sliding joint each, and a bar of 0.3 kg between them."""
    parts = [link("base", 0.4, "box 0.05 0.14 0.02", "0 0 -0.01")]
    for name, side in (("near", 1), ("far", -1)):
        parts += [
            link(f"{name}_pad", 0.05, "box 0.03 0.01 0.1", f"0 {0.055 * side} 0.04"),
            joint(name, "base", f"{name}_pad", "0 0 0", f"0 {-side} 0", "0 0.05 300 1", kind="prismatic"),
        ]
    path = tmp_path_factory.mktemp("jaws") / "jaws.urdf"
    path.write_text(robot("jaws", *parts))
    bar = pg.Box(size=(0.03, 0.04, 0.05), mass=0.3).placed(pg.spatial.pose_of([0.0, 0.0, 0.05], None))
    return pg.load_hand(path), bar


@pytest.mark.slow  # two plans and two simulations each
@pytest.mark.parametrize(
    ("difference", "pattern"),
    [
        (Disturbance(mass_factor=8.0), r"mass=([0-9.]+) kg"),
        (Disturbance(mu=0.15), r"mu=([0-9.]+),"),
        (Disturbance(pushes=(Push(wrench_o=9.0 * DOWN),)), r"Reserve\(disturbance=([0-9.]+)\)"),
    ],
    ids=["heavier", "slippery", "pushed"],
)
def test_the_advice_of_a_lost_grasp_holds(bar_in_jaws, difference, pattern):
    hand, bar = bar_in_jaws
    # The squeeze is what the advice is about, not how far the bar drops while it builds up.
    settings = {"support": "fixed", "hold": 0.5}
    lost = simulate(pg.plan_grasp_on(hand, bar, CONDITIONS), disturbance=difference, **settings).verdict
    assert not lost.held
    (figure,) = re.findall(pattern, " ".join(lost.remedies))
    conditions, value = CONDITIONS, float(figure)
    if difference.mass_factor != 1:
        bar, difference = replace(bar, mass=value, density=None), Disturbance()
    elif difference.mu is not None:
        conditions = replace(CONDITIONS, mu=value)
    else:
        conditions = replace(CONDITIONS, reserve=Reserve(disturbance=value))
    assert simulate(pg.plan_grasp_on(hand, bar, conditions), disturbance=difference, **settings).verdict.held
