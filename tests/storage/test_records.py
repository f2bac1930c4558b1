"""Hands and objects written down and made again: nothing is lost, nothing is run, and what is broken is told."""

from __future__ import annotations

import copy
import json
import pickle
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import coal
import numpy as np
import own_hands
import pinocchio as pin
import pytest
import trimesh
from marks import slow_except
from shipped_hands import SOME_HANDS, loaded

from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import HandModel, load_hand
from pinograsp.hands.catalogue import CATALOGUE
from pinograsp.hands.humanoid import humanoid_hand
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.objects import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from pinograsp.objects.record import object_of, object_record
from pinograsp.spatial import pose_of

POSE = pose_of([0.3, -0.2, 0.5], pin.rpy.rpyToMatrix(0.4, -1.1, 2.0))


def through_text(record):
    return json.loads(json.dumps(record, allow_nan=False))


def again(hand):
    record = hand_record(hand)
    assert through_text(record) == record
    return hand_of(through_text(record))


# -- hands -------------------------------------------------------------------------------------------------------------


def distances(hand, q, thing, at):
    data, placed = hand.model.createData(), hand.geometry.createData()
    pin.updateGeometryPlacements(hand.model, data, hand.geometry, placed, q)
    found = []
    for one, M in zip(hand.geometry.geometryObjects, placed.oMg):
        result = coal.DistanceResult()
        coal.distance(
            one.geometry,
            coal.Transform3s(M.rotation, M.translation),
            thing,
            coal.Transform3s(np.eye(3), at),
            coal.DistanceRequest(),
            result,
        )
        found.append(result.min_distance)
    return np.array(found)


def check_same(hand: HandModel, other: HandModel):
    for name in ("name", "source", "palm", "notes", "description", "joint_names", "n", "mass", "couplings"):
        assert getattr(hand, name) == getattr(other, name), name
    for name in ("pose", "lower", "upper", "effort", "velocity"):
        assert np.array_equal(getattr(hand, name), getattr(other, name)), name
    assert hand.describe() == other.describe()
    for mine, theirs in zip(hand.fingers, other.fingers, strict=True):
        for name in ("name", "joints", "links", "tip", "joint_ids", "actuated", "n", "coupled"):
            assert getattr(mine, name) == getattr(theirs, name)
        assert np.array_equal(mine.dofs, theirs.dofs)
    one, two = hand.model, other.model
    assert list(one.names) == list(two.names) and list(one.parents) == list(two.parents)
    assert np.array_equal(one.armature, two.armature) and np.array_equal(one.damping, two.damping)
    assert np.array_equal(one.friction, two.friction) and one.gravity == two.gravity
    for a, b in zip(one.frames, two.frames, strict=True):
        assert (a.name, a.type, a.parentJoint, a.parentFrame) == (b.name, b.type, b.parentJoint, b.parentFrame)
        assert a.placement == b.placement and a.inertia.isApprox(b.inertia, 1e-15)
    assert all(hand.is_prismatic(j) == other.is_prismatic(j) for j in range(1, one.njoints))
    assert all(a == b for a, b in zip(one.inertias, two.inertias, strict=True))
    shapes = list(zip(hand.geometry.geometryObjects, other.geometry.geometryObjects, strict=True))
    for a, b in shapes:
        assert (a.name, a.parentJoint, a.parentFrame, a.meshPath) == (b.name, b.parentJoint, b.parentFrame, b.meshPath)
        assert a.placement == b.placement and np.array_equal(a.meshScale, b.meshScale)
        assert type(a.geometry) is type(b.geometry)
    rng, data, others = np.random.default_rng(4), one.createData(), two.createData()
    for q in rng.uniform(hand.lower, hand.upper, (3, hand.n)):
        v, a = rng.normal(size=(2, hand.n))
        pin.framesForwardKinematics(one, data, q)
        pin.framesForwardKinematics(two, others, q)
        assert max(np.abs(A.homogeneous - B.homogeneous).max() for A, B in zip(data.oMf, others.oMf)) <= 1e-15
        assert np.abs(pin.crba(one, data, q) - pin.crba(two, others, q)).max() <= 1e-15
        assert np.abs(pin.rnea(one, data, q, v, a) - pin.rnea(two, others, q, v, a)).max() <= 1e-13
    ball, at = coal.Sphere(0.01), hand.pose[:3, 3] + [0.4, 0.3, 0.2]
    assert np.abs(distances(hand, q, ball, at) - distances(other, q, ball, at)).max(initial=0) <= 1e-12


