"""Hands as MuJoCo's specifications and texts, and what only its compiler knows: macros, attached models, meshes without
files, bounds of masses, constraints by sites, tendons that couple joints.
"""

from __future__ import annotations

import coal
import mujoco
import numpy as np
import pytest
import trimesh

from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.hands.visuals import meshes_of
from pinograsp.objects import load_object

FINGERS = """<mujoco model="pair"><compiler angle="radian"/><asset>{asset}</asset><worldbody><body name="palm">
  <geom type="box" size="0.03 0.05 0.02"/>
  <body name="l" pos="0 0.02 0.02"><joint name="jl" axis="-1 0 0" range="0 0.9"/>{geom}{inner}</body>
  <body name="r" pos="0 -0.02 0.02"><joint name="jr" axis="1 0 0" range="0 0.9"/>{geom}</body>
  </body></worldbody>{more}</mujoco>"""
BAR = '<geom type="box" size="0.008 0.004 0.02" pos="0 0 0.02"/>'
CORNERS = "-0.01 -0.004 0 0.01 -0.004 0 0 0.004 0 0 0 0.045"


def fingers(*, asset="", geom=BAR, inner="", more=""):
    return FINGERS.format(asset=asset, geom=geom, inner=inner, more=more)


@pytest.fixture(autouse=True)
def log_files_stay_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def same(one, other):
    assert one.joint_names == other.joint_names and one.mass == pytest.approx(other.mass, rel=1e-12)
    assert [drive.limit for drive in one.drives] == [drive.limit for drive in other.drives]
    q = np.linspace(0.1, 0.3, one.n)
    links = [finger.tip for finger in one.fingers]
    assert np.allclose(one.frame_placements(q, links), other.frame_placements(q, links), atol=1e-14)
    assert one.geometry.ngeoms == other.geometry.ngeoms


def test_a_file_a_text_and_a_specification_are_the_same_hand(tmp_path):
    text = fingers(more='<actuator><motor joint="jl" ctrlrange="-2 2"/><motor joint="jr" ctrlrange="-2 2"/></actuator>')
    (tmp_path / "pair.xml").write_text(text)
    spec = mujoco.MjSpec.from_string(text)
    before = spec.to_xml()
    file = load_hand(tmp_path / "pair.xml")
    for source in (text, spec):
        same(load_hand(source), file)
    assert spec.to_xml() == before and load_hand(spec).name == "pair"
    assert load_hand(spec, root="palm").n == 2


def test_a_hand_attached_to_an_arm_is_cut_out_again():
    hand = mujoco.MjSpec.from_string(fingers())
    arm = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 0 1"/><geom size="0.05"/>'
        '<site name="flange" pos="0 0 0.3" euler="10 20 30"/></body></worldbody></mujoco>'
    )
    alone = load_hand(hand)
    arm.attach(hand, prefix="h_", site=arm.site("flange"))
    with pytest.raises(HandNotLoaded, match="attached by reference to a parent"):
        load_hand(hand)
    cut = load_hand(arm, root="h_palm")
    assert cut.joint_names == ("h_jl", "h_jr") and cut.mass == pytest.approx(alone.mass, rel=1e-12)
    q = [0.2, 0.5]
    assert np.allclose(cut.frame_placements(q, ["h_l", "h_r"]), alone.frame_placements(q, ["l", "r"]), atol=1e-12)
    assert load_hand(arm).joint_names == ("turn", "h_jl", "h_jr")


