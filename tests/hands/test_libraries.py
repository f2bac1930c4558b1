"""Hands by the names of mujoco_menagerie and robot_descriptions, where these packages are installed.

Without a network: MENAGERIE_ROOT and ROBOT_DESCRIPTIONS_CACHE are the packages' own ways to files that are already
here, a folder of models and git repositories.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import own_hands
import pytest

import pinograsp as pg
from pinograsp.errors import ExtraMissing, HandNotLoaded
from pinograsp.hands.libraries import LIBRARIES, list_library

PACKAGES = {"menagerie": "mujoco_menagerie", "robot_descriptions": "robot_descriptions"}
GRIPPER = """<mujoco model="gripper"><compiler angle="radian" meshdir="assets"/>
  <asset><mesh name="pad" file="pad.obj"/></asset><worldbody><body name="palm">
  <geom type="box" size="0.03 0.05 0.02"/>
  <body name="l" pos="0 0.02 0.02"><joint name="jl" axis="-1 0 0" range="0 0.9"/><geom type="mesh" mesh="pad"/></body>
  <body name="r" pos="0 -0.02 0.02"><joint name="jr" axis="1 0 0" range="0 0.9"/><geom type="mesh" mesh="pad"/></body>
  </body></worldbody></mujoco>"""
PAD = "v -.01 -.004 0\nv .01 -.004 0\nv 0 .004 0\nv 0 0 .045\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """A folder of models as the Menagerie's, with a robot that has a left and a right hand."""
    library = pytest.importorskip("mujoco_menagerie")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    robot = library.get("leap_hand")
    (tmp_path / robot.name / "assets").mkdir(parents=True)
    (tmp_path / robot.name / "assets" / "pad.obj").write_text(PAD)
    for entry in robot.entry_points:
        (tmp_path / robot.name / entry.file).write_text(GRIPPER.replace('"gripper"', f'"{entry.name}"'))
    return tmp_path / robot.name


def run(tmp_path, script, **environment):
    """What a script prints in a process of its own, and what it prints as errors: modules are imported once."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=tmp_path,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def test_a_name_of_the_menagerie_is_the_file_that_it_stands_for(menagerie):
    file = pg.load_hand(menagerie / "right_hand.xml")
    hand = pg.load_hand("menagerie:leap_hand/right_hand")
    assert hand.source == "menagerie:leap_hand/right_hand" and hand.notes == file.notes
    assert hand.joint_names == file.joint_names and hand.mass == file.mass > 0
    assert hand.geometry.ngeoms == file.geometry.ngeoms
    q = np.array([0.1, 0.3])
    tips = [finger.tip for finger in hand.fingers]
    assert np.array_equal(hand.frame_placements(q, tips), file.frame_placements(q, tips))


def test_a_robot_of_several_files_says_which_one_is_taken(menagerie):
    hand = pg.load_hand("menagerie:leap_hand")
    assert hand.name == "left_hand" and any("menagerie:leap_hand/right_hand" in note for note in hand.notes)


def test_a_file_of_the_menagerie_includes_nothing_from_outside(menagerie):
    (menagerie.parent / "secret.xml").write_text("<mujoco><worldbody/></mujoco>")
    text = GRIPPER.replace("<worldbody>", '<include file="../secret.xml"/><worldbody>')
    (menagerie / "left_hand.xml").write_text(text)
    with pytest.raises(HandNotLoaded, match="outside the first file's own folder"):
        pg.load_hand("menagerie:leap_hand/left_hand")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("menagerie:leap_hnd", "did you mean leap_hand"),
        ("menagerie:", "its hands: leap_hand, "),
        ("menagerie:leap_hand/middle", "left_hand, right_hand.*got 'middle'"),
        ("menagerie:shadow_hand", "cannot be fetched"),
    ],
)
def test_names_that_the_menagerie_has_not(menagerie, name, message):
    with pytest.raises(HandNotLoaded, match=message) as caught:
        pg.load_hand(name)
    assert caught.value.source == name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("robot_descriptions:leap_hand_description", "did you mean leap_hand_"),
        ("robot_descriptions:allegro_hand", "ambiguous: expected allegro_hand_description .* allegro_hand_mj_desc"),
        ("robot_descriptions:no such robot at all", "its hands: ability_hand_description, "),
    ],
)
def test_names_that_robot_descriptions_has_not(name, message):
    pytest.importorskip("robot_descriptions")
    with pytest.raises(HandNotLoaded, match=message):
        pg.load_hand(name)


def test_a_name_of_robot_descriptions_is_the_file_in_its_repository(tmp_path):
    """By robot_descriptions itself, whose cache holds the repository at the commit that is asked for."""
    pytest.importorskip("robot_descriptions")
    pytest.importorskip("git")
    made = tmp_path / "made"
    urdf = made / "manipulation" / "models" / "allegro_hand_description" / "urdf"
    urdf.mkdir(parents=True)
    for side, name in (("left", "parallel_gripper"), ("right", "three_fingers")):
        own_hands.write(urdf, name).rename(urdf / f"allegro_hand_description_{side}.urdf")
    git = ["git", "-C", str(made), "-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "hands"]):
        subprocess.run([*git, *command], check=True)
    commit = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    cache = tmp_path / "cache" / f"drake-{commit}"
    cache.mkdir(parents=True)
    made.rename(cache / "drake")
    script = """
import json, pinograsp as pg
name = "robot_descriptions:allegro_hand_description"
left, right = pg.load_hand(name), pg.load_hand(name + "/right")
files = [pg.load_hand(file) for file in FILES]
print(json.dumps([[one.n, one.mass, list(one.notes)] for one in (left, right, *files)]))
"""
    root = cache / "drake" / "manipulation" / "models" / "allegro_hand_description" / "urdf"
    files = [str(root / f"allegro_hand_description_{side}.urdf") for side in ("left", "right")]
    out, _ = run(
        tmp_path,
        script.replace("FILES", repr(files)),
        ROBOT_DESCRIPTIONS_CACHE=str(tmp_path / "cache"),
        ROBOT_DESCRIPTION_COMMIT=commit,
    )
    left, right, file_left, file_right = json.loads(out)
    assert left[:2] == file_left[:2] and right == file_right and left[:2] != right[:2]
    assert left[2][1:] == file_left[2] and "allegro_hand_description/right" in left[2][0]


@pytest.mark.parametrize("library", LIBRARIES)
def test_hands_are_listed_without_a_network(library):
    pytest.importorskip(PACKAGES[library])
    names = list_library(library)
    assert any("shadow" in name for name in names) and not any("panda" in name or "g1" in name for name in names)
    assert all(names.values())


@pytest.mark.parametrize("library", LIBRARIES)
def test_a_library_that_is_not_installed_names_its_extra(library):
    try:
        list_library(library)
    except ExtraMissing as error:
        assert "pinograsp[names]" in str(error) and PACKAGES[library] in str(error)
        with pytest.raises(ExtraMissing, match=r"pinograsp\[names\]"):
            pg.load_hand(f"{library}:shadow_hand")
    else:
        pytest.skip(f"{PACKAGES[library]} is installed")


def test_a_missing_file_tells_of_these_names():
    with pytest.raises(HandNotLoaded, match="menagerie:NAME, robot_descriptions:NAME"):
        pg.load_hand("leap_hand")
