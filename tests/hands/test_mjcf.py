"""Hands from MuJoCo's XML: against MuJoCo itself where it is installed, and against what is written in the file."""

from __future__ import annotations

import re

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import load_hand

# -- MuJoCo as the oracle ----------------------------------------------------------------------------------------------


def couple(hand, mujoco, model, joints):
    """E and offsets from the actuated joints to ``joints``, from MuJoCo's reading of the equality constraints."""
    names = list(hand.joint_names)
    E, o = np.zeros((len(joints), hand.n)), np.zeros(len(joints))
    todo = []
    for row, joint in enumerate(joints):
        if joint in names:
            E[row, names.index(joint)] = 1.0
        else:
            todo.append(joint)
    for _ in range(len(todo) + 1):
        for e in range(model.neq):
            if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT:
                continue
            one, other = (model.joint(int(i)).name for i in (model.eq_obj1id[e], model.eq_obj2id[e]))
            c0, c1 = model.eq_data[e][:2]
            r1, r2 = (float(model.qpos0[model.joint(name).qposadr[0]]) for name in (one, other))
            if one in todo:
                E[joints.index(one)], o[joints.index(one)] = (
                    c1 * E[joints.index(other)],
                    c1 * (o[joints.index(other)] - r2) + c0 + r1,
                )
            elif other in todo:
                E[joints.index(other)] = E[joints.index(one)] / c1
                o[joints.index(other)] = (o[joints.index(one)] - r1 - c0) / c1 + r2
    return E, o


def check(path, root=None, seed=0, geometry=True):
    """Placements of bodies and geoms, masses, mass matrix, bias torques and limits, against MuJoCo's own."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    state = mujoco.MjData(model)
    hand = load_hand(path, root=root)
    ours, data = hand.model, hand.model.createData()
    joints = list(ours.names)[1:]
    E, o = couple(hand, mujoco, model, joints)
    qpos = [model.joint(name).qposadr[0] for name in joints]
    dofs = [model.joint(name).dofadr[0] for name in joints]
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q, v = rng.uniform(hand.lower, hand.upper), rng.normal(size=hand.n)
        state.qpos[qpos], state.qvel[dofs] = E @ q + o, E @ v
        mujoco.mj_forward(model, state)
        world = np.eye(4)
        if root is not None:
            world[:3, :3], world[:3, 3] = state.body(root).xmat.reshape(3, 3), state.body(root).xpos
        links = [frame.name for frame in ours.frames if frame.type == pin.FrameType.BODY and ":" not in frame.name]
        for link, placement in zip(links, hand.frame_placements(q, links)):
            placement = world @ placement
            assert np.abs(placement[:3, 3] - state.body(link).xpos).max() < 1e-12, link
            assert np.abs(placement[:3, :3] - state.body(link).xmat.reshape(3, 3)).max() < 1e-12, link
        if geometry:
            check_geoms(hand, mujoco, model, state, q, world)
        if root is None:
            still = np.zeros(hand.n)
            bias = E.T @ state.qfrc_bias[dofs]
            assert np.abs(pin.rnea(ours, data, q, v, still) - bias).max() < 1e-9 * max(1.0, np.abs(bias).max())
            M = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, state, M)
            M = E.T @ M[np.ix_(dofs, dofs)] @ E
            columns = [
                pin.rnea(ours, data, q, still, a) - pin.rnea(ours, data, q, still, still) for a in np.eye(hand.n)
            ]
            assert np.abs(np.column_stack(columns) - M).max() < 1e-9 * np.abs(M).max()
            assert hand.mass == pytest.approx(model.body_mass[1:].sum(), rel=1e-9)
    return hand, mujoco, model


def check_geoms(hand, mujoco, model, state, q, world):
    """Every geom that collides is there, where MuJoCo has it, as the exact shape (meshes aside)."""
    at = hand.geometry.createData()
    pin.updateGeometryPlacements(hand.model, hand.model.createData(), hand.geometry, at, q)
    kinds = mujoco.mjtGeom
    links = {frame.name for frame in hand.model.frames}
    theirs = {}
    for g in range(model.ngeom):
        body = model.body(int(model.geom_bodyid[g])).name
        if (
            (model.geom_contype[g] or model.geom_conaffinity[g])
            and model.geom_type[g] != kinds.mjGEOM_PLANE
            and body in links
        ):
            theirs.setdefault(body, []).append(g)
    own = {}
    for i, one in enumerate(hand.geometry.geometryObjects):
        own.setdefault(hand.model.frames[one.parentFrame].name, []).append(i)
    assert {body: len(geoms) for body, geoms in own.items()} == {body: len(geoms) for body, geoms in theirs.items()}
    for body, geoms in theirs.items():
        for i, g in zip(own[body], geoms):
            shape, size = hand.geometry.geometryObjects[i].geometry, model.geom_size[g]
            if model.geom_type[g] == kinds.mjGEOM_MESH:
                continue
            placement = world @ at.oMg[i].homogeneous
            assert np.abs(placement[:3, 3] - state.geom_xpos[g]).max() < 1e-12
            assert np.abs(placement[:3, :3] - state.geom_xmat[g].reshape(3, 3)).max() < 1e-9
            if model.geom_type[g] == kinds.mjGEOM_BOX:
                assert isinstance(shape, coal.Box) and np.allclose(shape.halfSide.ravel(), size, atol=1e-15)
            elif model.geom_type[g] == kinds.mjGEOM_ELLIPSOID:
                assert isinstance(shape, coal.Ellipsoid) and np.allclose(shape.radii.ravel(), size, atol=1e-15)
            elif model.geom_type[g] == kinds.mjGEOM_SPHERE:
                assert isinstance(shape, coal.Sphere) and shape.radius == size[0]
            else:
                kind = coal.Capsule if model.geom_type[g] == kinds.mjGEOM_CAPSULE else coal.Cylinder
                assert isinstance(shape, kind) and np.allclose([shape.radius, shape.halfLength], size[:2], atol=1e-15)


def write(tmp_path, text, name="hand.xml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


@pytest.fixture(autouse=True)
def log_files_stay_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


DEFAULTS = """<mujoco model="two fingers">
  <compiler angle="degree"/>
  <default>
    <joint damping="0.1"/>
    <geom density="800"/>
    <motor ctrlrange="-0.3 0.2"/>
    <default class="finger">
      <joint axis="0 1 0" range="-10 80" armature="0.002"/>
      <geom type="capsule" size="0.008"/>
      <position forcerange="-1.5 1.5" kp="3"/>
      <default class="tip">
        <joint axis="1 0 0" range="0 60"/>
        <geom type="sphere" size="0.009"/>
        <position forcerange="-0.5 0.7"/>
      </default>
    </default>
    <default class="slider"><joint type="slide" axis="0 0 1" range="-0.01 0.03"/></default>
    <default class="leaning"><geom type="box" size="0.01 0.02 0.03" euler="10 20 30"/>
      <default class="other way"><geom zaxis="1 2 3"/></default></default>
    <default class="seen"><geom contype="0" conaffinity="0" group="2"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="palm" pos="0.1 -0.2 0.3" euler="10 20 -30">
      <geom name="shell" type="box" size="0.05 0.03 0.01" pos="0 0 -0.01"/>
      <geom class="seen" type="box" size="0.01 0.01 0.01"/>
      <geom class="leaning"/><geom class="leaning" quat="0 1 0 0"/><geom class="other way"/>
      <geom class="other way" axisangle="1 0 0 40"/><geom class="leaning" fromto="0 0 0 0.01 0.02 0.03"/>
      <body name="a1" pos="0.04 0 0" childclass="finger" axisangle="0 0 1 20">
        <joint name="a1"/>
        <geom fromto="0 0 0 0 0.01 0.05"/>
        <body name="a2" pos="0 0.01 0.05" xyaxes="1 0.1 0 0 1 0.2">
          <joint name="a2" class="tip" pos="0 0.001 0.002" ref="15"/>
          <geom class="tip" pos="0 0 0.02" mass="0.013"/>
          <geom type="ellipsoid" size="0.01 0.006 0.02" pos="0 0 0.02" euler="0 45 0"/>
        </body>
      </body>
      <body name="b1" pos="-0.04 0 0" childclass="finger" zaxis="0.1 0.2 1">
        <joint name="b1" class="slider"/>
        <joint name="b1turn" pos="0 0 0.01" range="-20 20" axis="1 1 0"/>
        <geom type="cylinder" size="0.007 0.02"/>
        <frame name="bent" pos="0 0 0.04" euler="0 30 0" childclass="tip">
          <geom type="box" size="0.004 0.005 0.006" pos="0.001 0 0"/>
          <body name="b2" pos="0 0 0.01"><joint name="b2" range="-5 5"/>
            <geom fromto="0 0 0 0.01 0 0.03" type="ellipsoid" size="0.008"/></body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pa1" class="finger" joint="a1"/>
    <position name="pa2" class="tip" joint="a2" gear="2"/>
    <motor name="mb1" joint="b1" gear="10"/>
    <general name="gb1" joint="b1turn" forcerange="-3 2" biastype="affine"/>
    <general name="gb2" joint="b2" gainprm="4" ctrlrange="-1 1"/>
  </actuator>
