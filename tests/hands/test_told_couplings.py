"""Couplings that stand in ros2_control or in Gazebo's plugins, and transmissions of several joints."""

from __future__ import annotations

import numpy as np
import pytest

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import load_hand

INERTIAL = (
    '<inertial><mass value="0.05"/><inertia ixx="2e-5" iyy="2e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>'
)
COMMAND, STATE = '<command_interface name="position"/>', '<state_interface name="position"/>'
LEAD = f'<joint name="left_slide">{COMMAND}{STATE}</joint>'
MIMIC, FACTOR = '<param name="mimic">left_slide</param>', '<param name="multiplier">{}</param>'


def load(folder, extra, mimic="", kind="prismatic", ends=(0, 0.04)):
    """A body with two jaws, whose own limits leave any coupling room."""
    folder.mkdir(exist_ok=True)
    text = f'<link name="body">{INERTIAL}</link>'
    for name, sign, follows in (("left", 1, ""), ("right", -1, mimic)):
        text += (
            f'<link name="{name}">{INERTIAL}<collision><origin xyz="0 0 0.06"/><geometry><box size="0.016 0.008 0.04"/>'
            f'</geometry></collision></link><joint name="{name}_slide" type="{kind}"><parent link="body"/>'
            f'<child link="{name}"/><axis xyz="0 {sign} 0"/><limit lower="{ends[0]}" upper="{ends[1]}" effort="40" '
            f'velocity="0.2"/>{follows}</joint>'
        )
    path = folder / "jaws.urdf"
    path.write_text(f'<robot name="jaws">{text}{extra}</robot>')
    return load_hand(path)


def control(*joints):
    return f'<ros2_control name="gripper" type="system">{"".join(joints)}</ros2_control>'


def right(*parts, **attributes):
    given = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f'<joint name="right_slide"{given}>{"".join(parts)}{STATE}</joint>'


def plugin(library, **parts):
    inner = "".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())
    return f'<gazebo><plugin filename="{library}" name="mimic_right">{inner}</plugin></gazebo>'


GROUP, UPATRAS = (
    "libroboticsgroup_gazebo_mimic_joint_plugin.so",
    "libroboticsgroup_upatras_gazebo_mimic_joint_plugin.so",
)


@pytest.mark.parametrize(
    ("extra", "factor", "offset"),
    [
        (control(LEAD, right(MIMIC, FACTOR.format(1))), 1, 0),
        (control(right(FACTOR.format(-1.0), MIMIC), LEAD), -1, 0),
        (control(LEAD, right(MIMIC)), 1, 0),
        (control(LEAD, right(MIMIC, FACTOR.format(0.5), '<param name="offset">0.01</param>', COMMAND)), 0.5, 0.01),
        (control(LEAD) + control(right(MIMIC)), 1, 0),
        (plugin(GROUP, joint="left_slide", mimicJoint="right_slide", multiplier="1.0", offset="0.0"), 1, 0),
        (plugin(UPATRAS, joint=" left_slide ", mimicJoint="right_slide", multiplier="-1", offset="0.02"), -1, 0.02),
        (plugin("libgazebo_mimic_joint_plugin.so", joint="left_slide", mimicJoint="right_slide"), 1, 0),
        (plugin("mimic-joint-system", joint_name="right_slide", mimic_joint_name="left_slide"), 1, 0),
        (control(LEAD, right(MIMIC)) + plugin(GROUP, joint="left_slide", mimicJoint="right_slide"), 1, 0),
    ],
)
def test_they_are_read_as_a_mimic_would_be(tmp_path, extra, factor, offset):
    """The same file with URDF's own <mimic> moves alike, and has one motor."""
    hand = load(tmp_path / "told", extra, ends=(-0.04, 0.06))
    own = load(
        tmp_path / "own",
        control(LEAD),
        f'<mimic joint="left_slide" multiplier="{factor}" offset="{offset}"/>',
        ends=(-0.04, 0.06),
    )
    assert hand.couplings == own.couplings and hand.couplings["right_slide"].factor == factor
    for q in np.linspace(hand.lower, hand.upper, 3):
        assert np.array_equal(*(one.frame_placements(q, ["left", "right"]) for one in (hand, own)))
    assert (hand.lower, hand.upper) == (own.lower, own.upper)
    assert [drive.joints for drive in hand.drives] == [("left_slide",)] and not hand.passive_joints
    assert any(note.startswith("couplings taken from") and "right_slide" in note for note in hand.notes)


@pytest.mark.parametrize(
    ("extra", "mimic", "follows"),
    [
        (control(LEAD, right(mimic="true")), "", None),
        (control(LEAD, right(mimic="false")), '<mimic joint="left_slide"/>', 1),
        (control(LEAD, right(MIMIC, FACTOR.format(-1))), '<mimic joint="left_slide" multiplier="1"/>', 1),
        (control(LEAD, right('<param name="mimic">ur/left_slide</param>')), "", None),
        (plugin(GROUP, joint="left_slide", mimicJoint="right_slide", multiplier="2"), '<mimic joint="left_slide"/>', 1),
    ],
)
def test_what_cannot_be_or_contradicts_is_told(tmp_path, extra, mimic, follows):
    hand = load(tmp_path, extra, mimic)
    coupling = hand.couplings.get("right_slide")
    assert (coupling and coupling.factor) == follows
    assert any("right_slide is declared to follow" in note for note in hand.notes)


def test_a_plugin_of_another_layout_is_told(tmp_path):
    hand = load(tmp_path, plugin("libmy_mimic.so", first="left_slide", second="right_slide"))
    assert any("libmy_mimic.so" in note for note in hand.notes) and not hand.couplings


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (control(LEAD, right(MIMIC, FACTOR.format("fast"))), "right_slide.*'fast'"),
        (control(right('<param name="mimic">right_slide</param>')), "right_slide.*itself"),
    ],
)
def test_couplings_without_sense_are_refused(tmp_path, extra, message):
    with pytest.raises(HandNotLoaded, match=message):
        load(tmp_path, extra)


def test_transmissions_of_several_joints_are_told(tmp_path):
    joints = '<joint name="left_slide"/><joint name="right_slide"/>'
    for motors in ('<actuator name="one"/><actuator name="two"/>', '<actuator name="one"/>'):
        hand = load(tmp_path, f'<transmission name="wrist"><type>some</type>{joints}{motors}</transmission>')
        assert any("'wrist'" in note and "left_slide" in note for note in hand.notes) and len(hand.drives) == 2


def test_passive_joints_of_an_srdf_are_told(tmp_path):
    srdf = tmp_path / "jaws.srdf"
    srdf.write_text(
        '<robot name="jaws"><passive_joint name="right_slide"/><disable_collisions link1="left" link2="right"/></robot>'
    )
    hand = load(tmp_path, "")
    assert any("passive" in note and "right_slide" in note for note in load_hand(hand.source, srdf=srdf).notes)
