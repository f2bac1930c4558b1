"""The paper's hand against an independent DH product and closed-form ellipsoids; any hand from a file."""

from __future__ import annotations

import dataclasses
import io
import math
import os
import pickle
import re
from importlib.metadata import files
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy
from conftest import POINTS
from own_hands import joint, link, parallel_gripper, robot

from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import shipped_folder as urdf_folder
from pinograsp.hands.geometry import hull_points
from pinograsp.hands.humanoid import case_study_pose, humanoid_hand
from pinograsp.hands.load import ON_ROOT
from pinograsp.hands.mesh_file import triangles_of
from pinograsp.hands.xacro_files import expand_xacro

# Tables II and III once more, typed from the paper, in mm.
LENGTHS = {
    "thumb": [55.28, 43.16, 34.80],
    "index": [54.00, 31.48, 21.36],
    "middle": [58.58, 37.44, 23.80],
    "ring": [53.74, 36.34, 23.56],
    "little": [44.92, 25.80, 20.48],
}
AXES = {
    "thumb": [(27.64, 12.88, 13.14), (21.58, 9.37, 9.46), (17.40, 7.97, 9.90)],
    "index": [(26.98, 9.28, 9.11), (15.75, 8.06, 9.02), (10.68, 6.83, 8.15)],
    "middle": [(29.29, 10.00, 8.85), (18.72, 8.32, 8.76), (11.89, 7.18, 8.23)],
    "ring": [(26.87, 9.72, 8.50), (18.17, 7.80, 8.15), (11.78, 6.92, 7.97)],
    "little": [(22.46, 8.67, 8.06), (12.88, 7.53, 7.62), (10.24, 6.30, 7.36)],
}


def rot(axis, angle):
    return pin.AngleAxis(angle, np.asarray(axis, dtype=float)).toRotationMatrix()


def dh_product(base, lengths, q):
    """Frames {0}..{4} of classical DH with twist 90 deg on link 1, written with homogeneous products."""
    frames, T = [base], base
    for a, alpha, angle in zip([0, *lengths], [math.pi / 2, 0, 0, 0], q):
        step = np.eye(4)
        step[:3, :3] = rot([0, 0, 1], angle) @ rot([1, 0, 0], alpha)
        step[:3, 3] = rot([0, 0, 1], angle) @ [a, 0, 0]
        T = T @ step
        frames.append(T)
    return frames


@pytest.mark.parametrize("seed", range(5))
def test_frames_equal_an_independent_dh_product(hand, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(hand.lower, hand.upper)
    data = hand.model.createData()
    pin.framesForwardKinematics(hand.model, data, q)
    for finger, description in zip(hand.fingers, humanoid_hand().fingers):
        expected = dh_product(hand.pose @ description.base, np.array(LENGTHS[finger.name]) * 1e-3, q[finger.dofs])
        for i, j in enumerate(finger.joint_ids):
            # Joint i+1's frame before its own rotation is DH frame {i}.
            before = data.oMi[hand.model.parents[j]] * hand.model.jointPlacements[j]
            assert np.abs(before.homogeneous - expected[i]).max() < 1e-12
        tip = data.oMf[hand.model.getFrameId(finger.tip)].homogeneous
        assert np.abs(tip - expected[4]).max() < 1e-12
        own = description.frames(q[finger.dofs])
        assert np.abs(hand.pose @ own[-1] - tip).max() < 1e-12


def test_base_frames_equal_the_worked_out_table(hand):
    """Origins [mm] and x0 in W; the table is rounded to 0.01 mm."""
    E = np.array([math.cos(math.radians(94)), math.sin(math.radians(94)), 0])
    z = np.array([0.0, 0.0, 1.0])
    N = np.cross(z, E)
    c, s = math.cos, math.sin
    table = {
        "thumb": ((105.20, -38.67, 61.50), -c(math.radians(130)) * E - s(math.radians(130)) * z),
        "index": ((98.81, 36.54, 71.00), c(math.radians(10)) * E + s(math.radians(10)) * z),
        "middle": ((99.01, 37.58, 50.00), E),
    }
    middle = np.array([99.01, 37.58, 50.00])
    table["ring"] = (middle - 21 * z - 3 * E, E)
    table["little"] = (middle - 41 * z - 9 * E, E)
    for description in humanoid_hand().fingers:
        base = case_study_pose() @ description.base
        origin, x0 = table[description.name]
        assert np.abs(1e3 * base[:3, 3] - origin).max() < 0.006
        assert np.abs(base[:3, 0] - x0).max() < 1e-12
        assert np.abs(base[:3, 2] - N).max() < 1e-12


def test_phalanges_are_the_tables_ellipsoids(hand):
    for finger in hand.fingers:
        for joint_id, axes, length in zip(finger.joint_ids[1:], AXES[finger.name], LENGTHS[finger.name]):
            a, b, c = (1e-3 * v for v in axes)
            mass = 1160 * 4 / 3 * math.pi * a * b * c
            inertia = hand.model.inertias[joint_id]
            assert inertia.mass == pytest.approx(mass, rel=1e-12)
            assert np.abs(inertia.lever - [length / 2 * 1e-3, 0, 0]).max() < 1e-15
            # b along the flexion axis (z of the link), c perpendicular to both (y).
            expected = mass / 5 * np.diag([b * b + c * c, a * a + b * b, a * a + c * c])
            assert np.abs(inertia.inertia - expected).max() < 1e-18
            assert 2 * axes[0] == pytest.approx(length, abs=0.04)  # rows of Table III run from the tip
        assert hand.model.inertias[finger.joint_ids[0]].mass == 0


def test_finger_masses_are_the_papers(hand):
    assert 1e3 * hand.finger_mass("index") == pytest.approx(19.5, abs=0.05)
    assert 1e3 * hand.finger_mass("thumb") == pytest.approx(38.7, abs=0.05)


def test_joint_limits_are_table_i():
    hand = load_hand("humanoid")
    for finger in hand.fingers:
        degrees = np.degrees([hand.lower[finger.dofs], hand.upper[finger.dofs]]).T
        expected = (
            [(-15, 90), (-15, 90), (0, 80), (-10, 80)]
            if finger.name == "thumb"
            else [(0, 60), (-40, 90), (0, 135), (-5, 90)]
        )
        assert np.abs(degrees - expected).max() < 1e-9


def test_committed_files_are_what_the_description_writes(tmp_path):
    """The same elements, names and numbers; the last bits of a sine differ from machine to machine."""
    source, urdf = humanoid_hand().write(tmp_path)
    shipped = urdf_folder()
    assert_same_meaning(source.read_text(), (shipped / source.name).read_text())
    assert_same_meaning(urdf.read_text(), (shipped / urdf.name).read_text())
    assert_same_meaning(expand_xacro(shipped / source.name), (shipped / urdf.name).read_text())


NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def assert_same_meaning(text, other):
    assert NUMBER.sub("#", text) == NUMBER.sub("#", other)
    ours, theirs = ([float(number) for number in NUMBER.findall(one)] for one in (text, other))
    assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-13)


def test_what_is_written_does_not_hang_on_the_last_bits():
    """Every number is far from where it would be rounded to the next one: frames off by rounding are written alike."""
    written = humanoid_hand().to_xacro()
    for sign in (1, -1):
        hand = humanoid_hand()
        fingers = []
        for finger in hand.fingers:
            base = finger.base + sign * 4 * np.spacing(finger.base) * (np.abs(finger.base) > 1e-14)
            fingers.append(dataclasses.replace(finger, base=base))
        assert dataclasses.replace(hand, fingers=tuple(fingers)).to_xacro() == written


def test_xacro_arguments_reach_the_model():
    light = load_hand(urdf_folder() / "humanoid_hand.urdf.xacro", xacro_args={"density": 580})
    assert light.finger_mass("index") == pytest.approx(load_hand("humanoid").finger_mass("index") / 2, rel=1e-12)
    with pytest.raises(HandNotLoaded, match="only xacro files take arguments"):
        load_hand("humanoid", xacro_args={"density": 580})


def test_xacro_arguments_may_be_called_as_they_like(tmp_path):
    """Also as arguments of ``load_hand``."""
    text = (urdf_folder() / "humanoid_hand.urdf.xacro").read_text(encoding="utf-8").replace("density", "masses")
    named = load_hand(write(tmp_path, text, "hand.urdf.xacro"), xacro_args={"masses": 580})
    assert named.finger_mass("index") == pytest.approx(load_hand("humanoid").finger_mass("index") / 2, rel=1e-12)


def test_yourdfpy_and_pinocchio_agree_on_forward_kinematics():
    hand = load_hand("humanoid")
    robot = yourdfpy.URDF.load(str(urdf_folder() / "humanoid_hand.urdf"), load_meshes=True)
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = rng.uniform(hand.lower, hand.upper)
        robot.update_cfg(dict(zip(hand.joint_names, q)))
        for finger in hand.fingers:
            ours = hand.frame_placements(q, [*finger.links, finger.tip])
            theirs = [robot.get_transform(name, "palm") for name in (*finger.links, finger.tip)]
            assert np.abs(ours - theirs).max() < 1e-9


