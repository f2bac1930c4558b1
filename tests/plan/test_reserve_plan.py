"""Plans that bear a reserve besides the weight: one squeeze from the forces to files, reports and a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.cases.object_case import ObjectCase
from pinograsp.errors import GraspInfeasible, InvalidInput, Status
from pinograsp.forces import Reserve, search_reserve
from pinograsp.planner import load_run, save_run
from pinograsp.report import answer_questions, list_results, report_plan

CONE = pg.Friction(model="cone")
BALL = "sphere:radius=0.035,mass=0.1"
WEIGHT = 0.1 * 9.81


def closed(hand="allegro_right", body=BALL, at=(0.06, 0.0, 0.06), wrap=True):
    return ObjectCase.of(hand=hand, object=body, at=at, wrap=wrap).closure()


def planned(closure, reserve, **conditions):
    given = pg.GraspConditions(**{"mu": 0.7, "friction": CONE, "reserve": reserve, **conditions})
    return pg.plan_grasp_on(closure.hand, closure, given)


@pytest.fixture(scope="module")
def closure():
    return closed()


@pytest.fixture(scope="module")
def plan(closure):
    return planned(closure, Reserve()).with_margins()


@pytest.mark.slow
def test_a_plan_bears_its_reserve(closure, plan):
    assert plan.status is Status.OK and plan.forces.search == "robust"
    assert plan.forces.certificate.relative_gap <= 1e-6 and plan.forces.residual_force < 1e-9
    margins = plan.margins
    assert margins.disturbance_force >= 0.5 * WEIGHT and margins.load_factor >= 1.2
    assert margins.disturbance_moment >= plan.reserve.moment > 0
    assert np.all(plan.forces.normal_forces >= 0.05 * WEIGHT * (1 - 1e-6))
    assert np.all(np.abs(plan.motion.holding_torques) <= 0.9 * closure.hand.effort_or_infinity * (1 + 1e-5))
    assert plan.friction.safety == pytest.approx(1.25) and np.all(plan.torque_limit == closure.hand.effort_or_infinity)
    bare = planned(closure, None).with_margins()
    assert bare.margins.disturbance_force < 1e-3 * WEIGHT and bare.reserve is None
    assert bare.forces.normal_forces.sum() < plan.forces.normal_forces.sum()
    assert any("weakest direction" in text for text in bare.cautions)
    assert not any("weakest direction" in text for text in plan.cautions)


@pytest.mark.slow
def test_no_reserve_is_the_certified_optimum(closure):
    """The search over the impact times comes close to the proven global optimum."""
    bare, none = planned(closure, None), planned(closure, Reserve.none())
    assert none.reserve.loads == 1 and none.forces.search == "robust"
    assert none.forces.certificate.objective == pytest.approx(bare.forces.certificate.objective, rel=0.01)
    assert none.forces.certificate.objective >= bare.forces.certificate.lower_bound * (1 - 1e-9)


@pytest.mark.slow
def test_the_search_over_impact_times_is_near_the_best_of_a_fine_grid(plan):
    problem = replace(plan.problem, friction=CONE, min_normal_force=None, torques=None)
    for measure in ("impulse", "work"):
        one = replace(problem, measure=measure)
        found = search_reserve(one, Reserve())
        costs = []
        for t in np.linspace(*one.impact_time_range, 31):
            squeeze = pg.forces.optimize_reserve(one, Reserve(), t)
            costs += [squeeze.certificate.objective] if squeeze.status is Status.OK else []
        assert found.certificate.objective <= min(costs) * 1.01 and found.tried <= 16


@pytest.mark.slow
def test_the_reserve_is_kept_and_shown(plan, tmp_path):
    folder = save_run(plan, tmp_path / "run")
    again = load_run(folder)
    assert again.reserve.summary() == plan.reserve.summary() == plan.summary()["reserve"]
    words = dict(list_results(plan))
    assert "50 % of the weight" in words["reserve planned"] and "mass +-20 %" in words["reserve planned"]
    assert words["it withstands"].startswith(f"a push of {plan.margins.disturbance_force:.2f}"[:14])
    assert "at this t_I no forces cost less" in words["proven"]
    assert "m/s2" in {one.question: one.text for one in answer_questions(again)}["What does it withstand?"]
    assert f"One squeeze for {plan.reserve.loads} loads" in report_plan(again).to_markdown()
    plan.to_csv(tmp_path / "motion.csv")
    assert (tmp_path / "motion.csv").stat().st_size > 1000


def test_robust_forces_are_carried_out(closure, plan):
    squeeze = search_reserve(replace(plan.problem, friction=CONE, torques=None), Reserve())
    motion = pg.motion.plan_motion(closure.hand, squeeze, None)
    normals = np.einsum("kx,kx->k", motion.forces_o[-1], plan.contacts.rotations_oc[:, :, 2])
    assert normals == pytest.approx(squeeze.normal_forces, rel=1e-9)


@pytest.mark.slow
def test_what_is_in_the_way_is_named(closure):
    """Two hard jaws on a ball bear no moment about their line; soft ones do, and a push along it, too."""
    jaws = closed("panda", "sphere:radius=0.02,mass=0.1", at=(0.0, 0.0, 0.11), wrap=False)
    with pytest.raises(
        GraspInfeasible, match=r"(?s)with its reserve.*\n.*disturbance.*Reserve\(disturbance=0\)"
    ) as caught:
        planned(jaws, Reserve())
    assert caught.value.solution.status is Status.INFEASIBLE and caught.value.solution.search == "robust"
    assert "Reserve(moment_arm=0)" in str(caught.value)
    assert planned(jaws, Reserve(moment_arm=0.0)).with_margins().margins.disturbance_force >= 0.5 * WEIGHT
    soft = planned(jaws, Reserve(), friction=None)
    assert soft.friction.model == "soft" and soft.with_margins().margins.disturbance_moment >= soft.reserve.moment > 0
    with pytest.raises(GraspInfeasible, match=r"least normal force|every impact time"):
        planned(closure, Reserve(normal_force=1e3))
    with pytest.raises(GraspInfeasible, match="(?s)every impact time.*friction coefficient|proven infeasible"):
        planned(closure, Reserve(), mu=0.01)  # not even the weight


def test_what_goes_with_a_reserve(closure):
    given = pg.GraspConditions(mu=0.7, reserve=Reserve(), torque_limit=None)
    for options in ({"search": "hybrid"}, {"solver": "daqp"}):
        with pytest.raises(InvalidInput, match="reserve=None"):
            pg.plan_grasp_on(closure.hand, closure, given, pg.PlanOptions(**options))
    with pytest.raises(InvalidInput, match="least_squares.*reserve=None"):
        pg.plan_grasp_on(closure.hand, closure, given, pg.PlanOptions(objective="least_squares"))


@pytest.mark.slow
def test_held_when_shaken_as_hard_as_planned(plan, closure):
    """The hand shaken along each axis with half the weight's acceleration; without a reserve it is lost."""
    from pinograsp.simulation.settings import Disturbance

    bare = planned(closure, None)
    for axis in np.eye(3):
        shaken = Disturbance(shake=0.5 * 9.81 * axis)
        assert pg.simulate(plan, disturbance=shaken).verdict.held
        assert not pg.simulate(bare, disturbance=shaken).verdict.held