</mujoco>"""


def test_defaults_frames_and_shapes_equal_mujocos(tmp_path):
    check(write(tmp_path, DEFAULTS))


def test_what_a_file_says_is_what_is_loaded(tmp_path):
    """Without MuJoCo: numbers that can be read in the text."""
    hand = load_hand(write(tmp_path, DEFAULTS))
    assert hand.name == "two fingers" and hand.palm == "palm"
    assert [finger.name for finger in hand.fingers] == ["a", "b"]
    assert hand.fingers[1].joints == ("b1", "b1turn", "b2") and hand.fingers[1].links[0] == "b1:b1"
    limits = {name: (hand.lower[i], hand.upper[i], hand.effort[i]) for i, name in enumerate(hand.joint_names)}
    degrees = np.pi / 180
    expected = {
        "a1": (-10 * degrees, 80 * degrees, 1.5),
        "a2": (0, 60 * degrees, 2 * 0.7),
        "b1": (-0.01, 0.03, 10 * 0.3),
        "b1turn": (-20 * degrees, 20 * degrees, 3.0),
        "b2": (-5 * degrees, 5 * degrees, 4.0),
    }
    assert limits.keys() == expected.keys()
    for name, values in expected.items():
        assert limits[name] == pytest.approx(values, abs=1e-12), name
    assert hand.is_prismatic(hand.model.getJointId("b1")) and "m, effort 3 N" in hand.describe()
    armature = dict(zip(hand.joint_names, hand.model.armature))
    assert armature == pytest.approx({"a1": 0.002, "a2": 0.002, "b1": 0.0, "b1turn": 0.002, "b2": 0.002})
    assert any("geoms left out: world (floor)" in note for note in hand.notes)
    kinds = [type(one.geometry).__name__ for one in hand.geometry.geometryObjects]
    assert sorted(kinds) == ["Box"] * 7 + ["Capsule", "Cylinder", "Ellipsoid", "Ellipsoid", "Sphere"]
    ellipsoid = next(one.geometry for one in hand.geometry.geometryObjects if isinstance(one.geometry, coal.Ellipsoid))
    assert ellipsoid.radii.ravel().tolist() == [0.01, 0.006, 0.02]


def test_radians_and_given_inertias(tmp_path):
    hand, *_ = check(
        write(
            tmp_path,
            """<mujoco><compiler angle="radian" eulerseq="ZYX"/><worldbody>
      <body name="base"><inertial mass="1.5" pos="0.1 0 0" diaginertia="0.02 0.03 0.04" euler="0.3 0.2 0.1"/>
        <body name="one" pos="0 0 0.1" euler="0.1 -0.5 2"><inertial mass="0.2" pos="0 0.1 0"
          fullinertia="0.002 0.003 0.004 0.0001 -0.0002 0.0003"/><joint name="j" range="-0.7 0.8" axis="1 2 3"/>
          <geom size="0.01" mass="77"/></body>
        <body name="two"><inertial mass="0.3" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/>
          <joint name="k" range="0 1"/></body>
      </body></worldbody></mujoco>""",
        )
    )
    assert hand.mass == pytest.approx(2.0) and [hand.lower[0], hand.upper[0]] == [-0.7, 0.8]


def test_limits_without_autolimits(tmp_path):
    text = """<mujoco><compiler autolimits="false"/><worldbody><body><geom size="0.1"/>
      <joint name="j" range="-30 60" {}/></body></worldbody></mujoco>"""
    assert load_hand(write(tmp_path, text.format('limited="true"'))).upper[0] == pytest.approx(np.pi / 3)
    with pytest.raises(HandNotLoaded, match="`range` but not `limited`"):
        load_hand(write(tmp_path, text.format("")))
    assert load_hand(write(tmp_path, text.format('limited="false"'))).upper[0] == pytest.approx(np.pi)


def test_hinges_without_a_range_turn_without_end(tmp_path):
    text = """<mujoco><worldbody><body><geom size="0.1"/><joint name="j" {}/></body></worldbody></mujoco>"""
    hand = load_hand(write(tmp_path, text.format("")))
    assert [hand.lower[0], hand.upper[0]] == pytest.approx([-np.pi, np.pi])
    assert any("continuous joints taken as revolute between -180 and 180 deg: j" in note for note in hand.notes)
    with pytest.raises(HandNotLoaded, match=r"no position limits.*range="):
        load_hand(write(tmp_path, text.format('type="slide"')))


def test_included_files_and_settings(tmp_path):
    (tmp_path / "parts").mkdir()
    write(
        tmp_path / "parts", "<mujoco><compiler angle='radian'/><include file='defaults.xml'/></mujoco>", "settings.xml"
    )
    write(
        tmp_path / "parts", "<mujocoinclude><default><joint range='0 1.2'/></default></mujocoinclude>", "defaults.xml"
    )
    finger = "<mujocoinclude><body name='f'><joint name='j'/><geom size='0.02' pos='0.1 0 0'/></body></mujocoinclude>"
    write(tmp_path, finger, "finger.xml")
    path = write(
        tmp_path,
        """<mujoco><include file="parts/settings.xml"/><worldbody>
      <body name="palm"><geom size="0.03"/>
      <include file="finger.xml"/></body></worldbody></mujoco>""",
    )
    hand = load_hand(path)
    assert hand.upper[0] == 1.2 and hand.fingers[0].links == ("f",)
    write(tmp_path, "<mujoco><include file='finger.xml'/></mujoco>", "finger.xml")
    with pytest.raises(HandNotLoaded, match=r"finger.xml'>: includes itself"):
        load_hand(path)
    write(tmp_path, "<mujoco", "finger.xml")
    with pytest.raises(HandNotLoaded, match=r"finger.xml'>: not well-formed XML: unclosed token"):
        load_hand(path)
    (tmp_path / "finger.xml").unlink()
    with pytest.raises(HandNotLoaded, match=r"finger.xml'>: no such file"):
        load_hand(path)


@pytest.mark.parametrize("scale", ["1 1 1", "2 2 2", "2 3 0.5", "-1 1 1"])
@pytest.mark.parametrize("reference", ["", 'refpos="0.01 0.02 -0.03" refquat="0.9 0.1 -0.2 0.3"', 'refpos="1 2 3"'])
def test_meshes_are_found_placed_and_weighed(tmp_path, scale, reference):
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "my meshes").mkdir()
    body = trimesh.creation.box((0.02, 0.03, 0.05))
    body.apply_translation([0.01, -0.02, 0.03])
    body.export(tmp_path / "my meshes" / "block.stl")
    path = write(
        tmp_path,
        f"""<mujoco><compiler meshdir="my meshes" angle="radian"/>
      <asset><mesh file="block.stl" scale="{scale}" {reference}/></asset>
      <worldbody><body name="palm"><geom size="0.03"/><body name="f" pos="0.1 0 0" quat="0.8 0.1 0.2 0.3">
      <joint name="j" range="0 1" axis="0 1 0"/><geom type="mesh" mesh="block" pos="0 0.01 0" euler="0.1 0.2 0.3"/>
      </body></body></worldbody></mujoco>""",
    )
    hand = load_hand(path)
    volume = abs(np.prod([float(value) for value in scale.split()])) * 0.02 * 0.03 * 0.05
    assert hand.finger_mass("f") == pytest.approx(1000 * volume, rel=1e-6)
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    state = mujoco.MjData(model)
    state.qpos[0] = 0.4
    mujoco.mj_forward(model, state)
    # MuJoCo moves a mesh into its principal axes: compare vertices in the world.
    g = 1
    theirs = model.mesh_vert[: model.mesh_vertnum[0]] @ state.geom_xmat[g].reshape(3, 3).T + state.geom_xpos[g]
    at = hand.geometry.createData()
    pin.updateGeometryPlacements(hand.model, hand.model.createData(), hand.geometry, at, np.array([0.4]))
    vertices = hand.own_shapes[1].vertices()
    ours = vertices @ at.oMg[1].rotation.T + at.oMg[1].translation
    distance = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert distance.min(axis=1).max() < 1e-7 and distance.min(axis=0).max() < 1e-7  # files hold single precision
    assert hand.mass == pytest.approx(model.body_mass.sum(), rel=1e-6)


@pytest.mark.parametrize("way", ["", 'inertia="legacy"', 'inertia="exact"', 'inertia="convex"'])
def test_hollow_meshes_weigh_what_mujoco_says(tmp_path, way):
    mujoco = pytest.importorskip("mujoco")
    cup = trimesh.boolean.difference(
        [
            trimesh.creation.cylinder(0.02, 0.06),
            trimesh.creation.cylinder(0.018, 0.06).apply_translation([0.001, 0, 0.004]),
        ],
        engine="manifold",
    )
    cup.export(tmp_path / "cup.stl")
    path = write(
        tmp_path,
        f"""<mujoco><asset><mesh file="cup.stl" {way}/></asset><worldbody><body name="palm"><geom size="0.03"/>
      <body name="f" pos="0.1 0 0"><joint name="j" type="hinge" range="0 1" axis="0 1 0"/>
      <geom type="mesh" mesh="cup" euler="10 20 30"/></body></body></worldbody></mujoco>""",
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    ours = load_hand(path).model.inertias[1]
    assert ours.mass == pytest.approx(model.body_mass[2], rel=1e-6)
    assert np.array(ours.lever) == pytest.approx(model.body_ipos[2], abs=1e-8)
    assert np.linalg.eigvalsh(ours.inertia) == pytest.approx(np.sort(model.body_inertia[2]), rel=1e-5)


@pytest.mark.parametrize("file", ["gone.stl", "x" * 3000])
def test_missing_meshes_are_noted(tmp_path, file):
    text = """<mujoco><asset><mesh name="m" file="FILE"/></asset><worldbody><body name="palm"><geom size="0.03"/>
      <body name="f"><joint name="j" range="0 60"/><geom type="mesh" mesh="{}"/><geom size="0.01"/></body></body>
      </worldbody></mujoco>"""
    text = text.replace("FILE", file)
    hand = load_hand(write(tmp_path, text.format("m")))
    assert any("meshes not found" in note and f"f ({file}: no such file)" in note for note in hand.notes)
    with pytest.raises(HandNotLoaded, match="mesh 'n' not found"):
        load_hand(write(tmp_path, text.format("n")))


# -- on a robot, floating, coupled -------------------------------------------------------------------------------------

SCENE = """<mujoco><compiler angle="radian"/>
  <default><default class="arm"><joint range="-2 2" axis="0 1 0"/>
    <default class="gripper"><joint type="slide" axis="1 0 0" range="0 0.04" armature="0.01"/>
      <geom type="box" size="0.005 0.01 0.03" pos="0 0 0.03"/></default></default></default>
  <worldbody>
    <body name="can" pos="1 0 0"><freejoint name="loose"/><geom type="cylinder" size="0.03 0.06"/></body>
    <body name="link1" childclass="arm" pos="0 0 0.3"><joint name="shoulder"/><geom size="0.05"/>
      <body name="link2" pos="0.3 0 0" euler="0.1 0.2 0.3">
        <joint name="elbow" type="ball" range="0 1"/><geom size="0.04"/>
        <body name="palm" pos="0.2 0.1 0" euler="0.3 0 0.5" childclass="gripper">
          <joint name="wrist" class="arm"/>
          <geom type="box" size="0.05 0.02 0.01" pos="0 0 -0.01"/>
          <body name="left" pos="0.01 0 0"><joint name="left"/><geom/></body>
          <body name="right" pos="-0.01 0 0" quat="0 0 0 1"><joint name="right"/><geom/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="split"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>
  <equality><joint joint1="right" joint2="left"/><weld body1="can" body2="link1" active="false"/></equality>
  <actuator>
    <motor name="shoulder" joint="shoulder" ctrlrange="-50 50"/>
    <general name="grip" tendon="split" forcerange="-40 40" gainprm="10" biasprm="0 -100 -10" biastype="affine"/>
  </actuator>