@pytest.mark.parametrize("name", slow_except(CATALOGUE, *SOME_HANDS))
def test_every_hand_of_the_catalogue_comes_back(name):
    hand = loaded(name)
    check_same(hand, again(hand))
    i = hand.n // 2
    low, high = hand.lower[i], hand.upper[i]
    changed = hand.with_limits({hand.joint_names[i]: (low + 0.1 * (high - low), high)}).placed(POSE)
    back = again(changed)
    check_same(changed, back)
    assert "set to" in back.notes[-1]
    check_same(changed.placed(np.eye(4)), back.placed(np.eye(4)))


@pytest.mark.parametrize("name", own_hands.HANDS)
def test_coupled_hands_of_ones_own(name, tmp_path):
    hand = load_hand(own_hands.write(tmp_path, name), pose=POSE)
    assert hand.couplings
    back = again(hand)
    check_same(hand, back)
    (tmp_path / f"{name}.urdf").unlink()  # primitives need no file
    check_same(hand, again(back))
    check_same(back, pickle.loads(pickle.dumps(back)))


def test_tables_and_xacro_arguments(tmp_path):
    source, _ = humanoid_hand().write(tmp_path)
    hand = load_hand(
        source, xacro_args={"density": "900"}, pose=POSE, fingers={"pointer": "index_tip", "thumb": "thumb_tip"}
    )
    assert hand.mass == pytest.approx(loaded("humanoid").mass * 900 / 1160)
    check_same(hand, again(hand))
    source.unlink()
    assert [finger.name for finger in again(hand).fingers] == ["pointer", "thumb"]


MJCF = """<mujoco model="two fingers">
  <compiler angle="degree"/>
  <default><joint axis="0 1 0" range="-10 80" armature="0.002" damping="0.1"/>
    <geom density="800" size="0.008"/></default>
  <worldbody><body name="palm" pos="0.1 0 0"><geom type="box" size="0.04 0.03 0.01"/>
    <body name="a" pos="0.03 0 0.01"><joint name="ja"/><geom type="capsule" fromto="0 0 0 0 0 0.05"/>
      <body name="a2" pos="0 0 0.05"><joint name="ja2"/><geom type="cylinder" size="0.006 0.02" pos="0 0 0.02"/></body>
    </body>
    <body name="b" pos="-0.03 0 0.01"><joint name="jb" axis="0 -1 0"/><geom type="ellipsoid" size="0.01 0.01 0.03"/>
      <body name="b2" pos="0 0 0.05"><joint name="jb2" type="slide" axis="0 0 1" range="0 0.02"/>
        <geom type="mesh" mesh="tip"/></body></body></body></worldbody>
  <asset><mesh name="tip" file="tip.stl" scale="0.001 0.001 0.002"/></asset>
  <equality><joint joint1="ja2" joint2="ja" polycoef="0.1 0.7 0 0 0"/></equality>
</mujoco>"""


@pytest.fixture
def two_fingers(tmp_path):
    """A hand from MJCF with a coupled joint, a sliding one, armatures, every primitive and a mesh of its own."""
    trimesh.creation.icosphere(subdivisions=2, radius=9.0).export(tmp_path / "tip.stl")
    (tmp_path / "two.xml").write_text(MJCF)
    return load_hand(tmp_path / "two.xml", pose=POSE)


