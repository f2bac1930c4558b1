"""Case files and the command line: what goes in, what comes out, and what bad input gets."""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import yaml
from shipped_hands import listed
from typer.main import get_command

import pinograsp.cases
from pinograsp.cases import load_case
from pinograsp.cli import app
from pinograsp.errors import CaseRejected
from pinograsp.hands.catalogue import shipped_folder as urdf_folder
from pinograsp.planner import load_run
from pinograsp.writing import NewFolder

REQUIRED = {
    "status",
    "impact_time_s",
    "normal_forces_N",
    "multipliers",
    "work_J",
    "impulse_Ns",
    "residual_N",
    "residual_Nm",
    "max_penetration_m",
    "joint_torque_max_Nm",
    "solver",
    "elapsed_s",
}


# A plan with few samples and long steps: for what does not depend on them.
LIGHT = ("--set", "motion.samples=1", "--set", "motion.time_step=0.01")
NOT_DRAWN = "from matplotlib.figure import Figure; Figure.savefig = lambda figure, path, **_: open(path, 'w').close(); "
pytestmark = pytest.mark.usefixtures("no_rendering")


def write_case(path, **changes):
    case = load_case("paper").settings()
    for key, value in changes.items():
        section, _, name = key.partition("__")
        if value is ...:
            del case[section]
        elif name:
            case[section][name] = value
        else:
            case[section] = value
    with path.open("w") as stream:
        yaml.safe_dump(case, stream)
    return path


@pytest.mark.slow
def test_plan_paper_as_a_newcomer_types_it(tmp_path):
    """A real process, cold: prints the table, writes the folder, stays within time and memory."""
    script = (
        "import sys; from pinograsp.cli import main; sys.argv = ['pinograsp', 'plan', 'paper']\n"
        "try: main()\nexcept SystemExit as stop: assert not stop.code\n"
        # Of this process alone: getrusage's figure starts with that of the process that started it. Without the pages
        # of libraries' files: how many of these are mapped is the machine's choice.
        "status = dict(line.split()[:2] for line in open('/proc/self/status') if line.startswith(('VmHWM', 'RssFile')))\n"
        "print('peak', int(status['VmHWM:']) - int(status['RssFile:']))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for expected in ("impact time t_I", "Does it hold?  Barely", "thumb 11.71 N", "runs/paper/report.html"):
        assert expected in done.stdout
    report = (tmp_path / "runs" / "paper" / "report.md").read_text()
    assert "11.71" in report and "Comparison with the paper" not in report  # --compare asks for that
    assert "Traceback" not in done.stderr
    assert int(done.stdout.rsplit("peak", 1)[1]) < 300_000  # KiB
    names = {path.name for path in (tmp_path / "runs" / "paper").iterdir()}
    assert {"plan.json", "plan.npz", "scene.json", "report.md", "joint_angles.png", "contact_forces.png"} <= names


def test_json_is_one_object_and_nothing_else(command, tmp_path):
    code, out, err = command(
        "plan", "paper", "--json", "--out", "a", "--set", "object.mass=0.9", "--measure", "work", *LIGHT
    )
    document = json.loads(out)
    assert code == 0 and err == ""
    assert set(document) >= REQUIRED
    assert document["status"] == "ok" and document["solver"] == "daqp" and document["measure"] == "work"
    assert set(document["normal_forces_N"]) == {"thumb", "index", "middle"}
    assert all(len(pair) == 2 for pair in document["multipliers"].values())
    assert document["joint_torque_max_Nm"]["thumb"].keys() == {"approach", "grasp"}
    stored = json.loads((tmp_path / "a" / "plan.json").read_text())
    assert stored["settings"]["object"]["mass"] == 0.9 and stored["work_J"] == document["work_J"]
    assert stored["settings"]["forces"]["measure"] == "work"


@pytest.mark.slow
def test_folders_never_collide_and_replacing_one_needs_force(command, tmp_path):
    taken, run = tmp_path / "runs" / "paper", tmp_path / "runs" / "paper-2"
    taken.mkdir(parents=True)
    (taken / "notes.txt").write_text("mine")
    code, out, _ = command("plan", "paper", "--json", *LIGHT)
    assert code == 0 and json.loads(out)["folder"] == os.path.join("runs", "paper-2")
    assert sorted(os.listdir(tmp_path / "runs")) == ["paper", "paper-2"] and os.listdir(taken) == ["notes.txt"]
    before = (run / "plan.json").read_bytes()
    code, out, err = command("plan", "paper", "--out", "runs/paper-2")
    assert code == 2 and "--force" in err and out == ""
    assert (run / "plan.json").read_bytes() == before
    assert command("plan", "paper", "--json", "--out", "runs/paper-2", "--force", "--balance", "force", *LIGHT)[0] == 0
    assert (run / "plan.json").read_bytes() != before


@pytest.mark.parametrize(
    ("search", "solver"),
    [
        ("paper+qp", "daqp"),
        *(
            pytest.param(search, solver, marks=pytest.mark.slow)
            for search in ("paper", "paper+qp", "hybrid")
            for solver in ("daqp", "clarabel")
            if (search, solver) != ("paper+qp", "daqp")
        ),
    ],
)
def test_searches_and_solvers(command, search, solver):
    options = ("--balance", "force", "--search", search, "--solver", solver)
    code, out, _ = command("plan", "paper", "--json", *options, *LIGHT)
    document = json.loads(out)
    assert code == 0 and document["search"] == search
    assert document["status"] == ("unbalanced" if search == "paper+qp" else "ok")
    assert document["solver"] == ("none" if search == "paper" else solver)
    assert document["residual_N"] <= (1e-9 if search == "hybrid" else 0.1)


@pytest.mark.slow
def test_a_case_file_of_ones_own(command, tmp_path):
    """A URDF beside the case file, two fingers, a sphere; no table of the paper."""
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "mine.urdf").write_text((urdf_folder() / "humanoid_hand.urdf").read_text())
    write_case(tmp_path / "lab" / "case.yaml", name="lab", hand__source="mine.urdf", object__mass=0.5)
    code, out, _ = command("plan", "lab/case.yaml", "--balance", "wrench")
    assert code == 0 and "Grasp plan 'lab'" in out and "Comparison with the paper" not in out
    assert json.loads((tmp_path / "runs" / "lab" / "plan.json").read_text())["settings"]["name"] == "lab"


