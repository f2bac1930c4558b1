"""Closing a hand: first touches against closed forms and dense sampling, stops, coupled jaws, flat contacts, the
paper's grasp.
"""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pinograsp.cases import load_case
from pinograsp.contacts import PALM, clearance, close_hand, open_and_closed
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import GeometryFailed, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.humanoid import FINAL_ANGLES_DEG
from pinograsp.objects import Box, Cylinder, Mesh, Sphere

INERTIAL = (
    '<inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def link(name, geometry="", at="0 0 0"):
    collision = f'<collision><origin xyz="{at}"/><geometry>{geometry}</geometry></collision>' if geometry else ""
    return f'<link name="{name}">{INERTIAL}{collision}</link>'


def joint(name, parent, child, at="0 0 0", axis="0 -1 0", kind="revolute", limits="0 2", more=""):
    lower, upper = limits.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="5" velocity="5"/>{more}</joint>'
    )


def write(tmp_path, *parts):
    path = tmp_path / "hand.urdf"
    path.write_text(f'<robot name="test">{"".join(parts)}</robot>')
    return path


def at(*position):
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


@pytest.fixture
def two_links(tmp_path):
    """A finger in the x-z plane: two links of 50 and 40 mm, balls of 6 and 5 mm at their ends; flexion towards +z."""
    return load_hand(
        write(
            tmp_path,
            link("palm", '<box size="0.04 0.06 0.02"/>', "-0.03 0 0"),
            link("inner", '<sphere radius="0.006"/>', "0.05 0 0"),
            link("outer", '<sphere radius="0.005"/>', "0.04 0 0"),
            joint("j1", "palm", "inner"),
            joint("j2", "inner", "outer", "0.05 0 0"),
        )
    )


def first_meeting(length, ball, radius, centre):
    """Angle at which a ball at the end of an arm from the origin first meets a ball: law of cosines, from angle 0 on."""
    distance, towards = np.hypot(*centre), np.arctan2(centre[1], centre[0])
    cosine = (length**2 + distance**2 - (ball + radius) ** 2) / (2 * length * distance)
    return towards - np.arccos(cosine)


@pytest.mark.parametrize("seed", range(8))
def test_ball_on_ball(two_links, seed):
    """Both links straight: the outer ball is at 90 mm. Touch angle and point in closed form."""
    rng = np.random.default_rng(seed)
    radius, angle = rng.uniform(0.008, 0.02), rng.uniform(0.7, 1.4)
    centre = (0.09 + rng.uniform(-0.5, 0.5) * radius) * np.array([np.cos(angle), np.sin(angle)])
    ball = Sphere(radius=radius, mass=0.1, pose=at(centre[0], 0, centre[1]))
    closure = close_hand(two_links, ball, start=np.zeros(2), target=[1.9, 0.0])
    expected = first_meeting(0.09, 0.005, radius, centre)
    touch = closure.touches[0]
    assert touch.link == "outer" and closure.stops == {"j1": "touch of outer"}
    assert closure.q[0] == pytest.approx(expected, abs=1e-6 / 0.09)
    assert touch.at == pytest.approx(expected / 1.9, abs=1e-5)
    own = 0.09 * np.array([np.cos(expected), 0, np.sin(expected)])
    normal = (np.array([centre[0], 0, centre[1]]) - own) / (radius + 0.005)
    assert np.linalg.norm(touch.point_o - (own + 0.005 * normal)) < 1e-6
    assert touch.normal_o == pytest.approx(normal, abs=1e-4)
    assert (
        np.linalg.norm(
            touch.point_l
            - (
                np.array([0.04, 0, 0])
                + 0.005
                * np.array(
                    [[np.cos(expected), 0, np.sin(expected)], [0, 1, 0], [-np.sin(expected), 0, np.cos(expected)]]
                )
                @ normal
            )
        )
        < 1e-6
    )


