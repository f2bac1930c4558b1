"""The hand of a file on the user's own description: other frames, names, orders and directions of the same joints."""

from __future__ import annotations

import dataclasses

import grasp_files
import numpy as np
import pytest
from own_hands import joint, link
from scipy.spatial.transform import Rotation

import pinograsp as pg
from pinograsp.data import CONVENTIONS, GraspRows, JointAxes, alignment, join_rows, joint_axes, place_hand, read_grasps
from pinograsp.errors import InvalidInput


def rows_of(kind, poses, q, joint_names=(), **values):
    n = len(poses)
    given = dict(
        source="file", first=0, object_name="mug", hand_name="", scale=np.ones(n), joint_names=tuple(joint_names)
    )
    return GraspRows(format=kind, poses=poses, q=np.asarray(q, dtype=float), **{**given, **values})


def random_poses(n, seed):
    return grasp_files.some_grasps(n=n, seed=seed).poses


def tips(hand, poses, q, links):
    """Origins of links in the object's frame (N, k, 3), of a hand whose root is at ``poses``."""
    root = np.linalg.inv(hand.pose)
    return np.array([(pose @ root @ hand.frame_placements(one, links))[:, :3, 3] for pose, one in zip(poses, q)])


# -- two descriptions of the same hand, with different roots, directions, names, orders and origins along the axes

FINGERS = {
    "a": ("0.03 0.01 0.02", "0.1 0.2 0"),
    "b": ("-0.03 0 0.02", "0 -0.2 0.1"),
    "c": ("0 -0.03 0.01", "0.7 0 0.4"),
}


def two_descriptions(tmp_path):
    """The first as one would write it; the second with a turned root, its second joints the other way round, its third
    ones with their origins 7 mm farther along the axes, and other names in another order.
    """
    first, second = [link("palm", 0.2, "box 0.1 0.1 0.02")], [link("root"), link("base", 0.2, "box 0.1 0.1 0.02")]
    second.append(joint("mount", "root", "base", "0.02 0.01 0.05", rpy="0.3 -0.4 1.2", kind="fixed"))
    for finger, (at, rpy) in FINGERS.items():
        for i, axis in enumerate(("0 0 1", "1 0 0", "1 0 0")):
            parent = f"{finger}{i - 1}" if i else "palm"
            place = at if i == 0 else "0 0 0.03"
            first.append(link(f"{finger}{i}", 0.05, "cylinder 0.005 0.02", "0 0 0.015"))
            first.append(
                joint(
                    f"{finger}_{i}", parent, f"{finger}{i}", place, axis, "-1 1.5 2 5", rpy=rpy if i == 0 else "0 0 0"
                )
            )
        first += [
            link(f"{finger}_tip"),
            joint(f"{finger}_end", f"{finger}2", f"{finger}_tip", "0 0 0.03", kind="fixed"),
        ]
    for finger, (at, rpy) in reversed(FINGERS.items()):
        for i, axis in enumerate(("0 0 1", "-1 0 0", "1 0 0")):
            parent = f"L{finger}{i - 1}" if i else "base"
            place = {0: at, 1: "0 0 0.03", 2: "0.007 0 0.03"}[i]
            shape_at = "-0.007 0 0.015" if i == 2 else "0 0 0.015"
            second.append(link(f"L{finger}{i}", 0.05, "cylinder 0.005 0.02", shape_at))
            second.append(
                joint(
                    f"J{finger}{i}",
                    parent,
                    f"L{finger}{i}",
                    place,
                    axis,
                    "-1.5 1.5 2 5",
                    rpy=rpy if i == 0 else "0 0 0",
                )
            )
        second += [
            link(f"L{finger}_tip"),
            joint(f"J{finger}_end", f"L{finger}2", f"L{finger}_tip", "-0.007 0 0.03", kind="fixed"),
        ]
    hands = []
    for name, parts in (("first", first), ("second", second)):
        (tmp_path / f"{name}.urdf").write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
        hands.append(pg.load_hand(tmp_path / f"{name}.urdf"))
    return hands