def test_spheres_links_and_lists_in_a_case():
    case = load_case(
        "paper",
        {
            "object": {"shape": "sphere", "radius_mm": 30, "mass": 0.2, "position_mm": [0, 0, 60]},
            "contacts": [
                {"finger": "index", "point_mm": [30, 0, 60], "link": "index_intermediate", "length_mm": 20},
                {"finger": "index", "point_mm": [0, 30, 60], "link": "index_distal"},
            ],
            "grid.impact_times": [0.85, 0.9],
            "forces.moment_length_mm": 30,
            "motion.touch": "length",
        },
    )
    hand = case.load_hand()
    problem = case.make_problem(hand)
    assert problem.contacts.names == ("index/index_intermediate", "index/index_distal")
    assert [c.length for c in problem.contacts] == [0.02, pytest.approx(0.02136)]
    assert case.make_object().radius == 0.03 and problem.moment_length == 0.03
    assert case.make_grid().impact_times.tolist() == [0.85, 0.9]


BAD = {
    "unknown case": (["nothing"], "no case 'nothing': expected a YAML file or one of: mug, paper"),
    "mass < 0": (["paper", "--set", "object.mass=-1"], "object.mass: Input should be greater than 0 (got -1)"),
    "infinite": (["paper", "--set", "object.mass=.inf"], "object.mass"),
    "crossed t_I": (["paper", "--set", "limits.impact_time=[0.95, 0.8]"], "lower bound 0.95 is above upper bound 0.8"),
    "t_I after t_F": (["paper", "--set", "limits.final_time=0.9"], "must lie before final_time"),
    "unknown key": (["paper", "--set", "object.mas=1"], "object.mas: unknown key"),
    "folder is not a key": (["paper", "--set", "folder=x"], "unknown key"),
    "key below a value": (["paper", "--set", "object.mass.unit=1"], "has no further keys"),
    "index out of range": (["paper", "--set", "contacts.7=1"], "below 3"),
    "no equals sign": (["paper", "--set", "object.mass"], "expected KEY=VALUE"),
    "broken value": (["paper", "--set", "object.mass=[1"], "not valid YAML"),
    "unknown search": (["paper", "--search", "magic"], "forces.search"),
    "unknown solver": (["paper", "--solver", "no_such_solver"], "forces.solver"),
    "missing urdf": (["paper", "--set", "hand.source=gone.urdf"], "no such file"),
    "unknown finger": (["paper", "--set", "contacts.0.finger=thumbb"], "did you mean 'thumb'"),
    "finger in posture": (["paper", "--set", "motion.posture_deg.pinky=[1,2,3,4]"], "pinky"),
    "unknown joint": (["paper", "--set", "hand.limits_deg.elbow=[0, 1]"], "elbow"),
    "point off the surface": (["paper", "--set", "contacts.0.point_mm=[-26, -96, 61]"], "nearest surface point"),
    "empty grid": (["paper", "--set", "grid.accelerations={start: 1, stop: 0.5, step: 0.1}"], "empty grid"),
    "no contacts": (["paper", "--set", "contacts=[]"], "contacts"),
    "height of a sphere": (["paper", "--set", "object.shape=sphere"], "height_mm is needed for a cylinder"),
    "name with a slash": (["paper", "--set", "name=../up"], "name"),
    "too many grid values": (["paper", "--set", "grid.accelerations.step=1e-5"], "expected at most 10000 values"),
    "too many grid cells": (
        ["paper", "--set", "grid.accelerations.step=1e-4", "--set", "grid.impact_times.step=1e-4"],
        "at most 1000000 pairs",
    ),
    "huge mass": (["paper", "--set", "object.mass=1e300"], "expected 0 or a size from 1e-12 to 1e+12"),
    "endless motion": (["paper", "--set", "limits.final_time=1e6"], "expected at most 200000 steps"),
    "long name": (["paper", "--set", "name=" + "a" * 300], "at most 100 characters"),
    "long hand": (["paper", "--set", "hand.source=" + "a" * 300], "no such file"),
    "no decimal index": (["paper", "--set", "contacts.²=1"], "expected an index below 3"),
    "deep key": (["paper", "--set", "a" + ".a" * 3000 + "=1"], "at most 50 mappings and lists within each other"),
    "deep value": (
        ["paper", "--set", "hand.xacro_args=" + "[" * 60 + "]" * 60],
        "at most 50 mappings and lists within each other",
    ),
    "options of the hand's file": (
        ["paper", "--root", "palm", "--finger", "thumb=tip", "--arg", "side=left", "--masses", "estimate"],
        "got CASE 'paper', whose hand, object and contacts are in its file: write hand.root, hand.fingers, "
        "hand.xacro_args, hand.masses there",
    ),
    "trusted": (["paper", "--trusted"], "--trusted: expected with --hand and --object"),
    "friction and placing": (["paper", "--mu", "0.7", "--wrap"], "write contacts, friction.mu there"),
    "arguments for a file that takes none": (
        ["paper", "--set", "hand.xacro_args={pose: 1}"],
        "arguments pose given, but only xacro files take arguments",
    ),
    "half the links": (
        [
            "paper",
            "--set",
            "contacts=[{finger: index, point_mm: [4.7, 8.8, 71], link: index_distal}, "
            "{finger: index, point_mm: [4.7, 8.8, 71]}]",
        ],
        "expected the link of all",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_gets_one_message_and_exit_code_2(command, tmp_path, name):
    args, message = BAD[name]
    code, out, err = command("plan", *args, "--out", "result")
    assert code == 2 and out == ""
    assert err.startswith("pinograsp: ") and message in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_no_option_is_left_out_silently_with_a_case(command):
    """Each that is not of a case's forces or of the run is refused, those that will be added as well."""
    of_runs = {"hand", "object", "out", "search", "balance", "measure", "reserve", "solver", "changes", "force"}
    of_runs |= {"compare", "as_json", "quiet", "verbose", "case", "help"}
    values = {"samples": "3", "seed": "1", "least_fingers": "3", "mu": "0.5", "safety": "1.1", "torque_limit": "0.7"}
    values |= {"opening": "0.03", "at": "0,0,0.1", "posture": "a=1"}
    params = [one for one in get_command(app).commands["plan"].params if one.name not in of_runs]
    assert len(params) > 10
    for one in params:
        given = [max(one.opts, key=len)] + ([] if one.is_flag else [values.get(one.name, "a=b")])
        code, _, err = command("plan", "paper", *given)
        assert code == 2 and f"{given[0]}: expected with --hand and --object" in err, given


NO_GRASP = {
    "infeasible load": (["--set", "object.mass=30"], "closest to balance", "infeasible"),
    "no friction": (["--set", "friction.mu=0"], "no grasp found", "infeasible"),
    "unreachable point": (["--set", "hand.position_mm=[300, 37, 50]"], "mm remain", "not_reached"),
    "beyond a joint limit": (
        ["--set", "hand.limits_deg={}"],
        "with joints at their limits (thumb_abduction at 90.0 deg",
        "not_reached",
    ),
}


@pytest.mark.parametrize("name", NO_GRASP)
def test_no_grasp_gets_exit_code_3(command, tmp_path, name):
    args, message, status = NO_GRASP[name]
    code, out, err = command("plan", "paper", *args, "--out", "result", "--json")
    told = json.loads(out)
    assert code == 3 and err == "" and message in told["message"] and told["status"] == status
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_motion_at_its_limit_stays_within_it(command, tmp_path):
    """A joint that would swing beyond its limit on its way, or press beyond it, does not."""
    limits = "hand.limits_deg={thumb_abduction: [-15, 130], index_dip: [0, 30.5]}"
    code, out, _ = command(
        "plan", "paper", "--set", limits, "--set", "motion.spread_deg=0", "--set", "motion.samples=1"
    )
    assert code == 0, out
    from pinograsp.planner import load_run

    plan = load_run(tmp_path / "runs" / "paper")
    dip = plan.hand.joint_names.index("index_dip")
    assert plan.motion.q[:, dip].max() <= np.radians(30.5) + 1e-9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hand: [1, 2", "not valid YAML"),
        ("a: 1\na: 2", "not valid YAML"),
        ("- 1\n- 2", "expected a mapping"),
        ("", "expected a mapping"),
        ("!!python/object/apply:os.system ['touch owned']", "not valid YAML"),
        ("name: x", "hand: Field required"),
        ("\x00", "not valid YAML"),
        ("x" * 1_000_001, "at most 1000000"),
        ("[" * 3000, "not valid YAML"),
        ("hand: " + "[" * 100 + "]" * 100, "at most 50 mappings and lists within each other"),
        ("a: &a [*a]", "expected aliases of complete values"),
        (
            "a: &a ["
            + "x, " * 9
            + "x]\n"
            + "".join(f"{b}: &{b} [{f'*{a}, ' * 10}]\n" for a, b in zip("abcdefgh", "bcdefghi")),
            "at most 3000000 values",
        ),
        ("? [a]\n: 1", "expected texts as keys"),
    ],
)
def test_broken_case_files(command, tmp_path, text, message):
    (tmp_path / "case.yaml").write_text(text)
    code, _, err = command("plan", "case.yaml")
    assert code == 2 and message in err
    assert [path.name for path in tmp_path.iterdir()] == ["case.yaml"]


def test_binary_case_file_and_strange_hands(command, tmp_path):
    (tmp_path / "case.yaml").write_bytes(b"\xff\xfe\x00")
    assert command("plan", "case.yaml")[0] == 2
    (tmp_path / "broken.urdf").write_text("<robot>")
    write_case(tmp_path / "case.yaml", hand__source="broken.urdf")
    code, _, err = command("plan", "case.yaml")
    assert code == 2 and "well-formed" in err
    text = (urdf_folder() / "humanoid_hand.urdf").read_text()
    start = text.index("<mass", text.index('"thumb_metacarpal"'))
    (tmp_path / "broken.urdf").write_text(text[:start] + text[text.index("/>", start) + 2 :])
    code, _, err = command("plan", "case.yaml")
    assert code == 2 and "<inertial> needs both" in err
    assert {path.name for path in tmp_path.iterdir()} == {"case.yaml", "broken.urdf"}


def test_a_pipe_is_no_case_file(command, tmp_path):
    os.mkfifo(tmp_path / "case.yaml")
    code, _, err = command("plan", "case.yaml")
    assert code == 2 and "no case 'case.yaml'" in err


def test_a_case_offers_the_choices_of_the_force_searches():
    from pinograsp.cases.case import Case
    from pinograsp.cases.sections import Objective
    from pinograsp.forces import OBJECTIVES, available_solvers

    assert get_args(Objective) == OBJECTIVES
    section = Case.model_fields["forces"].annotation
    for name in available_solvers():
        assert section(solver=name).solver == name
    with pytest.raises(ValueError, match="expected one of auto, interior, newton, .*daqp"):
        section(solver="no_such_solver")


def test_all_problems_of_a_case_are_named_at_once():
    with pytest.raises(CaseRejected) as caught:
        load_case("paper", {"object.mass": -1, "friction.mu": -1, "surprise": 1})
    assert all(word in str(caught.value) for word in ("object.mass", "friction.mu", "surprise"))


def test_interrupting_the_search(command, monkeypatch):
    from pinograsp.forces.grid import pruned

    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(pruned, "refine_multipliers", interrupt)
    code, _, err = command("plan", "paper")
    assert code == 130 and "interrupted" in err


def test_package_imports_quickly_without_heavy_libraries(tmp_path):
    script = (
        "import sys, pinograsp; print(sorted(m for m in ('pinocchio', 'qpsolvers', 'matplotlib') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]"


@pytest.fixture
def loaded_once(monkeypatch):
    """Commands that list the catalogue do not load its hands once more."""
    monkeypatch.setattr("pinograsp.hands.summary.overview", listed)


@pytest.mark.slow
def test_the_catalogue_of_hands(command, loaded_once):
    from pinograsp.hands.catalogue import CATALOGUE

    code, out, err = command("hands")
    assert code == 0 and err == "" and "Traceback" not in out
    header, *rows = [line for line in out.splitlines() if line.strip()]
    assert "mass [kg]" in header and "effort limits" in header
    hint = rows.pop()
    assert [row.split()[0] for row in rows] == list(CATALOGUE) and "pinograsp hands humanoid" in hint
    psyonic = next(row for row in rows if row.startswith(" psyonic_left"))
    assert " ".join(psyonic.split()) == "psyonic_left 6 10 0.659 5 1.2 to 6 N m"
    panda = next(row for row in rows if row.startswith(" panda"))
    assert " ".join(panda.split()) == "panda 1 2 0.760 2 140 N"
    assert next(row for row in rows if row.startswith(" romeo_left")).split()[-1] == "none"


def test_the_catalogue_for_machines(command, loaded_once):
    code, out, err = command("hands", "--json")
    document = json.loads(out)
    assert code == 0 and err == "" and document["problems"] == [] and len(document["hands"]) == 22
    assert document["hands"][0] == {
        "name": "humanoid",
        "title": "the paper's humanoid hand",
        "actuated_joints": 20,
        "moving_joints": 20,
        "mass_kg": pytest.approx(0.437, abs=1e-3),
        "fingers": ["thumb", "index", "middle", "ring", "little"],
        "effort": {"N m": [2.0, 2.0]},
    }


def test_one_hand_of_the_catalogue_or_a_file(command, tmp_path):
    import own_hands

    code, out, _ = command("hands", "psyonic_left")
    assert code == 0 and "6 joints that move 4 more" in out and "note: joint Left_index_q2 follows" in out
    own_hands.write(tmp_path, "parallel_gripper")
    code, out, _ = command("hands", "parallel_gripper.urdf")
    assert code == 0 and "left_slide -> left_jaw: +0.000 .. +0.040 m, effort 120 N" in out
    code, out, err = command("hands", "parallel_gripper.urdf", "--json")
    document = json.loads(out)
    assert code == 0 and err == ""
    assert document["joints"] == [
        {
            "name": "left_slide",
            "type": "prismatic",
            "unit": "m",
            "lower": 0.0,
            "upper": 0.04,
            "effort_unit": "N",
            "effort": 120.0,
            "velocity": 0.1,
        }
    ]
    assert document["coupled"] == [{"name": "right_slide", "follows": "left_slide", "multiplier": 1.0, "offset": 0.0}]
    assert [finger["tip"] for finger in document["fingers"]] == ["left_tip", "right_tip"]
    assert document["mass_kg"] == pytest.approx(0.62) and document["palm"] == "palm"
    code, out, _ = command("hands", "humanoid", "--root", "index_proximal", "--json")
    assert code == 0 and [joint["name"] for joint in json.loads(out)["joints"]] == ["index_pip", "index_dip"]
    code, out, _ = command("hands", "panda", "--root", "panda_leftfinger", "--json")
    assert code == 2 and json.loads(out)["error"] == "HandNotLoaded"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["allegro_rigth"], "did you mean 'allegro_right'"),
        (["gone.urdf"], "no such file"),
        (["broken.urdf"], "well-formed"),
        (["panda", "--root", "hand"], "root 'hand' is not a link"),
        (["--root", "palm"], "--root needs the NAME"),
    ],
)
def test_hands_that_cannot_be_shown(command, tmp_path, arguments, message):
    (tmp_path / "broken.urdf").write_text("<robot>")
    code, out, err = command("hands", *arguments)
    assert code == 2 and out == "" and err.startswith("pinograsp: ") and message in err and "Traceback" not in err
    code, out, _ = command("hands", *arguments, "--json")
    assert code == 2 and json.loads(out)["status"] == "invalid_input" and message in json.loads(out)["message"]