def test_inner_touch_stops_the_joints_below_and_the_outer_goes_on(two_links):
    ball = Sphere(radius=0.015, mass=0.1, pose=at(0.045, 0, 0.032))
    closure = close_hand(two_links, ball, start=np.zeros(2), target=[1.9, 1.9])
    assert [touch.link for touch in closure.touches] == ["inner", "outer"]
    assert closure.stops == {"j1": "touch of inner", "j2": "touch of outer"}
    assert closure.touches[0].at < closure.touches[1].at
    assert clearance(two_links, ball, closure.q) == pytest.approx(0, abs=1e-6)
    # The inner joint stayed where it touched: its ball meets the object's in closed form.
    knuckle = 0.05 * np.array([np.cos(closure.q[0]), 0, np.sin(closure.q[0])])
    assert np.linalg.norm(knuckle - ball.com_o) == pytest.approx(0.021, abs=1e-6)
    shares, postures = closure.path.shares, closure.path.postures
    assert np.all(np.diff(shares) >= 0) and np.array_equal(postures[-1], closure.q)
    contacts = closure.contacts()
    assert contacts.names == tuple(f"{closure.hand.fingers[0].name}/{name}" for name in ("inner", "outer"))
    assert np.array_equal(contacts.posture, closure.q)


def test_wrapping_moves_the_joints_one_after_the_other(two_links):
    """The inner joint alone until its link touches, then the outer one: both angles in closed form."""
    centre, radius = np.array([0.045, 0.032]), 0.015
    ball = Sphere(radius=radius, mass=0.1, pose=at(centre[0], 0, centre[1]))
    closure = close_hand(two_links, ball, start=np.zeros(2), target=[1.9, 1.9], wrap=True)
    first = first_meeting(0.05, 0.006, radius, centre)
    c, s = np.cos(first), np.sin(first)
    second = first_meeting(0.04, 0.005, radius, np.array([[c, s], [-s, c]]) @ centre - [0.05, 0])
    assert [touch.link for touch in closure.touches] == ["inner", "outer"]
    assert closure.q == pytest.approx([first, second], abs=2e-5)  # 1e-6 m
    assert [touch.at for touch in closure.touches] == pytest.approx([first / 3.8, 0.5 + second / 3.8], abs=1e-5)
    # Nothing there to touch: every joint ends where it would have together.
    far = Sphere(radius=0.01, mass=0.1, pose=at(0.3, 0, 0.3))
    closure = close_hand(two_links, far, start=np.zeros(2), target=[3.0, 1.0], wrap=True)
    assert closure.stops == {"j1": "joint limit", "j2": "end of path"} and closure.path.shares[-1] == pytest.approx(1.0)


def test_joint_limits_and_objects_out_of_reach(two_links):
    far = Sphere(radius=0.01, mass=0.1, pose=at(0.3, 0, 0.3))
    closure = close_hand(two_links, far, start=np.zeros(2), target=[3.0, 1.0])
    assert closure.touches == () and closure.stops == {"j1": "joint limit", "j2": "end of path"}
    assert "left open" in closure.notes[0]
    with pytest.raises(InvalidInput, match="touches nothing"):
        closure.contacts()


def test_bad_starts_are_refused(two_links):
    ball = Sphere(radius=0.015, mass=0.1, pose=at(0.09, 0, 0.001))
    with pytest.raises(InvalidInput, match=r"'outer' .* overlaps the object by .* mm"):
        close_hand(two_links, ball, start=np.zeros(2), target=[1.0, 1.0])
    with pytest.raises(InvalidInput, match="within the joint limits, j1"):
        close_hand(two_links, ball, start=[-1.0, 0.0], target=[1.0, 1.0])
    with pytest.raises(InvalidInput, match="shape"):
        close_hand(two_links, ball, start=np.zeros(3), target=np.zeros(3))
    with pytest.raises(InvalidInput, match="finger"):
        close_hand(two_links, ball, start={"nobody": [0.0]}, target=np.zeros(2))


