"""Grasps as they are asked for: fingers, parts of the object, directions; refusals that name the wish."""

from __future__ import annotations

import secrets

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pinograsp.contacts import PALM, close_hand
from pinograsp.contacts.edges import on_edges
from pinograsp.errors import InvalidInput
from pinograsp.forces import GraspConditions, Reserve, Task
from pinograsp.hands import load_hand
from pinograsp.objects import Cylinder, Mesh
from pinograsp.spatial import pose_of
from pinograsp.synthesis import Approach, Wishes, find_grasps
from pinograsp.synthesis.preshapes import measure_thickness
from pinograsp.synthesis.seeds import Region, find_gap
from pinograsp.synthesis.wishes import WishCheck, find_fingers

POSE = pin.SE3(pin.utils.rotate("z", 0.6), np.array([0.2, -0.1, 0.4])).homogeneous
REGIONS = {"lid": [[-0.03, -0.03, 0.02], [0.03, 0.03, 0.06]], "foot": [[-0.03, -0.03, -0.06], [0.03, 0.03, -0.02]]}
JAR = Cylinder(radius=0.028, height=0.11, mass=0.2, pose=POSE, regions=REGIONS)
CONDITIONS = GraspConditions(mu=0.7)


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro_right")


def search(hand, body, wishes, **options):
    settings = {"count": 24, "jobs": 1, "progress": False} | options
    seed = int(np.random.default_rng().integers(1000))
    return find_grasps(hand, body, CONDITIONS, wishes=wishes, seed=seed, **settings)


def points_of(grasp, fingers=None):
    """Where it touches, in the object's frame (k, 3)."""
    closure = grasp.closure
    touches = [touch for touch in closure.touches if fingers is None or touch.finger in fingers]
    pose = closure.object.pose
    return (np.vstack([touch.patch_o for touch in touches]) - pose[:3, 3]) @ pose[:3, :3]


def fingers_of(grasp):
    return {touch.finger for touch in grasp.closure.touches if touch.finger} - {PALM}


def inside(box, points, by=0.0):
    lower, upper = np.asarray(box)
    return ((points >= lower + by) & (points <= upper - by)).all(axis=1)


def starts_above(found):
    """Whether the fingers' first joints are above the object, so that no palm is beside it."""
    hand, body = found.closure.hand, found.closure.object
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, np.array(found.closure.q))
    starts = np.mean([data.oMi[finger.joint_ids[0]].translation[2] for finger in hand.fingers])
    around = np.linspace(0, 2 * np.pi, 100)
    rim = np.column_stack([body.radius * np.cos(around), body.radius * np.sin(around), np.full(100, body.height / 2)])
    ends = np.vstack([rim, rim * [1, 1, -1]]) @ body.pose[:3, :3].T + body.pose[:3, 3]
    return starts >= ends[:, 2].max() - 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wishes", "holds"),
    [
        (Wishes(fingers=("Thumb", "index")), lambda one: fingers_of(one) <= {"thumb", "index"}),
        (Wishes(least_fingers=4), lambda one: len(fingers_of(one)) == 4),
        (Wishes(within="lid"), lambda one: inside(REGIONS["lid"], points_of(one), -1e-9).all()),
        (Wishes(forbidden=("lid",)), lambda one: not inside(REGIONS["lid"], points_of(one), 1e-9).any()),
        (Wishes(touching=("lid",)), lambda one: inside(REGIONS["lid"], points_of(one, fingers_of(one)), -1e-9).any()),
        (Wishes(approach="above"), lambda one: -one.look_o[2] >= np.cos(np.radians(40)) - 1e-9 and starts_above(one)),
        (Wishes(approach="side"), lambda one: abs(one.look_o[2]) <= np.sin(np.radians(40)) + 1e-9),
        (
            Wishes(approach=Approach(direction=(0, 1, 0), cone=0.4, frame="object")),
            lambda one: one.look_o @ POSE[:3, 1] >= np.cos(0.4) - 1e-9,
        ),
        (Wishes(edges=False), lambda one: not on_edges(one.closure.object, one.closure.contacts()).any()),
        (Wishes(palm=True), lambda one: PALM in {touch.finger for touch in one.closure.touches}),
        (Wishes(palm=False), lambda one: PALM not in {touch.finger for touch in one.closure.touches}),
        (Wishes(opening=0.01), lambda one: one.room >= 0.01),
    ],
    ids=lambda value: "-".join(value.names) if isinstance(value, Wishes) else "",
)
def test_all_that_is_found_is_as_wished(allegro, wishes, holds):
    """Seeds are drawn anew each time."""
    found = search(allegro, JAR, wishes)
    assert found.grasps, found.explain()
    assert all(holds(grasp) for grasp in found.grasps)


@pytest.mark.slow
def test_fingers_that_are_not_named_stay_open(allegro):
    for grasp in search(allegro, JAR, Wishes(fingers=("thumb", "middle"))).grasps:
        closure = grasp.closure
        for finger in allegro.fingers:
            if finger.name not in ("thumb", "middle"):
                assert np.array_equal(closure.start[finger.dofs], closure.q[finger.dofs])


@pytest.mark.slow
def test_a_wish_that_is_in_the_way_is_named_with_what_is_nearest(allegro):
    found = search(allegro, JAR, Wishes(opening=0.5, palm=False), count=8)
    assert not found.grasps
    assert any("wish opening=0.5" in line and "the open hand leaves" in line for line in found.unmet), found.explain()
    assert "proven" not in found.explain()