NAMES = {f"{finger}_{i}": f"J{finger}{i}" for finger in FINGERS for i in range(3)}


def test_fingertips_are_where_they_were_on_another_description(tmp_path):
    file_hand, hand = two_descriptions(tmp_path)
    rng = np.random.default_rng(5)
    poses, q = random_poses(6, 8), rng.uniform(-0.9, 1.4, (6, 9))
    order = rng.permutation(9)
    rows = rows_of("isaac", poses, q[:, order], [file_hand.joint_names[i] for i in order])
    there, q_there = place_hand(rows, hand, original=file_hand, joints=NAMES)
    before = tips(file_hand, poses, q, [f"{finger}_tip" for finger in FINGERS])
    after = tips(hand, there, q_there, [f"L{finger}_tip" for finger in FINGERS])
    np.testing.assert_allclose(after, before, atol=1e-7)
    assert np.abs(q_there[:, hand.joint_names.index("Ja1")] + q[:, file_hand.joint_names.index("a_1")]).max() == 0
    # The hand where it stands in a scene does not matter: its root is placed anew.
    moved = hand.placed(random_poses(1, 4)[0])
    again, _ = place_hand(rows, moved, original=file_hand, joints=NAMES)
    np.testing.assert_allclose(again, there, atol=1e-7)


def test_an_alignment_tells_where_hands_differ(tmp_path):
    file_hand, hand = two_descriptions(tmp_path)
    axes = joint_axes(file_hand)
    theirs = joint_axes(hand, [NAMES[name] for name in axes.names])
    laid = alignment(axes, theirs)
    assert laid.residual < 1e-7
    assert [pair for pair, sign in zip(laid.names, laid.signs) if sign < 0] == [
        (f"{finger}_1", f"J{finger}1") for finger in "abc"
    ]
    # A root in the other's root frame, by the URDF's own mount.
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.4, 1.2]).as_matrix()
    mount[:3, 3] = 0.02, 0.01, 0.05
    np.testing.assert_allclose(np.linalg.inv(laid.pose), mount, atol=1e-7)
    origins = np.array(theirs.origins)
    across = np.cross(theirs.directions[4], [0.3, 0.5, 0.8])
    origins[4] += 0.005 * across / np.linalg.norm(across)
    worse = alignment(axes, JointAxes(names=theirs.names, origins=origins, directions=theirs.directions))
    assert worse.worst == laid.names[4] and 4e-3 < worse.residual < 5e-3
    with pytest.raises(InvalidInput, match="three pairs"):
        alignment(axes.choose(axes.names[:2]), theirs.choose(theirs.names[:2]))
    # Where a sliding joint has its origin says nothing: its direction alone counts.
    sliding = dataclasses.replace(theirs, origins=origins, slides=np.arange(9) == 4)
    assert alignment(axes, sliding).residual < 1e-7
    parallel = JointAxes(names=("a", "b", "c"), origins=np.eye(3), directions=np.tile([0.0, 0, 1], (3, 1)))
    with pytest.raises(InvalidInput, match="open"):
        alignment(parallel, parallel)


def test_another_hand_and_other_zeros_are_refused(tmp_path):
    file_hand, _ = two_descriptions(tmp_path)
    rows = rows_of("isaac", random_poses(2, 1), np.zeros((2, 9)), file_hand.joint_names)
    mirrored = (tmp_path / "second.urdf").read_text().replace("0.03 0.01 0.02", "0.034 0.01 0.02")
    (tmp_path / "other.urdf").write_text(mirrored)
    with pytest.raises(InvalidInput, match=r"axes differ by .* mm, most at 'Ja.' \('a_.' of the file\)"):
        place_hand(rows, pg.load_hand(tmp_path / "other.urdf"), original=file_hand, joints=NAMES)
    before, after = (tmp_path / "second.urdf").read_text().split('name="Ja1"')
    after = after.replace('rpy="0 0 0"', 'rpy="0.2 0 0"', 1)  # the zero of this joint: what is beyond it has moved
    (tmp_path / "zero.urdf").write_text(f'{before}name="Ja1"{after}')
    with pytest.raises(InvalidInput, match="has other zeros.*most at 'Ja2'"):
        place_hand(rows, pg.load_hand(tmp_path / "zero.urdf"), original=file_hand, joints=NAMES)