def test_palm_contact_at_the_start(two_links):
    ball = Sphere(radius=0.01, mass=0.1, pose=at(-0.03, 0, 0.02 + 5e-7))
    closure = close_hand(two_links, ball, start=np.zeros(2), target=[0.5, 0.0])
    assert [touch.finger for touch in closure.touches] == [PALM]
    assert closure.touches[0].point_o == pytest.approx([-0.03, 0, 0.01], abs=1e-6)
    assert closure.touches[0].normal_o == pytest.approx([0, 0, 1], abs=1e-6)
    assert close_hand(two_links, ball, start=np.zeros(2), target=[0.5, 0.0], palm=False).touches == ()


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro_right")


@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_no_touch_is_missed(allegro, seed, wrap):
    """Against dense sampling of the path: no link was in the object earlier, and none is inside in the end."""
    rng = np.random.default_rng(seed)
    ball = Sphere(radius=rng.uniform(0.02, 0.035), mass=0.2, pose=at(0.08, *rng.uniform(-0.02, 0.02, 1), 0.07))
    start, target = open_and_closed(allegro, ball)
    assert clearance(allegro, ball, start) > 0
    closure = close_hand(allegro, ball, start=start, target=target, wrap=wrap)
    assert closure.touches
    first = min(touch.at for touch in closure.touches)
    for share in np.linspace(0, 0.0 if wrap else first, 60)[:-1]:
        assert clearance(allegro, ball, start + share * (target - start)) > -2e-7
    postures = closure.path.postures
    for a, b in itertools.pairwise(postures):
        for share in np.linspace(0, 1, 8):
            assert clearance(allegro, ball, a + share * (b - a)) > -1e-6
    for touch in closure.touches:
        assert abs(touch.gap) <= 2e-7
        surface, normal, _ = ball.project(touch.point_o[None])
        assert np.linalg.norm(surface[0] - touch.point_o) < 1e-9 and normal[0] @ touch.normal_o > 1 - 1e-9


def test_moving_hand_and_object_together_changes_nothing(allegro):
    ball = Sphere(radius=0.03, mass=0.2, pose=at(0.08, 0, 0.07))
    still = close_hand(allegro, ball)
    move = pin.SE3(pin.exp3(np.array([0.3, -1.2, 0.7])), np.array([0.4, -0.2, 1.1]))
    moved = close_hand(
        allegro.placed(move.homogeneous @ allegro.pose),
        Sphere(radius=0.03, mass=0.2, pose=move.homogeneous @ ball.pose),
    )
    assert moved.q == pytest.approx(still.q, abs=1e-9)
    # By link: fingers that are alike touch at once, and the last digit says which is first.
    still_at, moved_at = ({touch.link: touch for touch in closure.touches} for closure in (still, moved))
    assert still_at.keys() == moved_at.keys() and len(still.touches) == len(moved.touches)
    for one, two in ((touch, moved_at[link]) for link, touch in still_at.items()):
        assert move.act(one.point_o) == pytest.approx(two.point_o, abs=1e-7)
        assert two.at == pytest.approx(one.at, abs=1e-9) and two.length == pytest.approx(one.length, abs=1e-7)


def ellipsoid_beside_cylinder(semi_axes, placement, radius):
    """Distance of an ellipsoid from a z cylinder's side through the origin, by its support function along the best
    direction.
    """
    from scipy.optimize import minimize_scalar

    def gap(angle):
        n = np.array([np.cos(angle), np.sin(angle), 0.0])
        return -(n @ placement.translation - np.linalg.norm(semi_axes * (placement.rotation.T @ n)))

    coarse = min(np.linspace(-np.pi, np.pi, 721), key=gap)
    best = minimize_scalar(gap, bounds=(coarse - 0.02, coarse + 0.02), method="bounded", options={"xatol": 1e-12})
    n = np.array([np.cos(best.x), np.sin(best.x), 0.0])
    return -best.fun - radius, radius * n