def test_fingertips_lie_on_the_published_contacts(hand, final_angles):
    q = hand.configuration(final_angles)
    for finger, point in POINTS.items():
        tip = hand.frame_placements(q, [hand.finger(finger).tip])[0][:3, 3]
        assert np.linalg.norm(tip - point) < 1e-9


def test_placing_moves_every_frame_rigidly(hand):
    plain = load_hand("humanoid")
    q = np.random.default_rng(0).uniform(plain.lower, plain.upper)
    names = ["palm", "index_tip", "ring_distal", "index_metacarpal"]
    assert np.abs(hand.frame_placements(q, names) - hand.pose @ plain.frame_placements(q, names)).max() < 1e-12
    assert np.abs(hand.placed(np.eye(4)).frame_placements(q, names) - plain.frame_placements(q, names)).max() < 1e-12


def test_widened_limit_is_reported(hand):
    assert any("thumb_abduction" in note and "130" in note for note in hand.notes)
    assert "thumb_abduction" in hand.describe() and "note:" in hand.describe()
    assert load_hand("humanoid").notes == ()


def test_names_that_do_not_exist_are_refused_with_suggestions(hand):
    with pytest.raises(InvalidInput, match="did you mean 'index'"):
        hand.finger("indx")
    with pytest.raises(InvalidInput, match="frame"):
        hand.frame_id("no_such_frame")
    with pytest.raises(InvalidInput, match="joint of hand"):
        hand.with_limits({"nope": (0, 1)})
    with pytest.raises(InvalidInput, match="lower < upper"):
        hand.with_limits({"index_mcp": (1, 0)})
    with pytest.raises(InvalidInput, match="orthonormal"):
        hand.placed(2 * np.eye(4))


# -- any hand from a file ----------------------------------------------------------------------------------------------


def allegro(side):
    return next(f.locate() for f in files("example-robot-data") if f.name == f"allegro_{side}_hand.urdf")


@pytest.mark.parametrize("side", ["left", "right"])
def test_allegro_loads_from_its_plain_urdf(side):
    hand = load_hand(allegro(side))
    assert hand.palm == "palm_link"
    assert [finger.n for finger in hand.fingers] == [4, 4, 4, 4]
    assert all(finger.tip.endswith("_tip") for finger in hand.fingers)
    assert sorted(j for finger in hand.fingers for j in finger.joint_ids) == list(range(1, 17))


@pytest.mark.parametrize(
    ("links", "called"),
    [
        # Words that people use, in links or joints; a phalanx may be called as a finger is.
        (
            ("rh_ffknuckle rh_ffmiddle", "rh_mfknuckle rh_mfmiddle", "rh_thbase rh_thdistal"),
            ("index", "middle", "thumb"),
        ),
        (("right_thumb_link right_thumb_tip", "right_index_link right_index_tip"), ("thumb", "index")),
        (("LThumb1 LThumb2", "LIndexFinger1 LIndexFinger2"), ("thumb", "index")),
        (("index_proximal index_middle", "middle_proximal middle_middle"), ("index", "middle")),
        # Abbreviations, among others of them.
        (("if_bs if_ds", "mf_bs mf_ds", "rf_bs rf_ds", "th_mp th_ds"), ("index", "middle", "ring", "thumb")),
        (("R_T-AP R_T-DP", "R_I-AP R_I-DP", "R_R-AP R_R-DP"), ("thumb", "index", "ring")),
        (("imcp ipip", "mmcp mpip", "pmcp ppip"), ("index", "middle", "pinky")),
        (("lf_1 lf_2", "rf_1 rf_2"), ("lf", "rf")),
        (("l_1 l_2", "m_1 m_2", "r_1 r_2"), ("l", "m", "r")),
        (
            ("left_thumb_1 left_thumb_2", "left_index_1 left_index_2", "right_thumb_1", "right_index_1"),
            ("left_thumb", "left_index", "right_thumb", "right_index"),
        ),
        (
            (
                "neck_1 head_2",
                "left_cam left_arm L_thumb_1",
                "left_arm_2 L_index_1",
                "left_cam_2 right_arm R_thumb_1",
                "right_arm_2 R_index_1",
            ),
            ("head_2", "left_thumb", "left_index", "right_thumb", "right_index"),
        ),
        (("neck_1 head_2", "arm_1 L_thumb_1", "arm_2 L_index_1"), ("head_2", "L_thumb_1", "L_index_1")),
        # Else what is a finger's own.
        (("fr3_leftfinger", "fr3_rightfinger"), ("left", "right")),
        (("hand_link_1_a hand_link_1_b", "hand_link_2_a hand_link_2_b"), ("finger 1", "finger 2")),
        (("F1_L1 F1_L2", "F2_L1 F2_L2"), ("F1", "F2")),
        # Two that say the same, and one that says nothing.
        (("thumb_a_1 thumb_a_2", "thumb_b_1 thumb_b_2"), ("a", "b")),
        (("thumb_1 thumb_2", "claw_1 claw_2"), ("thumb", "claw")),
    ],
)
def test_fingers_are_called_what_people_call_them(links, called, tmp_path):
    parts = [link("base", 0.3, "box 0.1 0.05 0.02")]
    for number, chain in enumerate(links):
        before = "base"
        for one in chain.split():
            parts.append(link(one, 0.02, "box 0.01 0.01 0.03"))
            parts.append(joint(f"j_{one}", before, one, f"{0.02 * number} 0 0.03", "0 1 0", "0 1 1 1"))
            before = one
    file = tmp_path / "hand.urdf"
    file.write_text(robot("h", *parts))
    assert tuple(finger.name for finger in load_hand(file).fingers) == called


def test_finger_names_and_palm_can_be_given():
    hand = load_hand(allegro("right"), fingers={"index": "link_3.0_tip", "thumb": "link_15.0"}, palm="palm_link")
    assert [finger.name for finger in hand.fingers] == ["index", "thumb"]
    assert hand.finger("index").joints == ("joint_0.0", "joint_1.0", "joint_2.0", "joint_3.0")
    with pytest.raises(HandNotLoaded, match="is on no finger"):
        load_hand(allegro("right"), fingers={"index": "palm_link"})
    with pytest.raises(HandNotLoaded, match="is not a link"):
        load_hand(allegro("right"), palm="hand")
    with pytest.raises(HandNotLoaded, match="no moving chain"):
        load_hand(allegro("right"), palm="link_3.0_tip")


INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>'


def urdf(
    links="", joints="", first=INERTIAL, limit='<limit lower="-1" upper="1" effort="1" velocity="1"/>', kind="revolute"
):
    return f"""<?xml version="1.0"?><robot name="test">
      <link name="base"/><link name="a">{first}</link><link name="a_tip"/>{links}
      <joint name="j" type="{kind}"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>{limit}</joint>
      <joint name="tip" type="fixed"><parent link="a"/><child link="a_tip"/><origin xyz="0.1 0 0"/></joint>{joints}
    </robot>"""


def write(tmp_path, text, name="hand.urdf"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "inertia",
    [
        '<inertial><mass value="1"/></inertial>',
        '<inertial><mass value="1"/><inertia ixx="1"/></inertial>',
        INERTIAL.replace('ixx="1e-5"', 'ixx="-1e-5"'),
        INERTIAL.replace('<mass value="0.1"/>', '<mass value="-0.1"/>'),
    ],
)
def test_refused_inertias_have_a_way_out_that_works(tmp_path, inertia):
    shape = '<collision><geometry><box size="0.02 0.02 0.1"/></geometry></collision>'
    with pytest.raises(HandNotLoaded, match="leave <inertial> out"):
        load_hand(write(tmp_path, urdf(first=inertia + shape)))
    assert load_hand(write(tmp_path, urdf(first=shape))).mass == pytest.approx(0.04)


def test_smallest_hand_loads(tmp_path):
    hand = load_hand(write(tmp_path, urdf()))
    assert hand.palm == "base" and hand.fingers[0].tip == "a_tip" and hand.fingers[0].name == "a"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (urdf(first=""), "no <inertial>"),
        (urdf(first=INERTIAL.replace("0.1", "-0.1")), "mass"),
        (urdf(first=INERTIAL.replace("0.1", "nan")), "finite"),
        (urdf(first=INERTIAL.replace("0.1", "0")), "no mass at all"),
        (urdf(first=INERTIAL.replace('ixx="1e-5"', 'ixx="-1e-5"')), "positive semi-definite"),
        (urdf(first="<inertial/>"), "needs both"),
        (urdf(limit=""), "no position limits"),
        (urdf(limit='<limit lower="1" upper="-1" effort="1" velocity="1"/>'), "not below"),
        (urdf(kind="floating"), "no revolute or prismatic"),
        (urdf(kind="fixed"), "no revolute or prismatic"),
        (urdf(links='<link name="a"/>'), "defined 2 times"),
        (urdf(links='<link name="loose"/>'), "one root link"),
        (
            urdf(joints='<joint name="k" type="fixed"><parent link="a"/><child link="ghost"/></joint>'),
            "unknown link 'ghost'",
        ),
        (
            urdf(joints='<joint name="k" type="fixed"><parent link="base"/><child link="a_tip"/></joint>'),
            "several parent",
        ),
        (urdf()[:-20], "well-formed"),
        ("<robot name='x'/>", "no <link> found"),
        ("", "well-formed"),
        ("hello", "well-formed"),
    ],
)
def test_broken_urdfs_are_refused_with_the_reason(tmp_path, text, message):
    with pytest.raises(HandNotLoaded, match=message):
        load_hand(write(tmp_path, text))


