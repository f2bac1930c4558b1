"""Plans by the certified optimum: from Python, from a case file, from the command line, and the proof when there is
none.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.cases import load_case
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.errors import CaseRejected, GraspInfeasible, GraspUndecided, InvalidInput, Status, status_of
from pinograsp.forces.grid import global_optimum
from pinograsp.planner import load_run
from pinograsp.report import report_failure, report_plan
from pinograsp.storage import read_run

CONVEX = {**AS_PUBLISHED, "forces.search": "convex", "forces.balance": "wrench", "forces.measure": "work"}


@pytest.mark.slow
def test_plan_carries_certificate_and_margins():
    case = load_case("paper", {**CONVEX, "friction.safety": 1.2})
    plan = case.plan()
    assert plan.status is Status.OK and plan.forces.search == "convex"
    summary = plan.summary()
    certificate = summary["certificate"]
    assert certificate["relative_gap"] <= 1e-6 and summary["residual_N"] < 1e-9 and summary["residual_Nm"] < 1e-9
    assert certificate["objective"] == pytest.approx(summary["work_J"], rel=1e-12)
    margins = summary["margins"]
    assert max(margins["friction_used"].values()) == pytest.approx(1 / 1.2, rel=1e-6)
    assert margins["load_factor"] > 1.1 and margins["disturbance_any_N"] > 0 and margins["force_closure"] is True
    json.dumps(summary, allow_nan=False)
    text = report_plan(plan.with_margins()).to_markdown()
    for words in ("no forces cost less than", "friction limit", "safety factor 1.2", "Branch and bound", "least work"):
        assert words in text


def test_motion_carries_the_forces_out(hand):
    """Joint torques at t_F balance gravity and J^T f, tangential forces and a soft finger's moment included."""
    case = load_case("paper", {**CONVEX, "friction.model": "soft", "friction.torsion_mm": 3.0})
    plan = case.plan()
    forces = plan.forces
    assert np.abs(forces.torsion).max() > 1e-4
    limits = pg.torque_limits(case.load_hand(), plan.problem.contacts, plan.motion.q[-1], depth=forces.final_depths)
    normals = plan.problem.contacts.rotations_oc[:, :, 2]
    forces_o = np.einsum("kij,kj->ki", plan.problem.contacts.rotations_oc, forces.forces_c)
    still = limits.torques(forces_o, forces.torsion[:, None] * normals)
    without = limits.torques(forces_o)
    # The hand decelerates a little at t_F, so inertia leaves a small difference; the moment's share is larger.
    assert np.abs(plan.motion.torques[-1] - still).max() < 2e-4
    assert np.abs(plan.motion.torques[-1] - without).max() > 4e-4


@pytest.mark.slow
def test_torque_limits_of_a_plan_hold_at_the_end():
    settings = {**CONVEX, "forces.balance": "force"}  # in wrench balance three contacts leave no room
    free = load_case("paper", settings).plan()
    hand, contacts = free.hand, free.problem.contacts
    held = pg.torque_limits(hand, contacts, free.motion.q[-1])

    def holding(plan):
        limits = pg.torque_limits(hand, contacts, plan.motion.q[-1], depth=plan.forces.final_depths)
        return np.abs(limits.torques(np.einsum("kij,kj->ki", contacts.rotations_oc, plan.forces.forces_c)))

    assert np.all(held.limit == hand.effort)
    limit = 0.9985 * holding(free).max()  # three contacts leave 0.3 %
    limited = load_case("paper", {**settings, "limits.torque_limit": float(limit)}).plan()
    assert holding(limited).max() <= limit * (1 + 1e-5)
    assert limited.forces.work > free.forces.work and limited.solution.certificate.at_torque == ("thumb_cmc",)
    effort = load_case("paper", {**settings, "limits.torque_limit": "effort"}).plan()
    assert effort.forces.work == pytest.approx(free.forces.work, rel=1e-6)  # 2 N m do not bind


@pytest.mark.slow
@pytest.mark.no_cover
def test_motor_heat_is_least_for_its_own_objective():
    settings = {**CONVEX, "friction.model": "cone"}
    cool = load_case("paper", {**settings, "forces.objective": "motor_heat"}).plan()
    cheap = load_case("paper", settings).plan()

    def heat(plan):
        limits = pg.torque_limits(plan.hand, plan.problem.contacts, plan.motion.q[-1], depth=plan.forces.final_depths)
        rotations = plan.problem.contacts.rotations_oc
        return np.sum(limits.torques(np.einsum("kij,kj->ki", rotations, plan.forces.forces_c)) ** 2)

    assert heat(cool) <= heat(cheap) * (1 + 1e-6)
    assert cool.summary()["certificate"]["weights"] == {"motor_heat": 1.0}