def test_a_hand_that_is_missing_does_not_hide_the_others(command, monkeypatch):
    from pinograsp.hands import catalogue

    monkeypatch.setattr(catalogue.importlib.metadata, "files", lambda _: [])
    code, out, err = command("hands")
    assert code == 2 and "humanoid" in out and "panda" not in out and "install version 6 or later" in err
    code, out, _ = command("hands", "--json")
    document = json.loads(out)
    assert code == 2 and len(document["hands"]) == 1 and len(document["problems"]) == 21


@pytest.mark.slow
def test_the_catalogue_is_listed(tmp_path):
    """By a real process: all hands, meshes and the masses of those without any."""
    from pinograsp.hands.catalogue import CATALOGUE

    script = "from pinograsp.cli import main; import sys; sys.argv = ['pinograsp', 'hands']; main()"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in CATALOGUE)
    assert done.stderr == "" and list(tmp_path.iterdir()) == []


def test_bench_tells_times_of_this_machine(command):
    code, out, err = command("bench", "--contacts", "3", "--contacts", "6", "--json")
    told = json.loads(out)
    assert code == 0 and told["compiled"] and [row["contacts"] for row in told["rows"]] == [3, 6]
    for row in told["rows"]:
        assert 0 < row["online_step_us"] < row["solve_us"] < 1e5 and 0 < row["batch_per_problem_us"] < 1e5
    code, out, _ = command("bench", "--contacts", "4")
    assert code == 0 and "online_step_us" in out and "How fast?  4 contacts" in out
    code, _, err = command("bench", "--contacts", "2")
    assert code == 2 and "at least 3" in err