def test_table_iv_alone_gives_the_papers_grasp():
    """Phalanges as exact ellipsoids on the cylinder: touches against the closed form, contacts beside the published
    ones.
    """
    case = load_case("paper", {"forces.balance": "wrench"})
    hand, cylinder = case.load_hand(), case.make_object()
    target = {finger: np.radians(FINAL_ANGLES_DEG[finger]) for finger in ("thumb", "index", "middle")}
    closure = close_hand(hand, cylinder, start=np.zeros(hand.n), target=target)
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, closure.q)
    axis = cylinder.com_o * [1, 1, 0]
    for touch in closure.touches:
        one = next(g for g in hand.geometry.geometryObjects if g.parentJoint == touch.joint_id)
        placed = data.oMi[touch.joint_id] * one.placement
        placed.translation = placed.translation - axis
        gap, point = ellipsoid_beside_cylinder(np.array(one.geometry.radii), placed, cylinder.radius)
        assert 0 <= gap < 1e-6
        assert np.linalg.norm(touch.point_o[:2] - axis[:2] - point[:2]) < 1e-6
    published = case.make_contacts(hand)
    off = {
        name: np.linalg.norm(touch.point_o - p)
        for name, p in zip(published.names, published.points_o)
        for touch in closure.touches
        if touch.finger == name
    }
    # The thumb's flank meets the cylinder 2.8 mm from the published point, which its tip reaches only 1.3 mm inside.
    assert off == pytest.approx({"thumb": 2.797e-3, "index": 0.364e-3, "middle": 0.836e-3}, abs=2e-5)


def jaws(tmp_path, mimic=True, pads='<box size="0.02 0.004 0.03"/>'):
    """A parallel gripper: jaws slide along y, pads face each other, 80 mm open."""
    follow = '<mimic joint="left_slide" multiplier="1"/>' if mimic else ""
    return load_hand(
        write(
            tmp_path,
            link("palm", '<box size="0.06 0.12 0.02"/>', "0 0 -0.01"),
            link("left", pads, "0 0.042 0.03"),
            link("right", pads, "0 -0.042 0.03"),
            joint("left_slide", "palm", "left", axis="0 -1 0", kind="prismatic", limits="0 0.04"),
            joint("right_slide", "palm", "right", axis="0 1 0", kind="prismatic", limits="0 0.04", more=follow),
        )
    )


@pytest.mark.parametrize("off", [0.0, 0.007, -0.012])
def test_jaws_on_one_actuator_push_the_object_between_them(tmp_path, off):
    hand = jaws(tmp_path)
    assert hand.n == 1
    ball = Sphere(radius=0.02, mass=0.1, pose=at(0, off, 0.03))
    closure = close_hand(hand, ball)
    assert {touch.finger for touch in closure.touches} == {finger.name for finger in hand.fingers}
    # Caged half-way between the jaws, each of which has gone 40 mm - 20 mm.
    assert closure.q[0] == pytest.approx(0.02, abs=2e-6)
    assert closure.object.com_o == pytest.approx([0, 0, 0.03], abs=2e-6)
    assert closure.pushed[:3, 3] == pytest.approx([0, -off, 0], abs=2e-6)
    fixed = close_hand(hand, ball, fixed=True)
    assert len(fixed.touches) == (2 if off == 0 else 1) and np.array_equal(fixed.object.pose, ball.pose)
    # Jaws with actuators of their own need no pushing.
    apart = close_hand(jaws(tmp_path, mimic=False), ball)
    assert len(apart.touches) == 2 and np.array_equal(apart.pushed, np.eye(4))
    assert sorted(apart.q) == pytest.approx(sorted([0.02 - off, 0.02 + off]), abs=1e-6)