def test_missing_file_and_binary_file(tmp_path):
    with pytest.raises(HandNotLoaded, match="no such file; expected"):
        load_hand(tmp_path / "nothing.urdf")
    path = tmp_path / "noise.urdf"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(HandNotLoaded, match="text"):
        load_hand(path)


def test_shipped_urdf_needs_no_mesh_to_load(tmp_path):
    text = (urdf_folder() / "humanoid_hand.urdf").read_text()
    assert load_hand(write(tmp_path, text)).n == 20
    assert Path(urdf_folder() / "meshes" / "unit_sphere.stl").is_file()
    assert yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False).validate()


# -- what files are like -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings_comments_and_namespaces(tmp_path, encoding):
    text = urdf().replace("a_tip", "\u00e4_tip").replace('name="test"', 'name="test" xmlns="http://www.ros.org"')
    text = text.replace("<robot", "<!-- a comment, by hand \u00fc -->\n<robot", 1).replace(
        "</robot>", "<!-- end --></robot>"
    )
    if encoding == "latin-1":
        text = text.replace('version="1.0"', 'version="1.0" encoding="ISO-8859-1"')
    path = tmp_path / "hand.urdf"
    path.write_bytes(("\n\n" if encoding == "utf-8" else "").encode() + text.replace("\n", "\r\n").encode(encoding))
    assert load_hand(path).fingers[0].tip == "\u00e4_tip"


def test_what_is_no_robot_is_said(tmp_path):
    for text, message in (
        ("<sdf version='1.6'><model/></sdf>", "found <sdf>"),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>', "ending .xacro"),
    ):
        with pytest.raises(HandNotLoaded, match=message):
            load_hand(write(tmp_path, text))
    assert load_hand(urdf()).joint_names == load_hand(write(tmp_path, urdf())).joint_names
    for name in ("x" * 5000, "nul\0byte", "~nobody_at_all/hand.urdf", str(tmp_path), ""):
        with pytest.raises(HandNotLoaded, match="no such file"):
            load_hand(name)


@pytest.mark.parametrize(
    "arguments",
    [{"root": 5}, {"palm": ["base"]}, {"fingers": ["a"]}, {"limits": 3}, {"limits": {"j": None}}, {"pose": "up"}],
)
def test_arguments_of_the_wrong_kind(tmp_path, arguments):
    with pytest.raises(InvalidInput):
        load_hand(write(tmp_path, urdf()), **arguments)


def test_joints_and_links_may_share_names(tmp_path):
    """Frames are looked up among links first: in many hands a joint is called like another joint's link."""
    text = robot(
        "shared",
        link("base", 0.1, "box 1 1 1"),
        link("a", 0.1, "box 1 1 1"),
        link("b", 0.1, "box 1 1 1"),
        joint("b", "base", "a", "0 0 1", "0 0 1", "-1 1 1 1"),
        joint("a", "a", "b", "0 0 1", "0 1 0", "-1 1 1 1"),
    )
    hand = load_hand(write(tmp_path, text))
    assert hand.fingers[0].joints == ("b", "a") and hand.fingers[0].links == ("a", "b")
    assert hand.frame_placements([0, 0], ["a", "b"])[:, 2, 3].tolist() == [1, 2]
    assert hand.configuration({hand.fingers[0].name: [0.1, 0.2]}).tolist() == [0.1, 0.2]


def test_the_roots_inertia_counts_and_moves_with_the_hand(tmp_path):
    hand = load_hand(write(tmp_path, urdf().replace('<link name="base"/>', f'<link name="base">{INERTIAL}</link>')))
    assert hand.mass == pytest.approx(0.2) and hand.model.inertias[0].mass == 0.1
    pose = np.eye(4)
    pose[:3, 3] = [1, 2, 3]
    assert hand.placed(pose).model.inertias[0].lever.tolist() == [1, 2, 3]
    assert hand.model.inertias[0].lever.tolist() == [0, 0, 0]
    # A pose typed with few digits is taken as the nearest rotation; one that is none is refused.
    rough = np.round(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), 7)
    pose[:3, :3] = rough
    R = hand.placed(pose).pose[:3, :3]
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-15 and np.abs(R - rough).max() < 1e-7
    pose[3] = [0, 0, 1, 1]
    with pytest.raises(InvalidInput, match="last row"):
        hand.placed(pose)


def test_palm_joints_are_described_too(tmp_path):
    text = robot(
        "wristed",
        *(link(name, 0.1, "box 0.1 0.1 0.1") for name in ("arm", "palm", "a", "b")),
        joint("wrist", "arm", "palm", "0 0 1", "0 0 1", "-1 1 0 1"),
        joint("ja", "palm", "a", "0 0 1", "0 0 1", "0 1 2 1"),
        joint("jb", "palm", "b", "0 0 1", "1 0 0", "0 0.1 0 1", kind="prismatic"),
    )
    text = load_hand(write(tmp_path, text)).describe()
    assert "3 joints, 2 fingers on 'palm'" in text and "joints on no finger:" in text
    assert "wrist: -1.000 .. +1.000 rad, effort not given" in text
    assert "jb -> b: +0.000 .. +0.100 m, effort not given" in text
    assert "note: no effort limit (none given, or 0): wrist, jb" in text


def test_the_order_of_q_is_told_where_fingers_are_listed_in_another():
    hand = load_hand("allegro_right")
    told = next(line for line in hand.describe().splitlines() if line.strip().startswith("order of q"))
    assert told.partition(": ")[2].split(", ") == list(hand.joint_names)
    assert "order of q" not in load_hand("panda").describe()


# -- limits and joints of every kind -----------------------------------------------------------------------------------


def test_limits_without_effort_or_velocity(tmp_path):
    for limit, effort, velocity in (
        ('<limit lower="-1" upper="1"/>', 0, 0),
        ('<limit lower="-1" upper="1" effort="-3" velocity="nan"/>', 0, 0),
        ('<limit lower="-1" upper="1" effort="inf" velocity="2"/>', 0, 2),
        ('<limit lower=" -1e0 " upper="1" effort="2.5"/>', 2.5, 0),
        ('<limit lower="-1" upper="1" effort="1e308"/>', 0, 0),
    ):
        hand = load_hand(write(tmp_path, urdf(limit=limit)))
        assert hand.effort.tolist() == [effort] and hand.velocity.tolist() == [velocity]
        assert any("no effort limit" in note for note in hand.notes) == (not effort)
        assert [hand.lower[0], hand.upper[0]] == [-1, 1]


def test_continuous_joints_become_revolute(tmp_path):
    for limit in ("", '<limit effort="3" velocity="1"/>'):
        hand = load_hand(write(tmp_path, urdf(kind="continuous", limit=limit)))
        assert hand.model.nq == 1 and [hand.lower[0], hand.upper[0]] == pytest.approx([-math.pi, math.pi])
        assert any("continuous joints taken as revolute" in note and "j" in note for note in hand.notes)
        assert hand.effort[0] == (3 if limit else 0)


def test_axes_need_not_be_unit_vectors(tmp_path):
    for kind in ("revolute", "prismatic"):
        text = urdf(kind=kind)
        hand, plain = (load_hand(write(tmp_path, text.replace("0 0 1", axis))) for axis in ("0 3 4", "0 0.6 0.8"))
        tips = [one.frame_placements([0.5], ["a_tip"]) for one in (hand, plain)]
        assert np.abs(tips[0] - tips[1]).max() < 1e-15


def test_rotations_may_be_quaternions(tmp_path):
    q = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, -1.2, 2.5)).coeffs()
    text = urdf().replace('xyz="0.1 0 0"', f'xyz="0.1 0 0" quat_xyzw="{" ".join(map(repr, (3 * q).tolist()))}"')
    R = load_hand(write(tmp_path, text)).frame_placements([0.0], ["a_tip"])[0, :3, :3]
    assert np.abs(R - pin.rpy.rpyToMatrix(0.1, -1.2, 2.5)).max() < 1e-15
    with pytest.raises(HandNotLoaded, match="quat_xyzw=>: expected a rotation"):
        load_hand(write(tmp_path, urdf().replace('xyz="0.1 0 0"', 'quat_xyzw="0 0 0 0"')))


def on_an_arm(**parts):
    """base - arm (joint shoulder, carries a floating joint and a planar one beside the hand) - palm - two fingers."""
    text = {
        "arm": joint("shoulder", "base", "arm", "0 0 1", "0 1 0", "-1 1 1 1"),
        "arm_link": link("arm", 1, "box 0.1 0.1 1"),
        "wrist": joint("wrist", "arm", "palm", "0 0.2 1", rpy="0.1 0.2 0.3"),
        "palm": link("palm", 0.5, "box 0.1 0.1 0.1"),
        "loose": link("loose") + joint("free", "base", "loose", "0 0 0").replace("fixed", "floating"),
        "table": link("table") + joint("slip", "base", "table", "0 0 0").replace("fixed", "planar"),
        "one": link("one", 0.1, "box 0.01 0.01 0.1") + joint("j1", "palm", "one", "0.1 0 0", "0 1 0", "-1 1 1 1"),
        "two": link("two", 0.1, "box 0.01 0.01 0.1") + joint("j2", "palm", "two", "-0.1 0 0", "0 1 0", "-1 1 1 1"),
        **parts,
    }
    return robot("arm_and_hand", link("base"), *text.values())