def test_quiet_and_verbose(command, loaded_once):
    """Before the command, and after it."""
    for arguments in (("--quiet", "hands"), ("hands", "panda", "-q")):
        assert command(*arguments) == (0, "", "")
    for arguments in (("--verbose", "plan", "nothing_like_it"), ("plan", "nothing_like_it", "-v")):
        code, _, err = command(*arguments)
        assert code == 2 and "Traceback" in err and "no case 'nothing_like_it'" in err
    assert "Traceback" not in command("plan", "nothing_like_it")[2]  # not kept from call to call


@pytest.mark.slow
def test_a_search_that_finds_no_placement_is_no_grasp(command):
    code, out, err = command(
        "plan", "--hand", "panda", "--object", "sphere:radius=0.5,mass=1", "--samples", "1", "--json"
    )
    told = json.loads(out)
    assert code == 3 and told["status"] == "not_found" and "no grasp of 1" in told["message"] and err == ""


@pytest.mark.parametrize("option", ["--at"])
@pytest.mark.parametrize("text", ["0,0,0,1,1", "0", "a,b,c", "1,2,3,4,5,6,7", ""])
def test_options_of_several_numbers_say_how_many(command, option, text):
    code, _, err = command("plan", "--hand", "panda", "--object", "sphere:radius=0.02,mass=0.1", f"{option}={text}")
    assert code == 2 and err.startswith(f"pinograsp: {option}: expected ") and "6 numbers" in err and "[m" in err