</mujoco>"""


def test_a_hand_on_an_arm(tmp_path):
    path = write(tmp_path, SCENE)
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(path)
    assert "joint 'elbow' is a ball joint" in str(caught.value)
    hand = load_hand(path, root="palm")
    assert hand.palm == "palm" and hand.joint_names == ("left",) and hand.couplings["right"].factor == 1
    assert hand.effort.tolist() == [40.0]  # half on each, and both move with the same q
    assert hand.lower.tolist() == [0.0] and hand.upper.tolist() == [0.04] and hand.model.armature.tolist() == [0.02]
    assert hand.frame_placements([0.0], ["palm"])[0].tolist() == np.eye(4).tolist()
    assert [finger.name for finger in hand.fingers] == ["left", "right"]
    with pytest.raises(HandNotLoaded, match="'hand' is not a body; bodies: can, link1, link2, palm, left, right"):
        load_hand(path, root="hand")
    check(path, root="palm")


def test_a_hand_that_floats_is_placed_by_its_pose(tmp_path):
    text = """<mujoco><worldbody><body name="palm" pos="1 2 3"><freejoint/><geom size="0.03"/>
      <body name="f" pos="0.1 0 0"><joint name="j" range="0 60" axis="0 1 0"/><geom size="0.02"/></body></body>
      </worldbody></mujoco>"""
    path = write(tmp_path, text)
    pose = np.array([[0.0, -1, 0, 4], [1, 0, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]])
    floating, fixed = (
        load_hand(path, pose=pose),
        load_hand(write(tmp_path, text.replace("<freejoint/>", "")), pose=pose),
    )
    assert "joint 'palm joint' lets the whole hand float: taken as fixed, pose= places the hand" in floating.notes
    for q in ([0.0], [1.0]):
        places = [hand.frame_placements(q, ["palm", "f"]) for hand in (floating, fixed)]
        assert places[0] == pytest.approx(places[1], abs=1e-12)
    assert floating.mass == pytest.approx(fixed.mass)
    path = write(tmp_path, text)
    assert load_hand(path, root="palm").joint_names == ("j",)
    check(path, root="palm")
    path = write(tmp_path, text.replace("<freejoint/>", '<joint type="free" name="base"/>'))
    assert any("joint 'base' lets the whole hand float" in note for note in load_hand(path).notes)


def test_what_floats_beside_a_hand_is_left_out(tmp_path):
    hand = """<body name="palm"><freejoint/><geom size="0.03"/>
      <body name="f" pos="0.1 0 0"><joint name="j" range="0 60" axis="0 1 0"/><geom size="0.02"/></body></body>"""
    can = '<body name="can"><freejoint/><geom size="0.1"/><body name="lid"><geom size="0.1"/></body></body>'
    scene = load_hand(write(tmp_path, f"<mujoco><worldbody>{can}{hand}</worldbody></mujoco>"))
    alone = load_hand(write(tmp_path, f"<mujoco><worldbody>{hand}</worldbody></mujoco>"))
    assert scene.joint_names == alone.joint_names == ("j",) and scene.mass == pytest.approx(alone.mass)
    assert scene.geometry.ngeoms == alone.geometry.ngeoms
    assert any("'can' floats freely and has no joints: left out" in note for note in scene.notes)
    two = hand.replace('"palm"', '"palm2"').replace('"f"', '"f2"').replace('"j"', '"j2"')
    with pytest.raises(HandNotLoaded, match="joint 'palm joint' floats freely: give root="):
        load_hand(write(tmp_path, f"<mujoco><worldbody>{hand}{two}</worldbody></mujoco>"))


@pytest.mark.parametrize("curve", ["0.05 0.8 0.3 0 0", "0 -0.5 0.1 0.2 -0.05"])
def test_a_curved_coupling_is_the_nearest_line(tmp_path, curve):
    """Fitted here by the normal equations; positions of MuJoCo's own solution are as far off as the note says."""
    mujoco = pytest.importorskip("mujoco")
    equality = f'<joint joint1="m" joint2="p" polycoef="{curve}" solref="-1e6 -1e4"/>'
    path = write(tmp_path, COUPLED.format(equality=equality, driven="p"))
    hand = load_hand(path)
    coupling = hand.couplings["m"]
    x = np.linspace(-1, 1, 101) - 0.1  # p counts from its ref of 0.1
    y = sum(float(c) * x**i for i, c in enumerate(curve.split()))
    A = np.stack([x, np.ones_like(x)], axis=1)
    factor, offset = np.linalg.solve(A.T @ A, A.T @ y)
    assert coupling.factor == pytest.approx(factor) and coupling.offset == pytest.approx(offset - 0.1 * factor)
    note = next(note for note in hand.notes if "by a curve" in note)
    off = float(re.search(r"off by at most ([\d.]+) deg", note)[1])
    model = mujoco.MjModel.from_xml_path(str(path))
    data, worst = mujoco.MjData(model), 0.0
    for q in np.linspace(-1, 1, 21):
        data.joint("p").qpos = q
        for _ in range(60):  # Newton's method on the constraint: its residual is m less what the curve says
            mujoco.mj_forward(model, data)
            data.joint("m").qpos -= data.efc_pos[0]
        worst = max(worst, abs(float(data.joint("m").qpos[0]) - (coupling.factor * q + coupling.offset)))
    assert np.degrees(worst) == pytest.approx(off, rel=0.06)  # two digits, and coarser samples


