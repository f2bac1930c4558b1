"""Descriptions that name ROS packages, links without masses, and files that are not there yet."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from pinograsp.cases import load_case
from pinograsp.cases.object_case import ObjectCase
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand

INERTIAL = (
    '<inertial><mass value="0.02"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>'
)
FINGER = """
  <link name="{side}_finger">{mass}<collision><geometry><mesh filename="package://tips/meshes/tip.stl"/></geometry>
  </collision></link>
  <joint name="{side}_joint" type="prismatic"><parent link="base"/><child link="{side}_finger"/>
  <origin xyz="{x} 0 0.05"/><axis xyz="{axis} 0 0"/><limit lower="0" upper="0.03" effort="20" velocity="0.1"/></joint>
"""


@pytest.fixture
def gripper(tmp_path):
    """A xacro gripper in one folder; the package that it includes and that of its meshes elsewhere, without ROS."""
    tips, parts = tmp_path / "elsewhere" / "tips-1.2", tmp_path / "else" / "parts"
    (tips / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.02, 0.02, 0.04)).export(tips / "meshes" / "tip.stl")
    parts.mkdir(parents=True)
    sides = [
        FINGER.format(side="left", x=-0.04, axis=1, mass=INERTIAL),
        FINGER.format(side="right", x=0.04, axis=-1, mass=INERTIAL),
    ]
    (parts / "fingers.xacro").write_text(f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{"".join(sides)}</robot>')
    file = tmp_path / "mine" / "gripper.urdf.xacro"
    file.parent.mkdir()
    file.write_text(
        '<robot name="g" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="size" default="0.1"/>'
        f'<link name="base">{INERTIAL}<collision><geometry><box size="$(arg size) 0.05 0.02"/></geometry></collision>'
        '</link><xacro:include filename="$(find parts)/fingers.xacro"/></robot>'
    )
    return file, {"tips": tips, "parts": str(parts)}


@pytest.mark.parametrize("trusted", [False, True])
def test_packages_are_found_where_they_are_said_to_be(gripper, trusted):
    file, packages = gripper
    hand = load_hand(file, packages=packages, trusted=trusted)
    assert {finger.name for finger in hand.fingers} == {"left", "right"} and hand.geometry.ngeoms == 3
    case = ObjectCase.of(
        hand=str(file), object="sphere:radius=0.02,mass=0.1", packages={k: str(v) for k, v in packages.items()},
        trusted=trusted, xacro_args={"size": "0.12"},
    )  # fmt: skip
    assert case.load_hand().joint_names == hand.joint_names and case.load_hand() is case.load_hand()


def test_a_case_file_tells_how_its_hand_is_read(gripper, tmp_path):
    """All that the options of the commands say of a hand's file; relative folders start at the case file."""
    file, packages = gripper
    (tmp_path / "srdf.xml").write_text(
        '<robot name="g"><disable_collisions link1="left_finger" link2="right_finger"/></robot>'
    )
    changes = {
        "source": str(file),
        "packages": {name: str(Path(folder).relative_to(tmp_path)) for name, folder in packages.items()},
        "xacro_args": {"size": "0.14"},
        "exclude": ["left_finger"],
        "masses": "file",
        "srdf": "srdf.xml",
        "fingers": {"one": "left_finger", "two": "right_finger"},
        "limits_deg": {},
    }
    case = load_case("paper", {f"hand.{key}": value for key, value in changes.items()})
    hand = case.model_copy(update={"folder": tmp_path}).load_hand()
    assert [finger.name for finger in hand.fingers] == ["one", "two"] and hand.palm == "base"
    assert hand.geometry.ngeoms == 2 and 2 * hand.geometry.geometryObjects[0].geometry.halfSide[0] == 0.14
    assert hand.disabled_collisions == (("left_finger", "right_finger"),)
    more = load_case("paper", {"hand.source": "panda", "hand.root": "panda_link6", "hand.limits_deg": {}}).load_hand()
    assert more.joint_names == ("panda_joint7", "panda_finger_joint1")


def test_packages_that_are_missing_are_named(gripper, tmp_path):
    file, packages = gripper
    with pytest.raises(HandNotLoaded, match=r"find parts.*packages="):
        load_hand(file)
    bare = load_hand(file, packages={"parts": packages["parts"]})
    assert any("meshes not found" in note and "packages=" in note for note in bare.notes)
    for wrong, message in (
        ({"parts": tmp_path / "nowhere"}, "folder of package 'parts'"),
        ({"../parts": tmp_path}, "name of a ROS package"),
        ({"parts": 3}, "folder of package 'parts'"),
        ([], "packages"),
    ):
        with pytest.raises(InvalidInput, match=message):
            load_hand(file, packages=wrong)


def test_masses_of_the_file_alone(gripper):
    file, packages = gripper
    part = Path(packages["parts"]) / "fingers.xacro"
    before, mass, after = part.read_text().rpartition(INERTIAL)  # the right finger's
    assert mass and load_hand(file, packages=packages, masses="file").notes
    part.write_text(before + after)
    estimated = load_hand(file, packages=packages)
    joint = estimated.model.getJointId("right_joint")
    assert estimated.model.inertias[joint].mass == pytest.approx(1000 * 0.02 * 0.02 * 0.04, rel=0.01)
    assert any("taken from the geometry" in note for note in estimated.notes)
    with pytest.raises(HandNotLoaded, match="right_joint' moves no mass at all.*masses='estimate'"):
        load_hand(file, packages=packages, masses="file")
    with pytest.raises(InvalidInput, match="masses"):
        load_hand(file, packages=packages, masses="guess")


def test_pointers_of_git_lfs_say_what_to_do(gripper):
    file, packages = gripper
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"
    (packages["tips"] / "meshes" / "tip.stl").write_text(pointer)
    assert any("git lfs pull" in note for note in load_hand(file, packages=packages).notes)
    plain = file.with_name("hand.urdf")
    plain.write_text(pointer)
    with pytest.raises(HandNotLoaded, match="git lfs pull"):
        load_hand(plain)


@pytest.mark.slow
def test_on_the_command_line(command, gripper):
    file, packages = gripper
    chosen = [part for name, folder in packages.items() for part in ("--package", f"{name}={folder}")]
    code, out, _ = command(
        "hands", str(file), *chosen, "--palm", "base", "--finger", "one=left_finger", "--arg", "size=0.2"
    )
    assert code == 0 and "1 finger on 'base'" in out and "one:" in out
    code, _, err = command("hands", "--trusted")
    assert code == 2 and "need the NAME" in err
    code, _, err = command("hands", str(file), "--package", "parts")
    assert code == 2 and "--package: expected NAME=VALUE" in err
    code, _, err = command("close", "--hand", str(file), "--object", "sphere:radius=0.02,mass=0.1", "--masses", "none")
    assert code == 2 and "masses" in err
    code, out, err = command(
        "close", "--hand", str(file), "--object", "sphere:radius=0.02,mass=0.1", *chosen, "--samples", "8"
    )
    assert code == 0 and "left" in out


@pytest.mark.parametrize("trusted", [True, False])
def test_trust_is_not_asked_for_where_a_package_is_missing(tmp_path, trusted):
    path = tmp_path / "hand.urdf.xacro"
    path.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find nowhere_utils)/a.xacro"/><link name="b"/></robot>'
    )
    with pytest.raises(HandNotLoaded, match=r"find nowhere_utils.*its folder is to be given by packages=") as told:
        load_hand(path, trusted=trusted)
    assert "trusted" not in str(told.value) and "substitution" not in str(told.value)