@pytest.mark.slow
def test_a_task_that_is_in_the_way_is_named(allegro):
    conditions = GraspConditions(mu=0.7, reserve=Reserve(tasks=(Task.screw(torque=50.0),)))
    found = find_grasps(allegro, JAR, conditions, count=8, seed=1, jobs=1, progress=False)
    assert not any(grasp.withstands for grasp in found.grasps)
    assert any("tasks=screw with 50 N m" in line for line in found.unmet), found.explain()


def test_fingers_by_name(allegro):
    assert find_fingers(allegro, ["THUMB", " index "]) == ("thumb", "index")
    assert find_fingers(load_hand("psyonic_right"), ["little", "thumb"]) == ("pinky", "thumb")
    with pytest.raises(InvalidInput, match="'thump' is no finger of this hand.*did you mean 'thumb'"):
        find_fingers(allegro, ["thump"])
    with pytest.raises(InvalidInput, match="the same motor moves right"):
        find_fingers(load_hand("panda"), ["left"])


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"fingers": ()}, "each once"),
        ({"fingers": ("thumb", "thumb")}, "each once"),
        ({"least_fingers": 0}, "least_fingers"),
        ({"within": [[0, 0, 0], [1, 1, 0]]}, "lower corner < upper corner"),
        ({"touching": "lid"}, "a list of parts"),
        ({"approach": "left"}, "approach"),
        ({"opening": -0.01}, "opening"),
        ({"edges": None}, "edges"),
    ],
)
def test_wishes_that_cannot_be_used(wishes, message):
    with pytest.raises(InvalidInput, match=message):
        Wishes(**wishes)


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        (Wishes(within="rim"), "'rim' is no part of this object, which has lid, foot"),
        (Wishes(least_fingers=5), "expected at most 4, got 5"),
        (Wishes(least_fingers=3, fingers=("thumb", "ring")), "fingers= names no more"),
    ],
)
def test_wishes_that_this_hand_and_object_cannot_have(allegro, wishes, message):
    with pytest.raises(InvalidInput, match=message):
        find_grasps(allegro, JAR, CONDITIONS, wishes=wishes, count=4, jobs=1, progress=False)


def test_directions_turn_with_what_they_belong_to(allegro):
    """The object's own axes turn with it; above is against gravity."""
    approach = Approach(direction=(1.0, 2.0, 0.5), cone=0.3, frame="object")
    turned = JAR.placed(pin.SE3(pin.utils.rotate("y", 1.1), np.zeros(3)).homogeneous @ POSE)
    for body in (JAR, turned):
        check = WishCheck(Wishes(approach=approach), allegro, body)
        assert np.allclose(body.pose[:3, :3].T @ check.look_o, approach.direction)
    check = WishCheck(Wishes(approach="above"), allegro, JAR, (3.0, 0.0, 4.0))
    assert np.allclose(check.look_o, (0.6, 0.0, 0.8)) and check.least == 0.0


def test_what_is_missed_is_measured(allegro):
    """A closed hand looked at with wishes that it cannot meet: each miss has its figure."""
    body = Cylinder(radius=0.03, height=0.2, mass=0.1, pose=pin.SE3(np.eye(3), np.array([0.06, 0.0, 0.1])).homogeneous)
    closure = close_hand(allegro, body)
    names = {touch.finger for touch in closure.touches}
    wishes = Wishes(
        fingers=("thumb",), within=[[-1, -1, 5.0], [1, 1, 6.0]], approach=Approach(direction=(0, 0, 1), cone=0.1)
    )
    misses = {miss.wish: miss for miss in WishCheck(wishes, allegro, body).misses(closure, np.array([0.0, 0.0, -1.0]))}
    assert misses["approach"].by == pytest.approx(1.0 - 0.1 / np.pi)
    assert ("fingers" in misses) is bool(names - {"", "palm", "thumb"})
    assert set(misses["approach"].fingers) == set()


def test_openings_are_as_wide_as_they_were_made():
    """A plate on two posts: between them what was left free, in whatever place and direction; a solid has none."""
    rng = np.random.default_rng(secrets.randbelow(2**32))
    gap = rng.uniform(0.012, 0.04)
    parts = [trimesh.creation.box((0.02, 0.03, 0.06)) for _ in range(2)]
    parts.append(trimesh.creation.box((0.04 + gap, 0.03, 0.02)))
    parts[0].apply_translation([(gap + 0.02) / 2, 0, 0])
    parts[1].apply_translation([-(gap + 0.02) / 2, 0, 0])
    parts[2].apply_translation([0, 0, -0.04])
    made = trimesh.boolean.union(parts, engine="manifold")
    pose = pose_of(rng.normal(size=3), pin.exp3(rng.normal(size=3)))
    body = Mesh(vertices=made.vertices, faces=made.faces, mass=0.2, pose=pose)
    posts = Region(lower=np.array([-0.1, -0.1, -0.02]), upper=np.full(3, 0.1), pose=np.array(body.pose))
    assert find_gap(body, posts, rng) == pytest.approx(gap, rel=0.05)
    solid = Cylinder(radius=0.03, height=0.1, mass=0.2)
    assert find_gap(solid, Region(lower=-np.full(3, 0.1), upper=np.full(3, 0.1), pose=np.eye(4)), rng) == 0.0


def test_fingers_are_as_thick_as_their_shapes(allegro):
    """The ends of an Allegro's fingers are between 12 and 28 mm thick."""
    thick = measure_thickness(allegro)
    assert set(thick) == {finger.name for finger in allegro.fingers}
    assert all(0.012 < one < 0.028 for one in thick.values())
