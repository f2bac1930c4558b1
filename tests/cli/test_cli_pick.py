"""``pinograsp pick``."""

from __future__ import annotations

import csv
import json

import pytest

from pinograsp.hands.catalogue import file_of

BALL = "sphere:radius=0.03,mass=0.1"
PICK = ("pick", "panda", BALL, "--at", "0.5,0.2", "--to", "0.5,-0.2")


@pytest.mark.slow
def test_a_pick_is_planned_and_written(command, tmp_path):
    folder = tmp_path / "pick"
    wall = ("--box", "wall=0.02,0.2,0.15,0.5,0,0.075")
    code, out, err = command(*PICK, *wall, "--json", "--out", str(folder))
    told = json.loads(out)
    assert code == 0 and err == "" and told["status"] == "ok"
    assert list(told["phases_s"]) == ["reach", "close", "carry", "open", "leave"]
    with (folder / "trajectory.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert len(rows) > 400 * told["duration_s"]
    assert {"view.html", "pick.png", "trajectory.json", "trajectory.xml"} <= {one.name for one in folder.iterdir()}
    assert json.loads((folder / "pick.json").read_text())["simulation"] is None
    code, _, err = command(*PICK, "--out", str(folder))
    assert code == 2 and "already" in err


@pytest.mark.slow
def test_less_reserve_presses_less(command, tmp_path):
    forces = []
    for name in ("none", "disturbance=0.1,mass=0.05", "default"):
        code, _, err = command(*PICK, "--reserve", name, "--out", str(tmp_path / name))
        assert code == 0, err
        forces.append(json.loads((tmp_path / name / "pick.json").read_text())["squeeze_N"][0])
    assert forces == sorted(forces) and forces[0] < 0.9 * forces[2]


@pytest.mark.slow
def test_a_hand_on_another_arm(command, tmp_path):
    arm = file_of("panda").parents[2] / "ur_description/urdf/ur5_robot.urdf"
    posture = (
        "--posture",
        "shoulder_lift_joint=-1.5",
        "--posture",
        "elbow_joint=1.6",
        "--posture",
        "wrist_1_joint=-1.6",
    )
    mount = ("--hand", "panda", "--link", "tool0", "--posture", "wrist_2_joint=-1.57", *posture)
    code, out, _ = command(
        "pick", str(arm), BALL, "--at", "0.4,0.3", *mount, "--check", "--out", str(tmp_path / "lift")
    )
    assert code == 0 and "done" in out and "Is it possible?" in out and "leave" not in out


@pytest.mark.slow
def test_what_is_too_heavy_is_refused_with_the_grippers_own_limit(command, tmp_path):
    """The file of the robot has 100 N for each jaw, the catalogue 70."""
    box = "box:size=0.05x0.05x0.12,mass=6"
    code, _, err = command(*PICK[:2], box, *PICK[3:], "--out", str(tmp_path / "box"))
    assert code == 3 and "cannot be held" in err
    assert "given 140 N" in err and "mass of the object" in err


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--link", "tool0"), "--hand"),
        (("--hand", "panda"), "--link"),
        (("--box", "wall=1,2,3"), "--box"),
        (("--to", "1"), "--to"),
        (("--reserve", "much"), "expected none, default, or NAME=VALUE"),
        (("--reserve", "mass=2"), "reserve.mass"),
        pytest.param(("--at", "2.5,0"), "out of reach", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_picked_is_told(command, tmp_path, options, told):
    code, out, err = command(*PICK, *options, "--out", str(tmp_path / "pick"))
    assert code in (2, 3) and out == "" and told in err
    assert not (tmp_path / "pick").exists()