# -- public hands: the catalogue's Allegro is the one of get_a_grip and BODex; DexGraspBench has it turned


@pytest.fixture(scope="module")
def allegro():
    return pg.load_hand("allegro_right")


ALLEGRO_TIPS = ["link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"]


@pytest.mark.parametrize("kind", ["get_a_grip", "bodex", "dexgraspnet"])
def test_allegro_in_the_order_of_the_file(kind, allegro):
    q = np.random.default_rng(0).uniform(0, 0.5, (3, 16))
    rows = rows_of(kind, random_poses(3, 2), q, [f"joint_{i}.0" for i in range(16)])
    poses, there = place_hand(rows, allegro)
    np.testing.assert_allclose(poses, rows.poses, atol=2e-5)  # the known axes have five digits
    for i, name in enumerate(rows.joint_names):
        np.testing.assert_array_equal(there[:, allegro.joint_names.index(name)], q[:, i])


def test_allegro_of_mjcf_is_turned_and_needs_its_name(allegro):
    g = grasp_files.some_grasps(n=1)
    rows = rows_of("dexgraspbench", g.poses, g.q)
    with pytest.raises(InvalidInput, match="convention='allegro_mjcf' or 'leap_mjcf'"):
        place_hand(rows, allegro)
    poses, q = place_hand(rows, allegro, convention="allegro_mjcf")
    palm = np.eye(4)
    palm[:3, :3] = Rotation.from_quat([1, 0, 1, 0]).as_matrix()  # quat="0 1 0 1" of the MJCF file
    np.testing.assert_allclose(poses, g.poses @ palm, atol=2e-5)
    names = [f"joint_{i}.0" for i in range(16)]  # index, middle, ring, thumb
    np.testing.assert_array_equal(q[:, [allegro.joint_names.index(name) for name in names]], g.q)
    dexonomy = dataclasses.replace(rows, format="dexonomy", hand_name="allegro")
    np.testing.assert_array_equal(place_hand(dexonomy, allegro)[0], poses)
    with pytest.raises(InvalidInput, match="not the hand that leap_mjcf is for"):
        place_hand(rows, allegro, convention="leap_mjcf", joints=names)


def test_files_end_to_end_on_the_same_fingertips(allegro, tmp_path):
    """A posture of the catalogue's hand, written as get_a_grip and as DexGraspBench (by way of its MJCF's root)."""
    rng = np.random.default_rng(1)
    q, pose = rng.uniform(0.1, 0.6, 16), random_poses(1, 7)[0]
    ordered = q[[allegro.joint_names.index(f"joint_{i}.0") for i in range(16)]]
    g = grasp_files.some_grasps(n=1)
    g.q[0], g.poses[0] = ordered, pose
    grip = join_rows(read_grasps(grasp_files.npy(tmp_path / "mug_0_0500.npy", grasp_files.get_a_grip(g))))
    palm = np.eye(4)
    palm[:3, :3] = [[0, 0, 1], [0, -1, 0], [1, 0, 0]]
    g.poses[0] = pose @ np.linalg.inv(palm)
    bench = join_rows(read_grasps(grasp_files.npy(tmp_path / "0.npy", grasp_files.dexonomy(g))))
    truth = tips(allegro, pose[None], q[None], ALLEGRO_TIPS)
    for rows in (grip, bench):
        np.testing.assert_allclose(tips(allegro, *place_hand(rows, allegro), ALLEGRO_TIPS), truth, atol=3e-5)