def test_a_hand_from_mjcf(two_fingers):
    assert two_fingers.couplings["ja2"].factor == pytest.approx(0.7) and np.all(two_fingers.model.armature > 0)
    back = again(two_fingers)
    check_same(two_fingers, back)
    kinds = {type(one.geometry) for one in back.geometry.geometryObjects}
    assert kinds == {coal.Box, coal.Capsule, coal.Cylinder, coal.Ellipsoid, coal.Convex}
    assert sum(isinstance(one, coal.BVHModelOBBRSS) for one in back.own_shapes) > 0


def test_masses_that_came_from_shapes(tmp_path):
    text = ElementTree.fromstring(own_hands.PLANAR_GRIPPER)
    for link in text.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    (tmp_path / "light.urdf").write_text(ElementTree.tostring(text, encoding="unicode"))
    hand = load_hand(tmp_path / "light.urdf")
    assert any("no masses given" in note for note in hand.notes)
    check_same(hand, again(hand))


def test_meshes_that_are_gone_are_all_named(two_fingers, tmp_path):
    record = hand_record(two_fingers)
    [mesh] = [one for one in record["geometry"] if one["kind"] == "hull"]
    assert mesh["path"] == str(tmp_path / "tip.stl") and mesh["size"] == [0.001, 0.001, 0.002]
    other = copy.deepcopy(mesh)
    other.update(name="other", path="tip.stl")  # not beside whoever reads it
    record["geometry"].append(other)
    (tmp_path / "tip.stl").unlink()
    with pytest.raises(HandNotLoaded) as caught:
        hand_of(through_text(record))
    assert len(caught.value.problems) == 2 and str(tmp_path / "tip.stl") in caught.value.problems[0]
    assert "put the file back" in str(caught.value)


def test_meshes_that_are_none(two_fingers, tmp_path):
    record = hand_record(two_fingers)
    [mesh] = [one for one in record["geometry"] if one["kind"] == "hull"]
    (tmp_path / "text.stl").write_text("no mesh")
    for path in (str(tmp_path / "text.stl"), str(tmp_path), "/dev/zero", "/etc/passwd", "a\0b", "http://a.b/c.stl", ""):
        mesh["path"] = path
        with pytest.raises(HandNotLoaded, match=r"is not there|cannot be read"):
            hand_of(through_text(record))


def test_hands_that_cannot_be_written_down(two_fingers):
    assert hand_record(replace(two_fingers, description="")) is None
    other = two_fingers.model.copy()
    other.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "more")
    assert hand_record(replace(two_fingers, model=other)) is None
    geometry = two_fingers.geometry.copy()
    geometry.addGeometryObject(pin.GeometryObject("cone", 0, 1, pin.SE3.Identity(), coal.Cone(0.1, 0.2)))
    assert hand_record(replace(two_fingers, geometry=geometry)) is None


@pytest.fixture
def gripper(tmp_path):
    return hand_record(load_hand(own_hands.write(tmp_path, "planar_gripper")))


