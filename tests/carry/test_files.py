"""Paths from files, plans that were read back, and what the joints are sent."""

import csv
import os
import pickle

import numpy as np
import pytest
from panda_path import JOINTS, WAY, WAYPOINTS
from scipy.interpolate import CubicSpline, make_interp_spline

from pinograsp.carry import ArmPath, plan_carry
from pinograsp.errors import InvalidInput
from pinograsp.handover import read_csv, read_ros2


def written(path, header, rows):
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def test_waypoints_and_timed_tables(tmp_path):
    plain = ArmPath.read(written(tmp_path / "way.csv", JOINTS, WAY.tolist()))
    same = ArmPath.through(WAYPOINTS)
    assert plain.joints == JOINTS and plain.duration is None
    np.testing.assert_allclose(plain.at([0.3]).q, same.at([0.3]).q)
    rows = np.column_stack([[1.0, 1.5, 3.0], WAY])
    timed = ArmPath.read(written(tmp_path / "timed.csv", ("time", *JOINTS), rows.tolist()))
    assert timed.duration == pytest.approx(2.0)
    np.testing.assert_allclose(timed.s, [0.0, 0.25, 1.0])


def test_trajectories_of_controllers(tmp_path, smoothed):
    sent = smoothed.trajectory(rate=200.0)
    sent.to_csv(tmp_path / "a.csv")
    sent.to_ros2(tmp_path / "a.json")
    for name, read in (("a.csv", read_csv), ("a.json", read_ros2)):
        np.testing.assert_allclose(read(tmp_path / name).effort, sent.effort)  # the squeeze
        path = ArmPath.read(tmp_path / name)
        assert path.duration == pytest.approx(smoothed.duration)
        np.testing.assert_allclose(path.at([0.0, 1.0]).q, sent.q[[0, -1]], atol=1e-9)


@pytest.mark.parametrize("degree", [3, 5])
def test_splines_of_scipy(degree):
    x = np.linspace(2.0, 5.0, 8)
    q = np.random.default_rng(0).normal(size=(8, 2))
    spline = make_interp_spline(x, q, k=degree)
    path = pickle.loads(pickle.dumps(ArmPath.along(("a", "b"), spline)))
    s = np.linspace(0.003, 0.997, 50)
    found = path.at(s)
    for order, value in enumerate(found[:degree]):
        np.testing.assert_allclose(value, spline(2.0 + 3.0 * s, order) * 3.0**order, rtol=1e-6, atol=1e-6)
    clamped = CubicSpline(x, q, bc_type="clamped")
    np.testing.assert_allclose(
        ArmPath.along(("a", "b"), clamped).at(s).slope, 3.0 * clamped(2.0 + 3.0 * s, 1), atol=1e-9
    )


def test_splines_that_are_no_paths():
    corner = make_interp_spline([0.0, 1.0, 2.0], [[0.0], [1.0], [0.0]], k=1)
    with pytest.raises(InvalidInput, match="slope is continuous"):
        ArmPath.along(("a",), corner)
    with pytest.raises(InvalidInput, match="spline"):
        ArmPath.along(("a",), np.sin)
    with pytest.raises(InvalidInput, match="waypoints"):
        ArmPath.along(("a", "b"), make_interp_spline(np.arange(5.0), np.arange(5.0)[:, None]))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", "", "suffix"),
        ("a.csv", "panda_joint1\n0\nx\n", "lines of as many numbers"),
        ("a.csv", "a,b\n0,1\n1\n", "lines of as many numbers"),
        ("a.csv", "panda_joint1,panda_joint1\n0,1\n1,1\n", "each joint once"),
        ("a.csv", "time,panda_joint1\n0,1\n0,2\n", "later than the one before"),
        ("a.csv", "", "line of names"),
        ("a.json", "{}", "JointTrajectory"),
        ("missing.csv", None, "missing.csv"),
        ("a.csv", "1" * 200_000 + ",b\n0,1\n", "line of names"),
        ("a.csv", "time\n0\n1\n", "positions of joints"),
        ("a.csv", "a,b\n0,1e999\n1,2\n", "not finite"),
        ("a.csv", "a\n-1e308\n1e308\n", "waypoints"),
        ("a.csv", "time,a\n0,0\n1e-300,1\n1,2\n", "no smooth path"),
        ("a.csv", "time,a\n0,0\n1e-300,1\n", "times of the path"),
        ("a.csv", "a,b\n0,\x00\n", "line of names"),
        ("a.csv", "a,b\n" + "0," * 300_000 + "0\n", "2 names and 300001 numbers"),
        ("a.json", "[" * 100_000, "levels"),
    ],
)
def test_files_that_are_no_paths(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=message):
        ArmPath.read(tmp_path / name)