def test_a_left_hand_is_not_a_right_one():
    q = np.zeros((1, 16))
    rows = rows_of("get_a_grip", random_poses(1, 2), q, [f"joint_{i}.0" for i in range(16)])
    with pytest.raises(InvalidInput, match="is the other side"):
        place_hand(rows, pg.load_hand("allegro_left"))


def test_graspqps_allegro_lies_on_the_catalogues(allegro):
    known = CONVENTIONS["allegro_graspqp"]
    rows = rows_of("graspqp", random_poses(2, 3), np.zeros((2, 16)), known.joints)
    poses, _ = place_hand(rows, allegro)
    # Both hands' middle fingers point away from the palm: y of that root, z of this one.
    np.testing.assert_allclose((rows.poses @ [0, 1, 0, 0])[:, :3], (poses @ [0, 0, 1, 0])[:, :3], atol=0.01)


# -- Shadow: the older hand, whose knuckles and thumb turn the other way, on the newer one


def test_the_known_shadow_hands_lie_on_each_other():
    old, new = CONVENTIONS["shadow_dexgraspnet"].axes, CONVENTIONS["shadow_palm"].axes
    names = [f"rh_{name[7:10]}{int(name[10]) + 1}" for name in old.names]
    laid = alignment(new.choose(names), old)
    assert laid.residual < 3e-3 and {pair[1] for pair in laid.names if laid.signs[laid.names.index(pair)] < 0} == {
        "robot0:FFJ3",
        "robot0:MFJ3",
        "robot0:THJ1",
        "robot0:THJ0",
    }
    np.testing.assert_allclose(laid.pose, np.eye(4), atol=2e-3)
    mjcf = CONVENTIONS["shadow_mjcf"].axes
    up = alignment(new.choose(mjcf.names), mjcf).pose
    np.testing.assert_allclose(up[:3, 3], [0, 0, -0.034], atol=1e-6)
    graspqp = CONVENTIONS["shadow_graspqp"].axes
    same = graspqp.choose([name.replace(":", "_") for name in old.names])
    assert alignment(old, same).residual < 2e-5


def test_the_known_leap_hands_lie_on_each_other():
    base, mjcf = CONVENTIONS["leap_base"].axes, CONVENTIONS["leap_mjcf"].axes
    flat = alignment(mjcf.choose(["if_mcp", "if_rot", "if_pip", "th_cmc"]), base.choose(["j1", "j0", "j2", "j12"]))
    assert flat.residual < 1e-6
    np.testing.assert_allclose(flat.pose[:3, 3], [0, 0, 0.1], atol=1e-6)
    np.testing.assert_allclose(flat.pose[:3, :3], np.diag([1, -1, -1]), atol=1e-6)


def shadow_like(tmp_path, name, axes):
    """A hand with these axes at zero, each joint on a link of its own between the palm and the next of its finger."""
    parts, palm = [link("palm", 0.3, "box 0.08 0.02 0.09")], "palm"
    last: dict[str, tuple[str, np.ndarray]] = {}
    fingers = sorted({one[-4:-2] for one in axes.names}, key=[one[-4:-2] for one in axes.names].index)
    for finger in fingers:
        mine = [at for at, one in enumerate(axes.names) if one[-4:-2] == finger]
        mine.sort(key=lambda at: -int(axes.names[at][-1]))  # the outermost joint has the lowest number
        parent, origin = palm, np.zeros(3)
        for at in mine:
            child = f"link_{axes.names[at].replace(':', '_')}"
            place = " ".join(map(repr, (axes.origins[at] - origin).tolist()))
            axis = " ".join(map(repr, axes.directions[at].tolist()))
            parts += [
                link(child, 0.01, "sphere 0.004"),
                joint(axes.names[at], parent, child, place, axis, "-1.6 1.6 2 5"),
            ]
            parent, origin = child, axes.origins[at]
        last[finger] = parent, origin
        parts += [link(f"{finger}_tip"), joint(f"{finger}_end", parent, f"{finger}_tip", "0 0 0.02", kind="fixed")]
    (tmp_path / f"{name}.urdf").write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    return pg.load_hand(tmp_path / f"{name}.urdf", fingers={finger: f"{finger}_tip" for finger in fingers})