def test_convex_options_need_the_convex_search(hand, make_problem):
    for objective, limit in (("work", None), (None, 1.0)):
        with pytest.raises(InvalidInput, match="expected none with search='hybrid'"):
            pg.plan_grasp(
                hand, make_problem(), pg.PlanOptions(search="hybrid", objective=objective), torque_limit=limit
            )
    with pytest.raises(InvalidInput, match="optimize_grasp"):
        pg.grid_search(make_problem(friction=pg.Friction(model="cone")))
    with pytest.raises(InvalidInput, match="optimize_grasp"):
        pg.grid_search(make_problem(max_normal_force=9.0))


def test_infeasible_plan_says_why(hand, make_problem):
    with pytest.raises(GraspInfeasible) as caught:
        pg.plan_grasp(hand, make_problem(balance="wrench", mu=0.2), pg.PlanOptions(search="convex"))
    text = str(caught.value)
    for words in (
        "proven",
        "friction limit: thumb, index, middle",
        "friction coefficient (mu): at least 0.4",
    ):
        assert words in text
    assert caught.value.solution.infeasibility.margin > 0


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_command_finds_the_certified_optimum(command, tmp_path):
    code, out, err = command(
        "plan", "paper", "--search", "convex", "--set", "friction.safety=1", "--measure", "work", "--json", "--compare"
    )
    document = json.loads(out)
    assert code == 0 and err == "" and document["status"] == "ok"
    assert document["work_J"] == pytest.approx(57.09e-3, rel=1e-4)
    assert document["certificate"]["relative_gap"] <= 1e-6
    folder = tmp_path / document["folder"]
    assert load_run(folder).forces.certificate.active
    report = (folder / "report.md").read_text()
    for expected in ("certified optimum, wrench balance: impulse", "Comparison with the paper", "9.873", "55.90"):
        assert expected in report


@pytest.mark.usefixtures("no_rendering")
def test_command_keeps_the_proof(command, tmp_path):
    changes = ("--set", "friction.mu=0.2", "--set", "friction.safety=1")
    code, out, err = command("plan", "paper", "--search", "convex", *changes, "--out", "why")
    assert code == 3 and out == "" and "Traceback" not in err
    assert "(mu): at least 0.4" in err and "the proof is written to why" in err
    run = read_run(tmp_path / "why")
    assert run.status is Status.INFEASIBLE and run.proof.margin > 0 and run.contacts == ("thumb", "index", "middle")
    with pytest.raises(InvalidInput, match="holds no plan, because its search found none .infeasible."):
        load_run(tmp_path / "why")
    report = (tmp_path / "why" / "report.md").read_text()
    assert (
        report == report_failure(run).to_markdown()
        and "# No grasp: paper" in report
        and "largest normal force" in report
    )
    # A grid that found nothing proves nothing, and leaves nothing.
    assert command("plan", "paper", *changes, "--out", "grid")[0] == 3 and not (tmp_path / "grid").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"friction.model": "sticky"}, "friction.model"),
        ({"friction.edges": 5}, "friction.edges"),
        ({"friction.safety": 0.5}, "friction.safety"),
        ({"friction.model": "soft"}, "torsion_mm"),
        ({"limits.torque_limit": -1}, "limits.torque_limit"),
        ({"limits.torque_limit": "plenty"}, "limits.torque_limit"),
        ({"limits.max_normal_force": 0}, "limits.max_normal_force"),
        ({"limits.deceleration": {"linear": [1, 0], "sampled": [1, 1]}}, "one of linear"),
        ({"forces.objective": "beauty"}, "forces.objective"),
        ({"forces.objective": {"work": -1}}, "forces.objective"),
        ({"forces.solver": "magic"}, "forces.solver"),
    ],
)
def test_unusable_cases(changes, words):
    with pytest.raises(CaseRejected, match=re.escape(words)):
        load_case("paper", {**CONVEX, **changes})


def test_decelerations_and_caps_of_a_case():
    for shape in ({"linear": [1, 0.5]}, {"polynomial": [1, 0, -0.5]}, {"sampled": [0.5, 1, 0.5]}):
        problem = load_case(
            "paper", {**CONVEX, "limits.deceleration": shape, "limits.max_normal_force": 12}
        ).make_problem(load_case("paper").load_hand())
        assert problem.max_normal_force.tolist() == [12.0] * 3 and problem.shape.depth_factor != 0.5
    with pytest.raises(InvalidInput, match="negative|>= 0"):
        load_case("paper", {"limits.deceleration": {"sampled": [1, -1]}}).make_problem(load_case("paper").load_hand())


@pytest.mark.slow
def test_what_is_not_proven_is_not_called_infeasible(hand, make_problem, monkeypatch):
    problem = make_problem(balance="wrench", measure="impulse")
    monkeypatch.setattr(global_optimum, "_MOST", 0)
    with pytest.raises(GraspUndecided) as caught:
        pg.plan_grasp(hand, problem, pg.PlanOptions(search="convex"))
    assert caught.value.solution.status is Status.INACCURATE and status_of(caught.value) is Status.INACCURATE
    text = str(caught.value)
    assert "not proven that none exists" in text and "infeasible" not in text
