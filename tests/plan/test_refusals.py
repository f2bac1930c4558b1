"""Refusals name what is in the way, and what they advise makes the same call succeed."""

from __future__ import annotations

import re
import secrets
from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except
from own_hands import joint, link, robot

import pinograsp as pg
from pinograsp.errors import GraspInfeasible, NoGrasp, SearchFailed, Status
from pinograsp.forces import GraspConditions, Reserve
from pinograsp.planner import plan_best, plan_grasp_on
from pinograsp.synthesis import find_grasps
from pinograsp.synthesis.found import hold

NUMBER = r"([0-9.]+(?:e[-+]?\d+)?)"
PAD = "box 0.03 0.01 0.08"


def jaws(tmp_path, effort: float) -> pg.HandModel:
    """Two jaws of a sliding joint each, 90 mm apart, which close along y."""
    parts = [link("base", 0.4, "box 0.05 0.14 0.02", "0 0 -0.01")]
    for name, side in (("near", 1), ("far", -1)):
        parts += [
            link(f"{name}_pad", 0.05, PAD, f"0 {0.05 * side} 0.04"),
            joint(name, "base", f"{name}_pad", "0 0 0", f"0 {-side} 0", f"0 0.045 {effort} 1", kind="prismatic"),
        ]
    path = tmp_path / "jaws.urdf"
    path.write_text(robot("jaws", *parts))
    return pg.load_hand(path)


@pytest.fixture
def held(tmp_path):
    """A hand of an effort limit [N], and a bar between its jaws."""

    def make(effort=60.0, mass=0.3, **conditions):
        bar = pg.Box(size=(0.03, 0.04, 0.05), mass=mass)
        at = pg.spatial.pose_of([0.0, 0.0, 0.05], None)
        return jaws(tmp_path, effort), bar.placed(at), GraspConditions(**{"mu": 0.5, **conditions})

    return make


CULPRITS = {
    "effort": (dict(effort=0.9), rf"effort limit[^:\n]*of (?:near, far|far, near): at least {NUMBER} N,", "effort"),
    "friction": (dict(mu=0.012), rf"\(mu\): at least {NUMBER}", "mu"),
    "mass": (dict(mass=30.0), rf"\(mass\): at most {NUMBER} kg", "mass"),
    "cap": (dict(max_normal_force=0.2), rf"\(max_normal_force\): at least {NUMBER} N", "max_normal_force"),
    "depth": (dict(max_depth=1e-4), rf"\(max_depth\): at least {NUMBER} mm", "max_depth"),
    "disturbance": (dict(reserve=Reserve(disturbance=50.0)), rf"Reserve\(disturbance={NUMBER}\)", "disturbance"),
    "least force": (dict(reserve=Reserve(normal_force=40.0)), rf"Reserve\(normal_force={NUMBER}\)", "normal_force"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(CULPRITS, "friction"))
def test_the_one_thing_that_was_spoilt_is_named_with_a_figure_that_does(held, name):
    """Everything else is as in a plan that is ok."""
    spoilt, pattern, argument = CULPRITS[name]
    assert plan_grasp_on(*held()).status is Status.OK
    with pytest.raises(SearchFailed) as refused:
        plan_grasp_on(*held(**spoilt))
    told = str(refused.value)
    (figure,) = re.findall(pattern, told)
    value = float(figure) * (1e-3 if argument == "max_depth" else 1.0)
    mended = {argument: value}
    if argument in ("disturbance", "normal_force"):
        mended = {"reserve": replace(spoilt["reserve"], **mended)}
    assert plan_grasp_on(*held(**{**spoilt, **mended})).status is Status.OK
    assert refused.value.remedy and "Raise" not in refused.value.remedy


@pytest.mark.slow
def test_two_limits_in_the_way_together_are_told_together(held):
    with pytest.raises(GraspInfeasible) as refused:
        plan_grasp_on(*held(effort=0.8, max_normal_force=0.4))
    (line,) = [one for one in str(refused.value).splitlines() if "effort limit" in one]
    effort, cap = re.search(rf"at least {NUMBER} N,.*\(max_normal_force\): at least {NUMBER} N", line).groups()
    plan = plan_grasp_on(*held(effort=float(effort), max_normal_force=float(cap)))
    assert plan.status is Status.OK


@pytest.mark.slow
def test_a_search_names_what_keeps_all_of_its_samples_from_holding(held):
    hand, bar, conditions = held(effort=0.3)
    search = {"count": 4, "seed": 5, "jobs": 1, "progress": False}
    found = find_grasps(hand, bar, conditions, **search)
    assert not found.grasps and found.near and all(grasp.withstands for grasp in found.near)
    figure = re.search(rf"effort limit[^:\n]*: at least {NUMBER} N, given 0.300 N", found.explain())
    with pytest.raises(NoGrasp, match="effort limit"):
        plan_best(found, conditions, progress=False)
    enough = replace(conditions, torque_limit=float(figure[1]))
    again = find_grasps(hand, bar, enough, **search)
    assert plan_best(again, enough, progress=False).status.exit_code == 0


def test_grasps_that_are_found_without_the_reserve_tell_what_they_need(held):
    """These very grasps keep it with the figure that is told."""
    hand, bar, conditions = held(effort=2.0)
    found = find_grasps(hand, bar, conditions, count=8, seed=secrets.randbelow(10**6), jobs=1, progress=False)
    assert found.grasps and not any(grasp.withstands for grasp in found.grasps)
    known = [grasp.pose for grasp in found.grasps]
    assert found.near and all(any(np.array_equal(one.pose, pose) for pose in known) for one in found.near)
    (figure,) = re.findall(rf"effort limit[^:\n]*: at least {NUMBER} N, given 2.00 N", found.explain())
    closure = found.near[0].closure
    for effort, keeps in ((1.01 * float(figure), True), (0.95 * float(figure), False)):
        _, grasp = hold(closure, replace(conditions, torque_limit=effort))
        assert grasp is not None and grasp.withstands is keeps


@pytest.mark.slow
def test_of_several_grasps_it_is_told_of_how_many_it_is_proven(held):
    """Found with a reserve that they withstand, planned with one that they do not."""
    hand, bar, conditions = held()
    one = find_grasps(hand, bar, conditions, count=4, seed=3, jobs=1, progress=False)
    found = replace(one, grasps=2 * one.grasps)
    assert one.explain().startswith("1 grasp from 4 samples") and found.explain().startswith("2 grasps from")
    greedy = replace(conditions, reserve=Reserve(disturbance=80.0))
    with pytest.raises(GraspInfeasible, match=r"2 grasps .* \(proven for each of them\)"):
        plan_best(found, greedy, progress=False)
    with pytest.raises(GraspInfeasible) as refused:
        plan_best(one, greedy, progress=False)
    assert "grasps that were found" not in str(refused.value)