def test_a_curve_needs_a_range(tmp_path):
    text = COUPLED.format(equality='<joint joint1="m" joint2="p" polycoef="0 1 1"/>', driven="p")
    with pytest.raises(HandNotLoaded, match="'m' follows 'p' by a curve: 'p' needs a range to fit a line to it"):
        load_hand(write(tmp_path, text.replace('name="p" ref', 'limited="false" name="p" ref')))


COUPLED = """<mujoco><compiler angle="radian"/><default><joint range="-1 1" axis="0 1 0" armature="0.001"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.05"/></default>
  <worldbody><body name="palm"><geom/>
    <body name="p" pos="0.03 0 0"><joint name="p" ref="0.1"/><geom/>
      <body name="m" pos="0 0 0.05"><joint name="m"/><geom/>
        <body name="d" pos="0 0 0.05"><joint name="d" ref="-0.2"/><geom/></body></body></body>
    <body name="t" pos="-0.03 0 0" euler="0 0 3"><joint name="t"/><geom/></body></body></worldbody>
  <equality>{equality}</equality>
  <actuator><position joint="{driven}" forcerange="-3 3"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("equality", "driven", "free", "effort"),
    [
        ('<joint joint1="m" joint2="p" polycoef="0.1 0.7 0 0 0"/>', "p", {"p", "d", "t"}, 3.0),
        (
            '<joint joint1="m" joint2="p" polycoef="0.1 0.7"/><joint joint1="d" joint2="m" polycoef="0.1 -0.5 0 0 0"/>',
            "p",
            {"p", "t"},
            3.0,
        ),
        ('<joint joint1="p" joint2="d" polycoef="0.2 1.6 0 0 0"/>', "d", {"p", "m", "t"}, 3.0 / 1.6),
        ('<joint joint1="p" joint2="m"/><joint joint1="p" joint2="d" polycoef="0 2 0 0 0"/>', "p", {"p", "t"}, 3.0),
        ('<joint joint1="t" joint2="d" polycoef="0 -1 0 0 0"/>', "t", {"p", "m", "d"}, 3.0),
        (
            '<joint joint1="m" joint2="p"/><joint joint1="d" joint2="t" polycoef="0.1 2"/><joint joint1="m" joint2="d" '
            'polycoef="0 0.5"/><joint joint1="p" joint2="m"/>',
            "t",
            {"t"},
            3.0,
        ),
    ],
)
def test_linear_couplings(tmp_path, equality, driven, free, effort):
    hand, *_ = check(write(tmp_path, COUPLED.format(equality=equality, driven=driven)))
    assert set(hand.joint_names) == free
    assert sum(hand.effort > 0) == 1 and max(hand.effort) == pytest.approx(effort)


TENDONS = """<mujoco><compiler angle="radian"/>
  <default><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.05"/></default>
  <worldbody><body name="palm"><geom/>
    <body name="a"><joint name="a" axis="0 1 0" range="0 0.7"/><geom/>
      <body name="b" pos="0 0 0.05"><joint name="b" axis="0 1 0" range="-0.9 0.9"/><geom/></body></body>
    <body name="bar" pos="0.03 0 0"><joint name="bar" axis="0 1 0" range="-0.9 0.9"/><geom/></body></body></worldbody>
  <tendon><fixed name="ab"><joint joint="a" coef="1"/><joint joint="b" coef="1.5"/></fixed>
    <fixed name="bc"><joint joint="b" coef="1"/><joint joint="bar" coef="3.5"/></fixed></tendon>
  <equality>{}</equality><actuator><position joint="a" forcerange="-3 3"/></actuator></mujoco>"""


@pytest.mark.parametrize("order", [["ab", "bc"], ["bc", "ab"]])
def test_joints_of_tendons_follow_that_of_the_motor_with_its_limits(tmp_path, order):
    """Both tendons keep their length of 0: b = -a / 1.5 and bar = -b / 3.5, for all a of its own range."""
    hand = load_hand(write(tmp_path, TENDONS.format("".join(f'<tendon tendon1="{name}"/>' for name in order))))
    assert hand.joint_names == ("a",) and [*hand.lower, *hand.upper] == pytest.approx([0, 0.7])
    assert {one.followed for one in hand.couplings.values()} == {"a"}
    assert hand.couplings["b"].factor == pytest.approx(-1 / 1.5)
    assert hand.couplings["bar"].factor == pytest.approx(1 / 1.5 / 3.5)
    assert not any("do not fit" in note for note in hand.notes)


FRAGMENT = """<mujoco>{}<worldbody><body name="palm"><geom size="0.03"/><body pos="0.05 0 0" euler="0 0 {}">
  <joint name="j" axis="0 1 0" ref="0.1" range="0 {}"/><geom size="0.01" pos="0.02 0 0"/></body></body></worldbody>
  </mujoco>"""
DEGREES, RADIANS = '<compiler angle="degree"/>', '<compiler angle="radian"/>'


@pytest.mark.parametrize(
    ("compiler", "turned", "upper", "radians"),
    [
        ("", 1.57, 1.2, True),
        (DEGREES, 1.57, 1.2, False),
        (RADIANS, 1.57, 1.2, True),
        ("", 90, 1.2, False),  # its body is turned by degrees
        ("", 1.57, 60, False),
    ],
)
def test_files_made_to_be_included_are_in_radians(tmp_path, compiler, turned, upper, radians):
    hand = load_hand(write(tmp_path, FRAGMENT.format(compiler, turned, upper)))
    unit = 1.0 if radians else np.pi / 180
    assert hand.upper[0] == pytest.approx(unit * upper)
    guessed = radians and not compiler
    assert sum("are taken as radians" in note for note in hand.notes) == guessed
    mujoco = pytest.importorskip("mujoco")
    said = compiler or (RADIANS if radians else DEGREES)
    model = mujoco.MjModel.from_xml_string(FRAGMENT.format(said, turned, upper))
    data, state = hand.model.createData(), mujoco.MjData(model)
    state.qpos[0] = upper * unit / 2
    mujoco.mj_kinematics(model, state)
    pin.forwardKinematics(hand.model, data, state.qpos)
    assert data.oMi[1].translation == pytest.approx(state.xanchor[0], abs=1e-12)
    at = hand.frame_placements(state.qpos, [hand.fingers[0].tip])[0]
    assert at[:3, :3] == pytest.approx(state.xmat[2].reshape(3, 3), abs=1e-9)


@pytest.mark.parametrize(
    ("equality", "message"),
    [
        ('<joint joint1="m" polycoef="0.2 0 0 0 0"/>', "'m' is held still"),
        ('<joint joint1="m" joint2="p" polycoef="0.2 0 0 0 0"/>', "'m' is held still"),
        ('<joint joint1="m" joint2="ghost"/>', "'ghost'"),
        ('<joint joint1="m" joint2="p" polycoef="a b"/>', "'polycoef'"),
        (
            '<joint joint1="m" joint2="p"/><joint joint1="p" joint2="d"/><joint joint1="d" joint2="m" polycoef="0 2"/>',
            "equality constraints contradict each other at joint 'd'",
        ),
        ('<joint joint1="m" joint2="m"/>', "element 'm' is repeated"),
    ],
)
def test_couplings_that_cannot_be(tmp_path, equality, message):
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, COUPLED.format(equality=equality, driven="p")))
    assert message in str(caught.value)


def test_loops_and_inactive_constraints(tmp_path):
    loops = '<connect body1="d" body2="t" anchor="0 0 0"/><joint joint1="m" joint2="p" active="false"/>'
    hand = load_hand(write(tmp_path, COUPLED.format(equality=loops, driven="p")))
    assert hand.n == 4 and any("connect d and t" in note for note in hand.notes)


def test_efforts_equal_mujocos(tmp_path):
    """Force ranges times gears from MuJoCo's compiled arrays, classes and shortcuts resolved by it."""
    mujoco = pytest.importorskip("mujoco")
    path = write(
        tmp_path,
        """<mujoco><compiler angle="radian"/>
      <default><position forcerange="-9 9"/><joint range="-1 1"/><geom size="0.01" pos="0.01 0 0"/>
        <default class="a"><general forcerange="-1 4" gear="3"/>
          <default class="b"><position forcerange="-2 2"/><default class="c"><motor gear="-5 1 1"/></default></default>
        </default><default class="free"><position forcelimited="false"/></default></default>
      <worldbody><body name="palm"><geom/>"""
        + "".join(
            f'<body name="f{i}" pos="0 {i} 0"><joint name="j{i}"{more}/><geom/></body>'
            for i, more in enumerate(["", "", "", "", "", "", ' actuatorfrcrange="-0.5 0.6"', ""])
        )
        + """</body></worldbody><actuator>
        <position joint="j0"/><motor joint="j1" class="a"/><position joint="j2" class="b"/>
        <motor joint="j3" class="c" forcerange="-7 1"/><velocity joint="j4" class="c"/>
        <position joint="j5" class="b" gear="2"/><motor joint="j5" forcerange="-1 1"/><position joint="j6"/>
        <position joint="j7" class="free"/></actuator></mujoco>""",
    )
    model, hand = mujoco.MjModel.from_xml_path(str(path)), load_hand(path)
    expected = np.zeros(8)
    for a in range(model.nu):
        if model.actuator_forcelimited[a]:
            force = np.abs(model.actuator_forcerange[a]).max() * abs(model.actuator_gear[a][0])
            expected[model.actuator_trnid[a][0]] += force
    capped = model.jnt_actfrclimited.astype(bool)
    expected[capped] = np.minimum(expected[capped], np.abs(model.jnt_actfrcrange[capped]).max(axis=1))
    ours = dict(zip(hand.joint_names, hand.effort))
    assert [ours[f"j{i}"] for i in range(8)] == pytest.approx(expected.tolist())
    assert expected.tolist() == [9, 12, 6, 35, 10, 5, 0.6, 0]
    assert any("no effort limit (none given, or 0): j7" in note for note in hand.notes)