@pytest.mark.parametrize(
    "part, value, message",
    [
        (("description",), "no xml", "not well-formed"),
        (("description",), "<robot><link name='a'/></robot>", "no revolute or prismatic joint"),
        (("description",), "<mujoco/>", "no <link>"),
        (("joints",), [], "expected its description's"),
        (("joints", 1, "name"), "right_hinge", "expected its description's"),
        (("joints", 1, "placement"), np.zeros((4, 4)).tolist(), "orthonormal"),
        (("joints", 1, "inertia"), [[1, 1, 0], [0, 1, 0], [0, 0, 1]], "symmetric"),
        (("joints", 1, "mass"), -1.0, ">= 0"),
        (("joints", 1, "mass"), 10**400, "expected a finite number"),
        (("limits", "effortLimit"), [1.0, 1.0], r"shape \(1,\)"),
        (("limits", "effortLimit"), [-1.0], "none below zero"),
        (("limits", "lowerPositionLimit"), [7.0], "below the upper"),
        (("frames", 3, "joint"), 0, "expected joint 1, got 0"),
        (("geometry", 0, "frame"), 99, "a frame and its joint"),
        (("geometry", 0, "frame"), -1, "a frame and its joint"),
        (("geometry", 0, "kind"), "cone", "expected one of box"),
        (("geometry", 0, "size"), [0.1, 0.1], r"shape \(3,\)"),
        (("geometry", 0, "size"), [0.1, 0.0, 0.1], "above zero"),
        (("geometry", 1, "name"), "palm_0", "each name once"),
        (("fingers", 0, "joints"), [], "one link for each joint"),
        (("fingers", 0, "joints"), ["hinge"], "expected one of left_hinge"),
        (("fingers", 0, "tip"), "toe", "expected one of palm"),
        (("palm",), "hand", "expected one of palm"),
        (("pose",), [0, 0, 0], r"shape \(4, 4\)"),
        (("notes",), [1], "a list of texts"),
    ],
)
def test_broken_records_say_what_was_expected(gripper, part, value, message):
    inner = gripper
    for key in part[:-1]:
        inner = inner[key]
    inner[part[-1]] = value
    with pytest.raises(InvalidInput, match=message):
        hand_of(through_text(gripper))


def places(value, at=()):
    yield at
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(inner, (*at, key))


def damaged(record, junk):
    """The record with one value replaced or left out, at every place but inside of matrices."""
    for place in places(record):
        if not place or len([key for key in place if isinstance(key, int)]) > 2:
            continue
        for value in (*junk, KeyError):
            other = copy.deepcopy(record)
            inner = other
            for key in place[:-1]:
                inner = inner[key]
            if value is KeyError:
                del inner[place[-1]]
            else:
                inner[place[-1]] = value
            yield other


JUNK = (None, -1, 10**400, float("nan"), "x", [], [[1, 2], [3]], {"a": 1}, True)


@pytest.mark.parametrize(
    "change",
    [
        lambda record: record["geometry"][0].update(size=[1e100] * 3),
        lambda record: record["joints"][3].update(lever=[1e100, 0, 0]),
        lambda record: record["frames"][5]["placement"][0].__setitem__(3, 1e200),
        lambda record: record["joints"][2]["placement"][1].__setitem__(3, -1e5),
    ],
)
def test_lengths_out_of_all_proportion_are_refused(change):
    record = through_text(hand_record(loaded("humanoid")))
    hand_of(record)
    change(record)
    with pytest.raises(InvalidInput, match="up to 1000 m"):
        hand_of(record)


@pytest.mark.slow
def test_whatever_is_in_a_record_the_error_is_ours(gripper):
    for broken in (None, [], "record", 3, {}):
        with pytest.raises(InvalidInput):
            hand_of(broken)
    several = 0
    for record in damaged(gripper, JUNK):
        several += 1
        try:
            hand_of(record)
        except InvalidInput as error:
            assert len(str(error)) < 2000
    assert several > 500


def test_errors_of_long_names_are_short(gripper):
    gripper["source"], gripper["description"] = "x" * 5000, "<robot>"
    with pytest.raises(HandNotLoaded, match=r"xxx\.\.\.' could not be loaded") as caught:
        hand_of(gripper)
    assert len(str(caught.value)) < 600 and len(caught.value.source) == 5000


@pytest.mark.slow
def test_descriptions_that_would_harm(gripper):
    links = "".join(f'<link name="l{i}"/>' for i in range(6000))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(5999)
    )
    for text, message in (
        (f"<robot>{links}{joints}</robot>", "at most 2000 links"),
        ("<robot>" + "<a>" * 50000 + "</a>" * 50000 + "</robot>", "nested without end"),
        (gripper["description"].replace('type="revolute"', 'type="floating"'), "floats freely"),
        (gripper["description"].replace('type="revolute"', 'type="continuous"'), "got continuous ones"),
        (gripper["description"].replace("0000 left", "0009 left"), "Pinocchio cannot build"),
        (gripper["description"].replace("0.0 1.0 0.0", "0 0 0"), "axis xyz=> is zero"),
        (gripper["description"].replace('multiplier="-1.0"', 'multiplier="0"'), "make it fixed"),
    ):
        with pytest.raises(HandNotLoaded, match=message):
            hand_of({**gripper, "description": text})


