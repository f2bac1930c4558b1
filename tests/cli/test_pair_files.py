"""Case files of a hand and an object: the same keys as the options of ``pinograsp plan``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pinograsp.cases import Case, load_case
from pinograsp.cases.object_case import ObjectCase
from pinograsp.errors import CaseRejected
from pinograsp.synthesis import Approach

TEXT = """
hand: panda
object: {shape: box, size: 0.04x0.04x0.08, mass: 0.1}
samples: 8
wishes: {approach: {direction: [0, 0, -1], cone_deg: 50}, edges: false}
tasks: [{name: pull, force: 0.5}]
reserve: {disturbance: 0.3}
"""


def test_a_file_of_a_hand_and_an_object_is_read(tmp_path):
    (tmp_path / "pick.yaml").write_text(TEXT, encoding="utf-8")
    case = load_case(tmp_path / "pick.yaml", {"samples": 4})
    assert isinstance(case, ObjectCase) and case.name == "pick" and case.samples == 4
    wishes = case.wishes.make()
    assert isinstance(wishes.approach, Approach) and np.isclose(wishes.approach.cone, np.radians(50))
    assert not wishes.edges and case.tasks[0].make().size == 0.5
    assert isinstance(load_case("paper"), Case) and isinstance(load_case("mug"), ObjectCase)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("wishes.aproach=above", "did you mean 'approach'"),
        ("wishes.approach=left", "approach"),
        ("tasks=[{name: pull, torque: 1}]", "pull: expected force"),
        ("tasks=['screw']", "screw: expected torque"),
        ("reserve=none", "tasks are part of the reserve"),
        ("at=[0, 0, 0.1]", "expected them without at"),
        ("fingres=thumb", "did you mean 'fingers'"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, change, message):
    (tmp_path / "pick.yaml").write_text(TEXT, encoding="utf-8")
    with pytest.raises(CaseRejected, match=message):
        load_case(tmp_path / "pick.yaml", texts=[change])


def test_no_file_says_that_its_hand_may_run_code(tmp_path):
    (tmp_path / "pick.yaml").write_text(f"{TEXT}\ntrusted: true", encoding="utf-8")
    with pytest.raises(CaseRejected, match="a file cannot say this itself"):
        load_case(tmp_path / "pick.yaml")


@pytest.mark.slow
def test_file_and_options_make_the_same_plan(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pick.yaml").write_text(TEXT, encoding="utf-8")
    options = [
        *("--hand", "panda", "--object", "box:size=0.04x0.04x0.08,mass=0.1", "--samples", "8", "--no-edges"),
        *("--approach", "0,0,-1,50", "--task", "pull:force=0.5", "--reserve", "disturbance=0.3"),
    ]
    plans = []
    for words in (["pick.yaml"], options):
        code, out, err = command("plan", *words, "--json")
        assert code == 0, (out, err)
        plans.append(json.loads(out))
    for name in ("normal_forces_N", "contact_forces_N", "joint_torque_max_Nm", "reserve", "hand_in_object"):
        assert plans[0][name] == plans[1][name], name


def test_options_that_are_typed_change_what_the_file_says(tmp_path, command, monkeypatch):
    """Also where they are what is the default without a file."""
    (tmp_path / "pick.yaml").write_text(f"{TEXT}\nmu: 0.8", encoding="utf-8")
    planned = []
    monkeypatch.setattr("pinograsp.cli.plan._plan_pair", lambda case, *others: planned.append(case))
    command("plan", str(tmp_path / "pick.yaml"), "--mu", "0.6", "--edges", "--forbidden", "lid", "--check")
    command("plan", str(tmp_path / "pick.yaml"))
    changed, as_it_is = planned
    assert (changed.mu, as_it_is.mu) == (0.6, 0.8) and changed.check and not as_it_is.check
    assert changed.wishes.edges and not as_it_is.wishes.edges and changed.wishes.forbidden == ("lid",)
    for case in planned:
        assert case.wishes.approach.cone_deg == 50 and case.samples == 8 and case.name == "pick"


@pytest.mark.slow
def test_a_reserve_is_convex_and_says_so(command):
    code, _, err = command("plan", "paper", "--reserve", "disturbance=0.01", "--search", "hybrid")
    assert code == 2 and "--search: expected convex with --reserve, got hybrid" in err


def test_the_papers_case_takes_a_reserve():
    small = load_case("paper", {"reserve": "disturbance=0.02"}).plan(progress=False)
    assert small.reserve is not None and small.reserve.disturbance == 0.02
    assert small.forces.normal_forces.sum() > load_case("paper").plan(progress=False).forces.normal_forces.sum()
