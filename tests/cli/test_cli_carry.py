"""``pinograsp carry``: from a run and a file to a folder for a robot."""

import csv
import json
import os

import numpy as np
import pytest
from panda_path import JOINTS, WAY

import pinograsp as pg
from pinograsp.carry import ArmPath
from pinograsp.handover import read_csv
from pinograsp.spatial import pose_of

ROBOT = ("--robot", "panda", "--root", "panda_link0")


@pytest.fixture(scope="module")
def grasp():
    """A box in a gripper's jaws."""
    box = pg.Box(size=(0.04, 0.03, 0.05), mass=0.1, pose=pose_of([0, 0, 0.11], np.eye(3)))
    return pg.plan_grasp_on(pg.load_hand("panda"), box, pg.GraspConditions(mu=0.6))


@pytest.fixture
def run(grasp, command, tmp_path):
    """Its run, and a way of the arm."""
    pg.save_run(grasp, tmp_path / "run")
    with open(tmp_path / "way.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([JOINTS, *WAY.tolist()])
    return tmp_path


@pytest.mark.slow
def test_a_run_is_carried(command, run, no_rendering):
    way = str(run / "way.csv")
    code, out, err = command(
        "carry", str(run / "run"), *ROBOT, "--path", way, "--intervals", "60", "--out", str(run / "out")
    )
    assert code == 0, err
    assert "no timing of this path takes less" in " ".join(out.split()) and "out/report.html" in out
    assert {"report.html", "view.html", "carry.json", "carry.npz", "trajectory.csv", "trajectory.json"} <= {
        path.name for path in (run / "out").iterdir()
    }
    told = json.loads((run / "out" / "carry.json").read_text(encoding="utf-8"))
    arrays = np.load(run / "out" / "carry.npz")
    assert told["duration_s"] == pytest.approx(arrays["times"][-1])
    assert told["lower_bound_s"] <= told["fastest_s"] <= told["duration_s"]
    assert (run / "out" / "report.md").read_text(encoding="utf-8").startswith("# Carrying")
    sent = read_csv(run / "out" / "trajectory.csv")
    assert sent.times[-1] == pytest.approx(told["duration_s"])
    # What was written is a path again, whose own timing is held.
    timed = command(
        *("carry", str(run / "run"), *ROBOT, "--path", str(_arm_only(run)), "--timing", "given", "--intervals", "60"),
        *("--json", "--out", str(run / "again")),
    )
    assert timed[0] == 0, timed[2]
    again = json.loads(timed[1])
    assert again["fastest_s"] is None and again["speed_factor"] > 0.99
    assert again["duration_s"] == pytest.approx(told["duration_s"], rel=1e-6)


def _arm_only(run):
    """The arm's columns of the trajectory."""
    sent = read_csv(run / "out" / "trajectory.csv")
    columns = [sent.names.index(joint) for joint in JOINTS]
    rows = np.column_stack([sent.times, sent.q[:, columns]])
    with open(run / "timed.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("time", *JOINTS), *rows.tolist()])
    assert ArmPath.read(run / "timed.csv").duration is not None
    return run / "timed.csv"


@pytest.mark.slow
def test_squeezes_scenarios_and_simulation(command, run, no_rendering):
    code, out, err = command(
        *(
            "carry",
            str(run / "run"),
            *ROBOT,
            "--path",
            str(run / "way.csv"),
            "--intervals",
            "40",
            "--squeeze",
            "constant",
        ),
        *("--scenario", "mass=1.2,mu=0.9", "--ramp", "0.1", "--check", "--json", "--out", str(run / "out")),
    )
    assert code == 0, err
    told = json.loads(out)
    assert told["held"] is True
    assert told["squeeze_N"][0] == pytest.approx(told["squeeze_N"][1], rel=0.3)
    assert json.loads((run / "out" / "carry.json").read_text(encoding="utf-8"))["simulation"]["held"] is True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--timing", "soon"), "timing"),
        (("--squeeze", "hard"), "squeeze"),
        (("--scenario", "weight=2"), "expected mass, mu"),
        (("--scenario", "mass"), "NAME=NUMBER"),
        (("--scenario", "mass=2,mass=3"), "each name once"),
        (("--timing", "given"), "give a trajectory"),
        (("--reserve", "2"), "reserve"),
    ],
)
def test_options_that_cannot_be(command, run, options, message):
    code, _, err = command("carry", str(run / "run"), *ROBOT, "--path", str(run / "way.csv"), *options)
    assert code == 2 and message in err and "Traceback" not in err
    assert not (run / "carries").exists() or not any((run / "carries").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pipe.csv", "deep.json", "aliases.yaml", "gone.yaml", "way.txt"])
def test_paths_that_cannot_be_read(command, run, tmp_path, name):
    """Refused before anything is planned: nothing waits, and no traceback."""
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "aliases.yaml").write_text("joint_names: &a [*a]\npoints: *a\n")
    code, _, err = command("carry", str(run / "run"), *ROBOT, "--path", str(tmp_path / name))
    assert code == 2 and "Traceback" not in err
    assert name in err.replace("\n", "") or "suffix" in err


@pytest.mark.slow
def test_a_hand_without_an_arm_is_told(command, run):
    code, _, err = command("carry", str(run / "run"), "--path", str(run / "way.csv"))
    assert code == 2 and "joints of the arm" in err


@pytest.mark.slow
def test_what_is_too_heavy_is_no_grasp(command, run):
    code, out, _ = command(
        *("carry", str(run / "run"), *ROBOT, "--path", str(run / "way.csv"), "--scenario", "mass=500", "--json")
    )
    assert code == 3
    assert json.loads(out)["error"] in ("CarryInfeasible", "CarryUndecided")
