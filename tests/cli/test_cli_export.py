"""``pinograsp export``: what was saved is handed over."""

from __future__ import annotations

import csv
import json

import mujoco
import numpy as np
import pytest

import pinograsp as pg
from pinograsp.handover import read_csv, read_ros2
from pinograsp.planner import load_run
from pinograsp.spatial import pose_of

LIGHT = ("--set", "motion.samples=1", "--set", "motion.time_step=0.01")
pytestmark = pytest.mark.usefixtures("no_rendering")


@pytest.fixture
def run(command, tmp_path):
    assert command("plan", "paper", "--out", "run", *LIGHT)[0] == 0
    return load_run(tmp_path / "run")


@pytest.mark.slow
def test_each_file_is_what_the_same_call_in_python_writes(command, run, tmp_path):
    code, out, err = command(
        *("export", "run", "--csv", "a.csv", "--ros2", "a.json", "--mujoco", "a.xml"),
        *("--command", "position", "--stiffness", "5", "--rate", "200"),
    )
    assert code == 0 and all(f"Written      {name}" in out for name in ("a.csv", "a.json", "a.xml")), err
    asked = {"command": "position", "stiffness": 5.0, "rate": 200.0}
    run.to_csv(tmp_path / "b.csv", **asked)
    run.to_ros2(tmp_path / "b.json", **asked)
    run.to_mujoco(tmp_path / "b.xml", **asked)
    for ending in ("csv", "json", "xml"):
        assert (tmp_path / f"a.{ending}").read_text().replace("a.npz", "b.npz") == (
            tmp_path / f"b.{ending}"
        ).read_text()


@pytest.mark.slow
def test_starts_goals_and_scenes(command, run, tmp_path):
    start = run.motion.q[0] + 0.05 * np.sign(run.hand.lower + run.hand.upper - 2 * run.motion.q[0])
    told = ",".join(map(repr, start.tolist()))
    code, out, err = command(
        *("export", "run", "--ros2", "goal.json", "--goal", "--no-effort", "--rate", "200", "--json"),
        *(f"--start={told}", "--lead", "2", "--blend", "0.02"),
    )
    assert code == 0, err
    goal = json.loads((tmp_path / "goal.json").read_text())["trajectory"]
    assert goal["joint_names"] == list(run.layout.joints) and goal["points"][0]["effort"] == []
    assert goal["points"][0]["positions"] == pytest.approx(start.tolist())
    said = json.loads(out)
    assert said["ros2"] == "goal.json" and said["duration_s"] > 3 and said["samples"] == len(goal["points"])
    assert command("export", "run", "--mujoco", "scene.xml", "--scene", "--rate", "200", "--stiffness", "20")[0] == 0
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml")).nu >= run.hand.n


@pytest.mark.slow
def test_options_that_cannot_be(command, run, tmp_path):
    (tmp_path / "here.csv").write_text("mine")
    for arguments, message in (
        ([], "expected one or more of --csv FILE"),
        (["--csv", "here.csv"], "already exists"),
        (["--csv", "x.txt"], "ends in .csv"),
        (["--ros2", "x.csv"], "ends in .yaml"),
        (["--csv", "x.csv", "--scene"], "--scene: expected with --mujoco"),
        (["--mujoco", "x.xml", "--goal"], "--goal: expected with --ros2"),
        (["--mujoco", "x.xml", "--no-effort"], "--no-effort: expected with --ros2"),
        (["--mujoco", "x.xml", "--followers"], "--followers: expected with --csv or --ros2"),
        (["--csv", "x.csv", "--command", "push"], "--command"),
        (["--csv", "x.csv", "--command", "jaw"], "expected drives with control 'jaw'"),
        (["--csv", "x.csv", "--mujoco", "x.xml", "--command", "jaw"], "--mujoco: expected with --command torque"),
        (["--csv", "x.csv", "--command", "position"], "stiffness"),
        (["--csv", "x.csv", "--stiffness", "soft"], "--stiffness: expected numbers"),
        (["--csv", "x.csv", "--start", "1,2"], "start"),
        (["--csv", "x.csv", "--rate", "0"], "rate"),
        (["--csv", "here.csv", "--ros2", "x.yaml"], "already exists"),
    ):
        code, _, err = command("export", "run", *arguments)
        assert code == 2 and message in err, (arguments, err)
        assert not list(tmp_path.glob("x.*")) and (tmp_path / "here.csv").read_text() == "mine"
    assert command("export", "run", "--csv", "here.csv", "--force")[0] == 0
    assert read_csv(tmp_path / "here.csv").names == run.layout.joints


@pytest.mark.slow
def test_grippers_get_a_width(command, tmp_path):
    box = pg.Box(size=(0.04, 0.03, 0.05), mass=0.1, pose=pose_of([0, 0, 0.11], np.eye(3)))
    pg.save_run(pg.plan_grasp_on(pg.load_hand("panda"), box, pg.GraspConditions(mu=0.6)), tmp_path / "run")
    assert command("export", "run", "--csv", "jaw.csv", "--ros2", "jaw.json", "--command", "jaw")[0] == 0
    with open(tmp_path / "jaw.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert "panda_finger_joint1" in rows[0].values() and json.loads((tmp_path / "jaw.json").read_text())


def test_a_carry_plan_is_handed_over_once_more(command, tmp_path):
    """Its samples are what they were; another rate is not made up."""
    from pinograsp.handover import JointTrajectory

    times = np.linspace(0, 1, 11)
    one = np.column_stack([times, times**2])
    carried = JointTrajectory(names=("a", "b"), times=times, q=one, dq=one, ddq=one, effort=one)
    (tmp_path / "carried").mkdir()
    (tmp_path / "carried" / "carry.json").write_text("{}")
    carried.to_csv(tmp_path / "carried" / "trajectory.csv")
    code, _, err = command("export", "carried", "--ros2", "goal.json", "--goal", "--mujoco", "m.xml", "--csv", "c.csv")
    assert code == 0, err
    assert read_ros2(tmp_path / "goal.json").q == pytest.approx(one)
    assert read_csv(tmp_path / "c.csv").effort == pytest.approx(one) and (tmp_path / "m.xml").is_file()
    for more in (["--rate", "100"], ["--command", "torque"], ["--scene", "--mujoco", "n.xml"]):
        code, _, err = command("export", "carried", "--csv", "d.csv", *more)
        assert code == 2 and "a carry plan" in err and more[0] in err and not (tmp_path / "d.csv").exists()