def test_underactuated_tendons_springs_and_totals_are_noted(tmp_path):
    hand = load_hand(
        write(
            tmp_path,
            """<mujoco><compiler settotalmass="3"/><worldbody>
      <body name="palm"><geom size="0.03"/>
      <body name="a" pos="0.05 0 0"><joint name="a" range="0 60" stiffness="0.3"/><geom size="0.01" pos="0.02 0 0"/>
      <body name="b" pos="0.04 0 0"><joint name="b" range="0 60"/><geom size="0.01" pos="0.02 0 0"/></body></body>
      </body></worldbody>
      <tendon><fixed name="pull"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>
      <actuator><motor name="pull" tendon="pull" ctrlrange="0 5"/></actuator></mujoco>""",
        )
    )
    notes = "\n".join(hand.notes)
    assert "effort limits do not include actuators that pull several joints at once: pull (a, b)" in notes
    assert hand.effort.tolist() == [0, 0]
    assert "springs: torques are without those at a" in notes
    assert hand.mass == pytest.approx(3) and "settotalmass" in notes


def world(*inside):
    return f"<mujoco><worldbody>{''.join(inside)}</worldbody></mujoco>"


def body(*inside, name="b", joint="<joint name='j' range='0 1'/>", geom="<geom name='g' size='1'/>", more=""):
    return f"<body name='{name}' {more}>{joint}{geom}{''.join(inside)}</body>"