def test_a_shadow_file_moves_the_newer_hand_as_the_older_one(tmp_path):
    old = shadow_like(tmp_path, "old", CONVENTIONS["shadow_dexgraspnet"].axes)
    new = shadow_like(tmp_path, "new", CONVENTIONS["shadow_palm"].axes)
    g = grasp_files.some_grasps(n=4, d=22)
    path = grasp_files.npy(tmp_path / "mug.npy", grasp_files.dexgraspnet_rows(g))
    rows = join_rows(read_grasps(path))
    links = ["FF_tip", "MF_tip", "RF_tip"]  # the others are of slightly other lengths in the two
    before = tips(old, *place_hand(rows, old), links)
    after = tips(new, *place_hand(rows, new), links)
    np.testing.assert_allclose(after, before, atol=3e-4)
    _, q = place_hand(rows, new)
    for name, sign in {"rh_FFJ4": -1, "rh_RFJ4": 1, "rh_THJ1": -1, "rh_THJ5": 1, "rh_LFJ5": 1}.items():
        file_name = f"robot0:{name[3:6]}{int(name[6]) - 1}"
        column = g.q[:, grasp_files.SHADOW.index(file_name)]
        np.testing.assert_array_equal(q[:, new.joint_names.index(name)], sign * column)
    with pytest.raises(InvalidInput, match=r"34\.0 mm"):
        bench = rows_of("dexgraspbench", g.poses[:1], g.q[:1])
        place_hand(bench, new, frame="palm")


# -- jaws


def acronym_rows(n=2, kind="acronym", hand_name="panda", **values):
    return rows_of(kind, random_poses(n, 6), np.zeros((n, 0)), hand_name=hand_name, **values)


def test_acronyms_panda_closes_along_x_and_frankas_along_y():
    panda = pg.load_hand("panda")
    rows = acronym_rows()
    with pytest.raises(InvalidInput, match="no position of panda_finger_joint1.*at="):
        place_hand(rows, panda)
    poses, q = place_hand(rows, panda, at={"panda_finger_joint1": [0.01, 0.04]})
    np.testing.assert_array_equal(q[:, 0], [0.01, 0.04])
    links = ["panda_leftfinger", "panda_rightfinger"]
    fingers = (
        np.linalg.inv(rows.poses)[:, None]
        @ np.concatenate([tips(panda, poses, q, links), np.ones((2, 2, 1))], axis=2)[..., None]
    )
    # In ACRONYM's own frame the fingers are at +-x, 58.4 mm before the hand.
    np.testing.assert_allclose(np.abs(fingers[:, :, 0, 0]), [[0.01] * 2, [0.04] * 2], atol=1e-9)
    np.testing.assert_allclose(fingers[:, :, 1, 0], 0, atol=1e-9)
    np.testing.assert_allclose(fingers[:, :, 2, 0], 0.0584, atol=1e-9)
    with pytest.raises(InvalidInput, match="expected a link panda_hand or hand.*palm_in_root"):
        place_hand(rows, pg.load_hand("pr2_left"), at={"l_gripper_l_finger_joint": 0.1})
    generated = acronym_rows(kind="graspgen", hand_name="")
    with pytest.raises(InvalidInput, match="convention='panda_graspgen'"):
        place_hand(generated, panda)
    same, _ = place_hand(generated, panda, convention="panda_graspgen", at={"panda_finger_joint1": 0.04})
    np.testing.assert_array_equal(same, poses)