# -- objects -----------------------------------------------------------------------------------------------------------

ICO, RING = trimesh.creation.icosphere(subdivisions=2, radius=0.03), trimesh.creation.annulus(0.02, 0.03, 0.04)
OBJECTS = {
    "sphere": Sphere(radius=0.03, mass=0.2, pose=POSE),
    "cylinder": Cylinder(radius=0.03, height=0.1, density=700.0),
    "capsule": Capsule(radius=0.03, length=0.1, mass=0.3),
    "box": Box(size=[0.03, 0.04, 0.05], density=321.0, pose=POSE),
    "ellipsoid": Ellipsoid(semi_axes=[0.03, 0.04, 0.05], mass=0.1),
    "mesh": Mesh(vertices=ICO.vertices + 2.0, faces=ICO.faces[:, ::-1], mass=0.1, pose=POSE),
    "mesh, ring": Mesh(vertices=RING.vertices - [1, 2, 3], faces=RING.faces, density=400.0),
    "mesh, its hull": Mesh(vertices=RING.vertices, faces=RING.faces[:-3], density=400.0, convex=True, pose=POSE),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_come_back(name):
    thing = OBJECTS[name]
    record = object_record(thing)
    assert through_text(record) == record
    back = object_of(through_text(record))
    assert type(back) is type(thing) and back.mass == thing.mass and back.density == thing.density
    assert np.array_equal(back.pose, thing.pose)
    assert np.abs(back.inertia_b - thing.inertia_b).max() <= 1e-13 * np.abs(thing.inertia_b).max()
    for size in ("radius", "height", "length", "size", "semi_axes", "convex", "notes", "faces"):
        if hasattr(thing, size) and not (size == "faces" and thing.convex):
            assert np.array_equal(getattr(back, size), getattr(thing, size)), size
    points = thing.com_o + np.random.default_rng(0).normal(size=(50, 3)) * 0.05
    for ours, theirs in zip(back.project(points), thing.project(points)):
        assert np.abs(ours - theirs).max() <= 1e-13
    if isinstance(thing, Mesh):
        assert np.abs(back.vertices - thing.vertices).max() <= 1e-15
        assert np.abs(back.com_b - thing.com_b).max() <= 1e-15
        assert type(back.collision_geometry) is type(thing.collision_geometry)


class Pen(Cylinder):
    """Somebody's own."""


def test_objects_of_ones_own_are_not_written_down():
    assert object_record(Pen(radius=0.01, height=0.1, mass=0.1)) is None
    assert object_record(None) is None


@pytest.mark.parametrize("name", ["box", "cylinder", "mesh, ring"])
def test_broken_objects(name):
    for broken in (None, [], "sphere", {}, {"shape": "cone"}, {"shape": []}):
        with pytest.raises(InvalidInput):
            object_of(broken)
    record = object_record(OBJECTS[name])
    with pytest.raises(InvalidInput, match="expected shape, mass, density, pose"):
        object_of({**record, "colour": "red"})
    for place, value in ((key, value) for key in record for value in JUNK):
        try:
            object_of({**record, place: value})
        except InvalidInput as error:
            assert len(str(error)) < 2000
        else:
            assert (place, value) in [("mass", None), ("density", None), ("notes", []), ("convex", True)]


def test_a_strangers_open_mesh_is_refused():
    record = object_record(OBJECTS["mesh"])
    with pytest.raises(InvalidInput, match="watertight"):
        object_of({**record, "faces": record["faces"][1:]})