def test_a_hand_on_an_arm_is_cut_out(tmp_path):
    path = write(tmp_path, on_an_arm())
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(path)
    assert len(caught.value.problems) == 1 and "joint 'slip' is planar" in str(caught.value)
    hand = load_hand(path, root="palm")
    assert hand.palm == "palm" and hand.joint_names == ("j1", "j2") and hand.mass == pytest.approx(0.7)
    assert hand.frame_placements([0, 0], ["palm", "one"])[:, :3, 3].tolist() == [[0, 0, 0], [0.1, 0, 0]]
    assert any("the sub-tree of 'palm' is the hand: 3 of 7 links" in note for note in hand.notes)
    # The robot's own root is a root as well; one finger is a hand; a leaf is none.
    whole = load_hand(write(tmp_path, on_an_arm(loose="", table=""), "arm.urdf"), root="base")
    assert whole.joint_names == ("shoulder", "j1", "j2") and whole.palm == "palm"
    assert load_hand(path, root="arm").joint_names == ("j1", "j2")
    with pytest.raises(HandNotLoaded, match="no revolute or prismatic joint beyond root 'one'"):
        load_hand(path, root="one")
    with pytest.raises(
        HandNotLoaded, match="root 'hand' is not a link; links: base, arm, palm, loose, table, one, two"
    ):
        load_hand(path, root="hand")


def test_what_is_wrong_elsewhere_does_not_matter_with_a_root(tmp_path):
    broken = on_an_arm(
        base2='<link name="second_root"/>',
        arm_link='<link name="arm"><inertial/></link>',
        more='<link name="x"/><joint name="x" type="revolute"><parent link="base"/><child link="x"/></joint>',
    )
    path = write(tmp_path, broken)
    assert load_hand(path, root="palm").n == 2
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(path)
    for words in (
        "one root link, found 2: base, second_root",
        "'arm': <inertial> needs both",
        "'x' has no position",
        "'free' floats",
        "'slip' is planar",
    ):
        assert words in str(caught.value)


def fork(**changes):
    """A palm with three fingers of one joint each, whose tips are told apart in three ways."""
    parts = [link("palm", 0.5, "box 0.1 0.1 0.1")]
    for i, name in enumerate(("f1", "f2", "f3")):
        parts += [
            link(f"{name}_base", 0.1, "box 0.01 0.01 0.1"),
            link(f"{name}_pad"),
            link(f"{name}_end"),
            joint(name, "palm", f"{name}_base", f"{i} 0 0", "0 1 0", "-1 1 1 1"),
            joint(f"{name}_e", f"{name}_base", f"{name}_end", "0 0 0.1"),
            joint(f"{name}_p", f"{name}_base", f"{name}_pad", "0 0.01 0.05"),
        ]
    return robot("fork", *parts).replace("f1_end", changes.get("end", "f1_end"))


def test_fingertips(tmp_path):
    assert [finger.tip for finger in load_hand(write(tmp_path, fork())).fingers] == ["f1_pad", "f2_pad", "f3_pad"]
    # One called tip is the tip; one that is named is the tip whatever it is called.
    assert load_hand(write(tmp_path, fork(end="f1_Tip"))).fingers[0].tip == "f1_Tip"
    assert load_hand(write(tmp_path, fork(end="multiple"))).fingers[0].tip == "f1_pad"
    hand = load_hand(write(tmp_path, fork()), fingers={"a": "f1_end", "b": "f2_base", "c": "f3_pad"})
    assert [finger.tip for finger in hand.fingers] == ["f1_end", "f2_pad", "f3_pad"]
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, fork()), fingers={"a": "f1_end", "b": "f9", "c": "palm"})
    assert len(caught.value.problems) == 2 and "'b': link 'f9' is on no finger" in str(caught.value)


def test_a_link_of_several_fingers_does_not_tell_them_apart(tmp_path):
    parts = [link(name, 0.1, "box 0.1 0.1 0.1") for name in ("palm", "shared", "a", "b", "c")]
    joints = [
        joint(f"j_{child}", parent, child, "0 0 1", "0 1 0", "-1 1 1 1")
        for parent, child in (("palm", "shared"), ("shared", "a"), ("shared", "b"), ("palm", "c"))
    ]
    path = write(tmp_path, robot("forked", *parts, *joints))
    assert [finger.name for finger in load_hand(path).fingers] == ["a", "b", "c"]
    assert load_hand(path, fingers={"x": "a"}).fingers[0].joints == ("j_shared", "j_a")
    with pytest.raises(HandNotLoaded, match="'shared' is on several fingers; name one of their tips: a, b"):
        load_hand(path, fingers={"x": "shared"})


@pytest.mark.slow
def test_a_long_chain_needs_no_recursion(tmp_path):
    n = 1200
    parts = [link("l0"), *(link(f"l{i}", 0.1, "box 1 1 1") for i in range(1, n + 1))]
    joints = [
        joint(f"j{i}", f"l{i - 1}", f"l{i}", "0 0 0.01", "0 1 0" if i == n else "", "-1 1 1 1" if i == n else "")
        for i in range(1, n + 1)
    ]
    assert load_hand(write(tmp_path, robot("chain", *parts, *joints))).fingers[0].tip == f"l{n}"


@pytest.mark.slow
def test_more_than_any_robot_has_is_refused_at_once(tmp_path):
    """A chain of 3,000 joints took half a minute."""
    n = 3000
    parts = [link("l0"), *(link(f"l{i}", 0.1, "box 1 1 1") for i in range(1, n + 1))]
    joints = [joint(f"j{i}", f"l{i - 1}", f"l{i}", "0 0 0.01", "0 1 0", "-1 1 1 1") for i in range(1, n + 1)]
    for text, message in (
        (robot("chain", *parts, *joints), "at most 2000 links, got 3001"),
        (robot("chain", *parts[:1000], *joints[:999]), "at most 100 moving joints .*, got 999"),
        (
            robot("many", *(one.replace("</link>", "<collision/>" * 3000 + "</link>") for one in parts[:2]), joints[0]),
            "at most 2000 collision shapes",
        ),
        ("<!DOCTYPE robot [<!ENTITY e 'x'>]>" + urdf()[21:], "entity declarations are not allowed"),
        (
            urdf().replace("<robot", '<?xml version="1.0" encoding="punycode"?><robot')[21:],
            "encoding 'punycode' is not supported",
        ),
    ):
        with pytest.raises(HandNotLoaded, match=message):
            load_hand(write(tmp_path, text))


def test_a_chain_as_long_as_is_allowed_loads(tmp_path):
    n = 100
    parts = [link("l0"), *(link(f"l{i}", 0.1, "box 1 1 1") for i in range(1, n + 1))]
    joints = [joint(f"j{i}", f"l{i - 1}", f"l{i}", "0 0 0.01", "0 1 0", "-1 1 1 1") for i in range(1, n + 1)]
    assert load_hand(write(tmp_path, robot("chain", *parts, *joints))).n == n


