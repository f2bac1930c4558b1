"""When a motion that a plan has found makes the plan doubtful."""

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.planner.assemble import assemble_plan


@pytest.fixture(scope="module")
def plan():
    hand, ball = pg.load_hand("allegro_right"), pg.Sphere(radius=0.0375, mass=0.18)
    conditions = pg.GraspConditions(mu=0.6)
    found = pg.find_grasps(hand, ball, conditions, count=8, seed=0, jobs=1, progress=False)
    return pg.plan_best(found, conditions, progress=False)


def assemble(plan, **changes):
    """The plan of the same forces, its motion changed."""
    motion = replace(plan.motion, **changes)
    given = {"closure": plan.closure, "conditions": plan.conditions, "reserve": plan.reserve}
    return assemble_plan(plan.hand, plan.solution, motion, elapsed=plan.elapsed, **given)


@pytest.mark.parametrize("far, doubtful", [(0.001, False), (0.009, False), (0.011, True), (0.03, True)])
def test_contacts_that_slide_by_more_than_a_centimetre_make_it_doubtful(plan, far, doubtful):
    assert plan.status is pg.Status.OK
    slip = np.zeros(len(plan.contacts.names))
    slip[-1] = far
    found = assemble(plan, slip=slip)
    assert (found.status is pg.Status.DOUBTFUL) is doubtful
    assert (f"{plan.contacts.names[-1]} slides {1e3 * far:.0f} mm" in str(found.motion.remedy)) is doubtful


@pytest.mark.parametrize("share, doubtful", [(0.9, False), (0.6, False), (0.4, True)])
def test_forces_that_the_release_takes_away_make_it_doubtful(plan, share, doubtful):
    found = assemble(plan, settled_forces=share * plan.solution.normal_forces, slip=np.zeros(len(plan.contacts.names)))
    assert (found.status is pg.Status.DOUBTFUL) is doubtful
    assert (f"{100 * share:.0f} % of the planned forces" in str(found.motion.remedy)) is doubtful