def test_models_of_other_files_are_attached_but_from_inside_of_the_folder_alone(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "finger.xml").write_text(
        f'<mujoco model="finger"><compiler meshdir="forms"/><asset><mesh file="tip.stl"/></asset><worldbody>'
        f'<body name="f"><joint name="j" range="0 60" axis="1 0 0"/>{BAR}<geom type="mesh" mesh="tip"/></body>'
        "</worldbody></mujoco>"
    )
    (tmp_path / "parts" / "forms").mkdir()
    trimesh.creation.box((0.01, 0.02, 0.03)).export(tmp_path / "parts" / "forms" / "tip.stl")
    main = (
        '<mujoco><asset><model name="m" file="{}"/></asset><worldbody><body name="palm"><geom size="0.03"/>'
        '<frame pos="0.05 0 0"><attach model="m" body="f" prefix="a_"/></frame>'
        '<frame pos="-0.05 0 0"><attach model="m" body="f" prefix="b_"/></frame></body></worldbody></mujoco>'
    )
    (tmp_path / "hand.xml").write_text(main.format("parts/finger.xml"))
    hand = load_hand(tmp_path / "hand.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    assert set(hand.joint_names) == {"a_j", "b_j"} and hand.geometry.ngeoms == 5
    assert hand.mass == pytest.approx(model.body_mass.sum(), rel=1e-12)
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "hand.xml").write_text(main.format("../parts/finger.xml"))
    with pytest.raises(HandNotLoaded, match="outside the first file's own folder"):
        load_hand(tmp_path / "inner" / "hand.xml")
    assert load_hand(tmp_path / "inner" / "hand.xml", trusted=True).n == 2


def test_copies_that_a_file_asks_for_are_there(tmp_path):
    text = (
        '<mujoco><worldbody><body name="palm"><geom size="0.03"/><replicate count="3" euler="0 0 120">'
        f'<body name="f" pos="0.04 0 0"><joint name="j" axis="0 1 0" range="0 60"/>{BAR}</body></replicate></body>'
        "</worldbody></mujoco>"
    )
    hand, model = load_hand(text), mujoco.MjModel.from_xml_string(text)
    assert hand.n == 3 == model.nv and len(hand.fingers) == 3
    assert hand.mass == pytest.approx(model.body_mass.sum(), rel=1e-12)


@pytest.mark.parametrize("faces", ["", 'face="0 2 1 0 1 3 1 2 3 0 3 2"'])
def test_a_mesh_written_into_the_file_touches_is_seen_and_stored(faces):
    """Its hull is that of the given corners, and a stored hand has it back without any file."""
    text = fingers(asset=f'<mesh name="wedge" vertex="{CORNERS}" {faces}/>', geom='<geom type="mesh" mesh="wedge"/>')
    hand = load_hand(text)
    again = hand_of(hand_record(hand))
    wanted = np.array(CORNERS.split(), dtype=float).reshape(4, 3)
    for one in (hand, again):
        for place in (1, 2):
            shape = one.geometry.geometryObjects[place]
            assert isinstance(shape.geometry, coal.ConvexBase)
            points = np.array([shape.geometry.point(i) for i in range(shape.geometry.num_points)])
            points = points @ shape.placement.rotation.T + shape.placement.translation
            distance = np.linalg.norm(points[:, None] - wanted[None], axis=2)
            assert distance.min(axis=1).max() < 1e-8 and distance.min(axis=0).max() < 1e-8  # single precision
        meshes, problems = meshes_of(one.visuals, 1000)
        assert not problems and len(meshes) == 1 and sum(len(faces) for *_, faces in next(iter(meshes.values()))) == 4


def test_stored_meshes_that_are_none_are_refused():
    hand = load_hand(fingers(asset=f'<mesh name="w" vertex="{CORNERS}"/>', geom='<geom type="mesh" mesh="w"/>'))
    for key, value in (("vertices", "AAAA"), ("faces", "AAAAgP////8AAAAA"), ("vertices", 3), ("faces", "?")):
        record = hand_record(hand)
        record["geometry"][1]["triangles"] = {**record["geometry"][1]["triangles"], key: value}
        with pytest.raises(InvalidInput, match="triangles"):
            hand_of(record)


def test_bounds_of_masses_and_primitives_fitted_to_meshes_are_mujocos(tmp_path):
    trimesh.creation.box((0.01, 0.02, 0.05)).apply_translation([0, 0, 0.025]).export(tmp_path / "bar.stl")
    compiler = '<compiler boundmass="0.06" boundinertia="1e-5"/>'
    text = fingers(asset='<mesh file="bar.stl"/>', geom='<geom type="capsule" mesh="bar"/>', more=compiler)
    (tmp_path / "hand.xml").write_text(text)
    hand, model = load_hand(tmp_path / "hand.xml"), mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    assert hand.mass == pytest.approx(model.body_mass[1:].sum(), rel=1e-12) and model.body_mass[2] == 0.06
    inertia = np.linalg.eigvalsh(hand.model.inertias[1].inertia)
    assert inertia == pytest.approx(np.sort(model.body_inertia[2]), rel=1e-9)
    shape = hand.geometry.geometryObjects[1].geometry
    assert isinstance(shape, coal.Capsule)
    assert [shape.radius, shape.halfLength] == pytest.approx(model.geom_size[1, :2].tolist(), rel=1e-12)