def test_a_hand_that_reaches_too_far_is_refused(tmp_path):
    parts = [link("l0"), *(link(f"l{i}", 0.1, "box 1 1 1") for i in range(1, 4))]
    joints = [joint(f"j{i}", f"l{i - 1}", f"l{i}", "0 0 900", "0 1 0", "-1 1 1 1") for i in range(1, 4)]
    with pytest.raises(HandNotLoaded, match="reaches farther than 1000 m"):
        load_hand(write(tmp_path, robot("long", *parts, *joints)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('xyz="0 0 1"', 'xyz="0 0 1e-320"'), "<axis xyz=> is zero"),
        (('xyz="0 0 1"', 'xyz="0 0 1e308"'), "<axis xyz=>: expected numbers of at most 1e"),
        (('xyz="0.1 0 0"', 'xyz="1e308 0 0"'), "<origin xyz=>: expected numbers of at most 1000"),
        (('xyz="0.1 0 0"', 'rpy="1e308 0 0"'), "<origin rpy=>: expected numbers of at most"),
        (('xyz="0.1 0 0"', 'quat_xyzw="1e-320 0 0 0"'), "expected a rotation"),
        (('xyz="0.1 0 0"', 'quat_xyzw="1e308 1e308 0 0"'), "numbers of at most"),
        (('value="0.1"', 'value="1e308"'), "<mass value=>: expected a number of at most"),
        (('ixx="1e-5"', 'ixx="1e300"'), "<inertia ixx=>: expected a number of at most"),
        (('upper="1"', 'upper="1e308"'), "limit -1 is not below upper 1e+308, or beyond"),
        (('lower="-1" upper="1"', 'lower="0" upper="1e-320"'), "not below"),
        (('effort="1"', 'effort="1e-320"'), "effort limit 9.99989e-321 is next to nothing"),
        (('velocity="1"', 'velocity="1e-320"'), "velocity limit 9.99989e-321 is next to nothing"),
        (("<axis", '<dynamics armature="1e308"/><axis'), "<dynamics armature=>: expected a number of at most"),
        (('name="j" type', "type"), "1 <joint> without a name"),
        (('<link name="a_tip"/>', '<link name="a_tip"/><link/>'), "1 <link> without a name"),
        (('name="j" type', 'name="universe" type'), "joint 'universe': Pinocchio keeps that name"),
        (('type="revolute"', ""), "joint 'j' is without a type"),
        (('type="revolute"', 'type="planar"'), "joint 'j' is planar"),
        (('xyz="0 0 1"', 'xyz="0 0 0"'), "joint 'j': <axis xyz=> is zero, expected a direction"),
        (('xyz="0 0 1"', 'xyz="0 1"'), "joint 'j': <axis xyz=>: expected 3 finite numbers, got '0 1'"),
        (('xyz="0.1 0 0"', 'xyz="0.1 nan 0"'), "joint 'tip': <origin xyz=>: expected 3 finite numbers"),
        (('xyz="0.1 0 0"', 'xyz="0.1, 0, 0"'), "expected 3 finite numbers, got '0.1, 0, 0'"),
        (('upper="1"', 'upper="one"'), "joint 'j': limits must be numbers"),
        (('upper="1"', 'upper="inf"'), "lower limit -1 is not below upper inf"),
        (('upper="1"', 'upper="-1"'), "lower limit -1 is not below upper -1"),
        (('<mass value="0.1"/>', "<mass/>"), "link 'a': <inertial> lacks value"),
        (('ixx="1e-5" ', ""), "link 'a': <inertial> lacks ixx"),
        (('ixy="0"', 'ixy="1"'), "not positive semi-definite"),
        (('ixy="0"', 'ixy="x"'), "link 'a': <inertia ixy=>: expected 1 finite number, got 'x'"),
        (('<child link="a_tip"/>', ""), "joint 'tip' names the unknown link ''"),
        (('<child link="a_tip"/>', '<child link="a"/>'), "link 'a' has several parent joints"),
        (('<parent link="base"/>', '<parent link="a_tip"/>'), "hang on each other in a loop: a, a_tip"),
    ],
)
def test_broken_parts_are_named(tmp_path, change, message):
    assert change[0] in urdf()
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, urdf().replace(*change)))
    assert message in str(caught.value)


def test_problems_of_every_kind_come_in_one_error(tmp_path):
    text = urdf(
        links='<link name="a"/><link name="loose"/>',
        limit="",
        first=INERTIAL.replace('ixx="1e-5"', 'ixx="-1"'),
        joints='<joint name="m" type="revolute"><parent link="a"/><child link="ghost"/><axis xyz="0 0 0"/>'
        '<limit lower="2" upper="1"/></joint>'
        '<joint name="n" type="revolute"><parent link="a"/><child link="ghost"/>'
        '<mimic joint="nobody"/></joint>',
    )
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, text))
    problems = "; ".join(caught.value.problems)
    for words in (
        "link 'a' is defined 2 times",
        "one root link",
        "unknown link 'ghost'",
        "'j' has no position limits",
        "<axis xyz=> is zero",
        "not below",
        "unknown joint 'nobody'",
        "semi-definite",
    ):
        assert words in problems


# -- collision geometry and masses -------------------------------------------------------------------------------------


def shaped(*geometries, first=INERTIAL):
    """The smallest hand with these <geometry> contents on its link."""
    collisions = "".join(
        f'<collision><origin xyz="0 0 {i}"/><geometry>{one}</geometry></collision>' for i, one in enumerate(geometries)
    )
    return urdf(first=first + collisions)


def test_shapes_are_exact_and_several_per_link(tmp_path):
    hand = load_hand(
        write(
            tmp_path,
            shaped(
                '<box size="0.1 0.2 0.3"/>',
                '<sphere radius="0.1"/>',
                '<cylinder radius="0.1" length="0.4"/>',
                '<capsule radius="0.1" length="0.4"/>',
            ),
        )
    )
    box, sphere, cylinder, capsule = (one.geometry for one in hand.geometry.geometryObjects)
    assert isinstance(box, coal.Box) and box.halfSide.ravel().tolist() == [0.05, 0.1, 0.15]
    assert isinstance(sphere, coal.Sphere) and sphere.radius == 0.1
    assert isinstance(cylinder, coal.Cylinder) and (cylinder.radius, cylinder.halfLength) == (0.1, 0.2)
    assert isinstance(capsule, coal.Capsule) and (capsule.radius, capsule.halfLength) == (0.1, 0.2)
    assert [one.placement.translation[2] for one in hand.geometry.geometryObjects] == [0, 1, 2, 3]
    assert [one.name for one in hand.geometry.geometryObjects] == ["a_0", "a_1", "a_2", "a_3"]


def test_shapes_without_size_are_left_out_and_noted(tmp_path):
    hand = load_hand(
        write(
            tmp_path,
            shaped(
                '<box size="0 0 0"/>',
                '<sphere radius="-1"/>',
                '<cone radius="1"/>',
                "",
                '<cylinder radius="1"/>',
                '<sphere radius="0.1"/>',
            ),
        )
    )
    assert len(hand.geometry.geometryObjects) == 1
    note = next(note for note in hand.notes if note.startswith("shapes left out"))
    assert note.count("a (") == 5 and "no known shape" in note
    assert any("nothing of this hand can touch" in note for note in load_hand(write(tmp_path, urdf())).notes)


def meshes(folder, *names):
    block = trimesh.creation.box((0.02, 0.03, 0.05))
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        block.export(folder / name)


FOUND = {
    "package://my_hand/meshes/a.stl": "my_hand/meshes/a.stl",
    "package:///my_hand/meshes/a.stl": "my_hand/meshes/a.stl",
    "package://other_name/meshes/a.stl": "my_hand/meshes/a.stl",
    "model://my_hand/meshes/a.stl": "my_hand/meshes/a.stl",
    "../meshes/a.stl": "my_hand/meshes/a.stl",
    "..\\meshes\\a.stl": "my_hand/meshes/a.stl",
    "my meshes/b one.stl": "my_hand/urdf/my meshes/b one.stl",
    "my%20meshes/b%20one.stl": "my_hand/urdf/my meshes/b one.stl",
    "file://{folder}/my_hand/meshes/a.stl": "my_hand/meshes/a.stl",
    "{folder}/my_hand/meshes/a.stl": "my_hand/meshes/a.stl",
    "package://elsewhere/c.obj": "share/elsewhere/c.obj",
}


@pytest.mark.parametrize("name", FOUND)
def test_meshes_are_found(tmp_path, monkeypatch, name):
    monkeypatch.setenv("ROS_PACKAGE_PATH", os.pathsep.join([str(tmp_path / "share"), "", "/nowhere"]))
    meshes(tmp_path, FOUND[name])
    folder = tmp_path / "my_hand" / "urdf"
    folder.mkdir(parents=True, exist_ok=True)
    mesh = f'<mesh filename="{name.format(folder=tmp_path)}" scale="1 2 1"/>'
    hand = load_hand(write(folder, shaped(mesh)), hulls=False)
    (one,) = hand.geometry.geometryObjects
    assert Path(one.meshPath) == tmp_path / FOUND[name] and one.meshScale.tolist() == [1, 2, 1]
    assert np.abs(np.ptp(one.geometry.vertices(), axis=0) - [0.02, 0.06, 0.05]).max() < 1e-7


@pytest.mark.parametrize(
    "name",
    ["gone.stl", "package://nobody/x.stl", "package://", "", ".", "C:\\meshes\\a.stl", "x" * 3000, "http://a/b.stl"],
)
def test_missing_meshes_are_left_out_and_noted(tmp_path, name):
    hand = load_hand(write(tmp_path, shaped(f'<mesh filename="{name}"/>', '<sphere radius="0.1"/>')))
    assert len(hand.geometry.geometryObjects) == 1
    assert any("meshes not found" in note and f"a ({name})" in note for note in hand.notes)


BROKEN_MESHES = {
    "empty.stl": b"",
    "noise.stl": bytes(range(256)),
    "cut.stl": b"solid x\nfacet normal 0 0 1\n outer loop\n",
    "short.stl": b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100,
    "bad.obj": b"v 0 0\nf 1 2 3",
    "far.obj": b"v 0 0 0\nf 1 2 9\n",
    "empty.dae": b"<COLLADA/>",
    "unknown.xyz": b"1 2 3",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "points.obj": b"v 0 0 0\nv 1 0 0\n",
    "none.obj": b"",
}


@pytest.mark.parametrize("name", BROKEN_MESHES)
def test_broken_meshes_are_left_out_and_noted(tmp_path, name):
    (tmp_path / name).write_bytes(BROKEN_MESHES[name])
    hand = load_hand(write(tmp_path, shaped(f'<mesh filename="{name}"/>', '<sphere radius="0.1"/>')))
    assert [type(one.geometry).__name__ for one in hand.geometry.geometryObjects] == ["Sphere"]
    assert any("meshes that cannot be read" in note and name in note for note in hand.notes)


