"""Plans of a search: the best grasp that can be planned and carried out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pinograsp.contacts import Friction
from pinograsp.errors import GraspInfeasible, GraspNotFound, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import load_hand
from pinograsp.objects import Sphere
from pinograsp.planner import plan_best
from pinograsp.synthesis import find_grasps

CONDITIONS = GraspConditions(mu=0.7, friction=Friction(model="soft", torsion=0.005))


@pytest.fixture(scope="module")
def found():
    return find_grasps(load_hand("panda"), Sphere(radius=0.02, mass=0.1), CONDITIONS, count=16, jobs=1, progress=False)


def with_weak_motors(grasp):
    model = grasp.closure.hand.model.copy()
    model.effortLimit[:] = 1e-6
    return replace(grasp, closure=replace(grasp.closure, hand=replace(grasp.closure.hand, model=model)))


def test_the_best_grasp_that_can_be_planned_is(found):
    plan = plan_best(found, CONDITIONS, progress=False)
    assert plan.forces.status is Status.OK and plan.closure is not None
    weak, good = with_weak_motors(found.grasps[0]), found.grasps[1]
    second = plan_best(replace(found, grasps=(weak, good)), CONDITIONS, progress=False)
    assert np.array_equal(second.hand.pose, good.pose)


def test_where_none_can_be_planned_the_best_ones_failure_says_why(found):
    weak = replace(found, grasps=tuple(with_weak_motors(one) for one in found.grasps))
    with pytest.raises(GraspInfeasible, match="torque|joint"):
        plan_best(weak, CONDITIONS, progress=False)
    with pytest.raises(GraspNotFound, match="no grasp of 16 samples"):
        plan_best(replace(found, grasps=()), CONDITIONS, progress=False)