@pytest.mark.parametrize("kind", [Box, Mesh])
@pytest.mark.parametrize("off", [0.007, -0.012])
def test_an_edge_is_pushed_along_the_normal_of_the_jaw_that_pushes_it(tmp_path, kind, off):
    """On edge between the jaws, with a friction that jams it there, a box goes straight on and does not turn."""
    on_edge = at(0.001, off, 0.04)
    on_edge[:3, :3] = pin.exp3(np.array([0, 0, np.pi / 4]))
    solid = trimesh.creation.box((0.03, 0.03, 0.06))
    shape = {Box: {"size": (0.03, 0.03, 0.06)}, Mesh: {"vertices": solid.vertices, "faces": solid.faces}}[kind]
    closure = close_hand(jaws(tmp_path), kind(**shape, mass=0.1, pose=on_edge), friction=1.0)
    assert len(closure.touches) == 2
    assert closure.pushed[:3, 3] == pytest.approx([0, -off, 0], abs=1e-5)
    assert pin.log3(closure.pushed[:3, :3]) == pytest.approx(np.zeros(3), abs=1e-5)
    # Half of the diagonal on either side of the middle.
    assert closure.q[0] == pytest.approx(0.04 - 0.015 * np.sqrt(2), abs=4e-6)


def test_a_turned_box_is_turned_flat_and_touches_with_its_faces(tmp_path):
    turned = at(0, 0.003, 0.03)
    turned[:3, :3] = pin.exp3(np.array([0, 0, 0.1]))
    turned[2, 3] += 0.01  # clear of the palm
    box = Box(size=(0.05, 0.03, 0.06), mass=0.1, pose=turned)
    closure = close_hand(jaws(tmp_path), box)
    assert closure.q[0] == pytest.approx(0.04 - 0.015, abs=1e-5)
    assert abs(closure.object.pose[0, 1]) < 1e-4  # square between the pads
    contacts = closure.contacts()
    assert len(contacts) == 8  # four corners on each side
    across = np.abs(contacts.points_o - closure.object.com_o)
    assert across[:, 1] == pytest.approx(0.015, abs=2e-5)
    assert across[:, 0] == pytest.approx(0.01, abs=1e-3)
    # The pads reach from 15 to 45 mm above the palm, the box from 10 to 70 mm.
    assert sorted(set(contacts.points_o[:, 2].round(4))) == [0.015, 0.045]
    assert len(closure.contacts(patches=False)) == 2
    assert len(set(contacts.names)) == 8


def test_rounder_pads_touch_at_a_point(tmp_path):
    closure = close_hand(
        jaws(tmp_path, pads='<sphere radius="0.002"/>'),
        Cylinder(radius=0.02, height=0.05, mass=0.1, pose=at(0, 0, 0.03)),
    )
    assert len(closure.contacts()) == 2 and all(len(touch.patch_o) == 1 for touch in closure.touches)


@pytest.mark.parametrize("name", ["allegro_right", "panda", "humanoid", "so101"])
def test_nothing_is_touched_before_a_touch_is_noted(name):
    """Along the whole path no link overlaps the object, convex or not: steps by planes and by speeds skip no touch."""
    from pinograsp.contacts import fingertips
    from pinograsp.contacts.clearance import Distances, parts_of

    hand, rng = load_hand(name), np.random.default_rng()
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, (hand.lower + hand.upper) / 2)
    between = fingertips(hand, data).mean(axis=0)
    ring = trimesh.creation.annulus(0.012, 0.02, 0.03)
    hollow = Mesh(vertices=ring.vertices, faces=ring.faces, mass=0.05)
    for body in (Sphere(radius=0.02, mass=0.1), Box(size=(0.03, 0.04, 0.05), mass=0.1), hollow):
        closed = 0
        for _ in range(300):  # until three placements are out of the open hand's way, and are touched
            pose = pin.SE3(pin.exp3(rng.normal(size=3)), between + 0.03 * rng.normal(size=3)).homogeneous
            try:
                closure = close_hand(hand, body.placed(pose), fixed=True)
            except (InvalidInput, GeometryFailed):
                continue
            if not closure.touches:
                continue
            distances, parts = Distances(hand, closure.object), [part for part in parts_of(hand) if part.joint]
            shares, postures = closure.path.shares, closure.path.postures
            for share in np.linspace(0, shares[-1], 60):
                distances.put(np.array([np.interp(share, shares, way) for way in postures.T]))
                assert min(distances.of(part)[0] for part in parts) > -2.1e-7
            closed += 1
            if closed == 3:
                break
        assert closed