def test_graspnets_gripper_is_put_where_its_fingertips_are():
    panda = pg.load_hand("panda")
    rows = acronym_rows(
        kind="graspnet", hand_name="", widths=np.array([0.05, 0.08]), labels={"depth": np.array([0.01, 0.04])}
    )
    with pytest.raises(InvalidInput, match="palm_in_root= for the frame between the fingertips' ends"):
        place_hand(rows, panda)
    tip = np.array([[0, 0, -1.0, 0], [0, 1.0, 0, 0], [1.0, 0, 0, 0.1034], [0, 0, 0, 1]])  # x approaches, y closes
    poses, q = place_hand(rows, panda, palm_in_root=tip)
    np.testing.assert_allclose(q[:, 0], [0.025, 0.04])
    ends = poses @ tip
    np.testing.assert_allclose(ends[:, :3, :3], rows.poses[:, :3, :3], atol=1e-12)
    wanted = rows.poses[:, :3, 3] + np.array([[0.01], [0.04]]) * rows.poses[:, :3, 0]
    np.testing.assert_allclose(ends[:, :3, 3], wanted, atol=1e-12)


def test_isaacs_frame_is_given():
    panda = pg.load_hand("panda")
    rows = rows_of(
        "isaac", random_poses(2, 6), [[0.01], [0.02]], ["panda_finger_joint1"], hand_name="/World/panda_hand"
    )
    with pytest.raises(InvalidInput, match="are not known: give"):
        place_hand(rows, panda)
    poses, q = place_hand(rows, panda, frame="panda_hand")
    np.testing.assert_allclose(poses, rows.poses, atol=1e-12)
    np.testing.assert_array_equal(q[:, 0], [0.01, 0.02])


# -- refusals


def test_what_does_not_match_is_named(allegro):
    names = [f"joint_{i}.0" for i in range(16)]
    rows = rows_of("get_a_grip", random_poses(2, 1), np.full((2, 16), 0.3), names)
    other = rows_of("isaac", random_poses(2, 1), np.full((2, 17), 0.3), [*names, "wrist"])
    cases = [
        (dict(convention="alegro"), "did you mean 'allegro"),
        (dict(frame="palm_link", palm_in_root=np.eye(4)), "expected one of them"),
        (dict(palm_in_root=np.diag([1, -1, 1, 1])), "right-handed"),
        (dict(frame="link_3.0_tip"), "no finger's joint moves"),
        (dict(frame="palm"), "expected one of"),
        (dict(at={"joint_77": 0.1}), "joint_77"),
        (dict(at={"joint_0.0": [0.1, 0.2, 0.3]}), r"expected shape \(2,\)"),
        (dict(joints={"joint_0.0": "joint_1.0"}), "each joint of the hand once"),
        (dict(joints={"joint_0.0": None}), "no joint for joint_0.0 of the file, which move"),
        (dict(joints=names[:5]), "16 names"),
        (dict(joints={"nothing": "joint_0.0"}), "joint of the file"),
    ]
    for arguments, message in cases:
        with pytest.raises(InvalidInput, match=message):
            place_hand(rows, allegro, **arguments)
    with pytest.raises(InvalidInput, match="no joint for wrist of the file"):
        place_hand(other, allegro, frame="palm_link")
    still = dataclasses.replace(other, q=np.where(np.arange(17) == 16, 0.0, other.q))
    poses, q = place_hand(still, allegro, frame="palm_link")
    np.testing.assert_allclose(poses, other.poses, atol=1e-12)
    np.testing.assert_array_equal(q, np.full((2, 16), 0.3))


def test_joints_that_follow_others_have_to_agree():
    panda = pg.load_hand("panda")
    both = ["panda_finger_joint1", "panda_finger_joint2"]
    rows = rows_of("isaac", random_poses(2, 6), [[0.01, 0.01], [0.02, 0.02]], both)
    _, q = place_hand(rows, panda, frame="panda_hand")
    np.testing.assert_array_equal(q[:, 0], [0.01, 0.02])
    with pytest.raises(InvalidInput, match="follows 'panda_finger_joint1'"):
        place_hand(dataclasses.replace(rows, q=np.array([[0.01, 0.02], [0.02, 0.02]])), panda, frame="panda_hand")
