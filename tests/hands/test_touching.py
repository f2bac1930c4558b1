"""Which shapes and which pairs of links take part in touching: links left out, an SRDF's pairs, coarse shapes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from own_hands import HANDS, PLANAR_GRIPPER, joint, link, robot

import pinograsp as pg
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.record import hand_of, hand_record

BOTH = {("left_jaw", "right_jaw")}


@pytest.fixture
def gripper(tmp_path):
    path = tmp_path / "gripper.urdf"
    path.write_text(PLANAR_GRIPPER)
    return path


def srdf(folder, *lines):
    path = folder / "gripper.srdf"
    path.write_text(f"<robot name='planar_gripper'>{''.join(lines)}</robot>")
    return path


def disable(one, other):
    return f"<disable_collisions link1='{one}' link2='{other}' reason='Never'/>"


def shapes(hand):
    return {hand.model.frames[one.parentFrame].name for one in hand.geometry.geometryObjects}


def test_links_left_out_touch_nothing_and_weigh_the_same(gripper):
    hand, without = load_hand(gripper), load_hand(gripper, exclude=["right_jaw", "palm"])
    assert shapes(hand) == {"palm", "left_jaw", "right_jaw"} and shapes(without) == {"left_jaw"}
    assert without.mass == hand.mass
    assert "exclude=): right_jaw, palm" in " ".join(without.notes)
    closed = hand.upper
    assert SelfCollisions(hand).at(closed) == BOTH and SelfCollisions(without).at(closed) == set()
    box = pg.Box(size=(0.02, 0.02, 0.02), mass=0.05).placed(
        np.array([[1, 0, 0, 0.02], [0, 1, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]])
    )
    assert {one.finger for one in pg.close_hand(hand, box).touches} >= {"right"}
    assert "right" not in {one.finger for one in pg.close_hand(without, box).touches}


@pytest.mark.parametrize(("overlap", "hits"), [(0.0, False), (1e-9, False), (1e-4, True)])
def test_jaws_that_slide_along_each_other_do_not_hit(tmp_path, overlap, hits):
    """Bars drawn side by side share a plane, where rounding decides whether shapes overlap."""
    parts = [link("palm", 0.3, "box 0.1 0.06 0.02", "0 0 -0.02")]
    for name, sign in (("left", 1), ("right", -1)):
        bar = f"{-0.01 * sign} {sign * (0.005 - overlap / 2)} 0.01"
        parts += [
            link(f"{name}_jaw", 0.05, "box 0.06 0.01 0.01", bar),
            joint(name, "palm", f"{name}_jaw", f"{-0.02 * sign} 0 0", f"{sign} 0 0", "0 0.01 9 1", kind="prismatic"),
        ]
    path = tmp_path / "hand.urdf"
    path.write_text(robot("bars", *parts))
    hand = load_hand(path)
    for share in (0.25, 0.5, 1.0):
        assert bool(SelfCollisions(hand).at(hand.lower + share * (hand.upper - hand.lower))) == hits


def test_masses_are_still_taken_from_shapes_that_are_left_out(tmp_path):
    path = tmp_path / "hand.urdf"
    path.write_text(
        "<robot name='r'><link name='p'/><link name='a'><collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
        "</link><joint name='j' type='revolute'><parent link='p'/><child link='a'/><axis xyz='0 1 0'/>"
        "<limit lower='0' upper='1' effort='1' velocity='1'/></joint></robot>"
    )
    assert load_hand(path, exclude=["a"]).mass == pytest.approx(1.0)


@pytest.mark.parametrize("given", [["right"], ["left_hinge"], [""]])
def test_links_that_are_none_are_refused_with_those_there_are(gripper, given):
    with pytest.raises(InvalidInput, match="exclude: expected one of palm, left_jaw"):
        load_hand(gripper, exclude=given)


@pytest.mark.parametrize("given", ["palm", [1], {"palm": 1}, 3])
def test_exclude_takes_names(gripper, given):
    with pytest.raises(InvalidInput, match="exclude: expected a sequence of str"):
        load_hand(gripper, exclude=given)


@pytest.mark.parametrize("pair", [("left_jaw", "right_jaw"), ("right_jaw", "left_jaw")])
def test_pairs_that_an_srdf_disables_are_not_looked_at(gripper, pair):
    path = srdf(gripper.parent, disable(*pair), disable("left_jaw", "forearm"))
    hand = load_hand(gripper, srdf=path)
    assert hand.disabled_collisions == (("left_jaw", "right_jaw"),)
    assert SelfCollisions(hand).at(hand.upper) == set()
    assert "the SRDF disables: 1" in " ".join(hand.notes)
    other = load_hand(gripper, srdf=srdf(gripper.parent, disable("left_jaw", "palm")))
    assert SelfCollisions(other).at(hand.upper) == BOTH


def test_a_link_that_is_disabled_by_default_may_be_enabled_for_some(gripper):
    off, on = "<disable_default_collisions link='left_jaw'/>", "<enable_collisions link1='right_jaw' link2='left_jaw'/>"
    hand = load_hand(gripper, srdf=srdf(gripper.parent, off))
    assert {("palm", "left_jaw"), ("left_jaw", "right_jaw")} <= set(hand.disabled_collisions)
    assert SelfCollisions(hand).at(hand.upper) == set()
    assert SelfCollisions(load_hand(gripper, srdf=srdf(gripper.parent, off, on))).at(hand.upper) == BOTH


@pytest.mark.parametrize("text", [None, "<robot/>", "<mujoco/>", "<robot", PLANAR_GRIPPER, "\x00"])
def test_files_that_are_no_srdf_are_refused(gripper, text):
    path = gripper.parent / "other.srdf"
    if text is not None:
        path.write_text(text)
    with pytest.raises(HandNotLoaded, match=r"other\.srdf"):
        load_hand(gripper, srdf=path)


def test_records_keep_both(gripper):
    hand = load_hand(gripper, srdf=srdf(gripper.parent, disable("left_jaw", "right_jaw")), exclude=["palm"])
    record = json.loads(json.dumps(hand_record(hand)))
    again = hand_of(record)
    assert again.disabled_collisions == hand.disabled_collisions and shapes(again) == shapes(hand)
    assert SelfCollisions(again).at(hand.upper) == set()
    del record["disabled_collisions"]
    assert SelfCollisions(hand_of(record)).at(hand.upper) == BOTH  # an older record
    for broken in ([["left_jaw"]], [["left_jaw", "nobody"]], "x", [[1, 2]]):
        with pytest.raises(InvalidInput, match="disabled_collisions"):
            hand_of({**record, "disabled_collisions": broken})


def coarse(name, *, fixed=True, own=True):
    """A gripper whose jaw has a coarse shape as well, on a link of its own."""
    shape = "sphere 0.05"
    parts = HANDS["planar_gripper"].split("\n")[2:-2]
    if not own:
        parts = [
            link("left_jaw", 0.04, "box 0.012 0.02 0.08", "0 0 0.04").split("<collision>")[0] + "</link>"
            if 'link name="left_jaw"' in one
            else one
            for one in parts
        ]
    how = {} if fixed else {"axis": "0 1 0", "limit": "-1 1 1 1"}
    return robot("g", *parts, link(name, 1e-3, shape), joint("sc", "left_jaw", name, "0 0 0", **how))


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        (coarse("left_jaw_sc"), True),
        (coarse("left_jaw_pad"), False),
        (coarse("right_jaw_sc"), False),
        (coarse("left_jaw_sc", fixed=False), False),
        (coarse("left_jaw_sc", own=False), False),
    ],
)
def test_coarse_shapes_for_self_collision_are_left_out(tmp_path, text, left_out):
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    hand = load_hand(path)
    assert (
        "left_jaw_sc" not in shapes(hand) and "right_jaw_sc" not in shapes(hand) and "left_jaw_pad" not in shapes(hand)
    ) == left_out
    assert (
        any("coarse shapes for checks of self-collision are left out: left_jaw_sc" in one for one in hand.notes)
        == left_out
    )


def test_the_command_line_takes_both(gripper, command):
    path = srdf(gripper.parent, disable("left_jaw", "right_jaw"))
    _, out, _ = command("hands", str(gripper), "--exclude", "palm", "--srdf", str(path))
    assert "--exclude LINK): palm" in out and "the SRDF disables: 1" in out


def test_pairs_that_an_mjcf_file_excludes_are_not_looked_at(tmp_path):
    jaw = """<body name="{0}" pos="{1} 0 0"><joint name="{0}" type="slide" axis="1 0 0" range="-0.1 0.1"/>
      <geom type="box" size="0.01 0.01 0.05" pos="0 0 0.05"/></body>"""
    bodies = f"<body name='palm'><geom size='0.01'/>{jaw.format('left', -0.05)}{jaw.format('right', 0.05)}</body>"
    path = tmp_path / "hand.xml"
    exclude = '<contact><exclude body1="right" body2="left"/><exclude body1="right" body2="palm"/></contact>'
    for contact, found in (("", {("left", "right")}), (exclude, set())):
        path.write_text(f"<mujoco><worldbody>{bodies}</worldbody>{contact}</mujoco>")
        assert SelfCollisions(load_hand(path)).at(np.array([0.05, -0.05])) == found