def test_meshes_lie_beside_the_included_file_that_names_them(tmp_path):
    """Unless the main file's folder has them, or the compiler has a folder for them: as MuJoCo looks for them."""
    (tmp_path / "hand").mkdir()
    trimesh.creation.box((0.01, 0.01, 0.02)).export(tmp_path / "hand" / "bar.stl")
    inside = fingers(asset='<mesh name="bar" file="bar.stl"/>', geom='<geom type="mesh" mesh="bar"/>')
    (tmp_path / "hand" / "hand.xml").write_text(inside)
    scene = '<mujoco><include file="hand/hand.xml"/></mujoco>'
    (tmp_path / "scene.xml").write_text(scene)

    def heights():
        hand, model = load_hand("scene.xml"), mujoco.MjModel.from_xml_path("scene.xml")
        assert hand.mass == pytest.approx(model.body_mass[1:].sum(), rel=1e-12)
        return round(hand.finger_mass("l") / (1000 * 0.01 * 0.01), 6)

    assert heights() == 0.02
    trimesh.creation.box((0.01, 0.01, 0.04)).export(tmp_path / "bar.stl")
    assert heights() == 0.04


def side(n, s):
    """A finger on two bars; the tip and the second bar share a point."""
    return (
        f'<body name="drive_{n}" pos="0 {s * 0.02} 0.02"><joint name="drive_{n}" axis="{-s} 0 0" range="0 50"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.004"/><body name="tip_{n}" pos="0 0 0.04">'
        f'<joint name="tip_{n}" axis="{-s} 0 0" range="-60 60"/><geom type="box" size="0.008 0.003 0.02" '
        f'pos="0 {s * 0.008} 0.02"/><site name="on_tip_{n}" pos="0 {s * 0.015} 0"/></body></body>'
        f'<body name="bar_{n}" pos="0 {s * 0.035} 0.02"><joint name="bar_{n}" axis="{-s} 0 0" range="0 50"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.003"/><site name="on_bar_{n}" pos="0 0 0.04"/></body>'
    )


@pytest.mark.parametrize(
    "connect",
    [
        '<connect body1="tip_{n}" body2="bar_{n}" anchor="0 {y} 0"/>',
        '<connect site1="on_tip_{n}" site2="on_bar_{n}"/>',
        '<connect site1="on_bar_{n}" site2="on_tip_{n}"/>',
    ],
    ids=["bodies", "sites", "sites the other way"],
)
def test_loops_are_closed_by_bodies_and_by_sites(connect):
    loops = "".join(connect.format(n=n, y=0.015 * s) for n, s in (("l", 1), ("r", -1)))
    hand = load_hand(
        f'<mujoco><worldbody><body name="base"><geom type="box" size="0.03 0.05 0.02"/>{side("l", 1)}{side("r", -1)}'
        f'</body></worldbody><equality>{loops}<joint joint1="drive_l" joint2="drive_r"/></equality><actuator>'
        '<position name="grip" joint="drive_r" kp="5" forcerange="-2 2"/></actuator></mujoco>'
    )
    assert hand.joint_names == ("drive_r",) and len(hand.couplings) == 5
    for n in "lr":  # a parallelogram keeps the tip upright
        assert hand.couplings[f"tip_{n}"].factor == pytest.approx(-1, abs=1e-6)