BROKEN = {
    "no worldbody": ("<mujoco/>", "no <worldbody> found"),
    "nothing moves": (world(body(joint="")), "expected a hand that moves"),
    "no mass": (world(body(geom="")), "mass and inertia of moving bodies must be larger"),
    "include": (world("<include file='" + "x" * 3000 + "'/>"), "no such file"),
    "class": (world(body(more="childclass='x'")), "unknown default childclass"),
    "numbers": (world(body(more="pos='1 2'")), "'pos' does not have enough data"),
    "no number": (world(body(geom="<geom name='g' size='nan'/>")), "nan size in geom"),
    "axis": (world(body(joint="<joint name='j' axis='0 0 0' range='0 1'/>")), "axis too small in joint"),
    "size": (world(body(geom="<geom name='g' size='0'/>")), "size 0 must be positive in geom"),
    "twice": (world(body(body())), "repeated name 'b' in body"),
    "copies": (
        world(body("<replicate count='99999'><geom size='1'/></replicate>")),
        "with those that <replicate> makes",
    ),
    "inertia": (
        world(body("<inertial mass='-1' pos='0 0 0' diaginertia='1 1 1'/>")),
        "mass and inertia of moving bodies",
    ),
    "two inertias": (
        world(body("<inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/>" * 2)),
        "unique element 'inertial' found 2 times",
    ),
    "group": (world(body(geom="<geom name='g' size='1' group='two'/>")), "bad format in attribute 'group'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_with_the_reason(tmp_path, name):
    text, message = BROKEN[name]
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, text))
    assert message in str(caught.value)


def test_problems_of_what_mujoco_takes_come_at_once(tmp_path):
    text = COUPLED.format(equality='<joint joint1="m"/>', driven="p")
    text = text.replace('<joint name="t"/>', '<joint name="t" type="ball" range="0 1"/>')
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(write(tmp_path, text.replace('name="d" ref="-0.2"', 'name="d" type="slide" limited="false"')))
    problems = "; ".join(caught.value.problems)
    assert len(caught.value.problems) == 3
    for words in ("'m' is held still", "'t' is a ball joint", "'d' has no position limits"):
        assert words in problems


# -- random models -----------------------------------------------------------------------------------------------------