@pytest.mark.parametrize("name", ["so101", "sake_left", "panda", "talos_left", "humanoid"])
def test_hulls_are_never_farther_than_what_they_cover(name):
    """Dented meshes included: closing skips what their hulls say is far."""
    from pinograsp.contacts.clearance import Distances, HandPart

    hand, rng, compared = load_hand(name), np.random.default_rng(0), 0
    parts = [HandPart(hand, one, {}) for one in hand.geometry.geometryObjects]
    for _ in range(8):
        pose = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.15, 0.15, 3)).homogeneous
        box = Box(size=(0.03, 0.04, 0.05), mass=0.1, pose=pose)
        distances = Distances(hand, box)
        q = rng.uniform(hand.lower, hand.upper)
        distances.put(q)
        exact = [distances.of(part)[0] for part in parts]
        for part, gap in zip(parts, exact):
            if gap > 0:
                compared += 1
                assert distances.rough(part) <= gap + 1e-9
                assert distances.bound(part)[0] <= gap + 1e-9
        if min(exact) > 0:
            assert clearance(hand, box, q) == pytest.approx(min(exact), abs=1e-9)
    assert compared > 10


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_flat_meshes_can_touch(tmp_path, tilt):
    """A plate without thickness has no hull."""
    along = np.linspace(0, 0.05, 5)
    grid = np.array([[x, y, tilt * x + 0.1 * tilt * y] for x in along for y in along])
    corners = [i * 5 + j for i in range(4) for j in range(4)]
    faces = [face for c in corners for face in ((c, c + 5, c + 6), (c, c + 6, c + 1))]
    trimesh.Trimesh(grid, faces, process=False).export(tmp_path / "plate.stl")
    hand = load_hand(
        write(
            tmp_path,
            link("palm", '<box size="0.04 0.06 0.02"/>', "-0.03 0 0"),
            link("plate", '<mesh filename="plate.stl"/>'),
            joint("j1", "palm", "plate"),
        )
    )
    ball = Sphere(radius=0.01, mass=0.1, pose=at(0.03, 0.02, 0.05))
    closure = close_hand(hand, ball, start=[0.0], target=[1.9], fixed=True)
    assert [touch.link for touch in closure.touches] == ["plate"]
    assert clearance(hand, ball, closure.q) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("wrap, target", [(True, [1.9, 1.9]), (False, [4.0, 1.9])])
def test_joints_stay_on_their_way(two_links, seed, wrap, target):
    """A single finger pushes: every joint to its own end and no farther."""
    rng = np.random.default_rng(seed)
    radius, angle = rng.uniform(0.005, 0.012), rng.uniform(0.5, 1.5)
    reach = rng.uniform(0.03, 0.09)
    ball = Sphere(radius=radius, mass=0.1, pose=at(reach * np.cos(angle), 0, reach * np.sin(angle)))
    closure = close_hand(two_links, ball, start=np.zeros(2), target=target, wrap=wrap)
    ends = np.minimum(target, two_links.upper)
    assert np.all(closure.q >= -1e-12) and np.all(closure.q <= ends + 1e-12)
    assert np.all(closure.path.postures <= ends + 1e-12)