@pytest.mark.parametrize("narrow", ['range="-0.001 0.001"', 'range="0.0995 0.1005"'])
def test_tendons_of_a_narrow_range_couple_their_joints(narrow):
    """As in MuJoCo, where the motor of one joint brings the other along."""
    inner = '<body name="l2" pos="0 0 0.04"><joint name="jl2" axis="-1 0 0" range="0 0.9"/>' + BAR + "</body>"
    text = fingers(
        inner=inner,
        more=f'<tendon><fixed name="roll" {narrow}><joint joint="jl" coef="1"/><joint joint="jl2" coef="-0.5"/></fixed>'
        '</tendon><actuator><position joint="jl2" kp="5" forcerange="-2 2"/></actuator>',
    )
    hand = load_hand(text)
    assert any("tendon 'roll'" in note and "coupled" in note for note in hand.notes)
    ((coupled, coupling),) = [(name, one) for name, one in hand.couplings.items() if name.startswith("jl")]
    middle = np.mean([float(end) for end in narrow.split('"')[1].split()])
    q = {coupling.followed: 0.4, coupled: coupling.factor * 0.4 + coupling.offset}
    assert q["jl"] - 0.5 * q["jl2"] == pytest.approx(middle, abs=1e-12)
    wide = load_hand(text.replace(narrow, 'range="-0.5 0.5"'))
    assert not wide.couplings and not any("roll" in note for note in wide.notes)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        ('<replicate count="100000"><geom size="0.01"/></replicate>', "<replicate> makes"),
        ('<replicate count="200"><replicate count="300"><geom size="0.01"/></replicate></replicate>', "makes"),
    ],
)
def test_copies_without_end_are_refused(make, message):
    with pytest.raises(HandNotLoaded, match=message):
        load_hand(fingers(inner=make))


def test_soft_bodies_textures_and_height_fields_are_not_needed(tmp_path):
    """What has no part in a grasp may even be missing."""
    text = fingers(
        asset='<texture name="t" type="2d" file="gone.png"/><material name="m" texture="t" rgba="1 0 0 1"/>'
        '<hfield name="h" file="gone.png" size="1 1 1 1"/>',
        geom=BAR.replace("/>", ' material="m"/>'),
        more='<sensor><jointpos joint="jl"/></sensor><keyframe><key qpos="1 2 3 4 5 6"/></keyframe>',
    ).replace(
        "<worldbody>", '<worldbody><geom type="hfield" hfield="h"/><flexcomp name="c" type="grid" count="3 3 1"/>'
    )
    hand = load_hand(text)
    assert hand.n == 2 and any("soft bodies" in note for note in hand.notes)
    assert {one.colour for one in hand.visuals if one.link in "lr"} == {"#FF0000"}


def test_objects_come_from_texts_and_specifications(tmp_path):
    thing = '<body name="cup"><freejoint/><geom type="cylinder" size="0.03 0.05" pos="0.01 0 0"/></body>'
    text = f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{thing}</worldbody></mujoco>'
    (tmp_path / "cup.xml").write_text(text)
    spec = mujoco.MjSpec.from_string(text)
    file = load_object(tmp_path / "cup.xml")
    for source in (text, spec):
        made = load_object(source)
        assert made.mass == pytest.approx(file.mass) and type(made) is type(file)
        assert np.allclose(made.com_o, file.com_o)
    with pytest.raises(InvalidInput, match="object file 'MjSpec': body: expected one of cup, got 'mug'"):
        load_object(spec, body="mug")
    with pytest.raises(InvalidInput, match="object file 'text'"):
        load_object("<mujoco/>")


def test_meshes_of_a_specification_become_an_object():
    text = (
        f'<mujoco><asset><mesh name="w" vertex="{CORNERS}" inertia="exact" face="0 2 1 0 1 3 1 2 3 0 3 2"/></asset>'
        '<worldbody><body name="w"><geom type="mesh" mesh="w" pos="0.1 0 0" euler="0 30 0"/></body></worldbody></mujoco>'
    )
    made, model = load_object(mujoco.MjSpec.from_string(text)), mujoco.MjModel.from_xml_string(text)
    assert made.mass == pytest.approx(model.body_mass[1], rel=1e-6)
    assert made.com_o == pytest.approx(model.body_ipos[1], abs=1e-8)
    assert 1000 * made.volume == pytest.approx(model.body_mass[1], rel=1e-6)