def random_mjcf(seed):
    """A tree of bodies that uses every way of saying where things are, in random numbers."""
    rng = np.random.default_rng(seed)

    def numbers(n, scale=1.0):
        return " ".join(f"{value:.6f}" for value in scale * rng.uniform(-1, 1, n))

    def turn():
        return rng.choice(
            [
                "",
                f'quat="{numbers(4)}"',
                f'euler="{numbers(3, 80)}"',
                f'axisangle="{numbers(4, 50)}"',
                f'xyaxes="{numbers(6)}"',
                f'zaxis="{numbers(3)}"',
            ]
        )

    def geom():
        kind = rng.choice(["sphere", "box", "capsule", "cylinder", "ellipsoid"])
        size = " ".join(f"{value:.6f}" for value in rng.uniform(0.01, 0.05, 3))
        place = (
            f'fromto="{numbers(6, 0.1)}"'
            if kind != "sphere" and rng.random() < 0.4
            else f'pos="{numbers(3, 0.1)}" {turn()}'
        )
        extra = rng.choice(
            ["", 'mass="0.3"', 'density="400"', 'class="heavy"', 'contype="0" conaffinity="0"', 'group="3"']
        )
        return f'<geom type="{kind}" size="{size}" {place} {extra}/>'

    count = 0

    def body(depth):
        nonlocal count
        count += 1
        name = f"b{count}"
        joints = "".join(
            f'<joint name="{name}j{i}" type="{kind}" axis="{numbers(3)}" pos="{numbers(3, rng.choice([0.0, 0.05]))}"'
            f' range="{-1.0 if kind == "slide" else -60} {1.0 if kind == "slide" else 50}" '
            f'ref="{0.1 if rng.random() < 0.3 else 0}" armature="{0.01 if rng.random() < 0.5 else 0}"/>'
            for i, kind in enumerate(rng.choice(["hinge", "slide"], rng.integers(0 if depth else 1, 3)))
        )
        inside = "".join(geom() for _ in range(rng.integers(1, 3)))
        if rng.random() < 0.3:
            inside += f'<inertial mass="0.4" pos="{numbers(3, 0.1)}" diaginertia="0.02 0.03 0.04" quat="{numbers(4)}"/>'
        if depth < 3:
            for _ in range(rng.integers(1, 3)):
                one = body(depth + 1)
                inside += (
                    f'<frame pos="{numbers(3, 0.1)}" {turn()}>{one}{geom()}</frame>' if rng.random() < 0.3 else one
                )
        childclass = rng.choice(["", 'childclass="heavy"', 'childclass="light"'])
        return f'<body name="{name}" pos="{numbers(3, 0.2)}" {turn()} {childclass}>{joints}{inside}</body>'

    sequence = rng.choice(["xyz", "zyx", "XYZ", "ZXY", "yzy", "XyZ"][:5])
    return f"""<mujoco><compiler angle="degree" eulerseq="{sequence}"/><default><geom density="1200"/>
      <default class="heavy"><geom density="3000" condim="4"/><joint damping="1"/></default>
      <default class="light"><geom density="90"/></default></default><worldbody>{body(0)}</worldbody></mujoco>"""


@pytest.mark.parametrize("seed", range(25))
def test_random_models_equal_mujocos(tmp_path, seed):
    check(write(tmp_path, random_mjcf(seed)), seed=seed)


# -- files that would harm ---------------------------------------------------------------------------------------------

FINGER = "<body name='f'><joint name='j' range='0 1'/><geom size='0.02'/></body>"


def test_files_outside_the_own_folder_are_not_included(tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "inside").mkdir()
    write(tmp_path / "outside", f"<mujocoinclude>{FINGER}</mujocoinclude>", "finger.xml")
    (tmp_path / "inside" / "link.xml").symlink_to(tmp_path / "outside" / "finger.xml")
    for name in ("../outside/finger.xml", str(tmp_path / "outside" / "finger.xml"), "link.xml"):
        path = write(tmp_path / "inside", world(f"<body name='palm'><geom size='0.1'/><include file='{name}'/></body>"))
        with pytest.raises(HandNotLoaded, match=r"outside the first file's own folder.*trusted=True"):
            load_hand(path)
        assert load_hand(path, trusted=True).n == 1
    # A file below the folder may include what is beside it or above it, as long as that is in the folder.
    (tmp_path / "inside" / "parts").mkdir()
    write(tmp_path / "inside", f"<mujocoinclude>{FINGER}</mujocoinclude>", "finger.xml")
    write(tmp_path / "inside" / "parts", "<mujocoinclude><include file='../finger.xml'/></mujocoinclude>", "part.xml")
    path = write(
        tmp_path / "inside", world("<body name='palm'><geom size='0.1'/><include file='parts/part.xml'/></body>")
    )
    assert load_hand(path).n == 1


@pytest.mark.slow
def test_includes_that_fan_out_come_to_an_end(tmp_path):
    for level in range(7):
        inner = f"<include file='{level + 1}.xml'/>" * 50
        write(tmp_path, f"<mujocoinclude>{inner}</mujocoinclude>", f"{level}.xml")
    write(tmp_path, "<mujocoinclude/>", "7.xml")
    with pytest.raises(HandNotLoaded, match="expected at most 1000 included files"):
        load_hand(write(tmp_path, world('<include file="0.xml"/>')))
    write(tmp_path, f"<mujocoinclude>{'<a/>' * 49_000}</mujocoinclude>", "0.xml")
    with pytest.raises(HandNotLoaded, match="expected at most 50000 elements"):
        load_hand(write(tmp_path, world('<include file="0.xml"/>' * 500)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco>" + "<default class='a'>" * 20_000 + "</default>" * 20_000 + "</mujoco>", "nested without end"),
        (
            "<mujoco>"
            + "".join(f"<default class='{i}'>" for i in range(900))
            + "</default>" * 900
            + "<worldbody/></mujoco>",
            "nesting is too deep",
        ),
        (
            "<mujoco><default>"
            + "".join(f"<default class='{i}'/>" for i in range(3000))
            + "</default><worldbody/></mujoco>",
            "at most 2000 elements <default>",
        ),
        (
            "<mujoco><worldbody>" + "<body>" * 900 + "</body>" * 900 + "<body/>" * 1200 + "</worldbody></mujoco>",
            "at most 2000 elements <body>",
        ),
        ("<mujoco><worldbody>" + "<body/>" * 60_000 + "</worldbody></mujoco>", "at most 50000 elements"),
        (
            '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><mujoco>&b;</mujoco>',
            "entity declarations are not allowed",
        ),
        (
            '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/hostname">]><mujoco>&a;</mujoco>',
            "entity declarations are not allowed",
        ),
        ("<mujoco " + " ".join(f"a{i}=''" for i in range(2000)) + "/>", "at most 1000 attributes"),
        (
            f"<mujoco><worldbody><body pos='{'1 ' * 100_000}'/></worldbody></mujoco>",
            "'pos' has too much data",
        ),
    ],
)
def test_bombs_do_not_go_off(tmp_path, text, message):
    with pytest.raises(HandNotLoaded, match=message) as caught:
        load_hand(write(tmp_path, text))
    assert len(str(caught.value)) < 2000


