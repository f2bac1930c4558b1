"""Whether a plan's equilibrium is stable, against simulations with softer and stiffer servos."""

from __future__ import annotations

import pytest

import pinograsp as pg
from pinograsp.planner.stability import instability, stiffness_of
from pinograsp.referee import Servo


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper").plan()


def test_stiff_servos_keep_the_object_and_soft_ones_let_it_tip(plan):
    solution, q = plan.searched(), plan.motion.q[-1]
    assert instability(plan.hand, solution, q) is None
    assert not [caution for caution in plan.cautions if "unstable" in caution]
    told = instability(plan.hand, solution, q, 0.2)
    assert told is not None and told.startswith("the equilibrium is unstable: with servos of 0.2 N m/rad the object ")
    margins = [stiffness_of(plan.hand, solution, q, servo).margin for servo in (1.0, 5.0, 50.0, 1e6)]
    assert margins == sorted(margins)


@pytest.mark.slow
@pytest.mark.parametrize(("servo", "holds"), [(0.2, False), (10.0, True)])
def test_simulations_agree(plan, servo, holds):
    seen = pg.simulate(plan, hold=2.0, servo=Servo.of(plan.hand, stiffness=servo))
    assert seen.verdict.held is holds
    predicted = stiffness_of(plan.hand, plan.searched(), plan.motion.q[-1], servo).is_stable()
    assert predicted is holds
