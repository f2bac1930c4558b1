"""The commands that take a hand and an object: ``close`` and ``plan --hand --object``."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from pinograsp.errors import InvalidInput
from pinograsp.objects import object_from
from pinograsp.objects.spec import object_language

BALL = "sphere:radius=0.03,mass=0.2"

pytestmark = pytest.mark.usefixtures("no_rendering")


def test_close_says_what_touches_where(command):
    code, out, _ = command("close", "--hand", "allegro_right", "--object", BALL, "--at", "0.08,0,0.07")
    assert code == 0 and "contacts" in out and "stopped: touch of" in out
    code, out, _ = command("close", "--hand", "allegro_right", "--object", BALL, "--at", "0.08,0,0.07,0,0,30", "--json")
    found = json.loads(out)
    assert code == 0 and len(found["q"]) == 16 and found["touches"]
    for touch in found["touches"]:
        assert np.linalg.norm(np.array(touch["point_o"]) - [0.08, 0, 0.07]) == pytest.approx(0.03, abs=1e-6)


def test_wrapping_touches_with_more_links(command):
    found = []
    for more in ((), ("--wrap",)):
        _, out, _ = command(
            *"close --hand allegro_right --object cylinder:radius=0.025,height=0.15,mass=0.2 --at 0.055,0,0.03,90,0,0 --json".split(),
            *more,
        )
        found.append({touch["link"] for touch in json.loads(out)["touches"]})
    assert len(found[1]) > len(found[0]) >= 2


def test_close_without_contacts_and_with_bad_input(command):
    code, out, _ = command("close", "--hand", "allegro_right", "--object", BALL, "--at", "1,0,0")
    assert code == 3 and "0 contacts" in out
    for options, message in (
        (["--hand", "allegro_right", "--object", "ball:radius=0.03,mass=0.2"], "ball"),
        (["--hand", "nobody", "--object", BALL], "no such file"),
        (["--hand", "allegro_right", "--object", BALL, "--at", "1,2"], "--at: expected 3 or 6 numbers"),
        (["--hand", "allegro_right", "--object", BALL, "--at", "here"], "--at: expected 3 or 6 numbers"),
        (["--hand", "allegro_right", "--object", BALL, "--mu", "-1", "--samples", "0"], "mu: Input should be greater"),
        (["--hand", "allegro_right", "--object", BALL, "--friction", "glue"], "friction: Input should be 'pyramid'"),
        (["--hand", "allegro_right", "--object", BALL, "--at", "0,0,0.05"], "overlaps"),
    ):
        code, _, err = command("close", *options)
        assert code == 2 and message in err, options


def test_plan_from_hand_and_object(command, tmp_path):
    code, out, err = command(
        *"plan --hand allegro_right --object cylinder:radius=0.02,height=0.12,mass=0.2 --samples 8 --out run --json".split()
    )
    planned = json.loads(out)
    assert code in (0, 3), err
    assert planned["search"] == "robust" and planned["certificate"]["relative_gap"] <= 1e-6
    assert planned["closing"]["touches"] and planned["status"] in ("ok", "joint_limit", "not_tracked")
    assert (tmp_path / "run" / "report.md").is_file() and (tmp_path / "run" / "plan.npz").is_file()


@pytest.mark.slow
def test_a_plan_with_a_reserve(command, tmp_path):
    ball = ["--hand", "allegro_right", "--object", "sphere:radius=0.035,mass=0.1", "--at", "0.06,0,0.06", "--wrap"]
    code, out, err = command("plan", *ball, "--reserve", "disturbance=0.3, mass=0", "--out", "run", "--json")
    planned = json.loads(out)
    assert code == 0 and planned["search"] == "robust", err
    assert planned["reserve"]["force_N"] == pytest.approx(0.3 * 0.981) and planned["reserve"]["mass"] == 0
    assert planned["reserve"]["friction"] == 0.2  # the others are the default's
    report = (tmp_path / "run" / "report.md").read_text()
    assert "What does it withstand?" in report and "30 % of the weight" in report
    for given, message in (
        ("much", "reserve: expected none, default, or NAME=VALUE"),
        ("mass=0.1,mass=0.2", "each once"),
        ("friction=1", "reserve.friction"),
        ("weight=1", "reserve.weight: unknown key"),
    ):
        code, _, err = command("plan", *ball, "--reserve", given)
        assert code == 2 and message in err, given
    code, _, err = command("plan", "paper", "--reserve", "default")
    assert code == 3 and "disturbance of the reserve" in err  # the paper's contacts withstand next to nothing


def test_meshes_are_objects_too_and_help_says_so(command, tmp_path):
    import trimesh

    trimesh.creation.icosphere(radius=30.0, subdivisions=2).export(tmp_path / "ball.stl")
    code, out, err = command(
        *"close --hand allegro_right --object mesh:path=ball.stl,scale=0.001,mass=0.2 --at 0.08,0,0.07 --json".split()
    )
    assert code == 0 and json.loads(out)["touches"], err


def test_help_knows_every_shape_and_field(command):
    """Shapes and fields are those that errors list, so that none is left out."""
    with pytest.raises(InvalidInput) as refused:
        object_from("none:")
    shapes = re.findall(r"\w+", str(refused.value).partition("expected one of ")[2].partition(", got")[0])
    assert len(shapes) > 5
    for name in ("plan", "close"):
        text = " ".join(command(name, "-h")[1].split())
        for shape in shapes:
            with pytest.raises(InvalidInput) as refused:
                object_from(f"{shape}:none=1")
            fields = re.findall(r"\w+", str(refused.value).partition("expected one of ")[2].partition(", got")[0])
            line = re.search(rf" {shape}: .*? as ?{shape}:\S+", text)
            assert line and {"mass", "density"} < set(fields), (shape, fields)
            for field in fields:
                known = line[0] if field not in ("mass", "density") else text
                assert re.search(rf"\b{field}\b", known.partition(f" as {shape}:")[0]), (shape, field)


def test_examples_of_the_help_are_objects(tmp_path, monkeypatch):
    import trimesh

    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(radius=30.0, subdivisions=2).export(tmp_path / "mug.stl")
    mesh = '<collision><geometry><mesh filename="mug.stl" scale="1e-3 1e-3 1e-3"/></geometry></collision>'
    (tmp_path / "mug.urdf").write_text(f'<robot name="mug"><link name="mug">{mesh}</link></robot>')
    for line in object_language()[1:]:
        assert object_from(line.partition(", as ")[2]).mass > 0, line


def test_plan_takes_a_case_or_a_hand_with_an_object(command):
    for options in (["paper", "--hand", "panda"], ["--hand", "panda"], ["--object", BALL], []):
        code, _, err = command("plan", *options)
        assert code == 2 and "either CASE, or --hand and --object" in err
    code, _, err = command("plan", "--hand", "panda", "--object", BALL, "--set", "friction.mu=1")
    assert code == 2 and "--set changes a case" in err


@pytest.mark.slow
def test_a_plan_with_a_remark_is_a_plan(command):
    """Jaws on one actuator cannot press unequally deep: the closest motion is written, said, and no failure."""
    box = ("--object", "box:size=0.03x0.03x0.08,mass=0.1")
    code, out, _err = command("plan", "--hand", "panda", *box, "--samples", "4", "--reserve", "none", "--json")
    summary = json.loads(out)
    assert code == 0 and summary["status"] == "not_tracked" and "panda_finger_joint1" in summary["remedy"]