def test_depths_of_parts_deep_in_an_object(tmp_path):
    """Coal's depth of a box deep inside is next to nothing; the way out is found all the same."""
    parts = [link("palm", '<box size="0.1 0.1 0.03"/>', "0 0 -0.015")]
    for i, angle in enumerate((0.0, 2.1, 4.2)):
        base = joint(
            f"a{i}", "palm", f"inner{i}", f"{0.05 * np.cos(angle)} {0.05 * np.sin(angle)} 0", limits="-0.5 1.5"
        )
        parts += [
            link(f"inner{i}", '<box size="0.01 0.01 0.04"/>', "0 0 0.025"),
            link(f"outer{i}", '<box size="0.02 0.02 0.01"/>', "0 0 0.03"),
            base.replace("<axis", f'<origin rpy="0 0 {angle}"/><axis').replace('"/><origin rpy', '" rpy'),
            joint(f"b{i}", f"inner{i}", f"outer{i}", "0 0 0.05", limits="-0.2 1.5"),
        ]
    hand = load_hand(write(tmp_path, *parts))
    for radius, height in ((0.01, 0.05), (0.03, 0.02)):
        cylinder = Cylinder(radius=radius, height=height, mass=0.1, pose=at(0.005, 0.002, 0.07))
        closure = close_hand(hand, cylinder)
        surfaces = Penetration(hand, cylinder, closure.contacts())
        for further in np.linspace(0.1, 1.2, 12):
            depths, normals, _ = surfaces.at(closure.q + further * np.sign(closure.target - closure.start))
            assert np.isfinite(depths).all() and np.linalg.norm(normals, axis=1) == pytest.approx(1.0)


def test_what_cannot_be_computed_is_told_apart():
    assert "repair its mesh" in str(GeometryFailed("tip", "BVHModelOBBRSS"))
    assert "repair its mesh" not in str(GeometryFailed("tip", "Box")) and "sizes and places" in str(
        GeometryFailed("tip", "Box")
    )


def test_objects_of_another_scale_are_refused(two_links):
    for ball in (
        Sphere(radius=0.01, mass=0.1, pose=at(0, 0, 1e6)),
        Sphere(radius=6e12, mass=0.1, pose=at(0, 0, 6.1e12)),
    ):
        for use in (close_hand, lambda hand, one: clearance(hand, one, np.zeros(2))):
            with pytest.raises(InvalidInput, match="within 1000 m of the hand's root"):
                use(two_links, ball)


def test_closing_comes_to_an_end(tmp_path, monkeypatch):
    """A jaw that slides in a slot, a micrometre off its face: no plane parts it from the object, and steps are small."""
    monkeypatch.setattr("pinograsp.contacts.closing._MOST_STEPS", 500)
    hand = load_hand(
        write(
            tmp_path,
            link("palm"),
            link("jaw", '<box size="0.02 0.02 0.02"/>'),
            joint("j", "palm", "jaw", "0 0 0", "1 0 0", "prismatic", "-0.1 0.2"),
        )
    )
    box = Box(size=[0.4, 0.2, 0.2], mass=0.1, pose=at(0, 0, 0.110001))
    assert not close_hand(hand, box, start=[-0.05], target=[0.1]).touches  # past a flat face in a few steps
    walls = [trimesh.creation.box((0.4, 0.02, 0.1)).apply_translation((0, y, 0.05)) for y in (-0.04, 0.04)]
    floor = trimesh.creation.box((0.4, 0.1, 0.02)).apply_translation((0, 0, 0.11))
    slot = trimesh.boolean.union([*walls, floor]).apply_translation((0, 0, -0.089999))
    slotted = Mesh(vertices=slot.vertices, faces=slot.faces, mass=0.1)
    with pytest.raises(InvalidInput, match="more than 500 steps, for 'jaw' stays close to the object for too long"):
        close_hand(hand, slotted, start=[-0.05], target=[0.1])


def test_a_hand_of_very_many_shapes_is_not_closed(tmp_path):
    many = "<collision><geometry><sphere radius='0.01'/></geometry></collision>" * 501
    hand = load_hand(
        write(tmp_path, link("palm"), link("a").replace("</link>", f"{many}</link>"), joint("j", "palm", "a"))
    )
    with pytest.raises(InvalidInput, match="501 collision shapes, expected at most 500"):
        close_hand(hand, Sphere(radius=0.01, mass=0.1, pose=at(0, 0, 0.1)))
