"""A plan as text, its efforts in their units: newtons where joints slide."""

from __future__ import annotations

import numpy as np

import pinograsp as pg


def test_efforts_of_sliding_jaws_are_in_newtons():
    hand = pg.load_hand("panda")
    at = hand.frame_placements(hand.resting, [hand.palm])[0] @ pg.spatial.pose_of([0, 0, 0.1034])
    box = pg.Box(size=(0.03, 0.04, 0.06), mass=0.25).placed(at)
    plan = pg.plan_grasp_on(hand, box, pg.GraspConditions(mu=0.5), progress=False)
    assert plan.describe() == str(plan)
    largest = np.abs(plan.motion.torques).max()
    assert plan.peak_efforts() == f"{largest:.3g} N" and f"peak joint effort {largest:.3g} N;" in str(plan)


def test_efforts_of_turning_joints_are_in_newton_metres(paper_plan):
    largest = np.abs(paper_plan.motion.torques).max()
    assert paper_plan.peak_efforts().endswith(" N m")
    assert float(paper_plan.peak_efforts().split()[0]) == float(f"{largest:.3g}")