def test_a_changed_mesh_is_read_again(tmp_path):
    meshes(tmp_path, "a.stl")
    path = write(tmp_path, shaped('<mesh filename="a.stl"/>'))
    assert np.ptp(load_hand(path, hulls=False).geometry.geometryObjects[0].geometry.vertices()[:, 2]) == pytest.approx(
        0.05
    )
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "a.stl")
    os.utime(tmp_path / "a.stl", ns=(1, 1))
    assert np.ptp(load_hand(path, hulls=False).geometry.geometryObjects[0].geometry.vertices()[:, 2]) == pytest.approx(
        1.0
    )


@pytest.mark.parametrize("times", [1.0, 1000.0])
def test_meshes_in_millimetres_are_taken_as_such(tmp_path, times):
    trimesh.creation.box(times * np.array([0.02, 0.03, 0.05])).export(tmp_path / "a.stl")
    collision = '<collision><geometry><mesh filename="a.stl"/></geometry></collision>'
    visual = '<visual><geometry><mesh filename="a.stl"/></geometry></visual>'
    second = f'<link name="b">{INERTIAL}{collision}{visual}</link>'
    joint = """<joint name="k" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.04 0 0"/>
      <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
    path = write(tmp_path, urdf(links=second, joints=joint, first=INERTIAL + collision))
    hand = load_hand(path, hulls=False)
    for one in hand.geometry.geometryObjects:
        assert np.ptp(one.geometry.vertices(), axis=0) == pytest.approx([0.02, 0.03, 0.05])
        assert one.meshScale == pytest.approx(np.full(3, 1 / times))
    assert hand.visuals[0].size == pytest.approx(np.full(3, 1 / times))
    assert any("millimetres" in note for note in hand.notes) == (times > 1)


def test_ellipsoids_are_exact_only_where_the_mesh_is_the_unit_sphere(tmp_path):
    mesh = '<mesh filename="unit_sphere.stl" scale="0.1 -0.2 0.3"/>'
    for radius, kind in ((None, coal.Ellipsoid), (1.0, coal.Ellipsoid), (0.5, coal.BVHModelOBBRSS)):
        if radius:
            trimesh.creation.icosphere(radius=radius).export(tmp_path / "unit_sphere.stl")
            os.utime(tmp_path / "unit_sphere.stl", ns=(int(1e9 * radius),) * 2)
        (one,) = load_hand(write(tmp_path, shaped(mesh)), hulls=False).geometry.geometryObjects
        assert isinstance(one.geometry, kind)
        if kind is coal.Ellipsoid:
            assert one.geometry.radii.ravel().tolist() == [0.1, 0.2, 0.3] and one.meshPath == ""


NOTHING = INERTIAL.replace('"0.1"', '"0"').replace("1e-5", "0")


@pytest.mark.parametrize("first", ["", NOTHING])
def test_masses_are_filled_in_from_shapes(tmp_path, first):
    """1000 kg/m^3: a box of 2 x 3 x 5 cm is 30 g; a sphere of 1 cm beside it 4.19 g."""
    hand = load_hand(write(tmp_path, shaped('<box size="0.02 0.03 0.05"/>', '<sphere radius="0.01"/>', first=first)))
    inertia = hand.model.inertias[1]
    box, ball = 0.03, 4 / 3 * math.pi * 1e-6 * 1000
    assert inertia.mass == pytest.approx(box + ball, rel=1e-12)
    assert inertia.lever[2] == pytest.approx(ball / (box + ball), rel=1e-12)
    assert inertia.inertia[2, 2] == pytest.approx(box / 12 * (0.02**2 + 0.03**2) + 0.4 * ball * 1e-4, rel=1e-9)
    assert any("taken from the geometry at 1000 kg/m^3: j 34.2 g" in note for note in hand.notes)


def without_mass(text, name):
    """A description without the inertial of one link."""
    start = text.index("<inertial>", text.index(f'<link name="{name}"'))
    return text[:start] + text[text.index("</inertial>", start) + len("</inertial>") :]


def test_a_mass_that_was_forgotten_is_that_of_the_shape(tmp_path):
    """Only of the link that lacks one, and noted."""
    text = on_an_arm(loose="", table="")
    whole, hand = load_hand(write(tmp_path, text)), load_hand(write(tmp_path, without_mass(text, "one"), "other.urdf"))
    assert any("taken from the geometry at 1000 kg/m^3: j1 10.0 g" in note for note in hand.notes)
    j = whole.model.getJointId("j1")
    masses = [[inertia.mass for inertia in one.model.inertias] for one in (hand, whole)]
    assert masses[0][j] == pytest.approx(1000 * 0.01 * 0.01 * 0.1)
    assert [k for k, (a, b) in enumerate(zip(*masses)) if a != b] == [j]


def test_a_link_without_mass_and_shape_is_massless_where_its_joint_moves_others(tmp_path):
    bare = {"loose": "", "table": "", "one": link("one") + joint("j1", "palm", "one", "0.1 0 0", "0 1 0", "-1 1 1 1")}
    further = link("tip", 0.05, "sphere 0.01") + joint("j3", "one", "tip", "0 0 0.1", "0 1 0", "-1 1 1 1")
    hand = load_hand(write(tmp_path, on_an_arm(**bare, more=further)))
    assert any("so massless: j1" in note for note in hand.notes)
    assert hand.model.inertias[hand.model.getJointId("j1")].mass == 0
    with pytest.raises(HandNotLoaded, match="joint 'j1' moves no mass at all"):
        load_hand(write(tmp_path, on_an_arm(**bare)))


def test_joints_without_a_way_to_go_are_fixed_where_they_are(tmp_path):
    further = joint("j3", "one", "tip", "0 0 0.1", "0 1 0", "-1 1 1 1") + link("tip", 0.1, "sphere 0.01")
    text = on_an_arm(loose="", table="", more=further)
    free = load_hand(write(tmp_path, text))
    start = text.index('<limit lower="-1" upper="1"', text.index('name="j3"'))
    locked = text[:start] + text[start:].replace('lower="-1" upper="1"', 'lower="0.4" upper="0.4"', 1)
    hand = load_hand(write(tmp_path, locked, "locked.urdf"))
    assert hand.joint_names == tuple(name for name in free.joint_names if name != "j3")
    assert "joints without travel are fixed: j3" in hand.notes
    q = free.configuration({})
    q[free.joint_names.index("j3")] = 0.4
    expected = free.frame_placements(q, ["tip"])
    assert hand.frame_placements(np.zeros(hand.n), ["tip"]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("mesh", ["closed", "inside out", "open", "mirrored"])
def test_masses_of_meshes(tmp_path, mesh):
    """A ring is a ring however its faces are turned; one that is not closed counts as its hull."""
    body = trimesh.creation.annulus(0.01, 0.03, 0.02)
    body.apply_transform(trimesh.transformations.compose_matrix(angles=[0.1, 0.2, 0.3], translate=[0.1, 0.2, 0.3]))
    solid = body.convex_hull if mesh == "open" else body.copy()
    if mesh == "inside out":
        body.invert()
    if mesh == "open":
        body.update_faces(np.arange(len(body.faces)) > 1)
    body.export(tmp_path / "a.stl")
    scale = "-1 1 1" if mesh == "mirrored" else "1 1 1"
    inertia = load_hand(write(tmp_path, shaped(f'<mesh filename="a.stl" scale="{scale}"/>', first=""))).model.inertias[
        1
    ]
    exact = 0.02 * math.pi * (0.03**2 - (0.0 if mesh == "open" else 0.01**2))
    assert inertia.mass == pytest.approx(1000 * exact, rel=1e-2)  # a ring of 32 edges
    assert inertia.mass == pytest.approx(1000 * solid.volume, rel=1e-5)  # files hold single precision
    mirror = np.diag([-1.0, 1, 1]) if mesh == "mirrored" else np.eye(3)
    assert np.abs(inertia.lever - mirror @ solid.center_mass).max() < 1e-7
    expected = mirror @ (1000 * solid.moment_inertia) @ mirror
    assert np.abs(inertia.inertia - expected).max() < 1e-5 * np.abs(expected).max()


def test_links_that_nothing_gives_a_mass(tmp_path):
    meshes(tmp_path, "a.stl")
    (tmp_path / "broken.stl").write_bytes(b"")
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    flat.export(tmp_path / "flat.stl")
    for name in ("broken.stl", "flat.stl", "gone.stl"):
        with pytest.raises(HandNotLoaded, match="joint 'j' moves no mass at all"):
            load_hand(write(tmp_path, shaped(f'<mesh filename="{name}"/>', first="")))
    assert load_hand(write(tmp_path, shaped('<mesh filename="a.stl"/>', first=""))).mass == pytest.approx(
        0.03, rel=1e-6
    )


@pytest.mark.parametrize(
    "content",
    [
        b'<?xml version="1.0" encoding="latin-1"?><robot name="\xe4"/>',
        b'<robot name="\xe4\xff"/>',
        "<robot/>".encode("utf-16"),
        b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"><xacro:m/></xacro:macro>'
        b"<xacro:m/></robot>",
        b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="hand.xacro"/></robot>',
        b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property value="1"/></robot>',
        b"",
    ],
)
@pytest.mark.parametrize("trusted", [False, True])
def test_xacro_files_that_break_xacro(tmp_path, content, trusted):
    (tmp_path / "hand.xacro").write_bytes(content)
    encoded = content.startswith((b"<?xml", b"\xff\xfe"))  # xacro itself reads UTF-8 only
    with pytest.raises(
        HandNotLoaded, match="no <link> found" if encoded and not trusted else "xacro could not expand it"
    ):
        load_hand(tmp_path / "hand.xacro", trusted=trusted)


@pytest.mark.parametrize("trusted", [False, True])
def test_macros_that_are_called_as_xacro_took_them_once_are_told(tmp_path, trusted):
    """Xacro leaves such elements as they are, which URDF does not know: nothing would move."""
    joint = '<joint name="j" type="revolute"><parent link="p"/><child link="f"/><limit lower="0" upper="1" effort="1"/></joint>'
    parts = f'<link name="f">{INERTIAL}</link>{joint}'
    text = (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="finger" params="n">{}</xacro:macro>'
    )
    path = tmp_path / "hand.urdf.xacro"
    path.write_text(text.format(parts) + '<link name="p"/><finger n="1"/></robot>')
    with pytest.raises(HandNotLoaded, match="before 2018: write <xacro:finger> for finger"):
        load_hand(path, trusted=trusted)
    path.write_text(text.format(parts) + '<link name="p"/><xacro:finger n="1"/><finger/></robot>')
    assert load_hand(path, trusted=trusted).joint_names == ("j",)


def test_points_of_hulls_are_those_of_the_meshes():
    """They reach as far in every direction as the meshes, whether or not the hulls were taken already."""
    rng = np.random.default_rng(2)
    hand, meshes = (load_hand("psyonic_left", hulls=hulls) for hulls in (True, False))
    for one, own in zip(hand.geometry.geometryObjects, meshes.geometry.geometryObjects):
        points, corners = hull_points(one.geometry), own.geometry.vertices()
        towards = rng.normal(size=(3, 20))
        assert (points @ towards).max(axis=0) == pytest.approx((corners @ towards).max(axis=0), abs=1e-9)
        assert hull_points(own.geometry) == pytest.approx(points, abs=1e-12)


def test_bars_of_a_linkage_are_no_fingers(tmp_path):
    path = write(tmp_path, parallel_gripper())
    hand = load_hand(path)
    assert [finger.name for finger in hand.fingers] == ["left", "right"]
    assert any("not fingers: left_inner_knuckle, right_inner_knuckle" in note for note in hand.notes)
    # The bars overlap the fingers that they carry, which no motion of the one motor can change.
    for share in np.linspace(0, 1, 5):
        assert not SelfCollisions(hand).at(hand.lower + share * (hand.upper - hand.lower))
    assert not any(SelfCollisions(load_hand("baxter_left")).at(np.array([q])) for q in (0.0, 0.01, 0.02))  # by design
    named = load_hand(path, fingers={"left": "left_finger", "bar": "left_inner_knuckle"})
    assert [finger.name for finger in named.fingers] == ["left", "bar"]


def test_bars_that_nothing_moves_are_no_fingers_either(tmp_path):
    """Their joints follow none, and have no motor: the file leaves it to a simulation's contacts to move them."""
    text, ends = parallel_gripper(), {"left": 'lower="-0.2" upper="0.8"', "right": 'lower="-0.8" upper="0.2"'}
    for side, limits in ends.items():
        bar = re.search(f'<joint name="{side}_bar".*', text)[0]
        text = text.replace(bar, re.sub("<mimic[^>]*>", "", bar).replace('lower="-1" upper="1"', limits))
    motor = '<transmission name="t"><joint name="left_knuckle"/><actuator name="m"/></transmission></robot>'
    hand = load_hand(write(tmp_path, text.replace("</robot>", motor)))
    assert [finger.name for finger in hand.fingers] == ["left", "right"]
    assert set(hand.passive_joints) == {"left_bar", "right_bar"}
    for share in np.linspace(0, 1, 5):  # a pin joins them
        assert not SelfCollisions(hand).at(hand.lower + share * (hand.upper - hand.lower))
    # With a motor each, which is what a file without motors is taken to have, they may be fingers.
    assert len(load_hand(write(tmp_path, text)).fingers) == 4


