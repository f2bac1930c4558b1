"""Plans of a search: the best grasp that can be planned and carried out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pinograsp.contacts import Friction
from pinograsp.contacts.hits import find_overlaps
from pinograsp.errors import GraspInfeasible, GraspNotFound, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import load_hand
from pinograsp.objects import Sphere
from pinograsp.plan.answer import does_it_hold
from pinograsp.planner import plan_best
from pinograsp.planner.best import plan_each
from pinograsp.synthesis import find_grasps

CONDITIONS = GraspConditions(mu=0.7, friction=Friction(model="soft", torsion=0.005))


@pytest.fixture(scope="module")
def found():
    return find_grasps(load_hand("panda"), Sphere(radius=0.02, mass=0.1), CONDITIONS, count=16, jobs=1, progress=False)


def with_weak_motors(grasp):
    model = grasp.closure.hand.model.copy()
    model.effortLimit[:] = 1e-6
    return replace(grasp, closure=replace(grasp.closure, hand=replace(grasp.closure.hand, model=model)))


@pytest.mark.slow
def test_the_best_grasp_that_can_be_planned_is(found):
    plan = plan_best(found, CONDITIONS, progress=False)
    assert plan.forces.status is Status.OK and plan.closure is not None
    weak, good = with_weak_motors(found.grasps[0]), found.grasps[1]
    second = plan_best(replace(found, grasps=(weak, good)), CONDITIONS, progress=False)
    assert np.array_equal(second.hand.pose, good.pose)


@pytest.mark.slow
def test_where_none_can_be_planned_the_best_ones_failure_says_why(found):
    weak = replace(found, grasps=tuple(with_weak_motors(one) for one in found.grasps))
    with pytest.raises(GraspInfeasible, match="torque|joint"):
        plan_best(weak, CONDITIONS, progress=False)
    with pytest.raises(GraspNotFound, match="no grasp of 16 samples"):
        plan_best(replace(found, grasps=()), CONDITIONS, progress=False)


@pytest.mark.no_cover
def test_plans_do_not_depend_on_the_number_of_processes(found):
    """Nor does their order; what they were made of comes back as itself."""
    weak = replace(found, grasps=(with_weak_motors(found.grasps[0]), *found.grasps[1:5]))
    refused = [], []
    alone, together = (
        list(plan_each(weak, CONDITIONS, jobs=1 + i, progress=False, refused=refused[i])) for i in range(2)
    )
    assert len(alone) == len(together) > 1
    assert [[str(error) for error, _ in each] for each in refused] == [[str(refused[0][0][0])]] * 2
    for one, other in zip(alone, together):
        assert other.closure is one.closure and other.status is one.status and other.cautions == one.cautions
        assert np.array_equal(other.hand.pose, one.hand.pose)
        np.testing.assert_allclose(other.motion.torques, one.motion.torques, rtol=1e-9, atol=1e-12)
    best = plan_best(weak, CONDITIONS, jobs=2, progress=False)
    assert best.closure is alone[0].closure and best.tolerance is not None


def test_links_that_press_without_a_contact_are_told(found):
    """One jaw's contacts left out of the set: its link is deep in the object, and no other is."""
    plan = plan_best(found, CONDITIONS, progress=False)
    contacts, q = plan.solution.problem.contacts, plan.motion.q[-1]
    links = sorted({contact.link for contact in contacts})
    assert len(links) == 2 and find_overlaps(plan.hand, plan.body, contacts, q, allowed=1e-5) == ()
    left = replace(contacts, contacts=tuple(one for one in contacts if one.link == links[0]))
    assert find_overlaps(plan.hand, plan.body, left, q, allowed=1e-5) == (links[1],)
    assert find_overlaps(plan.hand, plan.body, left, plan.closure.q, allowed=1e-5) == ()


@pytest.mark.slow
def test_what_is_taken_was_simulated_where_asked(found):
    plain, checked = (plan_best(found, CONDITIONS, progress=False, check=check) for check in (False, True))
    assert not any(note.startswith("simulated (") for note in plain.notes)
    (told,) = (note for note in checked.notes if note.startswith("simulated ("))
    assert ": held, " in told and checked.status is plain.status
    assert "Not simulated yet" in does_it_hold(plain).text and "held" in does_it_hold(checked).text


def test_all_plans_of_a_search_come_once_the_best_first(found):
    plans = list(plan_each(found, CONDITIONS, progress=False))
    assert plans[0].closure is plan_best(found, CONDITIONS, progress=False).closure
    planned = [plan.closure for plan in plans]
    assert len({id(closure) for closure in planned}) == len(planned) == len(found.grasps)
    refused = []
    too_gentle = replace(CONDITIONS, max_normal_force=0.05)
    assert not list(plan_each(found, too_gentle, progress=False, refused=refused))
    assert len(refused) == len(found.grasps)


@pytest.mark.parametrize("final_time", [0.5, 1.0])
def test_plans_take_as_long_as_their_joints_need(final_time):
    """The jaws' way takes its time at the speed limit, whatever time was asked for."""
    hand, ball = load_hand("panda"), Sphere(radius=0.02, mass=0.1)
    limit = 0.02  # m/s
    model = hand.model.copy()
    model.velocityLimit[:] = limit
    slow = replace(hand, model=model)
    first, last = 0.8 * final_time, 0.95 * final_time
    conditions = GraspConditions(mu=0.6, final_time=final_time, impact_time_range=(first, last))
    found = find_grasps(slow, ball, conditions, count=4, seed=3, impact_time=first, jobs=1)
    plan = plan_best(found, conditions)
    assert plan.status == "ok" and np.abs(plan.motion.dq).max() <= limit * (1 + 1e-6)
    assert plan.forces.final_time > final_time and plan.forces.impact_time < plan.forces.final_time
    assert any(f"instead of {final_time:g} s, because of the speed limit" in note for note in plan.notes)
    assert not any("speed limit" in caution for caution in plan.cautions)
    way = np.abs(plan.motion.q[-1] - plan.motion.q[0]).max()
    assert plan.forces.final_time >= way / limit  # no faster than the way takes at that speed
    quick = plan_best(find_grasps(hand, ball, conditions, count=4, seed=3, impact_time=first, jobs=1), conditions)
    assert quick.forces.final_time <= plan.forces.final_time