def test_messages_do_not_steer_the_terminal(command):
    code, _, err = command("plan", "\x1b[2Jnothing\udcff")
    assert code == 2 and "\x1b" not in err and "\\x1b[2Jnothing" in err


def test_commands_of_the_readme_judge_the_run_that_they_name():
    """What is checked or shown is what was planned above."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    planned = {f"runs/{name}" for name in re.findall(r"pinograsp plan (\w+)", text)}
    assert planned and set(re.findall(r"pinograsp (?:check|view) (\S+)", text)) <= planned


# -- folders -----------------------------------------------------------------------------------------------------------


def start(folder, *args, largest: int | None = None) -> subprocess.Popen:
    """The command in a process of its own; ``largest``: no file may grow beyond this size [bytes], else none is drawn."""
    limit = (
        NOT_DRAWN
        if largest is None
        else f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({largest}, {largest})); "
    )
    code = f"import sys; {limit}sys.argv[0] = 'pinograsp'; from pinograsp.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, *args], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("out", ["n" * 300, ".", "taken/run", "/dev/null/run", "/"])
def test_folders_that_cannot_be_used_are_told_before_the_work(command, tmp_path, monkeypatch, out):
    from pinograsp.cases.case import Case

    monkeypatch.setattr(Case, "plan", lambda *_, **__: pytest.fail("long work"))
    with NewFolder(tmp_path / "taken" / "run"):
        code, _, err = command("plan", "paper", "--out", out, "--force")
    assert code == 2 and err.startswith("pinograsp: ") and "Traceback" not in err, err
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def light(tmp_path_factory):
    """A case that is soon planned."""
    return str(write_case(tmp_path_factory.mktemp("light") / "case.yaml", motion__samples=1, motion__time_step=0.01))


@pytest.mark.slow
def test_two_plans_at_once_keep_both_answers_or_one_is_refused(tmp_path, light):
    same = [start(tmp_path, "plan", light, "--out", "x", "--json") for _ in range(2)]
    codes = [(one.communicate()[1], one.returncode)[1] for one in same]
    assert sorted(codes) == [0, 2] and os.listdir(tmp_path) == ["x"]
    named = [start(tmp_path, "plan", light, "--json") for _ in range(2)]
    told = {json.loads(one.communicate()[0])["folder"] for one in named}
    assert told == {os.path.join("runs", "paper"), os.path.join("runs", "paper-2")}


@pytest.mark.slow
def test_on_a_full_disk_every_command_tells_it_and_leaves_nothing_half_written(tmp_path, light):
    assert start(tmp_path, "plan", light, "--out", "x").wait() == 0
    before = sorted((path.relative_to(tmp_path), path.stat().st_mtime_ns) for path in (tmp_path / "x").rglob("*"))
    (tmp_path / "s.yaml").write_text(
        "case: paper\nset: {motion.samples: 1, motion.time_step: 0.01}\nover: {object.mass: [0.5, 1.0]}\n"
    )
    for args, largest in (
        (("plan", light, "--out", "x", "--force"), 10_000),
        (("plan", light, "--out", "y"), 10_000),
        (("report", "x"), 10_000),
        (("view", "x", "--html", "page.html"), 10_000),
        (("sweep", "s.yaml", "--out", "z", "--jobs", "1"), 2_000),
        (("check", "x", "--hold", "0.1"), 10_000),
        (("check", "x", "--hold", "0.6", "--time-step", "1e-3", "--monte-carlo", "1"), 1_000),
    ):
        process = start(tmp_path, *args, "--quiet", largest=largest)
        _, err = process.communicate(timeout=300)
        assert process.returncode == 2 and "cannot write" in err and "Traceback" not in err, (args, err)
        assert not [path for path in tmp_path.rglob(".pinograsp-*")], args
    inside = [(path, when) for path, when in before if path.name not in ("files.txt", "x")]
    now = {path.relative_to(tmp_path): path.stat().st_mtime_ns for path in (tmp_path / "x").rglob("*")}
    assert all(now[path] == when for path, when in inside)
    assert (
        not (tmp_path / "y").exists()
        and not (tmp_path / "x" / "check").exists()
        and not (tmp_path / "page.html").exists()
    )
    assert start(tmp_path, "plan", light, "--out", "x", "--force").wait() == 0
    assert start(tmp_path, "sweep", "s.yaml", "--out", "z", "--jobs", "1").wait() == 0


@pytest.mark.slow
def test_killed_a_hundred_times_an_old_or_a_new_run_is_there(tmp_path, light, often):
    """Half of the kills fall anywhere, half from the moment on when the first files are written."""
    rng = random.Random(1)
    began = time.monotonic()
    assert start(tmp_path, "plan", light, "--out", "run", "--set", "object.mass=0.5").wait() == 0
    whole, current = time.monotonic() - began, 0.5
    for kill in range(often(100)):
        mass = round(0.3 + 0.004 * kill, 4)
        process = start(tmp_path, "plan", light, "--out", "run", "--force", "--set", f"object.mass={mass}")
        if rng.random() < 0.5:
            time.sleep(rng.uniform(0, whole))
        else:
            while process.poll() is None and not list(tmp_path.glob(".pinograsp-*/plan.npz")):
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 0.4 * whole))
        process.kill()
        process.communicate()
        found = load_run(tmp_path / "run").settings["object"]["mass"]
        assert found in (current, mass)
        listed = (tmp_path / "run" / "files.txt").read_text().splitlines()[1:]
        assert sorted([*listed, "files.txt"]) == sorted(os.listdir(tmp_path / "run"))
        current = found
    assert start(tmp_path, "plan", light, "--out", "run", "--force").wait() == 0
    assert os.listdir(tmp_path) == ["run"]


def test_no_file_lets_its_hand_run_code(command, tmp_path):
    """Whoever opens the file may: a case that was passed on may not."""
    case = tmp_path / "case.yaml"
    text = (Path(pinograsp.cases.__file__).parent / "paper.yaml").read_text()
    case.write_text(re.sub(r"^hand:\n", "hand:\n  trusted: true\n", text, flags=re.M))
    code, _, err = command("plan", str(case))
    assert code == 2 and "a file cannot say this itself" in err
    case.write_text(text)
    assert load_case(case, texts=["hand.trusted=true"]).hand.trusted
    (tmp_path / "sweep.yaml").write_text(
        "schema: 1\ncase: paper\nset: {hand.trusted: true}\nover: {object.mass: [0.5, 1.0]}\n"
    )
    code, _, err = command("sweep", str(tmp_path / "sweep.yaml"), "--out", str(tmp_path / "out"))
    assert code == 2 and "a file cannot say this itself" in err


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("frictoin.mu", "friction"),
        ("friction.mue", "mu"),
        ("contacts.0.finge", "finger"),
        ("compliance.stifness", "stiffness"),
    ],
)
def test_unknown_keys_of_a_case_come_with_the_nearest(key, near):
    with pytest.raises(CaseRejected, match=f"did you mean '{near}'"):
        load_case("paper", {key: 1})


@pytest.mark.parametrize("library", ["menagerie", "robot_descriptions"])
def test_hands_of_other_packages_are_listed(command, loaded_once, library):
    from pinograsp.errors import ExtraMissing
    from pinograsp.hands.libraries import list_library

    try:
        names = [f"{library}:{name}" for name in list_library(library)]
    except ExtraMissing:
        names = None
    assert json.loads(command("hands", "--json")[1])["others"][library] == names
    assert f"{library}:" in command("hands")[1].splitlines()[-1]
    code, out, err = command("hands", f"{library}:")
    if names is None:
        assert code == 2 and out == "" and "pinograsp[names]" in err
        return
    assert code == 0 and [line.split()[0] for line in out.splitlines() if f"{library}:" in line][:-1] == names
    code, out, _ = command("hands", f"{library}:", "--json")
    assert code == 0 and [row["name"] for row in json.loads(out)["hands"]] == names
    assert "need the NAME" in command("hands", f"{library}:", "--trusted")[2]
