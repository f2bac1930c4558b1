"""Coupled joints: torques, mass matrices and Jacobians against the model with every joint free, E from the file."""

from __future__ import annotations

import pickle

import numpy as np
import own_hands
import pinocchio as pin
import pytest
from marks import slow_except
from own_hands import joint, link, robot
from shipped_hands import SOME_HANDS, loaded, oracle
from urdf_oracle import Description

from pinograsp.errors import HandNotLoaded
from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import CATALOGUE

COUPLED = [
    name for name in CATALOGUE if name.startswith(("psyonic", "romeo", "talos", "tiago", "pr2", "baxter", "panda"))
]


def check_against_free(hand, file, seed=5):
    """rnea, mass matrix and frame Jacobians of ``hand`` are E^T tau, E^T M E and J E of the model without couplings."""
    full = file.model
    for j in range(1, full.njoints):  # masses may have been filled in from the geometry: not what is tested here
        full.inertias[j] = hand.model.inertias[hand.model.getJointId(full.names[j])]
    E, offsets = file.expansion(list(full.names)[1:], hand.joint_names)
    rng = np.random.default_rng(seed)
    data, free = hand.model.createData(), full.createData()
    for _ in range(3):
        q, v, a = rng.uniform(hand.lower, hand.upper), rng.normal(size=hand.n), rng.normal(size=hand.n)
        Q = E @ q + offsets
        tau, theirs = pin.rnea(hand.model, data, q, v, a), E.T @ pin.rnea(full, free, Q, E @ v, E @ a)
        assert np.abs(tau - theirs).max() < 1e-10 * max(1.0, np.abs(theirs).max())
        still = pin.computeGeneralizedGravity(hand.model, data, q)
        assert np.abs(still - E.T @ pin.computeGeneralizedGravity(full, free, Q)).max() < 1e-12
        M = pin.crba(full, free, Q)
        M = E.T @ (np.triu(M) + np.triu(M, 1).T) @ E
        ours = pin.crba(hand.model, data, q)
        assert np.abs(np.triu(ours) - np.triu(M)).max() < 1e-12 * max(1.0, np.abs(M).max())
        for finger in hand.fingers:
            for name in (*finger.links, finger.tip):
                J = pin.computeFrameJacobian(hand.model, data, q, hand.frame_id(name), pin.LOCAL_WORLD_ALIGNED)
                frame = full.getFrameId(name, pin.FrameType.BODY)
                wide = pin.computeFrameJacobian(full, free, Q, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
                assert np.abs(J.reshape(6, hand.n) - wide @ E).max() < 1e-12


def test_the_catalogue_has_coupled_hands():
    assert len(COUPLED) == 13 and all(loaded(name).couplings for name in COUPLED)


@pytest.mark.parametrize("name", COUPLED)
def test_torques_and_jacobians_of_the_catalogues_coupled_hands(name):
    check_against_free(loaded(name), oracle(name))


@pytest.mark.parametrize("name", own_hands.HANDS)
def test_torques_and_jacobians_of_own_hands(name, tmp_path):
    path = own_hands.write(tmp_path, name)
    hand, file = load_hand(path), Description(path)
    check_against_free(hand, file)
    assert all(finger.tip.endswith("_tip") for finger in hand.fingers)
    links = [finger.tip for finger in hand.fingers]
    for q in np.random.default_rng(0).uniform(hand.lower, hand.upper, (3, hand.n)):
        theirs = file.placements(links, dict(zip(hand.joint_names, q)))
        assert np.abs(hand.frame_placements(q, links) - theirs).max() < 1e-12


def test_own_hands_are_what_they_say(tmp_path):
    planar, three, parallel = (load_hand(own_hands.write(tmp_path, name)) for name in own_hands.HANDS)
    assert [hand.n for hand in (planar, three, parallel)] == [1, 3, 1]
    assert [len(hand.couplings) for hand in (planar, three, parallel)] == [1, 3, 1]
    # Jaws that are 12 mm thick, their middles 92 mm apart: 8 cm between them.
    left, right = planar.frame_placements([0.0], ["left_tip", "right_tip"])[:, :3, 3]
    assert right - left == pytest.approx([0.092, 0, 0], abs=1e-12) and left[2] == pytest.approx(0.08)
    left, right = planar.frame_placements([0.5], ["left_tip", "right_tip"])[:, :3, 3]
    assert 0 < right[0] - left[0] < 0.03 and right[0] == pytest.approx(-left[0], abs=1e-12)
    left, right = parallel.frame_placements([0.04], ["left_tip", "right_tip"])[:, :3, 3]
    assert left - right == pytest.approx([0.08, 0, 0], abs=1e-12)
    assert parallel.effort.tolist() == [120] and "60 N at each of the 2 jaws" in parallel.describe()
    assert three.couplings["finger2_coupled"].factor == pytest.approx(0.7)
    assert three.couplings["finger2_coupled"].offset == pytest.approx(0.1)
    assert [finger.name for finger in three.fingers] == ["finger1", "finger2", "finger3"]
    tips = [three.frame_placements([q] * 3, ["finger1_tip"])[0, :3, 3] for q in (0.0, 0.5)]
    assert tips[1][0] < tips[0][0]  # positive angles close
    assert len(three.geometry.geometryObjects) == 10


# -- couplings of every kind -------------------------------------------------------------------------------------------

LIMIT = "-1.0 1.5 2.0 3.0"
RZ = "0.1 -0.2 0.3"


def limb(name, parent, axis="0 0 1", mimic="", kind="revolute", limit=LIMIT):
    """A joint called ``name`` and its link, ``name_link``, somewhere away from the parent's frame."""
    return [
        link(f"{name}_link", 0.1, "box 0.02 0.03 0.05", "0.01 0.02 0.03"),
        joint(name, parent, f"{name}_link", "0.1 0.02 -0.03", axis, limit, rpy=RZ, kind=kind, mimic=mimic),
    ]


def hand_of(tmp_path, *limbs, base=("base",), **options):
    parts = [part for one in ([link(name, 0.2, "box 0.1 0.1 0.1")] for name in base) for part in one]
    path = tmp_path / "hand.urdf"
    path.write_text(robot("coupled", *parts, *(part for one in limbs for part in one)))
    return load_hand(path, **options), path


CASES = {
    "a mimic of a mimic": [
        limb("a", "base"),
        limb("b", "a_link", mimic="a 0.5 0.1"),
        limb("c", "b_link", mimic="b 0.8 0.2"),
    ],
    "a mimic of a mimic that comes later": [
        limb("a", "base"),
        limb("b", "a_link", mimic="c 0.5 0.1"),
        limb("c", "b_link", mimic="a 0.8 0.2"),
    ],
    "a negative multiplier": [limb("a", "base"), limb("b", "base", mimic="a -0.7 0.3", axis="1 2 -1")],
    "across branches, followed joint last by name": [
        limb("a", "base", mimic="z 0.5 0"),
        limb("b", "a_link"),
        limb("z", "base", axis="1 0 0"),
    ],
    "across branches, deep": [
        limb("a", "base"),
        limb("b", "a_link", mimic="y 0.5 0"),
        limb("x", "base"),
        limb("y", "x_link"),
        limb("z", "y_link"),
    ],
    "a turning joint that slides another": [
        limb("a", "base"),
        limb("b", "a_link", mimic="a 0.02 0.01", kind="prismatic", limit="-0.1 0.1 5 1", axis="0 0.6 0.8"),
    ],
    "a sliding joint that turns another": [
        limb("a", "base", kind="prismatic", limit="0 0.05 5 1"),
        limb("b", "a_link", mimic="a 20 -0.3"),
    ],
    "a parent that follows its child": [
        limb("a", "base", mimic="b 0.5 0.2"),
        limb("b", "a_link"),
        limb("c", "b_link", mimic="b -0.3 0"),
    ],
    "two branches that follow each other": [
        limb("a", "base"),
        limb("b", "a_link", mimic="y 0.5 0"),
        limb("x", "base"),
        limb("y", "x_link", mimic=""),
        limb("z", "y_link", mimic="a 0.3 0.1"),
    ],
    "two branches that follow each other at the same depth": [
        limb("a1", "base"),
        limb("a2", "a1_link", mimic="b1 0.5 0.1"),
        limb("b1", "base"),
        limb("b2", "b1_link", mimic="a1 -0.4 0.2"),
    ],
    "a wheel of branches": [
        limb("a1", "base", mimic="c2 -1.5 0.1"),
        limb("a2", "a1_link"),
        limb("b1", "base", mimic="a2 0.4 0"),
        limb("b2", "b1_link"),
        limb("c1", "base", mimic="b2 0.6 0"),
        limb("c2", "c1_link"),
    ],
}


@pytest.mark.parametrize("case", CASES)
def test_couplings_of_every_kind(case, tmp_path):
    hand, path = hand_of(tmp_path, *CASES[case])
    file = Description(path)
    assert hand.n == len(file.moving) - len(file.couplings)
    free = [name for name in file.moving if name not in file.couplings]
    if set(hand.joint_names) == set(free):
        check_against_free(hand, file)
    links = [f"{name}_link" for name in file.moving]
    for q in np.random.default_rng(1).uniform(hand.lower, hand.upper, (3, hand.n)):
        # Whatever joint leads: positions of all joints, from the loader's couplings, obey the file's.
        all_q = dict(zip(hand.joint_names, q))
        for name, one in hand.couplings.items():
            all_q[name] = one.factor * all_q[one.followed] + one.offset
        for name in file.couplings:
            followed, factor, offset = file.couplings[name]
            assert all_q[name] == pytest.approx(factor * all_q[followed] + offset, abs=1e-12)
        theirs = file.placements(links, {name: all_q[name] for name in free})
        assert np.abs(hand.frame_placements(q, links) - theirs).max() < 1e-12


def test_a_joint_that_stands_for_another_has_its_limits(tmp_path):
    """a = 0.5 b + 0.2, a carries b: q is a's. b in [-1, 1.5] is a in [-0.3, 0.95]; power is the same on both."""
    hand, _ = hand_of(tmp_path, *CASES["a parent that follows its child"])
    assert hand.joint_names == ("a",) and set(hand.couplings) == {"b", "c"}
    assert [hand.lower[0], hand.upper[0]] == pytest.approx([-0.3, 0.95])
    assert hand.effort[0] == pytest.approx(2.0 / 0.5) and hand.velocity[0] == pytest.approx(3.0 * 0.5)
    assert hand.couplings["b"].factor == pytest.approx(2.0) and hand.couplings["b"].offset == pytest.approx(-0.4)
    assert hand.couplings["c"].factor == pytest.approx(-0.6)
    assert any("a stands for b" in note for note in hand.notes)
    check = Description(tmp_path / "hand.urdf")
    full = check.model
    # Virtual power: tau_a da = tau_full . dq_full with dq_full = (1, 2, -0.6).
    E = np.array([[{"a": 1.0, "b": 2.0, "c": -0.6}[name]] for name in list(full.names)[1:]])
    o = np.array([{"a": 0.0, "b": -0.4, "c": 0.12}[name] for name in list(full.names)[1:]])
    q, v, a = np.array([0.3]), np.array([0.7]), np.array([-1.1])
    tau = pin.rnea(hand.model, hand.model.createData(), q, v, a)
    assert tau == pytest.approx(E.T @ pin.rnea(full, full.createData(), E @ q + o, E @ v, E @ a), abs=1e-12)


@pytest.mark.parametrize(
    ("limbs", "message"),
    [
        ([limb("a", "base"), limb("b", "a_link", mimic="ghost 1 0")], "mimics the unknown joint 'ghost'; joints: a, b"),
        ([limb("a", "base", mimic="a 1 0"), limb("b", "a_link")], "joint 'a' mimics itself through 'a'"),
        (
            [limb("a", "base", mimic="b 1 0"), limb("b", "a_link", mimic="a 1 0"), limb("c", "b_link")],
            "joint 'b' mimics itself through 'a' and 'b'",
        ),
        ([limb("a", "base"), limb("b", "a_link", mimic="a nan 0")], "<mimic multiplier=>: expected 1 finite number"),
        ([limb("a", "base"), limb("b", "a_link", mimic="a 1 x")], "<mimic offset=>: expected 1 finite number, got 'x'"),
        (
            [
                limb("a", "base"),
                [link("f", 0.1, "box 1 1 1"), joint("f", "a_link", "f", "0 0 0")],
                limb("b", "f", mimic="f 1 0"),
            ],
            "mimics 'f', which is fixed",
        ),
        (
            [limb("a", "base"), limb("b", "a_link", mimic="a 1e-200 0"), limb("c", "b_link", mimic="b 1e-200 0")],
            "joint 'c' mimics 'a' with multiplier 0",
        ),
    ],
)
def test_couplings_that_cannot_be(tmp_path, limbs, message):
    with pytest.raises(HandNotLoaded) as caught:
        hand_of(tmp_path, *limbs)
    assert message in str(caught.value)


def test_what_follows_not_at_all_is_fixed_at_its_offset(tmp_path):
    """And what follows that: c = 2 b + 0.1 = 0.7."""
    followers = [limb("b", "a_link", mimic="a 0 0.3"), limb("c", "b_link", mimic="b 2 0.1")]
    hand, _ = hand_of(tmp_path, limb("a", "base"), *followers)
    free, _ = hand_of(tmp_path, limb("a", "base"), limb("b", "a_link"), limb("c", "b_link"))
    assert hand.joint_names == ("a",) and "joints without travel are fixed: b, c" in hand.notes
    q = dict(zip(free.joint_names, np.zeros(3))) | {"a": 0.2, "b": 0.3, "c": 0.7}
    expected = free.frame_placements(np.array([q[name] for name in free.joint_names]), ["c_link"])
    assert hand.frame_placements(np.array([0.2]), ["c_link"]) == pytest.approx(expected, abs=1e-12)


def test_a_followed_joint_outside_of_the_sub_tree(tmp_path):
    limbs = [limb("arm", "base"), limb("a", "arm_link"), limb("b", "a_link", mimic="arm 1 0")]
    with pytest.raises(HandNotLoaded, match="'b' mimics 'arm', which root= leaves out"):
        hand_of(tmp_path, *limbs, root="arm_link")
    assert hand_of(tmp_path, *limbs)[0].joint_names == ("arm", "a")
    # A joint outside that follows one inside changes nothing.
    limbs = [limb("arm", "base", mimic="a 1 0"), limb("a", "arm_link"), limb("b", "a_link")]
    assert hand_of(tmp_path, *limbs, root="arm_link")[0].joint_names == ("a", "b")


def test_limits_of_coupled_joints_bound_the_joint_they_follow(tmp_path):
    """b = -2 a + 0.1 in [-1, 1.5] lets a only from -0.7 to 0.55."""
    hand, _ = hand_of(tmp_path, limb("a", "base"), limb("b", "a_link", mimic="a -2 0.1"))
    assert [hand.lower[0], hand.upper[0]] == pytest.approx([-0.7, 0.55])
    assert any("limits of a narrowed to -0.7..0.55 by b" in note for note in hand.notes)
    # Limits copied without their sign are not meant; a coupled joint needs none at all.
    for limit in ("-1.5 -1.2 1 1", "0 0 0 0"):
        hand, path = hand_of(tmp_path, limb("a", "base"), limb("b", "a_link", mimic="a 1 0", limit=limit))
        assert [hand.lower[0], hand.upper[0]] == [-1.0, 1.5]
    path.write_text(path.read_text().replace('<limit lower="0" upper="0" effort="0" velocity="0"/>', ""))
    assert load_hand(path).upper[0] == 1.5


def test_mimic_of_a_continuous_joint_and_on_a_fixed_one(tmp_path):
    hand, path = hand_of(tmp_path, limb("a", "base"), limb("b", "a_link", mimic="a 1 0"))
    text = path.read_text()
    path.write_text(text.replace('type="revolute"', 'type="continuous"'))
    turning = load_hand(path)
    assert turning.n == 1 and turning.upper[0] == pytest.approx(np.pi)
    start = text.index('<joint name="b"')
    path.write_text(text[:start] + text[start:].replace('type="revolute"', 'type="fixed"', 1))
    still = load_hand(path)
    assert still.n == 1 and not still.couplings and still.model.njoints == 2
    assert hand.model.njoints == 3


def slides(tmp_path, first, second, factor=1.0, kind="prismatic", **options):
    """Two jaws, the second of which follows the first; each with its effort and velocity limit."""
    axis = "1 0 0" if kind == "prismatic" else "0 1 0"
    jaws = [
        limb("a", "base", axis, kind=kind, limit=f"0 0.04 {first[0]} {first[1]}"),
        limb("b", "base", axis, kind=kind, limit=f"-0.04 0.04 {second[0]} {second[1]}", mimic=f"a {factor} 0"),
    ]
    return hand_of(tmp_path, *jaws, **options)[0]


@pytest.mark.parametrize(
    ("first", "second", "factor", "most"),
    [
        (60, 60, 1.0, 120.0),
        (60, 60, -1.0, 120.0),
        (40, 25, 1.0, 50.0),  # the weaker one ends the squeeze
        (25, 40, 1.0, 50.0),
        (30, 30, 0.5, 45.0),  # a jaw that moves half as far adds half of its force
        (30, 0, 1.0, 30.0),  # one without a limit of its own
    ],
)
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_jaw_may_do_what_its_own_joint_may(tmp_path, kind, first, second, factor, most):
    """Virtual work of jaws that press with F <= min(limits) each: tau = (1 + |factor|) F."""
    hand = slides(tmp_path, (first, 1), (second, 1), factor, kind)
    assert hand.effort == pytest.approx([most]) and hand.drives[0].limit == pytest.approx(most)
    assert any("at each of the 2 jaws" in note for note in hand.notes) == (second > 0)


def test_a_joint_on_the_same_finger_adds_nothing(tmp_path):
    """Of two links of one finger, of which the second follows, the file limits the motor of the first."""
    hand = load_hand(own_hands.write(tmp_path, "three_fingers"))
    assert hand.effort == pytest.approx([1.5, 1.5, 1.5])


def test_a_slow_follower_slows_what_moves_it(tmp_path):
    assert slides(tmp_path, (9, 1.0), (9, 0.3), 2.0).velocity == pytest.approx([0.15])
    assert slides(tmp_path, (9, 0), (9, 0.3), -1.0).velocity == pytest.approx([0.3])
    assert slides(tmp_path, (9, 0.2), (9, 0), 1.0).velocity == pytest.approx([0.2])


def test_describe_says_what_is_coupled_and_in_which_units(tmp_path):
    text = load_hand(own_hands.write(tmp_path, "parallel_gripper")).describe()
    assert "1 joint that moves 1 more" in text and "left_slide -> left_jaw: +0.000 .. +0.040 m, effort 120 N" in text
    assert "right_slide -> right_jaw: follows left_slide: 1 times its position" in text
    text = load_hand(own_hands.write(tmp_path, "three_fingers")).describe()
    assert "3 joints that move 3 more, 3 fingers on 'palm', 0.544 kg" in text
    assert "finger1_flexion -> finger1_proximal: -0.400 .. +1.200 rad, effort 1.5 N m" in text
    assert "follows finger1_flexion: 0.7 times its position + 0.1" in text
    assert text.count("note: joint finger") == 3


def test_limits_of_sliding_joints_are_in_metres(tmp_path):
    hand = load_hand(own_hands.write(tmp_path, "parallel_gripper"), limits={"left_slide": (0.0, 0.03)})
    assert hand.upper[0] == 0.03 and "limits of left_slide set to 0..0.03 m (the hand's own: 0..0.04 m)" in hand.notes
    turning = load_hand(own_hands.write(tmp_path, "planar_gripper")).with_limits({"left_hinge": (0.0, np.pi / 6)})
    assert any("set to 0..30 deg" in note for note in turning.notes)


@pytest.mark.parametrize("name", slow_except(COUPLED, *SOME_HANDS))
def test_coupled_hands_go_to_other_processes(name):
    """Pinocchio's own copies of mimic joints crash after pickling (4.1)."""
    hand = loaded(name).placed(pin.SE3.Random().homogeneous)
    there = pickle.loads(pickle.dumps(hand))
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper)
    assert there.joint_names == hand.joint_names and there.couplings == hand.couplings
    for one, two in zip(there.geometry.geometryObjects, hand.geometry.geometryObjects):
        assert one.placement == two.placement
    results = [pin.rnea(h.model, h.model.createData(), q, q, q) for h in (hand, there)]
    assert np.array_equal(*results)
    tips = [h.frame_placements(q, [finger.tip for finger in h.fingers]) for h in (hand, there)]
    assert np.array_equal(*tips)