@pytest.mark.parametrize("name", ["pipe.csv", "device.csv", "folder.csv"])
def test_only_regular_files_are_opened(name, tmp_path):
    """A pipe would wait for ever, a device never end."""
    {
        "pipe.csv": lambda path: os.mkfifo(path),
        "device.csv": lambda path: path.symlink_to("/dev/zero"),
        "folder.csv": lambda path: path.mkdir(),
    }[name](tmp_path / name)
    with pytest.raises(InvalidInput, match="regular file"):
        ArmPath.read(tmp_path / name)


def test_joints_of_several_robots_have_prefixes(tmp_path):
    """A slash in a name makes no table of positions and velocities of it."""
    path = ArmPath.read(written(tmp_path / "way.csv", ("left/turn", "left/tilt"), [[0.0, 0.1], [0.5, 0.2]]))
    assert path.joints == ("left/turn", "left/tilt")


@pytest.mark.parametrize("followers", [False, True])
def test_what_a_plan_writes_is_a_path(arm, grasp, smoothed, followers, tmp_path):
    """Coupled jaws included: fingers hold, and what follows them goes with them."""
    smoothed.trajectory(rate=50.0).to_ros2(tmp_path / "way.yaml", followers=followers)
    path = ArmPath.read(tmp_path / "way.yaml")
    assert ("panda_finger_joint2" in path.joints) == followers
    again = plan_carry(arm, grasp, path, intervals=20)
    assert again.path.joints == JOINTS
    np.testing.assert_allclose(again.path.at([0.0, 1.0]).q, smoothed.path.at([0.0, 1.0]).q, atol=1e-9)


# -- what the joints are sent ------------------------------------------------------------------------------------------


def test_the_arm_follows_the_plan(arm, smoothed):
    sent = smoothed.trajectory(rate=500.0)
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    assert sent.times[-1] == pytest.approx(smoothed.duration) and sent.times[0] == 0.0
    for planned, told in ((smoothed.q, sent.q), (smoothed.dq, sent.dq), (smoothed.ddq, sent.ddq)):
        at = np.column_stack([np.interp(smoothed.instants, sent.times, column) for column in told.T])
        assert np.abs(at - planned)[:, moving].max() < 0.01 * np.abs(planned[:, moving]).max()
    # Derivatives of the positions that are sent.
    np.testing.assert_allclose(np.gradient(sent.q, sent.times, axis=0)[2:-2, moving], sent.dq[2:-2, moving], atol=0.02)
    assert np.abs(sent.dq[[0, -1]]).max() < 1e-6


def test_fingers_are_sent_deeper_for_more_force(arm, grasp):
    """The contact law's depth of the commanded force, along the normals, by differences of the links' poses."""
    plan = plan_carry(arm, grasp, WAYPOINTS, intervals=20, squeeze="constant", reserve=0.3)
    q = plan.commanded_q.copy()
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    q[:, moving] = np.array(grasp.motion.q[-1])[moving]  # where the grasp was planned
    contacts, law = grasp.problem.contacts, grasp.problem.compliance
    before = arm.frame_placements(np.array(grasp.motion.q[-1]), [one.link for one in contacts])
    after = arm.frame_placements(q[0], [one.link for one in contacts])
    local = [np.linalg.solve(pose, np.append(point, 1.0)) for pose, point in zip(before, contacts.points_o)]
    moved = np.array([pose @ point for pose, point in zip(after, local)])[:, :3] - contacts.points_o
    normals = contacts.rotations_oc[:, :, 2]
    deeper = np.einsum("kx,kx->k", moved, normals) + grasp.forces.final_depths
    wanted = (plan.commanded[0] / law.stiffness) ** (1 / law.exponent)
    # Two jaws press eight contacts: as deep as they can be, in the sense of least squares.
    assert deeper.mean() == pytest.approx(wanted.mean(), rel=1e-3)


def test_torques_that_are_sent_press_with_what_is_commanded(arm, smoothed, grasp):
    constant = plan_carry(arm, grasp, WAYPOINTS, intervals=20, squeeze="constant")
    np.testing.assert_allclose(smoothed.commanded_torques, smoothed.torques, atol=1e-9)
    finger = arm.joint_names.index("panda_finger_joint1")
    # Of the coupled jaws both press: what is sent is the sum of the commanded normal forces, whatever the load.
    sent = constant.commanded_torques[:, finger]
    assert np.ptp(sent - constant.torques[:, finger]) > 0 or np.ptp(constant.normal_forces.sum(axis=1)) < 1e-9
    assert abs(np.mean(sent)) == pytest.approx(constant.commanded[0].sum(), rel=0.3)


def test_rates_that_cannot_be(smoothed):
    for rate in (0.0, -1.0, np.nan, 1e9):
        with pytest.raises(InvalidInput, match="rate"):
            smoothed.trajectory(rate=rate)
