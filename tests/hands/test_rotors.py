"""Bars and wheels that turn about their own middle are no fingers; all else that turns may be one."""

from __future__ import annotations

import numpy as np
import pytest
from own_hands import PARALLEL_GRIPPER, joint, link, robot

from pinograsp.hands import load_hand

PARTS = PARALLEL_GRIPPER.split("\n")[2:-2]
FIXED = "only turn a bar or wheel about its middle are fixed: motor"


def with_bar(shape, at="0 0 0", *, kind="continuous", parent="palm", axis="0 0 1", more=(), parts=PARTS):
    bar = link("bar", 0.004, shape, at)
    turn = joint("motor", parent, "bar", "0 0 -0.05", axis, "-3.1415926535 3.1415926535 1 3", kind=kind)
    return robot("gripper", *parts, bar, turn, *more)


def load(folder, text):
    path = folder / "gripper.urdf"
    path.write_text(text)
    return load_hand(path)


@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -2", "1 0 0"])
@pytest.mark.parametrize("shape", ["box 0.005 0.02 0.036", "cylinder 0.02 0.01", "sphere 0.01"])
def test_a_propeller_is_no_finger_and_its_joint_none_of_the_hands(tmp_path, shape, axis):
    hand, bare = load(tmp_path, with_bar(shape, axis=axis)), load(tmp_path, PARALLEL_GRIPPER)
    assert [finger.name for finger in hand.fingers] == [finger.name for finger in bare.fingers] == ["left", "right"]
    assert hand.joint_names == bare.joint_names and hand.mass == pytest.approx(bare.mass + 0.004)
    assert any(FIXED in note for note in hand.notes)
    assert [drive.joints for drive in hand.drives] == [drive.joints for drive in bare.drives]
    q = hand.upper  # the bar stays where the file has it
    assert np.allclose(hand.frame_placements(q, ["bar"])[0, :3, 3], [0, 0, -0.05])


@pytest.mark.parametrize(
    "text",
    [
        with_bar("box 0.01 0.01 0.06", "0 0.03 0"),  # to one side: a finger
        with_bar("box 0.01 0.01 0.06", kind="revolute"),  # it has ends
        with_bar("sphere 0.01", parent="left_jaw"),  # a roller on a finger
        with_bar("sphere 0.01", more=(link("tip", 0.01, "sphere 0.01"), joint("end", "bar", "tip", "0 0.05 0"))),
        with_bar(
            "sphere 0.01",
            parts=[link("palm", 1, "sphere 0.1")],
        ),
    ],
)
def test_what_may_be_a_finger_turns(tmp_path, text):
    hand = load(tmp_path, text)
    assert "motor" in hand.joint_names and not any("about its middle" in note for note in hand.notes)


def test_a_bar_that_fingers_follow_is_a_motor(tmp_path):
    parts = [one.replace('joint="left_slide" multiplier="1', 'joint="motor" multiplier="0.01') for one in PARTS]
    hand = load(tmp_path, with_bar("sphere 0.01", parts=parts))
    assert "right_slide" in hand.couplings or "motor" in hand.joint_names
    assert not any("about its middle" in note for note in hand.notes)


def test_a_hand_of_rollers_turns(tmp_path):
    parts = [link("palm", 0.3, "box 0.1 0.1 0.02")]
    for i in range(3):
        parts += [
            link(f"roller{i}", 0.1, "cylinder 0.01 0.05"),
            joint(f"roll{i}", "palm", f"roller{i}", f"0 {0.05 * i} 0.03", "0 0 1", "-3 3 1 1", kind="continuous"),
        ]
    assert load(tmp_path, robot("rollers", *parts)).n == 3
