"""The paper's hand against an independent DH product and closed-form ellipsoids; any hand from a file."""

from __future__ import annotations

import io
import math
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from conftest import POINTS

from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.humanoid import case_study_pose, humanoid_hand
from pinograsp.hands.catalogue import shipped_folder as urdf_folder
from pinograsp.hands.xacro_guard import expand_xacro

# Tables II and III once more, typed from the paper, in mm.
LENGTHS = {
    "thumb": [55.28, 43.16, 34.80], "index": [54.00, 31.48, 21.36], "middle": [58.58, 37.44, 23.80],
    "ring": [53.74, 36.34, 23.56], "little": [44.92, 25.80, 20.48],
}  # fmt: skip
AXES = {
    "thumb": [(27.64, 12.88, 13.14), (21.58, 9.37, 9.46), (17.40, 7.97, 9.90)],
    "index": [(26.98, 9.28, 9.11), (15.75, 8.06, 9.02), (10.68, 6.83, 8.15)],
    "middle": [(29.29, 10.00, 8.85), (18.72, 8.32, 8.76), (11.89, 7.18, 8.23)],
    "ring": [(26.87, 9.72, 8.50), (18.17, 7.80, 8.15), (11.78, 6.92, 7.97)],
    "little": [(22.46, 8.67, 8.06), (12.88, 7.53, 7.62), (10.24, 6.30, 7.36)],
}  # fmt: skip


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
        for joint, axes, length in zip(finger.joint_ids[1:], AXES[finger.name], LENGTHS[finger.name]):
            a, b, c = (1e-3 * v for v in axes)
            mass = 1160 * 4 / 3 * math.pi * a * b * c
            inertia = hand.model.inertias[joint]
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
    source, urdf = humanoid_hand().write(tmp_path)
    shipped = urdf_folder()
    assert source.read_text() == (shipped / source.name).read_text()
    assert urdf.read_text() == (shipped / urdf.name).read_text()
    assert expand_xacro(shipped / source.name) == (shipped / urdf.name).read_text()


def test_xacro_arguments_reach_the_model():
    light = load_hand(urdf_folder() / "humanoid_hand.urdf.xacro", density=580)
    assert light.finger_mass("index") == pytest.approx(load_hand("humanoid").finger_mass("index") / 2, rel=1e-12)
    with pytest.raises(HandNotLoaded, match="only xacro files take arguments"):
        load_hand("humanoid", density=580)


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


def test_pictures_are_the_ellipsoids():
    """The scaled unit sphere of a link fills the box of its semi-axes."""
    robot = yourdfpy.URDF.load(str(urdf_folder() / "humanoid_hand.urdf"))
    visual = robot.link_map["index_proximal"].visuals[0]
    assert np.allclose(visual.geometry.mesh.scale, [26.98e-3, 9.11e-3, 9.28e-3])
    assert robot.scene.extents.max() == pytest.approx(0.2, abs=0.1)  # a hand


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


def urdf(links="", joints="", first=INERTIAL, limit='<limit lower="-1" upper="1" effort="1" velocity="1"/>', kind="revolute"):
    return f"""<?xml version="1.0"?><robot name="test">
      <link name="base"/><link name="a">{first}</link><link name="a_tip"/>{links}
      <joint name="j" type="{kind}"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>{limit}</joint>
      <joint name="tip" type="fixed"><parent link="a"/><child link="a_tip"/><origin xyz="0.1 0 0"/></joint>{joints}
    </robot>"""


def write(tmp_path, text, name="hand.urdf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_smallest_hand_loads(tmp_path):
    hand = load_hand(write(tmp_path, urdf()))
    assert hand.palm == "base" and hand.fingers[0].tip == "a_tip" and hand.fingers[0].name == "a"


def test_dos_line_ends_and_leading_blank_lines_are_fine(tmp_path):
    path = tmp_path / "dos.urdf"
    path.write_bytes(urdf().replace("\n", "\r\n").encode())
    assert load_hand(path).n == 1


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
        (urdf(joints='<joint name="k" type="fixed"><parent link="a"/><child link="ghost"/></joint>'), "unknown link 'ghost'"),
        (urdf(joints='<joint name="k" type="fixed"><parent link="base"/><child link="a_tip"/></joint>'), "several parent"),
        (urdf()[:-20], "well-formed"),
        ("<robot name='x'/>", "no <link> found"),
        ("", "well-formed"),
        ("hello", "well-formed"),
    ],
)
def test_broken_urdfs_are_refused_with_the_reason(tmp_path, text, message):
    with pytest.raises(HandNotLoaded, match=message):
        load_hand(write(tmp_path, text))


def test_all_problems_are_named_at_once(tmp_path):
    path = write(tmp_path, urdf(first="", limit=""))
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(path)
    text = "; ".join(caught.value.problems)
    assert "no <inertial>" in text and "no position limits" in text


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