# A finger on a crank, held by a bar from the palm: at 0 the bar's upper end is at the finger's `anchor`.
FOUR_BARS = """<mujoco><worldbody><body name="palm"><geom type="box" size="0.03 0.02 0.01" pos="0 0 -0.02"/>
<body name="crank"><joint name="motor" axis="0 1 0" limited="true" range="-34 34"/>
<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.004"/>
<body name="finger" pos="0 0 0.04"><joint name="upright" axis="0 1 0" limited="true" range="-60 60"/>
<geom type="box" size="0.015 0.01 0.03" pos="0.01 0 0.025"/></body></body>
<body name="bar" pos="{bar}"><joint name="pivot" axis="0 1 0" limited="true" range="-60 60"/>
<geom type="capsule" fromto="0 0 0 0 0 {length}" size="0.003"/>{more}</body>
</body></worldbody><equality><connect body1="finger" body2="{end}" anchor="0.02 0 0"/></equality>
<actuator><motor joint="motor" ctrllimited="true" ctrlrange="-1 1"/>{motor}</actuator></mujoco>"""


def four_bars(tmp_path, bar, *, more="", end="bar", motor=""):
    return load_hand(
        write(tmp_path, FOUR_BARS.format(bar=bar, length=0.02 if more else 0.04, more=more, end=end, motor=motor))
    )


def test_a_parallelogram_keeps_the_finger_upright(tmp_path):
    hand = four_bars(tmp_path, "0.02 0 0")
    assert hand.joint_names == ("motor",) and [finger.name for finger in hand.fingers] == ["finger"]
    assert hand.couplings["upright"].factor == pytest.approx(-1.0, abs=1e-6)
    assert hand.couplings["pivot"].factor == pytest.approx(1.0, abs=1e-6)
    assert any("upright, pivot follow motor in proportion" in note for note in hand.notes)
    assert (hand.lower[0], hand.upper[0]) == pytest.approx((np.radians(-34), np.radians(34)))


def test_loops_are_closed_as_well_as_is_told(tmp_path):
    """Bars of other lengths: the gap at the shared point, measured by the hand's own kinematics."""
    hand = four_bars(tmp_path, "0.021 0 0.003")
    told = next(float(re.search(r"off by at most ([\d.e-]+) mm", note)[1]) for note in hand.notes if "loops" in note)
    gaps = []
    for q in np.linspace(hand.lower[0], hand.upper[0], 9):
        finger, bar = (pin.SE3(pose) for pose in hand.frame_placements([q], ["finger", "bar"]))
        gaps.append(1e3 * np.linalg.norm(finger.act(np.array([0.02, 0, 0])) - bar.act(np.array([-0.001, 0, 0.037]))))
    assert max(gaps) == pytest.approx(told, rel=0.06) and 0.01 < told < 2.0


def test_a_spring_decides_where_the_bars_leave_a_choice(tmp_path):
    """A fifth bar between bar and finger, which its spring keeps at its stop: as if it were not there."""
    knee = (
        '<body name="knee" pos="0 0 0.02"><joint name="knee" axis="0 1 0" limited="true" range="0 40" stiffness="0.1" '
        'springref="-90"/><geom type="capsule" fromto="0 0 0 0 0 0.02" size="0.003"/></body>'
    )
    hand = four_bars(tmp_path, "0.02 0 0", more=knee, end="knee")
    assert hand.joint_names == ("motor",) and "joints without travel are fixed: knee" in hand.notes
    assert hand.couplings["upright"].factor == pytest.approx(-1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("bar", "motor"),
    [("0.05 0 0.03", ""), ("0.02 0 0", '<motor joint="pivot" ctrllimited="true" ctrlrange="-1 1"/>')],
    ids=["far from a line", "two motors"],
)
def test_other_loops_stay_open(tmp_path, bar, motor):
    hand = four_bars(tmp_path, bar, motor=motor)
    assert hand.n == 3 and any("connect finger and bar" in note for note in hand.notes)


@pytest.mark.parametrize(
    ("site", "geom", "motor"),
    [("s_{}_tip", "", "m{i}"), ("", "{}_pad", "m{i}"), ("", "", "{}_flexor")],
    ids=["sites", "geoms", "motors"],
)
def test_sites_shapes_and_motors_tell_what_fingers_are_called(tmp_path, site, geom, motor):
    """Where joints and bodies have numbers alone; a joint that carries all fingers tells nothing of any."""
    bodies, motors = "", ""
    for i, short in enumerate(("th", "if", "mf")):
        named = f"name='{geom.format(short)}'" if geom else ""
        bodies += (
            f"<body name='b{i}' pos='{0.05 * i} 0 0'><joint name='j{i}' axis='0 1 0' range='-60 60'/>"
            f"<geom {named} type='box' size='0.01 0.01 0.03' pos='0 0 0.03'/>"
            + (f"<site name='{site.format(short)}'/>" if site else "")
            + "</body>"
        )
        motors += f"<motor name='{motor.format(short, i=i)}' joint='j{i}' ctrlrange='-1 1'/>"
    file = tmp_path / "hand.xml"
    file.write_text(
        "<mujoco><worldbody><body name='palm'><geom type='box' size='0.05 0.05 0.01'/>"
        f"{bodies}</body></worldbody><actuator>{motors}</actuator></mujoco>"
    )
    assert [finger.name for finger in load_hand(file).fingers] == ["thumb", "index", "middle"]


def test_two_hands_have_fingers_of_either_side(tmp_path):
    """A joint of the wrist carries all fingers of a hand and tells nothing of any of them."""
    sides = ""
    for x, side in enumerate(("left", "right")):
        fingers = "".join(
            f"<body name='{side}_{i}' pos='{0.05 * i} 0 0.02'><joint name='{side}_{letter}-mcp' axis='0 1 0' "
            "range='-60 60'/><geom type='box' size='0.01 0.01 0.03' pos='0 0 0.03'/></body>"
            for i, letter in enumerate("tim")
        )
        sides += (
            f"<body name='{side}_palm' pos='{x} 0 0'><joint name='{side}_wrist' axis='0 1 0' range='-9 9'/>"
            f"<geom type='box' size='0.05 0.05 0.01'/>{fingers}</body>"
        )
    file = tmp_path / "hands.xml"
    file.write_text(f"<mujoco><worldbody>{sides}</worldbody></mujoco>")
    named = [finger.name for finger in load_hand(file).fingers]
    assert named == [f"{side}_{finger}" for side in ("left", "right") for finger in ("thumb", "index", "middle")]