def test_a_matrix_that_is_a_little_off_is_mended_and_noted(tmp_path):
    """Moments 1e-5 and a product of 1.05e-5: one principal moment is -5e-7, and is taken as 0; the others stay."""
    hand = load_hand(write(tmp_path, urdf(first=INERTIAL.replace('ixy="0"', 'ixy="1.05e-5"'))))
    assert any("negative moment, which is taken as 0: a" in note for note in hand.notes)
    inertia = hand.model.inertias[1].inertia
    assert np.sort(np.linalg.eigvalsh(inertia)) == pytest.approx([0.0, 1e-5, 2.05e-5], abs=1e-12)


def on_a_robot(*before):
    """Two hands of two fingers each, on arms of the given joints."""
    parts = [link("base", 1, "box 0.2 0.2 0.2")]
    for side, y in (("left", 0.3), ("right", -0.3)):
        last = "base"
        for name in before:
            one = f"{side}_{name}"
            parts += [
                link(one, 0.5, "cylinder 0.03 0.2"),
                joint(f"{one}_joint", last, one, f"0 {y} 0.2", "0 1 0", "-1 1 9 1"),
            ]
            last, y = one, 0.0
        palm = f"{side}_palm"
        parts += [link(palm, 0.3, "box 0.08 0.08 0.02"), joint(f"{side}_mount", last, palm, f"0 {y} 0.2")]
        for finger, x in (("one", 0.04), ("two", -0.04)):
            parts += [
                link(f"{side}_{finger}", 0.05, "box 0.01 0.02 0.08", "0 0 0.04"),
                joint(f"{side}_{finger}_joint", palm, f"{side}_{finger}", f"{x} 0 0.01", "0 1 0", "-0.5 0.5 3 2"),
            ]
    return robot("two_armed", *parts)


def test_hands_of_a_robot_are_named_as_roots(tmp_path):
    whole = load_hand(write(tmp_path, on_a_robot("shoulder", "elbow", "forearm", "wrist")))
    (note,) = (note for note in whole.notes if note.startswith(ON_ROOT))
    assert {"left_palm", "right_palm"} == set(note.split("root= ")[1].split(" or "))
    hand = load_hand(whole.source, root="left_palm")
    assert not any(note.startswith(ON_ROOT) for note in hand.notes) and hand.palm == "left_palm"
    wrist = load_hand(whole.source, root="left_shoulder")  # three joints before the palm may be a wrist's
    assert not any(note.startswith(ON_ROOT) for note in wrist.notes)


@pytest.mark.parametrize(("height", "inside"), [(0.5, True), (0.02, False)])
def test_a_box_that_a_hand_stands_in_is_noted_with_the_root_that_leaves_it_out(tmp_path, height, inside):
    parts = [
        link("base", 1, f"box 0.5 0.5 {height}", f"0 0 {height / 2 - 0.02}"),
        link("palm", 0.3, "box 0.08 0.08 0.02"),
    ]
    parts.append(joint("mount", "base", "palm", "0 0 0.02"))
    for name, x in (("one", 0.04), ("two", -0.04)):
        parts += [
            link(name, 0.05, "box 0.01 0.02 0.08", "0 0 0.04"),
            joint(f"{name}_joint", "palm", name, f"{x} 0 0.01", "0 1 0", "-0.5 0.5 3 2"),
        ]
    hand = load_hand(write(tmp_path, robot("on_a_box", *parts)))
    assert hand.palm == "palm" and any("inside 'base'" in note for note in hand.notes) == inside
    alone = load_hand(hand.source, root="palm")
    assert not any("are inside" in note for note in alone.notes)


def test_an_arm_before_the_palm_is_noted_with_the_root_to_give(tmp_path):
    limbs = ["shoulder", "upper", "elbow", "forearm", "wrist"]
    arm = load_hand(write(tmp_path, on_a_robot(*limbs)), root="left_shoulder")
    note = "root: 4 joints, those of an arm, come before the palm 'left_palm': root='left_palm' loads the hand alone"
    assert note in arm.notes


def test_the_root_to_give_has_the_joints_that_fingers_follow(tmp_path):
    sides = []
    for side in ("left", "right"):
        wrist, palm, slide = f"{side}_wrist", f"{side}_palm", f"{side}_slide"
        sides += [
            joint(f"{side}_arm", "body", wrist, "0 0 1", "0 1 0", "-1 1 5 1"),
            link(wrist, 1, "box 0.1 0.1 0.1"),
            joint(slide, wrist, palm, "0 0 0.1", "0 0 1", "0 0.01 5 1", kind="prismatic"),
            link(palm, 1, "box 0.1 0.1 0.02"),
        ]
        for jaw in (f"{side}_a", f"{side}_b"):
            sides += [
                joint(f"{jaw}_turn", palm, jaw, "0 0 0.05", "0 1 0", "-1 1 5 1", mimic=f"{slide} 10 0"),
                link(jaw, 0.1, "cylinder 0.01 0.05"),
            ]
    whole = load_hand(write(tmp_path, robot("two", link("body", 1, "box 0.1 0.1 0.1"), *sides)))
    (note,) = (note for note in whole.notes if note.startswith(ON_ROOT))
    assert {"left_wrist", "right_wrist"} == set(note.split("root= ")[1].split(" or "))
    hand = load_hand(whole.source, root="left_wrist")
    assert hand.joint_names == ("left_slide",) and hand.palm == "left_palm"


def test_an_arm_on_a_robot_with_legs_is_told_apart(tmp_path):
    """The legs part at the body, as fingers do at a palm; an arm with one jaw starts there, too."""
    parts = [link("body", 10, "box 0.8 0.2 0.15")]
    for i, (x, y) in enumerate(((0.3, 0.1), (0.3, -0.1), (-0.3, 0.1), (-0.3, -0.1))):
        last = "body"
        for part, z in (("hip", "0"), ("thigh", "0.05"), ("shin", "0.3")):
            at = f"{x} {y} 0" if last == "body" else f"0 0 -{z}"
            parts += [
                link(f"{part}{i}", 1, "cylinder 0.03 0.3", "0 0 -0.15"),
                joint(f"{part}{i}_joint", last, f"{part}{i}", at, "0 1 0", "-1 1 40 9"),
            ]
            last = f"{part}{i}"
    last = "body"
    for i in range(7):
        parts += [
            link(f"arm{i}", 0.5, "cylinder 0.03 0.15", "0 0 0.07"),
            joint(f"arm{i}_joint", last, f"arm{i}", "0 0 0.15", "0 1 0", "-1 1 40 9"),
        ]
        last = f"arm{i}"
    whole = load_hand(write(tmp_path, robot("spot", *parts)))
    (note,) = (note for note in whole.notes if note.startswith(ON_ROOT))
    assert "7 joints" in note and "root='arm5'" in note
    assert load_hand(whole.source, root="arm5").joint_names == ("arm6_joint",)


def test_an_arm_with_one_jaw_is_told_apart(tmp_path):
    parts, last = [link("base", 1, "box 0.1 0.1 0.1")], "base"
    for i in range(6):
        parts += [
            link(f"link{i}", 0.1, "cylinder 0.02 0.1", "0 0 0.05"),
            joint(f"joint{i}", last, f"link{i}", "0 0 0.1", "0 1 0", "-1 1 5 1"),
        ]
        last = f"link{i}"
    arm = load_hand(write(tmp_path, robot("arm", *parts)))
    (note,) = (note for note in arm.notes if note.startswith(ON_ROOT))
    assert "6 joints" in note and "root='link4'" in note
    jaw = load_hand(write(tmp_path, robot("arm", *parts)), root="link4")
    assert jaw.joint_names == ("joint5",) and not any(note.startswith(ON_ROOT) for note in jaw.notes)


@pytest.mark.parametrize(
    ("links", "names"),
    [
        ((("thumb_base", "a"), ("index_base", "b")), ["thumb", "index"]),  # the first part of each says it
        ((("trumb_link0", "trumb_link1"), ("index_link0", "index_link1")), ["thumb", "index"]),  # Linker's L25
        ((("a", "thtip"), ("b", "fftip")), ["thumb", "index"]),  # the tips do
        ((("index_base", "index_middle"), ("middle_base", "middle_middle")), ["index", "middle"]),
        ((("little_base", "pinky_end"), ("medium_base", "a")), ["pinky", "middle"]),
        ((("thumb_base", "a"), ("thumb_end", "b")), ["a", "b"]),  # the same twice
        ((("thumb_base", "a"), ("c", "b")), ["a", "b"]),  # one says nothing
        ((("robot0:l_one", "robot0:l_two"), ("robot0:r_one", "robot0:r_two")), ["l", "r"]),
    ],
)
def test_fingers_are_called_what_some_of_their_parts_say(tmp_path, links, names):
    parts = [link("palm", 1, "box 0.1 0.1 0.02")]
    for i, (inner, outer) in enumerate(links):
        parts += [
            link(inner, 0.1, "cylinder 0.01 0.05"),
            link(outer, 0.1, "cylinder 0.01 0.05"),
            joint(f"j{i}a", "palm", inner, f"{0.05 * i} 0 0", "0 1 0", "-1 1 5 1"),
            joint(f"j{i}b", inner, outer, "0 0 0.05", "0 1 0", "-1 1 5 1"),
        ]
    assert [finger.name for finger in load_hand(write(tmp_path, robot("hand", *parts))).fingers] == names


def test_motors_of_an_arm_alone_leave_the_fingers_one_each(tmp_path):
    driven = "".join(
        f'<transmission name="{one}"><joint name="{one}"><hardwareInterface>EffortJointInterface</hardwareInterface>'
        f'</joint><actuator name="m_{one}"/></transmission>'
        for one in ("left_shoulder_joint", "right_shoulder_joint")
    )
    hand = load_hand(write(tmp_path, on_a_robot("shoulder").replace("</robot>", driven + "</robot>")), palm="left_palm")
    assert any("no motor of a finger is named" in note for note in hand.notes)
    drives = {drive.joints[0]: drive for drive in hand.drives}
    assert drives["left_one_joint"].limit == 3.0 and drives["left_shoulder_joint"].name == "m_left_shoulder_joint"
    assert hand.passive_joints == ("right_one_joint", "right_two_joint")


def test_meshes_travel_without_their_trees():
    """To other processes go vertices and faces: what coal writes down of a mesh is a hundred times as much."""
    hand = load_hand("g1_left")
    written = pickle.dumps(hand)
    assert len(written) < 10e6
    back = pickle.loads(written)
    meshes = [one for one in hand.own_shapes if isinstance(one, coal.BVHModelOBBRSS)]
    again = [one for one in back.own_shapes if isinstance(one, coal.BVHModelOBBRSS)]
    assert len(back.own_shapes) == len(hand.own_shapes) and len(again) == len(meshes) > 0
    for one, other in zip(meshes, again):
        assert all(np.array_equal(*pair) for pair in zip(triangles_of(one), triangles_of(other)))
        point = coal.Transform3s(np.eye(3), np.array([0.03, 0.02, 0.05]))
        ball, at = coal.Sphere(1e-3), coal.Transform3s()
        gaps = [
            coal.distance(mesh, at, ball, point, coal.DistanceRequest(), coal.DistanceResult()) for mesh in (one, other)
        ]
        assert gaps[0] == pytest.approx(gaps[1], abs=1e-12)


def test_a_motors_rod_is_no_finger(tmp_path):
    """It slides beside the finger whose joints turn with it, as in hands of push rods."""
    parts = [link("palm", 0.3, "box 0.08 0.08 0.02")]
    for name, y in (("index", -0.02), ("thumb", 0.02)):
        parts += [
            link(f"{name}_base", 0.02, "box 0.012 0.012 0.012"),
            joint(f"{name}_turn", "palm", f"{name}_base", f"0 {y} 0.016", "0 0 1", "-0.5 0.5 5 3"),
            link(f"{name}_rod", 0.01, "box 0.004 0.004 0.02", "0 0 0.05"),
            joint(f"{name}_push", f"{name}_base", f"{name}_rod", "0.02 0 0", "0 0 1", "0 0.008 50 1", kind="prismatic"),
            link(name, 0.03, "box 0.012 0.014 0.07", "0 0 0.035"),
            joint(
                f"{name}_close", f"{name}_base", name, "0 0 0.006", "0 -1 0", "0 0.8 5 3", mimic=f"{name}_push 100 0"
            ),
        ]
    path = tmp_path / "rods.urdf"
    path.write_text(robot("rods", *parts), encoding="utf-8")
    hand = load_hand(path)
    assert {finger.name for finger in hand.fingers} == {"index", "thumb"}
    assert any("index_rod" in note and "not fingers" in note for note in hand.notes)


def test_odd_limits_of_a_hand_on_an_arm_are_told(tmp_path):
    parts, before = [link("stand", 1.0, "box 0.1 0.1 0.1")], "stand"
    for i in range(6):
        parts += [
            link(f"arm{i}", 1.0, "box 0.05 0.05 0.1"),
            joint(f"turn{i}", before, f"arm{i}", "0 0 0.2", "0 1 0", "-1 1 5000 1"),
        ]
        before = f"arm{i}"
    parts += [link("palm", 0.5, "box 0.12 0.05 0.04", "0 0 -0.02"), joint("flange", before, "palm", "0 0 0.1")]
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_jaw", 0.06, "box 0.014 0.02 0.07", f"{sign * 0.007} 0 0.035"),
            joint(f"{side}_slide", "palm", f"{side}_jaw", "0 0 0", f"{sign} 0 0", "0 0.04 1000 0.1", kind="prismatic"),
        ]
    path = tmp_path / "arm.urdf"
    path.write_text(robot("arm", *parts), encoding="utf-8")
    told = " ".join(note for note in load_hand(path).notes if "look like placeholders" in note)
    assert "left_slide 1000 N" in told and "turn0" not in told
